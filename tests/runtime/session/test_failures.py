"""A bus that fails and a program that fails: the gate closes, the log is closed, and nobody believes it was clean."""

import signal

import can
import pytest

from cutgate.firmware_sim import memory
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerFault, ControllerHeartbeat, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, FaultCode, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.commands.app import INTERNAL, execute
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import HeartbeatReceived, Phase, Send
from cutgate.runtime.interlock.table import TABLE
from cutgate.runtime.session.journal import Journal
from cutgate.runtime.session.loop import Session
from tests.logs import judged
from tests.runtime.session.pair import KEY, Prover
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import CONTROLLER, RUNTIME


@pytest.fixture
def cutting(pair):
    pair.power_up(time_scale=0.05)
    return pair.to(Phase.CUTTING).run(0.1)


def inhibited(pair):
    """Whether the arm stands within the time-out, and stays so."""
    pair.run(0.1 + 2 * pair.cycle_s)
    return not pair.controller.may_move and not pair.controller.cutting_mode


# ---------------------------------------------------------------- the bus


def test_a_bus_that_fails_ends_the_runtimes_session_at_once(cutting):
    cutting.wire.nodes[RUNTIME].broken = True
    cutting.run_cycle()
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.BUS_FAILED)
    assert inhibited(cutting)
    assert cutting.controller.cause is StopCause.HEARTBEAT_LOST
    assert cutting.close().closed
    last, _ = recorded(cutting)
    assert (last["event"], last["first_out"]) == ("gave up BUS_FAILED", "BUS_FAILED")
    assert "send STOP BUS_FAILED" in last["effects"]
    assert cutting.read().of("/audit/close")[-1]["clean"] is True


def test_a_bus_that_can_only_be_written_still_carries_the_stop(cutting):
    cutting.wire.nodes[RUNTIME].deaf = True
    cutting.run_cycle()
    assert cutting.wire.frames(RuntimeStop)[-1][1].cause is StopCause.BUS_FAILED
    assert inhibited(cutting)
    assert cutting.controller.cause is StopCause.BUS_FAILED


def test_a_bus_that_fails_under_the_stop_ends_the_session_with_the_first_cause(cutting):
    cutting.wire.nodes[RUNTIME].mute = True
    cutting.say("stop")
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.OPERATOR_STOP)
    assert inhibited(cutting)
    assert cutting.close().closed
    last, fault = recorded(cutting, "stopping")
    assert (fault["cause"], last["first_out"]) == ("BUS_FAILED", "OPERATOR_STOP")


def test_a_bus_that_fails_once_under_the_stop_is_not_trusted_again(cutting, monkeypatch):
    """The stop itself was lost with it; what leaves later in the same cycle changes nothing."""
    node = cutting.wire.nodes[RUNTIME]
    send, failures = node.send, iter([can.CanOperationError("once")])

    def fails_once(message, timeout=None):
        for failure in failures:
            raise failure
        send(message, timeout)

    monkeypatch.setattr(node, "send", fails_once)
    cutting.say("stop")
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.OPERATOR_STOP)
    assert inhibited(cutting)
    assert cutting.close().closed
    last, fault = recorded(cutting, "stopping")
    assert (fault["cause"], last["first_out"]) == ("BUS_FAILED", "OPERATOR_STOP")
    assert "once" in fault["detail"]


def test_what_the_controller_said_before_the_bus_failed_counts(cutting, monkeypatch):
    """The hub ends: a client reads what still waits, and then that it has ended, in the same cycle."""
    node = cutting.wire.nodes[RUNTIME]
    recv = node.recv

    def recv_to_the_end(timeout):
        message = recv(timeout)
        if message is None:
            raise can.CanOperationError("the bus is gone")
        return message

    cutting.controller_terminal.type("bone-motion")
    cutting.runtime_runs = False
    cutting.run_cycle()
    cutting.runtime_runs = True
    monkeypatch.setattr(node, "recv", recv_to_the_end)
    assert cutting.end() is Phase.STOPPED
    assert cutting.state.cause is StopCause.BONE_MOVED
    assert cutting.state.registration_withdrawn


def test_a_bus_that_fails_stops_the_controller(cutting):
    cutting.wire.nodes[CONTROLLER].broken = True
    with pytest.raises(can.CanError):
        cutting.run_cycle()
    cutting.controller_runs = False
    assert cutting.controller.cause is StopCause.BUS_FAILED
    assert not cutting.controller.may_move
    assert cutting.end() is Phase.STOPPED
    assert cutting.state.cause is StopCause.HEARTBEAT_LOST
    assert cutting.close().closed


