"""One attachment, read by its parts: what it says of itself is held against its bytes."""

import io
import struct
import zlib
from hashlib import sha256

import pytest

from cutgate.runtime.audit.container import attachment, raw
from cutgate.runtime.audit.container.attachment import read_attachment
from cutgate.runtime.audit.container.raw import MAGIC, BrokenError, Budget, RecordReader, TornError

DATA = b"x,y,z\n1,2,3\n"
DAMAGED = "the record at offset 8 is damaged or not in its canonical form"
LONGER = "the record at offset 8 cannot be read (an attachment longer than its record)"


def text(data):
    return struct.pack("<I", len(data)) + data


def content(name=b"plan.csv", media=b"text/csv", data=DATA, size=None, crc=None):
    body = struct.pack("<QQ", 11, 12) + text(name) + text(media)
    body += struct.pack("<Q", len(data) if size is None else size) + data
    return body + struct.pack("<I", zlib.crc32(body) if crc is None else crc)


def file_of(body, length=None):
    return MAGIC + struct.pack("<BQ", 9, len(body) if length is None else length) + body + b"rest"


def read(data, size=None, budget=None):
    reader = RecordReader(io.BytesIO(data), size or len(data))
    entry = read_attachment(reader, reader.next(), budget or Budget())
    return entry, reader


def broken(body, told):
    with pytest.raises(BrokenError) as found:
        read(file_of(body))
    assert str(found.value) == told


@pytest.mark.parametrize("piece", [1, 5, len(DATA), 1 << 20])
@pytest.mark.parametrize("data", [DATA, b""])
def test_an_attachment_is_read_with_the_digest_of_its_bytes(monkeypatch, piece, data):
    monkeypatch.setattr(attachment, "PIECE", piece)
    whole = file_of(content(data=data))
    entry, reader = read(whole)
    assert (entry.name, entry.media_type) == ("plan.csv", "text/csv")
    assert (entry.log_time, entry.create_time) == (11, 12)
    assert (entry.size, entry.sha256) == (len(data), sha256(data).hexdigest())
    assert whole[entry.offset : entry.offset + entry.size] == data
    assert entry.data == data
    assert (reader.at, reader.crc) == (len(whole) - 4, zlib.crc32(whole[:-4]))


def test_only_a_piece_of_it_is_in_memory_at_a_time(monkeypatch):
    monkeypatch.setattr(attachment, "PIECE", 7)
    asked = []

    class Asked(io.BytesIO):
        def read(self, size=-1):
            asked.append(size)
            return super().read(size)

    whole = file_of(content(name=b"x", media=b"", data=bytes(100)))
    reader = RecordReader(Asked(whole), len(whole))
    read_attachment(reader, reader.next(), Budget())
    assert max(asked) == 16


def test_a_name_is_utf_8():
    broken(content(name=b"\xff"), "the record at offset 8 cannot be read (a name that is no UTF-8)")
    broken(content(media=b"\xff"), "the record at offset 8 cannot be read (a name that is no UTF-8)")
    assert read(file_of(content(name="Müller".encode())))[0].name == "Müller"


@pytest.mark.parametrize("size", [0, len(DATA) - 1, len(DATA) + 1, 1 << 60])
def test_its_length_is_that_of_its_bytes(size):
    broken(content(size=size), DAMAGED)


def test_its_checksum_is_that_of_everything_before_it():
    sound = content()
    broken(content(crc=0), DAMAGED)
    for place in range(len(sound)):
        changed = bytearray(sound)
        changed[place] ^= 1
        with pytest.raises(BrokenError):
            read(file_of(bytes(changed)))


def test_no_field_is_longer_than_the_record():
    whole = content(name=b"x" * 40)
    for end in range(4, 4 + 16 + 44):
        broken(whole[:end], LONGER)
    broken(struct.pack("<QQI", 11, 12, 1 << 20) + bytes(40), LONGER)
    broken(struct.pack("<QQI", 11, 12, 1) + b"\xff", LONGER)


def test_a_file_that_is_cut_while_it_is_read_is_torn():
    whole = file_of(content())
    for end in range(17, len(whole) - 4):
        with pytest.raises(TornError) as found:
            read(whole[:end], len(whole))
        assert found.value.offset == 8


def test_names_are_remembered_within_a_bound(monkeypatch):
    body = content(name=b"12345", media=b"123")
    told = "it holds more schemas, channels, metadata and attachments than any session writes: over {} bytes"
    monkeypatch.setattr(raw, "REMEMBERED_MAX", 5 + 3 + 9)
    assert read(file_of(body))
    for bound in (5 + 3 + 8, 7, 4):
        monkeypatch.setattr(raw, "REMEMBERED_MAX", bound)
        broken(body, told.format(bound) + " without their content")
