"""Fields to bytes and back; everything that does not fit is refused."""

import contextlib
from dataclasses import dataclass, is_dataclass, replace
from typing import Annotated, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import wire
from cutgate.protocol.states import Purpose
from cutgate.protocol.wire import (
    I16,
    U8,
    U16,
    Ascii,
    Ascii16,
    Blob,
    Block,
    Channel,
    Choice,
    Codec,
    Enumeration,
    Integer,
    Integers,
    Nested,
    Record,
    RecordError,
    Rest,
    Side,
    digest,
)


@dataclass(frozen=True)
class Inner(Block):
    small: U8

    def check(self) -> None:
        if self.small == 13:
            raise RecordError("Inner.small is 13")


@dataclass(frozen=True)
class Outer(Block):
    number: U16
    turns: I16
    name: Ascii16
    inner: Annotated[Inner, Nested(Inner)]
    tail: Annotated[bytes, Rest(4)]


OUTER = Outer(0x1234, -2, "abc", Inner(7), b"xy")


def test_fields_follow_each_other_little_endian():
    assert OUTER.body() == b"\x34\x12\xfe\xffabc" + bytes(13) + b"\x07xy"
    assert Outer.parse(OUTER.body()) == OUTER


@pytest.mark.parametrize(
    ("codec", "value"),
    [
        (Integer(1), 256),
        (Integer(1), -1),
        (Integer(1), True),
        (Integer(1), 1.0),
        (Integer(2, signed=True), -32769),
        (Integers(2), (1, 2, 3)),
        (Integers(2), [1, 2]),
        (Integers(1), (1 << 63,)),
        (Integers(1), (0.5,)),
        (Blob(2), b"x"),
        (Blob(2), "xy"),
        (Rest(2), b""),
        (Rest(2), b"xyz"),
        (Rest(2), None),
        (Ascii(2), ""),
        (Ascii(2), "abc"),
        (Ascii(2), b"ab"),
        (Ascii(2), "é"),
        (Ascii(2), "\n"),
        (Ascii(2), " a"),
        (Enumeration(Purpose, 1), 1),
        (Choice(("a", "b")), "c"),
        (Nested(Inner), 5),
    ],
)
def test_value_that_does_not_fit_is_refused(codec: Codec, value: object):
    with pytest.raises(RecordError):
        codec.pack(value)


@pytest.mark.parametrize(
    ("codec", "low", "high"),
    [
        (Integer(1), 0, 255),
        (Integer(1, bits=1), 0, 1),
        (Integer(2, bits=9), 0, 511),
        (Integer(4), 0, 2**32 - 1),
        (Integer(1, signed=True), -128, 127),
        (Integer(8, signed=True), -(2**63), 2**63 - 1),
    ],
)
def test_an_integer_is_taken_to_its_bounds_and_not_one_further(codec: Integer, low: int, high: int):
    for value in (low, high):
        assert codec.parse(codec.pack(value)) == value
    for value in (low - 1, high + 1):
        with pytest.raises(RecordError, match=rf"must be in {low}\.\.{high}"):
            codec.pack(value)


