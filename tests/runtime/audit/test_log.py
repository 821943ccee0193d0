"""The session's log: what is committed is on the disk, what fails is said, and nothing waits for the disk."""

import errno
import json
import os
from hashlib import sha256
from io import BytesIO

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit import records
from cutgate.runtime.audit.commit import Append, Closed, Durable, LogFailed, Reserved
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.heads import recoverable_head
from cutgate.runtime.audit.inspect import Status, read_log, verify_log
from cutgate.runtime.audit.log import Clock
from cutgate.runtime.audit.tree import EMPTY, Tree
from tests.logs import create, judged
from tests.runtime.audit.build import (
    LOG_ID,
    OPENED,
    PATIENCE_S,
    Ticking,
    WatchedDisk,
    decision,
    hanging,
    permit_record,
    small_log,
    wait_for,
)


def make(directory, disk=None, **options):
    return create(
        directory, log_id=LOG_ID, opened=OPENED, disk=disk, **({"clock": Ticking().clock()} | options)
    )


def close(log, **changes):
    return log.close(**({"final_state": "done", "clean": True, "timeout_s": PATIENCE_S} | changes))


def durable(token):
    return lambda event: isinstance(event, Durable) and event.token == token


def failed(event):
    return isinstance(event, LogFailed)


# ---------------------------------------------------------------- durable means on the disk


def test_a_committed_record_stands_in_the_file_cut_at_the_last_synced_offset(tmp_path):
    disk = WatchedDisk()
    log = make(tmp_path, disk)
    descriptor = log._committer._log.descriptor
    for token, kind in enumerate(["reset", "permit", "start"], start=1):
        log.write(permit_record(500.0, kind, "authorised", token=token))
        log.commit(token)
        event = wait_for(log, durable(token))
        # As after a power loss: only what was synced before the event is left.
        left = log.path.read_bytes()[: disk.synced[descriptor]]
        assert event.offset <= len(left)
        found = read_log(left)
        assert found.report.status is Status.INCOMPLETE
        assert [entry["kind"] for entry in found.of("/audit/permit")][-1] == kind
    close(log)


def test_no_commit_is_durable_before_the_disk_has_synced_it(tmp_path):
    disk = WatchedDisk()
    log = make(tmp_path, disk)
    log.commit(1)
    wait_for(log, durable(1))
    with hanging(disk, "sync"):
        log.write(permit_record(500.0, "permit", "authorised"))
        log.commit(2)
        assert not any(map(durable(2), log.events()))
    assert wait_for(log, failed).reason
    assert not log.writable


def test_a_durable_record_comes_with_the_tree_up_to_it(tmp_path):
    """Up to and including the last record before the commit, whatever is written before it is durable."""
    disk = WatchedDisk()
    log = make(tmp_path, disk)
    named = []
    for token in (1, 2):
        log.write(permit_record(500.0, "permit", "authorised", token=token))
        log.write(decision(token, disposition="authorised", token=token))
        log.commit(token)
        log.write(records.AuditOperator(word="stop", accepted=True))
        log.commit(None)
        event = wait_for(log, durable(token))
        named.append((token, event.size, event.root))
    stored = scan(close(log).log.read_bytes()).messages
    tree, trees = Tree(), {}
    for message in stored:
        tree.append(message.covered)
        trees[tree.size] = tree.root
    authorising = [
        number for number, message in enumerate(stored) if b'"disposition":"authorised"' in message.data
    ]
    assert named == [
        (token, number + 1, trees[number + 1]) for token, number in zip((1, 2), authorising, strict=True)
    ]


def test_a_commit_without_a_name_brings_no_tree(tmp_path):
    log = make(tmp_path)
    event = wait_for(log, durable(None))
    assert (event.size, event.root) == (0, EMPTY)
    close(log)


