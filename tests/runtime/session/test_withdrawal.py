"""What a session does about withdrawn registrations: a list that is asked first, and added to whatever the disk does."""

import threading

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit.directory import WITHDRAWN
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.session import withdrawal, withdrawn
from cutgate.runtime.session.withdrawal import list_withdrawal, withdrawn_in
from tests.runtime.audit.build import PATIENCE_S, open_log


@pytest.fixture
def log(tmp_path):
    with open_log(tmp_path) as made:
        yield made


def test_a_registration_that_was_withdrawn_here_is_known(log):
    assert withdrawn_in(log, bytes(32)) is None
    withdrawn.add(log.path.parent, bytes(32), "a.mcap")
    assert withdrawn_in(log, bytes(32)) == "a.mcap"


def test_a_list_that_cannot_be_read_ends_the_session_and_closes_its_log(log):
    with (log.path.parent / WITHDRAWN).open("w") as file:
        file.write("no entry\n")
    (log.path.parent / WITHDRAWN).chmod(0o600)
    with pytest.raises(InputError, match="line 1"):
        withdrawn_in(log, bytes(32))
    found = read_log(log.path.read_bytes(), log.candump_path.read_bytes())
    assert found.report.status is Status.OK
    (closed,) = found.of("/audit/close")
    assert closed["final_state"] == "refused"
    assert "line 1" in closed["outcome"]


def test_a_withdrawal_is_listed_and_is_in_the_next_head(log):
    notes = []
    list_withdrawal(log, bytes(32), notes.append)
    assert not notes
    assert log.listed.lines == 1
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert withdrawn.load(log.path.parent) == {bytes(32): log.path.name}


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), InputError("WITHDRAWN", "", None, "not ours")]
)
def test_a_withdrawal_that_cannot_be_listed_is_told(log, monkeypatch, error):
    def fail(*_):
        raise error

    notes = []
    monkeypatch.setattr(withdrawn, "add", fail)
    list_withdrawal(log, bytes(32), notes.append)
    assert str(error) in notes[0]
    assert "never use this registration again" in notes[0]
    assert log.listed.lines == 0


def test_a_disk_that_never_answers_holds_up_no_withdrawal(log, monkeypatch):
    notes, never = [], threading.Event()
    monkeypatch.setattr(withdrawn, "add", lambda *_: never.wait(PATIENCE_S))
    monkeypatch.setattr(withdrawal, "WITHDRAW_S", 0.01)
    list_withdrawal(log, bytes(32), notes.append)
    never.set()
    assert "the disk did not answer within 0.01 s" in notes[0]
