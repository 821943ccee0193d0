"""Plan, registration and robot to the quantised path that the controller will execute.

``R_p = R_T_CT * CT_T_I * I_p`` for tips, the rotations alone for tool axes.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Final, Literal

import numpy as np

from cutgate.config.load import InputError, Loaded
from cutgate.config.model import Robot
from cutgate.config.records import tool_record
from cutgate.protocol.arrays import Floats
from cutgate.protocol.records import Path, RecordError
from cutgate.runtime.kinematics.pose import transform_poses
from cutgate.runtime.plan.model import Plan
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.plan.registrations.declared import OPTIONS
from cutgate.runtime.plan.registrations.foreign import Converted
from cutgate.runtime.plan.toolpath.model import Cut

Link = Literal["linked", "not linked"]
Quantise = Callable[[Floats, Floats], tuple[Floats, Floats]]

DEFAULT_FEED_MM_S: Final = 10.0
TOOL_TOLERANCE_U: Final = 10_000
"""0.01 mm in counts of 1e-6 mm."""
TURN_MAX_DEG: Final = 179.0
IDENTITY_REGISTRATION: Final = b"cutgate.registration/identity"
"""Stands for the content in the registration digest where no registration is given."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """What is verified, and what it was made from.

    Attributes:
        path: the quantised path in the robot frame; its joint branch is (0, 0) until a verdict chooses one.
        plan: the plan or tool path.
        registration: None where none was given (identity).
        ct_link: whether plan and registration name the same CT, or one of them names none.
        robot: the arm, whose path tolerances include what straight moves leave out of what the file describes.
    """

    path: Path
    plan: Loaded[Plan]
    registration: Loaded[Registration] | None
    ct_link: Link
    robot: Robot

    @property
    def registration_digest(self) -> bytes:
        """What the registration is known by (`Registration.digest`); SHA-256 of ``IDENTITY_REGISTRATION`` without one."""
        if self.registration is None:
            return hashlib.sha256(IDENTITY_REGISTRATION).digest()
        return self.registration.value.digest

    @property
    def digests(self) -> frozenset[bytes]:
        """The same, and the SHA-256 of the file, by which 0.1.0 knew it."""
        files = () if self.registration is None else (self.registration.sha256,)
        return frozenset({self.registration_digest, *files})

    @property
    def quantise(self) -> Quantise:
        """What the wire does to poses, with this path's elbow, feed and tool; for guidance."""

        def quantised(tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
            path = Path.quantised(
                tips_mm,
                axes,
                feed_mm_s=self.path.feed_mm_s,
                tool_length_mm=self.path.tool_length_mm,
                elbow=self.path.elbow,
            )
            return path.tips_mm, path.axes

        return quantised


def with_branch(path: Path, q0_turns: int, roll_turns: int) -> Path:
    """The same path in the joint branch that a verdict chose."""
    return replace(path, q0_turns=q0_turns, roll_turns=roll_turns)


def prepare(
    plan: Loaded[Plan],
    registration: Loaded[Registration] | None,
    robot: Robot,
    *,
    now: datetime,
    clock_skew_s: float,
    tool_length_mm: float | None = None,
    feed_mm_s: float | None = None,
) -> Prepared:
    """The path to verify and to upload.

    Args:
        plan: the plan or bare tool path.
        registration: None stands for identity.
        robot: elbow and mounted tool.
        now: aware; a registration made later is refused,
        clock_skew_s: by more than the clock of who registers may be ahead of this one.
        tool_length_mm: replaces the robot's tool (off-line verification only).
        feed_mm_s: feed where the file has none; 10 mm/s if None.

    Raises:
        InputError: another CT, another tool, a registration from the future, a feed beside the plan's, poses
            beyond the wire, or neighbouring tool axes more than 179 deg apart.
    """
    tool = tool_record(robot, tool_length_mm)
    _check_tool(plan, tool.length_u)
    feed = _feed(plan, feed_mm_s)
    link = _check_link(plan, registration)
    placement = plan.value.ct_T_implant
    if registration is not None:
        _check_age(registration, now, clock_skew_s)
        placement = registration.value.matrix @ placement
    tips, axes = transform_poses(placement, plan.value.tips_mm, plan.value.axes)
    _check_turns(plan, axes)
    try:
        path = Path.quantised(tips, axes, feed_mm_s=feed, tool_length_mm=tool.length_mm, elbow=robot.elbow)
    except RecordError as error:
        remedy = "check units, registration and ct_T_implant"
        raise InputError(
            plan.path, "poses", str(error), "what the wire carries, in the robot frame", remedy
        ) from None
    try:
        arm = widened(robot, plan.value.cut)
    except ValueError:
        bound = "small enough for path_tolerance_mm and path_tolerance_deg of robot.toml to hold them as well"
        found = "what straight moves leave out of its arcs and turns"
        raise InputError(plan.path, "tolerances", found, bound, "state smaller tolerances") from None
    return Prepared(path, plan, registration, link, arm)


def widened(robot: Robot, cut: Cut | None) -> Robot:
    """The robot whose path tolerances are larger by how far what a tool path describes is from the straight moves in its stead.

    Raises:
        ValueError: the tolerances become larger than any that is allowed.
    """
    if cut is None or not (cut.tolerance_mm or cut.tolerance_deg):
        return robot
    document = robot.model_dump(by_alias=True)
    document["deadband"]["path_tolerance_mm"] += cut.tolerance_mm
    document["deadband"]["path_tolerance_deg"] += cut.tolerance_deg
    return Robot.model_validate(document)


def _check_tool(plan: Loaded[Plan], mounted_u: int) -> None:
    """Refuses a plan made for a tool more than 0.01 mm longer or shorter than the mounted one."""
    planned = plan.value.tool_length_mm
    if planned is not None and not (abs(round(planned * 1e6) - mounted_u) <= TOOL_TOLERANCE_U):
        bound = f"within 0.01 mm of the mounted tool's {mounted_u / 1e6:g} mm"
        raise InputError(
            plan.path, "tool_length_mm", f"{planned:g}", bound, "mount the planned tool or plan again"
        )


def _feed(plan: Loaded[Plan], option: float | None) -> float:
    """The plan's feed, else the option's, else the default; two different ones are refused.

    The controller cuts the whole path at one feed. Of a file with several it is the slowest, so that nothing is cut
    faster than was meant, or the option's, which must be one of those between.
    """
    planned = plan.value.feed_mm_s
    several = plan.value.cut.feed_range_mm_s if plan.value.cut else None
    if planned is None and several is not None:
        return several[0] if option is None else _between(option, *several, plan.path)
    if planned is None:
        return DEFAULT_FEED_MM_S if option is None else option
    if option is not None and option != planned:
        raise InputError(
            plan.path, "feed_mm_s", f"{planned:g}", f"the {option:g} mm/s of --feed-mm-s", "drop the option"
        )
    return planned


def _between(option: float, slowest: float, fastest: float, file: object) -> float:
    """The option, where it is none that the file never uses."""
    if not (slowest <= option <= fastest):
        bound = f"one between the feeds of {file}, {slowest:.6g} and {fastest:.6g} mm/s"
        raise InputError("--feed-mm-s", "", f"{option:g}", bound, "drop the option, or name one of these")
    return option


def _check_link(plan: Loaded[Plan], registration: Loaded[Registration] | None) -> Link:
    """Refuses plan and registration of two different CTs; says whether they are known to be of the same."""
    planned, registered = plan.value.ct_id, registration.value.ct_id if registration else None
    if planned is None or registration is None or registered is None:
        return "not linked"
    if planned != registered:
        bound = f"the plan's {planned!r} ({plan.path})"
        raise InputError(
            registration.path, "ct_id", repr(registered), bound, "use the registration of the plan's CT"
        )
    return "linked"


def _check_age(registration: Loaded[Registration], now: datetime, clock_skew_s: float) -> None:
    """Refuses a registration made in the future."""
    if not ((registration.value.created - now).total_seconds() <= clock_skew_s):
        found = registration.value.created_utc
        bound = f"not later than now ({now:%Y-%m-%dT%H:%M:%SZ}) and clock_skew_s ({clock_skew_s:g} s)"
        remedy = (
            "check the clocks of both computers, and that it is UTC: local time is converted, not relabelled"
        )
        if isinstance(registration, Converted):
            raise InputError(OPTIONS["taken_at"], "", found, bound, remedy)
        raise InputError(registration.path, "created_utc", found, bound, remedy)


def _check_turns(plan: Loaded[Plan], axes: Floats) -> None:
    """Refuses a segment whose tool axis turns so far that its great circle is all but undefined."""
    before, after = axes[:-1], axes[1:]
    # The chord keeps its accuracy near 180 deg, where the cosine does not.
    half = np.arctan2(np.linalg.norm(after - before, axis=1), np.linalg.norm(after + before, axis=1))
    turns = np.degrees(2.0 * half)
    bad = np.flatnonzero(~(turns <= TURN_MAX_DEG))
    if bad.size:
        segment = int(bad[0])
        bound = f"a turn of at most {TURN_MAX_DEG:g} deg between neighbouring poses"
        found = f"a turn of {turns[segment]:.3f} deg"
        raise InputError(plan.path, f"segment {segment}", found, bound, "add poses in between")
