"""Words typed on a terminal or sent through a pipe, read without ever blocking a control loop."""

import os
from enum import StrEnum
from typing import Generic, TypeVar

READ_BYTES = 4096
LINE_BYTES_MAX = 256
CUT = b"..."
"""Stands for what a line is too long by."""

W = TypeVar("W", bound=StrEnum)


class WordReader(Generic[W]):
    """Splits what arrives on a descriptor into words of one vocabulary.

    Args:
        descriptor: file descriptor to read from; poll it, then call :meth:`read`.
        words: the vocabulary.
    """

    def __init__(self, descriptor: int, words: type[W]) -> None:
        self.descriptor: int | None = descriptor
        self._words = words
        self._rest = b""

    def read(self) -> list[W | str]:
        """The words that have arrived; what is not in the vocabulary comes back as text, to be refused.

        Call it only when the descriptor is readable. At end of file ``descriptor`` becomes None.
        """
        if self.descriptor is None:
            return []
        try:
            data = os.read(self.descriptor, READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:  # the end of the file ends its last line
            self.descriptor = None
            data = b"\n"
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: LINE_BYTES_MAX + 1]  # one byte too many says that it is too long
        texts = [_text(line) for line in lines]
        return [self._word(text) for text in texts if text]

    def _word(self, text: str) -> W | str:
        try:
            return self._words(text)
        except ValueError:
            return text[:LINE_BYTES_MAX]


def _text(line: bytes) -> str:
    """No word is so long, padding included, however the line arrived: what is cut off must not make one of it."""
    whole = line if len(line) <= LINE_BYTES_MAX else line[:LINE_BYTES_MAX] + CUT
    return whole.decode("ascii", "replace").strip().lower()
