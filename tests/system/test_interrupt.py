"""Ctrl-C and SIGTERM, at any moment: the controller is inhibited, the log is closed, nothing is torn."""

import os
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from cutgate.protocol.frames import RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.state import Phase
from tests.system.children import SECOND_BLOCK, Script
from tests.system.harness import state_of

pytestmark = pytest.mark.processes

BOTH = (signal.SIGINT, signal.SIGTERM)


def test_an_interrupted_wait_for_a_controller_closes_the_log(rig):
    run = rig.run(script=Script(at=Phase.WAITING, number=signal.SIGINT))
    assert run.exit() == 3
    assert rig.log().report.status is Status.OK


def verifier_imports(run):
    """Whether a process that the runtime has started is on its way through its imports."""
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text(encoding="ascii").split()
    with suppress(OSError):  # one that has just ended
        return any("numpy" in Path(f"/proc/{child}/maps").read_text(encoding="utf-8") for child in children)
    return False


def test_ctrl_c_while_the_verifier_is_still_starting_closes_the_log(rig):
    run = rig.run(fresh=True)
    rig.until(lambda: rig.logs() and verifier_imports(run))
    run.ctrl_c()
    assert run.exit() == 3
    expected = ("key fingerprint", "a simulated controller is allowed", "log key")
    assert [line for line in run.lines if not any(words in line for words in expected)] == []
    assert rig.log().report.status is Status.OK


@pytest.mark.parametrize(
    ("at", "number"),
    [
        (Phase.OPENING, signal.SIGTERM),
        (SECOND_BLOCK, signal.SIGINT),
        (Phase.VERIFYING, signal.SIGTERM),
        (Phase.AUTHORISING_PERMIT, signal.SIGINT),
        (Phase.PERMITTED, signal.SIGTERM),
        (Phase.PERMITTED, signal.SIGINT),
    ],
)
def test_an_interrupted_session_ends_with_the_controller_inhibited(rig, at, number):
    run, sim = rig.run(script=Script(at=at, number=number)), rig.sim()
    assert run.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED"
    log = rig.log()
    assert log.report.status is Status.OK
    assert log.of("/audit/close")[-1]["clean"] is True


@pytest.mark.parametrize("number", BOTH)
def test_an_interrupted_cut_is_stopped(rig, number):
    sim, run = rig.cutting(fresh=number == signal.SIGINT)
    run.ctrl_c() if number == signal.SIGINT else run.signal(number)
    assert run.exit() == 3
    sim.line("state INHIBITED")
    assert state_of(sim) == "INHIBITED (OPERATOR_QUIT)"
    assert rig.log().report.status is Status.OK


@pytest.mark.parametrize("number", BOTH)
def test_an_interrupted_controller_stops_and_says_so(rig, number):
    sim, run = rig.cutting()
    sim.signal(number)
    assert sim.exit() == 0
    assert state_of(sim) == "INHIBITED (OPERATOR_QUIT)"
    assert run.exit() == 3
    assert rig.log().report.status is Status.OK


WAITS_IN_ITS_SESSION = "permit: expires"
"""For ten seconds."""


def test_an_interrupted_negative_suite_stops_the_controller_and_leaves_nothing_behind(rig):
    sim = rig.sim()
    tester = rig.conform(WAITS_IN_ITS_SESSION)
    rig.bus.single(RuntimeHeartbeat)
    tester.ctrl_c()
    assert tester.exit() == 3
    assert tester.lines[-1] == "interrupted: the controller was told to stop; there is no report"
    assert rig.bus.single(RuntimeStop, lambda stop: stop.cause is StopCause.OPERATOR_STOP)
    assert rig.at_rest(sim) == "INHIBITED (OPERATOR_STOP)"
    assert not (rig.folder / "report.json").exists()
    with pytest.raises(ProcessLookupError):
        os.killpg(tester.pid, 0)


def test_a_negative_suite_interrupted_before_it_has_met_a_controller_says_so_as_well(rig):
    tester = rig.conform(WAITS_IN_ITS_SESSION)
    tester.line("plant")
    tester.ctrl_c()
    assert tester.exit() == 3
    assert tester.lines[-1].startswith("interrupted:")