# ---------------------------------------------------------------- the runtime's own errors


def recorded(pair, came_from="cutting"):
    """The one decision that ended the session, and the fault beside it; the log holds together."""
    log = pair.read()
    assert log.report.status is Status.OK
    (last,) = [entry for entry in log.of("/audit/decision") if entry["to_state"] == "stopped"]
    (fault,) = [entry for entry in log.of("/audit/fault") if entry["cause"] == last["event"].split()[-1]]
    assert last["from_state"] == came_from
    assert (fault["source"], fault["code"]) == ("runtime", "STOP")
    assert fault["detail"] in last["reason"]
    return last, fault


@pytest.mark.parametrize("error", [RuntimeError("no\udcffod"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("place", ["_journal", "_view"])
def test_an_error_inside_a_turn_sends_the_stop_and_is_raised(cutting, monkeypatch, place, error):
    def fail(*_arguments):
        raise error

    monkeypatch.setattr(getattr(cutting.session, place), "step", fail)
    with pytest.raises(type(error)):
        cutting.run_cycle()
    stop = cutting.wire.frames(RuntimeStop)[-1]
    assert (stop[0].at_s, stop[1].cause) == (cutting.clock(), StopCause.INTERNAL_ERROR)
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.INTERNAL_ERROR)
    beats = len(cutting.wire.frames(RuntimeHeartbeat))
    assert inhibited(cutting)
    assert len(cutting.wire.frames(RuntimeHeartbeat)) == beats
    assert (cutting.controller.state, cutting.controller.cause) == (
        ControllerState.FAULT,
        StopCause.INTERNAL_ERROR,
    )
    monkeypatch.undo()
    assert cutting.close(clean=False).closed
    closed = cutting.read().of("/audit/close")[-1]
    assert (closed["clean"], closed["final_state"]) == (False, "stopped")
    assert closed["outcome"].startswith("internal error: ")
    last, _ = recorded(cutting)
    assert (last["event"], last["first_out"]) == ("gave up INTERNAL_ERROR", "INTERNAL_ERROR")
    by_the_table = "internal error: " if place == "_view" else "without the table: internal error: "
    assert last["reason"].startswith(by_the_table + type(error).__name__)


def broken(*_arguments, **_named):
    raise RuntimeError("broken")


@pytest.fixture(params=["a handler", "the table"])
def breaks(request, cutting, monkeypatch):
    """What raises when the next heartbeat is judged: its handler alone, or the table whatever it is asked."""
    if request.param == "a handler":
        monkeypatch.setitem(TABLE, (Phase.CUTTING, HeartbeatReceived), broken)
    else:
        monkeypatch.setattr("cutgate.runtime.session.loop.step", broken)
    return request.param


def test_a_decision_that_raises_ends_in_a_stop_a_decision_and_a_fault(cutting, breaks, monkeypatch):
    """The table decides the end as long as it can; without it the stop leaves all the same, and the log says so."""
    with pytest.raises(RuntimeError, match="broken"):
        cutting.run(0.1)
    stop = cutting.wire.frames(RuntimeStop)[-1]
    assert (stop[0].at_s, stop[1].cause) == (cutting.clock(), StopCause.INTERNAL_ERROR)
    assert len(cutting.wire.frames(RuntimeStop)) == 1
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.INTERNAL_ERROR)
    assert (cutting.state.permit, cutting.state.nonce, cutting.state.tracking) == (None, None, None)
    assert inhibited(cutting)
    monkeypatch.undo()
    assert cutting.close(clean=False).closed
    last, fault = recorded(cutting)
    assert (last["event"], last["first_out"]) == ("gave up INTERNAL_ERROR", "INTERNAL_ERROR")
    assert fault["detail"] == "internal error: RuntimeError: broken"
    assert ("send STOP INTERNAL_ERROR" in last["effects"]) is (breaks == "a handler")
    assert last["reason"].startswith("without the table: ") is (breaks == "the table")
    closed = cutting.read().of("/audit/close")[-1]
    assert (closed["clean"], closed["outcome"]) == (False, "internal error: RuntimeError: broken")


@pytest.fixture
def permitting(pair):
    """The permit is on its way, and its controller takes no more of it."""
    pair.to(Phase.PERMITTING).controller_runs = False
    return pair


def test_the_log_says_of_what_waits_that_it_never_leaves_where_the_program_fails(permitting, monkeypatch):
    assert permitting.session._port.endpoint.control_waits
    monkeypatch.setattr(permitting.session, "_read_disk", broken)
    with pytest.raises(RuntimeError):
        permitting.run_cycle()
    monkeypatch.undo()
    permitting.close(clean=False)
    (withheld,) = [one for one in permitting.read().of("/audit/permit") if one["stage"] == "withheld"]
    assert (withheld["kind"], withheld["reason"].split(":")[0]) == ("permit", "void")


def test_what_waits_is_void_also_where_the_log_cannot_say_so(permitting, monkeypatch):
    monkeypatch.setattr(permitting.session, "_read_disk", broken)
    monkeypatch.setattr(permitting.journal, "voided", broken)
    with pytest.raises(RuntimeError):
        permitting.run_cycle()
    assert not permitting.session._port.endpoint.control_waits
    assert permitting.wire.frames(RuntimeStop)[-1][1].cause is StopCause.INTERNAL_ERROR


def test_where_the_session_stood_when_it_failed_is_told(cutting, breaks):
    assert cutting.session.stopped_in is None
    with pytest.raises(RuntimeError, match="broken"):
        cutting.run(0.1)
    assert cutting.session.stopped_in is Phase.CUTTING, breaks


def test_an_error_between_two_turns_is_one_of_a_turn(cutting, monkeypatch):
    monkeypatch.setattr(cutting.session, "_wait", broken)
    with pytest.raises(RuntimeError):
        cutting.session.run(cutting.wake[0])
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.INTERNAL_ERROR)
    assert [stop.cause for _, stop in cutting.wire.frames(RuntimeStop)] == [StopCause.INTERNAL_ERROR]


