"""Files that decide are believed only if they are ours."""

import errno
import os
import stat
from pathlib import Path

import pytest

from cutgate.config import ours
from cutgate.config.durable import create_ours, replace_durably
from cutgate.config.load import InputError
from cutgate.config.ours import open_ours, read_ours

LIMIT = 1000


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


def test_a_user_without_a_name_is_a_number():
    assert ours.user(4_000_000_000) == "unknown (uid 4000000000)"
