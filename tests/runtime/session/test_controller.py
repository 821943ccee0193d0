"""The controller refuses for its own reasons, whatever the runtime believes; and what it remembers."""

from dataclasses import replace
from hashlib import sha256

import pytest

from cutgate.firmware_sim.drives import BANDWIDTH_RAD_S
from cutgate.firmware_sim.faults import FaultName
from cutgate.firmware_sim.plant import Leg
from cutgate.firmware_sim.reports import announcement
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerFault, ControllerHeartbeat
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.runtime.interlock.refusals import told
from cutgate.runtime.interlock.state import Phase, Refused
from tests.runtime.session.pair import Stranger
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import lose, nth, of


def refusals(pair):
    """Why words of the operator were refused."""
    return [effect.reason for effect in pair.notes.effects if isinstance(effect, Refused)]


@pytest.mark.parametrize(
    ("fault", "refusal"),
    [("flip-path-bit@loaded", Refusal.PATH_DIGEST), ("change-limit@loaded", Refusal.LIMITS_DIGEST)],
)
def test_what_changes_after_the_upload_is_found_at_the_permit(pair, fault, refusal):
    pair.power_up(fault)
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(refusal)}"
    assert Phase.PERMITTED not in pair.notes.phases


@pytest.mark.parametrize(
    ("fault", "refusal"),
    [("flip-path-bit@permitted", Refusal.PATH_DIGEST), ("change-limit@permitted", Refusal.LIMITS_DIGEST)],
)
def test_what_changes_after_the_permit_is_found_at_the_start(pair, fault, refusal):
    pair.power_up(fault)
    pair.begin().until(lambda: bool(refusals(pair)), act=pair._lead)
    assert refusals(pair)[0] == f"the controller refused the start: {told(refusal)}"
    pair.say("quit").run(0.2)
    assert not any("CUTTING" in line for line in pair.said)


def test_a_bit_that_flips_while_cutting_stops_the_arm(pair):
    pair.power_up("flip-path-bit@cutting", time_scale=1.0)
    assert pair.end() is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (StopCause.PATH_CHANGED, StopCause.PATH_CHANGED)


def test_an_arm_off_its_start_is_seen_by_the_runtime(pair):
    pair.power_up("off-start@permitted")
    pair.begin().until(lambda: bool(refusals(pair)), act=pair._lead)
    assert "measured wrist centre to the verified start: 31.4159" in refusals(pair)[0]
    assert "measured joints to the verified start: 2 " in refusals(pair)[0]
    assert not first_frames(pair, records.Start)


def test_an_arm_off_its_start_is_refused_by_the_controller_as_well(pair):
    """The arm slips after the runtime has last measured it."""
    pair.to(Phase.PERMITTED)
    pair.disk.delay_s = 0.1
    pair.to(Phase.AUTHORISING_START)
    pair.until(lambda: bool(first_frames(pair, records.Start)))
    pair.process._happen(FaultName.OFF_START)
    place = pair.process.arm.state.joints
    pair.until(lambda: "refused: NOT_AT_START" in pair.said)
    assert pair.end() is Phase.STOPPED, "its joints reach the runtime before the refusal does"
    assert pair.state.cause is StopCause.TRACKING_DEVIATION
    assert pair.process.arm.state.joints == place


@pytest.mark.parametrize("state", ["loaded", "permitted", "cutting"])
def test_a_reboot_ends_the_session(pair, state):
    pair.power_up(f"reboot@{state}", time_scale=0.1)
    boot = pair.controller.announce_nonce
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.PEER_REBOOTED
    assert pair.controller.announce_nonce != boot
    assert pair.controller.holdings.path is None
    assert pair.controller.state is ControllerState.INHIBITED


def test_a_path_that_was_being_checked_does_not_survive_a_reboot(pair, monkeypatch):
    monkeypatch.setattr("cutgate.firmware_sim.upload.CHECK_POSES_PER_CYCLE", 1)
    pair.begin().until(lambda: pair.process.upload.check is not None)
    assert pair.process._wait_s() == 0.0
    pair.process._happen(FaultName.REBOOT)
    assert pair.process.upload.check is None
    pair.end()
    assert pair.controller.holdings.path is None


def test_a_silent_controller_is_lost(pair):
    pair.power_up("silent@cutting", time_scale=0.05)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.HEARTBEAT_LOST
    assert not pair.controller.may_move


