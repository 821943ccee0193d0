"""How one field of a record becomes bytes: fixed layouts, little endian, every value checked both ways.

A record is a frozen dataclass whose fields are annotated with their codec (`U16`, `Digest`, ...). Building a
record checks every field, so a record in memory can always be sent, and `parse(body())` gives it back.
"""

import hashlib
import struct
from dataclasses import dataclass, fields
from enum import IntEnum, unique
from typing import Annotated, Any, ClassVar, Protocol, Self, get_type_hints

from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause


class RecordError(ValueError):
    """A record that cannot be sent or must not be believed; the message says which field and why."""


@unique
class Side(IntEnum):
    """The two ends of the wire."""

    RUNTIME = 0
    CONTROLLER = 1

    @property
    def peer(self) -> "Side":
        """The other end."""
        return Side.CONTROLLER if self is Side.RUNTIME else Side.RUNTIME


@unique
class Channel(IntEnum):
    """The two ISO-TP channels: a start never queues behind an upload."""

    CONTROL = 0
    BULK = 1


class Codec(Protocol):
    """Turns a value into `size` bytes and back; raises RecordError for anything else."""

    @property
    def size(self) -> int:
        """Bytes taken; 0 for a field that takes the rest of the record."""

    def pack(self, value: Any) -> bytes:
        """The value's bytes."""

    def parse(self, data: bytes) -> Any:
        """The value of these bytes."""


@dataclass(frozen=True)
class Integer:
    """A little-endian integer of `size` bytes, of which the lowest `bits` are used; all of them if 0."""

    size: int
    signed: bool = False
    bits: int = 0

    @property
    def bounds(self) -> tuple[int, int]:
        """Least and greatest value, both inside."""
        bits = self.bits or 8 * self.size
        return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if self.signed else (0, (1 << bits) - 1)

    def pack(self, value: Any) -> bytes:
        """Refuses what is not an integer or does not fit."""
        low, high = self.bounds
        if not isinstance(value, int) or isinstance(value, bool):
            raise RecordError(f"must be an integer, is {value!r}")
        if not low <= value <= high:
            raise RecordError(f"is {int(value)}, must be in {low}..{high}")
        return int(value).to_bytes(self.size, "little", signed=self.signed)

    def parse(self, data: bytes) -> int:
        """Every bit pattern is an integer; one that is out of bounds, the record refuses."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True)
class Integers:
    """A fixed number of signed 64-bit counts."""

    count: int

    @property
    def size(self) -> int:
        """Eight bytes a count."""
        return 8 * self.count

    def pack(self, value: Any) -> bytes:
        """Refuses another number of counts, and counts that do not fit."""
        if not isinstance(value, tuple) or len(value) != self.count:
            raise RecordError(f"must be a tuple of {self.count} integers, is {value!r}")
        item = Integer(8, signed=True)
        return b"".join(item.pack(count) for count in value)

    def parse(self, data: bytes) -> tuple[int, ...]:
        """Every bit pattern is a tuple of counts."""
        return struct.unpack(f"<{self.count}q", data)


@dataclass(frozen=True)
class Blob:
    """Bytes of a fixed length: nonces, digests, codes."""

    size: int

    def pack(self, value: Any) -> bytes:
        """Refuses another length."""
        if not isinstance(value, bytes) or len(value) != self.size:
            raise RecordError(f"must be {self.size} bytes, is {value!r}")
        return value

    def parse(self, data: bytes) -> bytes:
        """As they stand."""
        return bytes(data)


@dataclass(frozen=True)
class Rest:
    """All remaining bytes, at least one, at most `most`; only as the last field."""

    most: int
    size: int = 0

    def pack(self, value: Any) -> bytes:
        """Refuses nothing and too much."""
        if not isinstance(value, bytes) or not 1 <= len(value) <= self.most:
            raise RecordError(f"must be 1..{self.most} bytes")
        return value

    def parse(self, data: bytes) -> bytes:
        """As they stand."""
        return bytes(data)


@dataclass(frozen=True)
class Ascii:
    """Printable ASCII without blanks at the ends, filled with NUL to `size`."""

    size: int

    def pack(self, value: Any) -> bytes:
        """Refuses empty, long and non-printing text."""
        if not isinstance(value, str) or not 1 <= len(value) <= self.size:
            raise RecordError(f"must be 1..{self.size} characters, is {value!r}")
        if not value.isascii() or not value.isprintable() or value != value.strip():
            raise RecordError(f"must be printable ASCII without blanks at the ends, is {value!r}")
        return value.encode("ascii").ljust(self.size, b"\0")

    def parse(self, data: bytes) -> str:
        """Non-ASCII bytes become characters that `pack` refuses."""
        return data.rstrip(b"\0").decode("latin-1")


@dataclass(frozen=True)
class Enumeration:
    """A member of an enumeration, `size` bytes."""

    kind: type[IntEnum]
    size: int

    def pack(self, value: Any) -> bytes:
        """Refuses what is not a member."""
        if not isinstance(value, self.kind):
            raise RecordError(f"must be a {self.kind.__name__}, is {value!r}")
        return Integer(self.size).pack(value)

    def parse(self, data: bytes) -> IntEnum:
        """Refuses a code that is not listed."""
        code = int.from_bytes(data, "little")
        try:
            return self.kind(code)
        except ValueError:
            raise RecordError(f"is {code:#x}, which is no {self.kind.__name__}") from None


@dataclass(frozen=True)
class Choice:
    """One of a few words, sent as 1, 2, ...; 0 is never valid."""

    words: tuple[str, ...]
    size: int = 1

    def pack(self, value: Any) -> bytes:
        """Refuses another word."""
        if value not in self.words:
            raise RecordError(f"must be one of {', '.join(self.words)}, is {value!r}")
        return bytes([self.words.index(value) + 1])

    def parse(self, data: bytes) -> str:
        """Refuses another number."""
        if not 1 <= data[0] <= len(self.words):
            raise RecordError(f"is {data[0]}, must be in 1..{len(self.words)}")
        return self.words[data[0] - 1]


U8 = Annotated[int, Integer(1)]
U16 = Annotated[int, Integer(2)]
U32 = Annotated[int, Integer(4)]
I16 = Annotated[int, Integer(2, signed=True)]
U64 = Annotated[int, Integer(8)]
I64 = Annotated[int, Integer(8, signed=True)]
Flag = Annotated[int, Integer(1, bits=1)]
Counts2 = Annotated[tuple[int, ...], Integers(2)]
Counts5 = Annotated[tuple[int, ...], Integers(5)]
Nonce16 = Annotated[bytes, Blob(16)]
LogId16 = Annotated[bytes, Blob(16)]
Mac16 = Annotated[bytes, Blob(16)]
Digest32 = Annotated[bytes, Blob(32)]
Ascii16 = Annotated[str, Ascii(16)]
CauseCode = Annotated[StopCause, Enumeration(StopCause, 1)]
StateCode = Annotated[ControllerState, Enumeration(ControllerState, 1)]
PurposeCode = Annotated[Purpose, Enumeration(Purpose, 1)]
RefusalCode = Annotated[Refusal, Enumeration(Refusal, 1)]


_LAYOUTS: dict[type, tuple[tuple[str, Codec], ...]] = {}


def layout(kind: "type[Block]") -> tuple[tuple[str, Codec], ...]:
    """Names and codecs of a record's fields, in the order in which they are sent."""
    if kind not in _LAYOUTS:
        hints = get_type_hints(kind, include_extras=True)
        _LAYOUTS[kind] = tuple((field.name, hints[field.name].__metadata__[0]) for field in fields(kind))
    return _LAYOUTS[kind]


