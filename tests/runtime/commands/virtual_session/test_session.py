"""Whole sessions in virtual time: as they are with processes, in a moment, and the same every time."""

import json
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import pytest

from cutgate.config.load import InputError
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.hil.inputs import unit_registration, write_files
from cutgate.firmware_sim.hil.virtual import VirtualRig
from cutgate.protocol.states import ControllerState
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.commands.virtual_session.session import VirtualSession
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

pytest_plugins = ["pytester"]
FAST = 8.0


@pytest.fixture
def files(tmp_path):
    (tmp_path / "files").mkdir()
    return write_files(tmp_path / "files")


@pytest.fixture
def a_rig(tmp_path, files):
    """Makes rigs; closed after the test."""
    rigs = []

    def make(**options):
        folder = tmp_path / f"rig-{len(rigs)}"
        folder.mkdir()
        rigs.append(VirtualRig(folder, files, **options))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()


@pytest.mark.parametrize("wire", [{}, {"rates": Rates(1_000_000), "queue_frames": 10}])
def test_a_cut_is_completed_and_its_log_replays(a_rig, wire):
    rig = a_rig(**wire)
    controller = rig.controller(time_scale=FAST)
    session = VirtualSession(rig)
    assert (session.document, session.cause) == (None, "")
    assert session.summary.startswith("running")
    session.cut()
    assert controller.state is ControllerState.CUTTING
    assert session.ended() == 0
    assert (session.summary, session.cause) == ("completed", "NONE")
    assert session.document["log"]["closed"]
    assert "permitted: cutting mode is on" in " ".join(session.lines)
    with reading(session.log) as log:
        assert log.report.reasons == ()
        assert replay(log, certified.verify, verifier=VERIFIER).outcome is ReplayOutcome.IDENTICAL
    rig.close()
    assert (rig.findings, rig.summary, rig.logs) == ([], "completed", [session.log])


def frames(log: Path):
    """Every frame of a session: when, since the first one, and its identifier."""
    lines = [line.split() for line in log.with_suffix(".candump.log").read_text("ascii").splitlines()]
    times = [Decimal(when.strip("()")) for when, *_ in lines]
    return [(at - times[0], frame.split("#")[0]) for at, (_, _, frame, *_) in zip(times, lines, strict=True)]


def test_the_same_frames_pass_at_the_same_times_in_every_run(a_rig):
    logs = []
    for _ in range(2):
        rig = a_rig()
        rig.controller(time_scale=FAST)
        session = VirtualSession(rig).cut()
        assert session.ended() == 0
        logs.append(frames(session.log))
    assert logs[0] == logs[1]
    assert len(logs[0]) > 200


def test_a_fault_line_stops_the_cut(a_rig):
    rig = a_rig()
    rig.controller("lose ControllerHeartbeat @cutting p=1")
    session = VirtualSession(rig).start()
    assert (session.ended(), session.cause) == (3, "HEARTBEAT_LOST")
    rig.close()
    assert "HEARTBEAT_LOST" in {finding.name for finding in rig.findings}


def test_the_operator_stops_it_and_what_comes_after_is_another_session(a_rig):
    rig = a_rig()
    controller = rig.controller()
    session = VirtualSession(rig).cut()
    session.type("stop")
    assert (session.ended(), session.cause) == (3, "OPERATOR_STOP")
    assert controller.state is not ControllerState.CUTTING
    again = VirtualSession(rig)
    rig.until(lambda: again.phase is Phase.HELD)
    assert again.log.parent != session.log.parent


def test_a_cut_that_is_not_admissible_is_not_admitted_and_where_to_move_the_bone_is_said(
    a_rig, files, tmp_path
):
    away = unit_registration()
    away["R_T_CT"] = [[1, 0, 0, 600], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    registration = tmp_path / "away.json"
    registration.write_text(json.dumps(away), encoding="utf-8")
    rig = a_rig()
    rig.controller()
    session = VirtualSession(rig, replace(files, registration=registration))
    with pytest.raises(AssertionError, match="not permitted, but"):
        session.permitted()
    assert session.ended() == 1
    assert session.document["verdict"]["guidance"]
    rig.close()
    assert [finding.name for finding in rig.findings] == ["not-admitted"]


def test_a_session_that_the_test_leaves_running_is_ended_and_found_once(a_rig):
    rig = a_rig()
    controller = rig.controller()
    VirtualSession(rig).cut()
    rig.close()
    assert [finding.name for finding in rig.findings] == ["unfinished"]
    assert controller.state is not ControllerState.CUTTING


def test_files_that_are_refused_begin_no_session(a_rig, files):
    files.plan.write_text("{}", encoding="utf-8")
    rig = a_rig()
    with pytest.raises(InputError, match="schema"):
        VirtualSession(rig)
    assert rig.sessions == []


def test_who_has_no_simulated_controller_is_told(a_rig):
    with pytest.raises(LookupError, match=r"call cutgate_virtual.controller"):
        a_rig().type("hold")


TESTS = """
    import pytest

    @pytest.mark.cutgate_wire("1M")
    def test_a_cut(cutgate_virtual, cutgate_virtual_session):
        cutgate_virtual.controller(time_scale=8)
        session = cutgate_virtual_session().cut()
        assert session.ended() == 0
        assert cutgate_virtual.time.medium.totals.error_frames == 0

    @pytest.mark.cutgate_faults("lose ControllerHeartbeat @cutting p=1")
    @pytest.mark.cutgate_expect("HEARTBEAT_LOST")
    def test_lost(cutgate_virtual, cutgate_virtual_session):
        cutgate_virtual.controller()
        assert cutgate_virtual_session().start().ended() == 3

    def test_forgotten(cutgate_virtual, cutgate_virtual_session):
        cutgate_virtual.controller()
        cutgate_virtual_session().cut()

    @pytest.mark.cutgate_wire("1G")
    def test_no_rate(cutgate_virtual):
        pass
"""


@pytest.mark.processes
def test_the_fixture_has_the_health_check_the_wire_and_what_is_kept(pytester):
    pytester.makepyfile(TESTS)
    done = pytester.runpytest_subprocess("-p", "no:cacheprovider", "--cutgate-matrix", "m.md")
    done.assert_outcomes(passed=2, failed=1, errors=1)
    done.stdout.fnmatch_lines(["*unfinished: it had to be ended*", "*logs-report.html"])
    done.stdout.fnmatch_lines(["*cutgate_wire: '1G': give 10k to 8M*"])
    page = (pytester.path / "m.md").read_text("utf-8")
    assert "3 tests with sessions, 1 different faults, 1 tests failed." in page
