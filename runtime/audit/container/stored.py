"""What a log's file holds: messages, attachments, and what is wrong with it."""

from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.records import AttachmentIndex, Header, Metadata

from cutgate.runtime.audit.chain import ChainLink, covered_in, follow


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """What a channel and its schema say of each of their messages."""

    topic: str
    encoding: str
    schema_name: str
    schema: bytes
    covered: bytes
    """What chain and tree cover of all this."""


@dataclass(slots=True)
class Stored:
    """One message with what its channel and schema say. Times in nanoseconds."""

    channel: ChannelInfo
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    offset: int
    """Of its data in the file."""

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.channel.topic

    @property
    def link(self) -> ChainLink:
        """What is covered of it, part by part."""
        channel = self.channel
        return ChainLink(
            channel.topic, channel.encoding, channel.schema_name, channel.schema,
            self.log_time, self.publish_time, self.sequence, self.data,
        )  # fmt: skip

    @property
    def covered(self) -> bytes:
        """The bytes that chain and tree cover of it."""
        stamps = (self.log_time, self.publish_time, self.sequence)
        return covered_in(self.channel.covered, *stamps, self.data)

    def advance(self, head: bytes) -> bytes:
        """The chain's head after this message."""
        return follow(head, self.covered)


@dataclass(frozen=True, slots=True)
class StoredAttachment:
    """One attachment: what is said of it, and where its bytes stand."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    size: int
    sha256: str
    offset: int
    """Of its bytes in the file."""
    file: BinaryIO = field(repr=False)

    @property
    def data(self) -> bytes:
        """Its bytes, read from the file."""
        self.file.seek(self.offset)
        return self.file.read(self.size)

    def summary_index(self, offset: int, length: int) -> AttachmentIndex:
        """What the summary holds of it, whose record of this length stands at this offset."""
        return AttachmentIndex(
            offset=offset,
            length=length,
            log_time=self.log_time,
            create_time=self.create_time,
            data_size=self.size,
            name=self.name,
            media_type=self.media_type,
        )


@dataclass
class Scan:
    """What a file holds, as far as it has been read.

    Attributes:
        mcap: it starts as an MCAP file does.
        size: of the file, bytes.
        attachments, metadata: in file order.
        messages: in file order, where ``scan`` has collected them.
        finished: data section, summary and footer are there to the last byte.
        torn_at: offset of the first byte that is not a whole record, if the file ends early.
        zeros: it ends early in nothing but zeros, as a file system leaves it after a loss of power.
        problems: what is inconsistent, each with its place; a sound file has none.
    """

    mcap: bool = True
    size: int = 0
    header: Header | None = None
    attachments: list[StoredAttachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    messages: list[Stored] = field(default_factory=list)
    finished: bool = False
    torn_at: int | None = None
    zeros: bool = False
    problems: list[str] = field(default_factory=list)

    def attachment(self, name: str) -> StoredAttachment | None:
        """The first attachment of this name, or None."""
        return next((entry for entry in self.attachments if entry.name == name), None)
