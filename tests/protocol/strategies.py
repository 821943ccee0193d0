"""Hypothesis strategies for everything that is sent: built from each field's codec."""

from typing import Any

from hypothesis import strategies as st

from cutgate.protocol.path import BLOCK_BYTES, BLOCK_DATA_MAX, HEADER_BYTES, POSE_BYTES, POSES_MAX, PathBlock
from cutgate.protocol.records import PROTOCOL_VERSION, RECORDS, Announce, Open, Record
from cutgate.protocol.wire import (
    Ascii,
    Blob,
    Block,
    Choice,
    Codec,
    Enumeration,
    Integer,
    Integers,
    Nested,
    layout,
)

PRINTABLE = "".join(chr(code) for code in range(0x21, 0x7F))


def values(codec: Codec) -> st.SearchStrategy[Any]:
    """Everything a field may hold."""
    match codec:
        case Integer():
            return st.integers(*codec.bounds)
        case Integers():
            return st.tuples(*[st.integers(*Integer(8, signed=True).bounds)] * codec.count)
        case Blob():
            return st.binary(min_size=codec.size, max_size=codec.size)
        case Ascii():
            return st.text(PRINTABLE, min_size=1, max_size=codec.size)
        case Enumeration():
            return st.sampled_from(list(codec.kind))
        case Choice():
            return st.sampled_from(codec.words)
        case Nested():
            return blocks(codec.kind)
    raise AssertionError(codec)


def blocks(kind: type[Block]) -> st.SearchStrategy[Block]:
    """Any instance of a block; turns and speeds within their bounds."""
    bounds = {
        "q0_turns": (-100, 100),
        "roll_turns": (-100, 100),
        "speed_percent": (1, 100),
        "plant_speed_permille": (1, 1_000_000),
    }
    fields = {
        name: st.integers(*bounds[name]) if name in bounds else values(codec) for name, codec in layout(kind)
    }
    if kind in (Announce, Open):  # of another version nothing but the version is read
        fields["protocol_version"] = st.just(PROTOCOL_VERSION)
    return st.builds(kind, **fields)


@st.composite
def path_blocks(draw: st.DrawFn) -> PathBlock:
    """A block of some path, in its place; what it carries is looked at by who assembles it alone."""
    poses = draw(st.integers(2, POSES_MAX))
    total = HEADER_BYTES + POSE_BYTES * poses
    count = -(-total // BLOCK_BYTES)
    index = draw(st.integers(0, count - 1))
    length = draw(st.sampled_from([1, 8, BLOCK_DATA_MAX]))
    data = draw(st.binary(min_size=1, max_size=8)).ljust(length, b"\x5a")[:length]
    return PathBlock(index, count, index * BLOCK_BYTES, total, draw(st.integers(0, 2**32 - 1)), data)


def records(kinds: list[type[Record]] | None = None) -> st.SearchStrategy[Record]:
    """Any record that can be sent."""
    chosen = list(RECORDS.values()) if kinds is None else kinds
    return st.one_of([path_blocks() if kind is PathBlock else blocks(kind) for kind in chosen])  # type: ignore[arg-type]


def session_of(kind: type[Record]) -> int:
    """A tag with which this kind may be sent."""
    return 0xC0FFEE if kind.INSIDE_SESSION else 0
