"""The commit thread: durable is said only of what was synced, and after an error nothing more is done."""

import ctypes
import errno
import os
import select
from types import SimpleNamespace

import pytest

from cutgate.runtime.audit.commit import (
    SIDECAR_BYTES,
    Append,
    Closed,
    Committer,
    Durable,
    Finish,
    InTurn,
    LogFailed,
    LogFiles,
    Reserved,
    ReserveSpace,
)
from cutgate.runtime.audit.directory import HEAD_MAX, LOCK, lock
from cutgate.runtime.audit.disk import Reservation, SystemDisk, write_all
from cutgate.runtime.audit.tree import EMPTY
from cutgate.runtime.audit.written import Written
from tests.runtime.audit.build import PATIENCE_S, WatchedDisk, hanging

ROOT = bytes(range(32))


def signed(size, sha256):
    """What stands for the signature of so many bytes with this SHA-256."""
    return f"{size} {sha256.hex()}".encode()


class Thread:
    """A committer on files in a directory, and every event it has reported."""

    def __init__(self, directory, disk, kind=Committer):
        self.log_path, self.frames_path = directory / "a.mcap", directory / "a.candump.log"
        self.locked = lock(directory)
        self.files = LogFiles(
            Written(disk, disk.create(self.log_path), self.log_path),
            Written(disk, disk.create(self.frames_path), self.frames_path),
            (self.locked, directory / LOCK),
            disk.prepare(directory / "HEAD"),
            disk.prepare(directory / "a.signature.json"),
        )
        self.disk = disk
        self.committer = kind(disk, self.files)

    def wait(self, kind):
        while True:
            ready, _, _ = select.select([self.committer.fileno()], [], [], PATIENCE_S)
            assert ready, f"no {kind.__name__}"
            for event in self.committer.events():
                if isinstance(event, kind):
                    return event

    def finish(self):
        self.committer.submit(Finish(b"", b"", signed, b"head"))
        assert self.committer.join(PATIENCE_S)
        events = self.committer.events()
        self.committer.release()
        os.close(self.locked)
        return events


def failing(operation, code, after=0):
    def trouble(name, count):
        if name == operation and count >= after:
            raise OSError(code, os.strerror(code))

    return trouble


def test_a_token_is_durable_only_after_the_sync(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"abc", b"frame\n", 7, 2, ROOT))
    assert thread.wait(Durable) == Durable(7, 3, 2, ROOT)
    assert disk.synced[thread.files.log.descriptor] == 3
    assert thread.log_path.read_bytes() == b"abc"
    assert thread.finish() == [Closed()]
    assert thread.frames_path.read_bytes() == b"frame\n"
    assert (tmp_path / "HEAD").read_bytes() == b"head"


def test_a_commit_without_new_bytes_is_synced_and_answered(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"", b"", token=1))
    assert thread.wait(Durable) == Durable(1, 0, 0, EMPTY)
    assert disk.counts["sync"] == 1
    thread.finish()


def test_a_commit_without_a_name_names_no_tree(tmp_path):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(Append(b"abc", b""))
    assert thread.wait(Durable) == Durable(None, 3, 0, EMPTY)
    thread.finish()


def test_raw_frames_alone_are_not_synced(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"", b"frame\n"))
    thread.committer.submit(ReserveSpace(4096, 0))
    thread.wait(Reserved)
    assert "sync" not in disk.counts
    thread.finish()


def test_bytes_are_written_however_few_the_disk_takes(tmp_path):
    disk = WatchedDisk(short=3)
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(bytes(range(100)), b"", token=1))
    thread.wait(Durable)
    assert thread.log_path.read_bytes() == bytes(range(100))
    thread.finish()


def test_a_write_that_takes_nothing_is_an_error(tmp_path):
    disk = WatchedDisk(short=0)
    descriptor = disk.create(tmp_path / "x")
    with pytest.raises(OSError, match="no bytes"):
        write_all(disk, descriptor, b"abc")
    os.close(descriptor)


@pytest.mark.parametrize("operation", ["write", "sync"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_after_an_error_nothing_is_written_or_synced_again(tmp_path, operation, code):
    disk = WatchedDisk(trouble=failing(operation, code))
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"abc", b"frame\n", token=1))
    failed = thread.wait(LogFailed)
    assert os.strerror(code) in failed.reason
    done = dict(disk.counts)
    thread.committer.submit(Append(b"def", b"", token=2))
    assert thread.finish() == []
    assert disk.counts == done
    assert disk.counts[operation] == 1
    assert not (tmp_path / "HEAD").exists()


