"""Writes the tibial example: a plan of 1188 poses, 2988 mm, for the tibial tray of a knee, and a registration.

The tray lies on a flat cut and is held by a stem and two keels. Dimensions, in mm, in the implant frame (origin in
the middle of the stem on the flat cut, z proximal, out of the bone, y anterior, x lateral: a right knee):

- flat cut: an ellipse, half widths 36 (medial-lateral) by 24 (anterior-posterior), cut off straight behind at y -18;
- stem hole: diameter 13, 40 deep;
- two keel slots, 6 wide and 12 deep, from the stem hole backward to either side, 30 deg behind the x axis, their
  ends 20 from its middle;
- milled with a flat end mill of radius 3; the poses are the middle of its end face. The 9 of bone above the cut go in
  two layers, in lines along x that are 4 apart and run 3 beyond the edge; then once round, 3 beyond it. The stem
  hole is a helix with a pitch of 1.5. The keel slots are cut forth and back, 2 deeper each time.

The tool axis is z throughout: the cut is flat, and all of it can be reached from above. Between its parts the tool
goes out along its axis, past all bone, and comes in along it; so the path begins and ends.

Run ``python examples/make_tibial.py [FOLDER]``; the same files come out on every run.
"""

import math
import sys
from pathlib import Path
from typing import Final

from cutgate.examples.plan_files import STEP_MM, Bone, Route, Vector, rounded, turned, write

HALF_WIDTHS: Final = (36.0, 24.0)
BACK: Final = -18.0
LAYERS: Final = (4.5, 0.0)
LINES: Final = 4.0
BEYOND_EDGE: Final = 3.0
RIM_POSES: Final = 72
"""On the round of the edge, over the whole ellipse."""
CUTTER_RADIUS: Final = 3.0
STEM_RADIUS: Final = 6.5
STEM_DEPTH: Final = 40.0
STEM_PITCH: Final = 1.5
STEM_STEPS: Final = 9
"""Poses in one revolution of the stem hole's helix."""
KEEL_DEG: Final = 30.0
KEEL_END: Final = 20.0
KEEL_DEPTH: Final = 12.0
KEEL_LAYER: Final = 2.0
CLEARANCE: Final = 35.0
"""Over the flat cut, before and after each part."""
UP: Final[Vector] = (0.0, 0.0, 1.0)


def up(_tip: Vector) -> Vector:
    """The tool axis, everywhere."""
    return UP


def half_width(y: float) -> float:
    """Of the flat cut along x."""
    return HALF_WIDTHS[0] * math.sqrt(max(0.0, 1.0 - (y / HALF_WIDTHS[1]) ** 2))


def flat(route: Route) -> None:
    """The flat cut: the first layer from back to front, the next from front to back, in lines to either side in turn."""
    front = HALF_WIDTHS[1] - LINES / 2.0
    count = math.ceil((front - BACK) / LINES)
    rows = [BACK + (front - BACK) * k / count for k in range(count + 1)]
    sides = [-1.0, 1.0]
    route.into((-half_width(BACK) - BEYOND_EDGE, BACK, LAYERS[0]), UP, CLEARANCE - LAYERS[0])
    for height in LAYERS:
        for y in rows:
            for side in sides:
                route.cut((side * (half_width(y) + BEYOND_EDGE), y, height), up)
            sides.reverse()
        rows.reverse()
    route.out(CLEARANCE - LAYERS[-1])


def rim(route: Route) -> None:
    """Once round the flat cut, from the left of its back to the right."""
    across, along = HALF_WIDTHS[0] + BEYOND_EDGE, HALF_WIDTHS[1] + BEYOND_EDGE
    begin = math.asin((BACK - BEYOND_EDGE) / along)
    sweep = math.pi - 2.0 * begin
    steps = math.ceil(RIM_POSES * sweep / (2.0 * math.pi))
    angles = [math.pi - begin - sweep * k / steps for k in range(steps + 1)]
    tips: list[Vector] = [(across * math.cos(a), along * math.sin(a), 0.0) for a in angles]
    route.into(tips[0], UP, CLEARANCE)
    for tip in (*tips[1:], tips[0]):
        route.cut(tip, up)
    route.out(CLEARANCE)


def stem(route: Route) -> None:
    """The stem hole: a helix down to its bottom, once round there, and out."""
    radius = STEM_RADIUS - CUTTER_RADIUS
    turns = math.ceil(STEM_DEPTH / STEM_PITCH)
    route.into((radius, 0.0, 0.0), UP, CLEARANCE)
    for k in range(1, STEM_STEPS * (turns + 1) + 1):
        angle = 2.0 * math.pi * k / STEM_STEPS
        depth = STEM_DEPTH * min(1.0, k / (STEM_STEPS * turns))
        route.cut((radius * math.cos(angle), radius * math.sin(angle), -depth), up)
    route.out(CLEARANCE + STEM_DEPTH)


def keel(route: Route, side: float) -> None:
    """A keel slot, forth and back, each time deeper."""
    angle = math.radians(KEEL_DEG)
    places = [
        (side * r * math.cos(angle), -r * math.sin(angle)) for r in (STEM_RADIUS, KEEL_END - CUTTER_RADIUS)
    ]
    route.into((*places[0], 0.0), UP, CLEARANCE)
    for k in range(1, round(KEEL_DEPTH / KEEL_LAYER) + 1):
        for place in places:
            route.cut((*place, -KEEL_LAYER * k), up)
        places.reverse()
    route.out(CLEARANCE + KEEL_DEPTH)


def poses() -> list[list[float]]:
    """The whole path."""
    route = Route(STEP_MM)
    flat(route)
    rim(route)
    stem(route)
    for side in (-1.0, 1.0):
        keel(route, side)
    return route.written()


TIBIA: Final = Bone("example-knee-tibia-ct", "right", rounded(turned(171.0, 4.0, 6.0, (91.0, -8.5, -431.0))))
"""The CT's axes point to the patient's left, back and head: proximal is up, anterior is forward."""
R_YAW_TILT_SPIN: Final = (-30.0, 45.0, 90.0)
"""The shin leans 45 deg from the vertical, its knee end up and toward -30 deg in the floor plane, its front up."""
ORIGIN: Final = (610.0, 190.0, 170.0)
"""Where the middle of the stem stands in the robot frame."""


def main(folder: Path) -> None:
    """Writes the two files."""
    placed = turned(*R_YAW_TILT_SPIN, ORIGIN)
    files = {
        "tibial.plan.json": TIBIA.plan("tibial-example", "tibial tray, example", poses()),
        "registration-tibial.json": TIBIA.registration(
            "example-tibial", placed, 0.29, "2026-01-22T09:41:30Z"
        ),
    }
    write(folder, files)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
