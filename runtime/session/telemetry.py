"""What the log holds of a session by the second: how the arm keeps to the path, and the loop to its time.

Everything here was measured by others, for their own ends; nothing is decided by it. Pure.
"""

import math
from collections import deque
from typing import Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats
from cutgate.protocol.cycle import MS_PER_S, Cycle
from cutgate.protocol.link import Link
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.records import LoopTiming, TrackingSample
from cutgate.runtime.interlock.state import Interlock, Job
from cutgate.runtime.interlock.tracking import Nearest, ReferenceTrajectory
from cutgate.runtime.kinematics.arm import TrueArm

PER_SECOND_MAX: Final = 50
"""Records of one topic in any second, however short the heartbeat is."""
NEAR_S: Final = 0.25
"""Of the reference trajectory, before and behind the nearest place: there the path that is nearest to the tip is sought."""
_MM, _DEG, _MS, _PART = 4, 4, 2, 4
"""Decimals that are kept: a fiftieth of what a frame of joints is rounded by, and less."""


class RateLimit:
    """So many in any second, and no more. The time is passed in, s; it never goes back."""

    def __init__(self, per_second: int = PER_SECOND_MAX) -> None:
        self._last: deque[float] = deque(maxlen=per_second)

    def allows(self, now_s: float) -> bool:
        """Whether one more may come now; if so, it counts."""
        last = self._last
        if len(last) == last.maxlen and not now_s - last[0] >= 1.0:
            return False
        last.append(now_s)
        return True


class Telemetry:
    """Records of ``/tracking`` and ``/timing``, as often as they may come."""

    def __init__(self) -> None:
        self._tracking, self._timing = RateLimit(), RateLimit()
        self._longest_gap_s = 0.0
        self._tip: tuple[Job, MeasuredTip] | None = None
        """Of the session's job."""

    def tracking(self, before: Interlock, after: Interlock, now_s: float) -> TrackingSample | None:
        """Of a step of the interlock; None where no sample was held against the path in it, or too many come.

        A sample that leads to another phase, as one does that stops the arm, is never one too many.

        Args:
            before: the interlock before the step.
            after: and behind it.
            now_s: the loop's clock.
        """
        monitor, nearest = before.tracking, after.nearest
        if monitor is None or nearest is None or nearest is before.nearest:
            return None
        if not self._tracking.allows(now_s) and after.phase is before.phase:
            return None
        if self._tip is None or self._tip[0] is not after.job:
            self._tip = after.job, MeasuredTip(after.job)
        return tracking_sample(monitor.trajectory, nearest, self._tip[1], now_s - after.measured_s)

    def cycle(self, gap_s: float) -> None:
        """A cycle of the loop begins, so long after the one before."""
        self._longest_gap_s = max(self._longest_gap_s, gap_s)

    def timing(self, link: Link, cycle: Cycle, log: AuditLog) -> LoopTiming | None:
        """Of a cycle that has sent a heartbeat; None where too many come."""
        now_s = cycle.now_s
        if not self._timing.allows(now_s):
            return None
        gap_s, self._longest_gap_s = self._longest_gap_s, 0.0
        return LoopTiming(
            heartbeat_age_ms=_ms(now_s - (link.expires_s - link.timeout_s)),
            timeout_ms=_ms(link.timeout_s),
            round_trip_ms=None if link.round_trip_s is None else _ms(link.round_trip_s),
            heartbeat_late_ms=_ms(cycle.late_s),
            longest_gap_ms=_ms(gap_s),
            commit_ms=None if log.commit_s is None else _ms(log.commit_s),
            waiting_ms=_ms(log.oldest_pending_s(now_s)),
            waiting_bytes=log.waiting_bytes,
        )


class MeasuredTip:
    """Where the tip is by measured joints, with the arm's calibration.

    Args:
        job: the session's, whose calibration and tool are those that were verified.
    """

    def __init__(self, job: Job) -> None:
        path, calibration = records.PathCodes.parse(job.path), records.Calibration.parse(job.calibration)
        self._arm = TrueArm(
            calibration.upper_mm + calibration.upper_link_error_mm,
            calibration.forearm_mm + calibration.forearm_link_error_mm,
            1.0 if path.elbow == "right" else -1.0,
            calibration.joint_offset,
            calibration.slide_tilt,
        )
        self._tool_mm = records.Tool.parse(job.tool).length_mm

    def distance_mm(self, nearest: Nearest, trajectory: ReferenceTrajectory) -> float:
        """Of the tip by the measured joints from the way of the reference tip near the nearest place.

        Of that way counts what the sample is within tolerance of, at most NEAR_S to both sides; else the nearest place alone.
        """
        at_s = nearest.time_s
        first_s = min(max(nearest.earliest_s, at_s - NEAR_S), at_s)
        last_s = max(min(nearest.latest_s, at_s + NEAR_S), at_s)
        _, joints = trajectory.between(first_s, last_s)
        tips, _ = self._arm.pose(np.concatenate((nearest.joints[None], joints)), self._tool_mm)
        return _from_line(tips[0], tips[1:])


def tracking_sample(
    trajectory: ReferenceTrajectory, nearest: Nearest, tip: MeasuredTip, age_s: float
) -> TrackingSample:
    """The record of one sample.

    Args:
        trajectory: what it was held against.
        nearest: the place of it that is nearest.
        tip: of this arm.
        age_s: at most so old is the sample; infinite where nothing proves it.
    """
    leg, segment, fraction = trajectory.place(nearest.time_s)
    off = nearest.joints - trajectory.joints_at(nearest.time_s)
    q0, q1, _, q3, q4 = np.degrees(off).tolist()
    return TrackingSample(
        leg=leg,
        reference_s=round(nearest.time_s, _PART),
        segment=segment,
        fraction=None if fraction is None else round(fraction, _PART),
        q0_deviation_deg=round(q0, _DEG),
        q1_deviation_deg=round(q1, _DEG),
        q2_deviation_mm=round(float(off[2]), _MM),
        q3_deviation_deg=round(q3, _DEG),
        q4_deviation_deg=round(q4, _DEG),
        tip_distance_mm=round(tip.distance_mm(nearest, trajectory), _MM),
        wrist_deviation_mm=round(nearest.off_mm * nearest.near_mm, _MM),
        wrist_tolerance_mm=round(nearest.near_mm, _MM),
        joint_tolerance_deg=round(math.degrees(nearest.near_rad), _DEG),
        age_ms=_ms(age_s) if math.isfinite(age_s) else None,
    )


def _from_line(point: Floats, line: Floats) -> float:
    """Distance of a point, shape (3,), from the lines between two or more others in their order, shape (k, 3)."""
    chord, rest = line[1:] - line[:-1], point - line[:-1]
    square = np.einsum("ij,ij->i", chord, chord)
    along = np.einsum("ij,ij->i", rest, chord) / np.where(square > 0.0, square, np.inf)
    off = rest - np.clip(along, 0.0, 1.0)[:, None] * chord
    return float(np.linalg.norm(off, axis=1).min())


def _ms(seconds: float) -> float:
    return round(seconds * MS_PER_S, _MS)
