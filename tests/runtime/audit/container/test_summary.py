"""The summary: exactly the one that the data section gives, with its offsets and its footer."""

import zlib
from dataclasses import replace
from hashlib import sha256

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from cutgate.runtime.audit.container import raw, summary
from cutgate.runtime.audit.container.chunk import Chunk
from cutgate.runtime.audit.container.raw import BrokenError, Budget, Raw
from cutgate.runtime.audit.container.summary import (
    Expected,
    Group,
    KeptGroup,
    SummaryFound,
    footer_of,
    offsets_of,
)

START = 500


def packed(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


SCHEMAS = [Schema(1, b"{}", "jsonschema", "a"), Schema(2, b"{}", "jsonschema", "b")]
CHANNELS = [Channel(1, "/a", "json", {}, 1)]
CHUNKS = [
    ChunkIndex(
        chunk_start_offset=place,
        chunk_length=80,
        message_start_time=first,
        message_end_time=last,
        message_index_offsets={1: place + 80},
        message_index_length=31,
        compression="",
        compressed_size=80,
        uncompressed_size=80,
    )
    for place, first, last in ((8, 5, 9), (200, 3, 7))
]
ATTACHED = [
    AttachmentIndex(
        offset=place, length=9, log_time=1, create_time=2, data_size=3, name="x", media_type="text/plain"
    )
    for place in (300, 310, 320)
]
METADATA = [MetadataIndex(offset=400, length=20, name="cutgate")]
STATISTICS = Statistics(
    attachment_count=3,
    channel_count=1,
    channel_message_counts={1: 5, 2: 3},
    chunk_count=2,
    message_count=8,
    message_start_time=3,
    message_end_time=9,
    metadata_count=1,
    schema_count=2,
)


def expected(kind=Group):
    made = Expected(kind)
    for record in (*METADATA, *CHUNKS[:1], *SCHEMAS, *CHANNELS, *ATTACHED, *CHUNKS[1:]):
        made.add(record)
    made.count(1, 2)
    made.count(2, 3)
    made.count(1, 3)
    made.span(5, 9)
    made.span(3, 7)
    made.span(4, 8)
    return made


RECORDS = [*SCHEMAS, *CHANNELS, STATISTICS, *CHUNKS, *ATTACHED, *METADATA]


def with_offsets(records, start=START):
    """The summary's records, the offsets of their groups, and where the offsets begin."""
    groups, at = [], start
    for record in records:
        whole = packed(record)
        if groups and groups[-1][0] == whole[0]:
            groups[-1][2] += len(whole)
        else:
            groups.append([whole[0], at, len(whole)])
        at += len(whole)
    return [SummaryOffset(*group) for group in groups], at


def judged(records=RECORDS, offsets=None, footer=None, budget=None, start=START):
    """What is wrong with a summary; its footer and offsets fit unless they are given."""
    made, end = with_offsets(records, start)
    offsets = made if offsets is None else offsets
    body = b"".join(packed(record) for record in (*records, *offsets))
    found, at = SummaryFound(expected(), START, budget or Budget()), start
    try:
        for record in (*records, *offsets):
            whole = packed(record)
            found.take(Raw(whole[0], at, len(whole) - 9, 0), record, whole)
            at += len(whole)
        last = Footer(summary_start=start, summary_offset_start=end, summary_crc=0)
        last = replace(last, summary_crc=zlib.crc32(body + packed(last)[:-4]))
        last = replace(last, **footer or {})
        found.close(last, packed(last))
    except BrokenError as broken:
        return str(broken)
    return ""


NOT_THAT = "the summary is not that of the data section"
OFFSETS = "the summary's offsets are not those of its groups"


def test_the_summary_that_the_data_section_gives_is_right():
    assert judged() == ""


def test_what_each_group_must_be_stands_in_the_formats_order():
    groups = [group.content for group in expected().close()]
    wanted = {}
    for record in RECORDS:
        whole = packed(record)
        wanted[whole[0]] = wanted.get(whole[0], b"") + whole
    assert groups == [(opcode, len(data), sha256(data).digest()) for opcode, data in wanted.items()]


def test_a_file_without_messages_has_no_times_and_no_groups_but_statistics():
    counts = dict.fromkeys(vars(STATISTICS), 0) | {"channel_message_counts": {}}
    nothing = packed(Statistics(**counts))
    assert [group.content for group in Expected(Group).close()] == [
        (Opcode.STATISTICS, len(nothing), sha256(nothing).digest())
    ]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("attachment_count", 2),
        ("channel_count", 2),
        ("channel_message_counts", {1: 5, 2: 4}),
        ("channel_message_counts", {1: 5}),
        ("chunk_count", 1),
        ("message_count", 9),
        ("message_start_time", 5),
        ("message_end_time", 7),
        ("metadata_count", 0),
        ("schema_count", 1),
    ],
)
def test_statistics_are_those_of_the_data_section(name, value):
    wrong = replace(STATISTICS, **{name: value})
    assert judged([wrong if record is STATISTICS else record for record in RECORDS]) == NOT_THAT


