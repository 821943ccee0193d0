"""``cutgate decode``: what was said on the bus, message by message."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Annotated, BinaryIO, Final

import typer

from cutgate.config.load import InputError, open_input, unreadable
from cutgate.config.screen import printable
from cutgate.protocol.candump import CandumpError, RawFrame, parse
from cutgate.runtime.audit.container.raw import MAGIC
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.records import CanFrame, CanTransfer
from cutgate.runtime.commands.screen import echo
from cutgate.runtime.commands.sinks import Sink, standard_output
from cutgate.runtime.review.decoding import NAMES, NANOSECONDS, DecodedMessage, Decoding, transfer_of
from cutgate.runtime.review.recorded_frames import LINE_MAX, Direction, SessionFrames, lines
from cutgate.runtime.review.told import json_line, text_line

INTERFACES_MAX: Final = 64
"""Buses of one file; of each a little is remembered."""
ID_MAX: Final = 0x1FFF_FFFF
_SECONDS_MAX: Final = 1 << 37
_BOM: Final = b"\xef\xbb\xbf"
_UTF16: Final = (b"\xff\xfe", b"\xfe\xff")

Recorded = tuple[RawFrame, Direction | None] | DecodedMessage
"""A frame, or a transfer that the log tells of and whose frames it does not hold."""


@dataclass(frozen=True)
class Wanted:
    """What is shown of it.

    Attributes:
        ids: identifiers; all if there are none.
        names: of messages; all if there are none.
        json: as JSON.
    """

    ids: frozenset[int]
    names: frozenset[str]
    json: bool

    def takes(self, heard: DecodedMessage) -> bool:
        """Whether this is shown; a record that was lost is, if it may have been one of those."""
        return (not self.ids or heard.can_id in self.ids) and bool(
            not self.names or heard.may_be & self.names
        )


def decode(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A session's log (.mcap), or frames as candump -L records them."),
    ],
    *,
    json: Annotated[
        bool, typer.Option("--json", help="JSON lines: one object for each message, not one document.")
    ] = False,
    identifier: Annotated[
        list[str] | None,
        typer.Option("--id", metavar="HEX", help="Only this identifier; can be repeated."),
    ] = None,
    message: Annotated[
        list[str] | None,
        typer.Option("--message", metavar="NAME", help="Only this message, such as Permit; can be repeated."),
    ] = None,
    lenient: Annotated[
        bool,
        typer.Option(
            "--lenient", help="Pass over and count lines that are no frames, instead of refusing them."
        ),
    ] = False,
) -> None:
    """Show what was said on the bus: a line for each message, with its fields in words and units.

    Single frames are read by the DBC, records of transfers are put together of their segments and shown when they are
    whole. What was lost, came twice, is out of sequence, damaged or unknown is told in place, in brackets. Codes and tags
    of the key are shown, not checked; the sender is the side that alone may use the identifier.

    Of a log the raw frames beside it are read, where they are those that its close record names; else the frames of the
    log itself. A file of frames is looked through before anything is shown: a line that is none is refused with its
    number. What is counted stands on standard error.

    Exit code: 0, or 2 for a file that is refused; 141 if nobody reads any more.
    """
    wanted = Wanted(_ids(identifier or ()), _names(message or ()), json)
    with standard_output() as sink:
        with open_input(file) as opened:
            is_log = opened.read(len(MAGIC)) == MAGIC
            told = [] if is_log else _of_candump(file, opened, sink, wanted, lenient=lenient)
        if is_log:
            told = _of_log(file, sink, wanted)
    for line in told:
        echo(printable(line), err=True)


# ---------------------------------------------------------------- what is asked for


def _ids(texts: list[str] | tuple[()]) -> frozenset[int]:
    found = set()
    for text in texts:
        digits = text.lower().removeprefix("0x")
        plain = 0 < len(digits) <= 8 and all(one in "0123456789abcdef" for one in digits)
        if not plain or int(digits, 16) > ID_MAX:
            raise InputError("decode", "--id", text, "a hexadecimal number up to 1FFFFFFF", "as in --id 081")
        found.add(int(digits, 16))
    return frozenset(found)


def _names(texts: list[str] | tuple[()]) -> frozenset[str]:
    known = {name.lower(): name for name in NAMES}
    for text in texts:
        if text.lower() not in known:
            raise InputError(
                "decode", "--message", text, f"one of {', '.join(sorted(NAMES))}", "name one of these"
            )
    return frozenset(known[text.lower()] for text in texts)


# ---------------------------------------------------------------- a log


def _of_log(path: Path, sink: Sink, wanted: Wanted) -> list[str]:
    """Shows a log's messages; what is to be told of it afterwards."""
    with reading(path) as log, ExitStack() as files:
        report = log.report
        if report.status is Status.UNREADABLE:
            raise InputError(path, "", None, report.reasons[0], "name a session's .mcap file, or raw frames")
        if report.status is not Status.OK:
            echo(printable(f"{path}: {report.status.name}: {report.reasons[0]}"), err=True)
        beside = candump_of(path)
        raw = files.enter_context(open_input(beside)) if beside.is_file() else None
        frames = SessionFrames(log, raw)
        told = _shown(_recorded(frames), sink, wanted, several=False)
        told.append(f"of {frames.source}")
        if frames.strange:
            told.append(f"{frames.strange} records or lines that are no frames were passed over")
        return told


