"""What was written is found again under its name, as it was written, or the log is lost: nothing else is durable."""

import os
import shutil
import time
from hashlib import sha256
from pathlib import Path

import pytest

from cutgate.runtime.audit import written
from cutgate.runtime.audit.disk import SystemDisk
from cutgate.runtime.audit.written import LostError, Written, identify

CONTENT = b"what was decided, and why"


@pytest.fixture
def file(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    disk = SystemDisk()
    descriptor = disk.create(folder / "a.mcap")
    made = Written(disk, descriptor, folder / "a.mcap")
    made.append(CONTENT)
    made.check(enabling=True)
    yield made
    os.close(descriptor)


def later(path: Path) -> None:
    """The clock that dates files has gone on: whoever writes from here on leaves another time."""
    beside = path.with_name("clock")
    until_s = time.monotonic() + 5.0
    before_ns = path.stat().st_ctime_ns
    while time.monotonic() < until_s:
        beside.write_bytes(b"")
        if beside.stat().st_ctime_ns > before_ns:
            return
    raise AssertionError("files are not dated here")


def delete(path: Path) -> None:
    path.unlink()


def delete_the_folder(path: Path) -> None:
    shutil.rmtree(path.parent)


def rename(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))


def rename_the_folder(path: Path) -> None:
    path.parent.rename(path.parent.with_name("elsewhere"))


def replace_by_a_copy(path: Path) -> None:
    path.with_name("copy").write_bytes(path.read_bytes())
    path.with_name("copy").replace(path)


