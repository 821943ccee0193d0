"""Only the holder of the key signs; only a private key file is read."""

import os
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.conversation import Permit, Reset, SignedRecord, Start
from cutgate.protocol.permit import KeyFileError, load_key, new_key_file, sign, verify
from cutgate.protocol.wire import layout
from tests.protocol.strategies import blocks, values

KEY = bytes(range(32))
keys = st.binary(min_size=32, max_size=32)
signed_records = st.one_of(blocks(Permit), blocks(Start), blocks(Reset))


@given(keys, signed_records)
def test_signed_record_verifies_with_its_key_alone(key: bytes, record: SignedRecord):
    signed = sign(key, record)
    assert verify(key, signed)
    assert not verify(bytes([key[0] ^ 1]) + key[1:], signed)
    assert signed.with_mac(record.code) == record


@pytest.mark.parametrize("kind", [Permit, Start, Reset])
@given(data=st.data())
def test_record_altered_in_any_one_field_is_refused(kind: type[SignedRecord], data: st.DataObject):
    record = data.draw(blocks(kind))
    assert isinstance(record, SignedRecord)
    signed = sign(KEY, record)
    name, codec = data.draw(st.sampled_from(layout(kind)))
    values_of = st.integers(-100, 100) if name.endswith("_turns") else values(codec)
    other = data.draw(values_of.filter(lambda value: value != getattr(signed, name)))
    assert not verify(KEY, kind(**(vars(signed) | {name: other})))


@pytest.mark.parametrize("length", [0, 16, 31, 33])
def test_key_of_another_length_is_refused(length: int, tmp_path: Path):
    record = Reset(bytes(16), 0, bytes(32), cause_of())
    with pytest.raises(ValueError, match="must be 32"):
        sign(bytes(length), record)
    with pytest.raises(ValueError, match="must be 32"):
        verify(bytes(length), record)
    with pytest.raises(KeyFileError, match="must be 32"):
        new_key_file(tmp_path / "key", bytes(length))
    assert not (tmp_path / "key").exists()


def cause_of():
    codec = dict(layout(Reset))["cause"]
    return codec.parse(b"\x09")


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


def test_a_key_file_is_closed_whether_or_not_it_is_taken(tmp_path: Path, monkeypatch):
    opened = []
    really = os.open
    monkeypatch.setattr(os, "open", lambda *args: opened.append(really(*args)) or opened[-1])
    path = tmp_path / "key"
    new_key_file(path, KEY)
    load_key(path)
    path.chmod(0o640)
    with pytest.raises(KeyFileError):
        load_key(path)
    assert len(opened) == 3
    for descriptor in opened:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)


def test_key_file_is_never_overwritten(tmp_path: Path):
    path = tmp_path / "key"
    new_key_file(path, KEY)
    with pytest.raises(KeyFileError, match="never overwritten"):
        new_key_file(path, bytes(32))
    assert load_key(path) == KEY


def test_key_file_that_cannot_be_written_is_named(tmp_path: Path):
    with pytest.raises(KeyFileError, match=r"nowhere.* cannot be written"):
        new_key_file(tmp_path / "nowhere" / "key", KEY)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666, 0o700, 0o400])
def test_key_file_of_another_mode_is_refused(mode: int, tmp_path: Path):
    path = tmp_path / "key"
    new_key_file(path, KEY)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match=rf"mode is {mode:04o}.*chmod 600"):
        load_key(path)


def test_missing_key_file_says_how_to_make_one(tmp_path: Path):
    with pytest.raises(KeyFileError, match="cutgate key new"):
        load_key(tmp_path / "key")


def test_key_file_behind_a_file_cannot_be_read(tmp_path: Path):
    (tmp_path / "file").write_text("x", encoding="ascii")
    with pytest.raises(KeyFileError, match="cannot be read"):
        load_key(tmp_path / "file" / "key")


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_what_is_no_plain_file_is_refused(make, tmp_path: Path):
    make(tmp_path / "key")
    with pytest.raises(KeyFileError, match="plain file"):
        load_key(tmp_path / "key")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "holds 0 bytes"),
        (b"00" * 31, "holds 31 bytes"),
        (b"00" * 33, "holds 33 bytes"),
        (b"00" * 32 + b"\n" * 3, "must be at most 66"),
        (b"zz" * 32, "not hexadecimal"),
        (b"\xff" * 64, "not hexadecimal"),
        (b"00" * 1000, "must be at most 66"),
    ],
)
def test_key_file_that_holds_no_key_is_refused(content: bytes, why: str, tmp_path: Path):
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(KeyFileError, match=why):
        load_key(path)
