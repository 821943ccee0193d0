"""Which joint of an arm that stands too near to a limit, or beyond it, must be moved, how far and which way.

Rules, in order of the joints; each is told alone, together they cure what is told:

1. Slide, roll and pitch keep deadband and start tolerance of their own limits, as a length or an angle; below
   a vertical tool whose roll is held there is no stop of the pitch.
2. The roll, and the shoulder, stand where a joints frame surely reports them.
3. The elbow answers for the two circles about the column: the wrist centre keeps the deadband from both.
4. With the elbow put right, the shoulder answers for the arcs at its own limits, within half a turn of them.

A move is to whole steps, and a little further than needed. Where no place keeps what must be kept, none is named.

Example:
    ``stroke`` is that of `problem`.

    >>> from cutgate.runtime.verification.bounds.geometry import canonical
    >>> geometry, _ = canonical(stroke)
    >>> standing(geometry, np.array([0.0, 1.2, 250.0, 0.0, 1.0]), 0.0, 0.0, roll_held=False)
    ()
    >>> print(*standing(geometry, np.array([0.0, 1.2, 449.0, 0.0, 1.0]), 0.0, 0.0, roll_held=False))
    the arm stands with q2 at 449.000 mm, its limits are [50, 450] mm, 5 mm (...) must be kept: move q2 by -4.01 mm, to 444.99 mm
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.parameters import ROTATION_DEG_STANDS
from cutgate.runtime.kinematics.arm import elbow_angle
from cutgate.runtime.verification.bounds.enclosures import HALF_TURN
from cutgate.runtime.verification.bounds.geometry import Geometry
from cutgate.runtime.verification.branch import goes
from cutgate.runtime.workspace.planar import distance_to_arc

Range = tuple[float, float]

STEP: Final = 0.01
"""Joints are told to move to whole steps of this, deg or mm ..."""
CLEARANCE: Final = 0.001
"""... and at least so far beyond what must be kept, that no rounding undoes it."""
TRIED: Final = 4000
"""Places of the shoulder that are looked at, between its limits."""


def standing(
    geometry: Geometry, joints: Floats, tolerance_mm: float, tolerance_rad: float, *, roll_held: bool
) -> tuple[str, ...]:
    """A sentence for each joint that stands where no approach may begin; empty if each may stay.

    Args:
        geometry: of the cut.
        joints: reported, finite, rad and mm, shape (5,).
        tolerance_mm: of the start, kept besides the deadband.
        tolerance_rad: likewise, of a turning joint.
        roll_held: whether the cut holds a declared roll: then a vertical tool has no stop below it.
    """
    if geometry.workspace.empty:
        return ()
    keep_mm, keep_rad = geometry.arm_mm + tolerance_mm, geometry.wrist_rad + tolerance_rad
    true = joints * geometry.signs + geometry.offset
    told = {}
    for joint, allowed in _allowed(geometry, true, keep_mm, keep_rad, roll_held=roll_held):
        if allowed is None or not allowed[0] <= allowed[1]:
            kept = _kept(joint, keep_mm, keep_rad)
            told[joint] = f"{_stands(geometry, joint, joints)}: no place of it keeps {kept} from all of them"
        elif not allowed[0] <= true[joint] <= allowed[1]:
            ends = sorted(
                (end - float(geometry.offset[joint])) * float(geometry.signs[joint]) for end in allowed
            )
            kept = _kept(joint, keep_mm, keep_rad)
            told[joint] = (
                f"{_stands(geometry, joint, joints)}, {kept} must be kept: {_move(joint, joints, ends)}"
            )
    return tuple(told[joint] for joint in sorted(told))


def _allowed(
    g: Geometry, true: Floats, keep_mm: float, keep_rad: float, *, roll_held: bool
) -> Iterator[tuple[int, Range | None]]:
    """Where each joint may stand, canonical; None where nowhere. The shoulder comes last, with the elbow put right."""
    yield 2, (float(g.lower[2]) + keep_mm, float(g.upper[2]) - keep_mm)
    low, high = goes(g, 3, ROTATION_DEG_STANDS)
    yield 3, (max(float(g.lower[3]) + keep_rad, low), min(float(g.upper[3]) - keep_rad, high))
    least = float(g.lower[4])
    yield 4, (least if roll_held and least <= 0.0 else least + keep_rad, float(g.upper[4]) - keep_rad)
    elbow = _elbow(g, keep_mm)
    yield 1, elbow
    if elbow is not None:
        yield 0, _shoulder(g, float(true[0]), float(np.clip(true[1], *elbow)), keep_mm)


def _elbow(g: Geometry, keep_mm: float) -> Range | None:
    """Where the elbow keeps the wrist centre off the circles it can reach at its limits."""
    space = g.workspace
    far, near = space.radius(space.q1_lo) - keep_mm, space.radius(space.q1_hi) + keep_mm
    if not near <= far:
        return None
    straight, bent = (float(elbow_angle(np.array([r]), space.a0, space.a1)[0]) for r in (far, near))
    return straight, bent


def _shoulder(g: Geometry, stands: float, elbow: float, keep_mm: float) -> Range | None:
    """Where about the nearest such place the shoulder keeps off the arcs at its limits, as finely as it is tried."""
    (low, high), (least, most) = goes(g, 0, ROTATION_DEG_STANDS), (float(g.lower[0]), float(g.upper[0]))
    low, high = max(low, least), min(high, most)
    if not low <= high:
        return None
    place = min(max(stands, low), high)
    # Beyond half a turn of a limit its arc does not count: nothing farther away has to be tried.
    tried = np.linspace(max(low, place - 2 * HALF_TURN), min(high, place + 2 * HALF_TURN), TRIED)
    tried = np.sort(np.append(tried, place))
    links = np.exp(1j * tried) * (g.workspace.a0 + g.workspace.a1 * np.exp(1j * elbow))
    centres = np.stack((links.real, links.imag), axis=1)
    full = g.workspace.full_revolution
    bad = np.zeros(len(tried), dtype=np.bool_)
    for arc, away in ((g.arcs[2], most - tried), (g.arcs[3], tried - least)):
        bad |= (distance_to_arc(centres, arc) < keep_mm) & ((away <= HALF_TURN) | (not full))
    good = np.flatnonzero(~bad)
    if len(good) == 0:
        return None
    if place == stands and not bad[np.searchsorted(tried, place)]:
        return stands, stands
    first = last = int(good[int(np.argmin(np.abs(tried[good] - place)))])
    while first > 0 and not bad[first - 1]:
        first -= 1
    while last + 1 < len(tried) and not bad[last + 1]:
        last += 1
    return float(tried[first]), float(tried[last])


def _stands(g: Geometry, joint: int, joints: Floats) -> str:
    """Where a joint stands, and between which limits."""
    scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
    sign = float(g.signs[joint])
    low, high = (
        (float(g.workspace.q1_lo), float(g.workspace.q1_hi))
        if joint == 1
        else (g.lower[joint], g.upper[joint])
    )
    ends = sorted((float(end) - float(g.offset[joint])) * sign * scale for end in (low, high))
    frame = joint in {0, 3} and (ends[0] < -ROTATION_DEG_STANDS or ends[1] > ROTATION_DEG_STANDS)
    bound = f", and it is surely reported within +-{ROTATION_DEG_STANDS} deg" if frame else ""
    return (
        f"the arm stands with q{joint} at {float(joints[joint]) * scale:.3f} {unit}, its limits are "
        f"[{ends[0]:.6g}, {ends[1]:.6g}] {unit}{bound}"
    )


def _kept(joint: int, keep_mm: float, keep_rad: float) -> str:
    """What must be kept of a joint's limits: deadband and start tolerance."""
    if joint in {3, 4}:
        return f"{math.degrees(keep_rad):.6g} deg (deadband and start tolerance)"
    where = "" if joint == 2 else " at the wrist centre"
    return f"{keep_mm:.6g} mm{where} (deadband and start tolerance)"


def _move(joint: int, joints: Floats, ends: list[float]) -> str:
    """What to do: by how much, which way, and whereto."""
    scale, unit = (1.0, "mm") if joint == 2 else (math.degrees(1.0), "deg")
    stands, low, high = (float(value) * scale for value in (joints[joint], *ends))
    least, most = math.ceil((low + CLEARANCE) / STEP) * STEP, math.floor((high - CLEARANCE) / STEP) * STEP
    if not least <= most:
        return "let the arm start from elsewhere"
    to = min(max(stands, least), most)
    return f"move q{joint} by {to - stands:+.2f} {unit}, to {to:.2f} {unit}"