def rename_and_copy(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.write_bytes(path.with_name("elsewhere").read_bytes())


def replace_by_a_link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def cut(path: Path) -> None:
    os.truncate(path, 3)


def add(path: Path) -> None:
    with path.open("ab") as other:
        other.write(b"x")


def overwrite(path: Path) -> None:
    with path.open("r+b") as other:
        other.write(b"W")


def overwrite_and_put_back_the_times(path: Path) -> None:
    """The time of the last change of the inode is what nobody can put back."""
    before = path.stat()
    overwrite(path)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


ACTS = {
    delete: "was deleted$",
    delete_the_folder: "was deleted$",
    rename: "was renamed or moved",
    rename_the_folder: "was renamed or moved",
    replace_by_a_copy: "was deleted, and another file was put in its place",
    rename_and_copy: "was renamed, and another file was put in its place",
    replace_by_a_link: "was renamed, and another file was put in its place",
    cut: f"was cut to 3 bytes, {len(CONTENT)} were written",
    add: f"has grown to {len(CONTENT) + 1} bytes, {len(CONTENT)} were written",
    overwrite: "was overwritten: what is read back is not what was written",
    overwrite_and_put_back_the_times: "was overwritten",
}
"""What is done to a log by others, and what is said of it."""


@pytest.mark.parametrize("enabling", [False, True])
@pytest.mark.parametrize("act", ACTS, ids=lambda act: act.__name__)
def test_whatever_is_done_to_a_file_is_found_and_named(file, act, enabling):
    later(file.path)
    act(file.path)
    with pytest.raises(LostError, match=rf"a\.mcap {ACTS[act]}"):
        file.check(enabling=enabling)


@pytest.mark.parametrize("act", [delete, rename], ids=lambda act: act.__name__)
@pytest.mark.parametrize("call", range(6))
def test_what_happens_to_a_file_while_it_is_looked_at_is_named_as_well(file, monkeypatch, act, call):
    """Between any two calls of the system another may come: what is said of the file is true all the same."""
    later(file.path)
    touch(file.path)  # so that it is read back
    asked = 0

    def asks(name):
        real = getattr(os, name)

        def ask(*arguments, **options):
            nonlocal asked
            if asked == call:
                asked += 1
                act(file.path)
            asked += 1
            return real(*arguments, **options)

        return ask

    for name in ("stat", "fstat", "open", "read"):
        monkeypatch.setattr(written.os, name, asks(name))
    try:
        file.check()
    except LostError as lost:
        assert ACTS[act].rstrip("$") in str(lost)  # noqa: PT017 - it may also come too late to be seen
    else:
        with pytest.raises(LostError, match=ACTS[act]):
            file.check()


@pytest.mark.parametrize("act", [overwrite, overwrite_and_put_back_the_times])
def test_what_was_overwritten_in_the_very_moment_of_our_own_writing_is_found_before_anything_is_enabled(
    file, act
):
    """Two writes within one tick of the clock that dates files look alike; what is read back does not."""
    act(file.path)
    file._remember(file.path.stat())
    file.check()
    with pytest.raises(LostError, match="was overwritten"):
        file.check(enabling=True)


def test_a_file_that_was_written_to_by_nobody_else_is_never_lost(file):
    for number in range(50):
        file.check()
        file.append(bytes([number]) * number)
        file.sync()
        file.check(enabling=number % 7 == 0)
    file.trim()
    file.check(enabling=True)


def touch(path: Path) -> None:
    os.utime(path)


def allow(path: Path) -> None:
    path.chmod(0o644)


def link(path: Path) -> None:
    path.with_name("backup").hardlink_to(path)


def write_the_same(path: Path) -> None:
    with path.open("r+b") as other:
        other.write(CONTENT)


@pytest.mark.parametrize("act", [touch, allow, link, write_the_same], ids=lambda act: act.__name__)
def test_a_file_whose_content_is_what_was_written_is_not_lost(file, act):
    """A backup, a scanner for viruses, a curious person: none of them stops a half-cut bone."""
    later(file.path)
    act(file.path)
    file.check()
    file.append(b"and what came of it")
    file.check(enabling=True)


def test_a_file_that_nobody_touched_is_not_read_back_but_for_what_enables(file, monkeypatch):
    opened: list[object] = []
    reading = os.open
    monkeypatch.setattr(
        written.os, "open", lambda path, *how, **more: opened.append(path) or reading(path, *how, **more)
    )
    file.check()
    file.append(b"more")
    file.check()
    assert not opened
    file.check(enabling=True)
    assert opened == [file.path]


def test_a_large_file_is_read_back_only_when_its_times_show_that_another_wrote_to_it(file, monkeypatch):
    monkeypatch.setattr(written, "READ_BACK_MAX", len(CONTENT) - 1)
    file._read_back, read = lambda: pytest.fail("read back"), file._read_back
    file.check(enabling=True)
    file._read_back = read
    later(file.path)
    overwrite(file.path)
    with pytest.raises(LostError, match="was overwritten"):
        file.check()


def test_a_file_is_reserved_beyond_what_is_written_and_keeps_its_length(file):
    before = file.path.stat().st_size
    assert file.reserve(1 << 20).size >= (1 << 20) + before
    file.check(enabling=True)
    assert file.path.stat().st_size == before


def test_an_error_of_the_disk_is_none_of_the_file(file, monkeypatch):
    def fail(*_arguments, **_options):
        raise PermissionError(13, "no")

    monkeypatch.setattr(written.os, "stat", fail)
    with pytest.raises(PermissionError):
        file.check()


def test_a_name_that_leads_through_a_file_is_a_lost_one(file):
    folder = file.path.parent
    folder.rename(folder.with_name("elsewhere"))
    folder.write_bytes(b"")
    with pytest.raises(LostError, match="was renamed or moved"):
        identify(file.descriptor, file.path)


def test_what_changes_while_the_file_is_read_back_shows_the_next_time(file):
    later(file.path)
    touch(file.path)
    read = file._read_back

    def read_and_be_overwritten():
        read()
        later(file.path)
        overwrite(file.path)

    file._read_back = read_and_be_overwritten
    file.check()
    file._read_back = read
    with pytest.raises(LostError, match="was overwritten"):
        file.check()


# ---------------------------------------------------------------- what is asked of the system


class Dating(SystemDisk):
    """A disk on which every operation leaves another time, and is noted."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def sync(self, descriptor):
        self.done.append("sync")

    def reserve(self, descriptor, path, size):
        later(path)
        touch(path)
        self.done.append(f"reserve {size}")

    def trim(self, descriptor):
        later(Path(f"/proc/self/fd/{descriptor}").readlink())
        os.utime(descriptor)
        self.done.append("trim")


@pytest.fixture
def dated(tmp_path):
    disk = Dating()
    descriptor = disk.create(tmp_path / "a.mcap")
    yield disk, Written(disk, descriptor, tmp_path / "a.mcap")
    os.close(descriptor)


def test_a_new_file_is_what_it_was_made_as(dated):
    _, file = dated
    file._read_back = lambda: pytest.fail("read back")
    file.check()
    assert file.size == 0


def test_what_is_asked_of_the_disk_is_done_and_is_nobody_elses_writing(dated):
    disk, file = dated
    file.append(CONTENT)
    file._read_back = lambda: pytest.fail("read back")
    file.reserve(1000)
    file.check()
    file.trim()
    file.check()
    file.sync()
    assert disk.done == [f"reserve {len(CONTENT) + 1000}", "trim", "sync"]


def descriptors():
    return sorted(descriptor.name for descriptor in Path("/proc/self/fd").iterdir())


def test_a_file_is_read_back_once_for_each_change_through_no_link_and_without_waiting(file, monkeypatch):
    opened, reading, before = [], os.open, descriptors()
    monkeypatch.setattr(
        written.os, "open", lambda path, flags: opened.append((path, flags)) or reading(path, flags)
    )
    later(file.path)
    touch(file.path)
    file.check()
    file.check()
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    assert opened == [(file.path, flags)]
    assert descriptors() == before


def test_the_largest_file_that_is_read_back_with_what_enables(file, monkeypatch):
    read = []
    file._read_back = lambda: read.append(True)
    for bound, times in ((len(CONTENT) - 1, 0), (len(CONTENT), 1)):
        monkeypatch.setattr(written, "READ_BACK_MAX", bound)
        file.check(enabling=True)
        assert len(read) == times


def test_the_bounds_are_what_they_are():
    assert (written.READ_BACK_MAX, written.PIECE) == (33_554_432, 1_048_576)


def test_its_digest_is_that_of_all_that_was_written(tmp_path):
    disk = SystemDisk()
    file = Written(disk, disk.create(tmp_path / "a"), tmp_path / "a")
    for data in (b"one", b"", b"two"):
        file.append(data)
    assert file.sha256 == sha256((tmp_path / "a").read_bytes()).digest()
    os.close(file.descriptor)
