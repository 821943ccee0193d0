"""The coding of a block's poses: one form for each, everything else refused, in bounded memory."""

import contextlib
import json
import struct
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cutgate.protocol.coding import coded_bytes_max, decode, encode, fewest, written
from cutgate.protocol.wire import RecordError
from tests.protocol.plain_coding import Bits, component
from tests.protocol.vectors import generate

VECTORS = json.loads((generate.HERE / "coding.json").read_text(encoding="ascii"))
BLOCK_POSES = 200
LOW, HIGH = -(2**31), 2**31 - 1
MEMORY_BOUND = 400_000
"""Bytes while a block of 200 poses is decoded, whatever stands in it."""


def plain_decode(data: bytes, count: int) -> list[tuple[int, ...]] | None:
    """The same without numpy, as firmware may do it; None where it is refused."""
    bits = Bits(data)
    try:
        poses = list(zip(*[component(bits, count) for _ in range(5)], strict=True))
    except EOFError:
        return None
    return poses if data == generate.coded_poses(struct.pack(f"<{5 * count}i", *sum(poses, ()))) else None


def decoded(data: bytes, count: int) -> list[tuple[int, ...]] | None:
    try:
        poses = decode(data, count)
    except RecordError:
        return None
    assert poses.shape == (count, 5)
    assert poses.dtype == np.int32
    assert encode(poses) == data
    return [tuple(pose) for pose in poses.tolist()]


def codes(values: Any) -> np.ndarray:
    return np.array(values, dtype=np.int32).reshape(-1, 5)


smooth = st.builds(
    lambda seeds, poses: np.column_stack(
        [
            sum(part * np.arange(poses, dtype=np.int64) ** power for power, part in enumerate(one))
            for one in seeds
        ]
    ),
    st.lists(st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=6), min_size=5, max_size=5),
    st.integers(1, BLOCK_POSES),
).map(lambda values: ((values + 2**31) % 2**32 - 2**31).astype(np.int32))
"""Each component a polynomial, wrapped around."""
anything = st.integers(1, BLOCK_POSES).flatmap(
    lambda poses: hnp.arrays(
        np.int32,
        (poses, 5),
        elements=st.one_of(st.sampled_from([LOW, HIGH, 0, -1]), st.integers(LOW, HIGH), st.integers(-9, 9)),
    )
)
jumps = st.tuples(smooth, st.integers(0, BLOCK_POSES - 1), st.integers(LOW, HIGH)).map(
    lambda drawn: np.where(
        np.arange(len(drawn[0]))[:, None] >= drawn[1], drawn[0] ^ np.int32(drawn[2]), drawn[0]
    )
)


@given(st.one_of(smooth, anything, jumps))
@example(codes([0] * 5))
@example(np.full((BLOCK_POSES, 5), LOW, dtype=np.int32))
def test_poses_come_back_to_the_last_bit(poses: np.ndarray):
    data = encode(poses)
    assert len(data) <= coded_bytes_max(len(poses))
    assert decode(data, len(poses)).tolist() == poses.tolist()


@given(st.one_of(smooth, anything, jumps).map(lambda poses: poses[:12]))
@settings(max_examples=60)
def test_an_independent_coder_that_tries_everything_makes_the_same_bytes(poses: np.ndarray):
    assert generate.coded_poses(poses.astype("<i4").tobytes()) == encode(poses)


@given(st.binary(max_size=200), st.integers(1, BLOCK_POSES))
def test_any_bytes_are_refused_or_the_coding_of_what_they_say(data: bytes, count: int):
    decoded(data, count)


@given(st.data())
def test_changed_bytes_are_refused_or_the_coding_of_what_they_say(data: st.DataObject):
    """As one that shares no line with it decides."""
    poses = data.draw(st.one_of(smooth, anything, jumps).map(lambda poses: poses[:9]))
    sound = encode(poses)
    bits = data.draw(st.lists(st.integers(0, 8 * len(sound) - 1), max_size=3))
    number = int.from_bytes(sound, "little")
    for bit in bits:
        number ^= 1 << bit
    changed = number.to_bytes(len(sound), "little") + data.draw(st.sampled_from([b"", b"\0", b"\1"]))
    changed = changed[: len(changed) - data.draw(st.sampled_from([0, 0, 0, 1, 30]))]
    count = max(1, len(poses) + data.draw(st.sampled_from([0, 0, 0, 1, -1])))
    assert decoded(changed, count) == plain_decode(changed, count)


