"""What stands in a folder of logs, and what each log says of itself: what ``series`` is asked about.

    for path in files_of(folder):
        with reading(path) as log:
            sessions.append(session_of(path.name, log))

One log is read at a time, a chunk at a time. What is kept of each is small, whatever the log holds.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import InputError, read_bytes
from cutgate.runtime.audit.container.raw import MAGIC, PIECE, ZEROS_MAX
from cutgate.runtime.audit.directory import HEAD, HEAD_MAX, Head
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import (
    NANOSECONDS,
    AuditCheckpoint,
    AuditClose,
    AuditOpen,
    AuditPermit,
    AuditWitness,
)
from cutgate.runtime.audit.recovered import told_by
from cutgate.runtime.audit.series_facts import (
    SESSIONS_MAX,
    FolderSession,
    HeadNamed,
    PreviousNamed,
    WitnessNamed,
)
from cutgate.runtime.audit.series_rules import SeriesFinding

LOG_SUFFIX: Final = ".mcap"
STUB_SUFFIX: Final = ".archived"
"""Of what is left of a session that was archived."""
TREES_MAX: Final = 256
"""Starts of one session whose trees are kept."""
WITNESSES_MAX: Final = 16
"""What one session was told by controllers; it is told once."""
TEXT_MAX: Final = 300
"""Characters of what a record says in words."""
_TIME_MAX: Final = 1 << 63


def files_of(folder: Path) -> tuple[Path, ...]:
    """Logs and stubs of a folder, by name; whatever else stands there is passed over.

    Raises:
        InputError: it cannot be read, or holds more of them than any folder of sessions.
    """
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith((LOG_SUFFIX, STUB_SUFFIX)) and entry.is_file():
                    found.append(entry.name)
                if len(found) > SESSIONS_MAX:
                    bound = f"at most {SESSIONS_MAX} logs and stubs of logs in one folder"
                    remedy = "part them into several folders, by their names, which begin with the time"
                    raise InputError(folder, "logs", f"over {SESSIONS_MAX}", bound, remedy)
    except OSError as error:
        raise InputError(
            folder, "", None, f"cannot be read ({error.strerror})", "name a folder of logs"
        ) from None
    return tuple(folder / name for name in sorted(found))


def head_in(folder: Path) -> tuple[HeadNamed | None, tuple[SeriesFinding, ...]]:
    """What HEAD says; None where there is none, and a finding where it cannot be read."""
    path = folder / HEAD
    if not os.path.lexists(path):
        return None, ()
    try:
        head = Head.parse(read_bytes(path, HEAD_MAX, "it is no HEAD; restore it from a backup"))
    except InputError as error:
        return None, (SeriesFinding("head-unreadable", HEAD, "the file", "", error.problems[0].bound),)
    except ValueError as error:
        return None, (
            SeriesFinding("head-unreadable", HEAD, "the file", str(error), "what a session writes"),
        )
    series = None if head.series is None else head.series.hex()
    return HeadNamed(head.log, head.closed, head.head, series, head.epoch, head.size, head.root), ()


def session_of(file: str, log: Log, anchors: Iterable[str] = ()) -> FolderSession:
    """What a log says of itself, whatever it holds.

    Args:
        file: its name.
        log: as read.
        anchors: roots and heads, in hex, that are looked for in it.
    """
    report = log.report
    opened = next(log.one_by_one(AuditOpen.TOPIC), {})
    trees, starts = _trees(log)
    return FolderSession(
        file=file,
        log_id=report.log_id[:TEXT_MAX],
        status=Status.INCOMPLETE if not_begun(log) else report.status,
        closed=log.scan.finished and any(topic == AuditClose.TOPIC for topic, _, _ in log.places),
        size=report.messages,
        root=report.root,
        head=report.head,
        key=report.key,
        signed=report.signed,
        trees=trees,
        anchors=frozenset(_anchored(log, set(anchors))),
        starts=starts,
        witnesses=tuple(_witnesses(log)),
        recovered_from=_recovered(log),
        last_ns=_last_ns(log),
        **_of_record_0(opened),
    )


def not_begun(log: Log) -> bool:
    """Whether a file is what a session leaves that is cut short before its first bytes: empty, the first of them, or zeros."""
    if log.scan.mcap or log.scan.size > ZEROS_MAX:
        return False
    log.file.seek(0)
    pieces = iter(lambda: log.file.read(PIECE), b"")
    first = next(pieces, b"")
    return (len(first) < len(MAGIC) and MAGIC.startswith(first)) or not (any(first) or any(map(any, pieces)))


def of_stub(file: str, opened: dict[str, Any], **rest: Any) -> FolderSession:
    """What is left of an archived log: its record 0, and what its stub says of the rest."""
    return FolderSession(file=file, archived=True, **_of_record_0(opened), **rest)


def unread(file: str) -> FolderSession:
    """A file of which nothing is known."""
    return FolderSession(
        file, "", Status.UNREADABLE, closed=False, size=0, root=None, head="", opened_ns=0, last_ns=0
    )


def _of_record_0(opened: dict[str, Any]) -> dict[str, Any]:
    previous = PreviousNamed(
        log=text(opened, "previous_log"),
        head=text(opened, "previous_head"),
        size=count(opened, "previous_size"),
        root=text(opened, "previous_root"),
        epoch=count(opened, "previous_epoch"),
        crashed=opened.get("previous_crashed") is True,
        note=text(opened, "previous_note"),
    )
    time_ns = nanoseconds(opened.get("utc"))
    return {"opened_ns": time_ns, "enrolled": text(opened, "enrolled"), "previous": previous}


def _trees(log: Log) -> tuple[frozenset[tuple[int, str]], bool]:
    """The trees that starts name, be it that only the record which authorised them is left; and whether there are any."""
    found: set[tuple[int, str]] = set()
    starts = waiting = False
    for topic, data in log.each(AuditPermit.TOPIC, AuditCheckpoint.TOPIC):
        record = parse_object(data) or {}
        if topic == AuditPermit.TOPIC and record.get("kind") == "start":
            waiting = waiting or record.get("stage") == "authorised"
            starts = starts or waiting
            tree = count(record, "log_size"), text(record, "log_root")
        elif topic == AuditCheckpoint.TOPIC and waiting:
            waiting, tree = False, (count(record, "size"), text(record, "root"))
        else:
            continue
        if tree[0] is not None and tree[1] is not None and len(found) < TREES_MAX:
            found.add((tree[0], tree[1]))
    return frozenset(found), starts


def _anchored(log: Log, anchors: set[str]) -> Iterator[str]:
    """Roots that a checkpoint signs, and heads between records, that somebody asks for."""
    for _, data in log.each(*{topic for topic, _, _ in log.places}) if anchors else ():
        record = parse_object(data) or {}
        for value in (record.get("prev"), record.get("root")):
            if isinstance(value, str) and value in anchors:
                yield value


def _witnesses(log: Log) -> Iterator[WitnessNamed]:
    for number, record in enumerate(log.one_by_one(AuditWitness.TOPIC)):
        log_id, size, root = text(record, "log_id"), count(record, "log_size"), text(record, "log_root")
        if number < WITNESSES_MAX and log_id and size is not None and root is not None:
            yield WitnessNamed(log_id, size, root, found=record.get("found") is True)


def _recovered(log: Log) -> str | None:
    """Of which log it is a recovered copy."""
    try:
        told = told_by(log.scan.metadata)
    except ValueError:  # no recovery writes this: it is judged by its own
        return None
    return None if told is None else told.original[:TEXT_MAX]


def _last_ns(log: Log) -> int:
    """UTC of the last record that has a time."""
    for _, offset, size in reversed(log.places):
        log.file.seek(offset)
        record = parse_object(log.file.read(size)) or {}
        if "utc" in record:
            return nanoseconds(record["utc"])
    return 0


def text(record: Mapping[str, Any], key: str) -> str | None:
    """A text, no longer than any that a session writes; else None."""
    value = record.get(key)
    return value[:TEXT_MAX] if isinstance(value, str) else None


def count(record: Mapping[str, Any], key: str) -> int | None:
    """A number of things; else None."""
    value = record.get(key)
    return (
        value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _TIME_MAX else None
    )


def nanoseconds(time: object) -> int:
    """A stored time; 0 where it is none."""
    if isinstance(time, dict):
        seconds, rest = count(time, "sec"), count(time, "nsec")
        if seconds is not None and rest is not None and seconds * NANOSECONDS + rest < _TIME_MAX:
            return seconds * NANOSECONDS + rest
    return 0
