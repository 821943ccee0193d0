"""Writes the tool paths of the tests: simultaneous five-axis milling of an impeller, tip and tool axis at every pose.

No more than the kind of path is borrowed from real ones, which belong to others: a channel between two blades, and an
operation over the whole wheel in which the tool axis goes round by almost a turn. Dimensions, in mm, z along the
wheel's axis toward the inlet:

- hub: a quarter of an ellipse from radius 14 at z 32, where the flow enters along the axis, to radius 42 at z 0,
  where it leaves across it;
- 7 blades that wrap 50 deg backward from inlet to outlet; between two of them the cutter has 24 deg of room;
- the tool axis leans from z by 74 deg at the inlet and 43 deg at the outlet, outward from the wheel's axis and by up
  to 12 deg aside, away from the nearer blade;
- blade-channel.csv: one channel, 7 lines along it, to and fro, of 71 poses each;
- whole-wheel.csv: all channels one after the other, 3 lines of 25 poses each; from channel to channel the tool goes
  25 out along its axis, over the blade, and in along its axis.

``python tests/data/make_tool_paths.py [FOLDER]``; the same files come out on every run.
"""

import math
import sys
from pathlib import Path
from typing import Final

from cutgate.examples.plan_files import Route, Vector

INLET: Final = (14.0, 32.0)
OUTLET_RADIUS: Final = 42.0
BLADES: Final = 7
WRAP_DEG: Final = 50.0
ROOM_DEG: Final = 24.0
LEAN_DEG: Final = (74.0, 43.0)
ASIDE_DEG: Final = 12.0
CLEARANCE: Final = 25.0


def pose(channel: int, along: float, across: float) -> tuple[Vector, Vector]:
    """Tip and tool axis; ``along`` from inlet 0 to outlet 1, ``across`` from blade -1 to blade 1."""
    bend = along * math.pi / 2.0
    radius = OUTLET_RADIUS - (OUTLET_RADIUS - INLET[0]) * math.cos(bend)
    height = INLET[1] * (1.0 - math.sin(bend))
    angle = math.radians(360.0 / BLADES * channel + WRAP_DEG * along + ROOM_DEG / 2.0 * across)
    lean = math.radians(LEAN_DEG[0] + (LEAN_DEG[1] - LEAN_DEG[0]) * along)
    toward = angle - math.radians(ASIDE_DEG * across)
    tip = (radius * math.cos(angle), radius * math.sin(angle), height)
    axis = (math.sin(lean) * math.cos(toward), math.sin(lean) * math.sin(toward), math.cos(lean))
    return tip, axis


def mill(route: Route, channel: int, lines: int, steps: int) -> None:
    """A channel: lines from blade to blade, every second one from outlet to inlet."""
    route.into(*pose(channel, 0.0, -1.0), CLEARANCE)
    places = [(k if line % 2 == 0 else steps - k, line) for line in range(lines) for k in range(steps + 1)]
    for k, line in places[1:]:
        route.poses.append(pose(channel, k / steps, 2.0 * line / (lines - 1) - 1.0))
    route.out(CLEARANCE)


def text(route: Route) -> str:
    """The route as a tool path file; + 0.0 turns -0.0 into 0.0."""
    rows = (",".join(f"{round(value, 5) + 0.0:.5f}" for value in (*tip, *axis)) for tip, axis in route.poses)
    return "\n".join(("x,y,z,i,j,k", *rows)) + "\n"


def main(folder: Path) -> None:
    """Writes the two files."""
    channel, wheel = Route(0.8), Route(2.5)
    mill(channel, 0, 7, 70)
    for number in range(BLADES):
        mill(wheel, number, 3, 24)
    for name, route in (("blade-channel", channel), ("whole-wheel", wheel)):
        (folder / f"{name}.csv").write_text(text(route), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
