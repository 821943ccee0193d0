"""One thing, one name: a public class name stands once in the packages, and no identifier uses a word that is given up."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("protocol", "config", "runtime", "firmware_sim")
TWINS = {
    "DeviceCycle",
    "HeartbeatLost",
    "HeartbeatReceived",
    "JointsMeasured",
    "OpenLink",
    "Send",
    "Tick",
}
"""Events and effects that the tables of both sides have, each for itself: neither imports the other."""
GIVEN_UP = {
    "beyond": "standoff, or outside",
    "bow": "bound of the second order",
    "calm": "recovery",
    "course": "reference trajectory",
    "hopeless": "unrecoverable",
    "lifted": "unwrapped",
    "rooms": "modules",
    "said": "operator command",
    "storm": "randomised fault injection",
    "storms": "randomised fault injection",
    "sway": "bound of the first order",
    "watch": "tracking monitor",
    "ways": "approach and retract",
    "weather": "randomised fault injection",
    "word": "operator command",
    "wound": "winding",
}


KEPT = {
    "protocol/states.py: JOINTS_BEYOND_WIRE": "the wire's, and beyond is meant",
    "runtime/audit/records.py: word": "the field of the log, which old logs have as well",
}


def sources(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((ROOT / folder).rglob("*.py"))


def identifiers(tree: ast.AST) -> Iterator[str]:
    """What the source defines: classes, functions, arguments, variables, attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
                yield name
            case ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def words(name: str) -> set[str]:
    """The words of a name, as ``HeartbeatLost`` and ``heartbeat_lost`` have them."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def test_a_class_name_means_one_thing_in_the_whole_house():
    places = defaultdict(list)
    for path in sources(*PACKAGES):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(ROOT)))
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert {name: found for name, found in twice.items() if name not in TWINS} == {}
    assert set(twice) == TWINS, "a twin that is none any more"


def test_no_identifier_uses_a_word_that_is_given_up():
    found = set()
    for path in sources(*PACKAGES):
        for name in identifiers(ast.parse(path.read_text(encoding="utf-8"))):
            if words(name) & GIVEN_UP.keys():
                found.add(f"{path.relative_to(ROOT)}: {name}")
    assert found == set(KEPT)


def test_no_file_is_named_by_one():
    named = {
        path
        for path in sources(*PACKAGES, "tests")
        if words(path.stem.removeprefix("test_")) & GIVEN_UP.keys()
    }
    assert named == set()