@pytest.mark.parametrize("place", range(len(RECORDS)))
def test_no_record_is_missing_doubled_or_another(place):
    assert judged(RECORDS[:place] + RECORDS[place + 1 :]) == NOT_THAT
    assert judged([*RECORDS[:place], RECORDS[place], *RECORDS[place:]]) == NOT_THAT
    names = {Schema: "name", Channel: "topic", ChunkIndex: "chunk_length", MetadataIndex: "length"}
    record = RECORDS[place]
    if type(record) in names:
        value = getattr(record, names[type(record)])
        other = replace(record, **{names[type(record)]: value + (1 if isinstance(value, int) else "x")})
        assert judged([*RECORDS[:place], other, *RECORDS[place + 1 :]]) == NOT_THAT


def test_the_order_of_the_groups_and_in_them_counts():
    assert judged(RECORDS[::-1]) == NOT_THAT
    assert judged([SCHEMAS[1], SCHEMAS[0], *RECORDS[2:]]) == NOT_THAT
    assert judged([]) == NOT_THAT


def test_a_summary_of_endless_groups_is_not_read_to_its_end():
    found = SummaryFound(expected(), START, Budget())
    for number in range(6):
        whole = packed(SCHEMAS[0] if number % 2 else CHANNELS[0])
        found.take(Raw(whole[0], START, len(whole) - 9, 0), None, whole)
    found.take(Raw(whole[0], START, len(whole) - 9, 0), None, whole)  # one more of the last group
    with pytest.raises(BrokenError, match=NOT_THAT):
        found.take(Raw(packed(STATISTICS)[0], START, 0, 0), None, packed(STATISTICS))


@pytest.mark.parametrize("place", range(6))
def test_each_group_has_its_offset(place):
    offsets, _ = with_offsets(RECORDS)
    assert len(offsets) == 6
    assert judged(offsets=[*offsets[:place], *offsets[place + 1 :]]) == OFFSETS
    assert judged(offsets=[*offsets[:place], offsets[place], *offsets[place:]]) == OFFSETS
    for name in ("group_opcode", "group_start", "group_length"):
        value = getattr(offsets[place], name)
        wrong = replace(offsets[place], **{name: value + 1})
        assert judged(offsets=[*offsets[:place], wrong, *offsets[place + 1 :]]) == OFFSETS
    assert judged(offsets=offsets[::-1]) == OFFSETS


def test_nothing_stands_behind_the_offsets():
    offsets, _ = with_offsets(RECORDS)
    assert judged(offsets=[*offsets, METADATA[0]]) == OFFSETS
    assert judged(offsets=[*offsets[:3], SCHEMAS[0], *offsets[3:]]) == OFFSETS


def test_offsets_are_remembered_within_a_bound(monkeypatch):
    offsets, _ = with_offsets(RECORDS)
    size = sum(map(len, map(packed, offsets)))
    monkeypatch.setattr(raw, "REMEMBERED_MAX", size)
    assert judged() == ""
    monkeypatch.setattr(raw, "REMEMBERED_MAX", size - 1)
    assert judged().startswith("it holds more schemas")


@pytest.mark.parametrize("name", ["summary_start", "summary_offset_start"])
def test_the_footer_points_at_the_summary(name):
    for value in (0, START + 1):
        assert judged(footer={name: value}) == "the footer does not point at the summary"


def test_offsets_are_those_of_where_the_summary_stands():
    assert judged(start=START + 1) == OFFSETS


def test_the_footers_checksum_is_that_of_all_before_it():
    assert judged(footer={"summary_crc": 0}) == "the summary's checksum is wrong"
    assert judged(footer={"summary_crc": 1}) == "the summary's checksum is wrong"


# ---------------------------------------------------------------- written


def test_a_chunk_is_counted_and_what_it_defines_is_added():
    made, again = Expected(KeptGroup), expected(KeptGroup)
    for record in (*METADATA, *CHUNKS, *ATTACHED):
        made.add(record)
    entries = {1: [b""] * 5, 2: [b""] * 3}
    made.take_chunk(Chunk([], [*SCHEMAS, *CHANNELS], 3, 9, 80, entries))
    assert [group.data for group in made.close()] == [group.data for group in again.close()]


def test_what_is_written_is_what_is_read():
    groups = expected(KeptGroup).close()
    offsets, end = offsets_of(groups, START)
    body = b"".join(bytes(group.data) for group in groups) + b"".join(map(packed, offsets))
    footer = footer_of(START, end, zlib.crc32(body))
    assert (offsets, end) == with_offsets(RECORDS)
    assert judged(offsets=offsets, footer=vars(footer)) == ""
    assert body == b"".join(map(packed, (*RECORDS, *offsets)))


def test_a_group_that_is_kept_is_bounded(monkeypatch):
    assert summary.KEPT_MAX == 67_108_864
    record = packed(SCHEMAS[0])
    monkeypatch.setattr("cutgate.runtime.audit.container.summary.KEPT_MAX", 2 * len(record))
    group = KeptGroup(Opcode.SCHEMA)
    group.put(record)
    group.put(record)
    assert (group.data, group.count) == (record * 2, 2)
    with pytest.raises(BrokenError, match="its summary is larger than that of any session: over"):
        group.put(record)