@pytest.mark.parametrize("vector", VECTORS["coded"], ids=lambda vector: vector["what"])
def test_coded_poses_equal_the_vector(vector: dict[str, str]):
    poses, data = np.frombuffer(bytes.fromhex(vector["poses"]), dtype="<i4"), bytes.fromhex(vector["data"])
    assert encode(poses.reshape(-1, 5)) == data
    assert decode(data, len(poses) // 5).ravel().tolist() == poses.tolist()
    assert plain_decode(data, len(poses) // 5) == [tuple(pose) for pose in poses.reshape(-1, 5).tolist()]


@pytest.mark.parametrize("vector", VECTORS["refused"], ids=lambda vector: vector["what"])
def test_what_the_vectors_refuse_is_refused(vector: dict[str, Any]):
    with pytest.raises(RecordError):
        decode(bytes.fromhex(vector["data"]), vector["poses"])
    assert plain_decode(bytes.fromhex(vector["data"]), vector["poses"]) is None


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ("a byte less", "coded poses end inside component 4"),
        ("none", "coded poses end inside component 0"),
        ("a byte more", "coded poses of 460 bits are followed by others"),
        ("a bit set behind them", "coded poses of 460 bits are followed by others"),
        ("a higher order with as many bits", "another order or parameter than those of the fewest bits"),
        ("more bits than the longest number has", "another order or parameter than those of the fewest bits"),
        ("a prefix of more zeros than a number has bits", "have a prefix of more than 32 zeros"),
        ("a prefix without an end", "have 0 prefixes, must have 1"),
    ],
)
def test_a_refusal_says_why(what: str, why: str):
    (vector,) = (one for one in VECTORS["refused"] if one["what"] == what)
    with pytest.raises(RecordError, match=f"^coded poses.*{why.removeprefix('coded poses ')}$"):
        decode(bytes.fromhex(vector["data"]), vector["poses"])


@pytest.mark.parametrize("known", [0, 1, 10, 30])
def test_one_prefix_with_too_many_zeros_among_others_is_refused(known: int):
    alone, most = struct.pack("<5i", *[7] * 5), 32 - known
    for zeros in (most, most + 1):
        behind = "0" * zeros + "11" + "0" * (32 + known)
        data = generate.coded_poses(alone, {4: (1, 33 + known)}, behind=behind)
        why = f"more than {most} zeros" if zeros > most else "those of the fewest bits"
        with pytest.raises(RecordError, match=f"^coded poses have .* {why}$"):
            decode(data, 3)


def line(*values: int) -> np.ndarray:
    return np.array([[value, 0, 0, 0, 0] for value in values], dtype=np.int32)


@pytest.mark.parametrize(
    ("poses", "choice"),
    [
        (line(5), (0, 0)),
        (line(5, 5, 5), (0, 0)),
        (line(0, 1, 2), (0, 2)),  # the numbers 2, 2; of order 2, 2, 0: four bits each time
        (line(0, 1, 2, 3, 4), (1, 33)),  # 2, 0, 0, 0: 4 bits and 3, where fixed ones are 8
        (line(0, 1, 1, 1), (0, 2)),  # 2, 0, 0: 4 bits and 2, as many as fixed ones
        (line(0, HIGH, LOW, HIGH), (0, 34)),  # from the end to the other is a step of 1
    ],
    ids=["one pose", "still", "tie of orders", "a step", "tie of parameters", "around the end"],
)
def test_the_fewest_bits_then_the_lowest_order_then_the_lowest_parameter(poses, choice):
    assert fewest(poses) == [choice, (0, 0), (0, 0), (0, 0), (0, 0)]


def test_every_order_is_taken_where_it_needs_the_fewest_bits():
    steps = np.arange(60, dtype=np.int64)
    for order in range(8):
        poses = np.repeat(steps[:, None] ** order % 2**32, 5, axis=1).astype(np.uint32).view(np.int32)
        assert {found for found, _ in fewest(poses)} == {order}


def test_the_bytes_of_another_choice_are_never_those_of_the_same_poses():
    poses = np.cumsum(np.arange(150, dtype=np.int32).reshape(30, 5) % 11, axis=0, dtype=np.int32)
    right = fewest(poses)
    assert written(poses, right) == encode(poses)
    for order in range(8):
        for parameter in range(64):
            data = written(poses, [(order, parameter), *right[1:]])
            same = decoded(data, 30) == [tuple(pose) for pose in poses.tolist()]
            assert same == ((order, parameter) == right[0])


def test_the_longest_coding_is_known():
    assert len(encode(NOISE)) == coded_bytes_max(BLOCK_POSES) == 4006
    assert coded_bytes_max(1) == 26
    assert coded_bytes_max(198) == 3966


NOISE = np.random.default_rng(5).integers(LOW, HIGH, (BLOCK_POSES, 5), dtype=np.int32)


@pytest.mark.parametrize(
    "data",
    [encode(NOISE), *(encode(NOISE)[:20] + filled * 3986 for filled in (b"\0", b"\xff", b"\xaa", b"\x11"))],
    ids=["sound", "zeros", "ones", "by turns", "one in four"],
)
def test_memory_is_bounded_whatever_is_decoded(data: bytes):
    def work() -> None:
        with contextlib.suppress(RecordError):
            decode(data, BLOCK_POSES)

    work()  # what the first call alone needs is no part of it
    tracemalloc.start()
    try:
        work()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MEMORY_BOUND
