"""The course of a session by the second: joints, clearance, tracking, and the time of loop, bus and disk. Pure.

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
from cutgate.runtime.commands.report.curves import ROWS_MAX, Curves
from cutgate.runtime.commands.report.place import ALONG_MAX, arm_points

DEGREES: Final = ("q0", "q1", "q3", "q4")
RANGES: Final = (
    "q0 of its range",
    "q1 of its range",
    "q2 of its range",
    "q3 of its range",
    "q4 of its range",
)
_JOINTS: Final = ("q0_deg", "q1_deg", "q2_mm", "q3_deg", "q4_deg")


class Course:
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
        self._arm: list[tuple[float, Floats]] = []
        self._every = 1
        self._samples = 0
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
        low, high = arm.bounds
        with np.errstate(divide="ignore", invalid="ignore"):  # a joint without a range has no part of it
            parts = 100.0 * (joints - low) / (high - low)
        self._ranges.add(at_s, dict(zip(RANGES, parts.tolist(), strict=True)))
        if self._samples % self._every == 0:
            self._arm.append((at_s, arm_points(arm, joints)))
            if len(self._arm) > ROWS_MAX:  # half as often from here on, and before
                self._arm, self._every = self._arm[::2], 2 * self._every
        self._samples += 1

    def arm(self) -> dict[str, Any] | None:
        """The arm's points, moment by moment; None where no joints were measured."""
        if not self._arm:
            return None
        return {
            "t": [round(at_s, 3) for at_s, _ in self._arm],
            "points": [round(value, 1) for _, points in self._arm for value in points.ravel().tolist()],
        }

    def plots(self) -> list[dict[str, Any]]:
        """Those along time that show something."""
        tolerance = _line("tolerance", self._tolerance_mm)
        timeout = _line("time-out", self._timeout_ms)
        deadband = _line("deadband", 1.0)
        near = f"Clearance where it cut, in deadbands (at most {ALONG_MAX:g} are shown)"
        limits = _line("lower limit", 0.0) + _line("upper limit", 100.0)
        found: tuple[tuple[str, str, str, Curves, list[dict[str, Any]]], ...] = (
            ("clearance", near, "deadbands", self._clearance, deadband),
            ("deviation", "Distance of the arm from its verified way", "mm", self._deviation, tolerance),
            ("ranges", "Measured joints between their limits", "%", self._ranges, limits),
            ("turning", "Measured joints that turn", "deg", self._turning, []),
            ("slide", "Measured slide", "mm", self._slide, []),
            ("bus", "Heartbeats", "ms", self._bus, timeout),
            ("loop", "The runtime's loop and the disk", "ms", self._loop, []),
        )
        return [
            {"id": name, "title": title, "axis": "s", "unit": unit, "lines": lines, **curves.document(3)}
            for name, title, unit, curves, lines in found
            if len(curves)
        ]


def _line(name: str, value: float | None) -> list[dict[str, Any]]:
    return [] if value is None else [{"name": name, "value": value}]
