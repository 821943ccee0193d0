"""Whatever stops a cut stops it: at the controller, at the runtime, by its death, by the death of the bus."""

import json
import signal

import can
import pytest

from cutgate.config.key import load_key
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.frames import IDS, ControllerFault, ControllerHeartbeat, RuntimeHeartbeat
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import Status
from tests.system.children import MOVING, Script
from tests.system.harness import IN_TIME, is_kind, moved_after, register, state_of

pytestmark = pytest.mark.processes


@pytest.mark.parametrize(
    ("word", "cause"),
    [
        ("release", StopCause.DEVICE_RELEASED),
        ("estop", StopCause.EMERGENCY_STOP),
        ("bone-motion", StopCause.BONE_MOVED),
        ("limit", StopCause.LIMITS_CHANGED),
    ],
)
def test_a_word_at_the_controller_stops_the_cut(rig, word, cause):
    sim, run = rig.cutting()
    sim.say(word)
    assert run.exit() == 3
    stopped = rig.bus.single(ControllerFault, lambda fault: fault.cause is cause)
    assert state_of(sim) == f"INHIBITED ({cause.name})"
    assert rig.at_rest(sim) == f"INHIBITED ({cause.name})"
    assert not moved_after(rig, stopped.timestamp)
    assert cause.name in run.told
    assert rig.log().report.status is Status.OK


@pytest.mark.parametrize(
    ("word", "cause"),
    [
        ("stop", StopCause.OPERATOR_STOP),
        ("withdraw", StopCause.OPERATOR_STOP),  # what the stop frame says
        ("quit", StopCause.OPERATOR_QUIT),
    ],
)
def test_a_word_at_the_runtime_stops_the_cut(rig, word, cause):
    sim, run = rig.cutting()
    run.say(word)
    assert run.exit() == 3
    stopped = rig.bus.single(ControllerFault, lambda fault: fault.cause is cause)
    assert rig.at_rest(sim) == f"INHIBITED ({cause.name})"
    assert not moved_after(rig, stopped.timestamp)
    assert rig.log().report.status is Status.OK


def alone(rig) -> int:
    """How many heartbeats the controller sent after the runtime's last one and before its word that it had stopped."""
    fault = rig.bus.single(ControllerFault, lambda fault: fault.cause is StopCause.HEARTBEAT_LOST)
    heard = [number for number, m in enumerate(list(rig.bus.frames)) if is_kind(m, RuntimeHeartbeat)]
    return rig.bus.beats(ControllerHeartbeat, after=heard[-1], before=fault)


def test_a_killed_runtime_stops_the_cut_within_the_time_out(rig):
    sim, run = rig.cutting()
    run.signal(signal.SIGKILL)
    assert run.exit() == -signal.SIGKILL
    assert alone(rig) <= IN_TIME
    assert rig.at_rest(sim) == "INHIBITED (HEARTBEAT_LOST)"


def test_a_wedged_loop_stops_the_cut_within_the_time_out_and_says_so_when_it_comes_back(rig):
    """It stands still between two cycles; inside one, the fault frame of the controller may be read first."""
    sim, run = rig.cutting(script=Script(at=MOVING, sent=True, number=signal.SIGSTOP))
    sim.line("HEARTBEAT_LOST")
    assert alone(rig) <= IN_TIME
    rig.at_rest(sim)  # an announcement later the loop has stood still for longer than the time-out
    mark = len(rig.bus.frames)
    run.signal(signal.SIGCONT)
    run.line("STOP sent: this computer stood still")
    assert run.exit() == 3
    assert rig.log().of("/audit/decision")[-1]["first_out"] == "LOOP_STALLED"
    assert rig.log().report.status is Status.OK
    assert rig.at_rest(sim) == "INHIBITED (HEARTBEAT_LOST)"
    assert not any(is_kind(m, ControllerHeartbeat) for m in rig.bus.frames[mark:])  # no session any more


