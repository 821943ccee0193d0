"""Writes the femoral example: a plan of 2794 poses, 7001 mm, for the femoral component of a knee, and a registration.

The component sits on five flat cuts and two pegs. Dimensions, in mm, in the implant frame (origin in the middle of
the distal cut, z distal, out of the bone, y anterior, x medial: a right knee):

- seen from the side, a box: distal cut 24 long (y from -12 to 12), a chamfer of 45 deg to either side of it, 10 by
  10, the posterior cut 22 high and parallel to z, the anterior cut 30 high, leaning 5 deg forward;
- 64 wide; anterior cut 46 wide; behind the distal cut two condyles of 22, 20 apart;
- peg holes 36 apart on the distal cut, diameter 8, 14 deep;
- milled with a ball cutter of radius 3, whose centre the poses are: each cut once 3.5 above it, in lines 4 apart, and
  once on it, in lines 2.1 apart; all lines run across the knee and 3 beyond its edges. The peg holes are helices
  with a pitch of 1.4.

The knee is bent and opened in front, so the shank may lean forward but hardly back. On each cut it points at a place
250 out, in a direction of its own: 60, 35, 5, -15 and -6 deg from z toward y, from the anterior cut to the posterior
ones. The tool axis turns along every line and by 75 deg from cut to cut, and always leads away from the cut's plane;
the finished bone is convex, so the shank never meets it. Peg holes are cut along z.

Between the cuts the tool goes out along its axis, past all bone, turns, and comes in along its axis; so the path
begins and ends.

Run ``python examples/make_femoral.py [FOLDER]``; the same files come out on every run.
"""

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cutgate.examples.plan_files import (
    STEP_MM,
    Axis,
    Bone,
    Route,
    Vector,
    pointing_at,
    rounded,
    turned,
    write,
)

CUTTER_RADIUS: Final = 3.0
ROUGH_ABOVE: Final = 3.5
ROUGH_LINES: Final = 4.0
FINE_LINES: Final = 2.1
BEYOND_EDGE: Final = 3.0
TARGET_DISTANCE: Final = 250.0
PEG_X: Final = 18.0
PEG_RADIUS: Final = 4.0
PEG_DEPTH: Final = 14.0
PEG_PITCH: Final = 1.4
PEG_STEPS: Final = 6
"""Poses in one revolution of a peg hole's helix."""


@dataclass(frozen=True)
class Cut:
    """One flat cut, from its first edge to its second, seen from the side.

    Attributes:
        first: y and z of the edge that is cut first.
        height: to the other edge.
        normal_deg: direction out of the bone, from z toward y; the height is measured 90 deg behind it.
        lean_deg: direction of the tool axis in the middle, from z toward y.
        spans: from where to where each part of the cut reaches across the knee.
        clearance: how far the tool goes out along its axis before and after.
    """

    first: tuple[float, float]
    height: float
    normal_deg: float
    lean_deg: float
    spans: tuple[tuple[float, float], ...]
    clearance: float

    def place(self, x: float, along: float, above: float) -> Vector:
        """The place ``along`` the height and ``above`` the cut."""
        s, c = math.sin(math.radians(self.normal_deg)), math.cos(math.radians(self.normal_deg))
        return (x, self.first[0] - along * c + above * s, self.first[1] + along * s + above * c)

    @property
    def axis(self) -> Axis:
        """The tool axis on this cut: toward one place out of the wound."""
        _, y, z = self.place(0.0, self.height / 2, CUTTER_RADIUS)
        lean = math.radians(self.lean_deg)
        return pointing_at((0.0, y + TARGET_DISTANCE * math.sin(lean), z + TARGET_DISTANCE * math.cos(lean)))