@dataclass(frozen=True)
class Block:
    """Fields with a fixed layout; the base of records and of what is nested in them."""

    def __post_init__(self) -> None:
        self.body()
        self.check()

    def check(self) -> None:
        """Raise RecordError for fields that fit one by one but not together."""

    def body(self) -> bytes:
        """The canonical bytes: what is sent and what digests are taken of."""
        parts = []
        for name, codec in layout(type(self)):
            try:
                parts.append(codec.pack(getattr(self, name)))
            except RecordError as error:
                raise RecordError(f"{type(self).__name__}.{name} {error}") from None
        return b"".join(parts)

    @classmethod
    def parse(cls, body: bytes) -> Self:
        """The record of these bytes; raises RecordError unless it is well formed to the last byte."""
        values: dict[str, Any] = {}
        at = 0
        for name, codec in layout(cls):
            end = at + codec.size if codec.size else max(at, len(body))
            if end > len(body):
                raise RecordError(f"{cls.__name__} ends inside {name}: {len(body)} bytes")
            try:
                values[name] = codec.parse(body[at:end])
            except RecordError as error:
                raise RecordError(f"{cls.__name__}.{name} {error}") from None
            at = end
        if at != len(body):
            raise RecordError(f"{cls.__name__} is followed by {len(body) - at} bytes")
        record = cls(**values)
        if record.body() != body:
            raise RecordError(f"{cls.__name__} is not in its canonical form")
        return record


@dataclass(frozen=True)
class Nested:
    """A block inside a record."""

    kind: type[Block]

    @property
    def size(self) -> int:
        """The sum of its fields."""
        return sum(codec.size for _, codec in layout(self.kind))

    def pack(self, value: Any) -> bytes:
        """Refuses another kind."""
        if not isinstance(value, self.kind):
            raise RecordError(f"must be a {self.kind.__name__}, is {value!r}")
        return value.body()

    def parse(self, data: bytes) -> Block:
        """As the block parses itself."""
        return self.kind.parse(data)


@dataclass(frozen=True)
class Record(Block):
    """What is sent in one envelope: a type, a sender, a channel, and fields."""

    TYPE: ClassVar[int]
    SENDER: ClassVar[Side]
    CHANNEL: ClassVar[Channel]
    OUTSIDE_SESSION: ClassVar[bool] = False
    """Sent with session 0."""
    INSIDE_SESSION: ClassVar[bool] = True
    """Sent with the session's tag."""


def digest(body: bytes) -> bytes:
    """SHA-256 of canonical bytes, 32 bytes."""
    return hashlib.sha256(body).digest()
