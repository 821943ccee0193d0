"""The judge of logs: whatever is changed, cut off or added, a log is never OK."""

import io
import struct
import tracemalloc
import zlib
from dataclasses import replace
from hashlib import sha256

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from cutgate.protocol import candump
from cutgate.runtime.audit import records, second_reading
from cutgate.runtime.audit.container.raw import MAGIC
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.heads import closing_head, recoverable_head
from cutgate.runtime.audit.inspect import Status, read_log, verify_log
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.signer import Signer
from cutgate.runtime.audit.writer import LogWriter
from tests.logs import create, signature_of, signer_of
from tests.runtime.audit.build import (
    LOG_ID,
    OPENED,
    PATIENCE_S,
    Ticking,
    decision,
    enable,
    forge,
    small_log,
)

FRAMES = 3 * candump.line(1_790_000_000_123_456_789, "vcan0", 0x080, bytes(range(8))).encode()
"""What ``small_log`` writes beside the log."""
KEY = LogKey(bytes(16), 1, bytes(range(32)))
SIGNER = Signer(KEY, "ab" * 16)
OF_KEY = {"series": KEY.series.hex(), "epoch": 1, "public_key": KEY.public.public.hex(), "enrolled": "here"}


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    return small_log(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def data(paths):
    return paths.log.read_bytes()


def verified(data):
    """The judgement with the raw frames of the small log beside it."""
    return verify_log(data, FRAMES, signature_of(data))


def signed_again(data):
    """The judgement of a log without raw frames, signed by whoever has its key."""
    return verify_log(data, b"", signature_of(data))


def judged(data, word="", status=Status.TAMPERED):
    report = verified(data)
    assert report.status is status, report
    assert word in report.reasons[0]
    return report


# ---------------------------------------------------------------- bytes


def test_the_log_is_ok_and_says_by_which_key_and_anchor(data):
    report = verified(data)
    told = f"OK (signed, key {report.key.fingerprint} from the log itself; no anchor given)"
    assert (report.status, report.headline) == (Status.OK, told)
    assert verified(data[:-1]).headline == "INCOMPLETE"


@pytest.mark.no_cover
def test_a_flipped_bit_is_never_ok(data):
    """Every eleventh byte, so every region of the file: headers, payloads, attachments, indexes, summary."""
    found = set()
    for place in range(0, len(data), 11):
        changed = bytearray(data)
        changed[place] ^= 1 << (place % 8)
        status = verified(bytes(changed)).status
        found.add(status)
        assert status in (Status.TAMPERED, Status.UNREADABLE), f"byte {place}"
    assert Status.TAMPERED in found


@pytest.mark.no_cover
def test_every_byte_of_the_frame_of_the_file_counts(data):
    """Start, header, end of the data section, summary and footer, byte by byte."""
    summary = data.index(struct.pack("<BQ", Opcode.DATA_END, 4))
    for place in (*range(64), *range(summary, len(data), 17), *range(len(data) - 64, len(data))):
        changed = bytearray(data)
        changed[place] ^= 0xFF
        assert verified(bytes(changed)).status is not Status.OK, f"byte {place}"


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_changed_stretches_are_never_ok(data, draws):
    start = draws.draw(st.integers(0, len(data) - 1))
    new = draws.draw(st.binary(min_size=1, max_size=40))
    changed = data[:start] + new + data[start + len(new) :]
    assert (verified(changed).status is Status.OK) == (changed == data)


@pytest.mark.no_cover
def test_a_log_cut_anywhere_is_incomplete(data):
    for end in range(len(MAGIC), len(data), 13):
        report = verified(data[:end])
        assert report.status is Status.INCOMPLETE, (end, report)
    for end in range(len(data) - 200, len(data)):
        assert verified(data[:end]).status is Status.INCOMPLETE


def places_of(data, *opcodes):
    """Begin and end of every record of these kinds, read from the bytes."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found += [(at, at + 9 + size)] * (opcode in opcodes)
        at += 9 + size
    return found


@pytest.fixture(scope="module")
def crashed(data):
    """As it stands before the close record's chunk."""
    close = data.index(b'"final_state"')
    return data[: max(begin for begin, end in places_of(data, Opcode.CHUNK) if begin < close)]


@pytest.mark.parametrize("zeros", [9, 100, 4096, 1 << 20])
def test_zeros_behind_the_last_whole_record_are_a_loss_of_power(crashed, zeros):
    for begin, end in places_of(crashed, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)[-6:]:
        for kept in (begin, begin + 1, begin + 9, (begin + end) // 2, end):
            report = judged(crashed[:kept] + bytes(zeros), "the file ends early", Status.INCOMPLETE)
            assert report.dropped_bytes >= zeros
            assert report.messages == verified(crashed[:begin]).messages or kept == end


def test_zeros_with_anything_behind_them_are_no_loss_of_power(crashed, data):
    begin, end = places_of(crashed, Opcode.CHUNK)[-1]
    for log in (crashed, data):
        judged(log[:begin] + bytes(end - begin) + log[end:], "the record at offset", Status.TAMPERED)
        judged(log[: end - 40] + bytes(40) + log[end:], "checksum", Status.TAMPERED)
    for tail in (b"\1", b"\0\1", MAGIC, crashed[begin:end]):
        assert verified(crashed[:begin] + bytes(100) + tail).status is Status.TAMPERED


@pytest.mark.parametrize("zeros", [1, 8])
def test_fewer_zeros_than_a_record_begins_with_are_a_changed_byte(crashed, zeros):
    _begin, end = places_of(crashed, Opcode.CHUNK)[-1]
    changed = crashed[: end - zeros - 1] + b"x" + bytes(zeros)
    judged(changed, "checksum", Status.TAMPERED)


def test_power_that_was_lost_behind_the_close_record_left_no_signature(data):
    """The last bytes are synced before the file is signed: with its signature beside it a log has been changed."""
    behind = places_of(data, Opcode.DATA_END)[0][0]
    for at in (behind, behind + 9, len(data) - 100):
        left = data[:at] + bytes(len(data) - at)
        report = verify_log(left, FRAMES)
        assert report.status is Status.INCOMPLETE, report
        assert any("it ends in zeros" in reason for reason in report.reasons)
        assert verify_log(left, FRAMES, signature_of(data)).status is Status.TAMPERED


def test_the_zeros_that_are_looked_at_are_bounded(crashed, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.audit.container.raw.ZEROS_MAX", 1000)
    assert verified(crashed + bytes(900)).status is Status.INCOMPLETE
    assert verified(crashed + bytes(2000)).status is Status.TAMPERED


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"hello", b"\x00" * 100, MAGIC[:-1]])
def test_another_file_is_unreadable(content):
    judged(content, "not an audit log", Status.UNREADABLE)


def test_a_log_of_another_program_is_unreadable():
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2", "x")
    writer.finish()
    judged(stream.getvalue(), "not an audit log", Status.UNREADABLE)


def test_the_first_magic_alone_is_incomplete():
    judged(MAGIC, "before its first record", Status.INCOMPLETE)


def test_a_cut_log_says_what_is_left(data):
    end = data.rindex(struct.pack("<B", Opcode.CHUNK), 0, data.index(b'"final_state"')) + 20
    report = verified(data[:end])
    whole = read_log(data)
    assert report.messages == whole.report.messages - 1
    assert report.dropped_bytes > 0
    assert "record" in report.reasons[0]
    assert report.head == recoverable_head(io.BytesIO(data[:end])) != whole.report.head


def test_a_judgements_number_is_the_exit_code_of_the_command():
    assert {status.name: int(status) for status in Status} == {
        "OK": 0,
        "INCOMPLETE": 1,
        "TAMPERED": 2,
        "UNREADABLE": 3,
    }


def test_what_is_dropped_are_the_bytes_behind_the_last_whole_record(data):
    begin, end = places_of(data, Opcode.CHUNK)[-1]
    assert verified(data).dropped_bytes == 0
    for left in (0, 5, end - begin - 1):
        assert verified(data[: begin + left]).dropped_bytes == left


def test_a_wrong_length_in_a_finished_file_is_tampered(data):
    place = data.index(b"plan.csv") - 4 - 16 - 8
    changed = bytearray(data)
    changed[place + 5] = 1
    judged(bytes(changed), "longer than the file")


def test_a_closed_log_without_end_is_incomplete(data):
    unfinished = data[: data.index(struct.pack("<BQ", Opcode.DATA_END, 4))]
    judged(unfinished, "ends early", Status.INCOMPLETE)


def test_a_finished_log_without_close_record_is_incomplete(data):
    forged = forge(data, lambda record: None if isinstance(record, records.AuditClose) else record)
    judged(forged, "no close record", Status.INCOMPLETE)


# ---------------------------------------------------------------- records of the file


def raws(data):
    """The records of a file as (opcode, bytes), read without the code under test."""
    at, found = len(MAGIC), []
    while at < len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found.append((opcode, data[at : at + 9 + size]))
        at += 9 + size
    return found


def joined(entries):
    return MAGIC + b"".join(body for _, body in entries) + MAGIC


def packed(*contents):
    builder = RecordBuilder()
    for record in contents:
        record.write(builder)
    return builder.end()


def inserted(data, before, content):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == before)
    return joined([*entries[:place], (0, content), *entries[place:]])


