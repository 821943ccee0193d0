"""Whether what was verified is likely what was meant: a file in another unit, direction or frame can be sound in itself.

A warning says what looks wrong, before anybody moves a bone for it. Some must be confirmed, one by one, before a permit.
No verdict depends on them: what is admissible stays so, and what is not as well.

Rules, in order; what is not asked of a path is not warned of:

1. The cut's box is at least 1 mm across and no larger than the arm's reach: else its file may be in another unit.
2. Every turning joint may go beyond +-6.28 deg: else its limits may be in radians.
3. The wrist's deadband is at least 0.1 deg: smaller, it may be in radians.
4. With a registration: it moves the CT by at least 10 mm, and its residual and each of its check points are within the
   site's bounds; it has as many check points as the site asks for.
5. With a registration and an inadmissible verdict: read otherwise (inverted, transposed, in metres, with x and y
   reversed) it does not make the path admissible.
6. With a proposed move (`cautions_of_move`): it is at most 150 mm long and turns the bone by at most 15 deg.

Example:
    ``stroke`` is that of `problem`.

    >>> from cutgate.runtime.verification import certified
    >>> cautions(stroke, certified.verify(stroke), None)
    ()
    >>> metres = replace(stroke, tips_mm=stroke.tips_mm / 1000.0)
    >>> [caution.code for caution in cautions(metres, certified.verify(metres), None)]
    ['CUT_TINY']
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from cutgate.protocol.arrays import Floats, Vector
from cutgate.runtime.kinematics.landmarks import NONE_ASKED, CheckPoints
from cutgate.runtime.kinematics.pose import transform_poses
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.decide import decide
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Boundary, Verdict

CUT_LEAST_MM: Final = 1.0
CT_LEAST_MM: Final = 10.0
RADIANS_MOST: Final = 2.0 * math.pi
"""Limits of a joint in degrees that are smaller than a revolution in radians are hardly meant."""
DEADBAND_LEAST_DEG: Final = 0.1
"""Of the wrist; 5 deg in radians is less."""
MOVE_MOST_MM: Final = 150.0
TURN_MOST_DEG: Final = 15.0
_FRAME: Final = "check units, direction and frame (LPS or RAS) of the registration first"
MM_PER_M: Final = 1000.0
_ROTARY: Final = (0, 1, 3, 4)


@dataclass(frozen=True)
class Caution:
    """What looks wrong, with what was found and what is usual.

    Attributes:
        confirm: whether the operator must confirm it, by its code, before a permit.
    """

    code: str
    text: str
    value: float
    bound: float
    confirm: bool = False


@dataclass(frozen=True)
class Extent:
    """Where the cut lies, in the robot frame: the box of its tips, the first of them, and the tool's tilt from +z."""

    min_mm: Vector
    max_mm: Vector
    entry_tip_mm: Vector
    tilt_deg: tuple[float, float]

    @property
    def size_mm(self) -> float:
        """The box's diagonal."""
        return math.dist(self.min_mm, self.max_mm)


def extent(problem: Problem) -> Extent:
    """Of the poses; the tip's path between two of them is straight and stays in their box."""
    tilt = np.degrees(np.arctan2(np.hypot(problem.axes[:, 0], problem.axes[:, 1]), problem.axes[:, 2]))
    return Extent(
        _vector(problem.tips_mm.min(axis=0)),
        _vector(problem.tips_mm.max(axis=0)),
        _vector(problem.tips_mm[0]),
        (float(tilt.min()), float(tilt.max())),
    )


def place(problem: Problem, boundary: Boundary) -> Vector | None:
    """The tip at a boundary's worst place, mm; None where it has none."""
    if boundary.segment is None or boundary.fraction is None:
        return None
    begin, end = problem.tips_mm[boundary.segment : boundary.segment + 2]
    return _vector(begin + boundary.fraction * (end - begin))


