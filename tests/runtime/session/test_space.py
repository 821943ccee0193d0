"""Space for the log: what a session has written is never more than what was reserved for it, at any heartbeat."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.protocol import candump, records
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.space import FIXED_BYTES, Space, estimated_s, space, waiting_s
from cutgate.runtime.verification.steps import finished
from tests.runtime.session.pair import STANDS, check_of
from tests.runtime.session.test_session import first_frames

HEARTBEATS_MS = (5, 10, 20, 50, 100)


def timed(pair, heartbeat_ms):
    """The pair's job at another heartbeat."""
    timing = replace(pair.job.timing, heartbeat_ms=heartbeat_ms, timeout_ms=max(100, 4 * heartbeat_ms))
    return replace(pair.job, timing=timing)


def sizes(pair):
    """Bytes that stand in the two files now, with everything that waited to be written."""
    pair.log.commit(None)
    pair.log.events()
    return pair.log.path.stat().st_size, pair.log.candump_path.stat().st_size


@pytest.mark.parametrize("heartbeat_ms", HEARTBEATS_MS)
def test_a_moving_arm_writes_no_more_than_was_told_of_its_seconds_and_little_less(pair, heartbeat_ms):
    """Ten seconds of the cut, chunk by chunk. What is told is 1 to 10 % more, and twice that is reserved."""
    pair.cycle_s = heartbeat_ms / 1000 / 4
    pair.power_up(time_scale=0.01)
    pair.begin(timed(pair, heartbeat_ms)).to(Phase.CUTTING)
    pair.run(2.0)
    before, began_s = sizes(pair), pair.clock()
    pair.run(10.0)
    assert pair.phase is Phase.CUTTING
    written = Space(*(after - once for after, once in zip(sizes(pair), before, strict=True)))
    seconds = pair.clock() - began_s
    told = space(seconds, pair.job.timing, chunk_period_s=pair.log.hand_over_after_s, interface="vcan0")
    log, frames = told.log - FIXED_BYTES, told.frames - FIXED_BYTES // 4
    assert 0.85 * log <= written.log <= log, (written.log / log, heartbeat_ms)
    assert 0.95 * frames <= written.frames <= frames, (written.frames / frames, heartbeat_ms)


@pytest.mark.parametrize("heartbeat_ms", HEARTBEATS_MS)
def test_a_whole_session_stays_within_half_of_what_is_reserved(pair, heartbeat_ms):
    """From the verdict to the last byte, close record, index and summary included."""
    pair.cycle_s = min(pair.cycle_s, heartbeat_ms / 1000 / 4)
    pair.begin(timed(pair, heartbeat_ms)).to(Phase.ADMITTED, Phase.NONCE_PERMIT)
    before, began_s, needed = sum(sizes(pair)), pair.clock(), pair.state.log.needed_bytes
    assert pair.end(limit_s=60.0) is Phase.DONE
    seconds = pair.clock() - began_s
    assert pair.close().closed
    told = space(seconds, pair.job.timing, chunk_period_s=pair.log.hand_over_after_s, interface="vcan0")
    assert (
        pair.log.path.stat().st_size + pair.log.candump_path.stat().st_size - before <= told.total <= needed
    )
    assert pair.state.log.reserved_bytes >= 2 * needed


def test_the_reservation_follows_the_verified_trajectory_on_the_clock_of_the_plant(pair):
    pair.power_up(time_scale=0.01)
    asked = {}
    pair.begin()
    asked["estimate"] = pair.state.log.needed_bytes
    pair.to(Phase.PERMITTED)
    asked["known"] = pair.state.log.needed_bytes
    verdict = pair.state.verdict
    assert verdict is not None
    assert verdict.trajectory is not None
    seconds = 100 * verdict.trajectory.end_s + waiting_s(pair.job)
    told = space(seconds, pair.job.timing, chunk_period_s=pair.log.hand_over_after_s, interface="vcan0")
    assert asked["known"] == told.total > asked["estimate"]
    assert pair.state.log.reserved_bytes >= 2 * told.total


