"""A log cut in many places, and what is whole in what is left: read from the bytes, without the code under test."""

import random
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.recovered import Recovered
from cutgate.runtime.audit.recovery import copied, refused, what_is_told
from tests.runtime.audit.build import LOG_ID, OPENED, PATIENCE_S, Ticking, enable

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
SEEDED = 500
SEED = 20_261_128
ZEROS = 4096
"""A page, as a file system leaves it behind what had reached the disk."""
TOLD = ("cut.mcap", "ab" * 32, "cutgate test")


class Raw(NamedTuple):
    """A record of the file and where it stands."""

    opcode: int
    begin: int
    end: int


class Said(NamedTuple):
    """All of a message that readers of a file see of it."""

    topic: str
    schema: bytes
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


class Attached(NamedTuple):
    """All of an attachment."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    data: bytes


@dataclass(frozen=True)
class Whole:
    """A finished log, and what is whole in what damage has left of it."""

    data: bytes

    @cached_property
    def records(self) -> list[Raw]:
        found, at = [], len(MAGIC)
        while at < len(self.data) - len(MAGIC):
            opcode, size = HEAD.unpack_from(self.data, at)
            found.append(Raw(opcode, at, at + HEAD.size + size))
            at = found[-1].end
        return found

    def content(self, raw: Raw) -> ReadDataStream:
        return ReadDataStream(BytesIO(self.data[raw.begin + HEAD.size : raw.end]))

    @cached_property
    def messages(self) -> list[tuple[Raw, list[Said]]]:
        """Of each chunk."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        found: list[tuple[Raw, list[Said]]] = []
        for raw in self.records:
            if raw.opcode != Opcode.CHUNK:
                continue
            found.append((raw, []))
            for part in breakup_chunk(Chunk.read(self.content(raw)), validate_crc=True):
                if isinstance(part, Schema):
                    schemas[part.id] = part
                elif isinstance(part, Channel):
                    channels[part.id] = part
                else:
                    found[-1][1].append(said(schemas[channels[part.channel_id].schema_id], channels, part))
        return found

    @cached_property
    def attachments(self) -> list[tuple[Raw, Attached]]:
        return [
            (raw, attached(Attachment.read(self.content(raw))))
            for raw in self.records
            if raw.opcode == Opcode.ATTACHMENT
        ]

    @cached_property
    def closed_at(self) -> int:
        """Where the chunk of the close record ends."""
        return self.messages[-1][0].end

    def kept(self, left: bytes) -> tuple[list[Said], list[Attached]]:
        """What is whole in what was left: in each chunk and attachment that stands there to its last byte."""

        def there(raw: Raw) -> bool:
            return left[raw.begin : raw.end] == self.data[raw.begin : raw.end]

        return (
            [one for raw, several in self.messages if there(raw) for one in several],
            [one for raw, one in self.attachments if there(raw)],
        )

    def boundaries(self) -> list[int]:
        """Where records begin and end, and a byte to either side."""
        places = {place for raw in self.records for place in (raw.begin, raw.end)}
        near = {place + off for place in places for off in (-1, 0, 1)}
        return sorted(place for place in near if 0 <= place < len(self.data))

    def seeded(self) -> list[int]:
        """Places within records, each record as often as any other: on every machine within the same ones."""
        draw = random.Random(SEED)
        found = []
        for _ in range(SEEDED):
            raw = draw.choice(self.records)
            found.append(raw.begin + 1 + int(draw.random() * (raw.end - raw.begin - 1)))
        return found

    def at(self, cut: int) -> Raw | None:
        """The record that a cut goes through or ends before; None at the file's first and last bytes."""
        number = bisect_right([raw.begin for raw in self.records], cut) - 1
        return self.records[number] if number >= 0 and cut < self.records[-1].end else None


def said(schema: Schema, channels: dict[int, Channel], message: Message) -> Said:
    topic = channels[message.channel_id].topic
    return Said(topic, schema.data, message.log_time, message.publish_time, message.sequence, message.data)


def attached(entry: Attachment) -> Attached:
    return Attached(entry.name, entry.media_type, entry.log_time, entry.create_time, entry.data)


def smallest_log_with_a_start(directory: Path) -> bytes:
    """Opened, permitted, started, closed: 21 kB, most of them schemas."""
    log = AuditLog.create(directory, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock())
    enable(log, "permit", "start")
    return log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).log.read_bytes()


def recovered(left: bytes) -> tuple[bytes, Recovered, Log] | str:
    """The copy of what was left, what it says of itself, and what was left as it was read; or why there is none."""
    log = read_log(left)
    why = refused(log)
    if why is not None:
        return why[0]
    told = what_is_told(log, *TOLD)
    return b"".join(copied(log, told)), told, log


def by_index(copy: bytes) -> tuple[list[Said], list[Attached], list[tuple[str, dict[str, str]]]]:
    """What the indexed reader of the mcap library finds by the summary, in the order of the file."""
    reader = make_reader(BytesIO(copy), validate_crcs=True)
    messages = [
        Said(
            channel.topic, schema.data, message.log_time, message.publish_time, message.sequence, message.data
        )
        for schema, channel, message in reader.iter_messages(log_time_order=False)
        if schema is not None
    ]
    attachments = [attached(entry) for entry in reader.iter_attachments()]
    return messages, attachments, [(entry.name, entry.metadata) for entry in reader.iter_metadata()]


Damage = Callable[[bytes, int], bytes]


def cut_off(data: bytes, cut: int) -> bytes:
    return data[:cut]


def zeros_behind(data: bytes, cut: int) -> bytes:
    return data[:cut] + bytes(ZEROS)


def each(whole: Whole, cuts: list[int], damage: Damage) -> Iterator[tuple[int, bytes]]:
    for cut in cuts:
        yield cut, damage(whole.data, cut)
