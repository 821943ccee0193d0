"""What of a session can be held against another one: inputs, decisions and what came of them, flat and by name.

What differs between any two sessions is left out: ids, times of day, nonces, codes, digests of the log, running numbers.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, TypeGuard

from cutgate.config.load import DEFAULT_LIMIT, InputError, parse_json, parse_toml
from cutgate.protocol import records as wire
from cutgate.protocol.records import RecordError
from cutgate.runtime.audit import names
from cutgate.runtime.audit.container.stored import StoredAttachment
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.review.story import permissives_of
from cutgate.runtime.review.wording import fields_of_record

Values = dict[str, Any]
"""Numbers, text, truth values and lists of them, by name."""

NUMBERS: Final = 1000
"""Values of one file that are told by name; of a file with more, its digest."""
_DEPTH: Final = 8
"""Levels of tables within tables; no file of ours has more."""
NUMBER_MAX: Final = 1e15
_NUMBER: Final = re.compile(r"\d+(?:\.\d+)?")
_WHO: Final = ("account", "host", "operator")
_PROGRAM: Final = ("software", "verifier", "numpy", "cpu_dispatch")
_COLLECTED: Final[dict[str, type[wire.Record]]] = {
    names.LIMITS: wire.Limits,
    names.CALIBRATION: wire.Calibration,
    names.TOOL: wire.Tool,
}
MOMENTARY: Final = frozenset(
    {
        "age of the registration",
        "age of the measured joints",
        "age of the permit",
        "controller's fault latch",
        "controller's witness",
        "measured wrist centre to the verified start",
        "measured joints to the verified start",
    }
)
"""Permissives whose value is of the moment, or names another log: whether they hold counts, and against which bound."""
RUNNING: Final = frozenset({"epoch"})
"""Those whose bound is a running number as well."""
_BOUNDARY: Final = ("certified", "clearance", "deadband", "violated")


def comparable(log: Log, story: Mapping[str, Any]) -> dict[str, Values]:
    """The values that count, by section, in the order in which they are told. Never raises, whatever the log holds.

    Args:
        log: the log as read; its files are open.
        story: what ``story`` has made of it.
    """
    sections: dict[str, Callable[[], Iterable[tuple[str, Any]]]] = {
        "log": lambda: [("status", log.report.status.name)],
        "record 0": lambda: _opened(story["opened"]),
        "robot": lambda: _settings(log, names.ROBOT),
        "site": lambda: _settings(log, names.SITE),
        "plan": lambda: _plan(log),
        "path": lambda: _path(log),
        "registration": lambda: _registration(log),
        "collected": lambda: _collected(log, story["collected"]),
        "verdict": lambda: _numbered(story["verdicts"], _verdict),
        "approach": lambda: _numbered(story["approaches"], _approach),
        "permissives of the permit": lambda: _permissives(story["allowed"], "permit"),
        "permissives of the start": lambda: _permissives(story["allowed"], "start"),
        "outcome": lambda: _outcome(story),
    }
    return {name: _plain(values, log.report.head) for name, values in sections.items()}


def _plain(values: Callable[[], Iterable[tuple[str, Any]]], head: str) -> Values:
    """The values of a section as a JSON document can have them; one that nests without end equals no other."""
    try:
        return {name: _scalar(value) for name, value in values()}
    except RecursionError:
        return {"nested too deeply to be compared, chain head": head}


def _scalar(value: Any) -> Any:
    """A number, a word or a list of them; anything else as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, list) and not any(isinstance(one, list | dict) for one in value):
        return [_scalar(one) for one in value]
    return value if isinstance(value, str | int | float | None) else json.dumps(value, sort_keys=True)


def timing(story: Mapping[str, Any]) -> Values:
    """When permit and start left and the session ended, seconds since its opening, and what its link has counted."""
    left = {one["what"]: one["offset_s"] for one in story["allowed"]}
    closed = story["closed"] or {}
    found: Values = {"opening to permit, s": left.get("permit"), "opening to start, s": left.get("start")}
    found["opening to end, s"] = closed.get("offset_s")
    counts = closed.get("bus")
    if isinstance(counts, Mapping):
        found |= {f"controller's frames: {name.replace('_', ' ')}": count for name, count in counts.items()}
    return {name: value for name, value in found.items() if is_number(value)}


def words_of(text: str) -> str:
    """A sentence with its numbers taken out: two that differ in measured values alone are equal."""
    return _NUMBER.sub("#", text)


