"""``cutgate audit export``: a log's records and frames for other programs."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final, NoReturn

import can
import typer

from cutgate.config.load import InputError, open_input
from cutgate.config.screen import printable
from cutgate.runtime.audit.container.raw import PIECE
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.commands.foxglove.export import write_foxglove
from cutgate.runtime.commands.foxglove.lichtblick import layout_bytes
from cutgate.runtime.commands.screen import echo, working
from cutgate.runtime.commands.sinks import OPTION, Sink, TextSink, new_file, new_folder, standard_output
from cutgate.runtime.review.exported import (
    COLUMNS_MAX,
    NANOSECONDS,
    can_message,
    header_line,
    json_line,
    row_line,
    row_of,
    table_name,
)
from cutgate.runtime.review.recorded_frames import SessionFrames

TABLES_MAX: Final = 40
"""Topics that are written at the same time, a file each."""
STANDARD: Final = "-"
LAYOUT_OPTION: Final = "--layout"
_BLF_FIRST_S: Final = 631152000
"""1990: python-can writes no earlier time of a file's start, and so must not count from one."""


class Form(StrEnum):
    """What a log is exported to."""

    JSONL = "jsonl"
    CSV = "csv"
    CANDUMP = "candump"
    BLF = "blf"
    ASC = "asc"
    FOXGLOVE = "foxglove"


RECORDS: Final = (Form.JSONL, Form.CSV)
"""Forms of records; those of frames are the others but foxglove."""


def export(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap).")],
    *,
    to: Annotated[Form, typer.Option("--to", help="The form.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FILE", help="A new file, or - for standard output (without it the same)."
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", metavar="T", help="Only this topic, of jsonl and csv; can be repeated."),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option(
            LAYOUT_OPTION,
            metavar="FILE",
            help="Of foxglove: write the layout for Lichtblick there, a new file.",
        ),
    ] = None,
) -> None:
    """Write a log's records (jsonl, csv), its frames (candump, blf, asc), or what viewers draw of it (foxglove).

    jsonl: a line for each record with topic, sequence, times and data. csv: a table for each topic, in a new folder that
    -o names, or of one --topic in one file. candump: the raw frames beside the log where they are those that its close
    record names, else the log's single frames. blf, asc: the same frames as Vector's programs read them. foxglove: an MCAP
    file for Lichtblick and Foxglove with path, workspace and arm as a scene, and clearances, joints, tracking and timing as
    plots; a layout is in it as an attachment.

    Nothing is overwritten. Attachments and key files are not exported. A log that does not verify is exported as far as
    it can be read, and that is said.

    Exit code: 0, or 2 for a file that is no log or cannot be written.
    """
    topics = tuple(dict.fromkeys(topic or ()))
    standard = out is None or str(out) == STANDARD
    _check(to, topics, layout, standard=standard)
    with ExitStack() as stack:
        if to is Form.CSV and len(topics) != 1:
            folder = stack.enter_context(new_folder(_named(out)))
            write: Callable[[Log], str] = lambda read: _tables(read, topics, folder)  # noqa: E731 - one of three
        else:
            sink = stack.enter_context(standard_output() if standard else new_file(_named(out)))
            write = _written(to, log, topics, sink)
        if layout is not None:
            stack.enter_context(new_file(layout, LAYOUT_OPTION)).write(layout_bytes())
        if not standard:
            stack.enter_context(working(f"exporting {log}"))
        read = stack.enter_context(reading(log))
        _told(log, read)
        missing = [one for one in topics if one not in read.topics]
        if missing:
            bound = f"one of {', '.join(sorted(read.topics))}"
            raise InputError(log, "--topic", missing[0], bound, "name topics of this log")
        written = write(read)
    beside = "" if layout is None else f", layout to {layout}"
    echo(printable(written if standard else f"{written} to {out}{beside}"), err=True)


def _check(to: Form, topics: tuple[str, ...], layout: Path | None, *, standard: bool) -> None:
    """Refuses what does not go together."""
    if topics and to not in RECORDS:
        why = "it has topics of its own" if to is Form.FOXGLOVE else "frames have no topics"
        _refuse("--topic", topics[0], f"of --to jsonl or csv: {why}", "leave it out")
    if layout is not None and to is not Form.FOXGLOVE:
        _refuse(LAYOUT_OPTION, str(layout), "of --to foxglove", "leave it out")
    if to is Form.FOXGLOVE and standard:
        _refuse(OPTION, STANDARD, "a file: MCAP is not text", "name one with -o FILE.mcap")
    if to is Form.BLF and standard:
        _refuse(OPTION, STANDARD, "a file: BLF is not text", "name one with -o FILE")
    if to is Form.CSV and len(topics) != 1 and standard:
        remedy = "name a new folder with -o FOLDER, or one topic with --topic"
        _refuse(OPTION, STANDARD, "a folder: csv is a table for each topic", remedy)


def _refuse(option: str, value: str, bound: str, remedy: str) -> NoReturn:
    raise InputError("audit export", option, value, bound, remedy)


def _named(out: Path | None) -> Path:
    """The file or folder, which `_check` has seen to be named."""
    if out is None:
        raise TypeError("nothing is named to write to")
    return out


