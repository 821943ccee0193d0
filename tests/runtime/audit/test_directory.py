"""The log directory: HEAD is held against the log it names, the list of withdrawn registrations gets no shorter."""

import contextlib
import json
import os
import shutil
from dataclasses import replace
from hashlib import sha256
from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import SeekingReader

from cutgate.config.load import InputError
from cutgate.runtime.audit import directory, records
from cutgate.runtime.audit.directory import (
    HEAD,
    LOCK,
    WITHDRAWN,
    Head,
    Listed,
    Previous,
    check_clock,
    extend_list,
    lock,
    previous_session,
    remove_left_over,
    withdrawn_list,
)
from cutgate.runtime.audit.heads import closing_head, recoverable_head
from cutgate.runtime.audit.inspect import read_log, verify_log
from cutgate.runtime.audit.writer import LogWriter
from tests.logs import create
from tests.runtime.audit.build import LOG_ID, OPENED, PATIENCE_S, Ticking, forge, small_log

HEX = "ab" * 32
LINES = (b"one line\n", b"another\n", b"a third\n")


@pytest.fixture
def logs(tmp_path):
    """A directory with one session's log, closed in order."""
    small_log(tmp_path)
    return tmp_path


def head_of(logs):
    return Head.parse((logs / HEAD).read_bytes())


def log_of(logs):
    return logs / head_of(logs).log


class Later(Ticking):
    """A second session cannot have the first one's file name."""

    def __init__(self):
        super().__init__()
        self.now_ns += 60_000_000_000


