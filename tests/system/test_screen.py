"""Whoever looks on may stop reading, be slow or go away; a terminal that hangs up, and every signal, stop in order."""

import json
import secrets
import signal
import socket
import subprocess
from contextlib import contextmanager

import can
import pytest

from cutgate.config.interpreter import program
from cutgate.firmware_sim.bus.hub import is_served
from cutgate.protocol.frames import ControllerHeartbeat
from cutgate.protocol.states import ControllerState
from cutgate.runtime.audit.inspect import Status
from tests.system.children import BACKGROUND, FOREGROUND
from tests.system.harness import POSES, WAIT_S, state_of

pytestmark = pytest.mark.processes

SLOW = 15
"""Time scale at which the cut takes more than a second: time to do something to it, and to see its end."""
CTRL_S, CTRL_Z = b"\x13", b"\x1a"


def completed(rig, sim):
    """The cut went to its end, and so did its log."""
    assert f"{POSES - 1} segments executed" in sim.line("state DONE")
    log = rig.log()
    assert log.report.status is Status.OK
    assert log.of("/audit/close")[-1]["clean"] is True
    assert log.of("/audit/close")[-1]["final_state"] == "done"


def stopped(rig, sim, cause="OPERATOR_QUIT"):
    """The arm was stopped in order, and the log is whole."""
    assert rig.at_rest(sim) == f"INHIBITED ({cause})"
    log = rig.log()
    assert log.report.status is Status.OK
    assert log.of("/audit/close")[-1]["clean"] is True


# ---------------------------------------------------------------- the runtime's reader


def test_a_cut_goes_on_while_nobody_reads_what_the_runtime_says(rig):
    sim, run = rig.cutting(scale=SLOW)
    run.fill()
    assert run.deaf() == 0
    completed(rig, sim)


def test_a_cut_goes_on_after_the_runtimes_reader_has_gone(rig):
    sim, run = rig.cutting(scale=SLOW)
    run.hang_up()
    assert run.deaf() == 0
    completed(rig, sim)


def test_ctrl_s_at_the_runtimes_terminal_stops_the_screen_and_nothing_else(rig):
    sim, run = rig.cutting(scale=SLOW, terminal=True)
    run.type(CTRL_S)
    assert run.deaf() == 0
    completed(rig, sim)
    run.listen()
    assert "cutting: 90 %" not in run.told


def test_an_unread_screen_does_not_keep_a_word_from_being_obeyed(rig):
    sim, run = rig.cutting()
    run.fill()
    run.say("stop")
    assert run.deaf() == 3
    stopped(rig, sim, "OPERATOR_STOP")


# ---------------------------------------------------------------- its result


def test_the_document_waits_for_its_reader_with_bus_and_log_closed(rig):
    sim, run = rig.permitted(json=True)
    run.fill()
    run.say("quit")
    rig.at_rest(sim)
    rig.until(lambda: rig.log().of("/audit/close"))
    assert run.exit() == 3
    assert json.loads(run.document.strip("."))["outcome"] == "stopped"


def test_a_document_that_nobody_takes_is_141_and_no_verdict(rig):
    sim, run = rig.permitted(json=True)
    run.hang_up()
    run.say("quit")
    assert run.deaf() == 141
    assert rig.at_rest(sim) == "INHIBITED"
    assert rig.log().report.status is Status.OK


# ---------------------------------------------------------------- the terminal that hangs up, and signals


def test_a_terminal_that_hangs_up_stops_the_cut_in_order(rig):
    sim, run = rig.cutting(terminal=True)
    run.hang_up()
    assert run.deaf() == 3
    stopped(rig, sim)


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGHUP,
        signal.SIGQUIT,
        signal.SIGABRT,
        signal.SIGSYS,
        signal.SIGTSTP,
        signal.SIGTTIN,
        signal.SIGRTMAX,
    ],
    ids=lambda number: number.name,
)
def test_every_signal_that_would_end_or_suspend_the_runtime_stops_the_cut_in_order(rig, number):
    sim, run = rig.cutting()
    run.signal(number)
    assert run.exit() == 3
    assert f"STOPPED: {number.name} ended the program" in run.told
    stopped(rig, sim)
    assert rig.log().of("/audit/operator")[-1]["what"] == number.name, "a signal is nobody's word"


