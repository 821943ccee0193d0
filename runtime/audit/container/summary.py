"""The summary of a file: exactly the one that its data section gives, with the offsets of its groups.

What is kept of it is a length and a digest for each group: there may be millions of records in one. Who writes a
summary keeps the groups' bytes, up to ``KEPT_MAX`` (``KeptGroup``).
"""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import Any, Final, Generic, TypeVar

from mcap.opcode import Opcode
from mcap.records import Footer, McapRecord, Statistics, SummaryOffset

from cutgate.runtime.audit.container.chunk import Chunk
from cutgate.runtime.audit.container.kinds import encoded
from cutgate.runtime.audit.container.raw import BrokenError, Budget, Raw

SUMMARY: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
"""The groups of the summary, in their order."""
KEPT_MAX: Final = 64 << 20
"""Bytes of each group of a summary that is written; an hour of cutting has 2 MB of it."""
_CRC: Final = 4
"""Bytes of the footer's checksum, which stands at its end and covers all before itself."""

GroupContent = tuple[int, int, bytes]
"""Of a group: opcode, length and SHA-256."""


@dataclass
class Group:
    """Records of one kind that follow each other in the summary."""

    opcode: int
    count: int = 0
    length: int = 0
    digest: Any = field(default_factory=sha256)

    def put(self, record: bytes) -> None:
        """One more record."""
        self.count += 1
        self.length += len(record)
        self.digest.update(record)

    @property
    def content(self) -> GroupContent:
        """What it holds: equal to another's if all records are."""
        return self.opcode, self.length, self.digest.digest()


@dataclass
class KeptGroup(Group):
    """A group whose bytes are kept, to be written."""

    data: bytearray = field(default_factory=bytearray)

    def put(self, record: bytes) -> None:
        """One more record.

        Raises:
            BrokenError: over the bound.
        """
        super().put(record)
        if not self.length <= KEPT_MAX:
            raise BrokenError(f"its summary is larger than that of any session: over {KEPT_MAX} bytes")
        self.data += record


G = TypeVar("G", bound=Group)


class Expected(Generic[G]):
    """The summary that a data section gives, collected while it is read.

    Args:
        kind: what is kept of each group.
    """

    def __init__(self, kind: type[G]) -> None:
        self._groups = {int(opcode): kind(opcode) for opcode in SUMMARY}
        self._messages: dict[int, int] = {}
        self._times: tuple[int, int] | None = None

    def add(self, record: McapRecord) -> None:
        """A record of the summary."""
        content = encoded(record)
        self._groups[content[0]].put(content)

    def take_chunk(self, chunk: Chunk) -> None:
        """What a chunk defines and counts; its index is a record of its own."""
        for record in chunk.defined:
            self.add(record)
        for channel, entries in chunk.entries.items():
            self.count(channel, len(entries))
        self.span(chunk.first, chunk.last)

    def count(self, channel: int, messages: int) -> None:
        """So many messages more on a channel."""
        self._messages[channel] = self._messages.get(channel, 0) + messages

    def span(self, first: int, last: int) -> None:
        """A chunk's first and last time, nanoseconds."""
        before = self._times or (first, last)
        self._times = min(before[0], first), max(before[1], last)

    def close(self) -> list[G]:
        """The data section has ended: the groups that hold anything, statistics included, in their order."""
        first, last = self._times or (0, 0)
        self.add(
            Statistics(
                attachment_count=self._groups[Opcode.ATTACHMENT_INDEX].count,
                channel_count=self._groups[Opcode.CHANNEL].count,
                channel_message_counts=self._messages,
                chunk_count=self._groups[Opcode.CHUNK_INDEX].count,
                message_count=sum(self._messages.values()),
                message_start_time=first,
                message_end_time=last,
                metadata_count=self._groups[Opcode.METADATA_INDEX].count,
                schema_count=self._groups[Opcode.SCHEMA].count,
            )
        )
        return [group for group in self._groups.values() if group.count]


def offsets_of(groups: Iterable[Group], start: int) -> tuple[list[SummaryOffset], int]:
    """The offsets of groups of which each stands where the one before it ends, and where the last one does.

    Args:
        groups: of a summary, in their order.
        start: place of the first.
    """
    offsets, end = [], start
    for group in groups:
        offsets.append(SummaryOffset(group_opcode=group.opcode, group_start=end, group_length=group.length))
        end += group.length
    return offsets, end


def footer_of(start: int, end: int, crc: int) -> Footer:
    """The footer of a summary.

    Args:
        start: place of its first group.
        end: place of its offsets.
        crc: checksum of all of it.
    """
    footer = Footer(summary_start=start, summary_offset_start=end, summary_crc=crc)  # covers not itself
    return replace(footer, summary_crc=zlib.crc32(encoded(footer)[:-_CRC], crc))


class SummaryFound:
    """The summary that stands in a file, record by record."""

    def __init__(self, expected: Expected[Group], start: int, budget: Budget) -> None:
        self._expected = expected
        self._start = start
        self._budget = budget
        self._crc = 0
        self._groups: list[Group] = []
        self._offsets: list[SummaryOffset] = []

    def take(self, raw: Raw, record: McapRecord, whole: bytes) -> None:
        """The next record, ``whole`` with opcode and length.

        Raises:
            BrokenError: no summary has it there.
        """
        self._crc = zlib.crc32(whole, self._crc)
        if isinstance(record, SummaryOffset):
            self._budget.remember(raw.length)
            self._offsets.append(record)
        elif self._offsets:
            raise BrokenError("the summary's offsets are not those of its groups")
        elif self._groups and self._groups[-1].opcode == raw.opcode:
            self._groups[-1].put(whole)
        elif len(self._groups) < len(SUMMARY):
            self._groups.append(Group(raw.opcode))
            self._groups[-1].put(whole)
        else:
            raise BrokenError("the summary is not that of the data section")

    def close(self, footer: Footer, whole: bytes) -> None:
        """The footer, which points at the summary and its offsets.

        Raises:
            BrokenError: the summary, its offsets or the footer are not those of the data section.
        """
        if [group.content for group in self._groups] != [group.content for group in self._expected.close()]:
            raise BrokenError("the summary is not that of the data section")
        offsets, end = offsets_of(self._groups, self._start)
        if self._offsets != offsets:
            raise BrokenError("the summary's offsets are not those of its groups")
        if (footer.summary_start, footer.summary_offset_start) != (self._start, end):
            raise BrokenError("the footer does not point at the summary")
        if footer.summary_crc != zlib.crc32(whole[:-_CRC], self._crc):
            raise BrokenError("the summary's checksum is wrong")