def _told(log: Path, read: Log) -> None:
    """What is wrong with the log; one that cannot be read at all is refused."""
    report = read.report
    if report.status is Status.UNREADABLE:
        raise InputError(log, "", None, report.reasons[0], "name a session's .mcap file")
    if report.status is not Status.OK:
        told = f"{log}: {report.status.name}: {report.reasons[0]}; what can be read of it is exported"
        echo(printable(told), err=True)


def _messages(read: Log, topics: tuple[str, ...]) -> Iterator[Stored]:
    """The records of these topics, or all, in file order, a chunk at a time."""
    for message in walk(read.file, Scan()):
        if not topics or message.topic in topics:
            yield message


def _written(to: Form, log: Path, topics: tuple[str, ...], sink: Sink) -> Callable[[Log], str]:
    """What writes the form to the sink, and says what it has written."""
    match to:
        case Form.JSONL:
            return lambda read: _lines(read, topics, sink)
        case Form.CSV:
            return lambda read: _table(read, topics[0], sink)
        case Form.FOXGLOVE:
            return lambda read: write_foxglove(read, log.name, sink)
        case _:
            return lambda read: _frames(to, log, read, sink)


def _lines(read: Log, topics: tuple[str, ...], sink: Sink) -> str:
    count = 0
    for message in _messages(read, topics):
        sink.write(json_line(message).encode("ascii"))
        count += 1
    return f"{count} records"


# ---------------------------------------------------------------- tables


def _columns(read: Log, topics: tuple[str, ...]) -> dict[str, dict[str, None]]:
    """The columns of each topic, in the order in which they are met."""
    found: dict[str, dict[str, None]] = {}
    for message in _messages(read, topics):
        columns = found.setdefault(message.topic, {})
        columns.update(dict.fromkeys(row_of(message)))
        if not len(columns) <= COLUMNS_MAX:
            bound = f"<= {COLUMNS_MAX} columns of one topic"
            _refuse(
                "--to", f"csv with {len(columns)} columns of {message.topic}", bound, "export it to jsonl"
            )
    return found


def _table(read: Log, topic: str, sink: Sink) -> str:
    """One topic's table."""
    columns = _columns(read, (topic,)).get(topic, {})
    sink.write(header_line(columns).encode())
    count = 0
    for message in _messages(read, (topic,)):
        sink.write(row_line(message, columns).encode())
        count += 1
    return f"{count} records of {topic}"


def _tables(read: Log, topics: tuple[str, ...], folder: Path) -> str:
    """A table for each topic."""
    columns = _columns(read, topics)
    if not len(columns) <= TABLES_MAX:
        _refuse("--to", f"csv of {len(columns)} topics", f"<= {TABLES_MAX}", "name some with --topic")
    count = 0
    with ExitStack() as files:
        sinks: dict[str, Sink] = {}
        names: list[str] = []
        for topic, own in columns.items():
            names.append(table_name(topic, names))
            sinks[topic] = files.enter_context(new_file(folder / names[-1]))
            sinks[topic].write(header_line(own).encode())
        for message in _messages(read, topics):
            sinks[message.topic].write(row_line(message, columns[message.topic]).encode())
            count += 1
    return f"{count} records, {len(columns)} tables"


# ---------------------------------------------------------------- frames


def _frames(to: Form, log: Path, read: Log, sink: Sink) -> str:
    """The session's frames, and where they are from."""
    beside = candump_of(log)
    with ExitStack() as files:
        raw = files.enter_context(open_input(beside)) if beside.is_file() else None
        frames = SessionFrames(read, raw)
        count = _candump(frames, sink) if to is Form.CANDUMP else _python_can(to, frames, sink)
        strange = f", {frames.strange} that are none left out" if frames.strange else ""
        return f"{count} frames{strange} ({frames.source})"


def _candump(frames: SessionFrames, sink: Sink) -> int:
    """Raw frames byte for byte, or the lines of the log's own."""
    count = 0
    if frames.whole and frames.raw is not None:
        frames.raw.seek(0)
        while data := frames.raw.read(PIECE):
            sink.write(data)
            count += data.count(b"\n")
        return count
    for _, frame in frames.each():
        sink.write(frame.line.encode())
        count += 1
    return count


def _python_can(to: Form, frames: SessionFrames, sink: Sink) -> int:
    """By python-can's own writers, counted from a time that none of the frames is before."""
    first_ns = min((frame.time_ns for _, frame in frames.each()), default=0)
    writer = _blf(sink, first_ns) if to is Form.BLF else _asc(sink, first_ns)
    count = 0
    for direction, frame in frames.each():
        writer.on_message_received(can_message(direction, frame))
        count += 1
    writer.stop()
    return count


def _blf(sink: Any, first_ns: int) -> can.BLFWriter:
    """BLF tells the start in whole milliseconds, and each frame in nanoseconds from there."""
    writer = can.BLFWriter(sink)
    first_s = first_ns // (NANOSECONDS // 1000) / 1000
    writer.start_timestamp = first_s if first_s >= _BLF_FIRST_S else 0.0
    return writer


def _asc(sink: Sink, first_ns: int) -> can.ASCWriter:
    """ASC tells the start in this computer's time zone; python-can writes its milliseconds wrongly, so there are none."""
    writer = can.ASCWriter(TextSink(sink))  # type: ignore[arg-type]
    if first_ns:
        writer.log_event("exported by cutgate", float(first_ns // NANOSECONDS))
    return writer
