"""What ``cutgate run`` does about its log: whom it tells what, and that a log that was not closed is no success."""

import os
import socket
import threading
from types import SimpleNamespace

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit.directory import WITHDRAWN, Previous
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.log import AuditLog, Paths
from cutgate.runtime.commands import run as command
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session import withdrawn
from cutgate.runtime.verification.asked import BEST
from tests.runtime.audit.build import LOG_ID, OPENED, PATIENCE_S, small_log
from tests.runtime.audit.test_directory import Later
from tests.runtime.interlock.builders import DEADLINES, TIMING


class Screen(list):
    """A view that keeps its notes."""

    note = list.append


@pytest.fixture
def log(tmp_path):
    small_log(tmp_path)
    made = AuditLog.create(tmp_path, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    yield made
    if made.writable:
        made.close(final_state="done", clean=True, timeout_s=PATIENCE_S)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("phase", sorted(ENDED))
def test_a_session_whose_log_was_not_closed_exits_3_however_it_ended(
    tmp_path, tmp_path_factory, monkeypatch, phase, closed
):
    from tests.runtime.session.pair import job_of  # noqa: PLC0415 - it imports both sides of the bus

    files, job = job_of(tmp_path_factory)
    session = SimpleNamespace(
        state=SimpleNamespace(phase=phase, reason="", controller=None), answer=None, stopped_in=None
    )
    paths = Paths(tmp_path / "a.mcap", tmp_path / "a.candump.log", closed, "" if closed else "it was deleted")
    for name, value in {
        "read_files": lambda *_, **__: files,
        "_key": lambda *_: bytes(32),
        "make_job": lambda *_, **__: job,
        "Check": lambda *_: None,
        "_bus": lambda *_, **__: (SimpleNamespace(shutdown=lambda: None), "test/x"),
        "_session": lambda *_, **__: (session, paths),
    }.items():
        monkeypatch.setattr(command, name, value)
    words = ["run", "plan.csv", "--robot", "r", "--registration", "g", "--log-dir", str(tmp_path / "logs")]
    expected = {Phase.DONE: 0, Phase.REFUSED: 1, Phase.STOPPED: 3}[phase] if closed else 3
    assert execute(words) == expected


@pytest.mark.parametrize(
    ("previous", "told"),
    [
        (Previous(), []),
        (Previous("a.mcap", "ab"), []),
        (
            Previous("a.mcap", "ab", crashed=True),
            ["the session before this one (a.mcap) did not end in order"],
        ),
        (
            Previous(None, None, crashed=True, note="HEAD could not be read: why"),
            [
                "the session before this one (its log is unknown) did not end in order",
                "the log directory: HEAD could not be read: why",
            ],
        ),
        (Previous("a.mcap", "ab", note="a.mcap is gone"), ["the log directory: a.mcap is gone"]),
    ],
)
def test_the_operator_is_told_what_is_wrong_with_the_session_before(previous, told):
    screen = Screen()
    command._tell(previous, screen)
    assert screen == told


def test_a_registration_that_was_withdrawn_here_is_known(log):
    assert command._withdrawn_in(log, bytes(32)) is None
    withdrawn.add(log.path.parent, bytes(32), "a.mcap")
    assert command._withdrawn_in(log, bytes(32)) == "a.mcap"


def test_a_list_that_cannot_be_read_ends_the_session_and_closes_its_log(log):
    with (log.path.parent / WITHDRAWN).open("w") as file:
        file.write("no entry\n")
    (log.path.parent / WITHDRAWN).chmod(0o600)
    with pytest.raises(InputError, match="line 1"):
        command._withdrawn_in(log, bytes(32))
    found = read_log(log.path.read_bytes(), log.candump_path.read_bytes())
    assert found.report.status is Status.OK
    (closed,) = found.of("/audit/close")
    assert closed["final_state"] == "refused"
    assert "line 1" in closed["outcome"]


def test_a_withdrawal_is_listed_and_is_in_the_next_head(log):
    screen = Screen()
    command._withdraw(log, bytes(32), screen)
    assert not screen
    assert log.listed.lines == 1
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert withdrawn.load(log.path.parent) == {bytes(32): log.path.name}


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), InputError("WITHDRAWN", "", None, "not ours")]
)
def test_a_withdrawal_that_cannot_be_listed_is_told(log, monkeypatch, error):
    def fail(*_):
        raise error

    screen = Screen()
    monkeypatch.setattr(withdrawn, "add", fail)
    command._withdraw(log, bytes(32), screen)
    assert str(error) in screen[0]
    assert "never use this registration again" in screen[0]
    assert log.listed.lines == 0


def test_a_disk_that_never_answers_holds_up_no_withdrawal(log, monkeypatch):
    screen, never = Screen(), threading.Event()
    monkeypatch.setattr(withdrawn, "add", lambda *_: never.wait(PATIENCE_S))
    monkeypatch.setattr(command, "WITHDRAW_S", 0.01)
    command._withdraw(log, bytes(32), screen)
    never.set()
    assert "the disk did not answer within 0.01 s" in screen[0]


def test_a_verification_process_that_cannot_be_started_leaves_a_closed_log(log, monkeypatch):
    def none_left(_path):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(command.Worker, "start", none_left)
    state = SimpleNamespace(
        job=SimpleNamespace(timing=TIMING, deadlines=DEADLINES, path=b"", fd=False), phase=Phase.WAITING
    )
    with pytest.raises(OSError, match="temporarily unavailable"):
        command._session(None, None, state, b"", None, "a/b", log, None, None, fd=False)
    found = read_log(log.path.read_bytes(), log.candump_path.read_bytes())
    assert found.report.status is Status.OK
    (closed,) = found.of("/audit/close")
    assert (closed["clean"], closed["outcome"]) == (False, "the verification process cannot be started")


@pytest.mark.processes
@pytest.mark.parametrize("operator", [None, "Dr. Müller"])
def test_the_log_says_who_ran_the_session_and_where(tmp_path, tmp_path_factory, operator):
    from tests.runtime.session.pair import job_of  # noqa: PLC0415 - it imports both sides of the bus

    files, job = job_of(tmp_path_factory)
    log = command._log(tmp_path, files, job.path, "test/x", BEST, operator)
    log.close(final_state=Phase.WAITING, outcome="x", clean=True)
    (opened,) = read_log(log.path.read_bytes(), log.candump_path.read_bytes()).of("/audit/open")
    assert opened.get("operator") == operator
    assert str(os.getuid()) in opened["account"]
    assert opened["host"] == socket.gethostname()
