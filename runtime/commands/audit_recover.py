"""``cutgate audit recover``: a finalised copy of a log that a crash, a loss of power or a full disk has cut."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Annotated, BinaryIO, Final

import typer

from cutgate import __version__
from cutgate.config.durable import creating, write_all
from cutgate.config.load import InputError, open_input, unreadable
from cutgate.config.ours import read_ours
from cutgate.config.screen import printable
from cutgate.runtime.audit.container.raw import PIECE, BrokenError, TornError
from cutgate.runtime.audit.directory import HEAD, HEAD_MAX, Head, in_use
from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.reading import copy_of, reading
from cutgate.runtime.audit.recovered import Recovered
from cutgate.runtime.audit.recovery import agrees, copied, refused, what_is_told
from cutgate.runtime.commands.screen import echo, working

READ_ONLY: Final = 0o400
"""Mode of the original, once its copy is on the disk."""
_FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CHANGED: Final = "it changes while it is read"
_AT_REST: Final = "wait until whatever writes it has ended"


def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap) that was cut.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The copy; LOG's name with .recovered.mcap if left out."),
    ] = None,
) -> None:
    """Make a finalised copy of a log that a crash has cut, which every MCAP reader opens.

    Everything that is whole is kept as it is, the torn tail is dropped.
    The copy says of what it was made, and is INCOMPLETE for ever.
    The log is made read-only, and is otherwise untouched. Nothing is written over.
    Exit code: 0 copy written, 2 refused.
    """
    copy = copy_of(log) if out is None else out
    if os.path.lexists(copy):
        raise _there_already(copy)
    _check_no_session(log)
    with working(f"recovering {log}"), reading(log) as read:
        why = refused(read)
        if why is not None:
            raise InputError(log, "", None, *why)
        told = what_is_told(read, _named(log), _digest(log, read), f"cutgate {__version__}")
        _write(copy, _pieces(log, read, told))
        _read_back(copy, log, read, told)
        kept = _made_read_only(read.file)
    echo(f"recovered: {printable(str(copy))}")
    attachments = len(read.scan.attachments)
    echo(
        f"  {told.records} records and {attachments} attachments kept, {told.dropped} bytes dropped at the end"
    )
    echo("  audit verify says INCOMPLETE of it, never OK: it is a copy of what was left")
    echo(f"  {printable(str(log))}: {kept}")


def _named(log: Path) -> str:
    """The file's name; what of it is no text is escaped."""
    return os.fsencode(log.name).decode("utf-8", "backslashreplace")


def _there_already(copy: Path) -> InputError:
    return InputError(
        copy, "", None, "there is something of this name already", "name the copy another way, with -o"
    )


# ---------------------------------------------------------------- the original


def _check_no_session(log: Path) -> None:
    """Refuses the log that a session is writing, which looks as a crash leaves it.

    Raises:
        InputError: it is being written, or that cannot be told.
    """
    folder = Path(os.path.realpath(log)).parent
    with suppress(InputError, OSError, ValueError):  # then the lock alone tells
        if Head.parse(read_ours(folder / HEAD, HEAD_MAX)).log != Path(os.path.realpath(log)).name:
            return
    if in_use(folder):
        raise InputError(
            log,
            "",
            None,
            "a session is writing it",
            "end the session; a log that it closes needs no recovery",
        )


def _digest(path: Path, log: Log) -> str:
    """SHA-256 of the whole file, hex.

    Raises:
        InputError: it has not the size any more with which it was read.
    """
    digest, size = sha256(), 0
    log.file.seek(0)
    while data := log.file.read(PIECE):
        digest.update(data)
        size += len(data)
    if size != log.scan.size:
        raise InputError(path, "", None, _CHANGED, _AT_REST)
    return digest.hexdigest()


def _made_read_only(file: BinaryIO) -> str:
    """Take away who may write it; what is said of that, for the copy counts all the same."""
    if not stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o222:
        return "the original, which is read-only"
    try:
        os.fchmod(file.fileno(), READ_ONLY)
    except OSError as error:
        return f"the original, which could not be made read-only ({error.strerror}): keep it as it is"
    return "the original, now read-only: keep it"


# ---------------------------------------------------------------- the copy


def _pieces(path: Path, log: Log, told: Recovered) -> Iterator[bytes]:
    """The copy; an error of the original is told as one of its, not of the copy."""
    try:
        yield from copied(log, told)
    except TornError:
        raise InputError(path, "", None, _CHANGED, _AT_REST) from None
    except BrokenError as error:
        raise InputError(
            path, "", None, str(error), "no session writes such a log; keep it as it is"
        ) from None
    except OSError as error:
        raise unreadable(path, error) from None


def _write(copy: Path, pieces: Iterator[bytes]) -> None:
    try:
        with creating(copy) as descriptor:
            for piece in pieces:
                write_all(descriptor, piece)
    except FileExistsError:
        raise _there_already(copy) from None
    except OSError as error:
        full = error.errno in _FULL
        remedy = (
            "free the disk, or name the copy elsewhere with -o"
            if full
            else "name the copy elsewhere, with -o"
        )
        raise InputError(copy, "", None, f"cannot be written ({error.strerror})", remedy) from None


def _read_back(copy: Path, path: Path, log: Log, told: Recovered) -> None:
    """Refuses a copy that is not what was read, and removes it; raw frames that may lie beside it are not its matter.

    Raises:
        InputError: it differs, or cannot be read.
    """
    same = False
    try:
        with open_input(copy) as file:
            same = agrees(read_log(file), log, told)
    except OSError as error:
        raise unreadable(copy, error) from None
    finally:
        if not same:
            copy.unlink(missing_ok=True)
    if not same:
        raise InputError(path, "", None, f"{_CHANGED}: its copy holds something else", _AT_REST)
