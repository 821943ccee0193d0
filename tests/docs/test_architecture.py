"""docs/architecture.md is true of the house: every module and every name on the way is there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = "protocol|config|runtime|firmware_sim"
MODULES = sorted(set(re.findall(rf"`((?:{PACKAGES})/[\w/]+(?:\.py|/))`", PAGE)))
NAMED = sorted(set(re.findall(rf"`((?:{PACKAGES})/[\w/]+\.py)` `(\w+)`", PAGE)))


def defined(path: str) -> set[str]:
    """Classes and functions of a module."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}


@pytest.mark.parametrize("path", MODULES)
def test_every_module_is_there(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize(("path", "name"), NAMED, ids=[f"{path}:{name}" for path, name in NAMED])
def test_every_name_on_the_way_is_in_its_module(path, name):
    assert name in defined(path)


def test_a_pose_a_heartbeat_a_decision_and_a_motion_of_the_bone_are_followed():
    for what in ("A pose.", "A heartbeat of the controller.", "A decision.", "A bone that moves."):
        assert f"**{what}**" in PAGE
    assert len(NAMED) > 15