def test_an_error_while_the_session_is_stopping_keeps_the_first_cause(cutting, monkeypatch):
    cutting.say("stop")
    assert cutting.phase is Phase.STOPPING
    monkeypatch.setattr(cutting.session, "_read_disk", broken)
    with pytest.raises(RuntimeError):
        cutting.run_cycle()
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.OPERATOR_STOP)
    assert [stop.cause for _, stop in cutting.wire.frames(RuntimeStop)] == [
        StopCause.OPERATOR_STOP,
        StopCause.INTERNAL_ERROR,
    ]
    monkeypatch.undo()
    cutting.close(clean=False)
    last, _ = recorded(cutting, "stopping")
    assert (last["first_out"], last["reason"]) == ("OPERATOR_STOP", "internal error: RuntimeError: broken")


def test_an_error_after_the_end_of_the_session_still_sends_a_stop(cutting, monkeypatch):
    """The session had ended, but perhaps its word had not left."""
    honest = cutting.notes.step

    def fail(before, event, after, effects, now_s):
        honest(before, event, after, effects, now_s)
        if after.phase in ENDED:
            raise RuntimeError("broken")

    monkeypatch.setattr(cutting.notes, "step", fail)
    cutting.say("stop")
    with pytest.raises(RuntimeError):
        cutting.end()
    assert cutting.phase is Phase.STOPPED
    assert [stop.cause for _, stop in cutting.wire.frames(RuntimeStop)] == [
        StopCause.OPERATOR_STOP,
        StopCause.INTERNAL_ERROR,
    ]


