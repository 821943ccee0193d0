"""The quantised path: small errors, exact poles, strict blocks."""

import math
import struct
import zlib
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cutgate.protocol import path as paths
from cutgate.protocol.coding import encode
from cutgate.protocol.path import (
    BLOCK_BYTES,
    BLOCK_DATA_MAX,
    HEADER_BYTES,
    PATH_BYTES_MAX,
    POSE_BYTES,
    POSES_MAX,
    SCALE,
    Assembly,
    Path,
    PathBlock,
    PathCodes,
    PathHeader,
    block_of_pose,
    decode_axes,
    encode_axes,
    path_block,
    split,
)
from cutgate.protocol.wire import RecordError, digest

UP = [0.0, 0.0, 1.0]
TIPS = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def quantised(tips=TIPS, axes=(UP, UP), **changes) -> Path:
    values = {"feed_mm_s": 10.0, "tool_length_mm": 160.0, "elbow": "right"} | changes
    return Path.quantised(tips, axes, **values)


def long_path(poses: int) -> Path:
    line = np.linspace(0.0, 1.0, poses)[:, np.newaxis]
    return quantised(line * [100.0, -50.0, 25.0], np.tile(UP, (poses, 1)))


unit_axes = hnp.arrays(np.float64, (8, 3), elements=st.floats(-1.0, 1.0)).map(
    lambda axes: axes[np.linalg.norm(axes, axis=1) > 1e-3]
)


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return 2.0 * np.arctan2(np.linalg.norm(first - second, axis=1), np.linalg.norm(first + second, axis=1))


@given(unit_axes)
def test_axes_move_by_less_than_a_microradian_and_stay_unit(axes: np.ndarray):
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    decoded = decode_axes(encode_axes(unit))
    assert np.all(angles(unit, decoded) <= 1e-8)
    assert np.allclose(np.linalg.norm(decoded, axis=1), 1.0, rtol=0.0, atol=4e-16)


@given(unit_axes)
def test_quantising_twice_changes_nothing(axes: np.ndarray):
    once = decode_axes(encode_axes(axes))
    assert decode_axes(encode_axes(once)).tobytes() == once.tobytes()


@given(
    st.lists(st.floats(-2147483.0, 2147483.0), min_size=6, max_size=6),
    st.integers(-5, 5),
    st.integers(-5, 5),
)
def test_path_round_trip_moves_tips_by_at_most_half_a_micrometre(values: list[float], q0: int, roll: int):
    tips = np.reshape(values, (2, 3))
    path = quantised(tips, q0_turns=q0, roll_turns=roll, elbow="left")
    assert Path.parse(path.body()) == path
    assert np.all(np.abs(path.tips_mm - tips) <= 0.5e-3 + 1e-8)
    again = quantised(path.tips_mm, path.axes, q0_turns=q0, roll_turns=roll, elbow="left")
    assert again == path
    assert again.digest == digest(path.body())


def test_poles_are_exact():
    assert encode_axes(np.array([UP])).tolist() == [[0, 0]]
    assert encode_axes(np.array([[0.0, 0.0, -1.0]])).tolist() == [[SCALE, SCALE]]
    corners = np.array(
        [[0, 0], [SCALE, SCALE], [-SCALE, SCALE], [SCALE, -SCALE], [-SCALE, -SCALE]], dtype=np.int32
    )
    assert decode_axes(corners).tolist() == [UP] + 4 * [[0.0, 0.0, -1.0]]


def test_properties_give_units():
    path = quantised()
    assert (path.feed_mm_s, path.tool_length_mm, len(path)) == (10.0, 160.0, 2)
    assert path.poses.shape == (2, 5)
    for array in (path.poses, path.tips_mm, path.axes):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1


