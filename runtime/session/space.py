"""How much space a session takes on the disk until its end: the log, and the raw frames beside it. Pure.

Each heartbeat brings the same frames, and each frame one line and one record; and a record of tracking and of timing,
as often as these may come. All are taken here at their widest.
How long it lasts is estimated from the path before the session opens, so that a disk that is too full is known at
once; and known with the verdict, from the verified trajectory. The interlock asks for twice what is told here
(``permissives.log_space``): frames of others on the bus come out of the second half.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol import candump, records
from cutgate.runtime.audit.records import CanFrame, LogRecord, LoopTiming, Time, TrackingSample
from cutgate.runtime.interlock.state import Job
from cutgate.runtime.kinematics.arm import REVOLUTION
from cutgate.runtime.kinematics.pose import turn_angles
from cutgate.runtime.session.telemetry import PER_SECOND_MAX

FRAMES_PER_HEARTBEAT: Final = 6
"""Both heartbeats, three frames of a joint sample, one of progress; the two sides have one period."""
MESSAGE_BYTES: Final = 9 + 22 + 16
"""What a message has beside its data: length, head, and its entry in the chunk's index."""
CHUNK_BYTES: Final = 2000
"""What a chunk has beside its messages: its head, its checkpoint, an index for each topic, and its entry in the summary."""
FIXED_BYTES: Final = 1_000_000
"""Decisions with their permissives, changes of state, control records, the close record, summary and schemas."""
_LATEST_NS: Final = 9_999_999_999_999_999_999


@dataclass(frozen=True)
class Space:
    """Bytes of log and of raw frames."""

    log: int
    frames: int

    @property
    def total(self) -> int:
        """Of both."""
        return self.log + self.frames


def estimated_s(job: Job) -> float:
    """About how long the arm moves: the cut at its feed, the straight lines of approach and retract, and the joint lines at their speed.

    The joint lines from limit to limit, at most a revolution; the straight lines through the path's whole extent.
    """
    path, limits = records.PathCodes.parse(job.path), records.Limits.parse(job.limits)
    tips, axes = path.decoded(0, len(path))
    lengths_mm = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    turned_mm = path.tool_length_mm * turn_angles(axes[:-1], axes[1:])
    cut_s = float(np.sum(np.maximum(lengths_mm, turned_mm))) / path.feed_mm_s
    travel = np.minimum(limits.q_max - limits.q_min, [REVOLUTION, REVOLUTION, np.inf, REVOLUTION, REVOLUTION])
    line_s = float(np.max(travel / limits.speed)) * 100.0 / job.timing.approach_speed_percent
    way_mm = float(np.linalg.norm(np.ptp(tips, axis=0))) + job.timing.approach_clearance_mm
    return cut_s + 2.0 * (line_s + way_mm / path.feed_mm_s)


def waiting_s(job: Job) -> float:
    """The longest time from the verdict to START, and from the end of the trajectory to the session's."""
    waits = job.deadlines
    until_start_s = waits.operator_wait_s + job.timing.permit_lifetime_s
    answers_s = 4 * waits.reply_timeout_s + 2 * waits.commit_deadline_s
    return until_start_s + answers_s + waits.stop_confirm_s + 2 * job.timing.timeout_s


def space(seconds: float, timing: records.Timing, *, chunk_period_s: float, interface: str) -> Space:
    """What so many seconds take.

    Args:
        seconds: of the session.
        timing: its heartbeat.
        chunk_period_s: so often a chunk of the log is closed, at least.
        interface: the bus's name in the raw frames.
    """
    beats = math.ceil(seconds * 1000.0 / timing.heartbeat_ms)
    frames, samples = beats * FRAMES_PER_HEARTBEAT, min(beats, math.ceil(seconds) * PER_SECOND_MAX)
    line = len(candump.line(_LATEST_NS, interface, 0x7FF, bytes(8)))
    chunks = math.ceil(seconds / chunk_period_s)
    telemetry = _bytes_of(_widest_sample()) + _bytes_of(_widest_timing())
    log = FIXED_BYTES + frames * _bytes_of(_widest()) + samples * telemetry + chunks * CHUNK_BYTES
    return Space(log, FIXED_BYTES // 4 + frames * line)


def _bytes_of(record: LogRecord) -> int:
    """What a record takes in the file."""
    return len(record.encode()) + MESSAGE_BYTES


def _widest_sample() -> TrackingSample:
    """A long record of tracking: every number with all its decimals, of an arm in the midst of a long path."""
    return TrackingSample(
        leg="cut",
        reference_s=1234.1234,
        segment=123456,
        fraction=0.1234,
        q0_deviation_deg=-0.1234,
        q1_deviation_deg=-0.1234,
        q2_deviation_mm=-0.1234,
        q3_deviation_deg=-0.1234,
        q4_deviation_deg=-0.1234,
        tip_distance_mm=0.1234,
        wrist_deviation_mm=0.1234,
        wrist_tolerance_mm=0.1234,
        joint_tolerance_deg=0.1234,
        age_ms=123.12,
    )


def _widest_timing() -> LoopTiming:
    """A long record of timing."""
    return LoopTiming(
        heartbeat_age_ms=123.12,
        timeout_ms=1234.5,
        round_trip_ms=123.12,
        heartbeat_late_ms=123.12,
        longest_gap_ms=123.12,
        commit_ms=123.12,
        waiting_ms=123.12,
        waiting_bytes=1234567,
    )


def _widest() -> CanFrame:
    """The longest record of a frame."""
    return CanFrame(
        stamp=Time.of(_LATEST_NS),
        direction="received",
        id=0x7FF,
        is_rtr=False,
        is_extended=False,
        is_error=False,
        dlc=8,
        data=bytes(8).hex(),
    )
