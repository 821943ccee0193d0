"""The in-memory writer: what comes out is a log that stock readers open."""

import io
import json

import pytest
from mcap.reader import NonSeekingReader, make_reader

from cutgate.runtime.audit import records
from cutgate.runtime.audit.chain import GENESIS, follow
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.tree import Tree
from cutgate.runtime.audit.writer import METADATA, LogWriter
from tests.runtime.audit.build import decision, small_log


def written(count: int) -> tuple[LogWriter, bytes]:
    writer = LogWriter("id", {})
    writer.attach("a", "text/plain", b"x", log_time_ns=5)
    for number in range(count):
        writer.add(decision(number), log_time_ns=1_000 + number, monotonic_ns=7)
    return writer, writer.take()


@pytest.mark.parametrize("reader", [NonSeekingReader, make_reader])
def test_stock_readers_open_a_log(tmp_path, reader):
    data = small_log(tmp_path).log.read_bytes()
    messages = list(reader(io.BytesIO(data), validate_crcs=True).iter_messages(log_time_order=False))
    assert [message.sequence for _, _, message in messages] == list(range(len(messages)))
    assert [schema.encoding for schema, _, _ in messages] == ["jsonschema"] * len(messages)
    for _, channel, message in messages:
        assert channel.message_encoding == "json"
        assert json.loads(message.data)
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary.statistics.message_count == len(messages)
    assert summary.statistics.attachment_count >= 1
    assert summary.statistics.metadata_count == 1
    assert summary.chunk_indexes
    assert [entry.name for entry in reader(io.BytesIO(data)).iter_metadata()] == [METADATA]
    assert [entry.name for entry in reader(io.BytesIO(data)).iter_attachments()] == [
        "environment.json",
        "plan.csv",
    ]


def test_messages_wait_in_the_open_chunk():
    writer, _ = written(2)
    assert writer.unwritten == 2
    assert writer.take() == b""
    writer.close_chunk()
    assert writer.unwritten == 0
    assert b"/audit/decision" in writer.take()


def test_nothing_to_close_gives_nothing():
    writer, _ = written(0)
    writer.close_chunk()
    assert writer.take() == b""


def test_the_pieces_taken_are_the_file():
    writer, data = written(2)
    writer.close_chunk()
    data += writer.take()
    writer.add(records.AuditOperator(word="stop", accepted=True), log_time_ns=2_000, monotonic_ns=9)
    writer.finish()
    data += writer.take()
    found = scan(data)
    assert found.finished
    assert not found.problems
    assert len(found.messages) == 3


def test_audit_records_carry_the_head_before_them_and_both_clocks():
    writer, data = written(1)
    before = writer.head
    writer.add(decision(1), log_time_ns=3_000_000_001, monotonic_ns=4_000_000_002)
    writer.finish()
    first, second = (json.loads(message.link.data) for message in scan(data + writer.take()).messages)
    assert first["prev"] == GENESIS.hex()
    assert second["prev"] == before.hex() != first["prev"]
    assert (second["utc"], second["monotonic"]) == ({"sec": 3, "nsec": 1}, {"sec": 4, "nsec": 2})


def test_other_records_are_chained_without_carrying_the_head():
    writer, _ = written(1)
    before = writer.head
    frame = records.CanFrame(stamp=records.ZERO, direction="sent", id=0x80, dlc=1, data="00")
    writer.add(frame, log_time_ns=5_000, monotonic_ns=0)
    assert writer.head != before
    assert "prev" not in records.CanFrame.model_fields


def test_the_tree_stands_beside_the_chain():
    """Both over the same bytes of every message, frames too."""
    writer, data = written(2)
    frame = records.CanFrame(stamp=records.ZERO, direction="sent", id=0x80, dlc=1, data="00")
    writer.add(frame, log_time_ns=5_000, monotonic_ns=0)
    writer.finish()
    head, tree = GENESIS, Tree()
    for message in scan(data + writer.take()).messages:
        head = follow(head, message.covered)
        tree.append(message.covered)
    assert (writer.head, writer.count) == (head, 3)
    assert (writer.tree.size, writer.tree.root) == (tree.size, tree.root)
