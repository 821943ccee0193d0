"""One chunk: sound in itself, or which rule it breaks."""

import struct
import zlib

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, ChunkIndex, Header, Message, MessageIndex, Schema

from cutgate.runtime.audit.chain import of_channel
from cutgate.runtime.audit.container import raw
from cutgate.runtime.audit.container.chunk import Definitions, parse_chunk
from cutgate.runtime.audit.container.raw import BrokenError, Budget

PLACE = 1000
"""Of the chunk's content in the file."""


def packed(*contents):
    builder = RecordBuilder()
    for record in contents:
        record.write(builder)
    return builder.end()


def message(channel=1, log_time=5, sequence=0, data=b"{}", publish_time=6):
    return Message(
        channel_id=channel, log_time=log_time, data=data, publish_time=publish_time, sequence=sequence
    )


SCHEMA = Schema(1, b'{"type":"object"}', "jsonschema", "cutgate.Open")
CHANNEL = Channel(1, "/audit/open", "json", {}, 1)
OTHER = Channel(2, "/can/frame", "cbor", {}, 1)


def chunk(content, first=5, last=5, **changes):
    """The bytes of a chunk with this content; sizes and checksum fit unless they are given."""
    size, crc, compression, length = (
        changes.get(name, value)
        for name, value in (
            ("size", len(content)),
            ("crc", zlib.crc32(content)),
            ("compression", 0),
            ("length", len(content)),
        )
    )
    return struct.pack("<QQQIIQ", first, last, size, crc, compression, length) + content


def parsed(data, definitions=None):
    return parse_chunk(data, PLACE, definitions or Definitions(Budget()))


def broken(data, text, definitions=None):
    with pytest.raises(BrokenError) as found:
        parsed(data, definitions)
    assert str(found.value) == text


def defined():
    definitions = Definitions(Budget())
    parsed(chunk(packed(SCHEMA, CHANNEL, message())), definitions)
    return definitions


def test_a_chunk_gives_its_messages_with_what_their_channels_say():
    content = packed(
        SCHEMA, CHANNEL, message(data=b'{"a":1}'), OTHER, message(2, 9, 1, b"x", 10), message(1, 7, 2, b"")
    )
    found = parsed(chunk(content, 5, 9))
    assert [(one.log_time, one.publish_time, one.sequence, one.data) for one in found.messages] == [
        (5, 6, 0, b'{"a":1}'),
        (9, 10, 1, b"x"),
        (7, 6, 2, b""),
    ]
    for one in found.messages:
        at = one.offset - PLACE - 40
        assert content[at : at + len(one.data)] == one.data
    first, second = found.messages[0].channel, found.messages[1].channel
    assert first is found.messages[2].channel
    kind = ("/audit/open", "json", "cutgate.Open", b'{"type":"object"}')
    assert (first.topic, first.encoding, first.schema_name, first.schema) == kind
    assert first.covered == of_channel(*kind)
    assert (second.topic, second.encoding) == ("/can/frame", "cbor")
    assert found.defined == [SCHEMA, CHANNEL, OTHER]
    assert (found.first, found.last, found.size) == (5, 9, len(content))


def test_the_indexes_that_must_follow_are_those_the_writer_makes():
    content = packed(SCHEMA, CHANNEL, OTHER, message(2), message(1), message(2, 8, 2))
    found = parsed(chunk(content, 5, 8))
    places, at = [], 0
    while at < len(content):
        if content[at] == 5:
            places.append(at)
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    wanted = [
        (2, packed(MessageIndex(2, [(5, places[0]), (8, places[2])]))[9:]),
        (1, packed(MessageIndex(1, [(5, places[1])]))[9:]),
    ]
    assert list(found.indexes()) == wanted
    assert {channel: len(entries) for channel, entries in found.entries.items()} == {2: 2, 1: 1}


def test_what_one_chunk_has_defined_the_next_may_use():
    found = parsed(chunk(packed(message())), defined())
    assert found.messages[0].topic == "/audit/open"
    assert found.defined == []


# ---------------------------------------------------------------- what a chunk says of itself


@pytest.mark.parametrize("length", [0, 39])
def test_a_chunk_has_a_head(length):
    broken(chunk(b"")[:length], "it is too short to be one")


GOOD = packed(SCHEMA, CHANNEL, message())


@pytest.mark.parametrize(
    "changes",
    [
        {"compression": 1},
        {"compression": 4},
        {"size": len(GOOD) + 1},
        {"size": 0},
        {"length": len(GOOD) - 1},
        {"size": len(GOOD) - 1, "length": len(GOOD) - 1},
    ],
)
def test_a_chunk_is_stored_as_it_is(changes):
    broken(chunk(GOOD, **changes), "it is not stored as it is")


