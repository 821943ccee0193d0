"""The copy of a log that was cut: its bytes, which logs have none, and what it costs."""

import io
from dataclasses import replace
from typing import ClassVar

import pytest
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from cutgate.runtime.audit import records
from cutgate.runtime.audit.container import summary
from cutgate.runtime.audit.container.raw import BrokenError, TornError
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.recovered import RECOVERED
from cutgate.runtime.audit.recovery import agrees, copied, refused, what_is_told
from cutgate.runtime.audit.writer import LogWriter
from tests.logs import signature_of
from tests.runtime.audit.build import (
    decision,
    forge,
    session_log,
)
from tests.runtime.audit.cuts import (
    TOLD,
    Whole,
    by_index,
    recovered,
)
from tests.runtime.audit.test_inspect import cut_log, peak_bytes

NOTHING = "it was cut before its record 0 was whole: there is nothing to recover"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A session that was permitted, started and closed."""
    return Whole(session_log(tmp_path_factory.mktemp("session")).log.read_bytes())


# ---------------------------------------------------------------- what is written


def written_by_mcap(whole, left, told):
    """Oracle: the same content written by the writer of the mcap library."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, enable_data_crcs=True)
    for raw in whole.records:
        if left[raw.begin : raw.end] != whole.data[raw.begin : raw.end]:
            continue
        if raw.opcode == Opcode.HEADER:
            header = Header.read(whole.content(raw))
            writer.start(header.profile, header.library)
        elif raw.opcode == Opcode.METADATA:
            own = Metadata.read(whole.content(raw))
            writer.add_metadata(own.name, own.metadata)
            writer.add_metadata(RECOVERED, told.metadata().metadata)
        elif raw.opcode == Opcode.ATTACHMENT:
            entry = Attachment.read(whole.content(raw))
            writer.add_attachment(entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data)
        elif raw.opcode == Opcode.CHUNK:
            for part in breakup_chunk(Chunk.read(whole.content(raw))):
                if isinstance(part, Schema):
                    writer.register_schema(part.name, part.encoding, part.data)
                elif isinstance(part, Channel):
                    writer.register_channel(part.topic, part.message_encoding, part.schema_id)
                else:
                    writer.add_message(
                        part.channel_id, part.log_time, part.data, part.publish_time, part.sequence
                    )
            writer.flush()
    writer.finish()
    return stream.getvalue()


def test_the_copy_is_byte_for_byte_what_the_mcap_library_writes_of_the_same(whole):
    for cut in whole.seeded()[::5]:
        found = recovered(whole.data[:cut])
        if not isinstance(found, str):
            copy, told, _ = found
            if not scan(copy).attachments:
                continue  # of none the library writes an empty group of the summary
            assert copy == written_by_mcap(whole, whole.data[:cut], told), cut


def test_a_log_cut_in_its_summary_loses_no_record(whole):
    end = next(raw for raw in whole.records if raw.opcode == Opcode.DATA_END)
    for cut in (end.begin, end.end, len(whole.data) - 1):
        copy, told, _ = recovered(whole.data[:cut])
        assert told.records == sum(len(several) for _, several in whole.messages)
        assert "there is no close record" not in " ".join(read_log(copy, b"").report.reasons)


def test_a_log_cut_in_the_indexes_of_a_chunk_keeps_the_chunk(whole):
    for (raw, several), following in zip(whole.messages, [*whole.messages[1:], None], strict=True):
        indexes = [
            one
            for one in whole.records
            if one.opcode == Opcode.MESSAGE_INDEX
            and raw.end <= one.begin
            and (following is None or one.begin < following[0].begin)
        ]
        assert indexes
        for index in indexes:
            copy, told, _ = recovered(whole.data[: index.end - 1])
            assert told.dropped == index.end - 1 - index.begin
            assert by_index(copy)[0][-len(several) :] == several


class Checkpoint(records.AuditRecord):
    """A record of a later version."""

    TOPIC: ClassVar[str] = "/audit/checkpoint"
    note: str


class Elsewhere(records.LogRecord):
    """A record that is not linked."""

    TOPIC: ClassVar[str] = "/elsewhere"
    value: float


