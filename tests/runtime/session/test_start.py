"""No start leaves on joints that may be older than the time-out, whatever became of their frames on the way."""

from dataclasses import replace

import pytest

from cutgate.firmware_sim.faults import FaultName
from cutgate.protocol import records
from cutgate.protocol.frames import Joint4, Joints01, Joints23
from cutgate.runtime.interlock.state import DeviceCycle, Phase, Refused
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import of

TIME_OUT_S = 0.1
JOINTS = (Joints01, Joints23, Joint4)


def ready(pair, late_s=0.0):
    """Permitted, the device held; the joints have long been so late, and nothing else is."""
    pair.to(Phase.PERMITTED)
    pair.until(lambda: pair.state.device is DeviceCycle.PRESSED, act=pair._lead)
    late(pair, late_s)
    return pair.run(0.5)


def late(pair, late_s):
    """From now on the joints are so late, and nothing else is."""
    for kind in JOINTS:
        pair.wire.delay_s[of(kind)] = late_s


def catch_up(pair):
    """They come in time again; none overtakes another."""
    while (late_s := pair.wire.delay_s[of(Joint4)]) > 0.0:
        late(pair, max(0.0, late_s - 0.015))
        pair.run(0.02)
    return pair


def moves_off(pair):
    """The arm is knocked off its start; when."""
    pair.process._happen(FaultName.OFF_START)
    return pair.clock()


@pytest.mark.parametrize("late_s", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize("said_s", [-0.02, 0.0, 0.05, 0.1, 0.2, 0.3])
def test_no_start_leaves_long_after_the_arm_has_left_its_start(pair, late_s, said_s):
    """The word start before or after; the samples that arrive meanwhile still show the arm where it stood."""
    ready(pair, late_s)
    if said_s < 0.0:
        pair.terminal.type("start")
        pair.run(-said_s)
    moved_s = moves_off(pair)
    if said_s >= 0.0:
        pair.run(said_s).terminal.type("start")
    pair.run(0.5)
    assert all(start.at_s - moved_s <= TIME_OUT_S for start in first_frames(pair, records.Start))


@pytest.mark.parametrize("late_s", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize("asleep_s", [0.03, 0.06, 0.09])
def test_a_loop_that_slept_starts_nothing_on_what_it_finds_when_it_wakes_up(pair, late_s, asleep_s):
    """The start's record waits for the disk; it becomes durable in the turn in which the loop goes on."""
    ready(pair, late_s)
    pair.disk.answers = False
    pair.terminal.type("start")
    pair.run(0.05)
    moved_s = moves_off(pair)
    pair.run(0.05)
    pair.runtime_runs = False
    pair.run(asleep_s)
    pair.runtime_runs = pair.disk.answers = True
    pair.run(0.5)
    assert all(start.at_s - moved_s <= TIME_OUT_S for start in first_frames(pair, records.Start))


@pytest.mark.parametrize(("late_s", "starts"), [(0.0, True), (0.03, True), (0.12, False), (0.3, False)])
def test_joints_late_within_the_time_out_start_and_later_ones_are_refused_by_their_age(pair, late_s, starts):
    ready(pair, late_s).say("start").run(0.1)
    refused = [effect.reason for effect in pair.notes.effects if isinstance(effect, Refused)]
    assert bool(first_frames(pair, records.Start)) is starts
    assert any("age of the measured joints: " in why for why in refused) is not starts
    if not starts:
        assert catch_up(pair).phase is Phase.PERMITTED
        pair.say("start").run(0.1)
        assert first_frames(pair, records.Start), "nothing is lost by it: once they are in time it starts"


@pytest.mark.parametrize(
    ("heartbeat_ms", "timeout_ms"), [(20, 100), (5, 20), (25, 100), (100, 400), (5, 1000), (100, 1000)]
)
def test_a_start_succeeds_at_every_timing_that_is_allowed(pair, heartbeat_ms, timeout_ms):
    """Joints are called as old as is proved of them: with the fewest heartbeats to the time-out that is still enough."""
    timing = replace(pair.job.timing, heartbeat_ms=heartbeat_ms, timeout_ms=timeout_ms)
    pair.cycle_s = heartbeat_ms / 4000
    pair.begin(replace(pair.job, timing=timing))
    assert pair.end(30.0) is Phase.DONE, pair.state.reason


def test_an_arm_from_which_no_joints_come_in_time_is_not_verified(pair):
    """What is verified begins where the arm stands, not where it stood."""
    pair.begin()
    late(pair, 0.12)
    pair.to(Phase.UPLOADING).run(1.0)
    assert (pair.phase, pair.prover.asked) == (Phase.UPLOADING, [])
    catch_up(pair).to(Phase.PERMITTED)