@pytest.mark.parametrize("operation", ["trim", "sync", "replace"])
def test_a_log_that_cannot_be_finished_is_not_closed(tmp_path, operation):
    thread = Thread(tmp_path, WatchedDisk(trouble=failing(operation, errno.EIO)))
    events = thread.finish()
    assert [type(event) for event in events] == [LogFailed]


def test_a_log_is_closed_only_when_all_of_both_files_is_on_the_disk(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"abc", b"some frames"))
    before = {}
    replaced = []

    def trouble(name, _count):
        if name == "replace":
            replaced.append(sorted(path.name for path in tmp_path.glob("*.json")))
            before.update(disk.synced)

    disk.trouble = trouble
    assert isinstance(thread.finish()[-1], Closed)
    log, frames = thread.files.log.descriptor, thread.files.frames.descriptor
    assert before == {log: len(b"abc"), frames: len(b"some frames")}, "when it was about to be signed"
    assert replaced == [[], ["a.signature.json"]], "it is signed before HEAD says that it is closed"


def test_an_error_of_any_kind_is_reported(tmp_path):
    def trouble(_name, _count):
        raise RuntimeError("unexpected")

    thread = Thread(tmp_path, WatchedDisk(trouble=trouble))
    thread.committer.submit(Append(b"abc", b""))
    assert thread.wait(LogFailed).reason == "RuntimeError: unexpected"
    thread.finish()


def test_no_space_to_reserve_is_an_answer_and_the_log_goes_on(tmp_path):
    thread = Thread(tmp_path, WatchedDisk(trouble=failing("reserve", errno.ENOSPC)))
    thread.committer.submit(ReserveSpace(4096, 0))
    answer = thread.wait(Reserved)
    assert (answer.asked, answer.reservation.reserved) == (4096, False)
    assert 0 < answer.reservation.size < 4096, "an answer, and not enough"
    assert "No space" in answer.reservation.how
    thread.committer.submit(Append(b"abc", b"", token=1))
    assert thread.wait(Durable).token == 1
    thread.finish()


def test_a_reservation_does_not_change_the_files_length_and_is_given_back(tmp_path):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(ReserveSpace(1 << 22, 1 << 20))
    reservation = thread.wait(Reserved).reservation
    assert reservation.size >= 1 << 22
    assert thread.log_path.stat().st_size == 0
    if reservation.reserved:
        assert thread.log_path.stat().st_blocks * 512 >= 1 << 22
    thread.committer.submit(Append(b"abc", b""))
    assert thread.finish()[-1] == Closed()
    assert thread.log_path.stat().st_size == 3
    assert thread.log_path.stat().st_blocks * 512 < 1 << 22


def test_without_reservation_the_free_space_is_looked_at(tmp_path, monkeypatch):
    def unsupported(_descriptor, _size):
        raise OSError(errno.EOPNOTSUPP, "no")

    monkeypatch.setattr("cutgate.runtime.audit.disk._fallocate", unsupported)
    disk = SystemDisk()
    descriptor = disk.create(tmp_path / "x")
    reservation = disk.reserve(descriptor, tmp_path / "x", 4096)
    disk.close(descriptor)
    assert not reservation.reserved
    assert reservation.size > 0
    assert "cannot reserve" in reservation.how


def test_a_reservation_error_is_an_error(tmp_path):
    disk = SystemDisk()
    descriptor = disk.create(tmp_path / "x")
    with pytest.raises(OSError, match="Invalid"):
        disk.reserve(descriptor, tmp_path / "x", -1)
    disk.close(descriptor)


def test_a_c_library_without_fallocate_is_not_supported(monkeypatch, tmp_path):
    monkeypatch.setattr("cutgate.runtime.audit.disk._LIBC", object())
    disk = SystemDisk()
    descriptor = disk.create(tmp_path / "x")
    assert not disk.reserve(descriptor, tmp_path / "x", 4096).reserved
    disk.close(descriptor)


def test_an_interrupted_reservation_is_asked_for_again(monkeypatch, tmp_path):
    calls = []

    def fallocate(*arguments):
        calls.append(arguments)
        ctypes.set_errno(errno.EINTR)
        return -1 if len(calls) == 1 else 0

    monkeypatch.setattr("cutgate.runtime.audit.disk._LIBC", SimpleNamespace(fallocate=fallocate))
    assert SystemDisk().reserve(-1, tmp_path / "x", 4096).reserved
    assert len(calls) == 2