WHOLE, FRONT, CONDYLES = ((-32.0, 32.0),), ((-23.0, 23.0),), ((-32.0, -10.0), (10.0, 32.0))
FLANGE: Final = math.radians(5.0)
FRONT_EDGE: Final = (22.0 + 30.0 * math.sin(FLANGE), -10.0 - 30.0 * math.cos(FLANGE))
ANTERIOR: Final = Cut(FRONT_EDGE, 30.0, 85.0, 60.0, FRONT, 40.0)
FRONT_CHAMFER: Final = Cut((22.0, -10.0), math.hypot(10.0, 10.0), 45.0, 35.0, WHOLE, 40.0)
DISTAL: Final = Cut((12.0, 0.0), 24.0, 0.0, 5.0, WHOLE, 40.0)
BACK_CHAMFER: Final = Cut((-12.0, 0.0), math.hypot(10.0, 10.0), -45.0, -15.0, CONDYLES, 40.0)
POSTERIOR: Final = Cut((-22.0, -10.0), 22.0, -90.0, -6.0, CONDYLES, 60.0)


def lines(route: Route, cut: Cut, span: tuple[float, float]) -> None:
    """One part of a cut: forth in coarse lines above it and back in fine ones on it, each in turn to either side."""
    sides = [span[0] - BEYOND_EDGE, span[1] + BEYOND_EDGE]
    axis = cut.axis
    first = cut.place(sides[0], 0.0, CUTTER_RADIUS + ROUGH_ABOVE)
    route.into(first, axis(first), cut.clearance)
    for above, apart, back in ((ROUGH_ABOVE, ROUGH_LINES, False), (0.0, FINE_LINES, True)):
        count = math.ceil(cut.height / apart)
        for k in range(count + 1):
            along = cut.height * (count - k if back else k) / count
            for x in sides:
                route.cut(cut.place(x, along, CUTTER_RADIUS + above), axis)
            sides.reverse()
    route.out(cut.clearance)


def peg(route: Route, x: float) -> None:
    """A peg hole: a helix down to its bottom, once round there, and out."""
    radius = PEG_RADIUS - CUTTER_RADIUS
    up: Vector = (0.0, 0.0, 1.0)
    bottom = CUTTER_RADIUS - PEG_DEPTH
    turns = math.ceil((CUTTER_RADIUS - bottom) / PEG_PITCH)
    route.into((x + radius, 0.0, CUTTER_RADIUS), up, DISTAL.clearance)
    for k in range(1, PEG_STEPS * (turns + 1) + 1):
        angle = 2.0 * math.pi * k / PEG_STEPS
        down = min(1.0, k / (PEG_STEPS * turns))
        height = CUTTER_RADIUS + (bottom - CUTTER_RADIUS) * down
        route.cut((x + radius * math.cos(angle), radius * math.sin(angle), height), lambda _: up)
    route.out(DISTAL.clearance + PEG_DEPTH)


def poses() -> list[list[float]]:
    """The whole path."""
    route = Route(STEP_MM)
    for cut in (ANTERIOR, FRONT_CHAMFER, DISTAL):
        lines(route, cut, *cut.spans)
    for x in (-PEG_X, PEG_X):
        peg(route, x)
    for cut in (BACK_CHAMFER, POSTERIOR):
        for span in cut.spans:
            lines(route, cut, span)
    return route.written()


FEMUR: Final = Bone(
    "example-knee-femur-ct", "right", rounded(turned(176.0, 174.0, 3.0, (88.5, -12.0, -402.0)))
)
"""The CT's axes point to the patient's left, back and head: distal is down, anterior is forward."""
R_YAW_TILT_SPIN: Final = (150.0, 80.0, 90.0)
"""The thigh lies 10 deg from level, its distal end up and toward 150 deg in the floor plane, the front of the knee up."""
ORIGIN: Final = (640.0, 240.0, 190.0)
"""Where the middle of the distal cut stands in the robot frame."""


def main(folder: Path) -> None:
    """Writes the two files."""
    placed = turned(*R_YAW_TILT_SPIN, ORIGIN)
    files = {
        "femoral.plan.json": FEMUR.plan("femoral-example", "femoral component, example", poses()),
        "registration-femoral.json": FEMUR.registration(
            "example-femoral", placed, 0.33, "2026-01-22T09:14:05Z"
        ),
    }
    write(folder, files)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