def test_twenty_bytes_a_pose():
    assert len(quantised().body()) == HEADER_BYTES + 2 * POSE_BYTES


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"tips": [[0.0, 0.0, 0.0]], "axes": [UP]}, "1 poses"),
        ({"tips": [0.0, 0.0, 0.0], "axes": UP}, r"must be \(n, 3\)"),
        ({"tips": [[0.0, 0.0]] * 2, "axes": [[0.0, 1.0]] * 2}, r"must be \(n, 3\)"),
        ({"axes": [UP]}, r"must be \(n, 3\)"),
        ({"tips": [TIPS[0], [0.0, math.nan, 0.0]]}, "pose 1: is not finite"),
        ({"axes": [[math.inf, 0.0, 0.0], UP]}, "pose 0: is not finite"),
        ({"tips": [TIPS[0], [0.0, 2147483.648, 0.0]]}, "pose 1: tip is beyond"),
        ({"axes": [UP, [0.0, 0.0, 1.0011]]}, "pose 1: axis length"),
        ({"axes": [UP, [0.0, 0.0, 0.0]]}, "pose 1: axis length"),
        ({"axes": [UP, [0.0, 0.0, -1.0]]}, "pose 0: axis is more than 179"),
        ({"feed_mm_s": 0.0}, "feed is 0.0"),
        ({"feed_mm_s": -1.0}, "feed is -1.0"),
        ({"feed_mm_s": math.nan}, "feed is nan"),
        ({"tool_length_mm": -0.1}, "tool length is -0.1"),
        ({"q0_turns": 101}, "q0_turns is 101"),
        ({"roll_turns": -101}, "roll_turns is -101"),
        ({"elbow": "up"}, "must be one of right, left"),
    ],
)
def test_path_that_cannot_be_executed_is_refused(changes, why: str):
    with pytest.raises(RecordError, match=why):
        quantised(**changes)


@pytest.mark.parametrize(("degrees", "admitted"), [(178.999, True), (179.001, False)])
def test_neighbouring_axes_at_most_179_degrees_apart(degrees: float, admitted: bool):
    angle = math.radians(degrees)
    axes = [UP, [math.sin(angle), 0.0, math.cos(angle)]]
    if admitted:
        assert quantised(axes=axes)
    else:
        with pytest.raises(RecordError, match="more than 179"):
            quantised(axes=axes)


def test_too_many_poses_are_refused():
    with pytest.raises(RecordError, match=f"{POSES_MAX + 1} poses"):
        replace(quantised(), pose_bytes=bytes(POSE_BYTES * (POSES_MAX + 1)))


def test_half_a_pose_is_refused():
    with pytest.raises(RecordError, match="multiple of 20"):
        replace(quantised(), pose_bytes=bytes(50))


def test_axis_code_beyond_its_scale_is_refused():
    poses = quantised().poses.copy()
    poses[1, 3] = -SCALE - 1
    with pytest.raises(RecordError, match="pose 1: axis code"):
        replace(quantised(), pose_bytes=poses.tobytes())


@pytest.mark.parametrize("at", [0, 12, 13, 14])
def test_another_format_is_refused(at: int):
    body = bytearray(quantised().body())
    body[at] ^= 0x40
    with pytest.raises(RecordError, match="path format"):
        Path.parse(bytes(body))


def test_another_count_is_refused():
    body = quantised().body()
    for wrong in (body[:-POSE_BYTES], body + bytes(POSE_BYTES), body[:-1], body[:39], b""):
        with pytest.raises(RecordError):
            Path.parse(wrong)


@pytest.mark.parametrize("poses", [2, 198, 199, 398, 399, 2000])
def test_blocks_assemble_to_the_path(poses: int):
    path = long_path(poses)
    assembly = Assembly()
    for block in split(path.body()):
        assert not assembly.complete
        assembly = assembly.add(PathBlock.parse(block.body()))
    assert assembly.complete
    assert assembly.data == path.body()
    assert [zlib.crc32(block) for block in assembly.blocks] == list(assembly.crc32s)
    for pose in (0, poses // 2, poses - 1):
        start = HEADER_BYTES + POSE_BYTES * pose - BLOCK_BYTES * block_of_pose(pose)
        assert assembly.blocks[block_of_pose(pose)][start : start + POSE_BYTES] == path.poses[pose].tobytes()


def test_incomplete_assembly_gives_no_path():
    assembly = Assembly().add(split(long_path(2000).body())[0])
    for incomplete in (Assembly(), assembly):
        with pytest.raises(RecordError, match="not complete"):
            _ = incomplete.data


def test_block_out_of_order_or_of_another_path_is_refused():
    blocks = split(long_path(2000).body())
    assembly = Assembly().add(blocks[0])
    for block in (blocks[0], blocks[2]):
        with pytest.raises(RecordError, match="where 1 was due"):
            assembly.add(block)
    with pytest.raises(RecordError, match="the path of"):
        assembly.add(split(long_path(1999).body())[1])


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            {"total": PATH_BYTES_MAX + POSE_BYTES},
            "PathBlock.total is 20971580, must be 40 and 20 for each of 2..",
        ),
        ({"total": 40041}, "PathBlock.total is 40041"),
        ({"total": 60, "count": 1, "index": 0, "offset": 0}, "PathBlock.total is 60"),
        ({"total": 0, "count": 0, "index": 0}, "PathBlock.total is 0"),
        ({"count": 12}, "PathBlock 3 of 12 does not fit 40040 bytes"),
        ({"index": 11, "offset": 44000}, "PathBlock 11 of 11 does not fit"),
        ({"offset": 1}, "PathBlock 3: offset must be 12000"),
    ],
)
def test_block_that_does_not_lie_where_it_says_is_refused(change: dict[str, object], why: str):
    block = split(long_path(2000).body())[3]
    with pytest.raises(RecordError, match=why):
        replace(block, **change)


