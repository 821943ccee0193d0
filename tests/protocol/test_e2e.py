"""End-to-end protection against the AUTOSAR library; counters; corruption."""

import struct

import e2e as autosar
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.e2e import CorruptionCount, Sequence, Step, crc16, intact, protect

payloads = st.binary(min_size=5, max_size=5)
counters = st.integers(0, 255)
data_ids = st.integers(0, 0xFFFF)
tags = st.integers(0, 0xFFFFFFFF)


@given(payloads, counters, data_ids, tags)
def test_protected_frame_passes_the_autosar_check(payload: bytes, counter: int, data_id: int, tag: int):
    data = protect(payload, counter, data_id, tag)
    buffer = bytearray(data + struct.pack("<I", tag))
    assert autosar.p05.e2e_p05_check(buffer, data_id)
    autosar.p05.e2e_p05_protect(buffer, data_id, increment_counter=False)
    assert bytes(buffer[:8]) == data
    assert intact(data, data_id, tag)


@given(st.binary(min_size=8, max_size=8), data_ids, tags)
def test_any_eight_bytes_are_judged_as_autosar_judges_them(data: bytes, data_id: int, tag: int):
    assert intact(data, data_id, tag) == autosar.p05.e2e_p05_check(data + struct.pack("<I", tag), data_id)


@given(payloads, counters, data_ids, tags, st.integers(0, 63))
def test_any_flipped_bit_is_found(payload: bytes, counter: int, data_id: int, tag: int, bit: int):
    data = bytearray(protect(payload, counter, data_id, tag))
    data[bit // 8] ^= 1 << bit % 8
    assert not intact(bytes(data), data_id, tag)


@given(payloads, counters, data_ids, tags, data_ids)
def test_another_data_id_is_found(payload: bytes, counter: int, data_id: int, tag: int, other: int):
    assert intact(protect(payload, counter, data_id, tag), other, tag) == (other == data_id)


@given(payloads, counters, data_ids, tags, st.integers(0, 31))
def test_another_session_is_found(payload: bytes, counter: int, data_id: int, tag: int, bit: int):
    assert not intact(protect(payload, counter, data_id, tag), data_id, tag ^ 1 << bit)


@pytest.mark.parametrize("length", [0, 7, 9, 64])
def test_another_length_is_not_intact(length: int):
    assert not intact(bytes(length), 1, 1)


@pytest.mark.parametrize("length", [0, 4, 6])
def test_another_payload_length_is_refused(length: int):
    with pytest.raises(ValueError, match="must be 5"):
        protect(bytes(length), 0, 1, 1)


def test_crc_check_value():
    """CRC-16/IBM-3740 of "123456789" is 0x29B1; tag and data ID stand for its last six digits."""
    assert crc16(b"123", int.from_bytes(b"89", "little"), int.from_bytes(b"4567", "little")) == 0x29B1


def framed(counter: int, payload: int = 0) -> bytes:
    return bytes([0, 0, counter % 256, payload, 0, 0, 0, 0])


@given(counters, st.integers(0, 255))
def test_counter_rule_over_all_steps(first: int, delta: int):
    sequence = Sequence()
    assert sequence.judge(framed(first)) == (Step.NEXT, 0)
    outcome = sequence.judge(framed(first + delta))
    if delta == 0:
        assert outcome == (Step.REPEATED, 0)
    elif delta <= 3:
        assert outcome == (Step.NEXT, delta - 1)
    else:
        assert outcome == (Step.BROKEN, delta - 1)


def test_each_accepted_frame_is_the_one_the_next_is_counted_from():
    sequence = Sequence()
    assert [sequence.judge(framed(counter)) for counter in (250, 253, 0, 1, 4)] == [
        (Step.NEXT, lost) for lost in (0, 2, 2, 0, 2)
    ]


def test_same_counter_with_other_content_breaks_the_sequence():
    sequence = Sequence()
    sequence.judge(framed(7))
    assert sequence.judge(framed(7, payload=1)) == (Step.BROKEN, 0)
    assert sequence.judge(framed(8)) == (Step.NEXT, 0)


def test_broken_step_does_not_move_the_sequence():
    sequence = Sequence()
    sequence.judge(framed(7))
    assert sequence.judge(framed(11)) == (Step.BROKEN, 3)
    assert sequence.judge(framed(10)) == (Step.NEXT, 2)


def test_third_corruption_within_a_second_is_not_tolerated():
    watch = CorruptionCount()
    assert [watch.tolerated(at) for at in (77.0, 77.5, 78.0)] == [True, True, False]


def test_corruption_is_forgotten_after_a_second():
    watch = CorruptionCount()
    assert all(watch.tolerated(at) for at in (0.0, 0.5, 1.001, 1.501, 2.1))
