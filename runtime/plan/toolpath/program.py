"""The order in which the lines of an RS-274 program are executed: O-words, subroutines, loops, percent signs."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from cutgate.runtime.plan.toolpath.blocks import bare
from cutgate.runtime.plan.toolpath.expressions import GcodeError, Parameters, Scanner, integer

NESTING_MAX: Final = 10
"""Calls within calls, and loops and branches within each other."""
ARGUMENTS_MAX: Final = 30
REPEAT_MAX: Final = 1e9
BEHIND_TEXT: Final = 16
"""What executing a line costs beside its characters, in characters."""

_O_LINE: Final = re.compile(r"[ \t]*[oO]")
_O_TEXT: Final = re.compile(
    r"O([0-9]{1,9}|<[^<>\[\]#=]{1,60}>)"
    r"(SUB|ENDSUB|RETURN|CALL|DO|WHILE|ENDWHILE|IF|ELSEIF|ELSE|ENDIF|REPEAT|ENDREPEAT|BREAK|CONTINUE)(.*)"
)
_CLOSES: Final = {
    "ENDSUB": {"SUB"},
    "ENDWHILE": {"WHILE"},
    "ENDREPEAT": {"REPEAT"},
    "ENDIF": {"IF", "ELSEIF", "ELSE"},
    "ELSEIF": {"IF", "ELSEIF"},
    "ELSE": {"IF", "ELSEIF"},
}
"""What must be open for each; the innermost thing that is open, under the same label."""
_LOOPS: Final = frozenset({"DO", "WHILE", "REPEAT"})
_ALONE: Final = {"WHILE": {"DO"}, "DO": {"WHILE", "REPEAT"}, "REPEAT": {"REPEAT"}}
"""With BREAK or CONTINUE of a loop, none of these may be in the file: what LinuxCNC 2.9 executes is not what is written.

