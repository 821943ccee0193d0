"""Where long output goes: standard output, or a new file that is whole and on the disk, or not there.

What is written while a log is being read must not be taken for an error of reading it: an error of writing is an
`UnwrittenError` until the block of the sink ends, and only there what a person is told.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

import typer

from cutgate.config.durable import creating, sync_folder
from cutgate.config.exits import READER_GONE
from cutgate.config.load import InputError
from cutgate.config.screen import STDOUT, nobody_reads, write_nowhere
from cutgate.runtime.commands.screen import literal

OPTION: Final = "-o"
_PRIVATE: Final = 0o700
_ANOTHER: Final = "name another, or remove it first"


class UnwrittenError(Exception):
    """What was to be written was not.

    Args:
        error: of the system.
    """

    def __init__(self, error: OSError) -> None:
        super().__init__(str(error))
        self.error = error


class Sink:
    """What writers of bytes need of a file. Closing it leaves to its block what is to be done then."""

    closed = False

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def write(self, data: bytes) -> int:
        """All of the bytes. Raises UnwrittenError."""
        try:
            return self._stream.write(data)
        except OSError as error:
            raise UnwrittenError(error) from None

    def seek(self, place: int) -> int:
        """Go to a place. Raises UnwrittenError."""
        try:
            return self._stream.seek(place)
        except OSError as error:
            raise UnwrittenError(error) from None

    def tell(self) -> int:
        """Where it stands."""
        return self._stream.tell()

    def seekable(self) -> bool:
        """Whether it can go to a place."""
        return True

    def flush(self) -> None:
        """Nothing: its block does."""

    def close(self) -> None:
        """Nothing: its block does."""


class TextSink:
    """What writers of text need of a file."""

    closed = False

    def __init__(self, sink: Sink) -> None:
        self._sink = sink

    def write(self, text: str) -> int:
        """All of the text. Raises UnwrittenError."""
        self._sink.write(text.encode("utf-8", "backslashreplace"))
        return len(text)

    def flush(self) -> None:
        """Nothing: the sink's block does."""

    def close(self) -> None:
        """Nothing: the sink's block does."""


class _StandardOutput(Sink):
    """On a terminal what is not printable is escaped; a pipe or a file gets the bytes as they are."""

    def __init__(self) -> None:
        sys.stdout.flush()
        super().__init__(sys.stdout.buffer)
        self._terminal = sys.stdout.isatty()

    def write(self, data: bytes) -> int:
        """All of the bytes. Raises UnwrittenError."""
        if not self._terminal:
            return super().write(data)
        encoding = sys.stdout.encoding or "ascii"
        text = literal(data.decode("utf-8", "backslashreplace"))
        return super().write(text.encode(encoding, "backslashreplace"))


@contextmanager
def standard_output() -> Iterator[Sink]:
    """Standard output, for bytes.

    Raises:
        typer.Exit: nobody reads it any more; with a code that is no verdict's.
        OSError: it cannot be written otherwise.
    """
    try:
        yield _StandardOutput()
        _flushed()
    except UnwrittenError as failed:
        if not nobody_reads(failed.error):
            raise failed.error from None
        write_nowhere(STDOUT)
        raise typer.Exit(READER_GONE) from None


def _flushed() -> None:
    try:
        sys.stdout.buffer.flush()
    except OSError as error:
        raise UnwrittenError(error) from None


@contextmanager
def new_file(path: Path, option: str = OPTION) -> Iterator[Sink]:
    """A new file for its owner alone; where the block is left by an exception none is left there.

    Args:
        path: the file.
        option: that names it.

    Raises:
        InputError: something stands there, or it cannot be written.
    """
    try:
        with creating(path) as descriptor, os.fdopen(os.dup(descriptor), "wb") as stream:
            yield Sink(stream)
    except FileExistsError:
        raise InputError(path, option, None, "exists already", _ANOTHER) from None
    except UnwrittenError as failed:
        raise _refused(path, failed.error, option) from None
    except OSError as error:
        raise _refused(path, error, option) from None


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A new folder for its owner alone; where the block is left by an exception none is left there, if it is empty.

    Raises:
        InputError: something stands there, or it cannot be made.
    """
    try:
        path.mkdir(_PRIVATE)
    except FileExistsError:
        raise InputError(path, OPTION, None, "exists already", _ANOTHER) from None
    except OSError as error:
        raise _refused(path, error) from None
    try:
        yield path
        sync_folder(path.parent)
    except BaseException:
        with suppress(OSError):
            path.rmdir()
        raise


def _refused(path: Path, error: OSError, option: str = OPTION) -> InputError:
    reason = error.strerror or str(error)
    return InputError(path, option, None, f"cannot be written ({reason})", "name another place")
