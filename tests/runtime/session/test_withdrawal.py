"""What a session does about withdrawn registrations: a list that is asked first, and added to whatever the disk does."""

import errno
import os
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from hashlib import sha256

import pytest

from cutgate.config.load import SETTINGS_LIMIT, InputError
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.audit import names
from cutgate.runtime.audit.directory import WITHDRAWN
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.log import AuditLog, Clock, OpenInfo
from cutgate.runtime.session import withdrawal, withdrawn
from cutgate.runtime.session.withdrawal import (
    attached_registration,
    list_withdrawal,
    listed_before,
    of_session,
)
from cutgate.runtime.session.withdrawn import Withdrawal
from tests.altering import altered
from tests.logs import judged
from tests.runtime.audit.build import PATIENCE_S, Ticking, open_log
from tests.runtime.interlock.builders import READY
from tests.runtime.session.test_withdrawn import ELSEWHERE, PLACED, registration

FILE = bytes([7]) * 32
DATA = PLACED.model_dump_json(by_alias=True).encode()
MINUTE_NS = 60_000_000_000
OTHER = registration(R_T_CT=ELSEWHERE)
OURS = Withdrawal(FILE, "ours.mcap", PLACED.place, datetime(2026, 11, 28, tzinfo=UTC))
MOVED_US = since_1970_us(OURS.known)
MOVED = altered(READY, "opened.withdrawal_due", 1)


@pytest.fixture
def log(tmp_path):
    with open_log(tmp_path) as made:
        yield made


def closed_log(directory, data=DATA, minutes_ago=2):
    """A log of before, which holds a registration."""
    opened, ticking = OpenInfo("cutgate", "cutgate"), Ticking()
    before = Clock(lambda: ticking.utc_ns() - minutes_ago * MINUTE_NS, ticking.monotonic_ns)
    made = AuditLog.create(directory, log_id=os.urandom(16).hex(), opened=opened, clock=before)
    made.attach(f"{names.REGISTRATION}.json", "application/json", data)
    assert made.close(final_state="stopped", clean=True, timeout_s=PATIENCE_S).closed
    return made.path


def asked(log, file, said, skew_s=0.0):
    return withdrawn.refusal(listed_before(log), file, said, skew_s)


def test_what_was_withdrawn_here_is_known_by_file_place_and_time(log):
    assert asked(log, FILE, PLACED) == ""
    withdrawn.add(log.path.parent, [Withdrawal(FILE, "a.mcap", PLACED.place, datetime.now(UTC))])
    assert "this registration was withdrawn in a.mcap" in asked(log, FILE, PLACED)
    assert "the same place was withdrawn in a.mcap" in asked(log, bytes([1]) * 32, PLACED)
    assert "is not surely later than the withdrawal" in asked(log, bytes([1]) * 32, OTHER)


def test_the_sites_skew_is_what_is_waited_for(log):
    at = OTHER.created - timedelta(seconds=100)
    withdrawn.add(log.path.parent, [Withdrawal(FILE, "a.mcap", PLACED.place, at)])
    assert asked(log, bytes([1]) * 32, OTHER, 99.0) == ""
    assert "is not surely later" in asked(log, bytes([1]) * 32, OTHER, 100.0)


def test_a_list_that_cannot_be_read_ends_the_session_and_closes_its_log(log):
    with (log.path.parent / WITHDRAWN).open("w") as file:
        file.write("no entry\n")
    (log.path.parent / WITHDRAWN).chmod(0o600)
    with pytest.raises(InputError, match="line 1"):
        asked(log, FILE, PLACED)
    found = judged(log.path)
    assert found.report.status is Status.OK
    (closed,) = found.of("/audit/close")
    assert (closed["final_state"], closed["clean"]) == ("refused", True), "it is no crash"
    assert "line 1" in closed["outcome"]


# ---------------------------------------------------------------- lines of 0.1.0


def test_lines_of_0_1_0_stay_in_force_and_are_completed_on_the_disk(tmp_path):
    before = closed_log(tmp_path)
    file = sha256(DATA).digest()
    withdrawn.add(tmp_path, [Withdrawal(file, before.name), Withdrawal(bytes([2]) * 32, "gone.mcap")])
    began = datetime.now(UTC)
    with open_log(tmp_path) as log:
        assert f"this registration was withdrawn in {before.name}" in asked(log, file, PLACED)
        assert f"the same place was withdrawn in {before.name}" in asked(log, FILE, PLACED)
        assert "is not surely later than the withdrawal" in asked(log, FILE, OTHER)
        assert log.listed.lines == 4
    *old, known, unknown = withdrawn.load(tmp_path)
    assert [one.known for one in old] == [None, None]
    assert (known.registration, known.log, known.place) == (file, before.name, PLACED.place)
    assert (unknown.registration, unknown.log, unknown.place) == (bytes([2]) * 32, "gone.mcap", None)
    assert began <= known.known == unknown.known <= datetime.now(UTC)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), "No space left on device"),
        (OSError("gone for good"), "gone for good"),
    ],
)
def test_a_list_that_cannot_be_completed_ends_the_session(tmp_path, monkeypatch, error, said):
    withdrawn.add(tmp_path, [Withdrawal(FILE, "gone.mcap")])

    def fails(*_):
        raise error

    with open_log(tmp_path) as log:
        monkeypatch.setattr(withdrawn, "add", fails)
        with pytest.raises(InputError) as refused:
            asked(log, bytes([1]) * 32, PLACED)
    assert refused.value.problems[0].value == said


