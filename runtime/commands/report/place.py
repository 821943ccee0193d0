"""What of a session has a place in the robot's frame: path, workspace, worst places and the arm. Pure."""

import math
from typing import Any, Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.commands.foxglove.arm import ShownArm
from cutgate.runtime.commands.foxglove.decided import HEIGHT_MAX_MM, DrawnDecision
from cutgate.runtime.commands.reach_page import CIVIDIS
from cutgate.runtime.commands.report.curves import Curves
from cutgate.runtime.commands.verify_page import shades, steps
from cutgate.runtime.commands.verify_scene import LETTERS, MEANINGS, Worst
from cutgate.runtime.interlock.tracking import ReferenceTrajectory
from cutgate.runtime.kinematics.pose import lengths

LINKS: Final = ("slide", "elbow", "wrist", "tip")
"""What the arm's points are, from the column on."""
RANGES: Final = tuple(f"q{joint} of its range" for joint in range(5))
LIMITS: Final = [{"name": "lower limit", "value": 0.0}, {"name": "upper limit", "value": 100.0}]
ALONG_MAX: Final = 10.0
"""Deadbands: of a clearance along the path no more is shown."""


def place_document(decision: DrawnDecision, arm: ShownArm | None) -> dict[str, Any]:
    """Path, colours, workspace and worst places; mm in the robot's frame, points as flat lists of three."""
    scene = decision.scene
    return {
        "wrist": _flat(decision.wrist_mm),
        "tip": _flat(decision.tips_mm),
        "pose": [round(pose, 3) for pose in scene.path.pose.tolist()],
        "length": [round(length, 1) for length in tip_lengths(decision).tolist()],
        "shade": shades(scene).tolist(),
        "palette": list(CIVIDIS),
        "steps": steps(scene),
        "ratio": [_down(ratio) for ratio in scene.ratios.tolist()],
        "limiting": _limiting(decision),
        "workspace": [_flat(points) for points in _workspace(decision)],
        "deadband": [_flat(points) for points in _deadbands(decision)],
        "worst": _together([_worst(decision, one) for one in scene.worst if one.above is not None], decision),
        "tool_mm": arm.tool_mm if arm else None,
    }


def tip_lengths(decision: DrawnDecision) -> Floats:
    """Length of the tip's path from its start to each point of the scene, mm, shape (n,)."""
    steps_mm = lengths(np.diff(decision.tips_mm, axis=0))
    return np.concatenate(([0.0], np.cumsum(steps_mm)))


def arm_points(arm: ShownArm, joints: Floats) -> Floats:
    """Slide, elbow, wrist centre and tip, mm, shape (4, 3), of reported joints, rad and mm, shape (5,)."""
    q = joints + arm.offset
    slide = q[2] * np.array([*arm.tilt, 1.0])
    elbow = slide + arm.upper_mm * _level(q[0])
    wrist = elbow + arm.forearm_mm * _level(q[0] + q[1])
    axis = math.sin(q[4]) * _level(q[0] + q[1] + q[3]) + math.cos(q[4]) * np.array([0.0, 0.0, 1.0])
    return np.stack((slide, elbow, wrist, wrist - arm.tool_mm * axis))


def along_the_path(decision: DrawnDecision) -> dict[str, Any]:
    """Clearance of each boundary along the path, in its deadbands: a plot as those along time."""
    scene = decision.scene
    curves = Curves(scene.names)
    at = tip_lengths(decision)
    for piece in range(len(scene.path.pose) - 1):
        ratios = scene.values[:, piece] / scene.required
        curves.add(
            float(at[piece]),
            {name: min(float(ratio), ALONG_MAX) for name, ratio in zip(scene.names, ratios, strict=True)},
        )
    return {
        "id": "along",
        "title": f"Clearance along the path, in deadbands (at most {ALONG_MAX:g} are shown)",
        "axis": "mm",
        "unit": "deadbands",
        "lines": [{"name": "deadband", "value": 1.0}],
        **curves.document(3, down=True),
    }