def test_a_wedged_controller_is_noticed_and_stops_by_itself_when_it_comes_back(rig):
    sim, run = rig.cutting()
    sim.signal(signal.SIGSTOP)
    assert run.exit() == 3
    assert "HEARTBEAT_LOST" in rig.log().of("/audit/decision")[-1]["first_out"]
    sim.signal(signal.SIGCONT)
    sim.line("state INHIBITED")
    assert rig.at_rest(sim) in ("INHIBITED (LOOP_STALLED)", "INHIBITED (HEARTBEAT_LOST)")


def test_a_dead_controller_ends_the_session(rig):
    sim, run = rig.cutting()
    sim.signal(signal.SIGKILL)
    assert run.exit() == 3
    assert rig.log().of("/audit/decision")[-1]["first_out"] == "HEARTBEAT_LOST"
    assert rig.log().report.status is Status.OK


def test_a_dead_bus_stops_both(rig):
    sim, run = rig.cutting()
    rig.hub.signal(signal.SIGKILL)
    assert run.exit() == 3
    assert sim.exit() == 2
    assert state_of(sim) == "INHIBITED (BUS_FAILED)"
    log = rig.log()
    assert log.report.status is Status.OK
    assert log.of("/audit/decision")[-1]["first_out"] == "BUS_FAILED"


# ---------------------------------------------------------------- what it takes to go on


def test_after_a_stop_a_new_session_waits_for_acknowledge(rig):
    sim, run = rig.cutting()
    sim.say("release")
    assert run.exit() == 3
    again = rig.run()
    again.line("its cause is DEVICE_RELEASED")
    again.say("reset")
    again.line("reset refused: .*controller's stop cause")
    again.say("acknowledge")
    again.line("permitted:")
    again.say("quit")
    assert again.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED"


def test_another_key_opens_nothing_and_is_told_on_both_sides(rig):
    sim = rig.sim()
    right, wrong = (fingerprint(load_key(rig.folder / name)) for name in ("site.key", "wrong.key"))
    run = rig.run(key="wrong.key")
    run.line(f"key fingerprint {wrong}: the controller's key must have the same")
    assert run.exit() == 1
    assert "MAC_INVALID: the two key files differ" in run.told
    assert f"(this side's has the fingerprint {wrong})" in run.told
    assert f"site.key, fingerprint {right}" in sim.told
    assert f"this one's fingerprint is {right}" in sim.line("refused: MAC_INVALID")
    assert rig.at_rest(sim) == "INHIBITED"


def test_a_latched_fault_needs_acknowledge_and_then_reset(rig):
    sim = rig.sim()
    rig.bus.bus.send(
        can.Message(arbitration_id=IDS[ControllerHeartbeat], data=bytes(8), is_extended_id=False)
    )
    sim.line(r"state FAULT \(SECOND_NODE\)")

    again = rig.run()
    again.line("its cause is SECOND_NODE")
    again.say("acknowledge")
    again.line("the fault is latched: say reset")
    again.say("start")
    again.line("start refused")  # still held: acknowledging neither resets nor starts
    again.say("reset")
    again.line("permitted:")
    again.say("quit")
    assert again.exit() == 3
    authorised = [r["kind"] for r in rig.log().of("/audit/permit") if r["stage"] == "sent"]
    assert authorised == ["reset", "permit"]


# ---------------------------------------------------------------- a bone that has moved


def test_a_moved_bone_withdraws_its_registration_also_after_a_reboot(rig):
    sim, run = rig.cutting()
    sim.say("bone-motion")
    assert run.exit() == 3

    again = rig.run(logs="elsewhere")  # a runtime that does not know of it
    again.line("its cause is BONE_MOVED")
    again.say("acknowledge")
    assert again.exit() == 1
    assert "withdrawn at the controller" in again.told

    sim.signal(signal.SIGINT)
    assert sim.exit() == 0
    sim = rig.sim()
    after_reboot = rig.run(logs="yet elsewhere")
    assert after_reboot.exit() == 1
    assert "withdrawn at the controller" in after_reboot.told
    assert "state PERMITTED" not in sim.told

    other = rig.run(registration=register(rig.folder, "anew", (0.25, 0, 0), now=True))
    other.line("permitted:")
    other.say("quit")
    assert other.exit() == 3