def rechunked(data, change, *, number=0, **fields):
    """The first or another chunk with changed content, its checksum and size made to fit."""
    entries = raws(data)
    place = [place for place, (opcode, _) in enumerate(entries) if opcode == Opcode.CHUNK][number]
    chunk = Chunk.read(ReadDataStream(io.BytesIO(entries[place][1][9:])))
    content = change(chunk.data)
    new = {"data": content, "uncompressed_crc": zlib.crc32(content), "uncompressed_size": len(content)}
    entries[place] = (Opcode.CHUNK, packed(replace(chunk, **(new | fields))))
    return joined(entries)


def first_schema(content):
    """The first schema of a chunk once more, byte for byte."""
    at = 0
    while content[at] != Opcode.SCHEMA:
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    return content[at : at + 9 + struct.unpack_from("<Q", content, at + 1)[0]]


MESSAGE = Message(channel_id=1, log_time=1, data=b"{}", publish_time=1, sequence=9)


def test_a_message_outside_a_chunk_is_tampered(data):
    """A linear reader would show it, an indexed one would not."""
    judged(inserted(data, Opcode.DATA_END, packed(MESSAGE)), "(Message) does not belong into the data")


def test_an_unknown_record_is_tampered(data):
    judged(inserted(data, Opcode.DATA_END, struct.pack("<BQ", 0x80, 0)), "unknown kind 0x80")


