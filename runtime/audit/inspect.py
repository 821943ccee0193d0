"""Judging a log: structure, chain, attachments, and whether two ways of reading it agree. Pure over bytes.

A log is OK only if every rule holds. What is missing at the end makes it INCOMPLETE, anything inconsistent
TAMPERED, and a file that is no log of ours UNREADABLE. Without signatures this finds damage and careless changes;
whoever recomputes the whole chain is found by ``replay`` or not at all.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from hashlib import sha256
from io import BytesIO
from typing import Any, Final

from mcap.reader import McapReader, NonSeekingReader, make_reader

from cutgate.runtime.audit.chain import GENESIS, LINKED, advance
from cutgate.runtime.audit.records import Attachment, Close, Open
from cutgate.runtime.audit.scan import Scan, Stored, scan
from cutgate.runtime.audit.writer import ENCODING, METADATA, PROFILE

_SHOWN: Final = 20


class Status(IntEnum):
    """The judgement; its number is the exit code of ``cutgate audit verify``."""

    OK = 0
    INCOMPLETE = 1
    TAMPERED = 2
    UNREADABLE = 3


@dataclass(frozen=True, slots=True)
class Report:
    """What was found.

    Attributes:
        status: the judgement.
        reasons: why it is not OK; the first names the first bad record. Empty if it is OK.
        notes: what was not checked.
        log_id: from record 0; empty if there is none.
        messages: whole messages.
        head: the chain's head over them, hex.
        dropped_bytes: bytes after the last whole record.
    """

    status: Status
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    log_id: str
    messages: int
    head: str
    dropped_bytes: int

    @property
    def headline(self) -> str:
        """The judgement in a few words; no signature is ever claimed."""
        return "OK (unsigned)" if self.status is Status.OK else self.status.name


@dataclass(frozen=True, slots=True)
class Log:
    """A log that has been read: its structure, its parsed records in file order, and the judgement."""

    scan: Scan
    records: tuple[dict[str, Any], ...]
    """Parsed JSON, one per message; empty objects where it could not be parsed."""
    report: Report

    def of(self, topic: str) -> list[dict[str, Any]]:
        """The records of one topic, in file order."""
        pairs = zip(self.scan.messages, self.records, strict=True)
        return [record for message, record in pairs if message.topic == topic]


def verify_log(data: bytes, candump: bytes | None = None) -> Report:
    """Judge a log. Never raises.

    Args:
        data: the MCAP file.
        candump: the file of raw frames beside it, or None if it is not there.
    """
    return read_log(data, candump).report


def read_log(data: bytes, candump: bytes | None = None) -> Log:
    """Read and judge a log. Never raises; arguments as ``verify_log``."""
    found = scan(data)
    records = tuple(_parse(message.link.data) for message in found.messages)
    head = GENESIS
    tampered = list(found.problems)
    linked, head = _chain(found.messages, records)
    content = [*linked, *_content(found, records)]
    unread = "" if content or not found.finished else _two_readings(data, found)
    tampered = [*content, *tampered, *([unread] if unread else [])]
    missing = _missing(found, records)
    damaged, notes = _candump(records, candump)
    tampered += damaged
    if not found.mcap or not _ours(found):
        status, reasons = Status.UNREADABLE, ["this is not an audit log of cutgate", *found.problems]
    elif tampered:
        status, reasons = Status.TAMPERED, tampered
    elif missing:
        status, reasons = Status.INCOMPLETE, missing
    else:
        status, reasons = Status.OK, []
    report = Report(
        status=status,
        reasons=tuple(reasons[:_SHOWN]),
        notes=tuple(notes),
        log_id=_text(records[0], "log_id") if records else "",
        messages=len(records),
        head=head.hex(),
        dropped_bytes=0 if found.torn_at is None else len(data) - found.torn_at,
    )
    return Log(found, tuple(record or {} for record in records), report)


def _ours(found: Scan) -> bool:
    """Whether the header, as far as it is there, is one of ours."""
    return found.header is None or found.header.profile == PROFILE


def _chain(messages: list[Stored], records: tuple[dict[str, Any] | None, ...]) -> tuple[list[str], bytes]:
    """The first record whose place in the chain is wrong, and the head."""
    head = GENESIS
    problems: list[str] = []
    for number, (message, record) in enumerate(zip(messages, records, strict=True)):
        place = f"record {number} ({message.topic})"
        if record is None:
            problems.append(f"{place}: it is not a JSON object")
        elif message.link.sequence != number:
            problems.append(f"{place}: its sequence is {message.link.sequence}")
        elif message.link.encoding != ENCODING:
            problems.append(f"{place}: its encoding is not {ENCODING}")
        elif message.topic.startswith(LINKED) and record.get("prev") != head.hex():
            problems.append(f"{place}: it does not follow from the records before it")
        head = advance(head, message.link)
    return problems[:1], head


def _content(found: Scan, records: tuple[dict[str, Any] | None, ...]) -> Iterator[str]:
    """What the records say of the file and what the file holds, side by side."""
    topics = [message.topic for message in found.messages]
    if topics and topics[0] != Open.TOPIC:
        yield f"record 0 is {topics[0]}, must be {Open.TOPIC}"
    for topic in (Open.TOPIC, Close.TOPIC):
        if topics.count(topic) > 1:
            yield f"{topic} is there {topics.count(topic)} times"
    if Close.TOPIC in topics:
        number = topics.index(Close.TOPIC)
        count = (records[number] or {}).get("message_count")
        if number != len(topics) - 1:
            yield f"record {number + 1} ({topics[number + 1]}) stands after the close record"
        elif count != len(topics):
            yield f"the close record counts {count} messages, the file holds {len(topics)}"
    yield from _attachments(found, records)
    if records and [(entry.name, entry.metadata.get("log_id")) for entry in found.metadata] != [
        (METADATA, (records[0] or {}).get("log_id"))
    ]:
        yield "the file's metadata are not those of record 0"


def _attachments(found: Scan, records: tuple[dict[str, Any] | None, ...]) -> Iterator[str]:
    """Every record of an attachment has its attachment; in a closed file the other way round as well."""
    recorded = [
        tuple((record or {}).get(key) for key in ("name", "media_type", "sha256", "size"))
        for message, record in zip(found.messages, records, strict=True)
        if message.topic == Attachment.TOPIC
    ]
    stored = [
        (entry.name, entry.media_type, sha256(entry.data).hexdigest(), len(entry.data))
        for entry in found.attachments
    ]
    for number, (record, entry) in enumerate(zip(recorded, stored, strict=False)):
        if record != entry:
            yield f"attachment {number} ({entry[0]}) is not what its record says"
    if len(recorded) > len(stored):
        yield f"attachment {recorded[len(stored)][0]} has a record but is not there"
    if found.finished and len(stored) > len(recorded):
        yield f"attachment {stored[len(recorded)][0]} has no record"


def _missing(found: Scan, records: tuple[dict[str, Any] | None, ...]) -> list[str]:
    missing = []
    if not found.finished:
        missing.append(
            f"the file ends early: record {len(records) - 1} is the last whole one"
            if records
            else "the file ends before its first record"
        )
    if not found.messages or found.messages[-1].topic != Close.TOPIC:
        missing.append("there is no close record: the session did not end in order")
    return missing


def _candump(
    records: tuple[dict[str, Any] | None, ...], candump: bytes | None
) -> tuple[list[str], list[str]]:
    """Whether the raw frames are those the close record names; what could not be checked."""
    closed = next((record for record in records[-1:] if record and "candump_sha256" in record), None)
    if closed is None:
        return [], []
    if candump is None:
        return [], ["the file of raw frames is not beside the log: its digest was not checked"]
    if sha256(candump).hexdigest() != closed["candump_sha256"]:
        return ["the file of raw frames beside the log is not the one the close record names"], []
    return [], []


def _two_readings(data: bytes, found: Scan) -> str:
    """Whether the stock reader, linearly and by index, reads what we read."""
    ours = [(message.topic, message.link.sequence, message.link.data) for message in found.messages]
    attached = [(entry.name, entry.data) for entry in found.attachments]
    ways: dict[str, Callable[[], McapReader]] = {
        "linearly": lambda: NonSeekingReader(BytesIO(data), validate_crcs=True),
        "by index": lambda: make_reader(BytesIO(data), validate_crcs=True),
    }
    for way, reader in ways.items():
        try:
            theirs = [
                (channel.topic, message.sequence, message.data)
                for _, channel, message in reader().iter_messages(log_time_order=False)
            ]
            theirs_attached = [(entry.name, entry.data) for entry in reader().iter_attachments()]
        except Exception as error:  # noqa: BLE001 - whatever the reader dislikes, the log is not sound
            return f"read {way}, the file gives an error: {type(error).__name__}"
        if (theirs, theirs_attached) != (ours, attached):
            return f"read {way}, the file gives other records"
    return ""


def _parse(data: bytes) -> dict[str, Any] | None:
    """The JSON object, or None. NaN and infinity are not JSON."""

    def refuse(text: str) -> Any:
        raise ValueError(text)

    try:
        content = json.loads(data, parse_constant=refuse)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _text(record: dict[str, Any] | None, key: str) -> str:
    value = (record or {}).get(key)
    return value if isinstance(value, str) else ""