def test_a_decision_is_handed_over_at_once(tmp_path):
    log = make(tmp_path)
    before = log.size
    log.write(records.AuditOperator(word="stop", accepted=True))
    assert log.size == before
    log.write(decision(1))
    assert log.size > before
    close(log)


@pytest.mark.parametrize("after", range(1, 8))
def test_no_space_at_any_write_leaves_a_log_that_never_verifies(tmp_path, after):
    def trouble(operation, count):
        if operation == "write" and count >= after:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    log = make(tmp_path, WatchedDisk(trouble=trouble))
    for token in range(1, 20):
        log.write(permit_record(500.0, "permit", "authorised", token=token))
        log.commit(token)
        event = wait_for(log, lambda event, token=token: durable(token)(event) or failed(event))
        if isinstance(event, LogFailed):
            break
    assert not log.writable
    size = log.path.stat().st_size
    log._writer.finish = pytest.fail  # it would end the file as if nothing had happened
    paths = close(log)
    assert not paths.closed
    assert os.strerror(errno.ENOSPC) in paths.reason
    assert log.path.stat().st_size == size, "a failed log is left as it is"
    assert verify_log(log.path.read_bytes()).status in (Status.INCOMPLETE, Status.UNREADABLE)


def test_after_a_failure_nothing_is_kept(tmp_path):
    def trouble(operation, count):
        if operation == "sync" and count > 0:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    log = make(tmp_path, WatchedDisk(trouble=trouble))
    log.commit(1)
    wait_for(log, failed)
    size = log.size
    log.write(decision(1))
    log.attach("x", "text/plain", b"x")
    log.raw_frame(b"a line\n")
    log.commit(3)
    log.reserve(1, 1)
    log.tick(1e9)
    assert log.size == size
    assert close(log).closed is False


# ---------------------------------------------------------------- nothing waits


def test_a_disk_that_never_answers_blocks_no_call(tmp_path):
    disk = WatchedDisk()
    clock = Ticking()
    log = make(tmp_path, disk, clock=clock.clock())
    log.commit(1)
    wait_for(log, durable(1))
    with hanging(disk, "write", "sync", "reserve", "trim", "replace"):
        log.reserve(1 << 20, 1 << 18)
        for number in range(200):
            log.write(decision(number))
            log.raw_frame(b"a line\n")
        log.attach("x", "text/plain", b"x" * 1000)
        log.commit(2)
        log.tick(clock.now_ns / 1e9 + 10)
        assert not any(isinstance(event, Durable | LogFailed) for event in log.events())
        assert log.oldest_pending_s(clock.now_ns / 1e9 + 5.0) > 5.0
        paths = close(log, timeout_s=0.02)
        assert not paths.closed
        assert "did not answer" in paths.reason
        with pytest.raises(InputError, match="in use"):
            make(tmp_path)
    assert log.events() == []
    log._committer.join(PATIENCE_S)
    log._committer.release()
    os.close(log._locked)


def test_what_is_durable_is_not_pending(tmp_path):
    clock = Ticking()
    log = make(tmp_path, clock=clock.clock())
    log.commit(1)
    wait_for(log, durable(1))
    assert log.oldest_pending_s(clock.now_ns / 1e9 + 5.0) == 0.0
    close(log)


def test_bytes_wait_until_they_are_durable_and_how_long_that_took_is_known(tmp_path):
    """The clock goes on by a millisecond whenever it is read; the disk does not answer before it is let go."""
    clock, disk = Ticking(), WatchedDisk()
    log = make(tmp_path, clock=clock.clock(), disk=disk)
    log.commit(1)
    wait_for(log, durable(1))
    assert log.waiting_bytes == 0
    with hanging(disk, "sync"):
        log.write(records.AuditOperator(word="stop", accepted=True))
        assert log.waiting_bytes == 0, "it stands in memory yet"
        before, log.commit_s = log.size, None
        log.commit(2)
        assert log.waiting_bytes == log.size - before > 0
        assert log.events() == []
        assert log.commit_s is None
        clock.now_ns += 700_000_000
    # What hung ends with an error: nothing more becomes durable, and it goes on waiting.
    wait_for(log, lambda event: isinstance(event, LogFailed))
    assert (log.commit_s, log.waiting_bytes) == (None, log.size - before)
    close(log)


