"""A bus that fails and a program that fails: the gate closes, the log is closed, and nobody believes it was clean."""

import signal

import can
import pytest

from cutgate.firmware_sim import memory
from cutgate.protocol import records
from cutgate.protocol.frames import ControllerFault, ControllerHeartbeat, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, FaultCode, StopCause
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.reading import candump_of
from cutgate.runtime.commands.app import INTERNAL, execute
from cutgate.runtime.interlock.state import Phase, Send
from cutgate.runtime.session.journal import Journal
from cutgate.runtime.session.loop import Session
from tests.runtime.session.pair import KEY, Prover
from tests.runtime.session.test_session import first_frames
from tests.runtime.session.wire import CONTROLLER, RUNTIME


@pytest.fixture
def cutting(pair):
    pair.power_up(time_scale=0.05)
    return pair.to(Phase.CUTTING).run(0.1)


def inhibited(pair):
    """Whether the arm stands within the time-out, and stays so."""
    pair.run(0.1 + 2 * pair.turn_s)
    return not pair.controller.may_move and not pair.controller.cutting_mode


# ---------------------------------------------------------------- the bus


def test_a_bus_that_fails_ends_the_runtimes_session_at_once(cutting):
    cutting.wire.nodes[RUNTIME].broken = True
    cutting.turn()
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.BUS_FAILED)
    assert inhibited(cutting)
    assert cutting.controller.cause is StopCause.HEARTBEAT_LOST
    assert cutting.close().closed
    assert cutting.read().report.status is Status.OK


def test_a_bus_that_can_only_be_written_still_carries_the_stop(cutting):
    cutting.wire.nodes[RUNTIME].deaf = True
    cutting.turn()
    assert cutting.wire.frames(RuntimeStop)[-1][1].cause is StopCause.BUS_FAILED
    assert inhibited(cutting)
    assert cutting.controller.cause is StopCause.BUS_FAILED


def test_a_bus_that_fails_under_the_stop_ends_the_session_with_the_first_cause(cutting):
    cutting.wire.nodes[RUNTIME].mute = True
    cutting.say("stop")
    assert (cutting.phase, cutting.state.cause) == (Phase.STOPPED, StopCause.OPERATOR_STOP)
    assert inhibited(cutting)
    assert cutting.close().closed
    causes = [record["cause"] for record in cutting.read().of("/audit/fault")]
    assert "BUS_FAILED" in causes


def test_a_bus_that_fails_stops_the_controller(cutting):
    cutting.wire.nodes[CONTROLLER].broken = True
    with pytest.raises(can.CanError):
        cutting.turn()
    cutting.controller_turns = False
    assert cutting.controller.cause is StopCause.BUS_FAILED
    assert not cutting.controller.may_move
    assert cutting.end() is Phase.STOPPED
    assert cutting.state.cause is StopCause.HEARTBEAT_LOST
    assert cutting.close().closed


# ---------------------------------------------------------------- the runtime's own errors


@pytest.mark.parametrize("error", [RuntimeError("no\udcffod"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("place", ["_journal", "_view"])
def test_an_error_inside_a_turn_sends_the_stop_and_is_raised(cutting, monkeypatch, place, error):
    def fail(*_arguments):
        raise error

    monkeypatch.setattr(getattr(cutting.session, place), "step", fail)
    with pytest.raises(type(error)):
        cutting.turn()
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
        pair.turn()
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
    monkeypatch.setattr("cutgate.runtime.commands.run.Worker", Prover)
    monkeypatch.setattr("cutgate.runtime.commands.run.typed", lambda _words: None)
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
        return code, read_log(path.read_bytes(), candump_of(path).read_bytes())

    return run


def test_the_command_exits_70_and_closes_the_log_as_not_clean(command, monkeypatch, capsys):
    monkeypatch.setattr(Session, "_turn", lambda *_: 1 / 0)
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
    cutting.controller_turns = False
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

    monkeypatch.setattr("cutgate.firmware_sim.memory._replace", fail)
    cutting.controller_terminal.type("bone-motion")
    cutting.turn()
    assert (cutting.controller.state, cutting.controller.cause) == (
        ControllerState.FAULT,
        StopCause.BONE_MOVED,
    )
    assert not cutting.controller.may_move
    assert cutting.end() is Phase.STOPPED
    monkeypatch.undo()
    cutting.run(0.1)
    assert memory.load(cutting.memory_file) == cutting.controller.memory


def test_an_error_of_the_controller_on_a_dead_bus_is_still_the_error(cutting, monkeypatch):
    monkeypatch.setattr(cutting.process, "_move", lambda *_: 1 / 0)
    cutting.wire.nodes[CONTROLLER].mute = True
    with pytest.raises(ZeroDivisionError):
        cutting.turn()
    assert cutting.controller.state is ControllerState.FAULT