def writer_with_some_records():
    """A log's writer with records of topics that nothing here knows; its last chunk is closed."""
    writer = LogWriter("ab" * 16, {"software": "x"})
    names = {"software": "x", "verifier": "x", "numpy": "2", "candump": "x", "cpu_dispatch": ()}
    opened = records.AuditOpen(log_id="ab" * 16, previous_crashed=False, **names)
    for number, record in enumerate((opened, Checkpoint(note="signed\n"), Elsewhere(value=1.5))):
        writer.add(record, log_time_ns=7 - number, monotonic_ns=0)
    writer.close_chunk()
    return writer


def test_records_of_every_topic_are_kept_as_they_are():
    copy, told, _ = recovered(writer_with_some_records().take() + b"\6")
    messages, _, _ = by_index(copy)
    assert [(one.topic, one.log_time) for one in messages] == [
        ("/audit/open", 7),
        ("/audit/checkpoint", 6),
        ("/elsewhere", 5),
    ]
    assert messages[2].data == b'{"value":1.5}'
    assert (told.records, told.dropped) == (3, 1)
    assert read_log(copy).report.status is Status.INCOMPLETE


# ---------------------------------------------------------------- what is refused


def refusal(data, frames=None, sidecar=None):
    return refused(read_log(data, frames, sidecar))


def test_a_whole_log_is_not_recovered(whole):
    signature = signature_of(whole.data)
    assert refusal(whole.data, b"", signature) == (
        "it is whole: there is nothing to recover",
        "read it as it is",
    )


def test_a_finished_log_without_its_raw_frames_is_not_recovered(whole):
    text, remedy = refusal(whole.data)
    assert text.startswith("it is finished, and what is missing was not in it: the file of raw frames")
    assert "put that file beside it again" in remedy


def test_a_finished_log_without_close_record_is_not_recovered(whole):
    forged = forge(whole.data, lambda record: None if isinstance(record, records.AuditClose) else record)
    text, remedy = refusal(forged)
    assert text == (
        "its file is finished, no end of it was cut off: "
        "there is no close record: the session did not end in order"
    )
    assert remedy == "read it as it is (audit show, audit replay)"


def test_a_recovered_copy_is_not_recovered_nor_what_is_left_of_it(whole):
    copy, told, _ = recovered(whole.data[: whole.closed_at - 1])
    told_so = "it is a recovered copy of cut.mcap, and no log that was cut"
    assert refusal(copy)[0] == told_so
    assert "in the original" in refusal(copy)[1]
    marked = copy.index(told.original.encode()) + len(told.metadata().metadata) * 100
    cuts = range(8, len(copy), 101)
    found = {cut: refusal(copy[:cut])[0] for cut in cuts}
    assert set(found.values()) == {NOTHING, told_so}
    assert {text for cut, text in found.items() if cut > marked} == {told_so}


def test_a_copy_that_does_not_say_of_what_is_not_recovered_either(whole):
    copy, told, _ = recovered(whole.data[: whole.closed_at - 1])
    altered = copy.replace(told.sha256.encode(), b"x" * 64)
    assert refusal(altered)[0].startswith("it is altered, not cut: the metadata cutgate.recovered are none")
    assert read_log(altered[:-1]).report.status is Status.TAMPERED


def test_what_is_altered_is_not_copied_and_the_first_bad_record_named(whole):
    first, _ = whole.messages[1]
    changed = bytearray(whole.data[: whole.closed_at - 1])
    changed[first.end - 5] ^= 1
    text, remedy = refusal(bytes(changed))
    assert text == f"it is altered, not cut: chunk at offset {first.begin}: its checksum is wrong"
    assert remedy == "nothing of it is copied; keep it as evidence, and take the log from a backup"


def test_a_broken_chain_is_not_copied():
    writer = writer_with_some_records()
    writer.head = bytes(32)
    writer.add(decision(0), log_time_ns=9, monotonic_ns=0)
    writer.close_chunk()
    assert refusal(writer.take())[0] == (
        "it is altered, not cut: record 3 (/audit/decision): it does not follow from the records before it"
    )