@pytest.mark.parametrize(
    ("word", "cause"),
    [
        ("release", StopCause.DEVICE_RELEASED),
        ("estop", StopCause.EMERGENCY_STOP),
        ("bone-motion", StopCause.BONE_MOVED),
        ("limit", StopCause.LIMITS_CHANGED),
    ],
)
def test_the_person_at_the_controller_stops_the_cut(pair, word, cause):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING).controller_terminal.type(word)
    pair.run_cycle()
    assert not pair.controller.may_move
    assert pair.end() is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (cause, cause)


def test_an_unknown_word_at_the_controller_is_answered(pair):
    pair.controller_terminal.type("dance")
    pair.run_cycle()
    assert "'dance' is no command here; say one of hold, release," in pair.said[-1]


# ---------------------------------------------------------------- an arm with mass


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_an_arm_with_mass_cuts_to_its_end_within_the_usual_tolerances(pair, scale):
    pair.power_up(time_scale=scale, dynamics=True)
    assert pair.end(limit_s=60.0) is Phase.DONE
    assert pair.process.arm.reading == pair.process.arm.state.joints


@pytest.mark.parametrize("word", ["stop", "estop"])
def test_an_arm_with_mass_stands_a_stated_time_after_it_may_not_move_any_more(pair, word):
    """Its command stands in the cycle of the stop; the drives take 7 / bandwidth, and 0.5 mm at 10 mm/s."""
    pair.power_up(time_scale=1.0, dynamics=True)
    pair.to(Phase.CUTTING).until(lambda: pair.process.arm.seen.leg is Leg.CUT, limit_s=30.0).run(1.0)
    arm = pair.process.arm
    (pair.terminal if word == "stop" else pair.controller_terminal).type(word)
    pair.until(lambda: not pair.controller.may_move, limit_s=0.1)
    command, before = arm.state.joints, arm.reading
    assert before != command
    pair.run(7.0 / BANDWIDTH_RAD_S)
    assert arm.state.joints == command
    off = [abs(a - b) for a, b in zip(arm.reading, command, strict=True)]
    assert all(left <= 0.01 * abs(a - b) + 1e-6 for left, a, b in zip(off, before, command, strict=True))
    pair.run(0.5)
    assert arm.reading == command
    assert pair.end() is Phase.STOPPED


def test_what_the_operator_stops_while_the_arm_has_mass_is_told_as_ever(pair):
    pair.power_up(time_scale=1.0, dynamics=True)
    pair.to(Phase.CUTTING).run(1.0).say("stop")
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.OPERATOR_STOP


# ---------------------------------------------------------------- opening


def open_request(pair, **changes):
    """An OPEN as the session would send it."""
    timing = records.Timing(20, 100, 120, 2000, 500, 200, 10_000, 25)
    values = {
        "protocol_version": records.PROTOCOL_VERSION,
        "announce_nonce": pair.controller.announce_nonce,
        "runtime_nonce": b"n" * 16,
        "identity_digest": announcement(pair.controller).identity_digest,
        "registration_digest": pair.job.registration,
        "place_digest": pair.job.place,
        "registration_time_us": pair.job.registration_time_us,
        "configuration_digest": pair.job.configuration,
        "verifier_version": pair.job.verifier,
        "timing": timing,
    }
    return records.Open(**(values | changes))


def test_a_second_session_is_refused_while_one_lives(pair):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    stranger = Stranger(pair)
    stranger.say(open_request(pair))
    pair.run(0.1)
    assert [reply.refusal for reply in stranger.replies] == [Refusal.SESSION_IN_USE]
    assert pair.phase is Phase.CUTTING
    assert pair.controller.may_move


def test_timing_outside_the_controllers_bounds_is_refused(pair):
    timing = replace(pair.job.timing, heartbeat_ms=4)
    pair.begin(replace(pair.job, timing=timing))
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the session: {told(Refusal.TIMING_OUT_OF_BOUNDS)}"


def test_a_refusal_is_not_cut_off_by_the_next_announcement(pair):
    """Whenever the next announcement was due: the refusal needs several frames, and each of them a turn."""
    timing = replace(pair.job.timing, heartbeat_ms=4)
    pair.cycle_s = 0.02
    pair.begin(replace(pair.job, timing=timing))
    pair.until(lambda: "refused: TIMING_OUT_OF_BOUNDS" in pair.said)
    refused_s = pair.clock()
    assert pair.process._next_announce_s >= refused_s + pair.options.announce_s - 1e-9
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the session: {told(Refusal.TIMING_OUT_OF_BOUNDS)}"
    assert pair.clock() - refused_s <= pair.options.announce_s