def test_a_record_with_a_hidden_tail_is_tampered(data):
    hidden = packed(Header("a", "b"))[9:] + b"hidden"
    judged(
        inserted(data, Opcode.CHUNK, struct.pack("<BQ", Opcode.HEADER, len(hidden)) + hidden),
        "canonical form",
    )


def test_a_message_too_short_for_its_head_is_tampered(data):
    judged(inserted(data, Opcode.DATA_END, struct.pack("<BQ", Opcode.MESSAGE, 3) + b"abc"), "cannot be read")


def test_a_file_without_header_is_tampered(data):
    judged(joined(raws(data)[1:]), "no header")


@pytest.mark.parametrize("tail", [b"x", MAGIC])
def test_bytes_after_the_end_are_tampered(data, tail):
    assert verified(data + tail).status is Status.TAMPERED


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda content: content + packed(MESSAGE), "times are not those"),
        (lambda content: content + packed(replace(MESSAGE, channel_id=99)), "names no channel"),
        (lambda content: content + packed(Schema(1, b"", "", "x")), "given twice"),
        (lambda content: content + first_schema(content), "schema 1 is given twice"),
        (lambda content: content + packed(Schema(0, b"", "", "x")), "has no number"),
        (lambda content: content + packed(Channel(9, "t", "json", {}, 99)), "names no schema"),
        (lambda content: content + packed(Header("", "")), "does not belong into a chunk"),
        (lambda content: content + b"\x05\xff", "runs over the end"),
        (lambda content: content + packed(Schema(77, b"", "", "x")), "summary is not that"),
    ],
)
def test_a_chunk_that_holds_something_else_is_tampered(data, change, word):
    if "summary" in word:  # found last: the checksum of the data section must fit first
        changed = rechunked(data, change)
        end = changed.index(struct.pack("<BQ", Opcode.DATA_END, 4))
        changed = changed[: end + 9] + struct.pack("<I", zlib.crc32(changed[:end])) + changed[end + 13 :]
        judged(changed, word)
    else:
        judged(rechunked(data, change), word)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"message_start_time": 0}, "times"),
        ({"message_end_time": 2**63}, "times"),
        ({"uncompressed_crc": 0}, ": its checksum is wrong"),
        ({"uncompressed_size": 1}, "not stored as it is"),
        ({"compression": "zstd"}, "not stored as it is"),
    ],
)
def test_a_chunk_that_says_something_else_of_itself_is_tampered(data, fields, word):
    judged(rechunked(data, lambda content: content, **fields), word)


def raw(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


@pytest.mark.parametrize(
    ("record", "word"),
    [
        (raw(Opcode.CHUNK, bytes(39)), "it is too short to be one"),
        (raw(Opcode.ATTACHMENT, bytes(16) + struct.pack("<I", 99) + bytes(40)), "longer than its record"),
        (raw(Opcode.ATTACHMENT, bytes(16) + b"\1\0\0\0\xff" + bytes(16)), "no UTF-8"),
        (raw(Opcode.ATTACHMENT, bytes(32) + b"more than it says" + bytes(4)), "not in its canonical form"),
        (raw(Opcode.ATTACHMENT, bytes(32) + b"\1\2\3\4"), "not in its canonical form"),
    ],
)
def test_a_record_that_is_not_what_it_says_of_itself_is_tampered(data, record, word):
    judged(inserted(data, Opcode.CHUNK, record), word)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (raw(Opcode.MESSAGE, bytes(21)), "a message that is too short"),
        (raw(Opcode.MESSAGE, bytes(22))[:-1], "runs over the end, 0 bytes in"),
        (raw(Opcode.CHUNK, b""), "is a chunk where none belongs"),
        (raw(Opcode.ATTACHMENT, b""), "is an attachment where none belongs"),
        (packed(Message(9, 0, b"", 0, 7)), "message 7 names no channel"),
    ],
)
def test_a_chunk_whose_parts_are_not_what_they_say_of_themselves_is_tampered(data, content, word):
    judged(rechunked(data, lambda _content: content), word)


