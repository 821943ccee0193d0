"""Plan, tool path and registration files, by their extension."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cutgate.config.constants import CONSTANTS
from cutgate.config.load import (
    DEFAULT_LIMIT,
    EXAMPLES,
    SETTINGS_LIMIT,
    InputError,
    Loaded,
    Shipped,
    check_size,
    parse_json,
    read_bytes,
    read_settings,
    validate,
)
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.model import Plan, PlanDocument
from cutgate.runtime.plan.poses import poses_of, shorter, table_of
from cutgate.runtime.plan.registration import Registration, finer_than_a_microsecond
from cutgate.runtime.plan.registrations.declared import NOTHING, Declared, refuse_declared
from cutgate.runtime.plan.registrations.foreign import FOREIGN_EXTENSIONS, Converted, converted
from cutgate.runtime.plan.toolpath.languages import EXTENSIONS, check_declared, language_of
from cutgate.runtime.plan.toolpath.model import PLAIN, Cut, Reading, Told

PLAN_EXTENSIONS: Final = (".json", *EXTENSIONS)
REGISTRATION_EXTENSIONS: Final = (".json", *FOREIGN_EXTENSIONS)
PLANS: Final = Shipped(EXAMPLES, "", ".plan.json", "an example")
REGISTRATIONS: Final = Shipped(EXAMPLES, "registration-", ".json", "an example")
DEFAULT_POSE_LIMIT: Final = int(CONSTANTS["pose_limit"].default)
_SMALLER: Final = (
    "a rigid registration is far smaller: name a file of one; a B-spline or displacement field is none"
)
BESIDE_POSES: Final = 1_000
"""Brackets, braces, colons and commas of a plan that are not its poses': fewer than a hundred, and what its names hold."""


def load_plan(
    path: str | Path,
    *,
    size_limit: int = DEFAULT_LIMIT,
    pose_limit: int = DEFAULT_POSE_LIMIT,
    reading: Reading = PLAIN,
) -> Loaded[Plan]:
    """A plan (``.json``) or a bare tool path of one tool, or else the example of that name; read once.

    Raises:
        InputError: names file, key or line, value and bound.
    """
    path, data = _read(path, size_limit)
    return Loaded(plan_from_bytes(path, data, pose_limit, reading), data, path)


def load_plans(
    path: str | Path,
    *,
    size_limit: int = DEFAULT_LIMIT,
    pose_limit: int = DEFAULT_POSE_LIMIT,
    reading: Reading = PLAIN,
    told: Told | None = None,
) -> tuple[Loaded[Plan], ...]:
    """The same, one plan for each tool of the file.

    Raises:
        InputError: names file, key or line, value and bound.
    """
    path, data = _read(path, size_limit)
    plans = plans_from_bytes(path, data, pose_limit, reading, told)
    return tuple(Loaded(plan, data, path) for plan in plans)


def _read(path: str | Path, size_limit: int) -> tuple[Path, bytes]:
    found = _found(path, PLANS, PLAN_EXTENSIONS, "a plan or tool path")
    return found, read_bytes(found, size_limit)


def load_registration(path: str | Path, declared: Declared = NOTHING) -> Loaded[Registration]:
    """A registration (``.json``), one of another program (`Converted`), or else the example of that name; read once.

    Args:
        path: see above.
        declared: what a file of another program does not say.

    Raises:
        InputError: names file, key or line, value and bound; or the option that is missing, or means nothing.
    """
    path = _found(path, REGISTRATIONS, REGISTRATION_EXTENSIONS, "a registration")
    if path.suffix.lower() in FOREIGN_EXTENSIONS:
        source = read_bytes(path, SETTINGS_LIMIT, _SMALLER)
        data = converted(path, source, declared)
        return Converted(registration_from_bytes(path, data), data, path, source, declared)
    refuse_declared(declared, f"{path} says it itself", "drop the option, or correct the file")
    data = read_settings(path)
    return Loaded(new_registration(path, data), data, path)


def new_registration(path: Path, data: bytes) -> Registration:
    """The registration in a file's ``data``, as a session would take it.

    Raises:
        InputError: names file, key, value and bound.
    """
    registration = registration_from_bytes(path, data)
    _check_time(path, registration.created_utc)
    return registration


def load_placed(path: str | Path | None, declared: Declared = NOTHING) -> Loaded[Registration] | None:
    """The same; None where no registration is named, and then nothing may be declared of one.

    Raises:
        InputError: as ``load_registration``.
    """
    if path is None:
        refuse_declared(declared, "no registration is given", "name the file with --registration")
        return None
    return load_registration(path, declared)


def _check_time(path: Path, created_utc: str) -> None:
    """Refuses a time that would not be told apart from another one."""
    if finer_than_a_microsecond(created_utc):
        bound = "at most six digits behind the second"
        raise InputError(path, "created_utc", created_utc, bound, "leave the other digits out")


def registration_from_bytes(path: Path, data: bytes) -> Registration:
    """The registration in ``data``; ``path`` serves for messages (and for a replay from a log).

    Raises:
        InputError: names file, key, value and bound.
    """
    check_size(path, len(data))
    return validate(path, Registration, parse_json(path, data), "cutgate.registration/1")


