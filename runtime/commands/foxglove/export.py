"""``cutgate audit export --to foxglove``: a log as a second MCAP file, which viewers of the Foxglove family draw."""

from typing import Final

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from cutgate import __version__
from cutgate.config.screen import printable
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.commands.foxglove.known import known_of
from cutgate.runtime.commands.foxglove.lichtblick import LAYOUT, layout_bytes
from cutgate.runtime.commands.foxglove.schemas import VIEWED, viewed_json, viewed_schema
from cutgate.runtime.commands.foxglove.streams import Streams
from cutgate.runtime.commands.sinks import Sink

PROFILE: Final = ""
"""None: what is in it is said by its schemas."""
METADATA: Final = "cutgate.export"


def write_foxglove(log: Log, name: str, sink: Sink) -> str:
    """Write the file; what was written, and what is not in it.

    Args:
        log: the log as read.
        name: its file's.
        sink: takes the bytes.
    """
    known, verdicts, notes = known_of(log, name)
    streams = Streams(known, verdicts)
    out = _McapOut(sink, log, name)
    for message in walk(log.file, Scan()):
        for topic, viewed in streams.take(message):
            out.add(topic, message.log_time, viewed_json(viewed))
    out.finish()
    if streams.strange:
        notes.append(f"{streams.strange} records that are none left out")
    return f"{'; '.join([f'{out.count} messages of {out.topics} topics', *map(printable, notes)])}"


class _McapOut:
    """The file as it is written; a chunk of it is kept, and what its summary will say."""

    def __init__(self, sink: Sink, log: Log, name: str) -> None:
        self.count = 0
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._mcap = Writer(sink, compression=CompressionType.ZSTD, enable_data_crcs=True)  # type: ignore[arg-type]
        self._mcap.start(PROFILE, f"cutgate {__version__}")
        told = {
            "log": printable(name),
            "log_id": printable(log.report.log_id),
            "judgement": log.report.headline,
        }
        self._mcap.add_metadata(METADATA, {**told, "head": log.report.head, "root": log.report.root})
        # Some viewers show nothing of a file without attachments.
        self._mcap.add_attachment(
            create_time=0, log_time=0, name=LAYOUT, media_type="application/json", data=layout_bytes()
        )

    @property
    def topics(self) -> int:
        """How many there are messages of."""
        return len(self._channels)

    def add(self, topic: str, time_ns: int, data: bytes) -> None:
        """A message at a time of the log."""
        self._mcap.add_message(
            channel_id=self._channel(topic),
            log_time=time_ns,
            publish_time=time_ns,
            sequence=self.count,
            data=data,
        )
        self.count += 1

    def finish(self) -> None:
        """Summary and footer."""
        self._mcap.finish()  # type: ignore[no-untyped-call]

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            name, schema = viewed_schema(VIEWED[topic])
            if name not in self._schemas:
                self._schemas[name] = self._mcap.register_schema(name, SchemaEncoding.JSONSchema, schema)
            self._channels[topic] = self._mcap.register_channel(
                topic, MessageEncoding.JSON, self._schemas[name]
            )
        return self._channels[topic]