@pytest.mark.parametrize("index", [0, 3, 10])
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda block: {"data": block.data + b"\0"}, "are followed by others"),
        (lambda block: {"data": block.data[:-1]}, "coded poses (end|have [0-9]+ prefixes)"),
        (lambda block: {"data": block.data[:1]}, "coded poses end inside component 0"),
        (lambda block: {"block_crc32": block.block_crc32 ^ 1}, "CRC-32 does not match its poses"),
    ],
    ids=["longer", "shorter", "nearly nothing", "of other poses"],
)
def test_block_that_is_not_the_coding_of_its_poses_is_refused(index: int, change, why: str):
    block = split(long_path(2000).body())[index]
    with pytest.raises(RecordError, match=f"^PathBlock {index}: .*{why}"):
        replace(block, **change(block)).decoded()


@pytest.mark.parametrize(
    ("poses", "index", "said"), [(2, 0, 3), (400, 0, 2), (400, 2, 403), (400, 1, 399), (2000, 10, 2198)]
)
def test_block_of_another_number_of_poses_is_refused(poses: int, index: int, said: int):
    """How many it holds follows from its place, and nothing else says it."""
    block, total = split(long_path(poses).body())[index], HEADER_BYTES + POSE_BYTES * said
    elsewhere = replace(block, total=total, count=-(-total // BLOCK_BYTES))
    if said == 399:  # the same number of poses in this block
        assert elsewhere.decoded() == block.decoded()
    else:
        with pytest.raises(RecordError, match=f"^PathBlock {index}: coded poses"):
            elsewhere.decoded()


def test_a_block_is_sent_as_its_header_and_its_coded_poses():
    path = quantised()
    (block,) = split(path.body())
    assert (block.index, block.count, block.offset, block.total) == (0, 1, 0, 80)
    assert block.data == path.body()[:40] + encode(path.poses)
    assert block.block_crc32 == zlib.crc32(path.body())
    assert block.decoded() == path.body()
    assert split(long_path(2000).body())[4] == path_block(long_path(2000).body(), 4)


def test_poses_of_noise_fit_their_blocks():
    poses = np.random.default_rng(1).integers(-(2**31), 2**31, (398, 5), dtype="<i4")
    body = replace_count(quantised().body()[:HEADER_BYTES], 398) + poses.tobytes()
    first, second = split(body)
    assert (len(first.data), len(second.data)) == (BLOCK_DATA_MAX, BLOCK_DATA_MAX) == (4006, 4006)
    assert Assembly().add(first).add(second).data == body


def replace_count(header: bytes, poses: int) -> bytes:
    return header[:36] + struct.pack("<I", poses)


def test_the_header_alone_says_what_the_path_says_and_looks_at_no_pose():
    path = Path.quantised(TIPS, [UP, UP], feed_mm_s=3.5, tool_length_mm=160.25, elbow="left", roll_turns=-2)
    header = PathHeader.of(path.body()[:HEADER_BYTES] + bytes([255]) * 40)
    for name in ("elbow", "q0_turns", "roll_turns", "feed_u", "tool_length_u", "feed_mm_s", "tool_length_mm"):
        assert getattr(header, name) == getattr(path, name)
    assert header.count == len(path)


@pytest.mark.parametrize(
    "change",
    [lambda b: b[:-1], lambda b: b + b"\0", lambda b: b"x" + b[1:], lambda _: b""],
    ids=["shorter", "longer", "another magic", "nothing"],
)
def test_a_header_that_does_not_fit_its_path_is_refused(change):
    path = Path.quantised(TIPS, [UP, UP], feed_mm_s=3.5, tool_length_mm=160.0, elbow="right")
    with pytest.raises(RecordError):
        PathHeader.of(change(path.body()))


@pytest.mark.parametrize("begin", [0, 1, 3])
def test_codes_are_taken_over_unlooked_at_and_judged_where_asked(begin: int):
    codes = Path.parse(long_path(6).body()).poses.copy()
    codes[3, 3] = SCALE + 1
    body = long_path(6).body()[:HEADER_BYTES] + codes.tobytes()
    taken = PathCodes.parse(body)
    assert (taken.body(), len(taken)) == (body, 6)
    taken.judge(0, 3)
    taken.judge(5, 6)
    with pytest.raises(RecordError, match=r"path pose 3: axis code is beyond"):
        taken.judge(begin, 4)
    with pytest.raises(RecordError, match=r"path pose 3: axis code is beyond"):
        taken.judge(4, 5)
    with pytest.raises(RecordError, match=r"path pose 3: axis code is beyond"):
        Path.parse(body)


def test_the_header_is_these_forty_bytes():
    path = quantised(feed_mm_s=3.5, tool_length_mm=160.25, elbow="left", q0_turns=-3, roll_turns=2)
    written = struct.pack(
        "<12sBBBBhhqqI", b"cutgate.path", 1, 1, 1, 2, -3, 2, 3_500_000, 160_250_000, len(path)
    )
    assert path.body()[:40] == written
    assert quantised().body()[15:20] == b"\1\0\0\0\0"  # right elbow, no turns unless asked for


def test_what_lies_on_a_bound_of_the_header_is_within_it():
    header = PathHeader.of(quantised(tool_length_mm=0.0, q0_turns=100, roll_turns=-100).body())
    assert (header.tool_length_u, header.q0_turns, header.roll_turns) == (0, 100, -100)
    assert replace(header, feed_u=1).feed_mm_s == 1e-6
    assert replace(header, count=1_048_576).count == 1 << 20
    with pytest.raises(RecordError, match=r"has 1048577 poses, must have 2\.\.1048576"):
        replace(header, count=1_048_577)


def test_the_largest_path_has_its_last_block():
    total = 40 + 20 * 1_048_576
    last = PathBlock(
        5242, 5243, 5242 * 4000, total, zlib.crc32(bytes(3560)), encode(np.zeros((178, 5), "<i4"))
    )
    assert last.decoded() == bytes(3560)
    assert PathBlock.TYPE == 0x20


def test_numbers_of_less_precision_are_quantised_as_what_they_are():
    """A float32 is a number of its own: no step is taken in its precision."""
    tips = np.array([[123456.7, 2.1, 3.3], [12345.67, 5.0, 6.0]], dtype=np.float32)
    axes = np.array([[0.6, 0.0, 0.8], [0.36, 0.48, 0.8]], dtype=np.float32)
    path = quantised(tips, axes)
    assert np.abs(path.tips_mm - tips.astype(np.float64)).max() <= 0.5e-3 + 1e-10
    assert angles(path.axes, axes / np.linalg.norm(axes.astype(np.float64), axis=1)[:, None]).max() <= 1e-8


def test_axes_that_turn_far_in_small_steps_are_admitted():
    azimuth = np.radians(np.arange(0.0, 350.0, 20.0))
    axes = np.stack((np.sin(azimuth), np.zeros(len(azimuth)), np.cos(azimuth)), axis=1)
    assert len(quantised(np.zeros((len(axes), 3)), axes)) == len(axes)


def test_one_step_too_far_among_many_is_refused_and_named():
    axes = np.tile(UP, (6, 1))
    axes[4:] *= -1.0
    with pytest.raises(RecordError, match="pose 3: axis is more than 179"):
        quantised(np.zeros((6, 3)), axes)


def test_neighbouring_axes_exactly_as_far_apart_as_allowed_are_admitted(monkeypatch):
    monkeypatch.setattr(paths, "_HALF_SUM_MIN", 1.0)  # that of two equal axes
    assert quantised()


def test_codes_decode_to_millimetres_and_unit_axes():
    path = PathCodes.parse(quantised([[1.5, -2.25, 3.125], TIPS[1]], [UP, [0.6, 0.0, 0.8]]).body())
    tips, axes = path.decoded(0, 1)
    assert (tips.tolist(), axes.tolist()) == ([[1.5, -2.25, 3.125]], [UP])
    tips, axes = path.decoded(1, 2)
    assert tips.tolist() == [TIPS[1]]
    np.testing.assert_allclose(axes, [[0.6, 0.0, 0.8]], atol=1e-8)


def test_the_first_pose_is_judged_with_the_others():
    codes = quantised().poses.copy()
    codes[0, 4] = SCALE + 1
    path = PathCodes.parse(quantised().body()[:HEADER_BYTES] + codes.tobytes())
    with pytest.raises(RecordError, match="path pose 0: axis code is beyond"):
        path.judge(0, 1)


def test_an_assembly_is_a_value():
    assert Assembly() == Assembly((), (), 0)
    with pytest.raises(FrozenInstanceError):
        Assembly().total = 1
