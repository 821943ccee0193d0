"""The commit thread: durable is said only of what was synced, and after an error nothing more is done."""

import ctypes
import errno
import os
import select
from types import SimpleNamespace

import pytest

from cutgate.runtime.audit.commit import (
    Append,
    Closed,
    Committer,
    Durable,
    Failed,
    Files,
    Finish,
    Reserve,
    Reserved,
)
from cutgate.runtime.audit.disk import SystemDisk, write_all
from tests.runtime.audit.build import PATIENCE_S, WatchedDisk, hanging


class Thread:
    """A committer on files in a directory, and every event it has reported."""

    def __init__(self, directory, disk):
        self.log_path, self.frames_path = directory / "a.mcap", directory / "a.candump.log"
        self.files = Files(
            disk.create(self.log_path), disk.create(self.frames_path), self.log_path, directory / "HEAD"
        )
        self.disk = disk
        self.committer = Committer(disk, self.files)

    def wait(self, kind):
        while True:
            ready, _, _ = select.select([self.committer.fileno()], [], [], PATIENCE_S)
            assert ready, f"no {kind.__name__}"
            for event in self.committer.events():
                if isinstance(event, kind):
                    return event

    def finish(self):
        self.committer.submit(Finish(b"", b"", b"head"))
        assert self.committer.join(PATIENCE_S)
        events = self.committer.events()
        self.committer.release()
        return events


def failing(operation, code, after=0):
    def trouble(name, count):
        if name == operation and count >= after:
            raise OSError(code, os.strerror(code))

    return trouble


def test_a_token_is_durable_only_after_the_sync(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"abc", b"frame\n", token=7))
    assert thread.wait(Durable) == Durable(7, 3)
    assert disk.synced[thread.files.log] == 3
    assert thread.log_path.read_bytes() == b"abc"
    assert thread.finish() == [Closed()]
    assert thread.frames_path.read_bytes() == b"frame\n"
    assert (tmp_path / "HEAD").read_bytes() == b"head"


def test_a_commit_without_new_bytes_is_synced_and_answered(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"", b"", token=1))
    assert thread.wait(Durable) == Durable(1, 0)
    assert disk.counts["sync"] == 1
    thread.finish()


def test_raw_frames_alone_are_not_synced(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    thread.committer.submit(Append(b"", b"frame\n"))
    thread.committer.submit(Reserve(4096))
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
    failed = thread.wait(Failed)
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
    assert [type(event) for event in events] == [Failed]


def test_an_error_of_any_kind_is_reported(tmp_path):
    def trouble(_name, _count):
        raise RuntimeError("unexpected")

    thread = Thread(tmp_path, WatchedDisk(trouble=trouble))
    thread.committer.submit(Append(b"abc", b""))
    assert thread.wait(Failed).reason == "RuntimeError: unexpected"
    thread.finish()


def test_no_space_to_reserve_is_an_answer_and_the_log_goes_on(tmp_path):
    thread = Thread(tmp_path, WatchedDisk(trouble=failing("reserve", errno.ENOSPC)))
    thread.committer.submit(Reserve(4096))
    answer = thread.wait(Reserved)
    assert (answer.asked, answer.reservation.size, answer.reservation.reserved) == (4096, 0, False)
    thread.committer.submit(Append(b"abc", b"", token=1))
    assert thread.wait(Durable).token == 1
    thread.finish()


def test_a_reservation_does_not_change_the_files_length_and_is_given_back(tmp_path):
    thread = Thread(tmp_path, WatchedDisk())
    thread.committer.submit(Reserve(1 << 22))
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
        thread.committer.submit(Reserve(4096))
        assert disk.entered.wait(PATIENCE_S)
        for token in range(5):
            thread.committer.submit(Append(b"x", b"", token))
    events = thread.finish()
    durable = [event for event in events if isinstance(event, Durable)]
    assert durable == [Durable(token, 5) for token in range(5)]
    assert disk.counts["sync"] <= 1 + 2  # and two at the end, for the log and the raw frames


def test_a_disk_that_never_answers_blocks_nobody(tmp_path):
    disk = WatchedDisk()
    thread = Thread(tmp_path, disk)
    with hanging(disk, "write"):
        for token in range(1000):
            thread.committer.submit(Append(b"x" * 1000, b"frame\n", token))
        assert thread.committer.events() == []
        assert not thread.committer.join(0.01)
    assert isinstance(thread.wait(Failed), Failed)
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