def next_session(logs):
    """What record 0 of the next session says."""
    log = create(logs, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    paths = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert paths.closed
    return read_log(paths.log.read_bytes()).of("/audit/open")[0]


# ---------------------------------------------------------------- what HEAD says


HEADS = st.builds(
    Head,
    log=st.from_regex(r"[0-9A-Za-z-]{1,40}\.mcap", fullmatch=True),
    head=st.none() | st.just(HEX),
    closed=st.booleans(),
    listed=st.none() | st.builds(Listed, st.integers(0, 10**6), st.just(HEX)),
    time_ns=st.none() | st.integers(0, 2**63 - 1),
)


@given(HEADS)
def test_a_head_is_read_as_it_was_written(head):
    assert Head.parse(head.encode()) == head
    assert len(head.encode()) <= directory.HEAD_MAX


def test_a_head_of_0_1_0_says_nothing_of_the_list_and_no_time():
    old = {"schema": "cutgate.head/1", "log": "a.mcap", "state": "closed", "head": HEX}
    assert Head.parse(json.dumps(old).encode()) == Head("a.mcap", HEX, closed=True, listed=None, time_ns=None)


@pytest.mark.parametrize("time_ns", [0, 2**63 - 1])
def test_the_times_that_a_head_can_hold(time_ns):
    head = Head("a.mcap", HEX, closed=True, time_ns=time_ns)
    assert Head.parse(head.encode()) == head


@pytest.mark.parametrize(
    "change",
    [
        {"log": "../a.mcap"}, {"log": ".."}, {"log": ""}, {"log": 7}, {"head": 7}, {"withdrawn": []}, {"withdrawn": [1]},
        {"withdrawn": {"lines": 1}}, {"withdrawn": {"lines": "1", "sha256": HEX}}, {"withdrawn": 7},
        {"withdrawn": {"lines": 1, "sha256": 7}}, {"time_ns": "1"}, {"time_ns": 1.5}, {"time_ns": -1}, {"time_ns": 1 << 63},
    ],
)  # fmt: skip
def test_what_is_no_head_is_none(change):
    sound = {"log": "a.mcap", "state": "closed", "head": HEX}
    Head.parse(json.dumps(sound).encode())
    with pytest.raises(ValueError):
        Head.parse(json.dumps(sound | change).encode())


@pytest.mark.parametrize("content", [b"", b"[]", b"7", b"{", b"[" * 5000, b"\xff"])
def test_what_is_no_document_is_no_head(content):
    with pytest.raises(ValueError):
        Head.parse(content)


# ---------------------------------------------------------------- HEAD against its log


def test_a_head_that_cannot_be_read_is_taken_for_a_crash_and_says_why(logs):
    (logs / HEAD).write_bytes(b"{")
    found = previous_session(logs)
    assert (found.log, found.head, found.crashed) == (None, None, True)
    assert found.note.startswith("HEAD could not be read: ")


def test_a_log_that_is_what_head_says_has_no_note(logs):
    opened = next_session(logs)
    assert (opened["previous_log"], opened["previous_crashed"]) == ("20260921T141321Z-01234567.mcap", False)
    assert "previous_note" not in opened


def gone(log):
    log.unlink()


def cut(log):
    log.write_bytes(log.read_bytes()[:-1])


def emptied(log):
    log.write_bytes(b"")


def another(log):
    """Another session's log under this name: sound, closed, and not the one."""
    log.write_bytes(forge(log.read_bytes(), lambda record: record.model_copy(update={"outcome": "other"})
                          if hasattr(record, "outcome") else record))  # fmt: skip


def somebody_elses(log):
    log.chmod(0o666)


def linked(log):
    log.rename(log.with_name("moved"))
    log.symlink_to("moved")


def no_chunk(log):
    log.write_bytes(b"\x89MCAP0\r\n" + bytes(100))


@pytest.mark.parametrize("act", [gone, cut, emptied, another, somebody_elses, linked, no_chunk])
def test_a_log_that_is_not_what_head_says_is_noted_in_record_0(logs, act):
    log, head = log_of(logs), head_of(logs).head
    act(log)
    opened = next_session(logs)
    assert (opened["previous_log"], opened["previous_head"]) == (log.name, head)
    assert opened["previous_crashed"] is False
    assert f"{log.name} is not what HEAD says" in opened["previous_note"]


def crash(logs):
    """The session died with its process: HEAD says open, the log has no end."""
    head, log = head_of(logs), log_of(logs)
    (logs / HEAD).write_bytes(replace(head, head=None, closed=False).encode())
    os.truncate(log, log.stat().st_size - 1000)
    return log


def test_after_a_crash_the_head_is_that_of_all_whole_chunks(logs):
    log = crash(logs)
    previous = previous_session(logs)
    assert (previous.crashed, previous.log, previous.note) == (True, log.name, None)
    assert previous.head == recoverable_head(BytesIO(log.read_bytes())) == verify_log(log.read_bytes()).head


@pytest.mark.parametrize("act", [gone, somebody_elses, linked])
def test_a_crashed_log_that_cannot_be_believed_is_noted(logs, act):
    log = crash(logs)
    act(log)
    previous = previous_session(logs)
    assert (previous.crashed, previous.log, previous.head) == (True, log.name, None)
    assert "its log could not be read: " in previous.note


def test_a_last_chunk_that_is_longer_than_any_is_not_read(logs, monkeypatch):
    class Boasting(SeekingReader):
        def get_summary(self):
            summary = super().get_summary()
            summary.chunk_indexes[-1].chunk_length = 1 << 40
            return summary

    monkeypatch.setattr("cutgate.runtime.audit.heads.SeekingReader", Boasting)
    with pytest.raises(ValueError, match="its last chunk is longer than any"):
        closing_head(BytesIO(log_of(logs).read_bytes()))


def test_a_log_whose_last_chunk_is_linked_on_to_nothing_has_no_closing_head():
    writer = LogWriter("ab", {})
    frame = {"is_rtr": False, "is_extended": False, "is_error": False, "dlc": 0, "data": ""}
    stamp = records.Time.of(0)
    record = records.CanFrame(stamp=stamp, direction="sent", id=1, **frame)
    writer.add(record, log_time_ns=0, monotonic_ns=0)
    writer.finish()
    with pytest.raises(ValueError, match="nothing in its last chunk is linked on"):
        closing_head(BytesIO(writer.take()))


def test_frames_before_the_first_linked_record_of_the_last_chunk_need_no_head(logs):
    """What a session closes with: frames, then the close record."""
    log = create(logs, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    log.commit(None)
    frame = {"is_rtr": False, "is_extended": False, "is_error": False, "dlc": 0, "data": ""}
    log.write(records.CanFrame(stamp=records.Time.of(0), direction="sent", id=1, **frame))
    paths = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert closing_head(BytesIO(paths.log.read_bytes())) == verify_log(paths.log.read_bytes()).head
    assert previous_session(logs).note is None


def test_an_old_head_put_back_names_a_log_that_is_not_the_last(logs):
    """The old HEAD and its log agree; that a session is missing between shows when the folder is walked."""
    old = (logs / HEAD).read_bytes()
    next_session(logs)
    (logs / HEAD).write_bytes(old)
    assert previous_session(logs).note is None


def test_the_end_of_a_log_gives_the_head_that_the_whole_gives(logs):
    data = log_of(logs).read_bytes()
    assert closing_head(BytesIO(data)) == recoverable_head(BytesIO(data)) == verify_log(data).head


@pytest.mark.parametrize("place", range(0, 4000, 37))
def test_a_damaged_end_is_a_value_error_or_another_head(logs, place):
    data = bytearray(log_of(logs).read_bytes())
    data[-place % len(data)] ^= 0xFF
    with contextlib.suppress(ValueError):
        assert len(closing_head(BytesIO(bytes(data)))) == 64


def test_a_summary_without_end_is_not_read(logs):
    """Its footer points to the first byte of terabytes of nothing."""
    data = log_of(logs).read_bytes()

    class Sparse(BytesIO):
        def seek(self, offset, whence=0):
            self.place = (1 << 42) + offset if whence else offset
            return self.place

        def read(self, size=-1):
            assert size < 100
            return (b"\x08" + bytes(7)).ljust(size, b"\0")

    with pytest.raises(ValueError, match="larger than any"):
        closing_head(Sparse(data))


# ---------------------------------------------------------------- the list of withdrawn registrations


@given(st.lists(st.sampled_from(LINES), max_size=6), st.lists(st.sampled_from(LINES), max_size=3))
def test_a_list_begins_with_what_stood_there_before(before, more):
    listed = Listed.of(b"".join(before))
    assert listed.lines == len(before)
    assert listed.begins(b"".join(before + more))
    if before:
        assert not listed.begins(b"".join(before[:-1]))
        assert not listed.begins(b"".join([before[0][1:], *before[1:], *more]))


@pytest.fixture
def withdrawn(logs):
    """The same directory after three registrations were withdrawn in it."""
    for line in LINES:
        extend_list(logs, line)
    assert head_of(logs).listed == Listed.of(b"".join(LINES))
    return logs


def test_what_is_added_is_listed_and_head_says_so(withdrawn):
    assert withdrawn_list(withdrawn) == b"".join(LINES)
    assert next_session(withdrawn)["previous_crashed"] is False
    assert head_of(withdrawn).listed == Listed.of(b"".join(LINES))


def without_list(logs):
    (logs / WITHDRAWN).unlink()


def shorter(logs):
    (logs / WITHDRAWN).write_bytes(b"".join(LINES[:-1]))


def emptied_list(logs):
    (logs / WITHDRAWN).write_bytes(b"")


def altered(logs):
    (logs / WITHDRAWN).write_bytes(b"".join(LINES).replace(b"another", b"Another"))


def exchanged(logs):
    (logs / WITHDRAWN).write_bytes(b"".join(LINES[::-1]))


def torn(logs):
    os.truncate(logs / WITHDRAWN, len(b"".join(LINES)) - 1)


def without_head(logs):
    (logs / HEAD).unlink()


def damaged_head(logs):
    (logs / HEAD).write_bytes(b"{}")


def neither(logs):
    without_list(logs)
    without_head(logs)


def list_of_others(logs):
    (logs / WITHDRAWN).chmod(0o666)


def head_of_others(logs):
    (logs / HEAD).chmod(0o666)


def linked_list(logs):
    (logs / WITHDRAWN).rename(logs / "moved")
    (logs / WITHDRAWN).symlink_to("moved")


LOSSES = {
    without_list: "list of withdrawn registrations is missing, must be whole: at least the 3 lines",
    shorter: "is 2 lines that are not those, must be whole: at least the 3 lines",
    emptied_list: "is 0 lines that are not those",
    altered: "is 3 lines that are not those",
    exchanged: "is 3 lines that are not those",
    torn: "is 2 lines that are not those",
    without_head: "HEAD is missing, must be there where logs are",
    damaged_head: "HEAD is no head",
    neither: "HEAD is missing, must be there where logs are",
    list_of_others: "WITHDRAWN: mode is 0666",
    head_of_others: "HEAD: mode is 0666",
    linked_list: "WITHDRAWN: is a symbolic link",
}


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.__name__)
def test_no_session_begins_once_the_list_is_not_whole(withdrawn, loss):
    loss(withdrawn)
    files = {file.name for file in withdrawn.iterdir()}
    with pytest.raises(InputError, match=LOSSES[loss]) as refused:
        next_session(withdrawn)
    if "mode" not in LOSSES[loss] and "link" not in LOSSES[loss]:
        assert "restore HEAD and WITHDRAWN from a backup" in str(refused.value)
        assert "--log-dir" in str(refused.value)
    assert {file.name for file in withdrawn.iterdir()} == files, "nothing is made"
    os.close(lock(withdrawn))  # and the lock is given back


def test_a_list_that_was_restored_is_believed_again(withdrawn):
    kept = (withdrawn / WITHDRAWN).read_bytes()
    without_list(withdrawn)
    with pytest.raises(InputError):
        next_session(withdrawn)
    (withdrawn / WITHDRAWN).write_bytes(kept)
    next_session(withdrawn)


def test_a_list_that_is_longer_than_head_says_is_whole(withdrawn):
    """The power went between the list and HEAD."""
    with (withdrawn / WITHDRAWN).open("ab") as file:
        file.write(b"a fourth\n")
    next_session(withdrawn)
    assert head_of(withdrawn).listed == Listed.of(b"".join(LINES) + b"a fourth\n")


def test_a_list_that_is_lost_while_a_session_runs_is_missed_afterwards_whatever_was_added(withdrawn):
    log = create(withdrawn, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    without_list(withdrawn)
    log.listed = extend_list(withdrawn, b"a fourth\n")
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert (withdrawn / WITHDRAWN).read_bytes() == b"a fourth\n"
    with pytest.raises(InputError, match="at least the 3 lines"):
        withdrawn_list(withdrawn)


def test_what_stood_there_when_the_session_began_is_missed_whatever_became_of_head(withdrawn):
    known = head_of(withdrawn).listed
    longer = extend_list(withdrawn, b"a fourth\n", known)
    assert longer == head_of(withdrawn).listed == Listed.of(b"".join(LINES) + b"a fourth\n")
    without_list(withdrawn)
    (withdrawn / HEAD).unlink()
    assert extend_list(withdrawn, b"a fifth\n", longer) == longer
    assert (withdrawn / WITHDRAWN).read_bytes() == b"a fifth\n"
    assert not (withdrawn / HEAD).exists()


def test_what_is_withdrawn_in_a_session_is_in_its_last_head(withdrawn):
    log = create(withdrawn, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    assert head_of(withdrawn).listed == Listed.of(b"".join(LINES))
    log.listed = extend_list(withdrawn, b"a fourth\n")
    before = head_of(withdrawn)
    assert before == replace(head_of(withdrawn), closed=False, listed=log.listed), (
        "already before the session ends"
    )
    assert before.log == log.path.name
    assert before.time_ns is not None
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert head_of(withdrawn).closed
    assert head_of(withdrawn).listed == Listed.of(b"".join(LINES) + b"a fourth\n")


def test_a_directory_of_0_1_0_has_its_list_counted_from_the_next_session_on(withdrawn):
    content = json.loads((withdrawn / HEAD).read_bytes())
    del content["withdrawn"]
    (withdrawn / HEAD).write_bytes(json.dumps(content).encode())
    next_session(withdrawn)
    assert head_of(withdrawn).listed == Listed.of(b"".join(LINES))
    without_list(withdrawn)
    with pytest.raises(InputError):
        next_session(withdrawn)


def test_a_list_may_be_extended_where_no_head_tells_of_it(tmp_path):
    for line in LINES:
        listed = extend_list(tmp_path, line)
    assert listed == Listed.of(b"".join(LINES))
    assert not (tmp_path / HEAD).exists()


def test_one_session_at_a_time(tmp_path):
    held = lock(tmp_path)
    with pytest.raises(InputError, match="in use"):
        lock(tmp_path)
    os.close(held)
    os.close(lock(tmp_path))


@pytest.mark.parametrize("left", [(), (HEAD,), (WITHDRAWN,)])
def test_a_directory_without_logs_has_lost_nothing_that_could_be_known(tmp_path, left):
    for name in left:
        (tmp_path / name).write_bytes(b"")
        (tmp_path / name).chmod(0o600)
    next_session(tmp_path)


def test_a_session_that_was_cut_short_before_head_was_written_has_lost_nothing(tmp_path):
    (tmp_path / "20260101T000000Z-01234567.mcap").write_bytes(b"")
    next_session(tmp_path)


# ---------------------------------------------------------------- files of ours


@pytest.mark.parametrize("name", [f"{HEAD}.new", f"{WITHDRAWN}.new", HEAD, WITHDRAWN])
def test_nothing_is_written_through_a_link_that_somebody_has_put_there(tmp_path, name):
    logs = tmp_path / "logs"
    logs.mkdir()
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    (logs / name).symlink_to(victim)
    with contextlib.suppress(InputError):
        small_log(logs)
        extend_list(logs, LINES[0])
    assert victim.read_bytes() == b"somebody's"


def test_a_lock_that_is_a_link_is_refused(tmp_path):
    victim = tmp_path / "victim"
    (tmp_path / LOCK).symlink_to(victim)
    with pytest.raises(InputError, match="LOCK: is a symbolic link"):
        lock(tmp_path)
    assert not victim.exists()


def test_what_a_session_that_was_cut_short_had_prepared_is_removed(logs):
    for name in (HEAD, WITHDRAWN):
        (logs / f".{name}.0123456789abcdef.new").write_bytes(b"")
    (logs / ".HEAD.old").write_bytes(b"")
    remove_left_over(logs)
    assert not list(logs.glob(".*.new"))
    assert (logs / ".HEAD.old").exists()
    next_session(logs)
    assert not list(logs.glob(".*.new"))


def test_what_cannot_be_removed_is_in_nobodys_way(logs):
    (logs / ".HEAD.x.new").mkdir()
    remove_left_over(logs)
    next_session(logs)


def test_the_files_of_a_session_are_for_their_owner_alone(logs):
    assert {oct(file.stat().st_mode & 0o777) for file in logs.iterdir()} == {"0o600"}


def test_a_directory_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "logs").write_bytes(b"")
    with pytest.raises(InputError, match="log directory"):
        lock(tmp_path / "logs")


def test_the_directory_may_be_copied_as_a_whole(withdrawn, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(withdrawn, copy)
    next_session(copy)
    assert sha256((copy / WITHDRAWN).read_bytes()).hexdigest() == head_of(copy).listed.sha256


@pytest.mark.parametrize(("mode", "holds"), [(0o777, False), (0o775, False), (0o1777, True), (0o755, True)])
def test_a_directory_in_which_others_may_delete_is_refused(tmp_path, mode, holds):
    """Whoever deletes logs, HEAD and list together leaves a directory in which nothing was ever withdrawn."""
    logs = tmp_path / "logs"
    logs.mkdir()
    logs.chmod(mode)
    with contextlib.nullcontext() if holds else pytest.raises(InputError, match=f"mode {mode:04o}"):
        os.close(lock(logs))


# ---------------------------------------------------------------- the clock


def test_head_has_the_time_of_the_last_record(logs):
    (close,) = read_log(log_of(logs).read_bytes()).of("/audit/close")
    assert head_of(logs).time_ns == records.Time(**close["utc"]).nanoseconds > 1_790_000_000_000_000_000


def test_while_a_log_is_open_the_time_is_that_of_the_session_before(logs):
    before = head_of(logs).time_ns
    log = create(logs, log_id=LOG_ID, opened=OPENED, clock=Later().clock())
    assert (head_of(logs).closed, head_of(logs).time_ns, log.previous.time_ns) == (False, before, before)
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert head_of(logs).time_ns > before + 50_000_000_000


def test_the_time_never_goes_back(logs):
    """The clock is set back while a session runs: it ends before the one before it did."""
    before, clock = head_of(logs).time_ns, Later()
    log = create(logs, log_id=LOG_ID, opened=OPENED, clock=clock.clock())
    clock.now_ns = 0
    assert clock.utc_ns() < before
    assert log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).closed
    assert head_of(logs).time_ns == before


@pytest.mark.parametrize(
    "act", [crash, lambda logs: gone(log_of(logs)), head_of], ids=["crash", "gone", "whole"]
)
def test_whatever_became_of_the_log_its_time_counts(logs, act):
    before = head_of(logs).time_ns
    act(logs)
    assert previous_session(logs).time_ns == before


def test_a_folder_of_0_1_0_has_a_time_from_the_next_session_on(logs):
    (logs / HEAD).write_bytes(replace(head_of(logs), time_ns=None).encode())
    assert "time_ns" not in json.loads((logs / HEAD).read_bytes())
    assert previous_session(logs).time_ns is None
    next_session(logs)
    assert head_of(logs).time_ns > 1_790_000_000_000_000_000


def test_a_clock_behind_that_time_is_refused(tmp_path):
    previous = Previous("a.mcap", HEX, time_ns=1_790_000_000_000_000_005)
    with pytest.raises(InputError) as refused:
        check_clock(tmp_path, previous, 1_790_000_000_000_000_004)
    told = str(refused.value)
    assert told.startswith(f"{tmp_path / HEAD}: this computer's clock")
    assert "2026-09-21T14:13:20.000000004Z" in told
    assert "at least 2026-09-21T14:13:20.000000005Z, when a session was closed here" in told
    assert "set the clock" in told
    assert "--log-dir" in told


@pytest.mark.parametrize(
    ("then_ns", "now_ns"),
    [(None, 0), (5, 5), (5, 6), (0, 0), (1_790_000_000_000_000_000, 1_900_000_000_000_000_000)],
)
def test_a_clock_that_is_not_behind_is_not_refused(tmp_path, then_ns, now_ns):
    check_clock(tmp_path, Previous(time_ns=then_ns), now_ns)


@given(st.integers(0, directory.TIME_MAX), st.integers(0, directory.TIME_MAX))
def test_every_time_that_a_head_can_hold_can_be_told(then_ns, now_ns):
    late = (
        pytest.raises(InputError, match="this computer's clock")
        if now_ns < then_ns
        else contextlib.nullcontext()
    )
    with late:
        check_clock(directory.Path("logs"), Previous(time_ns=then_ns), now_ns)


# ---------------------------------------------------------------- whether a session runs


@pytest.mark.parametrize("mode", [0o600, 0o666, 0o444])
def test_a_folder_is_in_use_while_its_lock_is_held_whoever_may_write_it(tmp_path, mode):
    """A folder of evidence is anybody's: who reads it need not own it."""
    assert not directory.in_use(tmp_path)
    held = directory.lock(tmp_path)
    (tmp_path / directory.LOCK).chmod(mode)
    assert directory.in_use(tmp_path)
    os.close(held)
    assert not directory.in_use(tmp_path)
    (tmp_path / directory.LOCK).chmod(0o600)
    os.close(directory.lock(tmp_path))


def test_a_lock_that_cannot_be_looked_at_is_refused(tmp_path):
    (tmp_path / directory.LOCK).symlink_to("elsewhere")
    with pytest.raises(InputError, match="whether a session is writing here cannot be told") as told:
        directory.in_use(tmp_path)
    assert "copy log and raw frames to a folder of their own" in str(told.value)
