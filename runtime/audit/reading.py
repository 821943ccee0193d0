"""A log's files, opened, read and judged: what commands and reviews begin with."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import SEEK_END
from pathlib import Path
from typing import Final

from cutgate.config.load import check_size, open_input, unreadable
from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.audit.trust import NOBODY, Trust

SIZE_MAX: Final = 1 << 32
"""Bytes of the largest log that is read: four hours of cutting at the shortest heartbeat, twelve at the usual one."""
COPY: Final = ".recovered"
"""What the name of a recovered copy has before its ending."""
_REMEDY: Final = "it is no session's log; name another file"


def candump_of(log: Path) -> Path:
    """Where the raw frames of a log stand: beside it, and those of a recovered copy beside the original."""
    return log.with_name(f"{log.stem.removesuffix(COPY)}.candump.log")


def copy_of(log: Path) -> Path:
    """Where the recovered copy of a log is made: beside it."""
    return log.parent / f"{log.stem}{COPY}.mcap"


@contextmanager
def reading(path: Path, trust: Trust = NOBODY) -> Iterator[Log]:
    """The log and its judgement, with raw frames and signature beside it where they are; its files are open meanwhile.

    An error of the disk in the block is one of reading: what writes, to a terminal or a file, stands behind the block.

    Raises:
        InputError: no such file, larger than any log, or it cannot be read.
    """
    with ExitStack() as files:
        log = files.enter_context(open_input(path))
        check_size(path, log.seek(0, SEEK_END), SIZE_MAX, _REMEDY)
        candump = candump_of(path)
        frames = files.enter_context(open_input(candump)) if candump.is_file() else None
        sidecar = sidecar_of(path)
        signature = files.enter_context(open_input(sidecar)) if sidecar.is_file() else None
        try:
            found = read_log(log, frames, signature, trust)
        except OSError as error:
            raise unreadable(path, error) from None
        try:
            yield found
        except OSError as error:  # records and attachments are read when they are asked for
            raise unreadable(path, error) from None