def test_what_stands_behind_the_summarys_offsets_is_tampered(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.FOOTER)
    judged(joined([*entries[:place], entries[place - 20], entries[place]]), "the summary's offsets are not")


def test_a_summary_of_endless_groups_is_not_read_to_its_end(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.SCHEMA)
    kinds = dict(entries[place:])
    two = [(opcode, kinds[opcode]) for opcode in (Opcode.SCHEMA, Opcode.CHANNEL)]
    judged(joined([*entries[:place], *two * 4, *entries[place:]]), "the summary is not that")


def test_a_chunk_without_messages_is_tampered(data):
    judged(rechunked(data, lambda _content: b""), "times")


def test_a_chunk_without_its_index_is_tampered(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.MESSAGE_INDEX)
    judged(joined(entries[:place] + entries[place + 1 :]), "index")


def test_an_index_that_points_elsewhere_is_tampered(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.MESSAGE_INDEX)
    entries[place] = (Opcode.MESSAGE_INDEX, packed(MessageIndex(1, [(1, 1)])))
    judged(joined(entries), "index")


def test_a_log_cut_between_a_chunk_and_its_index_is_incomplete(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.MESSAGE_INDEX)
    judged(joined(entries[:place])[: -len(MAGIC)], "ends early", Status.INCOMPLETE)


@pytest.mark.parametrize(
    "kind", [Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.SCHEMA]
)
def test_a_summary_that_leaves_something_out_is_tampered(data, kind):
    entries = raws(data)
    place = max(number for number, (opcode, _) in enumerate(entries) if opcode == kind)
    judged(joined(entries[:place] + entries[place + 1 :]), "summary is not that")


def test_statistics_of_another_log_are_tampered(data):
    entries = raws(data)
    place = next(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.STATISTICS)
    statistics = Statistics.read(ReadDataStream(io.BytesIO(entries[place][1][9:])))
    entries[place] = (Opcode.STATISTICS, packed(replace(statistics, message_count=1)))
    judged(joined(entries), "summary is not that")


def test_a_summary_offset_that_is_missing_is_tampered(data):
    entries = raws(data)
    place = max(number for number, (opcode, _) in enumerate(entries) if opcode == Opcode.SUMMARY_OFFSET)
    judged(joined(entries[:place] + entries[place + 1 :]), "offsets")


@pytest.mark.parametrize("field", [0, 8, 16])
def test_a_footer_that_says_something_else_is_tampered(data, field):
    changed = bytearray(data)
    changed[len(data) - len(MAGIC) - 20 + field] ^= 1
    judged(bytes(changed), "footer" if field < 16 else "summary's checksum")


def test_the_data_sections_checksum_counts(data):
    changed = bytearray(data)
    changed[data.index(struct.pack("<BQ", Opcode.DATA_END, 4)) + 9] ^= 1
    judged(bytes(changed), "data section's checksum")


# ---------------------------------------------------------------- messages


def unlinked(data, change):
    """The log written again with a sound structure and raw messages changed: the chain is not made to fit."""
    found = scan(data)
    stream = io.BytesIO()
    writer = Writer(stream, compression=LogWriter("", {})._mcap._Writer__compression, enable_data_crcs=True)
    writer.start(found.header.profile, found.header.library)
    for entry in found.metadata:
        writer.add_metadata(entry.name, entry.metadata)
    for entry in found.attachments:
        writer.add_attachment(entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data)
    channels = {}
    for link in change([message.link for message in found.messages]):
        key = (link.topic, link.encoding, link.schema_name, link.schema)
        if key not in channels:
            schema = writer.register_schema(link.schema_name, "jsonschema", link.schema)
            channels[key] = writer.register_channel(link.topic, link.encoding, schema)
        writer.add_message(channels[key], link.log_time, link.data, link.publish_time, link.sequence)
    writer.finish()
    return stream.getvalue()


def test_rewriting_a_log_as_it_is_leaves_it_ok(data):
    assert verified(unlinked(data, lambda links: links)).status is Status.OK


def changed_link(number, **changes):
    return lambda links: [
        replace(link, **changes) if place == number else link for place, link in enumerate(links)
    ]