def joints_along_the_path(
    decision: DrawnDecision, arm: ShownArm, trajectory: ReferenceTrajectory
) -> dict[str, Any]:
    """The joints of the verified way at each point of the path, between their limits: a plot as those along time."""
    curves = Curves(RANGES)
    last = trajectory.segments - 1
    for length, pose in zip(tip_lengths(decision).tolist(), decision.scene.path.pose.tolist(), strict=True):
        segment = min(int(pose), last)
        joints = trajectory.joints_at(trajectory.time_of(segment, pose - segment))
        curves.add(length, ranges(arm, joints))
    return {
        "id": "joints",
        "title": "Planned joints along the path, between their limits",
        "axis": "mm",
        "unit": "%",
        "lines": LIMITS,
        **curves.document(2),
    }


def ranges(arm: ShownArm, joints: Floats) -> dict[str, float]:
    """Where each joint stands between its limits, %, by reported joints, rad and mm, shape (5,)."""
    low, high = arm.bounds
    with np.errstate(divide="ignore", invalid="ignore"):  # a joint without a range has no part of it
        parts = 100.0 * (joints - low) / (high - low)
    return dict(zip(RANGES, parts.tolist(), strict=True))


def _level(angle: float) -> Floats:
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _flat(points: Floats) -> list[float]:
    return [round(value, 2) for value in points.ravel().tolist()]


def _down(value: float) -> float | None:
    """Never shown as more than it is."""
    return math.floor(value * 1e3) / 1e3 if math.isfinite(value) else None


def _limiting(decision: DrawnDecision) -> list[str]:
    """The boundary that each piece of the path is nearest to, in deadbands."""
    scene = decision.scene
    if not scene.names:
        return [""] * (len(scene.path.pose) - 1)
    return [scene.names[k] for k in scene.limiting.tolist()]


def _ends(decision: DrawnDecision, inward_mm: float) -> tuple[float, float]:
    low, high = (min(max(end, -HEIGHT_MAX_MM), HEIGHT_MAX_MM) for end in decision.scene.heights)
    return low + inward_mm, high - inward_mm


def _workspace(decision: DrawnDecision) -> list[Floats]:
    """Boundary of the wrist centre, at both ends of the slide, and its corners upright."""
    out = []
    for _, arc in decision.scene.arcs:
        low, high = _ends(decision, 0.0)
        out += [decision.in_robot(arc, np.full(len(arc), end)) for end in (low, high)]
        out.append(decision.in_robot(np.stack((arc[0], arc[0])), np.array([low, high])))
    return out


def _deadbands(decision: DrawnDecision) -> list[Floats]:
    """What the deadband leaves of it."""
    low, high = _ends(decision, decision.scene.arm_mm)
    parts = decision.scene.deadbands if low < high else ()
    return [decision.in_robot(part, np.full(len(part), end)) for part in parts for end in (low, high)]


TOGETHER: Final = 0.12
"""Parts of the path's size: worst places that lie nearer to each other have one label."""


def _together(worst: list[dict[str, Any]], decision: DrawnDecision) -> list[dict[str, Any]]:
    """Those that lie together under one label, the violated first."""
    near_mm = TOGETHER * float(np.ptp(decision.wrist_mm, axis=0).max())
    groups: list[dict[str, Any]] = []
    for one in sorted(worst, key=lambda entry: not entry["violated"]):
        group = next((g for g in groups if math.dist(g["place"], one["place"]) <= near_mm), None)
        if group is None:
            groups.append(one)
        else:
            group["letter"] += f" {one['letter']}"
            group["text"] += f"; {one['text']}"
    return groups


def _worst(decision: DrawnDecision, worst: Worst) -> dict[str, Any]:
    assert worst.above is not None and worst.side is not None  # noqa: S101, PT018 - asked before
    place = decision.in_robot(np.array([worst.above]), np.array([worst.side[1]]))
    return {
        "letter": LETTERS[worst.name] + ("!" if worst.violated else ""),
        "name": worst.name,
        "text": f"{worst.name} ({MEANINGS[worst.name]}): {worst.value} of {worst.required:g} {worst.unit} required",
        "violated": worst.violated,
        "place": _flat(place),
    }
