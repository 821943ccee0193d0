"""Only a key file that is ours alone is read, and none is ever overwritten."""

import errno
import os
import stat
from pathlib import Path

import pytest

from cutgate.config import ours
from cutgate.config.key import load_key, new_key_file
from cutgate.config.load import InputError

KEY = bytes(range(32))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "key"
    new_key_file(made, KEY)
    return made


@pytest.mark.parametrize("length", [0, 16, 31, 33])
def test_a_key_of_another_length_is_not_written(length: int, tmp_path: Path):
    with pytest.raises(InputError, match=f"a key of {length} bytes, must be 32"):
        new_key_file(tmp_path / "key", bytes(length))
    assert not (tmp_path / "key").exists()


def test_key_file_round_trip_under_any_umask(tmp_path: Path):
    for umask in (0o000, 0o077, 0o377):
        path = tmp_path / f"key{umask}"
        before = os.umask(umask)
        try:
            new_key_file(path, KEY)
        finally:
            os.umask(before)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert load_key(path) == KEY


def test_a_key_file_is_closed_whether_or_not_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    opened = []
    really = os.open
    monkeypatch.setattr(os, "open", lambda *args: opened.append(really(*args)) or opened[-1])
    path = tmp_path / "key"
    new_key_file(path, KEY)
    load_key(path)
    path.chmod(0o640)
    with pytest.raises(InputError):
        load_key(path)
    assert len(opened) == 4, "the new file, its folder, and twice the file to be read"
    for descriptor in opened:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)


def test_a_new_key_file_is_whole_when_it_is_made_durable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, synced = tmp_path / "key", []
    monkeypatch.setattr(os, "fsync", lambda _descriptor: synced.append(path.read_bytes()))
    new_key_file(path, KEY)
    assert synced == 2 * [KEY.hex().encode() + b"\n"], "before its bytes, and before its name"


def test_a_key_file_is_never_overwritten(path: Path):
    with pytest.raises(InputError, match="never overwritten; name another"):
        new_key_file(path, bytes(32))
    assert load_key(path) == KEY


def test_a_key_is_never_written_through_a_link(tmp_path: Path):
    (tmp_path / "link").symlink_to("victim")
    with pytest.raises(InputError, match="link: exists and is never overwritten"):
        new_key_file(tmp_path / "link", KEY)
    assert not (tmp_path / "victim").exists()


def test_a_key_file_that_cannot_be_made_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"nowhere.* cannot be written .No such file"):
        new_key_file(tmp_path / "nowhere" / "key", KEY)


def test_a_disk_that_is_full_leaves_no_half_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=r"key: cannot be written .No space left"):
        new_key_file(tmp_path / "key", KEY)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o666, 0o644])
def test_a_key_that_others_can_read_is_refused(mode: int, path: Path):
    path.chmod(mode)
    with pytest.raises(InputError, match=rf"key: mode is {mode:04o}, must be .*0600.*chmod 600"):
        load_key(path)


@pytest.mark.parametrize("mode", [0o400, 0o600, 0o700])
def test_a_key_that_only_its_owner_reads_is_read(mode: int, path: Path):
    path.chmod(mode)
    assert load_key(path) == KEY


def test_a_key_of_another_user_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch):
    mine = os.geteuid()
    monkeypatch.setattr(ours.os, "geteuid", lambda: mine + 1)
    with pytest.raises(InputError, match=rf"key: owner is .*\(uid {mine}\), must be .*\(uid {mine + 1}\)"):
        load_key(path)


def test_a_missing_key_file_says_how_to_make_one(tmp_path: Path):
    with pytest.raises(
        InputError,
        match=r"key: there is no such key file; copy the other side's there, or make one for both with: cutgate key new .*key",
    ):
        load_key(tmp_path / "key")


def test_a_key_behind_a_file_cannot_be_read(tmp_path: Path):
    (tmp_path / "file").write_text("x", encoding="ascii")
    with pytest.raises(InputError, match="cannot be read"):
        load_key(tmp_path / "file" / "key")


def test_a_key_behind_a_link_is_refused(path: Path, tmp_path: Path):
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(InputError, match="link: is a symbolic link"):
        load_key(tmp_path / "link")


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_what_is_no_plain_file_is_refused(make, tmp_path: Path):
    make(tmp_path / "key")
    with pytest.raises(InputError, match="not a regular file"):
        load_key(tmp_path / "key")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "a key of 0 bytes, must be 32 bytes"),
        (b"00" * 31, "a key of 31 bytes, must be 32 bytes"),
        (b"00" * 33, "a key of 33 bytes, must be 32 bytes"),
        (b"00" * 32 + b"\n" * 3, "must be <= 66 bytes"),
        (b"zz" * 32, "not hexadecimal; copy it anew from the other side"),
        (b"\xff" * 64, "not hexadecimal"),
        (b"00" * 1000, "size is 2000 bytes, must be <= 66 bytes"),
    ],
)
def test_a_file_that_holds_no_key_is_refused(content: bytes, why: str, path: Path):
    path.write_bytes(content)
    with pytest.raises(InputError, match=why):
        load_key(path)