CHANGES = {
    "left out": (lambda links: links[:3] + links[4:], "record 3"),
    "exchanged": (lambda links: [*links[:3], links[4], links[3], *links[5:]], "record 3"),
    "repeated": (lambda links: [*links[:3], links[3], *links[3:]], "record 4"),
    "first left out": (lambda links: links[1:], "record 0"),
    "log time": (changed_link(3, log_time=5), "record 4"),
    "publish time": (changed_link(3, publish_time=5), "record 4"),
    "sequence": (changed_link(3, sequence=77), "record 3"),
    "encoding": (changed_link(3, encoding="cbor"), "record 3"),
    "topic": (changed_link(3, topic="/audit/x"), "record 4"),
    "schema": (changed_link(3, schema=b"{}"), "record 4"),
    "list": (changed_link(3, data=b"[]"), "record 3"),
    "NaN": (changed_link(3, data=b'{"prev":NaN}'), "record 3"),
    "not UTF-8": (changed_link(3, data=b"\xff"), "record 3"),
    "without link": (changed_link(3, data=b"{}"), "record 3"),
    "bottomless": (changed_link(3, data=b"[" * 100_000), "record 3"),
    "number": (changed_link(0, data=b"7"), "record 0"),
}


@pytest.mark.parametrize(("change", "word"), CHANGES.values(), ids=CHANGES)
def test_the_first_record_that_does_not_follow_is_named(data, change, word):
    report = verified(unlinked(data, change))
    assert report.status is Status.TAMPERED
    assert word in report.reasons[0]


def test_a_changed_payload_with_all_checksums_made_to_fit_is_found_by_the_chain(data):
    def refuse(links):
        return [
            replace(link, data=link.data.replace(b'"accepted":true', b'"accepted":null')) for link in links
        ]

    assert "record" in judged(unlinked(data, refuse)).reasons[0]


def add_again(writer, record, message):
    """A record as it was, a checkpoint signed again."""
    if isinstance(record, records.AuditCheckpoint):
        writer.checkpoint()
    else:
        writer.add(record, log_time_ns=message.link.log_time, monotonic_ns=0)


def appended(data, *contents, close=None):
    """The log with more records after the close record, chained."""
    found = scan(data)
    writer = LogWriter(read_log(data).report.log_id, {"software": "cutgate 0.1.0"}, signer_of(data))
    for entry in found.attachments:
        writer.attach(entry.name, entry.media_type, entry.data, log_time_ns=entry.log_time)
    models = {model.TOPIC: model for model in records.MODELS}
    for message in found.messages:
        record = models[message.topic].model_validate_json(message.link.data)
        if close is not None and isinstance(record, records.AuditClose):
            record = record.model_copy(update=close)
        add_again(writer, record, message)
    for record in contents:
        writer.add(record, log_time_ns=0, monotonic_ns=0)
    writer.finish()
    return writer.take()


def test_nothing_may_follow_the_close_record(data):
    judged(appended(data, decision(1)), "after the close record")


def test_a_log_is_opened_once(data):
    first = records.AuditOpen.model_validate_json(scan(data).messages[0].link.data)
    judged(appended(data, first), "/audit/open is there 2 times")


def test_a_log_is_closed_once(data):
    last = records.AuditClose.model_validate_json(scan(data).messages[-1].link.data)
    judged(appended(data, last), "/audit/close is there 2 times")


def test_the_close_record_counts(data):
    judged(appended(data, close={"message_count": 3}), "counts 3 messages")


def test_record_0_opens_the_log():
    writer = LogWriter("", {})
    writer.add(decision(1), log_time_ns=0, monotonic_ns=0)
    writer.finish()
    judged(writer.take(), "record 0 is /audit/decision")


def test_the_metadata_are_those_of_record_0(data):
    changed = appended(data)
    other = unlinked(changed, lambda links: links).replace(
        b"log_id\x20\x00\x00\x000", b"log_id\x20\x00\x00\x001"
    )
    assert verified(other).status is Status.TAMPERED
    assert any("metadata" in reason for reason in verified(other).reasons)


# ---------------------------------------------------------------- attachments and raw frames


def with_attachments(data, change):
    found = scan(data)
    writer = LogWriter(read_log(data).report.log_id, {"software": "cutgate 0.1.0"}, signer_of(data))
    for name, content in change([(entry.name, entry.data) for entry in found.attachments]):
        media = "text/csv" if name == "plan.csv" else "application/json"
        writer.attach(name, media, content, log_time_ns=1)
    models = {model.TOPIC: model for model in records.MODELS}
    for message in found.messages:
        add_again(writer, models[message.topic].model_validate_json(message.link.data), message)
    writer.finish()
    return writer.take()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda entries: [entries[0], ("plan.csv", b"other")], "plan.csv) is not what its record says"),
        (lambda entries: entries[:1], "plan.csv has a record but is not there"),
        (lambda entries: [*entries, ("more.bin", b"x")], "more.bin has no record"),
        (lambda entries: entries[::-1], "is not what its record says"),
    ],
)
def test_attachments_are_those_of_their_records(data, change, word):
    assert verified(with_attachments(data, lambda entries: entries)).status is Status.OK
    judged(with_attachments(data, change), word)


