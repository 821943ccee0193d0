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

import math
import sys
from pathlib import Path
from typing import Final

from cutgate.examples.plan_files import Bone, Vector, pointing_at, rounded, turned, write

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
    axis = pointing_at(window)(tip)
    return [round(value, 4) for value in tip] + [round(value, 7) for value in axis]


FEMUR: Final = Bone("example-femur-ct", "left", rounded(turned(-35.0, 20.0, 10.0, (-82.5, 41.0, 1210.0))))
FIRST: Final = (720.0, 376.0, 352.0)
"""Where the opening stands first, in the robot frame, mm: too far out and too high."""
SECOND: Final = (673.0, 345.0, 317.0)
"""Where it stands after the bone was moved the way the guidance says, twice as far as it must."""
R_YAW_TILT_SPIN: Final = (60.0, 50.0, 0.0)
"""The shank leans 50 deg from the vertical, toward 60 deg in the floor plane."""


def main(folder: Path) -> None:
    """Writes the three files."""
    poses = [pose(index) for index in range(POSES)]
    first, second = (turned(*R_YAW_TILT_SPIN, opening) for opening in (FIRST, SECOND))
    files = {
        "hip-stem.plan.json": FEMUR.plan("hip-stem-example", "tapered femoral stem, example", poses),
        "registration-first.json": FEMUR.registration("example-first", first, 0.31, "2026-01-15T08:02:11Z"),
        "registration-second.json": FEMUR.registration(
            "example-second", second, 0.28, "2026-01-15T08:21:47Z"
        ),
    }
    write(folder, files)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
