"""Files are made only where nothing stands, replaced as a whole, and are on the disk when the call returns."""

import errno
import os
import stat
from pathlib import Path

import pytest

from cutgate.config import durable
from cutgate.config.durable import (
    Replacement,
    create_durably,
    create_ours,
    creating,
    left_over,
    replace_durably,
    sync_folder,
)

GUESSED = ".LIST.0000000000000000.new"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "LIST"
    replace_durably(path, b"what decides")
    return path


def noted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What becomes durable, in its order: a file with so many bytes, a name, the folder."""
    done: list[str] = []
    fsync, rename = os.fsync, os.rename

    def note_sync(descriptor: int) -> None:
        status = os.fstat(descriptor)
        done.append("folder" if stat.S_ISDIR(status.st_mode) else f"{status.st_size} bytes of a file")
        fsync(descriptor)

    def note_rename(*names: str, **folders: int) -> None:
        done.append("name")
        rename(*names, **folders)

    monkeypatch.setattr(durable.os, "fsync", note_sync)
    monkeypatch.setattr(durable.os, "rename", note_rename)
    return done


def open_descriptors() -> set[str]:
    return {descriptor.name for descriptor in Path("/proc/self/fd").iterdir()}


def test_a_file_is_made_only_where_nothing_stands(tmp_path: Path):
    victim = tmp_path / "VICTIM"
    (tmp_path / "LINK").symlink_to(victim)  # dangling: open(O_CREAT) without O_EXCL would make the victim
    victim2 = tmp_path / "VICTIM-2"
    victim2.write_bytes(b"mine")
    (tmp_path / "LINK-2").symlink_to(victim2)
    for name in ("LINK", "LINK-2", "VICTIM-2"):
        with pytest.raises(FileExistsError):
            create_ours(tmp_path / name)
    assert not victim.exists()
    assert victim2.read_bytes() == b"mine"


@pytest.mark.parametrize("planted", ["LIST", "LIST.new"])
def test_a_file_is_replaced_never_through_what_stands_there(tmp_path: Path, planted: str):
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    (tmp_path / planted).symlink_to(victim)
    replace_durably(tmp_path / "LIST", b"new")
    assert victim.read_bytes() == b"somebody's"
    assert (tmp_path / "LIST").read_bytes() == b"new"


def test_a_fresh_name_that_is_taken_already_is_not_written_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    monkeypatch.setattr(durable.os, "urandom", bytes)
    (tmp_path / GUESSED).symlink_to(victim)
    with pytest.raises(FileExistsError):
        replace_durably(tmp_path / "LIST", b"new")
    assert victim.read_bytes() == b"somebody's"
    assert (tmp_path / GUESSED).is_symlink()  # not ours: not removed either


def test_a_replacement_that_fails_leaves_the_old_file_and_no_other(
    file: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(durable.os, "write", full)
    with pytest.raises(OSError, match="No space"):
        replace_durably(file, b"new")
    assert list(file.parent.iterdir()) == [file]
    assert file.read_bytes() == b"what decides"


def test_a_disk_that_takes_few_bytes_at_a_time_gets_them_all(file: Path, monkeypatch: pytest.MonkeyPatch):
    write = os.write
    monkeypatch.setattr(durable.os, "write", lambda descriptor, data: write(descriptor, data[:3]))
    replace_durably(file, b"0123456789")
    assert file.read_bytes() == b"0123456789"


def test_what_replaced_a_file_is_on_the_disk_before_its_name_and_its_name_before_the_return(
    file: Path, monkeypatch: pytest.MonkeyPatch
):
    done = noted(monkeypatch)
    replace_durably(file, b"new")
    assert done == ["3 bytes of a file", "name", "folder"]


def test_what_is_prepared_stands_beside_the_file_until_it_is_put_in_place(file: Path):
    prepared = Replacement(file)
    assert file.read_bytes() == b"what decides"
    assert len(list(left_over(file))) == 1
    prepared.put(b"new")
    assert prepared.descriptor == -1
    assert file.read_bytes() == b"new"
    assert list(file.parent.iterdir()) == [file]


def test_what_is_given_up_leaves_the_file_as_it_was_and_may_be_given_up_again(file: Path):
    before = open_descriptors()
    prepared = Replacement(file)
    prepared.discard()
    assert open_descriptors() == before
    assert prepared.descriptor == -1, "which no call takes for a file"
    stranger = os.open(file, os.O_RDONLY)  # takes the number that has become free
    prepared.discard()
    assert os.read(stranger, 4) == b"what"
    os.close(stranger)
    assert list(file.parent.iterdir()) == [file]


def test_a_folder_that_is_gone_is_an_error_of_the_disk(file: Path):
    prepared = Replacement(file)
    file.unlink()
    (fresh,) = file.parent.iterdir()
    fresh.unlink()
    file.parent.rmdir()
    with pytest.raises(FileNotFoundError):
        prepared.put(b"new")
    prepared.discard()


def test_a_replacement_that_cannot_be_made_leaves_no_descriptor(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(durable.os, "urandom", bytes)
    (file.parent / GUESSED).write_bytes(b"")
    before = open_descriptors()
    with pytest.raises(FileExistsError):
        Replacement(file)
    assert open_descriptors() == before


@pytest.mark.parametrize(
    "act", [replace_durably, lambda path, data: create_durably(path.with_name("NEW"), data)]
)
def test_writing_leaves_no_descriptor(file: Path, act):
    before = open_descriptors()
    act(file, b"new")
    assert open_descriptors() == before


def test_what_was_left_over_is_that_of_the_file_alone(file: Path):
    Replacement(file)
    Replacement(file.with_name("HEAD"))
    assert [found.name.startswith(".LIST.") for found in left_over(file)] == [True]


# ---------------------------------------------------------------- new files


def test_a_new_file_is_whole_when_it_is_made_durable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    done = noted(monkeypatch)
    create_durably(tmp_path / "NEW", b"0123456789")
    assert done == ["10 bytes of a file", "folder"]
    assert (tmp_path / "NEW").read_bytes() == b"0123456789"


@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o377, 0o400)])
def test_a_new_file_is_its_owners_alone_or_whose_the_umask_says(tmp_path: Path, umask: int, mode: int):
    before = os.umask(umask)
    try:
        create_durably(tmp_path / "ours", b"")
        create_durably(tmp_path / "shared", b"", ours=False)
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "shared")]
    assert modes == [0o600, mode]


@pytest.mark.parametrize("ours", [True, False])
def test_a_new_file_is_never_written_over_another_or_through_a_link(tmp_path: Path, ours: bool):
    (tmp_path / "there").write_bytes(b"mine")
    (tmp_path / "link").symlink_to("victim")
    for name in ("there", "link"):
        with pytest.raises(FileExistsError):
            create_durably(tmp_path / name, b"new", ours=ours)
    assert (tmp_path / "there").read_bytes() == b"mine"
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("call", ["write", "fsync", "fchmod"])
def test_a_disk_that_fails_leaves_no_half_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str):
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = open_descriptors()
    monkeypatch.setattr(durable.os, call, full)
    with pytest.raises(OSError, match="No space"):
        create_durably(tmp_path / "NEW", b"new")
    assert list(tmp_path.iterdir()) == []
    assert open_descriptors() == before


def test_a_folder_is_synced_and_its_errors_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before, done = open_descriptors(), noted(monkeypatch)
    sync_folder(tmp_path)
    assert done == ["folder"]
    with pytest.raises(FileNotFoundError):
        sync_folder(tmp_path / "nowhere")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(NotADirectoryError):
        sync_folder(tmp_path / "file")
    assert open_descriptors() == before


# ---------------------------------------------------------------- piece by piece


def test_what_is_made_piece_by_piece_is_on_the_disk_when_the_block_has_ended(tmp_path: Path, monkeypatch):
    done = noted(monkeypatch)
    with creating(tmp_path / "NEW") as descriptor:
        os.write(descriptor, b"one, ")
        os.write(descriptor, b"two")
        assert done == []
    assert done == ["8 bytes of a file", "folder"]
    assert (tmp_path / "NEW").read_bytes() == b"one, two"
    assert stat.S_IMODE((tmp_path / "NEW").stat().st_mode) == 0o600


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, OSError])
def test_of_what_is_not_finished_nothing_is_left(tmp_path: Path, error):
    def broken_off():
        with creating(tmp_path / "NEW") as descriptor:
            os.write(descriptor, b"half")
            raise error

    before = open_descriptors()
    with pytest.raises(error):
        broken_off()
    assert list(tmp_path.iterdir()) == []
    assert open_descriptors() == before


def test_what_stands_there_is_not_made_again_and_stays(tmp_path: Path):
    (tmp_path / "OLD").write_bytes(b"mine")
    with pytest.raises(FileExistsError), creating(tmp_path / "OLD"):
        pytest.fail("the block must not run")
    assert (tmp_path / "OLD").read_bytes() == b"mine"