def test_the_raw_frames_beside_the_log_are_those_of_the_close_record(paths, data):
    frames = paths.candump.read_bytes()
    assert verify_log(data, frames, signature_of(data)).status is Status.OK
    for other in (frames + b"x", b"", frames[:-1], b"x" * len(frames)):
        report = verify_log(data, other)
        assert report.status is Status.TAMPERED
        assert "raw frames beside the log" in report.reasons[0]


def test_raw_frames_of_another_size_are_not_read(data):
    class Huge(io.BytesIO):
        def seek(self, offset, whence=0):
            return 1 << 43 if whence == io.SEEK_END else super().seek(offset, whence)

        def read(self, size=-1):
            pytest.fail("read")

    assert verify_log(data, Huge()).status is Status.TAMPERED


def test_a_log_without_its_raw_frames_is_incomplete(data):
    report = verify_log(data)
    assert report.status is Status.INCOMPLETE
    assert "raw frames" in report.reasons[0]
    assert "is not beside the log" in report.reasons[0]


def test_a_log_that_was_not_closed_names_no_raw_frames(data):
    unclosed = data[: data.index(b'"final_state"') - 300]
    assert not any("raw frames" in reason for reason in verify_log(unclosed).reasons)


def test_a_changed_log_without_its_raw_frames_is_tampered_first(data):
    changed = data.replace(b"time scale", b"time skale")
    assert verify_log(changed).status is Status.TAMPERED


# ---------------------------------------------------------------- two ways of reading


class Failing:
    def __init__(self, *_arguments, **_options):
        raise ValueError("broken")


