"""The MCAP writer, in memory: records go in, the new bytes of the file come out.

Chunks are not compressed: what is stored is what the chain covers, a decision closes its chunk at once and small
chunks do not compress, and recovery needs nothing but the bytes.

What is signed stands in the file as it grows. Every chunk ends in a checkpoint of all records before it, but the first,
which is record 0 alone, and the last of a closed log, which is the close record alone: the sidecar signs that. So
whatever chunk a crash leaves as the last whole one, what stands before its checkpoint is signed.
"""

from typing import Final

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, CompressionType
from mcap.writer import Writer as McapWriter

from cutgate.runtime.audit.chain import GENESIS, covered_in, follow, of_channel
from cutgate.runtime.audit.records import (
    AuditCheckpoint,
    AuditRecord,
    LogRecord,
    Time,
    title_of,
)
from cutgate.runtime.audit.schema import schema_bytes
from cutgate.runtime.audit.signing.signer import Signer
from cutgate.runtime.audit.tree import Tree

PROFILE: Final = "cutgate.audit/1"
METADATA: Final = "cutgate"
CHUNK_BYTES: Final = 1 << 20
"""A chunk with so much in it is closed."""
_NEVER: Final = 1 << 62
"""The library is to close none: it knows no checkpoint."""
ENCODING: Final[str] = MessageEncoding.JSON
SCHEMA_ENCODING: Final[str] = SchemaEncoding.JSONSchema


class _Buffer:
    """What the MCAP writer writes to: counts all bytes, keeps those not yet taken."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._end = 0

    def write(self, data: bytes) -> int:
        self._parts.append(bytes(data))
        self._end += len(data)
        return len(data)

    def tell(self) -> int:
        return self._end

    def flush(self) -> None:
        """Nothing is kept back."""

    def take(self) -> bytes:
        data = b"".join(self._parts)
        self._parts.clear()
        return data


class LogWriter:
    """One log file, in memory. Pure apart from that: no clock, no disk.

    Args:
        log_id: names the log; hex.
        metadata: what the file says of itself beside it.
        signer: signs its checkpoints; without one there are none, as before logs were signed.

    Attributes:
        head: the chain's head over all messages so far, 32 bytes.
        tree: the tree of all messages so far.
        unwritten: messages that stand in the open chunk.
    """

    def __init__(self, log_id: str, metadata: dict[str, str], signer: Signer | None = None) -> None:
        self.head = GENESIS
        self.tree = Tree()
        self.unwritten = 0
        self._signer = signer
        self._signed = (0, self.tree.root)
        self._stamps = (0, 0)
        self._chunk_bytes = 0
        self._buffer = _Buffer()
        self._channels: dict[str, tuple[int, bytes]] = {}
        """Of each topic: its channel's number in the file, and what is covered of the channel."""
        self._mcap = McapWriter(
            self._buffer,  # type: ignore[arg-type]  # write, tell and flush are all it uses
            chunk_size=_NEVER,
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        self._mcap.start(PROFILE, LIBRARY_IDENTIFIER)
        self._mcap.add_metadata(METADATA, {"log_id": log_id, **metadata})

    @property
    def count(self) -> int:
        """Messages so far; the next message's sequence."""
        return self.tree.size

    def add(self, record: LogRecord, *, log_time_ns: int, monotonic_ns: int) -> None:
        """Add a message to the open chunk; an ``/audit/`` record gets its link and its times here.

        Args:
            record: any of ``records.MODELS``.
            log_time_ns: UTC, nanoseconds since 1970.
            monotonic_ns: the session's monotonic clock.

        Raises:
            ValueError: a number is not finite.
        """
        if isinstance(record, AuditRecord):
            stamped = {
                "prev": self.head.hex(),
                "utc": Time.of(log_time_ns),
                "monotonic": Time.of(monotonic_ns),
            }
            record = record.model_copy(update=stamped)
        data = record.encode()
        model = type(record)
        number, channel = self._channel(model)
        self._mcap.add_message(
            channel_id=number,
            log_time=log_time_ns,
            publish_time=log_time_ns,
            sequence=self.count,
            data=data,
        )
        body = covered_in(channel, log_time_ns, log_time_ns, self.count, data)
        self.head = follow(self.head, body)
        self.tree.append(body)
        self.unwritten += 1
        self._stamps = (log_time_ns, monotonic_ns)
        self._chunk_bytes += len(data)
        if self._chunk_bytes >= CHUNK_BYTES and model is not AuditCheckpoint:
            self.close_chunk()

    def attach(self, name: str, media_type: str, data: bytes, *, log_time_ns: int) -> None:
        """Add an attachment; it stands before the open chunk in the file."""
        self._mcap.add_attachment(
            create_time=log_time_ns, log_time=log_time_ns, name=name, media_type=media_type, data=data
        )

    def checkpoint(self) -> None:
        """Sign all messages so far, in a message of their last one's times."""
        if self._signer is None:
            return
        size, root = self.tree.size, self.tree.root
        note = self._signer.checkpoint(size, root)
        log_time_ns, monotonic_ns = self._stamps
        record = AuditCheckpoint(size=size, root=root.hex(), note=note)
        self.add(record, log_time_ns=log_time_ns, monotonic_ns=monotonic_ns)
        self._signed = (size, root)

    @property
    def signed(self) -> tuple[int, bytes]:
        """Size and root of the tree at the last checkpoint; of the whole tree where there is no signer."""
        return (self.tree.size, self.tree.root) if self._signer is None else self._signed

    def close_chunk(self, *, signed: bool = True) -> None:
        """End the open chunk, if it holds anything, with a checkpoint unless told otherwise, and give out its bytes."""
        if self.unwritten and signed:
            self.checkpoint()
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self.unwritten = self._chunk_bytes = 0

    def finish(self) -> None:
        """End the file: last chunk, summary, footer. Nothing can be added any more."""
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self.unwritten = 0

    def take(self) -> bytes:
        """The bytes that have come to stand in the file since the last call."""
        return self._buffer.take()

    def _channel(self, model: type[LogRecord]) -> tuple[int, bytes]:
        topic = model.TOPIC
        if topic not in self._channels:
            name, schema = schema_name(model), schema_bytes(model)
            registered = self._mcap.register_schema(name, SCHEMA_ENCODING, schema)
            number = self._mcap.register_channel(topic, ENCODING, registered)
            self._channels[topic] = number, of_channel(topic, ENCODING, name, schema)
        return self._channels[topic]


def schema_name(model: type[LogRecord]) -> str:
    """The schema's name in the file."""
    return f"cutgate.{title_of(model)}"
