"""What a session decided on, as it is drawn: the path by its clearance, the workspace, the worst places, the plan. Pure."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.audit.records import Time
from cutgate.runtime.commands.foxglove.arm import BONE, ROBOT
from cutgate.runtime.commands.foxglove.schemas import (
    BoundaryClearances,
    FoxgloveLine,
    FoxgloveLineType,
    FoxglovePosesInFrame,
    FoxgloveSceneUpdate,
)
from cutgate.runtime.commands.foxglove.shapes import colour, entity, label, line, pose, with_z_along
from cutgate.runtime.commands.reach_page import CIVIDIS
from cutgate.runtime.commands.verify_page import BAD, NONE, shades, steps
from cutgate.runtime.commands.verify_scene import LETTERS, MEANINGS, Scene, Worst
from cutgate.runtime.verification.problem import Problem

VIOLATED: Final = "#c23b00"
"""As on the page of a verdict."""
UNDEFINED: Final = "#c3c8d0"
_EDGE: Final = colour("#565d68")
_DEADBAND: Final = colour("#9aa3ad", 0.7)
_BONE: Final = colour("#0b57d0", 0.6)
_KEPT: Final = colour("#16181d")
_BAD: Final = colour(VIOLATED)
POSES_MAX: Final = 5000
"""Of the plan, as a viewer draws an arrow for each; of a longer one every second, third, and so on, and the last."""
HEIGHT_MAX_MM: Final = 10_000.0
"""A slide without an end is drawn up to here."""


@dataclass(frozen=True, eq=False)
class DrawnDecision:
    """A verdict's scene in three dimensions.

    Attributes:
        problem: what was verified.
        scene: what is drawn of its verdict.
        place: of the bone in the robot's frame, shape (4, 4), mm; None without a registration.
    """

    problem: Problem
    scene: Scene
    place: Floats | None

    # ------------------------------------------------------------ the path

    @property
    def wrist_mm(self) -> Floats:
        """The wrist centre's way in the robot's frame, at the scene's points, shape (n, 3)."""
        path = self.scene.path
        return self.in_robot(path.above, path.side[:, 1])

    @property
    def tips_mm(self) -> Floats:
        """The tip's way there, shape (n, 3)."""
        return _between(self.problem.tips_mm, self.scene.path.pose)

    def clearances(self, segment: int, fraction: float) -> BoundaryClearances | None:
        """Of the piece of the path with this place in it, as its colour shows it: the least that its ends have.

        Args:
            segment: of the path; None comes back for one that it does not have.
            fraction: of the segment, 0..1.
        """
        scene = self.scene
        if not 0 <= segment < len(self.problem.tips_mm) - 1:
            return None
        piece = int(np.searchsorted(scene.path.pose, segment + fraction, "right")) - 1
        piece = min(max(piece, 0), len(scene.path.pose) - 2)
        units = {worst.name: worst.unit for worst in scene.worst}
        found: dict[str, Any] = {}
        for name, value, required in zip(scene.names, scene.values[:, piece], scene.required, strict=True):
            if math.isfinite(value):
                found[f"{name}_{units[name]}"] = _down(float(value))
            found[f"{name}_deadband_{units[name]}"] = float(required)
        least = float(scene.ratios[piece])
        return BoundaryClearances(
            segment=segment,
            fraction=fraction,
            least_in_deadbands=_down(least) if math.isfinite(least) else None,
            **found,
        )

    # ------------------------------------------------------------ the messages

    def drawn(self, at: Time) -> FoxgloveSceneUpdate:
        """Path, workspace, worst places and the bone's own path, as one message: a viewer shows the last of a topic."""
        scene = self.scene
        verdict = (("verdict", scene.verdict), ("plan", scene.title))
        scale = steps(scene)
        legend = (*verdict, ("colours", f"clearance in deadbands, from {scale[0]:g} to {scale[-1]:g}"))
        things = [
            entity("path/tip", ROBOT, at, told=legend, lines=self._coloured(self.tips_mm, 4.0)),
            entity("path/wrist", ROBOT, at, told=legend, lines=self._coloured(self.wrist_mm, 2.5)),
            entity("workspace", ROBOT, at, told=verdict, lines=self._workspace()),
        ]
        things += [self._worst(worst, at) for worst in scene.worst if worst.above is not None]
        if self.place is not None:
            own = (_between(self.problem.tips_mm, scene.path.pose) - self.place[:3, 3]) @ self.place[:3, :3]
            things.append(entity("bone/path", BONE, at, lines=(line(own, _BONE, 1.0),)))
        return FoxgloveSceneUpdate(deletions=(), entities=tuple(things))

    def plan(self, at: Time) -> FoxglovePosesInFrame:
        """The planned poses of the tool: its tip, and z along the tool toward the wrist; at most POSES_MAX and the last."""
        last = len(self.problem.tips_mm) - 1
        shown = np.append(np.arange(0, last, -(-last // POSES_MAX)), last)
        tips, axes = self.problem.tips_mm[shown], self.problem.axes[shown]
        poses = tuple(pose(tip, with_z_along(axis)) for tip, axis in zip(tips, axes, strict=True))
        return FoxglovePosesInFrame(timestamp=at, frame_id=ROBOT, poses=poses)

    def _coloured(self, way_mm: Floats, pixels: float) -> list[FoxgloveLine]:
        """A line list for each colour; what violates last, so that it is seen."""
        numbers = shades(self.scene)
        return [
            _pieces(way_mm, np.flatnonzero(numbers == number), _code(number), pixels)
            for number in sorted(set(numbers.tolist()), key=lambda number: -number)
        ]

    def _workspace(self) -> list[FoxgloveLine]:
        """The boundary of the wrist centre at both ends of the slide, its corners upright, and the deadband inside of it."""
        scene = self.scene
        low, high = (min(max(end, -HEIGHT_MAX_MM), HEIGHT_MAX_MM) for end in scene.heights)
        out = []
        for _, arc in scene.arcs:
            out += [line(self.in_robot(arc, np.full(len(arc), end)), _EDGE, 1.5) for end in (low, high)]
            for corner in (arc[0], arc[-1]):
                upright = self.in_robot(np.stack((corner, corner)), np.array([low, high]))
                out.append(line(upright, _EDGE, 1.0))
        inside = (low + scene.arm_mm, high - scene.arm_mm)
        for part in scene.deadbands if inside[0] < inside[1] else ():
            out += [line(self.in_robot(part, np.full(len(part), end)), _DEADBAND, 1.0) for end in inside]
        return out

    def _worst(self, worst: Worst, at: Time) -> Any:
        """A letter at a worst place, and what it means when it is pointed at."""
        assert worst.above is not None and worst.side is not None  # noqa: S101, PT018 - asked before
        place = self.in_robot(np.array([worst.above]), np.array([worst.side[1]]))[0]
        sign = "!" if worst.violated else ""
        text = f"{LETTERS[worst.name]}{sign} {worst.value} of {worst.required:g}"
        told = (
            ("boundary", f"{worst.name}: {MEANINGS[worst.name]}"),
            ("clearance, proved", worst.value),
            ("required", f"{worst.required:g} {worst.unit}"),
            ("", "violated" if worst.violated else "kept"),
        )
        shown = label(place, text, _BAD if worst.violated else _KEPT)
        return entity(f"worst/{worst.name}", ROBOT, at, told=told, texts=(shown,))

    def in_robot(self, above_mm: Floats, heights_mm: Floats) -> Floats:
        """Wrist centres from slide coordinates, which lean with the slide, shapes (n, 2) and (n,), to the robot's, (n, 3)."""
        leaning = above_mm + heights_mm[:, None] * self.problem.calibration.slide_tilt
        return np.column_stack((leaning, heights_mm))


def _between(rows: Floats, at: Floats) -> Floats:
    """Rows at fractional numbers, shapes (n, 3) and (m,), linear in between."""
    first = np.clip(np.floor(at).astype(np.int64), 0, len(rows) - 2)
    out: Floats = rows[first] + (at - first)[:, None] * (rows[first + 1] - rows[first])
    return out


def _pieces(way_mm: Floats, which: Ints, code: str, pixels: float) -> FoxgloveLine:
    """These pieces of a way; no point is written twice."""
    ends = np.stack((which, which + 1), axis=1).ravel()
    used, indices = np.unique(ends, return_inverse=True)
    return line(way_mm[used], colour(code), pixels, indices, FoxgloveLineType.LINE_LIST)


def _code(number: int) -> str:
    return {NONE: UNDEFINED, BAD: VIOLATED}.get(number) or CIVIDIS[number]


def _down(value: float) -> float:
    """Never shown as more than it is."""
    return math.floor(round(value * 1e4, 4)) / 1e4