def test_another_controller_than_the_configured_one_is_refused(pair):
    pair.begin(replace(pair.job, serial="SIM-2"))
    assert pair.end() is Phase.REFUSED
    assert "controller serial number: SIM-1 (required: SIM-2)" in pair.state.reason


def test_announcements_that_nobody_takes_are_dropped_and_repeated(pair):
    pair.run(1.1)
    assert len(pair.wire.seen) == 6  # a first frame each, every 200 ms; nobody answers
    assert pair.begin().end() is Phase.DONE


def test_other_limits_than_the_approved_are_refused_before_the_upload(pair):
    pair.begin()
    pair.controller_terminal.type("limit")
    pair.run(0.02)
    pair.close()
    pair.run(0.1).begin()
    pair.to(Phase.HELD).run(0.05).say("acknowledge")
    assert pair.end() is Phase.REFUSED
    assert "controller's joint limits equal the approved: q" in pair.state.reason
    assert "approved: " in pair.state.reason
    assert Phase.UPLOADING not in pair.notes.phases
    pair.close()
    log = pair.read()
    (collected,) = [entry for entry in log.of("/audit/collected") if not entry["matches_approved"]]
    assert "limit is " in collected["difference"]
    held = log.scan.attachment("limits.bin")
    assert sha256(held.data).hexdigest() == collected["sha256"]
    assert held.data != pair.job.limits


def test_an_emergency_stop_that_is_still_pressed_is_named_at_the_acknowledgement_and_then_released(pair):
    pair.to(Phase.PERMITTED).controller_terminal.type("estop")
    assert pair.end() is Phase.STOPPED
    pair.close()
    pair.run(0.1).begin()
    pair.to(Phase.HELD).run(0.05).say("acknowledge").run(0.1)
    still = "EMERGENCY_STOP: the emergency stop is still pressed: release it, then try again"
    assert refusals(pair) == [f"the controller refused: {still}"]
    assert "refused: EMERGENCY_STOP: the emergency stop is pressed; say estop to release it" in pair.said
    pair.controller_terminal.type("estop")
    pair.run(0.05).say("acknowledge")
    pair.to(Phase.PERMITTED)


# ---------------------------------------------------------------- memory


def test_a_withdrawn_registration_stays_withdrawn_over_a_restart(pair):
    pair.to(Phase.PERMITTED).controller_terminal.type("bone-motion")
    assert pair.end() is Phase.STOPPED
    pair.close()
    pair.power_up()
    assert pair.begin().end() is Phase.REFUSED
    assert pair.state.reason.startswith(
        "registration stands: withdrawn at the controller; what is taken from 2026-09-21 "
    )
    assert pair.state.verdict is None, "it is refused before anything is uploaded"


def test_a_motion_without_a_session_withdraws_what_was_registered_before_it_and_nothing_else(pair):
    """The controller alone has seen it; the next session says from when on a registration counts."""
    pair.controller_terminal.type("bone-motion")
    pair.run(2.0)
    assert pair.controller.memory.withdrawal_due
    pair.to(Phase.HELD).run(0.05).say("acknowledge")
    assert pair.end() is Phase.REFUSED
    assert "is not surely later than the last withdrawal that the controller knows" in pair.state.reason
    barrier_us = pair.state.barrier_us
    assert 0 <= pair.clock.utc_ns() // 1000 - (barrier_us - 60_000_000) - 2_000_000 <= 1_500_000, (
        "2 s ago, and skew"
    )
    assert (pair.controller.memory.barrier_us, pair.controller.memory.withdrawal_due) == (barrier_us, False)
    assert pair.controller.memory.withdrawn == frozenset(), "of which place it was, nobody knows"
    pair.close()
    (told,) = [one for one in pair.read().of("/audit/decision") if one["event"] == "withdrawal sent"]
    assert told["reason"].startswith("only a registration later than 2026-09-21 ")
    pair.run(0.1).begin(replace(pair.job, registration_time_us=barrier_us + 1))
    assert pair.end() is Phase.DONE


def test_a_motion_whose_age_nobody_knows_withdraws_what_this_side_has_seen(pair):
    """After a power-up: a registration that this side knows is none of later."""
    pair.controller_terminal.type("bone-motion")
    pair.run(0.1)
    pair.power_up()
    pair.begin().end()
    assert pair.phase is Phase.REFUSED
    now_us = pair.clock.utc_ns() // 1000
    assert 0 <= now_us + 60_000_000 - pair.state.barrier_us <= 1_000_000