def test_a_withdrawal_that_the_controller_never_heard_stands_in_every_later_session(rig):
    sim, run = rig.permitted()
    sim.signal(signal.SIGSTOP)
    rig.until(lambda: sim.stopped)
    run.say("withdraw")
    assert run.exit() == 3
    sim.signal(signal.SIGKILL)
    assert sim.exit() == -signal.SIGKILL

    rig.sim()
    again = rig.run()
    again.line(f"this registration was withdrawn in {rig.logs()[0].name}: register the bone anew")
    assert again.exit() == 1
    assert "registration stands: this registration was withdrawn in" in again.told
    assert rig.log().report.status is Status.OK

    other = rig.run(registration=register(rig.folder, "anew", (0.25, 0, 0), now=True))
    other.line("permitted:")
    other.say("quit")
    assert other.exit() == 3


def test_what_was_withdrawn_is_the_place_and_everything_taken_before(rig):
    """The same file with one more newline, indented, under another name; and another place that was measured before."""
    sim, run = rig.permitted()
    run.say("withdraw")
    assert run.exit() == 3
    sim.signal(signal.SIGINT)
    assert sim.exit() == 0
    written = json.loads((rig.folder / "registration.json").read_text())
    log = rig.logs()[0].name
    itself = f"this registration was withdrawn in {log}"
    for text, said in (
        (json.dumps(written) + "\n", itself),
        (json.dumps(written, indent=2), itself),
        (json.dumps({**written, "id": "b"}), f"the same place was withdrawn in {log}, under whatever name"),
    ):
        (rig.folder / "spelled.json").write_text(text)
        sim = rig.sim()
        again = rig.run(registration="spelled.json")
        again.line(said)
        assert again.exit() == 1
        assert "state PERMITTED" not in sim.told
        sim.signal(signal.SIGINT)
        assert sim.exit() == 0
    rig.sim()
    before = rig.run(registration=register(rig.folder, "before", (0.25, 0, 0)))
    before.line("is not surely later than the withdrawal")
    assert before.exit() == 1
    assert "required: not withdrawn, and later than every withdrawal" in before.told
    assert rig.log().report.status is Status.OK


def test_a_bone_that_moves_again_while_a_session_is_refused_is_listed_again(rig):
    """The barrier goes with the last of them, whether or not the registration of that session was any good."""
    sim, run = rig.permitted()
    run.say("withdraw")
    assert run.exit() == 3
    sim.signal(signal.SIGSTOP)
    rig.until(lambda: sim.stopped)
    again = rig.run()
    again.line("this registration was withdrawn")
    again.say("withdraw")
    assert again.exit() == 3
    first, second = (rig.logs()[0].parent / "WITHDRAWN").read_text().splitlines()
    assert first.split()[0] == second.split()[0]
    assert first.split()[3] < second.split()[3]


def test_an_arm_that_drifts_unseen_by_its_controller_is_stopped_by_the_runtime(rig):
    sim, run = rig.permitted("drift@cutting")
    sim.say("hold")
    run.line("enabling device is held")
    run.say("start")
    assert run.exit() == 3
    stopped = rig.bus.single(ControllerFault, lambda fault: fault.cause is StopCause.TRACKING_DEVIATION)
    assert rig.at_rest(sim) == "INHIBITED (TRACKING_DEVIATION)"
    assert "off the verified path near" in run.told
    assert not any("the arm stopped by itself" in line for line in sim.told.splitlines())
    assert stopped
    assert rig.log().report.status is Status.OK