def test_a_chunks_checksum_is_that_of_its_content():
    broken(chunk(GOOD, crc=zlib.crc32(GOOD) ^ 1), "its checksum is wrong")
    broken(chunk(GOOD, crc=0), "its checksum is wrong")


@pytest.mark.parametrize(("first", "last"), [(4, 8), (6, 8), (5, 7), (5, 9), (8, 5)])
def test_a_chunks_times_are_those_of_its_messages(first, last):
    content = packed(SCHEMA, CHANNEL, message(), message(1, 8, 1), message(1, 6, 2))
    assert len(parsed(chunk(content, 5, 8)).messages) == 3
    broken(chunk(content, first, last), "its times are not those of its messages")


def test_a_chunk_without_messages_is_none():
    broken(chunk(packed(SCHEMA, CHANNEL), 0, 0), "its times are not those of its messages")
    broken(chunk(b"", 0, 0), "its times are not those of its messages")


# ---------------------------------------------------------------- its records


@pytest.mark.parametrize("left", range(1, 9))
def test_a_record_that_begins_and_does_not_end_is_broken(left):
    broken(chunk(GOOD + bytes(left)), f"a record runs over the end, {len(GOOD)} bytes in")


def test_a_record_longer_than_the_chunk_is_broken():
    for size in (1, 1 << 63):
        broken(chunk(GOOD + struct.pack("<BQ", 3, size)), f"a record runs over the end, {len(GOOD)} bytes in")


def test_a_message_has_its_head():
    short = struct.pack("<BQ", 5, 21) + bytes(21)
    broken(
        chunk(GOOD + short), f"the record at offset {len(GOOD)} cannot be read (a message that is too short)"
    )
    empty = struct.pack("<BQHIQQ", 5, 22, 1, 3, 5, 5)
    assert parsed(chunk(GOOD + empty)).messages[1].data == b""


def test_a_message_names_a_channel_that_was_defined_before_it():
    broken(chunk(packed(SCHEMA, CHANNEL, message(7, 5, 3))), "message 3 names no channel")
    broken(chunk(packed(SCHEMA, message(1, 5, 4), CHANNEL)), "message 4 names no channel")


def test_a_channel_names_a_schema_that_was_defined_before_it():
    broken(chunk(packed(CHANNEL, SCHEMA, message())), "channel /audit/open names no schema")
    broken(chunk(packed(SCHEMA, Channel(3, "/x", "json", {}, 2), message())), "channel /x names no schema")


@pytest.mark.parametrize(
    ("again", "what"),
    [
        (SCHEMA, "schema 1"),
        (Schema(1, b"", "", "other"), "schema 1"),
        (CHANNEL, "channel 1"),
        (Channel(1, "/other", "json", {}, 1), "channel 1"),
        (Schema(0, b"", "", ""), "schema 0"),
        (Channel(0, "/x", "json", {}, 1), "channel 0"),
    ],
)
def test_nothing_is_defined_twice_identical_or_not_nor_without_a_number(again, what):
    """Also not by a later chunk: a reader that keeps the last one would show another topic or schema."""
    told = f"{what} is given twice or has no number"
    broken(chunk(GOOD + packed(again)), told)
    broken(chunk(packed(again, message())), told, defined())


def test_nothing_else_stands_in_a_chunk():
    at = len(GOOD)
    broken(
        chunk(GOOD + packed(Header("", ""))),
        f"the record at offset {at} (Header) does not belong into a chunk",
    )
    broken(chunk(GOOD + struct.pack("<BQ", 0x80, 0)), f"the record at offset {at} is of unknown kind 0x80")


def test_what_is_defined_is_remembered_within_a_bound(monkeypatch):
    definitions = packed(SCHEMA, CHANNEL)
    monkeypatch.setattr(raw, "REMEMBERED_MAX", len(definitions))
    assert parsed(chunk(GOOD))
    monkeypatch.setattr(raw, "REMEMBERED_MAX", len(definitions) - 1)
    with pytest.raises(BrokenError, match="it holds more schemas"):
        parsed(chunk(GOOD))


def test_the_summary_holds_its_place_times_and_sizes():
    data = packed(SCHEMA, CHANNEL, message(log_time=9), message(log_time=5))
    index = parsed(chunk(data, 5, 9)).summary_index(40, 300, {1: 340}, 47)
    assert index == ChunkIndex(
        chunk_start_offset=40,
        chunk_length=300,
        message_start_time=5,
        message_end_time=9,
        message_index_offsets={1: 340},
        message_index_length=47,
        compression="",
        compressed_size=len(data),
        uncompressed_size=len(data),
    )
