"""A session by the second: joints, clearance, tracking, and the time of loop, bus and disk. Pure.

Read once, a record at a time; what is kept does not grow with the log.
"""

from typing import Any, Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.audit.container.stored import Stored
from cutgate.runtime.audit.records import LoopTiming, TrackingSample
from cutgate.runtime.commands.foxglove.arm import ShownArm
from cutgate.runtime.commands.foxglove.schemas import BoundaryClearances, JointValues
from cutgate.runtime.commands.foxglove.streams import Known, Streams
from cutgate.runtime.commands.report.curves import Curves
from cutgate.runtime.commands.report.place import ALONG_MAX, LIMITS, LINKS, RANGES, arm_points, ranges

DEGREES: Final = ("q0", "q1", "q3", "q4")
COORDINATES: Final = tuple(f"{link} {axis}" for link in LINKS for axis in "xyz")
_JOINTS: Final = ("q0_deg", "q1_deg", "q2_mm", "q3_deg", "q4_deg")


class OverTime:
    """What the plots along time show, and where the arm was."""

    def __init__(self, known: Known, start_ns: int) -> None:
        self._known = known
        self._streams = Streams(known, 0)
        self._start_ns = start_ns
        self._turning, self._slide = Curves(DEGREES), Curves(("q2",))
        self._ranges = Curves(RANGES)
        self._clearance = Curves(("nearest limit",))
        self._deviation = Curves(("wrist centre, at most", "tip"))
        self._bus = Curves(("age of the heartbeat echoed last", "round trip"))
        self._loop = Curves(("longest gap", "heartbeat late", "log made durable in", "log waits"))
        self._arm = Curves(COORDINATES)
        self._tolerance_mm: float | None = None
        self._timeout_ms: float | None = None

    def take(self, message: Stored) -> None:
        """The next record of the log, of any topic."""
        at_s = (message.log_time - self._start_ns) / 1e9
        for _, viewed in self._streams.take(message):
            if isinstance(viewed, JointValues):
                self._joints(at_s, viewed)
            elif isinstance(viewed, BoundaryClearances):
                least = viewed.least_in_deadbands
                self._clearance.add(at_s, {"nearest limit": None if least is None else min(least, ALONG_MAX)})
            elif isinstance(viewed, TrackingSample):
                self._tolerance_mm = viewed.wrist_tolerance_mm
                self._deviation.add(
                    at_s, {"wrist centre, at most": viewed.wrist_deviation_mm, "tip": viewed.tip_distance_mm}
                )
            elif isinstance(viewed, LoopTiming):
                self._timing(at_s, viewed)

    def _timing(self, at_s: float, timing: LoopTiming) -> None:
        self._timeout_ms = timing.timeout_ms
        self._bus.add(
            at_s,
            {
                "age of the heartbeat echoed last": timing.heartbeat_age_ms,
                "round trip": timing.round_trip_ms,
            },
        )
        self._loop.add(
            at_s,
            {
                "longest gap": timing.longest_gap_ms,
                "heartbeat late": timing.heartbeat_late_ms,
                "log made durable in": timing.commit_ms,
                "log waits": timing.waiting_ms,
            },
        )

    def _joints(self, at_s: float, joints: JointValues) -> None:
        values = [getattr(joints, name.replace("_", "_measured_")) for name in _JOINTS]
        self._turning.add(at_s, dict(zip(DEGREES, (*values[:2], *values[3:]), strict=True)))
        self._slide.add(at_s, {"q2": values[2]})
        if self._known.arm is not None:
            self._moved(at_s, self._known.arm, np.where(np.arange(5) == 2, values, np.radians(values)))

    def _moved(self, at_s: float, arm: ShownArm, joints: Floats) -> None:
        self._ranges.add(at_s, ranges(arm, joints))
        self._arm.add(at_s, dict(zip(COORDINATES, arm_points(arm, joints).ravel().tolist(), strict=True)))

    def arm(self) -> dict[str, Any] | None:
        """The arm's points, moment by moment, and every turn of them; None where no joints were measured."""
        if not len(self._arm):
            return None
        document = self._arm.document(2)
        columns = [series["values"] for series in document["series"]]
        return {"t": document["x"], "points": [value for row in zip(*columns, strict=True) for value in row]}

    def plots(self) -> list[dict[str, Any]]:
        """Those along time that show something."""
        tolerance = _line("tolerance", self._tolerance_mm)
        timeout = _line("time-out", self._timeout_ms)
        deadband = _line("deadband", 1.0)
        near = f"Clearance where it cut, in deadbands (at most {ALONG_MAX:g} are shown)"
        found: tuple[tuple[str, str, str, Curves, list[dict[str, Any]]], ...] = (
            ("clearance", near, "deadbands", self._clearance, deadband),
            ("deviation", "Distance of the arm from its verified way", "mm", self._deviation, tolerance),
            ("ranges", "Measured joints between their limits", "%", self._ranges, LIMITS),
            ("turning", "Measured joints that turn", "deg", self._turning, []),
            ("slide", "Measured slide", "mm", self._slide, []),
            ("bus", "Heartbeats", "ms", self._bus, timeout),
            ("loop", "The runtime's loop and the disk", "ms", self._loop, []),
        )
        return [
            {
                "id": name,
                "title": title,
                "axis": "s",
                "unit": unit,
                "lines": lines,
                **curves.document(3, down=curves is self._clearance),
            }
            for name, title, unit, curves, lines in found
            if len(curves)
        ]


def _line(name: str, value: float | None) -> list[dict[str, Any]]:
    return [] if value is None else [{"name": name, "value": value}]
