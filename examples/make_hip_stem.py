"""Writes the hip-stem example: a plan of 2000 poses and two registrations of the same femur.

The cavity receives a femoral stem. Its dimensions, in mm, in the implant frame (origin at the centre of the
opening, z out of the bone along the shank, x medial, y anterior):

- depth 110 along a centreline that bows medially with radius 500, so that its direction turns by 12.6 deg;
- elliptical section, half widths 18 (medial-lateral) by 11 (anterior-posterior) at the opening, 7 by 6.5 at the
  bottom, tapering linearly and turning 12 deg (anteversion) from top to bottom;
- milled with a ball cutter of radius 3: a roughing helix down at half the width, then a finishing helix up along
  the wall, 69 turns each;
- the shank always points at a window 60 above the opening that follows the cutter by a third, so that the long
  cutter clears the rim; the tool axis turns with every turn of the helix and with the bow.

Run ``python examples/make_hip_stem.py [FOLDER]``; the same files come out on every run.
"""

import json
import math
import sys
from pathlib import Path
from typing import Final

DEPTH: Final = 110.0
BOW_RADIUS: Final = 500.0
HALF_WIDTHS_TOP: Final = (18.0, 11.0)
HALF_WIDTHS_BOTTOM: Final = (7.0, 6.5)
ANTEVERSION_DEG: Final = 12.0
CUTTER_RADIUS: Final = 3.0
ROUGH_WIDTH: Final = 0.5
WINDOW_HEIGHT: Final = 60.0
WINDOW_FOLLOWS: Final = 1.0 / 3.0
POSES: Final = 2000
TURNS: Final = 138
"""Of the helix in both passes together."""
FEED_MM_S: Final = 20.0
TOOL_LENGTH_MM: Final = 160.0
CT_ID: Final = "example-femur-ct"

Vector = tuple[float, float, float]
Matrix = list[list[float]]


def section(depth: float, angle: float, width: float) -> Vector:
    """The cutter's centre at ``angle`` of the section at ``depth`` along the centreline, ``width`` of the way out."""
    down = depth / DEPTH
    half = [
        top + (bottom - top) * down - CUTTER_RADIUS
        for top, bottom in zip(HALF_WIDTHS_TOP, HALF_WIDTHS_BOTTOM, strict=True)
    ]
    along, across = width * half[0] * math.cos(angle), width * half[1] * math.sin(angle)
    twist = math.radians(ANTEVERSION_DEG) * down
    e1 = along * math.cos(twist) - across * math.sin(twist)
    e2 = along * math.sin(twist) + across * math.cos(twist)
    bend = depth / BOW_RADIUS
    x = BOW_RADIUS * (1.0 - math.cos(bend)) + e1 * math.cos(bend)
    z = -BOW_RADIUS * math.sin(bend) + e1 * math.sin(bend)
    return (x, e2, z)


def pose(index: int) -> list[float]:
    """Tip and tool axis of one pose: the first half of the path goes down, the second comes up."""
    half = POSES // 2
    down = index if index < half else POSES - 1 - index
    angle = 2.0 * math.pi * TURNS * index / (POSES - 1)
    width = ROUGH_WIDTH if index < half else 1.0
    depth = DEPTH * down / (half - 1)
    tip = section(depth, angle, width)
    rim = section(0.0, angle, width)
    window = (WINDOW_FOLLOWS * rim[0], WINDOW_FOLLOWS * rim[1], WINDOW_HEIGHT)
    axis = [w - t for w, t in zip(window, tip, strict=True)]
    length = math.hypot(*axis)
    return [round(value, 4) for value in tip] + [round(value / length, 7) for value in axis]


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


CT_T_IMPLANT: Final = rounded(turned(-35.0, 20.0, 10.0, (-82.5, 41.0, 1210.0)))
FIRST: Final = (720.0, 376.0, 352.0)
"""Where the opening stands first, in the robot frame, mm: too far out and too high."""
SECOND: Final = (673.0, 345.0, 317.0)
"""Where it stands after the bone was moved the way the guidance says, twice as far as it must."""
R_YAW_TILT_SPIN: Final = (60.0, 50.0, 0.0)
"""The shank leans 50 deg from the vertical, toward 60 deg in the floor plane."""


def plan() -> dict[str, object]:
    """The plan file's content."""
    return {
        "schema": "cutgate.plan/1",
        "id": "hip-stem-example",
        "implant": "tapered femoral stem, example",
        "side": "left",
        "units": "mm",
        "tool_length_mm": TOOL_LENGTH_MM,
        "feed_mm_s": FEED_MM_S,
        "ct_T_implant": CT_T_IMPLANT,
        "ct_id": CT_ID,
        "poses": [pose(index) for index in range(POSES)],
    }


def registration(name: str, opening: Vector, residual_rms_mm: float, created_utc: str) -> dict[str, object]:
    """A registration file's content: the femur lies so that the opening's centre is at ``opening``."""
    r_t_implant = turned(*R_YAW_TILT_SPIN, opening)
    return {
        "schema": "cutgate.registration/1",
        "id": name,
        "R_T_CT": rounded(times(r_t_implant, inverse(CT_T_IMPLANT))),
        "residual_rms_mm": residual_rms_mm,
        "created_utc": created_utc,
        "ct_id": CT_ID,
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


def main(folder: Path) -> None:
    """Writes the three files."""
    files = {
        "hip-stem.plan.json": plan(),
        "registration-first.json": registration("example-first", FIRST, 0.31, "2026-01-15T08:02:11Z"),
        "registration-second.json": registration("example-second", SECOND, 0.28, "2026-01-15T08:21:47Z"),
    }
    for name, document in files.items():
        (folder / name).write_text(text(document), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