@pytest.mark.parametrize("case", ["another file", "no registration", "too large", "none", "no log"])
def test_only_the_registration_with_this_digest_is_believed(tmp_path, case):
    data = {"no registration": b"{}", "too large": DATA + b" " * 100_000}.get(case, DATA)
    path = closed_log(tmp_path, data)
    file = sha256(data).digest()
    match case:
        case "another file":
            assert attached_registration(path, bytes(32)) is None
        case "none":
            (tmp_path / "x.mcap").write_bytes(b"no log")
            assert attached_registration(tmp_path / "x.mcap", file) is None
        case "no log":
            assert attached_registration(tmp_path / "gone.mcap", file) is None
        case _:
            assert attached_registration(path, file) is None
    for name, data in (("short", DATA), ("long", DATA.ljust(SETTINGS_LIMIT))):
        whole = closed_log(tmp_path / name, data)
        assert attached_registration(whole, sha256(data).digest()).place == PLACED.place


# ---------------------------------------------------------------- a withdrawal of this session


@pytest.mark.parametrize("said", [PLACED, None])
def test_a_session_lists_its_own_registration_if_it_was_withdrawn(said):
    began = datetime.now(UTC)
    assert list(of_session(READY, "a.mcap", said, 60.0)) == []
    (entry,) = of_session(replace(READY, registration_withdrawn=True), "a.mcap", said, 60.0)
    place = None if said is None else said.place
    assert (entry.registration, entry.log, entry.place) == (READY.job.registration, "a.mcap", place)
    assert began <= entry.known <= datetime.now(UTC)


def test_a_motion_without_a_session_is_listed_for_no_place_since_when_the_controller_was_told():
    (entry,) = of_session(replace(MOVED, barrier_us=MOVED_US + 60_000_000), "a.mcap", PLACED, 60.0)
    assert entry == Withdrawal(withdrawn.NO_REGISTRATION, "a.mcap", None, OURS.known)
    both = replace(MOVED, barrier_us=MOVED_US, registration_withdrawn=True)
    assert [one.registration for one in of_session(both, "a.mcap", PLACED, 60.0)] == [
        withdrawn.NO_REGISTRATION,
        READY.job.registration,
    ]


@pytest.mark.parametrize(
    "state", [MOVED, replace(READY, barrier_us=MOVED_US), replace(READY, opened=None, barrier_us=MOVED_US)]
)
def test_what_the_controller_was_not_told_or_did_not_ask_for_is_not_listed(state):
    assert list(of_session(state, "a.mcap", PLACED, 60.0)) == []


@pytest.mark.parametrize("said", [PLACED, None])
def test_a_withdrawal_is_listed_and_is_in_the_next_head(log, said):
    notes, began = [], datetime.now(UTC)
    list_withdrawal(log, withdrawn.of_now(FILE, log.path.name, said, datetime.now(UTC)), notes.append)
    assert not notes
    assert log.listed.lines == 1
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    (entry,) = withdrawn.load(log.path.parent)
    assert (entry.registration, entry.log, entry.place) == (
        FILE,
        log.path.name,
        None if said is None else said.place,
    )
    assert began <= entry.known <= datetime.now(UTC)


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), InputError("WITHDRAWN", "", None, "not ours")]
)
def test_a_withdrawal_that_cannot_be_listed_is_told(log, monkeypatch, error):
    def fail(*_):
        raise error

    notes = []
    monkeypatch.setattr(withdrawn, "add", fail)
    list_withdrawal(log, OURS, notes.append)
    assert str(error) in notes[0]
    assert "never use this registration again, nor any that was taken before 20" in notes[0]
    assert log.listed.lines == 0
    list_withdrawal(log, replace(OURS, registration=withdrawn.NO_REGISTRATION), notes.append)
    assert "never use any registration that was taken before 20" in notes[1]


def test_the_disk_is_waited_for_five_seconds():
    assert withdrawal.WITHDRAW_S == 5.0


def test_a_disk_that_never_answers_holds_up_no_withdrawal(log, monkeypatch):
    notes, never = [], threading.Event()
    monkeypatch.setattr(withdrawn, "add", lambda *_: never.wait(PATIENCE_S))
    monkeypatch.setattr(withdrawal, "WITHDRAW_S", 0.01)
    before = set(threading.enumerate())
    list_withdrawal(log, OURS, notes.append)
    (thread,) = set(threading.enumerate()) - before
    assert (thread.name, thread.daemon) == ("withdraw", True), (
        "the end of the program does not wait for it either"
    )
    never.set()
    assert "the disk did not answer within 0.01 s" in notes[0]
