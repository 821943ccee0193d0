"""What a refused input looks like: file, key, value, bound and remedy, one line each."""

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cutgate.config.screen import printable

MAX_SHOWN: Final = 20
_VALUE_CHARACTERS: Final = 60
_REPR_BITS: Final = 4096


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One thing wrong with one file. ``key`` is a dotted key or ``line N``; empty when it is the whole file."""

    file: str
    key: str
    value: str
    bound: str
    remedy: str

    def __str__(self) -> str:
        """One line: file, key, value, bound, remedy; absent parts are left out."""
        place = f"{self.file}: {self.key}" if self.key else self.file
        found = f" is {self.value}" if self.value else ""
        rule = f", must be {self.bound}" if self.value else f": {self.bound}"
        return printable(f"{place}{found}{rule}" + (f"; {self.remedy}" if self.remedy else ""))


class InputError(Exception):
    """Refused input: every problem found, one line each.

    Args:
        file: the file as the user named it.
        key: dotted key, ``line N`` or empty.
        value: what was found (shown with ``repr`` unless it is text already); None when nothing was.
        bound: what would have been accepted.
        remedy: what to do about it; may be empty.
        more: further problems of the same input.
    """

    def __init__(
        self,
        file: object,
        key: str,
        value: object,
        bound: str,
        remedy: str = "",
        *,
        more: Sequence[FileProblem] = (),
    ) -> None:
        self.problems = (FileProblem(str(file), key, shown(value), bound, remedy), *more)
        super().__init__(str(self))

    @classmethod
    def of(cls, problems: Sequence[FileProblem]) -> "InputError":
        """The error that lists these problems; at least one."""
        first = problems[0]
        return cls(first.file, first.key, first.value or None, first.bound, first.remedy, more=problems[1:])

    def __str__(self) -> str:
        """One line per problem, at most ``MAX_SHOWN``."""
        lines = [str(problem) for problem in self.problems[:MAX_SHOWN]]
        if len(self.problems) > MAX_SHOWN:
            lines.append(f"... and {len(self.problems) - MAX_SHOWN} more")
        return "\n".join(lines)


class _Brief(reprlib.Repr):
    """The beginning of a value: nobody writes out a list of a million numbers to show sixty characters of it."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxlist = self.maxtuple = self.maxdict = _VALUE_CHARACTERS // 2
        self.maxstring = self.maxother = 2 * _VALUE_CHARACTERS

    def repr_int(self, value: int, _level: int) -> str:
        """Python writes out no integer of thousands of digits, and nobody wants to read it."""
        bits = value.bit_length()
        return repr(value) if bits <= _REPR_BITS else f"an integer of {bits} bits"


_BRIEF: Final = _Brief()


def shown(value: object) -> str:
    """A value for a message: on one line, printable, at most 60 characters; empty for None."""
    if value is None:
        return ""
    text = value[: _VALUE_CHARACTERS + 1] if isinstance(value, str) and value else _BRIEF.repr(value)
    text = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)
    return text if len(text) <= _VALUE_CHARACTERS else text[: _VALUE_CHARACTERS - 3] + "..."


def quoted(value: object) -> str:
    """A value of a file for a message: text in quotation marks, so that nobody takes "20" for a number."""
    return f'"{shown(value) if value else ""}"' if isinstance(value, str) else shown(value)
