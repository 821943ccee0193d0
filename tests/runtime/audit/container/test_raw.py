"""The reader of bytes: each record where it stands, and never a byte beyond a bound."""

import io
import struct
import zlib

import pytest

from cutgate.runtime.audit.container import raw
from cutgate.runtime.audit.container.raw import (
    MAGIC,
    RECORD_MAX,
    REMEMBERED_MAX,
    BrokenError,
    Budget,
    RecordReader,
    TornError,
)


def packed(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


ONE, OTHER = packed(3, b"abc"), packed(7, b"")
FILE = MAGIC + ONE + OTHER


def reader(data, size=None):
    return RecordReader(io.BytesIO(data), len(data) if size is None else size)


def test_records_come_one_after_the_other_with_place_size_and_the_checksum_before_them():
    reading = reader(FILE)
    first = reading.next()
    assert (first.opcode, first.offset, first.size, first.length) == (3, 8, 3, 12)
    assert first.crc == zlib.crc32(MAGIC)
    assert (reading.begun, reading.at) == (8, 17)
    assert reading.content(first) == b"abc"
    second = reading.next()
    assert (second.opcode, second.offset, second.size, second.length) == (7, 20, 0, 9)
    assert second.crc == zlib.crc32(MAGIC + ONE)
    assert reading.content(second) == b""
    assert reading.begun == 20
    assert (reading.at, reading.crc) == (len(FILE), zlib.crc32(FILE))


def test_whoever_moved_the_file_meanwhile_is_not_noticed():
    reading = reader(FILE)
    reading.file.seek(15)
    assert reading.content(reading.next()) == b"abc"


def torn(data, size=None):
    """Where the file is torn."""
    reading = reader(data, size)
    try:
        while True:
            reading.content(reading.next())
    except TornError as found:
        return found.offset, reading.begun


def test_a_file_that_ends_is_torn_behind_its_last_whole_record():
    assert torn(FILE) == (29, 29)
    for end in range(20, 29):
        assert torn(FILE[:end]) == (20, 20), end
    for end in range(8, 20):
        assert torn(FILE[:end]) == (8, 8), end


def test_a_file_that_is_cut_while_it_is_read_is_torn_in_the_record_that_was_read():
    assert torn(FILE[:14], len(FILE)) == (8, 8)
    assert torn(FILE[:18], len(FILE)) == (8, 8)
    assert torn(FILE[:22], len(FILE)) == (20, 20)


def test_bytes_that_came_after_the_files_size_was_taken_are_not_read():
    for size, torn_at in ((22, 20), (28, 20), (16, 8), (19, 8)):
        assert torn(FILE, size) == (torn_at, torn_at)


def test_a_length_over_the_files_end_is_torn_whatever_it_is():
    for size in (4, 1 << 40, (1 << 64) - 1):
        assert torn(MAGIC + struct.pack("<BQ", 3, size) + b"abc") == (8, 8)


def test_the_largest_record_is_read_and_no_larger_one():
    class Endless(io.BytesIO):
        def read(self, size=-1):
            return super().read(size) or bytes(size)

    for size, read in ((RECORD_MAX, True), (RECORD_MAX + 1, False)):
        reading = RecordReader(Endless(MAGIC + struct.pack("<BQ", 3, size)), 1 << 40)
        record = reading.next()
        if read:
            assert reading.content(record) == bytes(size)
        else:
            with pytest.raises(BrokenError) as broken:
                reading.content(record)
            assert str(broken.value) == (
                f"the record at offset 8 has {size} bytes, a session writes at most {RECORD_MAX}"
            )


# ---------------------------------------------------------------- zeros


def zeros(data, at):
    """Whether a file ends in zeros, once everything before ``at`` was read."""
    reading = reader(data)
    reading.take(at - len(MAGIC), 8)
    return reading.ends_in_zeros()


def test_zeros_to_the_end_are_a_loss_of_power_and_nothing_else_is():
    assert zeros(MAGIC + b"ab" + bytes(20), 11)
    assert zeros(MAGIC + b"ab" + bytes(20), 28)
    assert not zeros(MAGIC + b"ab" + bytes(20), 10), "the byte that was read last is looked at as well"
    assert not zeros(MAGIC + b"ab" + bytes(20) + b"\1", 12)
    assert not zeros(MAGIC + b"ab" + bytes(20) + b"\1" + bytes(20), 12)


def test_fewer_zeros_than_a_record_begins_with_are_a_changed_byte():
    for count, found in ((8, False), (9, True)):
        data = MAGIC + b"abc" + bytes(count)
        assert zeros(data, len(data)) is found


def test_zeros_are_looked_at_up_to_a_bound_a_piece_at_a_time(monkeypatch):
    monkeypatch.setattr(raw, "ZEROS_MAX", 100)
    monkeypatch.setattr(raw, "PIECE", 7)
    assert zeros(MAGIC + bytes(101), 9)
    assert not zeros(MAGIC + bytes(102), 9)
    assert not zeros(MAGIC + bytes(99) + b"\1", 9)


def test_the_bounds_are_what_they_are():
    assert (raw.RECORD_MAX, raw.REMEMBERED_MAX) == (16_777_216, 16_777_216)
    assert (raw.ZEROS_MAX, raw.PIECE) == (67_108_864, 1_048_576)
    assert raw.PREFIX == 9


# ---------------------------------------------------------------- what is remembered


def test_what_is_remembered_is_bounded_in_all():
    budget = Budget()
    budget.remember(REMEMBERED_MAX - 5)
    budget.remember(5)
    with pytest.raises(BrokenError) as broken:
        budget.remember(1)
    assert str(broken.value) == (
        "it holds more schemas, channels, metadata and attachments than any session writes: "
        f"over {REMEMBERED_MAX} bytes without their content"
    )
