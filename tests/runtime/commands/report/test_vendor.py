"""What others wrote and we ship is what was bundled: by hash, by version, with its licences."""

import json
import re
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
SOURCES = ROOT / "tools" / "vendor"
SHIPPED = files("cutgate.runtime.commands.report") / "vendor"
VENDORED = json.loads((SHIPPED / "vendored.json").read_text(encoding="utf-8"))
LOCK = json.loads((SOURCES / "package-lock.json").read_text(encoding="utf-8"))
LIBRARIES = ("three", "uplot")


def test_every_shipped_file_has_its_hash_and_no_other_is_shipped():
    shipped = {file.name: file.read_bytes() for file in SHIPPED.iterdir() if file.name != "vendored.json"}
    assert {name: sha256(data).hexdigest() for name, data in shipped.items()} == VENDORED["sha256"]


def test_the_versions_are_those_of_the_lock_and_each_is_asked_for_exactly():
    asked = json.loads((SOURCES / "package.json").read_text(encoding="utf-8"))
    locked = {name: LOCK["packages"][f"node_modules/{name}"]["version"] for name in VENDORED["versions"]}
    assert VENDORED["versions"] == locked
    assert {**asked["dependencies"], **asked["devDependencies"]} == locked
    assert set(asked["dependencies"]) == set(LIBRARIES)


def test_every_locked_package_has_a_checksum():
    packages = {name: one for name, one in LOCK["packages"].items() if name}
    assert packages.keys() >= {f"node_modules/{name}" for name in VENDORED["versions"]}
    assert all(one["integrity"].startswith("sha512-") for one in packages.values())


@pytest.mark.parametrize("name", LIBRARIES)
def test_each_licence_is_there_whole(name):
    text = (SHIPPED / f"LICENSE.{name}").read_text(encoding="utf-8")
    assert re.search(r"MIT License", text)
    assert re.search(r"^Copyright ", text, re.MULTILINE)
    assert "The above copyright notice and this permission notice shall be included" in text
    assert text.rstrip().endswith("SOFTWARE.")


def test_the_bundle_asks_for_nothing_and_makes_no_code_of_text():
    """The page's policy would refuse it; then what is drawn by it would be missing."""
    text = (SHIPPED / "drawing.js").read_text(encoding="utf-8")
    assert text.startswith("var drawing=(()=>{")
    assert not re.search(r"\beval\(|new Function\(", text)
    assert "</script" not in text.lower()
    assert "sourceMappingURL" not in text