def test_only_a_withdrawn_registration_is_remembered(pair):
    pair.to(Phase.PERMITTED).controller_terminal.type("estop")
    pair.end()
    pair.close()
    pair.power_up()
    assert pair.begin().end() is Phase.DONE


# ---------------------------------------------------------------- records that do not fit


@pytest.mark.parametrize(
    "block",
    [records.split(bytes(5000))[1], records.split(bytes(100))[0]],
    ids=["a second block without the first", "no path"],
)
def test_a_path_block_that_makes_no_path_is_refused(pair, block):
    pair.begin()
    pair.prover.answer = lambda _request: None
    pair.to(Phase.VERIFYING)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.say(block)
    pair.run(0.2)
    assert any("path refused: " in line for line in pair.said)
    assert pair.controller.holdings.path is None


def test_a_path_block_outside_loading_is_ignored(pair):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.say(records.split(pair.job.path)[0])
    pair.run(0.2)
    assert pair.controller.may_move
    assert pair.process.upload.check is None


def unlimited(pair, joint, turns=0):
    """The same session with a joint that has no limits, and the path that many turns further on."""
    i = records.Limits.parse(pair.job.limits)
    far = 36_000_000_000
    lower, upper = (
        tuple(sign * far if j == joint else bound for j, bound in enumerate(bounds))
        for sign, bounds in ((-1, i.q_min_u), (1, i.q_max_u))
    )
    path = records.Path.parse(pair.job.path)
    path = replace(path, **{{0: "q0_turns", 3: "roll_turns"}[joint]: turns})
    pair.job = replace(
        pair.job,
        limits=replace(i, q_min_u=lower, q_max_u=upper).body(),
        path=path.body(),
        branch=records.Branch(path.elbow, path.q0_turns, path.roll_turns),
    )
    pair.power_up()
    return pair


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_without_limits_runs_a_whole_session(pair, joint):
    """What must fit a joints frame is where the arm goes."""
    assert unlimited(pair, joint).begin().end() is Phase.DONE


@pytest.mark.parametrize("joint", [0, 3])
def test_a_path_that_goes_beyond_what_a_joints_frame_carries_is_refused_by_the_controller_itself(pair, joint):
    assert unlimited(pair, joint, turns=7).begin().end() is Phase.REFUSED
    assert "JOINTS_BEYOND_WIRE" in pair.state.reason
    assert any(f"q{joint} = " in line and "deg is beyond +-2261 deg" in line for line in pair.said)


# ---------------------------------------------------------------- a bone that moves while the runtime stops anyway


@pytest.fixture
def stopping(pair):
    """The bone moves in the turn in which the operator says stop: what the controller says of it crosses the stop."""
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING).run(0.1)
    pair.wire.delay_s = {of(kind): pair.cycle_s / 2 for kind in (ControllerFault, ControllerHeartbeat)}
    pair.controller_terminal.type("bone-motion")
    return pair


def test_a_bone_that_moved_as_the_operator_said_stop_is_not_forgotten(stopping):
    assert stopping.say("stop").phase is Phase.STOPPING
    assert stopping.end() is Phase.STOPPED
    assert stopping.state.cause is StopCause.OPERATOR_STOP
    assert stopping.controller.cause is StopCause.BONE_MOVED
    assert stopping.state.registration_withdrawn


def test_the_heartbeat_says_so_where_the_fault_frame_was_lost(stopping):
    stopping.wire.rules.append(nth(of(ControllerFault), range(10), lose))
    assert stopping.say("stop").phase is Phase.STOPPING
    assert stopping.end() is Phase.STOPPED
    assert stopping.state.registration_withdrawn


def test_a_cause_that_stood_before_withdraws_no_registration_of_this_session(pair):
    pair.power_up()
    pair.to(Phase.CUTTING)
    pair.controller_terminal.type("bone-motion")
    assert pair.end() is Phase.STOPPED
    pair.close()
    pair.run(0.5).begin()
    pair.until(lambda: pair.phase is Phase.HELD and pair.state.controller is not None)
    assert pair.state.controller.cause is StopCause.BONE_MOVED
    pair.say("stop")
    assert pair.end() is Phase.STOPPED
    assert not pair.state.registration_withdrawn