def test_an_error_of_the_stock_reader_is_a_failure(data, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.audit.second_reading._Records", Failing)
    judged(data, "read linearly, the file gives an error: ValueError")


def hiding(kind):
    """A stock reader from which one record of a kind is hidden."""

    class Hiding(second_reading._Records):
        @property
        def records(self):
            hidden = 0
            for record in super().records:
                if isinstance(record, kind) and not hidden:
                    hidden += 1
                else:
                    yield record

    return Hiding


@pytest.mark.parametrize("kind", [Chunk, Attachment])
def test_another_content_read_linearly_is_a_failure(data, monkeypatch, kind):
    monkeypatch.setattr("cutgate.runtime.audit.second_reading._Records", hiding(kind))
    judged(data, "read linearly, the file gives")


@pytest.mark.parametrize(
    "changed",
    [{"data": b"{}"}, {"sequence": 7}, {"channel_id": 1}, {"log_time": 1}, {"publish_time": 1}],
)
def test_one_message_that_is_read_otherwise_is_a_failure(data, monkeypatch, changed):
    parts = second_reading._parts
    one = [part for record in linear(data) for part in parts(record) if isinstance(part, Message)][3]

    def other(chunk):
        return (replace(part, **changed) if part == one else part for part in parts(chunk))

    assert replace(one, **changed) != one
    monkeypatch.setattr(second_reading, "_parts", other)
    judged(data, "read linearly, the file gives other records")


def linear(data):
    """The chunks of a log."""
    records_of_file = StreamReader(io.BytesIO(data), emit_chunks=True).records
    return [record for record in records_of_file if isinstance(record, Chunk)]


def test_the_parts_of_a_chunk_are_those_that_the_library_finds(data):
    for chunk in linear(data):
        assert list(second_reading._parts(chunk)) == breakup_chunk(chunk)
    message = packed(MESSAGE)
    unknown = struct.pack("<BQ", 0x7F, 3) + b"abc"
    content = first_schema(linear(data)[0].data) + unknown + message
    chunk = replace(linear(data)[0], data=content, uncompressed_crc=0)
    assert list(second_reading._parts(chunk)) == breakup_chunk(chunk)


def test_a_chunk_whose_last_record_is_cut_has_no_parts(data):
    chunk = replace(linear(data)[0], data=packed(MESSAGE)[:-1], uncompressed_crc=0)
    with pytest.raises(EndOfFile):
        list(second_reading._parts(chunk))


@pytest.mark.parametrize("part", ["chunk_indexes", "attachment_indexes"])
def test_another_content_by_index_is_a_failure(data, monkeypatch, part):
    class Hiding(SeekingReader):
        def get_summary(self):
            summary = super().get_summary()
            setattr(summary, part, getattr(summary, part)[1:])
            return summary

    monkeypatch.setattr("cutgate.runtime.audit.second_reading.make_reader", Hiding)
    judged(data, "read by index, the file gives other records")


def test_an_attachment_that_is_too_large_for_a_second_reading_is_said(data, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.audit.second_reading.READ_TWICE_MAX", 119)
    report = verified(data)
    assert report.status is Status.OK
    assert "attachment environment.json has" in report.notes[0]


# ---------------------------------------------------------------- memory


def cut_log(megabytes):
    """A log as a long cut leaves it: mostly frames; and its raw frames."""
    writer = LogWriter("ab" * 16, {"software": "x"}, SIGNER)
    names = OF_KEY | {"software": "x", "verifier": "x", "numpy": "2", "candump": "x", "cpu_dispatch": ()}
    writer.attach("x", "text/plain", b"x", log_time_ns=0)
    attached = {"name": "x", "media_type": "text/plain", "size": 1, "sha256": sha256(b"x").hexdigest()}
    for record in (
        records.AuditOpen(log_id="ab" * 16, previous_crashed=False, **names),
        records.AuditAttachment(**attached),
    ):
        writer.add(record, log_time_ns=0, monotonic_ns=0)
    stream = io.BytesIO()
    while stream.tell() < megabytes * 1e6:
        for number in range(240):
            frame = {"is_rtr": False, "is_extended": False, "is_error": False, "dlc": 8, "data": "00" * 8}
            stamp = records.Time.of(writer.count)
            record = records.CanFrame(stamp=stamp, direction="received", id=number, **frame)
            writer.add(record, log_time_ns=writer.count, monotonic_ns=0)
        writer.close_chunk()
        stream.write(writer.take())
    ending = {"message_count": writer.count + 1, "candump_sha256": sha256(b"").hexdigest()}
    writer.add(
        records.AuditClose(final_state="done", clean=True, candump_bytes=0, **ending),
        log_time_ns=writer.count,
        monotonic_ns=0,
    )
    writer.finish()
    stream.write(writer.take())
    return stream


def peak_bytes(act):
    """What an act takes of memory beside what there was."""
    tracemalloc.start()
    try:
        act()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def ok(file):
    assert verify_log(file, b"").reasons[0].startswith("the signature of the closed log is not beside it")


@pytest.mark.no_cover
@pytest.mark.parametrize("judge", [ok, recoverable_head, closing_head])
def test_memory_is_bounded_by_a_chunk_and_the_index_not_by_the_log(judge):
    small, large = cut_log(0.5), cut_log(4.0)
    judge(cut_log(0.1))  # whatever is made once
    few, many = (peak_bytes(lambda file=file: judge(file)) for file in (small, large))
    assert many < 1_500_000
    assert many - few < 150_000, "3.5 MB of frames more, in 75 chunks more"


def test_frames_are_found_though_no_place_of_them_is_kept():
    log = read_log(cut_log(0.1), b"")
    assert log.report.status is Status.INCOMPLETE, "its signature is not beside it"
    checkpoints = len(log.of(records.AuditCheckpoint.TOPIC))
    assert len(log.places) == 3 + checkpoints
    assert len(log.of(records.CanFrame.TOPIC)) == log.report.messages - 3 - checkpoints


class Sparse(io.BytesIO):
    """A file of terabytes that holds these bytes and zeros after them; what is read of it is counted."""

    def __init__(self, data, size=1 << 42):
        super().__init__(data)
        self.size, self.begin, self.place, self.read_bytes = size, data, 0, 0

    def seek(self, offset, whence=0):
        self.place = self.size + offset if whence == io.SEEK_END else offset
        return self.place

    def read(self, size=-1):
        assert 0 <= size <= 32 << 20, "asked for more than any record has"
        self.read_bytes += size
        found = self.begin[self.place : self.place + size].ljust(min(size, self.size - self.place), b"\0")
        self.place += len(found)
        return found


HEAD = MAGIC + packed(Header("cutgate.audit/1", "x"))


@pytest.mark.parametrize(
    ("begin", "status"),
    [
        (b"", Status.UNREADABLE),
        (MAGIC, Status.TAMPERED),
        (HEAD, Status.TAMPERED),
        (MAGIC + struct.pack("<BQ", Opcode.HEADER, 1 << 41), Status.TAMPERED),
        (HEAD + struct.pack("<BQ", Opcode.CHUNK, 1 << 41), Status.TAMPERED),
        (HEAD + struct.pack("<BQ", Opcode.METADATA, 1 << 41), Status.TAMPERED),
        (HEAD + struct.pack("<BQ", Opcode.CHUNK, 1 << 43), Status.INCOMPLETE),
        (HEAD + struct.pack("<BQQQI", Opcode.ATTACHMENT, 1 << 41, 0, 0, 1 << 30), Status.TAMPERED),
        (
            HEAD + packed(DataEnd(zlib.crc32(HEAD))) + struct.pack("<BQ", Opcode.SCHEMA, 1 << 41),
            Status.TAMPERED,
        ),
    ],
)
def test_a_huge_file_is_judged_by_its_first_bytes(begin, status):
    file = Sparse(begin)
    assert verify_log(file).status is status
    assert file.read_bytes < 4096 or "attachment" in str(begin)


def test_what_a_file_says_of_itself_is_bounded():
    many = b"".join(packed(Metadata(str(number), {"x": "y" * 1000})) for number in range(20_000))
    judged(HEAD + many, "it holds more schemas, channels, metadata and attachments")


def test_a_file_with_more_records_than_any_session_is_tampered(data, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.audit.judge.KEPT_MAX", 5)
    judged(data, "it holds over 5 records that are not streamed")


def test_a_file_that_is_cut_while_it_is_read_is_torn(data):
    class Shrinking(io.BytesIO):
        def read(self, size=-1):
            if self.tell() > len(data) // 2:
                self.truncate(len(data) // 2)
            return super().read(size)

    assert verify_log(Shrinking(data), FRAMES).status is Status.INCOMPLETE


def test_a_disk_that_gives_an_error_is_no_judgement(data):
    class Broken(io.BytesIO):
        def read(self, size=-1):
            if self.tell() > 1000:
                raise OSError(5, "no")
            return super().read(size)

    with pytest.raises(OSError, match="no"):
        verify_log(Broken(data))


def test_records_of_one_topic_come_in_file_order(data):
    log = read_log(data)
    assert [entry["sequence"] for entry in log.of("/audit/decision")] == [0, 1, 2]


def test_scanning_keeps_what_stands_before_the_damage(data):
    broken = rechunked(data, lambda content: content + b"\x05\xff", number=1)
    found = scan(broken)
    assert found.problems
    assert not found.finished
    assert found.attachment("environment.json")
    assert found.attachment("nothing") is None


# ---------------------------------------------------------------- the tree


@pytest.fixture
def enabled(tmp_path):
    """A log in which permit and start left, each naming the tree of the record that authorised it."""
    log = create(tmp_path, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock())
    enable(log, "permit", "start")
    return log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).log.read_bytes()


def test_a_log_whose_permit_and_start_name_its_tree_is_ok(enabled):
    assert verify_log(enabled, b"", signature_of(enabled)).status is Status.OK
    named = [entry for entry in read_log(enabled).of("/audit/permit") if entry["stage"] == "sent"]
    assert [entry["kind"] for entry in named] == ["permit", "start"]
    assert all(entry["log_size"] > 2 and len(entry["log_root"]) == 64 for entry in named)


def test_a_log_rewritten_before_its_start_is_tampered_although_its_chain_fits(enabled):
    """Whoever chains a changed record anew must change what permit and start name, too; the controller has kept it."""

    def edit(record):
        return (
            record.model_copy(update={"operator": "x"}) if isinstance(record, records.AuditOpen) else record
        )

    report = signed_again(forge(enabled, edit, trees_again=False))
    assert report.status is Status.TAMPERED
    assert report.reasons[0].startswith("record 6 (/audit/permit): it names the root "), report
    assert signed_again(forge(enabled)).status is Status.OK


def test_a_crashed_log_that_names_another_tree_is_tampered_not_incomplete(enabled):
    def edit(record):
        return None if isinstance(record, records.AuditClose) else record

    def other(record):
        sent = isinstance(record, records.AuditPermit) and (record.kind, record.stage) == ("start", "sent")
        return record.model_copy(update={"log_size": 3}) if sent else edit(record)

    assert signed_again(forge(enabled, edit)).status is Status.INCOMPLETE
    report = signed_again(forge(enabled, other))
    assert report.status is Status.TAMPERED
    assert "it names a tree of size 3, must be 10 to 12" in report.reasons[0], report


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_a_log_whose_permit_or_start_names_another_log_is_tampered(enabled, kind):
    """The same tree under another id: only what was signed tells them apart."""

    def edit(record):
        if not isinstance(record, records.AuditPermit) or (record.kind, record.stage) != (kind, "sent"):
            return record
        return record.model_copy(update={"record": record.record.replace(LOG_ID, "ab" * 16)})

    report = signed_again(forge(enabled, edit))
    assert report.status is Status.TAMPERED
    assert report.reasons[0].endswith(f": it names the log {'ab' * 16}, this one is {LOG_ID}"), report