def _recorded(frames: SessionFrames) -> Iterator[Recorded]:
    if frames.whole:
        for direction, frame in frames.each():
            yield frame, direction
        return
    interface = frames.interface
    time_ns = 0
    for topic, data in frames.log.each(CanFrame.TOPIC, CanTransfer.TOPIC):
        if topic == CanFrame.TOPIC:
            found = frames.recorded(data, interface)
            if found is not None:
                time_ns = found[1].time_ns
                yield found[1], found[0]
        else:
            record = parse_object(data) or {}
            time_ns = _stamp(record, time_ns)
            yield transfer_of(record, time_ns, interface)


def _stamp(record: dict[str, object], before_ns: int) -> int:
    """The record's time; that of what came before it where it has none."""
    stamp = record.get("stamp")
    if isinstance(stamp, dict) and isinstance(stamp.get("sec"), int) and isinstance(stamp.get("nsec"), int):
        found = int(stamp["sec"]) * NANOSECONDS + int(stamp["nsec"])
        return found if 0 <= found < _SECONDS_MAX * NANOSECONDS else before_ns
    return before_ns


# ---------------------------------------------------------------- a file of frames


@dataclass
class _Looked:
    """What a look through the whole file has found.

    Attributes:
        size: bytes that were looked at; what is written behind them meanwhile is not read.
        interfaces: names of the buses.
        passed_over: lines that are no frames.
        first: the number of the first of them.
        ending: what is to be told of the last line.
    """

    size: int = 0
    interfaces: set[str] = field(default_factory=set)
    passed_over: int = 0
    first: int = 0
    ending: str = ""


def _of_candump(path: Path, file: BinaryIO, sink: Sink, wanted: Wanted, *, lenient: bool) -> list[str]:
    """Shows the messages of raw frames; what is to be told of them afterwards."""
    try:
        looked = _look(path, file, lenient=lenient)
        frames = ((frame, None) for _, _, frame in _parsed(file, looked.size) if isinstance(frame, RawFrame))
        told = _shown(frames, sink, wanted, several=len(looked.interfaces) > 1)
    except OSError as error:  # of reading: one of writing comes as another
        raise unreadable(path, error) from None
    if looked.passed_over:
        told.append(
            f"lines passed over, which are no frames: {looked.passed_over}; the first is line {looked.first}"
        )
    if looked.ending:
        told.append(looked.ending)
    return told


def _look(path: Path, file: BinaryIO, *, lenient: bool) -> _Looked:
    """Looks at every line before anything is shown.

    Raises:
        InputError: a line is no frame, and is not to be passed over; or more buses than can be.
    """
    found = _Looked(size=file.seek(0, 2))
    file.seek(0)
    if file.read(2) in _UTF16:
        raise InputError(
            path, "line 1", "UTF-16", "ASCII or UTF-8", "save it as UTF-8, or record it by candump -L"
        )
    for number, text, frame in _parsed(file, found.size):
        whole = text.endswith(b"\n")
        if isinstance(frame, RawFrame):
            found.interfaces.add(frame.interface)
            found.ending = "" if whole else f"line {number}, the last one, has no end: it may be cut off"
        elif not whole and len(text) < LINE_MAX:
            found.ending = f"line {number}, the last one, is cut off and was passed over"
        elif lenient:
            found.passed_over += 1
            found.first = found.first or number
        else:
            shown = text.decode("utf-8", "backslashreplace").rstrip()
            remedy = "record it by candump -L, or pass such lines over with --lenient"
            raise InputError(path, f"line {number}", shown, str(frame), remedy)
        if not len(found.interfaces) <= INTERFACES_MAX:
            bound = f"<= {INTERFACES_MAX} interfaces"
            raise InputError(
                path, f"line {number}", "one interface more", bound, "part the file by interface"
            )
    return found


def _parsed(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes, RawFrame | CandumpError]]:
    """Number, bytes and frame of each line that is not blank; in a frame's place what is wrong with the line."""
    for number, raw in enumerate(lines(file, size), 1):
        text = raw.removeprefix(_BOM) if number == 1 else raw
        if not text.strip():
            continue
        try:
            yield number, text, parse(text.decode("utf-8"))
        except CandumpError as error:
            yield number, text, error
        except UnicodeDecodeError:
            yield number, text, CandumpError("text in ASCII or UTF-8")


# ---------------------------------------------------------------- what is shown


def _shown(recorded: Iterator[Recorded], sink: Sink, wanted: Wanted, *, several: bool) -> list[str]:
    """Writes the messages that are wanted; the counts of all."""
    decoding, shown, start_ns = Decoding(), 0, 0
    for number, one in enumerate(chain(recorded, [None])):
        if one is None:
            found = decoding.end()
        elif isinstance(one, DecodedMessage):
            found = (one,)
        else:
            found = decoding.take(*one)
        if number == 0 and one is not None:
            start_ns = one.time_ns if isinstance(one, DecodedMessage) else one[0].time_ns
            if not wanted.json:
                sink.write(f"# seconds since {_utc(start_ns)}\n".encode())
        for heard in filter(wanted.takes, found):
            line = (
                json_line(heard, start_ns) if wanted.json else text_line(heard, start_ns, interfaces=several)
            )
            sink.write(line.encode("utf-8", "backslashreplace"))
            shown += 1
    return [f"{shown} lines; {_counted(decoding)}"]


def _counted(decoding: Decoding) -> str:
    counts = decoding.counts
    told = [f"{counts['frames']} frames", f"{counts['messages']} messages"]
    told.append(f"{counts['records']} records of {counts['segments']} segments")
    told += [
        f"{counts[name]} {name}" for name in ("unknown", "with remarks", "stray segments") if counts[name]
    ]
    if counts["unchecked"]:
        told.append(f"CRC of {counts['unchecked']} not checked: their session was not seen to open")
    return ", ".join(told)


def _utc(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, NANOSECONDS)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest // 1000:06d} UTC"


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("decode")(decode)
