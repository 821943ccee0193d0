"""Where chunks stand, by the index and by the lengths of records: the same as by reading all of the file."""

import io
import struct

import pytest
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, SummaryOffset

from cutgate.runtime.audit.container import places
from cutgate.runtime.audit.container.chunk import Definitions
from cutgate.runtime.audit.container.kinds import encoded
from cutgate.runtime.audit.container.places import ChunkPlace, by_hops, by_index, chunk_at, cut_in_zeros
from cutgate.runtime.audit.container.raw import MAGIC, BrokenError, Budget
from tests.runtime.audit.attacks import _records as records_of
from tests.runtime.audit.build import session_log


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("log")).log.read_bytes()


def expected(data):
    """Read record by record, with nothing of what is tested."""
    found = []
    for opcode, begin, _ in records_of(data):
        if opcode == Opcode.CHUNK:
            found.append((begin, set()))
        elif opcode == Opcode.MESSAGE_INDEX:
            found[-1][1].add(struct.unpack_from("<H", data, begin + 9)[0])
        elif opcode == Opcode.DATA_END:
            break
    return [ChunkPlace(begin, frozenset(channels)) for begin, channels in found]


def listed(find, data):
    return list(find(io.BytesIO(data)))


def test_both_find_every_chunk_with_its_channels(data):
    assert listed(by_index, data) == listed(by_hops, data) == expected(data)
    assert len(expected(data)) > 5


def test_cut_anywhere_every_whole_chunk_is_found_by_hops_and_none_by_index(data):
    whole = expected(data)
    ends = [begin + 9 + struct.unpack_from("<Q", data, begin + 1)[0] for begin, _ in whole]
    for at in range(len(MAGIC), len(data) - 1, 61):
        left = data[:at]
        assert [place.offset for place in listed(by_hops, left)] == [
            place.offset for place, end in zip(whole, ends, strict=True) if end <= at
        ]
        with pytest.raises(BrokenError):
            listed(by_index, left)


def test_zeros_behind_the_last_whole_record_are_its_end(data):
    third = expected(data)[2].offset
    assert listed(by_hops, data[:third] + bytes(4096))[0] == expected(data)[0]
    assert len(listed(by_hops, data[:third] + bytes(4096))) == 2


def test_what_is_no_record_is_told(data):
    with pytest.raises(BrokenError, match="of kind 0x7f"):
        listed(by_hops, data[: expected(data)[2].offset] + b"\x7f" + bytes(8) + b"x")


def test_more_records_than_any_session_writes_are_not_looked_at(data, monkeypatch):
    monkeypatch.setattr(places, "RECORDS_MAX", 5)
    with pytest.raises(BrokenError, match="it holds over 5 records"):
        listed(by_hops, data)
    assert (places.INDEX_MAX, places.OFFSETS_MAX) == (64 << 20, 4096)


def summary(start, index, length=None, entry=None):
    """A file that is nothing but a summary: an index, its offset, a footer."""
    offset = SummaryOffset(Opcode.CHUNK_INDEX, start, len(index) if length is None else length)
    end = len(MAGIC) + len(index)
    footer = Footer(summary_start=len(MAGIC), summary_offset_start=end, summary_crc=0)
    return MAGIC + index + (encoded(offset) if entry is None else entry) + encoded(footer) + MAGIC


INDEX = encoded(
    ChunkIndex(
        chunk_start_offset=77,
        chunk_length=5,
        message_start_time=0,
        message_end_time=0,
        message_index_offsets={1: 5, 2: 6},
        message_index_length=7,
        compression="",
        compressed_size=9,
        uncompressed_size=9,
    )
)


def test_an_index_alone_is_read():
    assert listed(by_index, summary(8, INDEX)) == [ChunkPlace(77, frozenset({1, 2}))]
    assert listed(by_index, summary(8, INDEX, entry=b"")) == []


@pytest.mark.parametrize(
    ("file", "told"),
    [
        (b"", "no footer"),
        (MAGIC, "no footer"),
        (summary(8, INDEX)[:-1] + b"x", "no footer"),
        (summary(8, INDEX, 1 << 40), "runs over the summary"),
        (summary(8, encoded(SummaryOffset(5, 1, 2))), "holds something else"),
        (summary(8, INDEX + b"\x08"), "runs over the end"),
        (summary(8, INDEX + b"\x7f" + bytes(8)), f"the record at offset {8 + len(INDEX)} is of unknown kind"),
        (summary(1 << 20, INDEX), "runs over the summary"),
    ],
)
def test_an_index_that_no_session_writes_is_told(file, told):
    with pytest.raises(BrokenError, match=told):
        listed(by_index, file)


def test_offsets_longer_than_any_are_not_read():
    entry = encoded(SummaryOffset(Opcode.SCHEMA, 8, 0)) * 200
    with pytest.raises(BrokenError, match="must be 0 to 4096"):
        listed(by_index, summary(8, INDEX, entry=entry))


def test_a_chunk_is_read_where_one_stands_and_nowhere_else(data):
    first = expected(data)[0].offset
    assert chunk_at(io.BytesIO(data), first, Definitions(Budget())).messages[0].sequence == 0
    for offset in (first + 1, len(data), len(data) - 3, 8):
        with pytest.raises(BrokenError, match="there is no chunk at offset"):
            chunk_at(io.BytesIO(data), offset, Definitions(Budget()))
    changed = bytearray(data)
    changed[first + 60] ^= 1
    with pytest.raises(BrokenError, match=f"chunk at offset {first}: its checksum"):
        chunk_at(io.BytesIO(bytes(changed)), first, Definitions(Budget()))
    huge = data[:first] + struct.pack("<BQ", Opcode.CHUNK, 1 << 40)
    with pytest.raises(BrokenError, match="there is no chunk"):
        chunk_at(io.BytesIO(huge), first, Definitions(Budget()))


def test_a_chunk_cut_in_zeros_is_told_from_one_that_goes_on(data):
    first, second = (place.offset for place in expected(data)[:2])
    end = first + 9 + struct.unpack_from("<Q", data, first + 1)[0]
    assert cut_in_zeros(io.BytesIO(data[: end - 20] + bytes(4096)), first)
    assert not cut_in_zeros(io.BytesIO(data[:end]), first)
    assert not cut_in_zeros(io.BytesIO(data[: end - 20] + bytes(4096) + b"x"), first)
    assert second > end