NAMED = {
    **{name: int(name[1:]) // 8 for name in ("U8", "U16", "U32", "U64", "I16", "I64")},
    **{name: 8 * int(name[-1]) for name in ("Counts2", "Counts5")},
    **{name: int(name[-2:]) for name in ("Nonce16", "LogId16", "Mac16", "Digest32", "Ascii16")},
    **dict.fromkeys(("Flag", "CauseCode", "StateCode", "PurposeCode", "RefusalCode"), 1),
}


@pytest.mark.parametrize(("name", "size"), NAMED.items())
def test_a_field_takes_as_many_bytes_as_its_name_says(name: str, size: int):
    codec = get_args(getattr(wire, name))[1]
    assert codec.size == size
    if isinstance(codec, Integer):
        assert codec.signed is name.startswith("I")
        assert codec.bounds[1] == 1 or name != "Flag"
    if isinstance(codec, Enumeration):
        assert all(len(codec.pack(code)) == size for code in codec.kind)


@pytest.mark.parametrize(
    "kind", [kind for kind in vars(wire).values() if isinstance(kind, type) and is_dataclass(kind)]
)
def test_what_was_checked_is_not_altered_afterwards(kind):
    assert kind.__dataclass_params__.frozen


def test_a_field_that_does_not_fit_is_refused_as_soon_as_the_block_is_made():
    with pytest.raises(RecordError, match=r"Outer\.number is 65536, must be in 0\.\.65535"):
        replace(OUTER, number=65536)


def test_a_record_needs_a_session_unless_it_says_otherwise():
    assert (Record.OUTSIDE_SESSION, Record.INSIDE_SESSION) == (False, True)


@pytest.mark.parametrize(
    ("codec", "value", "data"),
    [
        (Integer(4), 1, b"\x01\0\0\0"),
        (Rest(2), b"xy", b"xy"),
        (Ascii(2), "a", b"a\0"),
        (Ascii(2), "ab", b"ab"),
        (Choice(("a", "b")), "a", b"\x01"),
        (Integers(1), (-1,), b"\xff" * 8),
        (Blob(2), b"xy", b"xy"),
        (Rest(2), b"x", b"x"),
        (Ascii(4), "a b", b"a b\0"),
        (Enumeration(Purpose, 1), Purpose.START, b"\x02"),
        (Choice(("a", "b")), "b", b"\x02"),
        (Nested(Inner), Inner(7), b"\x07"),
    ],
)
def test_codec_round_trip(codec: Codec, value: object, data: bytes):
    assert codec.pack(value) == data
    assert codec.parse(data) == value
    assert codec.size in (len(data), 0)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"", "ends inside number"),
        (OUTER.body()[:19], "ends inside name"),
        (OUTER.body()[:21], "tail must be 1..4 bytes"),
        (OUTER.body() + b"abc", "tail must be 1..4 bytes"),
        (OUTER.body()[:4] + b"a\0b" + OUTER.body()[7:], "name must be printable"),
        (OUTER.body()[:4] + b"\xff" * 16 + OUTER.body()[20:], "name must be printable"),
        (OUTER.body()[:20] + b"\x0d" + OUTER.body()[21:], "inner Inner.small is 13"),
    ],
)
def test_malformed_body_is_refused_by_name(body: bytes, why: str):
    with pytest.raises(RecordError, match=why):
        Outer.parse(body)


def test_trailing_bytes_are_refused():
    with pytest.raises(RecordError, match="followed by 1 bytes"):
        Inner.parse(b"\x01\x02")


def test_codes_not_listed_are_refused():
    with pytest.raises(RecordError, match="no Purpose"):
        Enumeration(Purpose, 1).parse(b"\x63")
    for code in (b"\0", b"\x03"):
        with pytest.raises(RecordError, match=r"must be in 1\.\.2"):
            Choice(("a", "b")).parse(code)


def test_another_byte_form_of_the_same_value_is_refused():
    @dataclass(frozen=True)
    class Lenient:
        size: int = 1

        def pack(self, value: int) -> bytes:
            return bytes([value])

        def parse(self, data: bytes) -> int:
            return data[0] & 0x7F

    annotations = {"__annotations__": {"field": Annotated[int, Lenient()]}}
    loose = dataclass(frozen=True)(type("Loose", (Block,), annotations))
    assert loose.parse(b"\x01").field == 1
    with pytest.raises(RecordError, match="canonical"):
        loose.parse(b"\x81")


@given(st.binary(max_size=64))
def test_any_bytes_parse_or_are_refused(body: bytes):
    with contextlib.suppress(RecordError):
        assert Outer.parse(body).body() == body


def test_sides_and_channels_keep_their_number():
    assert [int(side) for side in Side] == [int(channel) for channel in Channel] == [0, 1]


def test_sides_are_each_others_peers():
    assert Side.RUNTIME.peer is Side.CONTROLLER
    assert Side.CONTROLLER.peer is Side.RUNTIME


def test_digest_is_sha256():
    assert digest(b"abc").hex() == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