def test_a_commits_time_is_from_handing_over_to_being_told(tmp_path):
    clock = Ticking()
    log = make(tmp_path, clock=clock.clock())
    log.commit(1)
    wait_for(log, durable(1))
    log.write(records.AuditOperator(word="stop", accepted=True))
    log.commit(2)
    clock.now_ns += 250_000_000
    wait_for(log, durable(2))
    assert log.commit_s == pytest.approx(0.25, abs=0.1)
    close(log)


def test_records_wait_in_memory_for_less_than_the_chunk_period(tmp_path):
    clock = Ticking()
    log = make(tmp_path, clock=clock.clock(), chunk_period_s=1.0)
    now_s = clock.now_ns / 1e9
    before = log.size
    log.tick(now_s + 100.0)
    assert log.size == before, "nothing waits"
    log.write(records.AuditOperator(word="stop", accepted=True))
    log.tick(now_s + 0.5)
    assert log.size == before
    log.tick(now_s + 0.9)
    assert log.size > before
    close(log)


def test_space_is_asked_for_and_answered(tmp_path):
    log = make(tmp_path)
    log.reserve(1 << 20, 1 << 18)
    answer = wait_for(log, lambda event: isinstance(event, Reserved))
    assert answer.reservation.size >= 1 << 20
    close(log)


# ---------------------------------------------------------------- the whole file


def test_a_closed_log_verifies(tmp_path):
    paths = small_log(tmp_path)
    assert (paths.closed, paths.reason) == (True, "")
    report = judged(paths.log).report
    assert (report.status, report.reasons, report.notes) == (Status.OK, (), ())
    assert report.headline.startswith("OK (signed, key ")


def test_the_close_record_counts_messages_and_names_the_raw_frames(tmp_path):
    paths = small_log(tmp_path)
    log = read_log(paths.log.read_bytes())
    (entry,) = log.of("/audit/close")
    candump = paths.candump.read_bytes()
    assert entry["message_count"] == log.report.messages
    assert (entry["candump_sha256"], entry["candump_bytes"]) == (sha256(candump).hexdigest(), len(candump))
    assert candump.splitlines()[0] == b"(1790000000.123456) vcan0 080#0001020304050607"


def test_attachments_have_their_digest_as_a_record(tmp_path):
    log = read_log(small_log(tmp_path).log.read_bytes())
    recorded = {entry["name"]: entry["sha256"] for entry in log.of("/audit/attachment")}
    assert recorded == {entry.name: sha256(entry.data).hexdigest() for entry in log.scan.attachments}
    assert recorded.keys() == {"environment.json", "plan.csv"}


def test_record_0_names_program_machine_and_simulation(tmp_path):
    log = read_log(small_log(tmp_path).log.read_bytes())
    (opened,) = log.of("/audit/open")
    assert (opened["log_id"], opened["software"]) == (LOG_ID, OPENED.software)
    assert opened["simulation"] == [{"name": "time scale", "value": "20"}]
    assert opened["cpu_dispatch"]
    assert opened["previous_crashed"] is False
    assert "previous_head" not in opened


def test_a_log_is_closed_once(tmp_path):
    log = make(tmp_path)
    close(log)
    assert not log.writable
    with pytest.raises(RuntimeError, match="closed"):
        close(log)


def test_the_systems_clocks_are_the_default(tmp_path):
    log = make(tmp_path, clock=None)
    assert close(log).closed
    assert Clock().utc_ns() > 1_700_000_000_000_000_000


# ---------------------------------------------------------------- the directory


def test_the_directory_serves_one_session_at_a_time(tmp_path):
    log = make(tmp_path)
    with pytest.raises(InputError, match="in use"):
        make(tmp_path)
    close(log)
    close(make(tmp_path, clock=Later().clock()))


