"""Records from and to their bytes: only the kinds a session writes, and only in their canonical form."""

import struct

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from cutgate.runtime.audit.container.kinds import KINDS, decode, encoded, misplaced
from cutgate.runtime.audit.container.raw import BrokenError

RECORDS = [
    Header("cutgate.audit/1", "x"),
    Footer(summary_start=1, summary_offset_start=2, summary_crc=3),
    Schema(1, b"{}", "jsonschema", "a"),
    Channel(1, "/a", "json", {"k": "v"}, 1),
    Message(channel_id=1, log_time=1, data=b"{}", publish_time=2, sequence=3),
    MessageIndex(1, [(1, 2), (3, 4)]),
    ChunkIndex(
        chunk_start_offset=1,
        chunk_length=2,
        message_start_time=3,
        message_end_time=4,
        message_index_offsets={1: 5},
        message_index_length=6,
        compression="",
        compressed_size=7,
        uncompressed_size=8,
    ),
    AttachmentIndex(offset=1, length=2, log_time=3, create_time=4, data_size=5, name="x", media_type="y"),
    Statistics(
        attachment_count=1,
        channel_count=2,
        channel_message_counts={1: 3},
        chunk_count=4,
        message_count=5,
        message_start_time=6,
        message_end_time=7,
        metadata_count=8,
        schema_count=9,
    ),
    Metadata("cutgate", {"log_id": "x"}),
    MetadataIndex(offset=1, length=2, name="x"),
    SummaryOffset(group_opcode=1, group_start=2, group_length=3),
    DataEnd(data_section_crc=1),
]


def packed(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def broken(opcode, content, text):
    with pytest.raises(BrokenError) as found:
        decode(opcode, content, 77)
    assert str(found.value) == f"the record at offset 77 {text}"


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_each_kind_is_read_as_it_is_written_and_in_no_other_form(record):
    whole = packed(record)
    assert encoded(record) == whole
    assert decode(whole[0], whole[9:], 0) == record
    if not isinstance(record, Message):  # whatever stands behind its head is its data
        broken(whole[0], whole[9:] + b"\0", "is damaged or not in its canonical form")
    with pytest.raises(BrokenError, match=r"cannot be read|canonical form"):
        decode(whole[0], whole[9:-1] if not isinstance(record, Message) else whole[9:20], 77)


def test_these_are_all_kinds_of_the_format_but_those_that_are_read_by_their_parts():
    assert sorted(KINDS) == sorted(packed(record)[0] for record in RECORDS)
    assert {int(opcode) for opcode in Opcode} - set(KINDS) == {Opcode.CHUNK, Opcode.ATTACHMENT}


def test_any_other_kind_is_named():
    broken(Opcode.CHUNK, b"", "is a chunk where none belongs")
    broken(Opcode.ATTACHMENT, b"", "is an attachment where none belongs")
    broken(0x80, b"", "is of unknown kind 0x80")
    broken(0, b"", "is of unknown kind 0x00")


@pytest.mark.parametrize(
    ("opcode", "content", "name"),
    [
        (Opcode.HEADER, struct.pack("<I", 1) + b"\xff" + struct.pack("<I", 0), "UnicodeDecodeError"),
        (Opcode.HEADER, b"", "EndOfFile"),
        (Opcode.FOOTER, b"\0", "error"),
    ],
)
def test_what_cannot_be_read_is_broken_and_says_how(opcode, content, name):
    broken(opcode, content, f"cannot be read ({name})")


@pytest.mark.parametrize("error", [ValueError, struct.error, OverflowError, MemoryError])
def test_whatever_the_library_raises_on_bytes_is_broken(monkeypatch, error):
    class Raising:
        @staticmethod
        def read(_stream):
            raise error("x")

    monkeypatch.setitem(KINDS, Opcode.HEADER, Raising)
    broken(Opcode.HEADER, b"", f"cannot be read ({error.__name__})")


def test_a_record_that_is_not_written_as_it_was_read_is_broken():
    """A map with a key twice: read, one of the two is lost."""
    pair = struct.pack("<I", 1) + b"k" + struct.pack("<I", 1) + b"v"
    twice = struct.pack("<I", 1) + b"x" + struct.pack("<I", 2 * len(pair)) + 2 * pair
    broken(Opcode.METADATA, twice, "is damaged or not in its canonical form")


def test_a_record_that_stands_elsewhere_is_named_with_its_place():
    text = "the record at offset 5 (Header) does not belong into a chunk"
    assert misplaced(Header("", ""), 5, "a chunk") == text
