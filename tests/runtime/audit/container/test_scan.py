"""A whole file from front to back: what it holds, where it is torn, and the first rule that it breaks."""

import io
import struct
import zlib

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Header, Message, Metadata
from mcap.writer import CompressionType, Writer

from cutgate.runtime.audit.chain import GENESIS, advance
from cutgate.runtime.audit.container import raw
from cutgate.runtime.audit.container.raw import MAGIC
from cutgate.runtime.audit.container.scan import scan, walk
from cutgate.runtime.audit.container.stored import Scan

MESSAGES = [("/a", 5, b"{}"), ("/b", 9, b"[1]"), ("/a", 3, b"")]
ATTACHED = [("plan.csv", b"x,y\n"), ("empty", b"")]


def written():
    """Two attachments, two chunks of messages, metadata before and behind them."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, enable_data_crcs=True)
    writer.start("cutgate.audit/1", "x")
    writer.add_metadata("cutgate", {"log_id": "1"})
    for name, data in ATTACHED:
        writer.add_attachment(1, 2, name, "text/plain", data)
    channels = {}
    for number, (topic, time, data) in enumerate(MESSAGES):
        if topic not in channels:
            schema = writer.register_schema(topic.strip("/"), "jsonschema", b"{}")
            channels[topic] = writer.register_channel(topic, "json", schema)
        writer.add_message(channels[topic], time, data, time + 1, number)
        if number == 1:
            writer.flush()
    writer.flush()
    writer.add_metadata("more", {})
    writer.finish()
    return stream.getvalue()


FILE = written()


def raws(data=FILE):
    """The records of a file, whole."""
    at, found = len(MAGIC), []
    while at < len(data) - len(MAGIC):
        size = 9 + struct.unpack_from("<Q", data, at + 1)[0]
        found.append(data[at : at + size])
        at += size
    return found


KINDS = [record[0] for record in raws()]
STARTS = [len(MAGIC) + sum(map(len, raws()[:number])) for number in range(len(KINDS))]


def packed(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def joined(records):
    """A file of these records, the checksum of its data section made to fit."""
    data = MAGIC + b"".join(records) + MAGIC
    end = data.find(struct.pack("<BQ", Opcode.DATA_END, 4))
    if end < 0:
        return data
    return data[: end + 9] + struct.pack("<I", zlib.crc32(data[:end])) + data[end + 13 :]


def problem(data):
    """What is wrong with a file that is whole."""
    found = scan(data)
    assert found.problems != [] or found.torn_at is not None
    assert not found.finished
    assert found.torn_at is None
    (text,) = found.problems
    return text


def place(opcode, which=0):
    return [number for number, kind in enumerate(KINDS) if kind == opcode][which]


def replaced(number, *records):
    return joined([*raws()[:number], *records, *raws()[number + 1 :]])


def test_a_sound_file_is_read_to_its_last_byte():
    found = scan(FILE)
    assert (found.problems, found.finished, found.torn_at, found.zeros, found.mcap) == (
        [],
        True,
        None,
        False,
        True,
    )
    assert found.size == len(FILE)
    assert found.header == Header("cutgate.audit/1", "x")
    assert [
        (one.topic, one.log_time, one.publish_time, one.sequence, one.data) for one in found.messages
    ] == [(topic, time, time + 1, number, data) for number, (topic, time, data) in enumerate(MESSAGES)]
    for one in found.messages:
        assert FILE[one.offset : one.offset + len(one.data)] == one.data
    assert [(one.name, one.data) for one in found.attachments] == ATTACHED
    assert found.metadata == [Metadata("cutgate", {"log_id": "1"}), Metadata("more", {})]
    assert found.attachment("empty").size == 0
    assert found.attachment("other") is None
    assert joined(raws()) == FILE


def test_the_chain_of_a_message_is_the_same_by_its_link_and_by_its_channel():
    for one in scan(FILE).messages:
        assert one.advance(GENESIS) == advance(GENESIS, one.link)


@pytest.mark.parametrize("data", [b"", b"x", MAGIC[:-1], b"\0" + MAGIC[1:] + FILE])
def test_another_file_is_none(data):
    found = scan(data)
    assert (found.mcap, found.problems) == (False, ["the file does not start as an MCAP file"])
    assert found.torn_at is None


# ---------------------------------------------------------------- torn


def test_a_file_cut_anywhere_is_torn_at_its_last_record_and_keeps_what_stands_before():
    for end in range(len(MAGIC), len(FILE)):
        found = scan(FILE[:end])
        begun = [start for start in (*STARTS, len(FILE) - len(MAGIC)) if start <= end][-1]
        assert (found.torn_at, found.problems, found.finished) == (begun, [], False), end
    whole = scan(FILE[: STARTS[place(Opcode.CHUNK, 1)] + 20])
    assert len(whole.messages) == 2
    assert len(whole.attachments) == 2


def test_the_messages_of_a_chunk_whose_index_is_cut_off_are_kept():
    found = scan(FILE[: STARTS[place(Opcode.MESSAGE_INDEX)]])
    assert len(found.messages) == 2
    assert found.torn_at == STARTS[place(Opcode.MESSAGE_INDEX)]


def test_a_file_with_both_ends_was_finished_and_lacks_nothing():
    number = place(Opcode.ATTACHMENT)
    longer = bytearray(raws()[number])
    longer[7] = 1
    found = scan(replaced(number, bytes(longer)))
    assert found.problems == [f"the record at offset {STARTS[number]} is longer than the file"]
    assert found.torn_at == STARTS[number]
    assert scan(MAGIC).problems == []
    assert scan(MAGIC + MAGIC).problems != []


def test_zeros_at_the_end_are_a_loss_of_power():
    for count in (9, 200):
        found = scan(FILE[: STARTS[place(Opcode.CHUNK, 1)]] + bytes(count))
        assert (found.zeros, found.problems) == (True, [])
        assert found.torn_at == STARTS[place(Opcode.CHUNK, 1)]
    found = scan(FILE[: STARTS[place(Opcode.CHUNK, 1)]] + bytes(200) + b"\1")
    assert (found.zeros, found.torn_at) == (False, None)


# ---------------------------------------------------------------- each rule


def test_the_first_record_is_the_header():
    assert problem(joined(raws()[1:])) == "the record at offset 8 is no header"


@pytest.mark.parametrize("record", [Header("a", "b"), Message(1, 1, b"{}", 1, 9)])
def test_a_record_that_stands_where_none_of_its_kind_belongs_is_named(record):
    number = place(Opcode.DATA_END)
    told = f"the record at offset {STARTS[number]} ({type(record).__name__}) does not belong into the data section"
    assert problem(replaced(number, packed(record), raws()[number])) == told


def test_the_data_sections_checksum_is_that_of_its_bytes():
    number = place(Opcode.DATA_END)
    wrong = MAGIC + b"".join([*raws()[:number], packed(DataEnd(1)), *raws()[number + 1 :]]) + MAGIC
    assert problem(wrong) == "the data section's checksum is wrong"


def test_a_chunk_that_breaks_a_rule_is_named_by_its_place():
    number = place(Opcode.CHUNK, 1)
    changed = bytearray(raws()[number])
    changed[-1] ^= 1
    assert (
        problem(replaced(number, bytes(changed)))
        == f"chunk at offset {STARTS[number]}: its checksum is wrong"
    )


@pytest.mark.parametrize("which", range(KINDS.count(Opcode.MESSAGE_INDEX)))
def test_each_chunk_is_followed_by_the_index_of_each_of_its_channels(which):
    number = place(Opcode.MESSAGE_INDEX, which)
    chunk = max(n for n, kind in enumerate(KINDS[:number]) if kind == Opcode.CHUNK)
    told = (
        f"chunk at offset {STARTS[chunk]}: the index at offset {STARTS[number]} is not that of its messages"
    )
    other = bytearray(raws()[number])
    other[-1] ^= 1
    assert problem(replaced(number)) == told
    assert problem(replaced(number, bytes(other))) == told
    as_another_kind = bytes([Opcode.METADATA_INDEX]) + raws()[number][1:]
    assert problem(replaced(number, as_another_kind)) == told


def test_one_index_too_many_is_misplaced():
    number = place(Opcode.MESSAGE_INDEX)
    last = place(Opcode.DATA_END)
    assert "(MessageIndex) does not belong" in problem(replaced(last, raws()[number], raws()[last]))


SUMMARY = range(place(Opcode.DATA_END) + 1, len(KINDS) - 1)


@pytest.mark.parametrize("number", SUMMARY)
def test_nothing_is_missing_from_the_summary_doubled_or_other_in_it(number):
    kept = raws()[number]
    whose = (
        "the summary's offsets are not"
        if KINDS[number] == Opcode.SUMMARY_OFFSET
        else "the summary is not that"
    )
    assert problem(replaced(number)).startswith("the summary")
    assert problem(replaced(number, kept, kept)).startswith("the summary")
    other = bytearray(kept)
    other[9] ^= 4
    assert problem(replaced(number, bytes(other))).startswith((whose, "the record at offset"))


def test_the_footer_points_at_the_summary_and_covers_it():
    footer = bytearray(raws()[-1])
    footer[9] ^= 1
    assert problem(replaced(len(KINDS) - 1, bytes(footer))) == "the footer does not point at the summary"
    footer = bytearray(raws()[-1])
    footer[-1] ^= 1
    assert problem(replaced(len(KINDS) - 1, bytes(footer))) == "the summary's checksum is wrong"


@pytest.mark.parametrize("tail", [MAGIC + b"x", MAGIC + MAGIC, b"x" + MAGIC, b"12345678", b"x"])
def test_the_file_ends_behind_its_footer(tail):
    data = FILE[: -len(MAGIC)] + tail
    assert problem(data) == f"the file does not end with the footer at offset {STARTS[-1]}"


def test_metadata_are_remembered_within_a_bound(monkeypatch):
    size = len(raws()[place(Opcode.METADATA)])
    monkeypatch.setattr(raw, "REMEMBERED_MAX", size - 1)
    assert problem(FILE).startswith("it holds more schemas, channels, metadata")


def test_every_part_that_is_remembered_counts(monkeypatch):
    """Metadata, attachments' names and places, schemas, channels and the summary's offsets: all but the last byte."""
    kinds = (Opcode.METADATA, Opcode.SUMMARY_OFFSET)
    size = sum(len(record) for record in raws() if record[0] in kinds)
    size += sum(len(name) + len("text/plain") + 9 for name, _ in ATTACHED)
    first = place(Opcode.DATA_END)
    size += sum(len(record) for record in raws()[first:] if record[0] in (Opcode.SCHEMA, Opcode.CHANNEL))
    monkeypatch.setattr(raw, "REMEMBERED_MAX", size)
    assert scan(FILE).finished
    monkeypatch.setattr(raw, "REMEMBERED_MAX", size - 1)
    assert not scan(FILE).finished


def test_no_record_that_is_read_as_a_whole_is_larger_than_a_sessions(monkeypatch):
    for opcode in (Opcode.HEADER, Opcode.METADATA, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.STATISTICS):
        record = raws()[place(opcode)]
        with monkeypatch.context() as patched:
            patched.setattr(raw, "RECORD_MAX", len(record) - 10)
            assert "a session writes at most" in problem(FILE), opcode


def test_the_messages_come_one_chunk_at_a_time():
    class Counting(io.BytesIO):
        last = 0

        def read(self, size=-1):
            data = super().read(size)
            Counting.last = max(Counting.last, self.tell())
            return data

    found = Scan()
    messages = walk(Counting(FILE), found)
    next(messages)
    assert Counting.last == STARTS[place(Opcode.MESSAGE_INDEX)]
    assert len(list(messages)) == 2
    assert found.messages == []
