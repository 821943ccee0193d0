"""What the scripts that make the example plans share: cutting moves, rigid transforms, and the files' form.

Pure Python and rounded coordinates, so that the same files come out on every machine. Lengths are mm.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

TOOL_LENGTH_MM: Final = 160.0
FEED_MM_S: Final = 20.0
STEP_MM: Final = 2.7
"""No two poses of a route lie further apart."""
AIR_STEP_DEG: Final = 2.5
"""The tool axis turns by no more from pose to pose while the cutter is out of the bone."""

Vector = tuple[float, float, float]
Matrix = list[list[float]]
Axis = Callable[[Vector], Vector]
"""The tool axis at a place of the cutter."""


class Route:
    """Poses in the order they are visited, in equal steps on each straight move.

    Args:
        step_mm: no step is longer.
    """

    def __init__(self, step_mm: float) -> None:
        self.poses: list[tuple[Vector, Vector]] = []
        self._step_mm = step_mm

    def cut(self, tip: Vector, axis: Axis) -> None:
        """Straight to ``tip``; the tool axis follows the cutter."""
        begin, _ = self.poses[-1]
        steps = math.ceil(math.dist(begin, tip) / self._step_mm)
        for k in range(1, steps + 1):
            place = between(begin, tip, k / steps)
            self.poses.append((place, axis(place)))

    def air(self, tip: Vector, axis: Vector) -> None:
        """Straight to ``tip``, outside the bone; the tool axis turns evenly on the great circle. Or begins there."""
        if not self.poses:
            self.poses.append((tip, axis))
            return
        begin, before = self.poses[-1]
        angle = math.acos(min(1.0, math.fsum(a * b for a, b in zip(before, axis, strict=True))))
        turns = math.degrees(angle) / AIR_STEP_DEG
        steps = max(math.ceil(math.dist(begin, tip) / self._step_mm), math.ceil(turns))
        for k in range(1, steps + 1):
            self.poses.append(
                (between(begin, tip, k / steps), turned_between(before, axis, angle, k / steps))
            )

    def into(self, tip: Vector, axis: Vector, clearance_mm: float) -> None:
        """Over ``tip``, ``clearance_mm`` out along the tool axis, and in along it."""
        self.air(moved(tip, axis, clearance_mm), axis)
        self.cut(tip, lambda _: axis)

    def out(self, clearance_mm: float) -> None:
        """Out along the tool axis."""
        tip, axis = self.poses[-1]
        self.cut(moved(tip, axis, clearance_mm), lambda _: axis)

    def written(self) -> list[list[float]]:
        """The poses as a plan has them: to 0.1 um and 1e-7."""
        return [written(tip, axis) for tip, axis in self.poses]


def between(begin: Vector, end: Vector, part: float) -> Vector:
    """A place on a straight line; the whole of it ends in ``end`` itself."""
    x, y, z = (a * (1.0 - part) + b * part for a, b in zip(begin, end, strict=True))
    return x, y, z


def turned_between(begin: Vector, end: Vector, angle: float, part: float) -> Vector:
    """A direction on the great circle between two that are ``angle`` rad apart."""
    if angle < 1e-9:
        return end
    first, second = math.sin((1.0 - part) * angle), math.sin(part * angle)
    x, y, z = ((first * a + second * b) / math.sin(angle) for a, b in zip(begin, end, strict=True))
    return x, y, z


def moved(place: Vector, direction: Vector, distance_mm: float) -> Vector:
    """A place further along a direction."""
    x, y, z = (p + distance_mm * d for p, d in zip(place, direction, strict=True))
    return x, y, z


def pointing_at(target: Vector) -> Axis:
    """The tool axis whose shank passes through ``target``."""

    def axis(tip: Vector) -> Vector:
        length = math.dist(tip, target)
        x, y, z = ((b - a) / length for a, b in zip(tip, target, strict=True))
        return x, y, z

    return axis


def written(tip: Vector, axis: Vector) -> list[float]:
    """One pose as a plan has it; + 0.0 turns -0.0 into 0.0."""
    return [round(value, 4) + 0.0 for value in tip] + [round(value, 7) + 0.0 for value in axis]


def turned(yaw_deg: float, tilt_deg: float, spin_deg: float, origin: Vector) -> Matrix:
    """The rigid transform that spins about z, tilts z toward +x, turns about z, then moves to ``origin``."""
    (cy, sy), (ct, st), (cs, ss) = (
        (math.cos(math.radians(a)), math.sin(math.radians(a))) for a in (yaw_deg, tilt_deg, spin_deg)
    )
    yaw = [[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]]
    tilt = [[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]]
    spin = [[cs, -ss, 0.0], [ss, cs, 0.0], [0.0, 0.0, 1.0]]
    rotation = times(times(yaw, tilt), spin)
    return [[*row, o] for row, o in zip(rotation, origin, strict=True)] + [[0.0, 0.0, 0.0, 1.0]]


def times(a: Matrix, b: Matrix) -> Matrix:
    """Matrix product."""
    return [
        [math.fsum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)]
        for row in a
    ]


def inverse(rigid: Matrix) -> Matrix:
    """Inverse of a rigid transform."""
    rotation = [list(column) for column in zip(*(row[:3] for row in rigid[:3]), strict=True)]
    back = [-math.fsum(r * row[3] for r, row in zip(line, rigid[:3], strict=True)) for line in rotation]
    return [[*line, b] for line, b in zip(rotation, back, strict=True)] + [[0.0, 0.0, 0.0, 1.0]]


def rounded(matrix: Matrix) -> Matrix:
    """To 1e-9, so that the files are short; + 0.0 turns -0.0 into 0.0."""
    return [[round(value, 9) + 0.0 for value in row] for row in matrix]


@dataclass(frozen=True)
class Bone:
    """A bone in its CT, with the implant planned in it.

    Attributes:
        ct_id: which CT.
        side: of the patient.
        ct_t_implant: the implant's frame in the CT's.
    """

    ct_id: str
    side: str
    ct_t_implant: Matrix

    def plan(self, name: str, implant: str, poses: list[list[float]]) -> dict[str, object]:
        """A plan file's content."""
        return {
            "schema": "cutgate.plan/1",
            "id": name,
            "implant": implant,
            "side": self.side,
            "units": "mm",
            "tool_length_mm": TOOL_LENGTH_MM,
            "feed_mm_s": FEED_MM_S,
            "ct_T_implant": self.ct_t_implant,
            "ct_id": self.ct_id,
            "poses": poses,
        }

    def registration(
        self, name: str, r_t_implant: Matrix, residual_rms_mm: float, created_utc: str
    ) -> dict[str, object]:
        """A registration file's content: the bone lies so that the implant's frame is at ``r_t_implant``."""
        return {
            "schema": "cutgate.registration/1",
            "id": name,
            "R_T_CT": rounded(times(r_t_implant, inverse(self.ct_t_implant))),
            "residual_rms_mm": residual_rms_mm,
            "created_utc": created_utc,
            "ct_id": self.ct_id,
        }


def text(document: dict[str, object]) -> str:
    """JSON with one line a pose or matrix row."""
    body = json.dumps(document, indent=1, allow_nan=False)
    lines: list[str] = []
    for line in body.split("\n"):
        short = line.strip()
        inside = lines and lines[-1].lstrip().startswith("[") and not lines[-1].rstrip(",").endswith("]")
        if inside:
            lines[-1] += short if short.startswith("]") else ("" if lines[-1].endswith("[") else " ") + short
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def write(folder: Path, files: dict[str, dict[str, object]]) -> None:
    """Writes the files, each under its name."""
    for name, document in files.items():
        (folder / name).write_text(text(document), encoding="utf-8")
