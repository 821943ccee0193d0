"""A machine as others have it: an own environment, folders of packages, and places that plant modules."""

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLANTED = """
import pathlib
pathlib.Path({marker!r}).write_text(__name__)
raise SystemExit("a planted module was run")
"""
MODULES = (
    "can",
    "config",
    "firmware_sim",
    "multiprocessing",
    "numpy",
    "protocol",
    "runtime",
    "signal",
    "typing",
)
"""Ours of old, those that our processes import first, and those that their children import first."""


def run(
    command: list[str | Path], *, cwd: Path = ROOT, env: Mapping[str, str] | None = None, code: int = 0
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; what it said is in the failure where it ends with another code."""
    words = list(map(str, command))
    surroundings = {**os.environ, "PYTHONPATH": "", **(env or {})}
    done = subprocess.run(
        words, cwd=cwd, env=surroundings, text=True, capture_output=True, check=False, timeout=300
    )
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


def environment(folder: Path) -> Path:
    """An empty environment of this Python; returns its folder of programs."""
    run([sys.executable, "-m", "venv", "--clear", folder])
    return folder / "bin"


def checkout(folder: Path) -> Path:
    """The repository's files as a fresh clone would have them, this working tree's changes included."""
    names = run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]).stdout.split("\0")
    for name in filter(None, names):
        source, target = ROOT / name, folder / name
        if source.is_symlink() or source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target, follow_symlinks=False)
    return folder


def false_wheel(folder: Path, name: str, version: str = "9999.0") -> None:
    """A wheel that must not be installed: newer than any, and empty."""
    stem = f"{name.replace('-', '_')}-{version}"
    files = {
        f"{stem}.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{stem}.dist-info/WHEEL": "Wheel-Version: 1.0\nGenerator: false\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(
        f"{path},sha256={base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b'=').decode()},{len(text)}\n"
        for path, text in files.items()
    )
    with zipfile.ZipFile(folder / f"{stem}-py3-none-any.whl", "w") as wheel:
        for path, text in {
            **files,
            f"{stem}.dist-info/RECORD": f"{record}{stem}.dist-info/RECORD,,\n",
        }.items():
            wheel.writestr(path, text)


def plant(folder: Path) -> Path:
    """Modules and packages that leave a marker when they are run; returns where the marker would be."""
    marker = folder / "planted-module-was-run"
    text = PLANTED.format(marker=str(marker))
    for name in MODULES:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(text, encoding="utf-8")
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return marker