def test_a_log_that_takes_nothing_any_more_holds_up_neither_the_stop_nor_the_error(cutting, monkeypatch):
    monkeypatch.setattr(cutting.log, "write", broken)
    monkeypatch.setattr("cutgate.runtime.session.loop.step", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cutting.run_cycle()
    assert cutting.wire.frames(RuntimeStop)[-1][1].cause is StopCause.INTERNAL_ERROR
    assert inhibited(cutting)


def test_an_error_while_a_permit_is_recorded_lets_no_permit_leave(pair, monkeypatch):
    pair.begin()
    write = pair.journal.step

    def fail(before, event, after, effects, now_s):
        if any(isinstance(effect, Send) and isinstance(effect.record, records.Permit) for effect in effects):
            raise OSError("no")
        write(before, event, after, effects, now_s)

    monkeypatch.setattr(pair.journal, "step", fail)
    with pytest.raises(OSError, match="no"):
        pair.end()
    assert not first_frames(pair, records.Permit)
    assert inhibited(pair)


def test_an_error_before_the_link_is_open_sends_nothing(pair, monkeypatch):
    pair.begin()
    monkeypatch.setattr(pair.journal, "step", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        pair.run_cycle()
    assert pair.state.cause is StopCause.INTERNAL_ERROR
    assert not pair.wire.frames(RuntimeStop)


def test_an_error_on_a_bus_that_has_failed_as_well_is_still_the_error(cutting, monkeypatch):
    monkeypatch.setattr(cutting.journal, "step", lambda *_: 1 / 0)
    cutting.wire.nodes[RUNTIME].mute = True
    with pytest.raises(ZeroDivisionError):
        cutting.run(0.1)
    assert inhibited(cutting)


@pytest.fixture
def command(pair, monkeypatch, tmp_path):
    """``cutgate run`` on a bus in memory; its exit code and its log."""
    directory = pair.files.prepared.plan.path.parent
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    node = pair.wire.nodes[RUNTIME]
    monkeypatch.setattr("cutgate.runtime.commands.run._bus", lambda *_, **_fd: (node, "test/a\udcffb"))
    monkeypatch.setattr("cutgate.runtime.session.conduct.Worker", Prover)
    monkeypatch.setattr("cutgate.runtime.session.conduct.typed", lambda _commands: None)
    monkeypatch.setattr("sys.argv", ["cutgate", "run", "pl\udcffan"])
    monkeypatch.setattr(node, "shutdown", lambda: None)

    def run():
        code = execute(
            [
                *("run", str(directory / "plan.csv"), "--robot", str(directory / "robot.toml")),
                *("--registration", str(directory / "registration.json")),
                *("--key", str(key), "--log-dir", str(tmp_path / "command")),
            ]
        )
        (path,) = (tmp_path / "command").glob("*.mcap")
        return code, judged(path)

    return run


def test_the_command_exits_70_and_closes_the_log_as_not_clean(command, monkeypatch, capsys):
    monkeypatch.setattr(Session, "_run_cycle", lambda *_: 1 / 0)
    code, log = command()
    assert code == INTERNAL
    assert "internal error: ZeroDivisionError" in capsys.readouterr().err
    assert log.report.status is Status.OK
    assert log.of("/audit/close")[0]["clean"] is False
    assert log.of("/audit/process")[0]["argv"] == ["cutgate", "run", "pl\\udcffan"]


def test_a_second_interrupt_while_the_log_is_closed_leaves_it_whole(command, monkeypatch):
    begin, close = Session.begin, Journal.close

    def begin_and_quit(session, wake):
        begin(session, wake)
        signal.raise_signal(signal.SIGINT)

    def close_under_a_signal(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return close(*arguments, **options)

    monkeypatch.setattr(Session, "begin", begin_and_quit)
    monkeypatch.setattr(Journal, "close", close_under_a_signal)
    code, log = command()
    assert code == 3
    assert log.report.status is Status.OK
    assert log.of("/audit/close")[0]["clean"] is True


# ---------------------------------------------------------------- the controller's own errors


@pytest.mark.parametrize("place", ["_move", "_item", "_speak"])
def test_an_error_inside_the_controllers_turn_latches_and_is_raised(cutting, monkeypatch, place):
    monkeypatch.setattr(cutting.process, place, lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cutting.run(0.1)
    cutting.controller_runs = False
    monkeypatch.undo()
    assert (cutting.controller.state, cutting.controller.cause) == (
        ControllerState.FAULT,
        StopCause.INTERNAL_ERROR,
    )
    fault = cutting.wire.frames(ControllerFault)[-1][1]
    assert (fault.code, fault.cause) == (FaultCode.LATCHED, StopCause.INTERNAL_ERROR)
    beats = len(cutting.wire.frames(ControllerHeartbeat))
    assert cutting.end() is Phase.STOPPED
    assert cutting.state.cause is StopCause.INTERNAL_ERROR
    assert len(cutting.wire.frames(ControllerHeartbeat)) == beats


def test_a_memory_that_cannot_be_written_latches(cutting, monkeypatch):
    def fail(*_):
        raise OSError("full")

    monkeypatch.setattr("cutgate.firmware_sim.memory.replace_durably", fail)
    cutting.controller_terminal.type("bone-motion")
    cutting.run_cycle()
    assert (cutting.controller.state, cutting.controller.cause) == (
        ControllerState.FAULT,
        StopCause.BONE_MOVED,
    )
    assert not cutting.controller.may_move
    assert cutting.end() is Phase.STOPPED
    monkeypatch.undo()
    cutting.run(0.1)
    assert memory.load(cutting.memory_file, now_us=0) == cutting.controller.memory


def test_an_error_of_the_controller_on_a_dead_bus_is_still_the_error(cutting, monkeypatch):
    monkeypatch.setattr(cutting.process, "_move", lambda *_: 1 / 0)
    cutting.wire.nodes[CONTROLLER].mute = True
    with pytest.raises(ZeroDivisionError):
        cutting.run_cycle()
    assert cutting.controller.state is ControllerState.FAULT