def plan_from_bytes(
    path: Path, data: bytes, pose_limit: int = DEFAULT_POSE_LIMIT, reading: Reading = PLAIN
) -> Plan:
    """The plan in ``data``, for one tool; ``path`` decides the format and serves for messages.

    Raises:
        InputError: names file, key or line, value and bound; or the tools, where the file has several.
    """
    plans = plans_from_bytes(path, data, pose_limit, reading)
    single_tool(path, plans)
    return plans[0]


def single_tool(path: Path, plans: Sequence[Plan]) -> None:
    """Refuses a file of several tools: no tool is changed while the bone is fixed.

    Raises:
        InputError: names the tools.
    """
    if len(plans) > 1:
        cuts = [plan.cut for plan in plans if plan.cut is not None]
        found = ", ".join(f"tool {cut.tool} from line {cut.lines[0]}" for cut in cuts)
        remedy = "make a file of each tool's part; `cutgate verify` judges each part of this one"
        raise InputError(path, "tools", found, "one tool, mounted for the whole path", remedy)


def plans_from_bytes(
    path: Path,
    data: bytes,
    pose_limit: int = DEFAULT_POSE_LIMIT,
    reading: Reading = PLAIN,
    told: Told | None = None,
) -> tuple[Plan, ...]:
    """What is in ``data``, a plan for each tool; ``path`` decides the format and serves for messages.

    Args:
        path: see above.
        data: the file's content.
        pose_limit: most poses of all tools together.
        reading: what is declared of a tool path.
        told: takes what was understood of a tool path, line by line.

    Raises:
        InputError: names file, key or line, value and bound.
    """
    language = language_of(path)
    check_declared(path, language, reading)
    if language is None:
        if told is not None:
            bound = f"left out: {path} is a plan, which says itself what its numbers are"
            raise InputError("--explain", "", None, bound, "drop the option")
        return (_plan(path, data, pose_limit),)
    return tuple(_of_cut(path, cut) for cut in language.read(path, data, reading, pose_limit, told).cuts)


def _of_cut(path: Path, cut: Cut) -> Plan:
    """One tool's part of a tool path, with the feed that holds for all of it, if there is one."""
    feeds = cut.feed_range_mm_s
    return Plan(
        id=path.stem,
        implant=None,
        side=None,
        tool_length_mm=cut.tool_length_mm,
        feed_mm_s=feeds[0] if feeds and feeds[0] == feeds[1] else None,
        ct_T_implant=_identity(),
        ct_id=None,
        tips_mm=cut.tips_mm,
        axes=cut.axes,
        cut=cut,
    )


def _plan(path: Path, data: bytes, pose_limit: int) -> Plan:
    _check_crowd(path, data, pose_limit)
    document = validate(path, PlanDocument, parse_json(path, data), "cutgate.plan/1")
    _check_count(path, document.poses, pose_limit)

    def place(index: int) -> str:
        return f"poses.{index}"

    tips, axes = poses_of(path, table_of(path, document.poses, place), place)
    return Plan(
        id=document.id,
        implant=document.implant,
        side=document.side,
        tool_length_mm=document.tool_length_mm,
        feed_mm_s=document.feed_mm_s,
        ct_T_implant=np.array(document.ct_T_implant, dtype=np.float64),
        ct_id=document.ct_id,
        tips_mm=tips,
        axes=axes,
    )


def _identity() -> Floats:
    return np.eye(4)


def _check_crowd(path: Path, data: bytes, pose_limit: int) -> None:
    """Refuses what would take more memory than the longest path: an empty list is 2 bytes here and 56 when parsed."""
    for signs, most in ((b"[", pose_limit), (b"{", 0), (b":", 0), (b",", 6 * pose_limit)):
        count, bound = data.count(signs), most + BESIDE_POSES
        if not (count <= bound):
            found = f"{count} times '{signs.decode()}'"
            remedy = f"it holds something else, or more poses: {shorter(pose_limit)}"
            raise InputError(path, "", found, f"<= {bound} for {pose_limit} poses", remedy)


def _check_count(path: Path, poses: list[Any], pose_limit: int) -> None:
    if not (len(poses) <= pose_limit):
        raise InputError(path, "poses", f"{len(poses)} poses", f"<= {pose_limit} poses", shorter(pose_limit))


def _found(path: str | Path, shipped: Shipped, accepted: tuple[str, ...], what: str) -> Path:
    """The file that is named, or the example.

    Raises:
        InputError: an extension that is not read, before the file is touched; or no such file or example.
    """
    suffix = Path(path).suffix
    if suffix and suffix.lower() not in accepted:
        raise InputError(path, "extension", suffix, _either(accepted, what), "convert the file")
    found = shipped.file(path)
    if not found.suffix:
        raise InputError(path, "extension", "missing", _either(accepted, what), "convert the file")
    return found


def _either(extensions: tuple[str, ...], what: str) -> str:
    return f"{' or '.join(extensions)} for {what}"