@dataclass(frozen=True)
class Placed:
    """How the bone was registered.

    Attributes:
        matrix: from CT to robot coordinates, shape (4, 4), mm.
        residual_mm: root mean square of what the registration left over.
        residual_max_mm: what the site allows of it; None where it sets no bound.
        check_points: how far each check point is off, and what the site asks of them.
    """

    matrix: Floats
    residual_mm: float
    residual_max_mm: float | None = None
    check_points: CheckPoints = NONE_ASKED


def cautions(problem: Problem, verdict: Verdict, placed: Placed | None) -> tuple[Caution, ...]:
    """What looks wrong with the files.

    Args:
        problem: as it was verified.
        verdict: what was found.
        placed: None where no registration is given.
    """
    found = [_size(problem), _radians(problem), _tiny_deadband(problem)]
    if placed is not None:
        found += [
            _near_the_origin(placed.matrix),
            _residual(placed),
            _missing_check_points(placed.check_points),
            _check_point_off(placed.check_points),
            *cautions_of_reading(problem, verdict, placed.matrix),
        ]
    return tuple(one for one in found if one is not None)


def described(
    document: dict[str, Any],
    problem: Problem,
    verdict: Verdict,
    found: Sequence[Caution],
    placed: Placed | None,
) -> dict[str, Any]:
    """A verdict's document with where the cut lies, the tip at each worst place, the check points, and what looks wrong."""
    boundaries = {
        name: {**entry, "tip_mm": _listed(place(problem, verdict.boundaries[name]))}
        for name, entry in document["boundaries"].items()
    }
    return {
        **document,
        "boundaries": boundaries,
        "extent": {name: _listed(value) for name, value in asdict(extent(problem)).items()},
        "check_points": [one._asdict() for one in placed.check_points.points] if placed else [],
        "warnings": [asdict(caution) for caution in found],
    }


def _listed(values: tuple[float, ...] | None) -> list[float] | None:
    return None if values is None else list(values)


def _size(problem: Problem) -> Caution | None:
    size, reach = extent(problem).size_mm, problem.arm.upper_mm + problem.arm.forearm_mm
    if size < CUT_LEAST_MM:
        text = f"the whole cut is {size:.3g} mm in size: check whether its file is in mm"
        return Caution("CUT_TINY", text, size, CUT_LEAST_MM, confirm=True)
    if size > reach:
        text = f"the cut is {size:.0f} mm in size, more than the arm's reach of {reach:.0f} mm: check whether its file is in mm"
        return Caution("CUT_HUGE", text, size, reach, confirm=True)
    return None


def _radians(problem: Problem) -> Caution | None:
    """Each joint on its own: files are edited line by line, and one joint may have no limits to speak of."""
    largest = {
        q: math.degrees(max(abs(float(problem.lower[q])), abs(float(problem.upper[q])))) for q in _ROTARY
    }
    small = {f"q{q}": most for q, most in largest.items() if most <= RADIANS_MOST}
    if not small:
        return None
    most = max(small.values())
    text = f"{', '.join(small)} may not leave +-{most:.3g} deg: check whether the limits are in radians"
    return Caution("LIMITS_IN_RADIANS", text, most, RADIANS_MOST, confirm=True)


def _tiny_deadband(problem: Problem) -> Caution | None:
    found = math.degrees(problem.deadband.wrist_rad)
    if found >= DEADBAND_LEAST_DEG:
        return None
    text = f"the wrist's deadband is {found:.3g} deg only: check whether it is in radians"
    return Caution("DEADBAND_IN_RADIANS", text, found, DEADBAND_LEAST_DEG, confirm=True)


def _near_the_origin(registration: Floats) -> Caution | None:
    length = float(np.linalg.norm(registration[:3, 3]))
    if length >= CT_LEAST_MM:
        return None
    text = f"the registration moves the CT by {length:.3g} mm only: right for a plan in robot coordinates, else {_FRAME}"
    return Caution("CT_TRANSLATION_SMALL", text, length, CT_LEAST_MM)