def test_ctrl_z_stops_the_cut_in_order_because_a_suspended_runtime_watches_nothing(rig):
    sim, run = rig.cutting(terminal=True)
    run.type(CTRL_Z)
    run.line("SIGTSTP.*suspended")
    assert run.exit() == 3
    stopped(rig, sim)


def test_a_hang_up_that_the_runtimes_parent_ignores_stays_ignored(rig):
    """As behind nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        sim, run = rig.cutting(scale=SLOW, fresh=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    run.signal(signal.SIGHUP)
    assert run.exit() == 0
    completed(rig, sim)


# ---------------------------------------------------------------- the terminal that belongs to somebody else


def test_a_cut_goes_on_in_the_background_of_its_terminal(rig):
    sim, run = rig.cutting(scale=SLOW, terminal=True)
    run.signal(BACKGROUND)
    rig.until(lambda: run.in_background)
    run.say("stop")  # to the shell
    assert run.exit() == 0
    completed(rig, sim)


def test_a_runtime_that_is_back_in_the_foreground_hears_its_operator(rig):
    sim, run = rig.cutting(terminal=True)
    run.signal(BACKGROUND)
    rig.until(lambda: run.in_background)
    run.say("nothing")
    run.signal(FOREGROUND)
    run.line("'nothing' is no command here")
    run.say("stop")
    assert run.exit() == 3
    stopped(rig, sim, "OPERATOR_STOP")


# ---------------------------------------------------------------- the controller


def test_a_controller_whose_screen_nobody_reads_still_obeys_its_enabling_device(rig):
    sim, run = rig.cutting()
    sim.fill()
    sim.say("release")
    assert run.exit() == 3
    assert "DEVICE_RELEASED" in run.told
    rest = rig.bus.single(ControllerHeartbeat, lambda beat: beat.state is ControllerState.INHIBITED)
    assert rest.timestamp
    sim.signal(signal.SIGTERM)
    assert sim.deaf() == 0


def test_a_controller_goes_on_after_its_reader_has_gone(rig):
    sim, run = rig.cutting(scale=SLOW)
    sim.hang_up()
    assert run.exit() == 0
    sim.signal(signal.SIGTERM)
    assert sim.deaf() == 0


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGUSR1], ids=lambda number: number.name)
def test_every_signal_that_would_end_the_controller_stops_the_arm_in_order(rig, number):
    sim, run = rig.cutting()
    sim.signal(number)
    assert sim.exit() == 0
    assert state_of(sim) == "INHIBITED (OPERATOR_QUIT)"
    assert run.exit() == 3


# ---------------------------------------------------------------- the bus


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_hub_serves_whatever_is_closed_when_it_is_started(rig, closed):
    path = rig.folder.parent / f"{secrets.token_hex(4)}.sock"
    command = program("cutgate.firmware_sim", "bus", "serve", "--socket", str(path))
    with subprocess.Popen(
        ["sh", "-c", f'exec "$@" {closed}', "sh", *command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as hub:
        with ended(hub):
            rig.until(lambda: is_served(path))  # not every one of them can say so
            with (
                can.Bus(interface="cutgate", channel=str(path)) as one,
                can.Bus(interface="cutgate", channel=str(path)) as other,
            ):
                one.send(can.Message(arbitration_id=0x42, is_extended_id=False))
                assert other.recv(WAIT_S).arbitration_id == 0x42
            hub.send_signal(signal.SIGHUP)
            told, _ = hub.communicate(timeout=WAIT_S)
        assert hub.returncode == 0
        assert "Traceback" not in told
    assert not path.exists()


@contextmanager
def ended(process):
    """A test that fails leaves no process behind, for which leaving `Popen` would wait."""
    try:
        yield
    except BaseException:
        process.kill()
        raise


def test_a_hub_whose_screen_nobody_reads_carries_the_cut_to_its_end(rig):
    sim, run = rig.cutting(scale=SLOW)
    rig.hub.fill()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.settimeout(WAIT_S)
        stranger.connect(rig.channel)
        stranger.send(b"hello?")
        assert stranger.recv(4096)  # refused, which the hub has to say
    assert run.exit() == 0
    completed(rig, sim)
    rig.hub.signal(signal.SIGTERM)
    assert rig.hub.deaf() == 0