A WHILE that was left lets a later DO run once, a DO that was continued lets a later REPEAT run twice as often, and a
REPEAT that is left skips the rest of the program.
"""
_BARE: Final = frozenset({"SUB", "DO", "ENDWHILE", "ELSE", "ENDIF", "ENDREPEAT", "BREAK", "CONTINUE"})
"""Nothing may follow these."""


@dataclass(slots=True)
class _Control:
    """An O-word: where it leads.

    Attributes:
        keyword, label, rest: what stands in the line.
        head: the line that opens what this one belongs to.
        end: the line that closes it; of a branch, the next branch of the same condition.
        tail: of a branch, the ENDIF; of a DO, the WHILE that closes it.
    """

    keyword: str
    label: str
    rest: str
    head: int = -1
    end: int = -1
    tail: int = -1


@dataclass(slots=True)
class _Call:
    """A subroutine that is being executed."""

    label: str
    back: int
    counts: dict[int, int] = field(default_factory=dict)


class Program:
    """Lines of a program, handed out in the order of execution.

    Args:
        lines: all of the file.
        parameters: what conditions read, and calls set.
        work: so many characters are executed at most.

    Attributes:
        index: the line that is being executed, from 0.

    Raises:
        GcodeError: O-words that do not fit together.
    """

    def __init__(self, lines: Sequence[str], parameters: Parameters, work: int) -> None:
        self.index = 0
        self._lines = lines
        self._parameters = parameters
        self._work = self._left = work
        self._first, self._last, self._closed = _extent(lines)
        self._controls = _controls(lines, self._first, self._last)
        self._subs: dict[str, int] = {}
        self._calls = [_Call("", -1)]
        # Where each O-word leads; the others lead to the next line.
        self._acts: dict[str, Callable[[_Control], int]] = {
            "SUB": self._define,
            "CALL": self._call,
            "RETURN": self._return,
            "ENDSUB": self._return,
            "IF": self._branch,
            "ELSEIF": self._pass,
            "ELSE": lambda control: control.tail + 1,
            "REPEAT": self._repeat,
            "ENDREPEAT": self._again,
            "WHILE": self._while,
            "ENDWHILE": lambda control: control.head,
            "BREAK": lambda control: control.end + 1,
            "CONTINUE": self._continue,
        }

    def blocks(self) -> Iterator[str]:
        """The bare text of each line without an O-word, as often as it is executed; ``index`` tells which it is.

        Whoever takes them stops at the program's end.

        Raises:
            GcodeError: in the line ``index``.
        """
        self.index = self._first
        while self.index < self._last:
            line = self._lines[self.index]
            self._left -= len(line) + BEHIND_TEXT
            if not (self._left >= 0):
                bound = f"<= {self._work} for this pose limit"
                raise GcodeError("more characters executed", bound, "does a loop end? else part the program")
            control = self._controls.get(self.index)
            if control is None:
                yield bare(line)
                self.index += 1
            else:
                self.index = self._next(control)
        self.index = max(0, len(self._lines) - 1)
        if not self._closed:
            bound = "ended by M2, M30 or a second %"
            raise GcodeError("the end of the file", bound, "end the program; perhaps the file is cut off")

    # ---------------------------------------------------------- where to go

    def _next(self, control: _Control) -> int:
        """The line after this one."""
        act = self._acts.get(control.keyword)
        return self.index + 1 if act is None else act(control)

    def _define(self, control: _Control) -> int:
        self._subs[control.label] = self.index
        return control.end + 1

    def _continue(self, control: _Control) -> int:
        """To where the loop decides whether it goes on."""
        return control.head if self._controls[control.head].keyword == "WHILE" else control.end

    def _pass(self, control: _Control) -> int:
        """The branch before it is done; its condition must be one all the same, as LinuxCNC reads it."""
        self._condition(control)
        return control.tail + 1

    def _while(self, control: _Control) -> int:
        holds = self._condition(control)
        if control.head >= 0:
            return control.head + 1 if holds else self.index + 1
        return self.index + 1 if holds else control.end + 1

    def _branch(self, control: _Control) -> int:
        while not self._condition(control):
            self.index = control.end
            control = self._controls[self.index]
            self._left -= len(control.rest) + BEHIND_TEXT
            if control.keyword != "ELSEIF":
                break
        return self.index + 1

    def _repeat(self, control: _Control) -> int:
        count = integer(self._condition_value(control), "how often")
        if not (0 <= count <= REPEAT_MAX):
            raise GcodeError(f"REPEAT [{count}]", f"0 to {REPEAT_MAX:g}", "correct it")
        self._calls[-1].counts[self.index] = count
        return self.index + 1 if count else control.end + 1

    def _again(self, control: _Control) -> int:
        counts = self._calls[-1].counts
        counts[control.head] -= 1
        return control.head + 1 if counts[control.head] > 0 else self.index + 1

    def _call(self, control: _Control) -> int:
        scanner, arguments = Scanner(control.rest, self._parameters), list[float]()
        while not scanner.ended():
            arguments.append(scanner.expression())
        if not (len(arguments) <= ARGUMENTS_MAX):
            raise GcodeError(f"{len(arguments)} arguments", f"<= {ARGUMENTS_MAX}", "use global parameters")
        if control.label not in self._subs:
            bound = "a subroutine that this file defines above the call"
            raise GcodeError(f"call of O{control.label}", bound, "put the subroutine's lines into this file")
        if not (len(self._calls) <= NESTING_MAX):
            raise GcodeError(f"over {NESTING_MAX} calls within calls", f"<= {NESTING_MAX}", "call less deep")
        self._calls.append(_Call(control.label, self.index + 1))
        self._parameters.enter(arguments)
        return self._subs[control.label] + 1

    def _return(self, control: _Control) -> int:
        value = self._condition_value(control) if control.rest else None
        self._parameters.leave(value)
        return self._calls.pop().back

    def _condition(self, control: _Control) -> bool:
        return self._condition_value(control) != 0.0

    def _condition_value(self, control: _Control) -> float:
        scanner = Scanner(control.rest, self._parameters)
        value = scanner.expression()
        if not scanner.ended():
            raise GcodeError(f'"{scanner.rest}"', "nothing after the expression", "correct the line")
        return value


def _extent(lines: Sequence[str]) -> tuple[int, int, bool]:
    """First line, the line after the last, and whether a percent sign closes what another has opened."""
    first = next((index for index, line in enumerate(lines) if line.strip()), len(lines))
    if first == len(lines) or lines[first].strip() != "%":
        return 0, len(lines), False
    last = next((index for index in range(first + 1, len(lines)) if lines[index].strip() == "%"), None)
    return (first + 1, len(lines), False) if last is None else (first + 1, last, True)


def _controls(lines: Sequence[str], first: int, last: int) -> dict[int, _Control]:
    """Every O-word, with where it leads.

    Raises:
        GcodeError: names the line.
    """
    builder = _Builder()
    for index in range(first, last):
        if _O_LINE.match(lines[index]):
            try:
                builder.add(index, _parsed(lines[index]))
            except GcodeError as error:
                raise GcodeError(error.found, error.bound, error.remedy, index + 1) from None
    builder.finish()
    return builder.controls


def _parsed(line: str) -> _Control:
    text = bare(line)
    match = _O_TEXT.fullmatch(text)
    if match is None:
        bound = "O, a number or <name>, and SUB, CALL, IF, WHILE, DO, REPEAT or one of their kind"
        remedy = "take out the program number" if text[1:].isdigit() else "correct the line"
        raise GcodeError(f'"{text[:40]}"', bound, remedy)
    label, keyword, rest = match.groups()
    if keyword in _BARE and rest:
        raise GcodeError(f'"{rest[:40]}" after {keyword}', "nothing", "put it into a line of its own")
    return _Control(keyword, label.lstrip("0") or "0", rest)


class _Builder:
    """Joins the O-words of a file: each closes the innermost one that is open, or opens one of its own."""

    def __init__(self) -> None:
        self.controls: dict[int, _Control] = {}
        self.open: list[int] = []
        self._labels: set[tuple[int, str]] = set()
        self._branches: dict[int, list[int]] = {}
        self._exits: dict[int, list[int]] = {}
        self._continued: set[int] = set()
        self._kinds: set[str] = set()
        self._left: dict[str, int] = {}

    def add(self, index: int, control: _Control) -> None:
        """The O-word of the next line that has one.

        Raises:
            GcodeError: it fits nothing.
        """
        self.controls[index] = control
        keyword = control.keyword
        if keyword == "WHILE" and self._innermost(control, {"DO"}):
            self._close(index, control)
        elif keyword in _CLOSES:
            self._require(control, _CLOSES[keyword])
            self._close(index, control)
        elif keyword in ("BREAK", "CONTINUE"):
            head = self._enclosing(control, _LOOPS)
            self._left.setdefault(self.controls[head].keyword, index)
            self._exits.setdefault(head, []).append(index)
            if keyword == "CONTINUE" and self.controls[head].keyword == "DO":
                self._continued.add(head)
        elif keyword == "RETURN":
            self._enclosing(control, {"SUB"})
        elif keyword != "CALL":
            self._open(index, control)

    def _open(self, index: int, control: _Control) -> None:
        if not (len(self.open) < NESTING_MAX):
            raise GcodeError(f"over {NESTING_MAX} levels", f"<= {NESTING_MAX}", "use subroutines")
        if control.keyword == "SUB" and self.open:
            raise GcodeError("SUB within another O-word", "outside of all", "close the other one first")
        if control.keyword in _LOOPS:
            self._kinds.add(control.keyword)
            self._check_continued()
        outermost = self.open[0] if self.open else index
        around = outermost if self.controls[outermost].keyword == "SUB" and self.open else -1
        if (around, control.label) in self._labels:
            raise GcodeError(
                f"a second {control.keyword} O{control.label}", "one of each label", "rename one"
            )
        self._labels.add((around, control.label))
        self.open.append(index)
        self._branches[index] = [index]

    def _close(self, index: int, control: _Control) -> None:
        head = self.open[-1]
        if control.keyword in ("ELSEIF", "ELSE"):
            self._branches[head].append(index)
            return
        self.open.pop()
        branches = [*self._branches.pop(head), index]
        for branch, following in pairwise(branches):
            self.controls[branch].end = following
            self.controls[branch].tail = index
        control.head = head
        for leaving in self._exits.pop(head, ()):
            self.controls[leaving].head, self.controls[leaving].end = head, index

    def finish(self) -> None:
        """The file has no more lines.

        Raises:
            GcodeError: names the line of an O-word that is not closed, or of a BREAK that is not safe.
        """
        if self.open:
            index = self.open[-1]
            control = self.controls[index]
            found = f"O{control.label} {control.keyword} without its end"
            raise GcodeError(found, "closed", f"close O{control.label}", index + 1)
        for kind, index in self._left.items():
            others = _ALONE[kind] & self._kinds
            if others:
                control = self.controls[index]
                found = f"O{control.label} {control.keyword} of a {kind}"
                bound = (
                    f"in a file without {' and '.join(sorted(others))} loops: LinuxCNC then executes others"
                )
                raise GcodeError(found, bound, "write all loops as WHILE and ENDWHILE", index + 1)

    def _check_continued(self) -> None:
        """Refuses what LinuxCNC does not execute as it is written: CONTINUE of a DO ends at a loop in between."""
        head = next((head for head in self.open if head in self._continued), None)
        if head is not None:
            label = self.controls[head].label
            bound = f"no loop between O{label} CONTINUE and the end of its DO"
            raise GcodeError("a loop", bound, f"use O{label} WHILE and ENDWHILE, or IF")

    def _innermost(self, control: _Control, keywords: set[str]) -> bool:
        """Whether the innermost O-word that is open has this label, and its last branch is one of these."""
        if not self.open:
            return False
        last = self.controls[self._branches[self.open[-1]][-1]]
        return last.label == control.label and last.keyword in keywords

    def _require(self, control: _Control, keywords: set[str]) -> None:
        if not self._innermost(control, keywords):
            bound = f"after {' or '.join(sorted(keywords))} of this label, with all in between closed"
            raise GcodeError(f"O{control.label} {control.keyword}", bound, "correct the labels or the order")

    def _enclosing(self, control: _Control, keywords: frozenset[str] | set[str]) -> int:
        for index in reversed(self.open):
            around = self.controls[index]
            if around.label == control.label and around.keyword in keywords:
                return index
        bound = f"within {' or '.join(sorted(keywords))} of this label"
        raise GcodeError(f"O{control.label} {control.keyword}", bound, "correct the label")