def _residual(placed: Placed) -> Caution | None:
    residual, bound = placed.residual_mm, placed.residual_max_mm
    if bound is None or residual <= bound:
        return None
    text = f"the registration's residual of {residual:g} mm is over the site's {bound:g} mm: register the bone again"
    return Caution("REGISTRATION_RESIDUAL", text, residual, bound)


def _missing_check_points(asked: CheckPoints) -> Caution | None:
    if not asked.missing:
        return None
    there = len(asked.points)
    text = f"the registration has {there} check points, the site asks for {asked.least}: touch {asked.missing} more"
    return Caution("CHECK_POINTS_MISSING", text, float(there), float(asked.least))


def _check_point_off(asked: CheckPoints) -> Caution | None:
    """The worst of them; the others stand beside it."""
    worst = asked.worst
    if worst is None or not asked.outside:
        return None
    others = f", {len(asked.outside)} of {len(asked.points)} are off" if len(asked.outside) > 1 else ""
    text = (
        f"check point {worst.id} is {worst.residual_mm:g} mm off, more than {asked.tolerance_mm:g} mm{others}: {_FRAME}, "
        "then touch the point again, or register the bone again"
    )
    return Caution("CHECK_POINT_OFF", text, worst.residual_mm, asked.tolerance_mm)


def _readings(registration: Floats) -> dict[str, tuple[str, Floats]]:
    """Other transforms that somebody may have meant who wrote this one, shape (4, 4), by their warnings' codes."""
    transposed, scaled, flipped = registration.copy(), registration.copy(), registration.copy()
    transposed[:3, :3] = registration[:3, :3].T
    scaled[:3, 3] *= MM_PER_M
    flipped[:3, :2] *= -1.0
    return {
        "REGISTRATION_INVERTED": (
            "read in the other direction, from robot to CT",
            _inverse(registration),
        ),
        "REGISTRATION_TRANSPOSED": ("with its rotation transposed", transposed),
        "REGISTRATION_IN_METRES": ("with its translation in metres", scaled),
        "REGISTRATION_FRAME": ("with the CT's x and y reversed, LPS for RAS", flipped),
    }


def cautions_of_reading(problem: Problem, verdict: Verdict, registration: Floats) -> tuple[Caution, ...]:
    """Whether a path that is inadmissible as it is placed would be admissible if its registration is read otherwise."""
    if verdict.admissible:
        return ()
    violated = float(sum(boundary.violated for boundary in verdict.boundaries.values()))
    to_ct = _inverse(registration)
    found = []
    for code, (words, meant) in _readings(registration).items():
        if decide(_moved(problem, meant @ to_ct)).admissible:
            text = f"{words} the registration makes the path admissible: {_FRAME}"
            found.append(Caution(code, text, violated, 0.0))
    return tuple(found)


def _inverse(registration: Floats) -> Floats:
    return np.asarray(np.linalg.inv(registration), dtype=np.float64)


def _moved(problem: Problem, by: Floats) -> Problem:
    """The path somewhere else, shape (4, 4)."""
    tips_mm, axes = transform_poses(by, problem.tips_mm, problem.axes)
    return replace(problem, tips_mm=tips_mm, axes=axes, branch=None)


def cautions_of_move(guidance: Guidance | None) -> tuple[Caution, ...]:
    """What looks wrong with a move that is proposed."""
    if guidance is None or guidance.translation_mm is None:
        return ()
    length, turn = math.hypot(*guidance.translation_mm), abs(guidance.yaw_deg)
    if length > MOVE_MOST_MM:
        text = f"the move would be {length:.0f} mm long: {_FRAME}"
        return (Caution("MOVE_LARGE", text, length, MOVE_MOST_MM),)
    if turn > TURN_MOST_DEG:
        text = f"the bone would be turned by {turn:.1f} deg: {_FRAME}"
        return (Caution("TURN_LARGE", text, turn, TURN_MOST_DEG),)
    return ()


def _vector(values: Floats) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