@pytest.mark.parametrize("data", [b"", b"x" * 100, b"\x89MCAP0\r"])
def test_another_file_is_not_recovered(data):
    assert refusal(data) == ("this is not an audit log of cutgate", "name a session's .mcap file")


def test_a_log_without_record_0_is_not_recovered(whole):
    begin = whole.messages[0][0].begin
    assert refusal(whole.data[:begin]) == (
        NOTHING,
        "no session can have enabled anything by then; leave the file where it is",
    )


# ---------------------------------------------------------------- bounds, and a file that changes


def crashed(whole):
    """Cut in the chunk of its close record."""
    return whole.data[: whole.closed_at - 1]


def test_a_file_that_gets_shorter_while_it_is_copied_is_an_error(whole):
    file = io.BytesIO(crashed(whole))
    log = read_log(file)
    pieces = copied(log, what_is_told(log, *TOLD))
    for _ in range(5):
        next(pieces)
    file.truncate(3000)
    with pytest.raises(TornError):
        list(pieces)


def test_a_chunk_that_changes_while_it_is_copied_is_an_error(whole):
    file = io.BytesIO(crashed(whole))
    log = read_log(file)
    raw, _ = whole.messages[1]
    file.seek(raw.end - 5)
    file.write(b"\0")
    with pytest.raises(BrokenError, match="checksum"):
        list(copied(log, what_is_told(log, *TOLD)))


def test_an_attachment_that_changes_while_it_is_copied_is_found_in_the_copy(whole):
    file = io.BytesIO(crashed(whole))
    log = read_log(file)
    told = what_is_told(log, *TOLD)
    raw, _ = whole.attachments[2]
    file.seek(raw.end - 9)
    file.write(b"\0")
    assert not agrees(read_log(b"".join(copied(log, told))), log, told)


def test_a_copy_that_holds_something_else_does_not_agree(whole):
    copy, told, log = recovered(crashed(whole))
    read = read_log(copy)
    assert agrees(read, log, told)
    for changes in ({"status": Status.OK}, {"messages": 3}, {"head": "ab" * 32}, {"log_id": "other"}):
        assert not agrees(replace(read, report=replace(read.report, **changes)), log, told), changes
    assert not agrees(read, log, replace(told, dropped=told.dropped + 1))
    assert not agrees(read_log(copy[:-1]), log, told)
    assert not agrees(read, read_log(whole.data[: whole.messages[2][0].begin]), told)
    scan = replace(read.scan, attachments=read.scan.attachments[:-1])
    assert not agrees(replace(read, scan=scan), log, told)


def test_the_summary_is_bounded(whole, monkeypatch):
    monkeypatch.setattr(summary, "KEPT_MAX", 5000)
    with pytest.raises(BrokenError, match="its summary is larger than that of any session: over 5000 bytes"):
        recovered(crashed(whole))


def test_an_attachment_is_copied_in_pieces(whole, monkeypatch):
    copy, told, log = recovered(crashed(whole))
    monkeypatch.setattr("cutgate.runtime.audit.recovery.PIECE", 100)
    pieces = list(copied(log, told))
    assert b"".join(pieces) == copy
    whole_ones = sum((raw.end - raw.begin - 9) // 100 for raw, _ in whole.attachments)
    assert sum(len(piece) == 100 for piece in pieces) == whole_ones > 10


@pytest.mark.no_cover
def test_memory_is_bounded_by_a_chunk_and_the_index_not_by_the_log():
    def copy_it(file):
        file.truncate(file.seek(0, io.SEEK_END) - 30)
        log = read_log(file)
        assert sum(map(len, copied(log, what_is_told(log, *TOLD)))) > len(file.getbuffer()) * 0.9

    small, large = cut_log(0.3), cut_log(1.5)
    copy_it(cut_log(0.1))  # whatever is made once
    few, many = (peak_bytes(lambda file=file: copy_it(file)) for file in (small, large))
    assert many < 1_500_000
    assert many - few < 100_000, "1.2 MB of frames more, in 25 chunks more"
