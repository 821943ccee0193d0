"""Files that decide are believed only if they are ours, and written anew never through what stands there."""

import errno
import os
import stat
from pathlib import Path

import pytest

from cutgate.config import ours
from cutgate.config.load import InputError
from cutgate.config.ours import FRESH, Replacement, create_ours, open_ours, read_ours, replace_durably

LIMIT = 1000
GUESSED = ".LIST.0000000000000000.new"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "LIST"
    replace_durably(path, b"what decides")
    return path


def test_what_was_written_is_read(file: Path):
    assert read_ours(file, LIMIT) == b"what decides"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert list(file.parent.iterdir()) == [file]


def test_a_file_that_is_missing_is_the_callers_business(tmp_path: Path):
    with pytest.raises(FileNotFoundError):
        read_ours(tmp_path / "LIST", LIMIT)


def test_a_file_of_another_user_is_refused_as_root_too(file: Path, monkeypatch: pytest.MonkeyPatch):
    mine = os.geteuid()
    monkeypatch.setattr(ours.os, "geteuid", lambda: mine + 1)
    with pytest.raises(InputError, match=r"LIST: owner is .*\(uid \d+\), must be .*\(uid \d+\); ") as refused:
        read_ours(file, LIMIT)
    assert f"uid {mine})" in str(refused.value)
    assert f"chown it to {mine + 1}" in str(refused.value)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_root_believes_no_file_of_somebody_else(file: Path):
    os.chown(file, 65534, 65534)
    with pytest.raises(InputError, match=r"owner is .*uid 65534\), must be .*uid 0\)"):
        read_ours(file, LIMIT)


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_can_write_is_refused(file: Path, mode: int):
    file.chmod(mode)
    with pytest.raises(InputError, match=rf"LIST: mode is {mode:04o}, must be .*; .*chmod 600"):
        read_ours(file, LIMIT)


@pytest.mark.parametrize("mode", [0o640, 0o604])
def test_a_secret_that_others_can_read_is_refused_where_an_open_list_is_not(file: Path, mode: int):
    file.chmod(mode)
    assert read_ours(file, LIMIT) == b"what decides"
    with pytest.raises(InputError, match=rf"LIST: mode is {mode:04o}, must be .*; .*chmod 600"):
        read_ours(file, LIMIT, secret=True)


def test_a_link_is_never_followed(file: Path, tmp_path: Path):
    link = tmp_path / "LINK"
    link.symlink_to(file)
    with pytest.raises(InputError, match="LINK: is a symbolic link"):
        read_ours(link, LIMIT)


@pytest.mark.timeout(10)
def test_a_pipe_and_a_folder_are_refused_and_nobody_is_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "PIPE", 0o600)
    for name in ("PIPE", "."):
        with pytest.raises(InputError, match="not a regular file"):
            read_ours(tmp_path / name, LIMIT)


def test_a_file_over_its_size_is_refused_before_it_is_read(tmp_path: Path):
    file = tmp_path / "LIST"
    os.close(create_ours(file))
    os.truncate(file, LIMIT)
    assert len(read_ours(file, LIMIT)) == LIMIT
    os.truncate(file, 1 << 40)  # sparse: nobody has the memory for it
    with pytest.raises(InputError, match=f"size is {1 << 40} bytes, must be <= {LIMIT} bytes"):
        read_ours(file, LIMIT)


def test_a_file_that_grows_while_it_is_read_is_refused(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(ours.os, "read", lambda _descriptor, size: b"x" * size)
    with pytest.raises(InputError, match=r"cannot be read .grew over 1000 bytes"):
        read_ours(file, LIMIT)


def test_a_disk_that_gives_an_error_is_named(file: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(ours.os, "read", fail)
    with pytest.raises(InputError, match=r"cannot be read .Input/output error"):
        read_ours(file, LIMIT)


def test_a_name_that_no_file_can_have_is_refused():
    with pytest.raises(InputError, match="cannot be read"):
        read_ours("NUL\0L", LIMIT)


def test_opening_gives_no_descriptor_to_children(file: Path):
    descriptor = open_ours(file)
    assert not os.get_inheritable(descriptor)
    os.close(descriptor)


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
    assert read_ours(tmp_path / "LIST", LIMIT) == b"new"


def test_a_fresh_name_that_is_taken_already_is_not_written_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    monkeypatch.setattr(ours.os, "urandom", bytes)
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

    monkeypatch.setattr(ours.os, "write", full)
    with pytest.raises(OSError, match="No space"):
        replace_durably(file, b"new")
    assert list(file.parent.iterdir()) == [file]
    assert read_ours(file, LIMIT) == b"what decides"


def test_a_disk_that_takes_few_bytes_at_a_time_gets_them_all(file: Path, monkeypatch: pytest.MonkeyPatch):
    write = os.write
    monkeypatch.setattr(ours.os, "write", lambda descriptor, data: write(descriptor, data[:3]))
    replace_durably(file, b"0123456789")
    assert read_ours(file, LIMIT) == b"0123456789"


def test_what_replaced_a_file_is_on_the_disk_before_its_name_and_its_name_before_the_return(
    file: Path, monkeypatch: pytest.MonkeyPatch
):
    done: list[str] = []
    fsync, rename = os.fsync, os.rename

    def note_sync(descriptor: int) -> None:
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def note_rename(*names: str, **folders: int) -> None:
        done.append("name")
        rename(*names, **folders)

    monkeypatch.setattr(ours.os, "fsync", note_sync)
    monkeypatch.setattr(ours.os, "rename", note_rename)
    replace_durably(file, b"new")
    assert done == ["file", "name", "folder"]


def test_what_is_prepared_stands_beside_the_file_until_it_is_put_in_place(file: Path):
    prepared = Replacement(file)
    assert read_ours(file, LIMIT) == b"what decides"
    assert len(list(file.parent.glob(FRESH.format(name="LIST", number="*")))) == 1
    prepared.put(b"new")
    assert read_ours(file, LIMIT) == b"new"
    assert list(file.parent.iterdir()) == [file]


def test_what_is_given_up_leaves_the_file_as_it_was_and_may_be_given_up_again(file: Path):
    prepared = Replacement(file)
    prepared.discard()
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


def test_a_user_without_a_name_is_a_number():
    assert ours.user(4_000_000_000) == "unknown (uid 4000000000)"
