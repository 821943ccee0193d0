"""Envelopes: what comes out is what went in; one flipped bit, and nothing comes out."""

import contextlib
import struct
import zlib
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cutgate.protocol import wire
from cutgate.protocol.path import BLOCK_BYTES, BLOCK_DATA_MAX, PathBlock
from cutgate.protocol.records import (
    ENVELOPE_BYTES_MAX,
    PROTOCOL_VERSION,
    RECORDS,
    Acknowledge,
    Announce,
    Channel,
    Collect,
    Envelope,
    Open,
    OtherVersion,
    Record,
    RecordError,
    Reply,
    Side,
    Timing,
    pack,
    unpack,
)
from cutgate.protocol.states import StopCause
from tests.protocol.strategies import blocks, path_blocks, records, session_of

COLLECT = pack(Collect(), 5, 6)


def forged(code: int, reserved: int, length: int, session: int, body: bytes) -> bytes:
    """An envelope with a right CRC around anything."""
    head = struct.pack("<BBHII", code, reserved, length, session, 1) + body
    return head + struct.pack("<I", zlib.crc32(head))


@given(records(), st.integers(0, 2**32 - 1))
def test_every_record_round_trips(record: Record, sequence: int):
    session = session_of(type(record))
    data = pack(record, session, sequence)
    assert len(data) <= ENVELOPE_BYTES_MAX
    assert unpack(data) == Envelope(record.TYPE, session, sequence, record)
    assert unpack(data, sender=record.SENDER, channel=record.CHANNEL).record == record


@pytest.mark.parametrize("kind", RECORDS.values(), ids=lambda kind: kind.__name__)
@given(data=st.data())
def test_any_flipped_bit_is_refused(kind: type[Record], data: st.DataObject):
    record = data.draw(path_blocks() if kind is PathBlock else blocks(kind))  # type: ignore[arg-type]
    packed = bytearray(pack(record, session_of(kind), 3))  # type: ignore[arg-type]
    bit = data.draw(st.integers(0, 8 * len(packed) - 1))
    packed[bit // 8] ^= 1 << bit % 8
    with pytest.raises(RecordError):
        unpack(bytes(packed))


@given(st.binary(max_size=200))
@example(b"")
def test_any_bytes_raise_nothing_but_record_error(data: bytes):
    with contextlib.suppress(RecordError):
        unpack(data)


@given(st.sampled_from(sorted(RECORDS)), st.sampled_from([0, 5]), st.binary(max_size=300))
def test_any_body_behind_a_right_crc_parses_or_is_refused(code: int, session: int, body: bytes):
    data = forged(code, 0, len(body), session, body)
    with contextlib.suppress(RecordError):
        envelope = unpack(data)
        if not isinstance(envelope.record, OtherVersion):
            assert pack(envelope.record, session, 1) == data


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (COLLECT[:15], "is 15 bytes"),
        (bytes(4096), "is 4096 bytes"),
        (COLLECT[:-1] + bytes([COLLECT[-1] ^ 1]), "CRC-32"),
        (forged(4, 1, 0, 5, b""), "reserved"),
        (forged(4, 0, 4079, 5, bytes(4079)), "Collect is followed by 4079 bytes"),
        (forged(4, 0, 1, 5, b""), "length says 1, body is 0 bytes"),
        (forged(4, 0, 0, 5, b"x"), "length says 0, body is 1 bytes"),
        (forged(0x99, 0, 0, 5, b""), "type 0x99"),
        (forged(4, 0, 1, 5, b"x"), "Collect is followed by 1 bytes"),
        (forged(4, 0, 0, 0, b""), "Collect must not be sent outside a session"),
        (forged(10, 0, 18, 5, b"\x00\xff" + bytes(16)), "Acknowledge.cause is 0xff"),
    ],
)
def test_malformed_envelope_is_refused_with_its_reason(data: bytes, why: str):
    with pytest.raises(RecordError, match=why):
        unpack(data)


def test_what_has_passed_stays_as_it_came():
    with pytest.raises(FrozenInstanceError):
        unpack(COLLECT).session = 6  # type: ignore[misc]


@pytest.mark.parametrize("session", [-1, 2**32])
def test_numbers_beyond_32_bits_are_refused(session: int):
    with pytest.raises(RecordError, match="session is"):
        pack(Collect(), session, 0)
    with pytest.raises(RecordError, match="sequence is"):
        pack(Collect(), 1, session)


@pytest.mark.parametrize("kind", [Announce, Open])
@given(data=st.data())
def test_announce_and_open_are_refused_inside_a_session(kind: type[Record], data: st.DataObject):
    record = data.draw(blocks(kind))
    with pytest.raises(RecordError, match="inside a session"):
        pack(record, 5, 0)  # type: ignore[arg-type]


def test_only_announce_open_and_reply_are_sent_outside_a_session():
    assert {kind for kind in RECORDS.values() if kind.OUTSIDE_SESSION} == {Announce, Open, Reply}


@given(records())
def test_record_from_the_wrong_side_or_channel_is_refused(record: Record):
    data = pack(record, session_of(type(record)), 1)
    with pytest.raises(RecordError, match="never sent by"):
        unpack(data, sender=record.SENDER.peer)
    with pytest.raises(RecordError, match="does not belong"):
        unpack(data, channel=Channel(1 - record.CHANNEL))


def test_every_record_kind_is_listed():
    def kinds(base: type[Record]) -> set[type[Record]]:
        return {base}.union(*(kinds(sub) for sub in base.__subclasses__()))

    listed = {kind for kind in kinds(wire.Record) if "TYPE" in vars(kind)}
    assert listed == {*RECORDS.values(), OtherVersion}
    assert {kind.SENDER for kind in listed} == set(Side)


def test_largest_block_fits_one_transfer():
    block = PathBlock(0, 2, 0, 2 * BLOCK_BYTES, 0, bytes(BLOCK_DATA_MAX))
    assert len(pack(block, 1, 1)) <= ENVELOPE_BYTES_MAX
    with pytest.raises(RecordError, match=r"PathBlock\.data must be 1\.\.4006 bytes"):
        replace(block, data=bytes(BLOCK_DATA_MAX + 1))


def test_acknowledge_names_its_cause():
    assert Acknowledge(31, StopCause.BONE_MOVED).body() == b"\x1f\x0e" + bytes(16)


@pytest.mark.parametrize("kind", [Announce, Open])
@given(
    version=st.integers(0, 2**16 - 1).filter(lambda version: version != PROTOCOL_VERSION),
    rest=st.binary(max_size=500),
)
def test_of_another_version_nothing_but_the_version_is_read(kind: type[Record], version: int, rest: bytes):
    """So that a person is told which; what follows may be laid out in any way."""
    body = version.to_bytes(2, "little") + rest
    data = forged(kind.TYPE, 0, len(body), 0, body)
    found = unpack(data, sender=kind.SENDER, channel=kind.CHANNEL)
    assert found.record == OtherVersion(kind.TYPE, version)


def test_a_version_cut_short_is_malformed():
    with pytest.raises(RecordError, match="Open ends inside protocol_version"):
        unpack(forged(Open.TYPE, 0, 1, 0, b"\x03"))


def test_the_agreed_timing_is_read_in_the_units_of_each_name():
    timing = Timing(20, 150, 120, 2500, 505, 250, 10_250, 25)
    assert (timing.heartbeat_s, timing.timeout_s, timing.start_lifetime_s) == (0.02, 0.15, 2.5)
    assert (timing.start_tolerance_mm, timing.start_tolerance_deg) == (0.505, 0.25)
    assert timing.approach_clearance_mm == 10.25
