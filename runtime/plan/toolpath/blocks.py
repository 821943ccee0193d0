"""A block of RS-274: its words and its assignments, and nothing that is neither."""

import re
from dataclasses import dataclass, field
from typing import Final

from cutgate.runtime.plan.toolpath.expressions import GcodeError, Parameters, Scanner, check_index

LINE_MAX: Final = 255
"""Characters of a line, as LinuxCNC has it."""
LETTERS: Final = frozenset("ABCDFHIJKLPQRSTXYZ")
"""Letters that may stand once in a block, beside G and M."""
CODE_TENTHS: Final = 1e-6
"""A code given by an expression may be this far from a tenth."""

_COMMENT: Final = re.compile(r"\(([^()]*+)\)|;.*+", re.DOTALL)
_BLANKS: Final = str.maketrans("", "", " \t\r")
_NUMBER_LETTER: Final = r"[A-Z][+-]?+(?:[0-9]++\.?+[0-9]*+|\.[0-9]++)"
_PLAIN: Final = re.compile(f"(?:{_NUMBER_LETTER})++")
_PAIR: Final = re.compile(r"([A-Z])([^A-Z]++)")
_SEQUENCE: Final = re.compile(r"N[0-9.]{1,20}")
_FOREIGN: Final = {
    "U": "a second linear axis",
    "V": "a second linear axis",
    "W": "a second linear axis",
    "E": "an output of the machine",
    "O": "it must be the first of its line, alone",
    "N": "it must be the first of its line",
}


@dataclass(slots=True)
class GcodeBlock:
    """One line.

    Attributes:
        values: of every letter but G and M; whoever uses one takes it out.
        codes: the G and M words, such as ``G1`` or ``G43.1``.
    """

    values: dict[str, float] = field(default_factory=dict)
    codes: list[str] = field(default_factory=list)

    def take(self, letter: str) -> float | None:
        """The value of a letter, which is thereby used; None where it is not in the block."""
        return self.values.pop(letter, None)

    def need(self, letter: str, whose: str) -> float:
        """The same of a letter that must be there.

        Raises:
            GcodeError: it is not.
        """
        value = self.take(letter)
        if value is None:
            raise GcodeError(f"{whose} without {letter}", f"given with {letter}", f"add the {letter} word")
        return value


def bare(line: str) -> str:
    """A line in upper case without blanks and comments.

    Raises:
        GcodeError: too long, a comment that does not end or aborts the program, or a sign that is not of ASCII.
    """
    if not (len(line) <= LINE_MAX):
        raise GcodeError(f"{len(line)} characters", f"<= {LINE_MAX} characters in a line", "part the line")
    if "(" in line or ";" in line or ")" in line:
        line = _COMMENT.sub(_removed, line)
        if "(" in line or ")" in line:
            bound = "a comment that ends in its line and holds no parenthesis"
            raise GcodeError("a parenthesis", bound, "correct the comment, or begin it with ;")
    if not line.isascii():
        found = next(sign for sign in line if not sign.isascii())
        raise GcodeError(f'"{found}"', "a sign of ASCII, outside of comments", "take it out")
    return line.translate(_BLANKS).upper()


def _removed(match: re.Match[str]) -> str:
    comment = match[1]
    if comment is not None and comment.lstrip()[:6].lower() == "abort,":
        bound = "no order to abort: the machine goes no further"
        raise GcodeError("(ABORT,...)", bound, "take out what leads here")
    return ""


def read_block(text: str, parameters: Parameters) -> GcodeBlock:
    """The words of a bare line; assignments in it hold from the next line on.

    Raises:
        GcodeError: something that is no word, a word of another kind of machine, or a letter that stands twice.
    """
    sequence = _SEQUENCE.match(text)
    if sequence:
        text = text[sequence.end() :]
    block = GcodeBlock()
    if _PLAIN.fullmatch(text):
        for letter, number in _PAIR.findall(text):
            _put(block, letter, float(number))
        return block
    if text.startswith("/"):
        bound = "a line that is always executed: a switch at the machine decides about this one"
        raise GcodeError("block delete /", bound, "take out the line, or its /")
    scanner, assigned = Scanner(text, parameters), list[tuple[int | str, float]]()
    while not scanner.ended():
        if scanner.take("#"):
            assigned.append(_assignment(scanner))
        else:
            letter = scanner.text[scanner.at]
            if not letter.isalpha():
                raise GcodeError(f'"{scanner.rest}"', "a word: a letter and its value", "correct the line")
            scanner.at += 1
            _put(block, letter, scanner.value())
    for key, value in assigned:
        parameters.set(key, value)
    return block


def _assignment(scanner: Scanner) -> tuple[int | str, float]:
    key = scanner.key()
    if isinstance(key, int):
        check_index(key)
    scanner.need("=")
    return key, scanner.value()


def _put(block: GcodeBlock, letter: str, value: float) -> None:
    if letter in "GM":
        block.codes.append(_code(letter, value))
        return
    if letter not in LETTERS:
        bound = f"one of the letters {' '.join(sorted(LETTERS | {'G', 'M'}))}"
        reason = f" ({_FOREIGN[letter]})" if letter in _FOREIGN else ""
        raise GcodeError(f"{letter} word{reason}", bound, "take it out")
    if letter in block.values:
        raise GcodeError(f"two {letter} words", "one of each letter in a line", "part the line")
    block.values[letter] = value


def _code(letter: str, value: float) -> str:
    tenths = round(10.0 * value)
    if not (abs(10.0 * value - tenths) <= CODE_TENTHS and 0 <= tenths < 10_000):
        raise GcodeError(f"{letter}{value:g}", f"a code {letter}0 to {letter}999.9", "correct it")
    whole, tenth = divmod(tenths, 10)
    return f"{letter}{whole}.{tenth}" if tenth else f"{letter}{whole}"