def test_a_directory_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="log directory"):
        make(tmp_path / "file" / "logs")


@pytest.mark.parametrize("operation", ["create", "replace"])
def test_a_log_that_cannot_be_created_is_refused_and_the_lock_given_back(tmp_path, operation):
    class Broken(WatchedDisk):
        def create(self, path):
            if operation == "create" and path.name.endswith(".candump.log"):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().create(path)

        def replace(self, prepared, data):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    with pytest.raises(InputError, match="log directory"):
        make(tmp_path, Broken())
    for path in tmp_path.glob("*.mcap"):
        path.unlink()
    for path in tmp_path.glob("*.log"):
        path.unlink()
    close(make(tmp_path))


def opened_of(paths):
    return read_log(paths.log.read_bytes()).of("/audit/open")[0]


def test_a_session_carries_the_head_of_the_one_before(tmp_path):
    first = close(make(tmp_path))
    second = opened_of(close(make(tmp_path, clock=Later().clock())))
    assert second["previous_log"] == first.log.name
    assert second["previous_head"] == verify_log(first.log.read_bytes()).head
    assert second["previous_crashed"] is False


class Later(Ticking):
    """A second session cannot have the first one's file name."""

    def __init__(self):
        super().__init__()
        self.now_ns += 60_000_000_000


def test_a_session_whose_clock_is_behind_the_last_ones_end_is_refused_and_the_lock_given_back(tmp_path):
    close(make(tmp_path, clock=Later().clock()))
    with pytest.raises(InputError, match=r"HEAD: this computer's clock .* when a session was closed here"):
        make(tmp_path)
    assert len(list(tmp_path.glob("*.mcap"))) == 1, "nothing was written"
    later = Later()
    later.now_ns += 60_000_000_000
    close(make(tmp_path, clock=later.clock()))


def crash(directory):
    """A session whose process dies: its files stay, HEAD says open, the lock is free."""
    disk = WatchedDisk()
    log = make(directory, disk)
    log.write(decision(1))
    log.commit(1)
    wait_for(log, durable(1))
    log._committer.submit(Append(b"\x06torn", b""))
    with hanging(disk, "trim"):
        close(log, timeout_s=0.02)
    log._committer.join(PATIENCE_S)
    log._committer.release()
    os.close(log._locked)
    return log.path


def test_after_a_crash_the_last_recoverable_head_is_carried_and_marked(tmp_path):
    path = crash(tmp_path)
    second = opened_of(close(make(tmp_path, clock=Later().clock())))
    assert second["previous_crashed"] is True
    assert second["previous_log"] == path.name
    assert second["previous_head"] == recoverable_head(BytesIO(path.read_bytes())) != "0" * 64


def test_a_crashed_log_that_is_gone_is_marked(tmp_path):
    crash(tmp_path).unlink()
    second = opened_of(close(make(tmp_path, clock=Later().clock())))
    assert second["previous_crashed"] is True
    assert "could not be read" in second["previous_note"]


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff", b"[]", b"{}", json.dumps({"log": "../x", "head": None, "state": "closed"}).encode()],
)
def test_a_head_that_cannot_be_read_is_marked(tmp_path, content):
    (tmp_path / "HEAD").write_bytes(content)
    opened = opened_of(close(make(tmp_path)))
    assert opened["previous_crashed"] is True
    assert "HEAD" in opened["previous_note"]


def test_closing_says_closed_once_it_is_durable(tmp_path):
    disk = WatchedDisk()
    log = make(tmp_path, disk)
    descriptor = log._committer._log.descriptor
    paths = close(log)
    assert paths.closed
    assert disk.synced[descriptor] == paths.log.stat().st_size
    assert json.loads((tmp_path / "HEAD").read_bytes())["state"] == "closed"
    assert Closed() not in log.events()