def test_a_permit_waits_for_the_space_that_is_known_to_be_needed(pair):
    """The slow plant needs more than was estimated; the disk does not answer any more."""
    pair.power_up(time_scale=0.01)
    pair.begin().to(Phase.COLLECTING)
    pair.disk.answers = False
    pair.to(Phase.ADMITTED)
    pair.run(1.0)
    assert pair.phase is Phase.ADMITTED
    assert pair.state.log.reserved_bytes == 0
    pair.disk.answers = True
    assert pair.to(Phase.PERMITTED)


def test_a_permit_waits_for_no_other_space_where_no_more_is_needed_than_was_estimated(pair, monkeypatch):
    """The estimate was exact, and what it asked for is reserved; the disk does not answer any more."""
    own = finished(check_of(pair.job, pair.files.robot.value).steps(1, STANDS)).verdict
    seconds = own.trajectory.end_s / pair.options.time_scale
    monkeypatch.setattr("cutgate.runtime.session.loop.estimated_s", lambda _job: seconds)
    pair.begin().to(Phase.COLLECTING)
    reserved, needed = pair.state.log.reserved_bytes, pair.state.log.needed_bytes
    pair.disk.answers = False
    pair.to(Phase.AUTHORISING_PERMIT)
    assert (pair.state.log.reserved_bytes, pair.state.log.needed_bytes) == (reserved, needed)


def test_a_disk_without_space_for_the_raw_frames_admits_nothing(pair):
    def trouble(operation, count):
        if operation == "reserve" and count % 3 == 1:  # the log, the raw frames, HEAD
            raise OSError(28, "no")

    pair.disk.trouble = trouble
    assert pair.end() is Phase.REFUSED
    assert "space reserved for the audit log" in pair.state.reason
    assert any("No space left" in note for note in pair.notes.notes)
    assert not first_frames(pair, records.Permit)


def test_the_estimate_covers_the_slowest_approach(pair):
    seconds = {}
    for percent in (100, 1):
        timing = replace(pair.job.timing, approach_speed_percent=percent)
        seconds[percent] = estimated_s(replace(pair.job, timing=timing))
    cycle_s = math.radians(340) / 2.0  # the roll of the example, from limit to limit at its speed
    assert seconds[1] - seconds[100] == pytest.approx(2 * 99 * cycle_s)


def test_the_estimate_covers_the_trajectory_that_is_verified(pair):
    pair.to(Phase.PERMITTED)
    verdict = pair.state.verdict
    assert verdict is not None
    assert verdict.trajectory is not None
    assert estimated_s(pair.job) >= verdict.trajectory.end_s


def test_a_path_that_only_turns_takes_its_time(pair):
    """The tip stands still while the axis turns by a right angle: as long as the tool's length along the quarter."""
    still = records.Path.quantised(
        np.full((91, 3), 100.0),
        [(math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))) for angle in range(91)],
        feed_mm_s=1.0,
        tool_length_mm=160.0,
        elbow="right",
    )
    moving = records.Path.parse(pair.job.path)
    turning = estimated_s(replace(pair.job, path=still.body()))
    lines_s = estimated_s(pair.job)
    path_s = sum(np.linalg.norm(np.diff(moving.tips_mm, axis=0), axis=1)) / moving.feed_mm_s
    assert turning > 160.0 * math.pi / 2 * 0.999
    assert lines_s > path_s


@pytest.mark.parametrize("interface", ["can0", "x" * 100])
def test_the_buss_name_is_counted_in_every_line_of_the_raw_frames(pair, interface):
    told = space(100.0, pair.job.timing, chunk_period_s=0.8, interface=interface)
    line = candump.line(1_790_000_000_000_000_000, interface, 0x302, bytes(8))
    assert told.frames >= 100 * 300 * len(line)