def test_waiting_jobs_share_one_sync(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    with hanging(disk, "reserve"):
        thread.committer.submit(ReserveSpace(4096, 0))
        assert disk.entered.wait(PATIENCE_S)
        for token in range(5):
            thread.committer.submit(Append(b"x", b"", token, 10 + token, bytes([token])))
            thread.committer.submit(Append(b"y", b""))
    events = thread.finish()
    durable = [event for event in events if isinstance(event, Durable)]
    assert durable == [Durable(token, 10, 10 + token, bytes([token])) for token in range(5)], (
        "each its own tree"
    )
    assert disk.counts["sync"] <= 1 + 2  # and two at the end, for the log and the raw frames


def test_a_disk_that_never_answers_blocks_nobody(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    with hanging(disk, "write"):
        for token in range(1000):
            thread.committer.submit(Append(b"x" * 1000, b"frame\n", token))
        assert thread.committer.events() == []
        assert not thread.committer.join(0.01)
    assert isinstance(thread.wait(LogFailed), LogFailed)
    assert thread.committer.join(PATIENCE_S)
    thread.committer.release()


def test_the_wake_pipe_may_be_full(tmp_path):
    thread = Thread(tmp_path, WatchedDisk())
    writer = thread.committer._wake_write
    try:
        while os.write(writer, bytes(4096)):
            pass
    except BlockingIOError:
        pass
    thread.committer.submit(Append(b"abc", b"", token=1))
    assert thread.wait(Durable).token == 1
    thread.finish()


# ---------------------------------------------------------------- what was written must be found again


LOSSES = {
    "the log deleted": lambda thread: thread.log_path.unlink(),
    "the log cut": lambda thread: os.truncate(thread.log_path, 1),
    "the log overwritten": lambda thread: overwritten(thread.log_path),
    "the raw frames deleted": lambda thread: thread.frames_path.unlink(),
    "the raw frames cut": lambda thread: os.truncate(thread.frames_path, 1),
    "the raw frames overwritten": lambda thread: overwritten(thread.frames_path),
    "the lock deleted": lambda thread: (thread.log_path.parent / LOCK).unlink(),
    "the lock replaced": lambda thread: replaced(thread.log_path.parent / LOCK),
}


def overwritten(path):
    with path.open("r+b") as file:
        file.write(b"X")
    os.utime(path, ns=(1, 1))  # it shows that somebody was there, even within one tick of the clock


def replaced(path):
    path.unlink()
    path.write_bytes(b"")


@pytest.mark.parametrize("token", [None, 2])
@pytest.mark.parametrize("loss", LOSSES)
def test_nothing_is_durable_once_what_was_written_is_lost(tmp_path, loss, token):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(Append(b"abc", b"frame\n", token=1))
    thread.wait(Durable)
    thread.committer.submit(ReserveSpace(4096, 4096))  # answered after the raw frames are written
    thread.wait(Reserved)
    LOSSES[loss](thread)
    thread.committer.submit(Append(b"def", b"frame\n", token=token))
    reason = thread.wait(LogFailed).reason
    name = {"the log": "a.mcap", "the raw": "a.candump.log", "the loc": LOCK}[loss[:7]]
    assert name in reason
    assert thread.finish() == []
    assert not (tmp_path / "HEAD").exists()


@pytest.mark.parametrize("loss", LOSSES)
def test_a_log_is_not_closed_once_what_was_written_is_lost(tmp_path, loss):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(Append(b"abc", b"frame\n", token=1))
    thread.committer.submit(ReserveSpace(4096, 4096))
    thread.wait(Reserved)
    LOSSES[loss](thread)
    assert [type(event) for event in thread.finish() if not isinstance(event, Durable)] == [LogFailed]
    assert not (tmp_path / "HEAD").exists()


def test_what_is_lost_between_write_and_sync_is_not_durable(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)

    def trouble(operation, _count):
        if operation == "sync":
            thread.log_path.unlink()

    disk.trouble = trouble
    thread.committer.submit(Append(b"abc", b"", token=1))
    assert "was deleted" in thread.wait(LogFailed).reason
    assert thread.finish() == []


def test_closing_needs_no_space_but_what_was_reserved(tmp_path):
    """HEAD, the summary, the raw frames: nothing new is made, no block is taken that was not reserved."""
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(ReserveSpace(1 << 20, 1 << 20))
    reservation = thread.wait(Reserved).reservation
    if not reservation.reserved:
        pytest.skip("this file system cannot reserve")
    (prepared,) = tmp_path.glob(".HEAD.*.new")
    blocks = {path: path.stat().st_blocks for path in (thread.log_path, thread.frames_path, prepared)}
    assert all(blocks.values())
    inode = prepared.stat().st_ino
    thread.committer.submit(Append(bytes(1 << 19), bytes(1 << 19)))
    assert thread.finish()[-1] == Closed()
    assert (tmp_path / "HEAD").stat().st_ino == inode
    assert (tmp_path / "HEAD").stat().st_blocks <= blocks[prepared]
    assert thread.log_path.stat().st_blocks <= blocks[thread.log_path]
    assert thread.frames_path.stat().st_blocks <= blocks[thread.frames_path]


def test_both_files_are_reserved_and_so_is_what_closing_writes(tmp_path):
    asked = []

    class Asked(WatchedDisk):
        def reserve(self, descriptor, path, size):
            asked.append(size)
            return super().reserve(descriptor, path, size)

    thread = Thread(tmp_path, Asked())
    thread.committer.submit(Append(b"abc", b"frame\n"))
    thread.committer.submit(ReserveSpace(5000, 600))
    thread.wait(Reserved)
    assert asked == [5003, 606, HEAD_MAX, SIDECAR_BYTES], "so many more bytes than are written"
    thread.finish()


@pytest.mark.parametrize("which", [0, 1, 2, 3])
def test_no_space_for_any_of_them_is_no_space(tmp_path, which):
    thread = Thread(tmp_path, WatchedDisk(trouble=failing("reserve", errno.ENOSPC, after=which)))
    thread.committer.submit(ReserveSpace(4096, 4096))
    answer = thread.wait(Reserved)
    assert answer.reservation.size < answer.asked
    thread.finish()


def test_what_is_only_seen_free_is_counted_once_for_all(tmp_path):
    class Unable(WatchedDisk):
        def reserve(self, _descriptor, _path, _size):
            return Reservation(1000, reserved=False, how="seen free")

    thread = Thread(tmp_path, Unable())
    thread.committer.submit(ReserveSpace(600, 600))
    assert thread.wait(Reserved).reservation == Reservation(1000, reserved=False, how="seen free")
    thread.finish()


def test_a_disk_that_does_not_even_say_what_is_free_has_answered(tmp_path, monkeypatch):
    def fail(_path):
        raise OSError(errno.EIO, "no")

    monkeypatch.setattr("cutgate.runtime.audit.commit.os.statvfs", fail)
    thread = Thread(tmp_path, WatchedDisk(trouble=failing("reserve", errno.EIO)))
    thread.committer.submit(ReserveSpace(4096, 0))
    assert thread.wait(Reserved).reservation.size == 1
    thread.finish()


class Alike:
    """Times that tell nothing, as within one tick of the clock."""

    def __eq__(self, _other):
        return True

    __hash__ = None


@pytest.fixture
def within_one_tick(monkeypatch):
    monkeypatch.setattr(Written, "_remember", lambda written, _status: setattr(written, "_times", Alike()))


@pytest.mark.parametrize("which", ["log_path", "frames_path"])
@pytest.mark.parametrize("token", [None, 2])
def test_content_is_read_back_with_every_record_that_enables(tmp_path, within_one_tick, which, token):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(Append(b"abc", b"frame\n", token=1))
    thread.committer.submit(ReserveSpace(4096, 4096))
    thread.wait(Reserved)
    overwritten(getattr(thread, which))
    thread.committer.submit(Append(b"def", b"", token=token))
    assert "was overwritten" in thread.wait(LogFailed).reason if token else thread.wait(Durable).token is None
    assert Closed() not in thread.finish(), "and when the log is closed"
    assert not (tmp_path / "HEAD").exists()


def test_in_turn_a_job_is_done_when_it_is_handed_over(tmp_path):
    disk = WatchedDisk()
    in_turn = Thread(tmp_path, disk, InTurn)
    in_turn.committer.submit(Append(b"abc", b"frame\n", 7, 2, ROOT))
    assert disk.synced[in_turn.files.log.descriptor] == 3
    assert in_turn.committer.events() == [Durable(7, 3, 2, ROOT)]
    assert not in_turn.committer.join(0.0)
    assert in_turn.finish() == [Closed()]


def test_in_turn_nothing_is_done_after_the_first_failure(tmp_path):
    in_turn = Thread(tmp_path, WatchedDisk(failing("sync", errno.EIO)), InTurn)
    for _ in range(2):
        in_turn.committer.submit(Append(b"abc", b"", token=1))
    assert [type(event) for event in in_turn.finish()] == [LogFailed]
    assert in_turn.log_path.read_bytes() == b"abc"