# ---------------------------------------------------------------- inputs


def _opened(opened: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Program, account and options of record 0; what else it holds names logs and keys."""
    for name in (*_PROGRAM, *_WHO):
        if name in opened:
            yield name, opened[name]
    options = opened.get("simulation")
    for option in options if isinstance(options, list) else ():
        if isinstance(option, Mapping):
            yield f"option {option.get('name')}", option.get("value")


def _settings(log: Log, name: str) -> Iterator[tuple[str, Any]]:
    """robot.toml or site.toml, key by key."""
    entry = log.scan.attachment(name)
    yield from _file(entry, partial(parse_toml, name))


def _registration(log: Log) -> Iterator[tuple[str, Any]]:
    """The registration, key by key; of another program's file, which one it was made of."""
    for entry in log.scan.attachments:
        if Path(entry.name).stem == names.REGISTRATION_SOURCE:
            yield "made of", f"{entry.name}, SHA-256 {entry.sha256}"
        elif Path(entry.name).stem == names.REGISTRATION:
            yield from _file(entry, partial(parse_json, entry.name))


def _plan(log: Log) -> Iterator[tuple[str, Any]]:
    """A plan of ours key by key, but for its poses; any other tool path by its digest."""
    for entry in log.scan.attachments:
        if Path(entry.name).stem != names.PLAN:
            continue
        yield "kind of file", Path(entry.name).suffix
        if Path(entry.name).suffix == ".json":
            yield from _file(entry, partial(_plan_document, entry.name))
        else:
            yield "size, bytes", entry.size
            yield "SHA-256", entry.sha256


def _plan_document(name: str, data: bytes) -> Any:
    """A plan with how many poses it has, and their digest, in their place. Raises InputError."""
    document = parse_json(name, data)
    if not isinstance(document, dict) or not isinstance(document.get("poses"), list):
        return document
    poses = document["poses"]
    text = json.dumps(poses, separators=(",", ":")).encode()
    return document | {"poses": {"count": len(poses), "SHA-256": sha256(text).hexdigest()}}


def _path(log: Log) -> Iterator[tuple[str, Any]]:
    """The path that was verified: how many poses, its extent in the robot frame, branch, feed, tool and digest."""
    data = _data(log.scan.attachment(names.PATH))
    if data is None:
        return
    try:
        path = wire.PathCodes.parse(data)
    except RecordError as error:
        yield "path", f"cannot be read: {error}"
        return
    tips = path.tips_mm
    yield "poses", len(path)
    for number, axis in enumerate("xyz"):
        yield f"extent {axis}, mm", [float(tips[:, number].min()), float(tips[:, number].max())]
    yield "elbow", path.elbow
    yield "turns of q0 and q3", [path.q0_turns, path.roll_turns]
    yield "feed, mm/s", path.feed_mm_s
    yield "tool length, mm", path.tool_length_mm
    yield "SHA-256", sha256(data).hexdigest()


def _collected(log: Log, entries: list[dict[str, Any]]) -> Iterator[tuple[str, Any]]:
    """What the controller has reported, against the approved, and its values."""
    seen: dict[str, int] = {}
    for entry in entries:
        kind = str(entry.get("kind"))
        seen[kind] = seen.get(kind, 0) + 1
        name = kind if seen[kind] == 1 else f"{kind} ({seen[kind]})"
        yield f"{name}: as approved", entry.get("matches_approved")
        yield f"{name}: SHA-256", entry.get("sha256")
        if "difference" in entry:
            yield f"{name}: difference", entry["difference"]
    for name, record in _COLLECTED.items():
        data = _data(log.scan.attachment(name))
        with suppress(RecordError):
            for field in () if data is None else fields_of_record(record.parse(data)):
                yield f"{Path(name).stem}.{field.name}{f', {field.unit}' if field.unit else ''}", field.value


def _file(entry: StoredAttachment | None, parse: Callable[[bytes], Any]) -> Iterator[tuple[str, Any]]:
    """What a file says, by its keys; of one that cannot be read so, its digest."""
    data = _data(entry)
    if entry is None:
        return
    try:
        found = dict(_flat(parse(data))) if data is not None else {}
    except (InputError, RecursionError):
        found = {}
    if 0 < len(found) <= NUMBERS:
        yield from found.items()
    else:
        yield "size, bytes", entry.size
        yield "SHA-256", entry.sha256


def _data(entry: StoredAttachment | None) -> bytes | None:
    return entry.data if entry is not None and entry.size <= DEFAULT_LIMIT else None


def _flat(value: Any, name: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Numbers, words and plain lists by their place in a document."""
    if depth < _DEPTH and isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key), depth + 1)
    elif depth < _DEPTH and isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        for number, inner in enumerate(value):
            yield from _flat(inner, f"{name}[{number}]", depth + 1)
    else:
        yield name, value if isinstance(value, str | int | float | list | dict | None) else str(value)


# ---------------------------------------------------------------- decisions


def _numbered(
    entries: list[dict[str, Any]], values: Callable[[Mapping[str, Any]], Iterable[tuple[str, Any]]]
) -> Iterator[tuple[str, Any]]:
    """The values of each record; a session has one as a rule."""
    for number, entry in enumerate(entries, 1):
        before = "" if number == 1 else f"({number}) "
        for name, value in values(entry):
            yield before + name, value


def _verdict(verdict: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The verdict, every boundary, the path's lengths, the joints' speeds and what was warned of."""
    for name in ("verdict", "method", "poses", "elbow", "q0_turns", "roll_turns"):
        if name in verdict:
            yield name.replace("_", " "), verdict[name]
    for boundary in verdict["boundaries"]:
        for name in _BOUNDARY:
            yield f"{boundary.get('name')} {name}{_unit(boundary, name)}", boundary.get(name)
    document = _document(verdict)
    yield from _flat(document.get("path", {}), "path")
    speeds = document.get("speed")
    for line in speeds if isinstance(speeds, list) else ():
        if isinstance(line, Mapping):
            yield (
                f"q{line.get('joint')} peak speed, of its limit",
                _ratio(line.get("peak"), line.get("limit")),
            )
    for warning in verdict["warnings"]:
        yield f"warning {warning.get('code')}", warning.get("value")


def _approach(approach: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The verdict, what a permit binds, and every boundary of every leg."""
    for name in ("verdict", "entry_um", "exit_um", "speed_percent"):
        if name in approach:
            yield name, approach[name]
    for name in ("start_joints_u", "entry_joints_u", "exit_joints_u"):
        yield f"{name.removesuffix('_u')}, 1e-6 deg or mm", approach.get(name)
    legs = _document(approach).get("legs")
    for leg, boundaries in legs.items() if isinstance(legs, Mapping) else ():
        for boundary, entry in boundaries.items() if isinstance(boundaries, Mapping) else ():
            for name in _BOUNDARY if isinstance(entry, Mapping) else ():
                yield f"{leg}: {boundary} {name}{_unit(entry, name)}", entry.get(name)


def _permissives(allowed: list[dict[str, Any]], what: str) -> Iterator[tuple[str, Any]]:
    """Of permit or start: whether each one held, on what, and against which bound."""
    for one in allowed:
        for entry in permissives_of(one) if one["what"] == what else ():
            name = str(entry.get("name"))
            yield f"{name}: holds", entry.get("holds")
            if name not in RUNNING:
                yield f"{name}: required", entry.get("bound")
            if name not in MOMENTARY | RUNNING:
                yield f"{name}: found", entry.get("value", entry.get("text"))


def _outcome(story: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """How it ended, and by what it was stopped."""
    left = {one["what"] for one in story["allowed"]}
    yield "permit left", "permit" in left
    yield "start left", "start" in left
    closed, stop = story["closed"], story["stop"]
    yield "closed", closed is not None
    for name in ("final_state", "verdict", "outcome", "clean"):
        if closed and name in closed:
            yield name.replace("_", " "), closed[name]
    yield "first-out", None if stop is None else stop["cause"]
    if stop is not None:
        yield "stopped while", stop["while"]
        yield "stop confirmed", stop["confirmed"]


def _document(record: Mapping[str, Any]) -> dict[str, Any]:
    with suppress(TypeError, ValueError, RecursionError):
        found = json.loads(record.get("document", ""))
        if isinstance(found, dict):
            return found
    return {}


def _unit(boundary: Mapping[str, Any], name: str) -> str:
    return "" if name == "violated" else f", {boundary.get('unit')}"


def _ratio(part: object, whole: object) -> float | None:
    if is_number(part) and is_number(whole) and whole:
        return part / whole
    return None


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether it is a number that a session writes; JSON has integers without end."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= NUMBER_MAX
