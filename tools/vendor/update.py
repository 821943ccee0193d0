"""Bundles what the report page draws with: ``python tools/vendor/update.py``; needs npm, and nothing of it runs at install.

The versions and their checksums are those of ``package-lock.json``; no script of a package is run. What comes out stands in
``runtime/commands/report/vendor`` with both licences, and its SHA-256 in ``vendored.json``, which a test compares.
"""
# ruff: noqa: INP001, S603, S607

import json
import shutil
import subprocess
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).parent
INTO: Final = HERE.parents[1] / "runtime" / "commands" / "report" / "vendor"
PACKAGES: Final = ("three", "uplot")
BUNDLE: Final = (
    "node_modules/.bin/esbuild", "entry.js", "--bundle", "--minify", "--format=iife", "--global-name=drawing",
    "--legal-comments=eof", "--log-level=error", "--outfile=drawing.js",
)  # fmt: skip


def main() -> None:
    """Install in a folder of its own, bundle, and copy."""
    with tempfile.TemporaryDirectory() as own:
        folder = Path(own)
        for name in ("entry.js", "package.json", "package-lock.json"):
            shutil.copy(HERE / name, folder)
        subprocess.run(
            ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"], cwd=folder, check=True
        )
        subprocess.run(BUNDLE, cwd=folder, check=True)
        INTO.mkdir(exist_ok=True)
        shutil.copy(folder / "drawing.js", INTO)
        shutil.copy(folder / "node_modules/uplot/dist/uPlot.min.css", INTO / "uplot.css")
        for name in PACKAGES:
            shutil.copy(folder / "node_modules" / name / "LICENSE", INTO / f"LICENSE.{name}")
        lock = json.loads((folder / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    files = sorted(path for path in INTO.iterdir() if path.suffix != ".json")
    told = {
        "versions": {name: lock[f"node_modules/{name}"]["version"] for name in (*PACKAGES, "esbuild")},
        "sha256": {path.name: sha256(path.read_bytes()).hexdigest() for path in files},
    }
    (INTO / "vendored.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
