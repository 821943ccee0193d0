"""Numbers of RS-274: parameters and expressions, with the precedence, tolerances and angles (deg) of LinuxCNC.

An expression is evaluated while it is read, as the interpreter of LinuxCNC does. What it does not define is refused:
a parameter that nothing has set holds there what an earlier program left, and nobody sees that in this file.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

PARAMETERS_MAX: Final = 5602
MACHINE_FIRST: Final = 5061
"""From here on the machine keeps parameters for itself: probe results, offsets, positions, tool."""
LOCAL_MAX: Final = 30
"""Parameters 1 to 30 belong to a subroutine; the arguments of its call are the first of them."""
NAMES_MAX: Final = 10_000
"""Named parameters of one file or of one call."""
BRACKETS_MAX: Final = 30
EQUAL: Final = 1e-4
"""EQ and NE tell numbers apart that differ by this much, and an index may be this far from an integer."""
PREDEFINED: Final = frozenset(
    [
        "_vmajor",
        "_vminor",
        "_line",
        "_motion_mode",
        "_plane",
        "_ccomp",
        "_metric",
        "_imperial",
        "_absolute",
        "_incremental",
        "_inverse_time",
        "_units_per_minute",
        "_units_per_rev",
        "_coord_system",
        "_tool_offset",
        "_retract_r_plane",
        "_retract_old_z",
        "_spindle_rpm_mode",
        "_spindle_css_mode",
        "_ijk_absolute_mode",
        "_lathe_diameter_mode",
        "_lathe_radius_mode",
        "_spindle_on",
        "_spindle_cw",
        "_mist",
        "_flood",
        "_speed_override",
        "_feed_override",
        "_adaptive_feed",
        "_feed_hold",
        "_feed",
        "_rpm",
        "_x",
        "_y",
        "_z",
        "_a",
        "_b",
        "_c",
        "_u",
        "_v",
        "_w",
        "_current_tool",
        "_current_pocket",
        "_selected_tool",
        "_selected_pocket",
        "_value",
        "_value_returned",
        "_task",
        "_call_level",
        "_remap_level",
    ]
)
"""What the interpreter sets itself; two of them, of a returned value, are known here."""

_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_NAME: Final = re.compile(r"<([^<>\[\]#=]{1,60})>")
_FUNCTION: Final = re.compile(r"ABS|ACOS|ASIN|ATAN|COS|EXP|EXISTS|FIX|FUP|LN|ROUND|SIN|SQRT|TAN")
_OPERATOR: Final = re.compile(r"\*\*|[-+*/]|MOD|EQ|NE|GT|GE|LT|LE|AND|OR|XOR")
_PRECEDENCE: Final[Mapping[str, int]] = MappingProxyType(
    {"**": 5, "*": 4, "/": 4, "MOD": 4, "+": 3, "-": 3}
    | dict.fromkeys(("EQ", "NE", "GT", "GE", "LT", "LE"), 2)
    | dict.fromkeys(("AND", "OR", "XOR"), 1)
)


class GcodeError(ValueError):
    """No such program: what was found, what would be accepted, and what to do.

    Attributes:
        line: where, from 1; 0 for the line that is being executed.
    """

    def __init__(self, found: str, bound: str, remedy: str = "", line: int = 0) -> None:
        super().__init__(f"{found}, must be {bound}")
        self.found = found
        self.bound = bound
        self.remedy = remedy
        self.line = line


@dataclass(slots=True)
class _Scope:
    """What one call of a subroutine, or the main program, has for itself."""

    numbers: dict[int, float] = field(default_factory=dict)
    names: dict[str, float] = field(default_factory=dict)
    unset: float | None = None


class Parameters:
    """All parameters of a program while it runs."""

    def __init__(self) -> None:
        self._numbers: dict[int, float] = {}
        self._names: dict[str, float] = {}
        self._scopes = [_Scope()]

    def enter(self, arguments: list[float]) -> None:
        """A subroutine begins: its parameters are the arguments, and 0 up to the thirtieth."""
        self._scopes.append(_Scope(dict(enumerate(arguments, start=1)), unset=0.0))

    def leave(self, value: float | None) -> None:
        """It ends, with a value or without one."""
        self._scopes.pop()
        self._names["_value"] = 0.0 if value is None else value
        self._names["_value_returned"] = float(value is not None)

    def number(self, index: int) -> float:
        """The value of a numbered parameter.

        Raises:
            GcodeError: the machine's, none at all, or never set.
        """
        check_index(index)
        scope = self._scopes[-1]
        value = scope.numbers.get(index, scope.unset) if index <= LOCAL_MAX else self._numbers.get(index)
        if value is None:
            bound = "set before it is used: what it holds otherwise an earlier program has left"
            raise GcodeError(f"#{index}", bound, f"set #{index} in this file, before this line")
        return value

    def named(self, name: str) -> float:
        """The value of a named parameter; those that begin with ``_`` are global.

        Raises:
            GcodeError: the machine's, or never set.
        """
        value = self._home(name).get(name)
        if value is None and name in PREDEFINED:
            raise GcodeError(
                f"#<{name}>", "a parameter of this file: the machine keeps it", "write its value"
            )
        if value is None:
            raise GcodeError(f"#<{name}>", "set before it is used", f"set #<{name}> before this line")
        return value

    def exists(self, name: str) -> bool:
        """Whether a named parameter is set.

        Raises:
            GcodeError: a global one that this file has not set, so that only the machine knows.
        """
        found = name in self._home(name)
        if not found and name.startswith("_"):
            bound = "a parameter that this file has set, or a local one: an earlier program may have set a global one"
            raise GcodeError(f"EXISTS[#<{name}>]", bound, f"set #<{name}> before this line")
        return found

    def set(self, key: int | str, value: float) -> None:
        """Assigns a numbered or a named parameter.

        Raises:
            GcodeError: the machine's, or too many.
        """
        if isinstance(key, int):
            check_index(key)
            (self._scopes[-1].numbers if key <= LOCAL_MAX else self._numbers)[key] = value
            return
        if key in PREDEFINED:
            raise GcodeError(f"#<{key}> set", "another name: the machine keeps this one", "rename it")
        home = self._home(key)
        if key not in home and not (len(home) < NAMES_MAX):
            raise GcodeError(f"over {NAMES_MAX} named parameters", f"<= {NAMES_MAX}", "use fewer names")
        home[key] = value

    def _home(self, name: str) -> dict[str, float]:
        return self._names if name.startswith("_") else self._scopes[-1].names


def check_index(index: int) -> None:
    """Refuses a parameter that does not exist, or is the machine's.

    Raises:
        GcodeError: says which.
    """
    if not (1 <= index <= PARAMETERS_MAX):
        raise GcodeError(f"#{index}", f"#1 to #{PARAMETERS_MAX}", "use another number")
    if not (index < MACHINE_FIRST):
        bound = f"below #{MACHINE_FIRST}: the machine keeps the others, and this file does not hold its value"
        raise GcodeError(f"#{index}", bound, "write the value itself")


class Scanner:
    """Reads numbers from a line of upper case without blanks and comments, from its beginning to its end.

    Args:
        text: the line.
        parameters: what ``#`` means.
    """

    def __init__(self, text: str, parameters: Parameters) -> None:
        self.text = text
        self.at = 0
        self._parameters = parameters
        self._depth = 0

    @property
    def rest(self) -> str:
        """What has not been read yet, its beginning."""
        return self.text[self.at : self.at + 20]

    def ended(self) -> bool:
        """Whether the whole line has been read."""
        return self.at >= len(self.text)

    def take(self, sign: str) -> bool:
        """Reads this sign if it is next."""
        if not self.text.startswith(sign, self.at):
            return False
        self.at += len(sign)
        return True

    def need(self, sign: str) -> None:
        """Reads this sign.

        Raises:
            GcodeError: another one is next.
        """
        if not self.take(sign):
            raise GcodeError(self._found(), f'"{sign}" here', "correct the expression")

    def value(self) -> float:
        """A number, a parameter, a function, or an expression in brackets, perhaps with a sign.

        Raises:
            GcodeError: anything else, or a value that is none.
        """
        match = _NUMBER.match(self.text, self.at)
        if match:
            self.at = match.end()
            return float(match[0])
        self._depth += 1
        if not (self._depth <= BRACKETS_MAX):
            raise GcodeError(
                f"over {BRACKETS_MAX} levels of brackets", f"<= {BRACKETS_MAX}", "use parameters"
            )
        value = self._compound()
        self._depth -= 1
        return _finite(value)

    def expression(self) -> float:
        """``[...]``.

        Raises:
            GcodeError: it is not closed, or not an expression.
        """
        self.need("[")
        value = self._level(1)
        self.need("]")
        return value

    def key(self) -> int | str:
        """What follows ``#``: the number or the name of a parameter.

        Raises:
            GcodeError: neither.
        """
        if self.text.startswith("<", self.at):
            match = _NAME.match(self.text, self.at)
            if match is None:
                raise GcodeError(self._found(), "a name of 1 to 60 characters in < >", "correct the name")
            self.at = match.end()
            return match[1].lower()
        return integer(self.value(), "the number of a parameter")

    def _compound(self) -> float:
        if self.text.startswith("[", self.at):
            return self.expression()
        if self.take("#"):
            key = self.key()
            return self._parameters.number(key) if isinstance(key, int) else self._parameters.named(key)
        if self.take("-"):
            return -self.value()
        if self.take("+"):
            return self.value()
        return self._function()

    def _function(self) -> float:
        match = _FUNCTION.match(self.text, self.at)
        if match is None:
            raise GcodeError(self._found(), "a number, a parameter, a function or [expression]", "correct it")
        self.at = match.end()
        if match[0] == "EXISTS":
            return self._exists()
        argument = self.expression()
        if match[0] == "ATAN":
            self.need("/")
            return math.degrees(math.atan2(argument, self.expression()))
        try:
            return _FUNCTIONS[match[0]](argument)
        except (ValueError, OverflowError):
            bound = "a value for which the function is defined, with a result a double can hold"
            raise GcodeError(f"{match[0]}[{argument:g}]", bound, "correct the argument") from None

    def _exists(self) -> float:
        self.need("[#")
        key = self.key()
        self.need("]")
        if isinstance(key, int):
            raise GcodeError(f"EXISTS[#{key}]", "a named parameter", "name it")
        return float(self._parameters.exists(key))

    def _level(self, lowest: int) -> float:
        """Operators of this precedence or a higher one, from left to right."""
        left = self.value()
        while True:
            match = _OPERATOR.match(self.text, self.at)
            if match is None or _PRECEDENCE[match[0]] < lowest:
                return left
            self.at = match.end()
            right = self._level(_PRECEDENCE[match[0]] + 1)
            left = _applied(match[0], left, right)

    def _found(self) -> str:
        return f'"{self.rest}"' if not self.ended() else "the end of the line"


def integer(value: float, what: str) -> int:
    """The integer that a value is, within ``EQUAL``.

    Raises:
        GcodeError: it is none.
    """
    nearest = round(value)
    if not (abs(value - nearest) <= EQUAL):
        raise GcodeError(f"{value:g}", f"an integer, {what}", "correct it")
    return nearest


def _applied(operator: str, left: float, right: float) -> float:
    try:
        return _finite(_OPERATORS[operator](left, right))
    except (ValueError, ArithmeticError):
        bound = "defined, with a result a double can hold"
        raise GcodeError(f"{left:g} {operator} {right:g}", bound, "correct the expression") from None


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise GcodeError(f"{value}", "a finite number", "correct the expression")
    return value


def _modulo(left: float, right: float) -> float:
    """Never negative, whatever the signs."""
    rest = math.fmod(left, right)
    return rest + abs(right) if rest < 0.0 else rest


def _nearest(value: float) -> float:
    """Halves away from zero."""
    return math.floor(value + 0.5) if value >= 0.0 else math.ceil(value - 0.5)


_FUNCTIONS: Final[Mapping[str, Callable[[float], float]]] = MappingProxyType(
    {
        "ABS": abs,
        "ACOS": lambda x: math.degrees(math.acos(x)),
        "ASIN": lambda x: math.degrees(math.asin(x)),
        "COS": lambda x: math.cos(math.radians(x)),
        "EXP": math.exp,
        "FIX": lambda x: float(math.floor(x)),
        "FUP": lambda x: float(math.ceil(x)),
        "LN": math.log,
        "ROUND": _nearest,
        "SIN": lambda x: math.sin(math.radians(x)),
        "SQRT": math.sqrt,
        "TAN": lambda x: math.tan(math.radians(x)),
    }
)
_OPERATORS: Final[Mapping[str, Callable[[float, float], float]]] = MappingProxyType(
    {
        "**": math.pow,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "MOD": _modulo,
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "EQ": lambda a, b: float(abs(a - b) < EQUAL),
        "NE": lambda a, b: float(abs(a - b) >= EQUAL),
        "GT": lambda a, b: float(a > b),
        "GE": lambda a, b: float(a >= b),
        "LT": lambda a, b: float(a < b),
        "LE": lambda a, b: float(a <= b),
        "AND": lambda a, b: float(bool(a) and bool(b)),
        "OR": lambda a, b: float(bool(a) or bool(b)),
        "XOR": lambda a, b: float(bool(a) != bool(b)),
    }
)
