"""Tool paths as APT/CL cutter location files (ISO 4343 and what CAM systems make of it): a table of major words.

Every statement is understood or refused; nothing that could move the tool is passed over. Where dialects differ, a file
is read only if they agree about it:

* **Three numbers after an axis of six.** Some systems leave an axis out that has not changed, others write three numbers
  only where the axis is that of the coordinate system. Both mean the same until a statement begins another section
  (``LOAD``, ``LOADTL``, ``TOOL PATH``, ``CSYS``, ``MSYS``, ``TRNTYP``, ``MULTAX``); behind one, three numbers are read
  only while the axis kept is the z axis of the coordinate system, which for ``CSYS`` is its third column. So a section
  milled along 1,0,0 may not be followed by three numbers in one whose z axis is 0,0,1 without saying the axis once.
  (Where a file as found turns to a plane at right angles, ``CSYS`` has 1,0,0 as its third column and every point of the
  section has the same axis: both senses agree there, and nothing in it tells which one its writer meant.)
* **Depths of a cycle** are measured along the tool axis from the point of each ``GOTO``: ``FEDTO`` toward the tip,
  ``RAPTO`` and ``RTRCTO`` toward the holder. In a file as found the tool comes from 25 mm, drills at points of -6.761364 mm
  with ``RTRCTO,31.761364``, which is 25 mm to the last digit from the point and from nowhere else; that the other two
  are measured from there as well is the sense of the standard, a positive ``FEDTO`` leaves no other direction.
  All moves of a cycle stand on one line, so whether a machine lifts the drill a little between two pecks or wholly out
  changes nothing of where it is: each peck returns to the clearance. From hole to hole the tool moves at the height
  where it stands, and rises to the clearance first where it is below it.
* **RAPID** holds for the next point alone.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.config.load import decode
from cutgate.config.refusal import InputError
from cutgate.runtime.plan.poses import AXIS_DECIMALS, COORDINATE_MM, UNIT_AXIS, shorter
from cutgate.runtime.plan.toolpath.circular import RADIUS_MM, CircleError, CircularMove
from cutgate.runtime.plan.toolpath.model import Reading, Told, ToolPath, check_lines
from cutgate.runtime.plan.toolpath.trace import Point, Trace

INCH_MM: Final = 25.4
UNITS: Final = {"MM": 1.0, "INCH": INCH_MM, "INCHES": INCH_MM}
STATEMENT_MAX: Final = 2000
"""Characters of one statement, continued lines together."""
NAME_MAX: Final = 100
"""Characters of a tool's name."""
LENGTH_MAX_MM: Final = 2000.0
FEED_MM_S: Final = (0.001, 10_000.0)
PECK_MIN_MM: Final = 0.001
DEPTH_MAX_MM: Final = 2 * COORDINATE_MM
CLOSE_MM: Final = 0.002
"""Start and end of a circle that are nearer, and not the same: rounding could have made them of a whole turn."""
CUTCOM_OPTION: Final = "--cutcom-is-tool-centre"
ARC_OPTION: Final = "--arc-tolerance-mm"
CORRECT_CIRCLE: Final = "correct centre, axis or points, or have it written as GOTO"

_NUMBER: Final = (
    r"[ \t]*+[+-]?+(?:[0-9]{1,30}+(?:\.[0-9]{0,30}+)?+|\.[0-9]{1,30}+)(?:[eE][+-]?+[0-9]{1,2}+)?+[ \t]*+"
)
"""Nothing that was matched is given back, and what it matches is finite as a double, in inches too."""
_ONE: Final = re.compile(_NUMBER)
_LIST: Final = re.compile(f"{_NUMBER}(?:,{_NUMBER})*+")
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]|\r(?!\n)")
_UP: Final = (0.0, 0.0, 1.0)
_IDENTITY: Final = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
_MSYS_IDENTITY: Final = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]

Handler = Callable[["_Program", int, str], str]
"""Does what a statement says; takes its line and what follows the slash, returns what was understood."""


def read_apt(file: object, data: bytes, reading: Reading, pose_limit: int, told: Told | None) -> ToolPath:
    """The poses of an APT/CL file.

    Strictly UTF-8, lines ended by LF or CRLF, upper or lower case; ``$$`` begins a comment, ``$`` at the end of a line
    continues the statement. The last statement is ``FINI`` (``END``, ``END-OF-PATH``): without it a file may be the
    first part of one.

    Raises:
        InputError: names the line, what was found, what is read and what to do.
    """
    check_lines(file, data, pose_limit)
    program = _Program(file, reading, pose_limit, told)
    return program.run(decode(file, data))


@dataclass(frozen=True, slots=True)
class _Rate:
    """A feed as it is written: mm per minute, or mm per revolution of the spindle."""

    mm: float
    per_revolution: bool


FEED_UNITS: Final[dict[str, tuple[float | None, bool]]] = {
    "MMPM": (1.0, False),
    "IPM": (INCH_MM, False),
    "PERMIN": (None, False),
    "MMPR": (1.0, True),
    "IPR": (INCH_MM, True),
    "PERREV": (None, True),
}
"""The length that a unit of feed stands for, mm, None for the file's own; and whether it is per revolution."""


@dataclass(frozen=True, slots=True)
class _Circle:
    """A ``CIRCLE`` whose ``GOTO`` comes next; mm, the normal of length 1, the radius None where it is not given."""

    centre: Point
    normal: Point
    radius_mm: float | None


@dataclass(frozen=True, slots=True)
class _Cycle:
    """A drilling cycle; lengths in mm along the tool axis from the point, ``depth`` toward the tip, others away.

    Attributes:
        depth, clearance, retract: of the hole; where the feed begins; where the tool goes between two holes.
        first, step: depths of the first peck and of each further one; both ``depth`` where the hole has no pecks.
        rate: its own feed, or None for that of ``FEDRAT``.
    """

    depth: float
    clearance: float
    retract: float
    first: float
    step: float
    rate: _Rate | None

    @property
    def pecks(self) -> int:
        return 1 + max(0, math.ceil((self.depth - self.first) / self.step))


@dataclass(frozen=True, slots=True)
class _Next:
    """What the next statement must be, or else ``bound`` and ``remedy`` of its refusal."""

    majors: frozenset[str]
    found: str
    bound: str
    remedy: str


CYCLE_KEYS: Final = {
    "FEDTO": "depth",
    "RAPTO": "clearance",
    "CLEAR": "clearance",
    "RTRCTO": "retract",
    "1STPECK": "first",
    "SUBPECK": "step",
    "INCR": "increment",
    "STEP": "increment",
}
CYCLE_LENGTHS: Final = {
    "FEDTO": "the depth below the point, a positive number",
    "RAPTO": "the height above the point where the feed begins",
    "RTRCTO": "the height above the point to which the tool leaves, no lower than RAPTO",
    "1STPECK": "the depth of the first peck",
    "SUBPECK": "the depth of each further peck",
    "INCR": "the depth of each peck, as STEP is",
}
HOLES: Final = "have the holes written as GOTO"
_PECKING: Final = frozenset({"first", "step", "increment"})
CYCLES: Final = {
    "DRILL": (frozenset[str](),),
    "DEEP": (frozenset({"first", "step"}), frozenset({"increment"})),
    "DEEP2": (frozenset({"first", "step"}), frozenset({"increment"})),
}
"""Each cycle, with the lengths of its pecks in one of these ways."""
SPINDLE: Final = frozenset({"RPM", "CLW", "CCLW", "ON"})
"""What may stand beside the speed of a spindle; with anything else its revolutions are not known."""

# What keeps the tool from moving: each is set by one statement and removed by others.
_NO_UNIT: Final = (
    None,
    "the file says no unit of length before its first length",
    "add the line UNITS/MM or UNITS/INCHES at its beginning, whichever it was written in",
)
_HOME: Final = (
    "a motion behind GOHOME",
    "behind LOAD or LOADTL: the way home, and back from there, is not in the file",
    "part the file at GOHOME, or have the way home written as GOTO",
)
_ENDED: Final = (
    "a motion behind END",
    "before it",
    "part the file at END",
)


class _Program:
    """What the statements so far have set, and the trace of the tool.

    Args:
        file: for messages.
        reading: what is declared of the file.
        pose_limit: most poses of all cuts together.
        told: takes what was understood of each statement.
    """

    def __init__(self, file: object, reading: Reading, pose_limit: int, told: Told | None) -> None:
        self._file = file
        self._reading = reading
        self._limit = pose_limit
        self._told = told
        self._trace = Trace(file, pose_limit)
        self._unit: str | None = None
        self._mm = math.nan  # of a length of the file
        self._bars: dict[str, tuple[str | None, str, str]] = {"unit": _NO_UNIT}
        self._next: _Next | None = None
        self._tool = ""
        self._length_mm: float | None = None
        self._operation_tool: str | None = None  # of the last TOOL PATH, unless another was mounted since
        self._operation_room = -1  # when it was read
        self._stood: tuple[int, int, Point, Point] | None = None  # room, line and pose of a FROM
        self._axis: Point = _UP
        self._axis_read: Point = _UP  # the axis as the file has it
        self._frame: Point = _UP  # z of the coordinate system
        self._settled = True  # six numbers, or none but the frame's axis, since the section began
        self._world = False
        self._rapid = False
        self._rate: _Rate | None = None
        self._feed_unit: str | None = None
        self._feed_mm_s: float | None = None
        self._feed_due = False  # it is per revolution, and to be computed where it is needed
        self._rpm: float | None = None
        self._circle: _Circle | None = None
        self._cycle: _Cycle | None = None

    # ------------------------------------------------------------ statements

    def run(self, text: str) -> ToolPath:
        self._check_characters(text)
        told, line, major = self._told, 0, ""
        for line, statement in self._statements(text):
            head, _, rest = statement.partition("/")
            major = head.strip()
            handler = MAJOR.get(major)
            if handler is None:
                major, rest = self._spelled(line, statement)
                handler = MAJOR[major]
            if self._next is not None and major not in self._next.majors:
                raise self._refusal(line, f"{major} {self._next.found}", self._next.bound, self._next.remedy)
            understood = handler(self, line, rest)
            if told is not None:
                told(line, understood)
        if major not in ENDS:
            found = f"the last statement, {major}" if major else "a file without a statement"
            remedy = "the file may be cut off: have it written or copied anew, as a whole"
            raise self._refusal(max(line, 1), found, "FINI at the end", remedy)
        return self._trace.finish()

    def _check_characters(self, text: str) -> None:
        if found := _CONTROL.search(text):
            line = text.count("\n", 0, found.start()) + 1
            value = f"the control character 0x{ord(found.group()):02x}"
            raise self._refusal(
                line, value, "text, in lines ended by LF or CRLF", "save the file as plain text"
            )

    def _lines(self, text: str) -> Iterator[tuple[int, str]]:
        """Line by line: a list of all would take many times the memory of a file of empty ones."""
        start, number, length = 0, 0, len(text)
        while start < length:
            end = text.find("\n", start)
            end = length if end < 0 else end
            number += 1
            yield number, text[start:end].strip()
            start = end + 1

    def _statements(self, text: str) -> Iterator[tuple[int, str]]:
        """Each statement with the line on which it begins; without comments, continued lines joined."""
        parts: list[str] = []
        size = first = 0
        for number, whole in self._lines(text):
            line, continued = whole, False
            if "$" in whole:
                line = whole.partition("$$")[0].rstrip()
                continued = line.endswith("$")
                line = line.removesuffix("$")
            if not (line or continued):
                continue
            if parts and "/" in line:
                found, bound = "a statement in the middle of one that $ continues", "its rest"
                raise self._refusal(number, found, bound, f"remove the $ above it, or complete line {first}")
            first = first if parts else number
            size = 1 + len(line) + (size if parts else 0)  # with what separates the lines
            if not (size <= STATEMENT_MAX + 1):
                found, bound = f"a statement of over {STATEMENT_MAX} characters", f"<= {STATEMENT_MAX}"
                raise self._refusal(first, found, bound, "shorten it; no statement that is read is so long")
            if continued:
                self._check_continued(number, line)
            # A number does not go on across lines: a space keeps its two parts apart, and they are refused.
            if parts or continued:
                parts.append(line)
                if continued:
                    continue
                line, parts = " ".join(parts).strip(), []
            yield first, line
        if parts:
            raise self._refusal(
                first, "a statement that $ continues to the end of the file", "complete", "add its rest"
            )

    def _check_continued(self, number: int, line: str) -> None:
        """Text goes to the end of its line: whether a ``$`` there continues it, dialects do not agree."""
        if _first(line) in TEXTS:
            found, bound = f"{_first(line)} with a $ at its end", "text without it"
            raise self._refusal(
                number, found, bound, "remove the $: it could make the next line part of the text"
            )

    def _spelled(self, line: int, statement: str) -> tuple[str, str]:
        """A major word of the table, and what follows it, of a statement that is spelled in another way.

        Raises:
            InputError: no major word of the table.
        """
        head, _, rest = statement.partition("/")
        name, first = " ".join(_upper(head).split()), _first(statement)
        if name in MAJOR:
            return name, rest
        if first in TEXTS:
            return first, ""
        if name.startswith(PREFIX) and " " not in name:
            return PREFIX, rest
        bound = "a statement that is read here (docs/files.md, Tool path: APT/CL)"
        remedy = (
            "have the CAM system write all motion as GOTO and CIRCLE; "
            "delete the line only where it neither moves the tool nor changes coordinates"
        )
        raise self._refusal(line, statement, bound, remedy)

    def _refusal(self, line: int, found: str | None, bound: str, remedy: str) -> InputError:
        return InputError(self._file, f"line {line}", found, bound, remedy)

    def _unread(
        self, line: int, major: str, rest: str, bound: str, remedy: str = "correct the line"
    ) -> InputError:
        return self._refusal(line, f"{major}/{rest}", bound, remedy)

    # ------------------------------------------------------------ numbers

    def _numbers(self, line: int, major: str, rest: str, counts: tuple[int, ...], bound: str) -> list[float]:
        if not _LIST.fullmatch(rest):
            raise self._unread(line, major, rest, f"{major}/{bound}", "write it with plain decimal numbers")
        values = list(map(float, rest.split(",")))
        if len(values) not in counts:
            less = "complete it" if len(values) < min(counts) else "have it written without the others"
            remedy = f"it has {len(values)} of them: {less}"
            raise self._unread(line, major, rest, f"{major}/{bound}", remedy)
        return values

    def _number(self, line: int, major: str, name: str, text: str) -> float:
        if not _ONE.fullmatch(text):
            raise self._refusal(line, f"{major} with {name} {text}", "a decimal number", "correct it")
        return float(text)

    def _scale(self, line: int) -> float:
        """Millimetres of a length of 1; refused where the file has not said."""
        if self._unit is None:
            raise self._refusal(line, *_NO_UNIT)
        return self._mm

    def _tip(self, values: list[float]) -> Point:
        mm = self._mm
        return values[0] * mm, values[1] * mm, values[2] * mm

    def _normalised(self, line: int, values: list[float], what: str) -> Point:
        x, y, z = values
        length = math.sqrt(x * x + y * y + z * z)
        if not (abs(length - 1.0) <= UNIT_AXIS):
            bound = f"of length 1 within {UNIT_AXIS:g}"
            remedy = f"normalise it, with {AXIS_DECIMALS} decimals or more"
            raise self._refusal(line, f"{what} of length {length:.6g}", bound, remedy)
        return x / length, y / length, z / length

    def _axis_of(self, line: int, values: list[float]) -> Point:
        """The tool axis given; it is that of what follows."""
        read = values[0], values[1], values[2]
        if read != self._axis_read or not self._settled:
            self._axis = self._normalised(line, values, "a tool axis")
            self._axis_read, self._settled = read, True
        return self._axis

    def _axis_kept(self, line: int) -> Point:
        """The tool axis of a point of three numbers; see the top of this module."""
        if not self._settled and self._axis != self._frame:
            found = f"three numbers behind the tool axis {_at(self._axis)}"
            bound = f"six: the coordinate system that begins here has the axis {_at(self._frame)}"
            raise self._refusal(
                line, found, bound, "write the tool axis i,j,k with the section's first point"
            )
        return self._axis

    # ------------------------------------------------------------ motion

    def _check_movable(self, line: int) -> None:
        """Refuses a motion that the file leaves open."""
        if self._bars:
            raise self._refusal(line, *next(iter(self._bars.values())))

    def _check_no_cycle(self, line: int, found: str) -> None:
        if self._cycle is not None:
            remedy = f"write CYCLE/OFF before it, or {HOLES}"
            raise self._refusal(line, f"{found} while a cycle is on", "behind CYCLE/OFF", remedy)

    def goto(self, line: int, rest: str) -> str:
        self._check_movable(line)
        tip, axis = self._pose_of(line, "GOTO", rest)
        return self._go(line, tip, axis)

    def godlta(self, line: int, rest: str) -> str:
        self._check_movable(line)
        self._check_no_cycle(line, "GODLTA")
        delta = self._tip(self._numbers(line, "GODLTA", rest, (3,), "dx,dy,dz"))
        (x, y, z), _ = self._standing(line, "GODLTA")
        return self._go(line, (x + delta[0], y + delta[1], z + delta[2]), self._axis_kept(line))

    def from_(self, line: int, rest: str) -> str:
        self._check_movable(line)
        self._check_no_cycle(line, "FROM")
        pose = self._pose_of(line, "FROM", rest)
        standing = self._trace.pose
        if standing is not None and standing != pose:
            bound = f"where the tool stands, {_at(standing[0])}: FROM moves nothing"
            raise self._unread(line, "FROM", rest, bound, "write GOTO if the tool moves there")
        self._trace.move(line, *pose, positioning=True)
        self._stood = (self._trace.room, line, *pose)
        return f"stands at {_pose(pose)}"

    def rapid(self, line: int, rest: str) -> str:
        self._check_no_cycle(line, "RAPID")
        if rest.strip():
            raise self._unread(line, "RAPID", rest, "RAPID alone")
        self._rapid = True
        return "the next point is a positioning move"

    def gohome(self, _line: int, _rest: str) -> str:
        if self._trace.pose is not None:
            self._bars["home"] = _HOME
        return "ends this tool's part: its way home is not in the file"

    def _pose_of(self, line: int, major: str, rest: str) -> tuple[Point, Point]:
        values = self._numbers(line, major, rest, (3, 6), "x,y,z or x,y,z,i,j,k")
        axis = self._axis_kept(line) if len(values) == 3 else self._axis_of(line, values[3:])
        return self._tip(values), axis

    def _standing(self, line: int, major: str) -> tuple[Point, Point]:
        pose = self._trace.pose
        if pose is None:
            found, bound = f"{major} before the tool's first point", "behind FROM or GOTO"
            raise self._refusal(line, found, bound, "add FROM with where the tool stands")
        return pose

    def _go(self, line: int, tip: Point, axis: Point) -> str:
        """Straight, along a circle or into a hole, as the statements before say."""
        positioning, self._rapid = self._rapid, False
        if self._cycle is not None:
            return self._drill(line, self._cycle, tip, axis)
        if self._feed_due and not positioning:
            self._feed_mm_s, self._feed_due = self._mm_s(line, self._rate), False
        if self._circle is not None:
            return self._arc(line, self._circle, tip, axis, positioning=positioning)
        begins = self._told is not None and self._trace.pose is None
        self._trace.move(line, tip, axis, positioning=positioning, feed_mm_s=self._feed_mm_s)
        if self._told is None:
            return ""
        verb = "begins at" if begins else "positions to" if positioning else "cuts to"
        return f"{verb} {_pose((tip, axis))}"

    # ------------------------------------------------------------ circles

    def circle(self, line: int, rest: str) -> str:
        self._check_movable(line)
        self._check_no_cycle(line, "CIRCLE")
        self._standing(line, "CIRCLE")
        values = self._numbers(line, "CIRCLE", rest, (6, 7), "x,y,z,i,j,k or x,y,z,i,j,k,radius")
        normal = self._normalised(line, values[3:6], "a circle's axis")
        radius = values[6] * self._mm if len(values) == 7 else None
        self._circle = _Circle(self._tip(values), normal, radius)
        self._next = _BEHIND_CIRCLE
        return f"a circle about {_at(self._circle.centre)}, right-handed about {_at(normal)}"

    def _arc(self, line: int, circle: _Circle, tip: Point, axis: Point, *, positioning: bool) -> str:
        """From where the tool stands to the point, as chords."""
        self._circle = self._next = None
        start, stood_axis = self._standing(line, "CIRCLE")
        if axis != stood_axis:
            bound, remedy = f"the tool axis {_at(stood_axis)} of its start", "have it written as GOTO"
            raise self._refusal(line, f"a circle that ends with the tool axis {_at(axis)}", bound, remedy)
        move = CircularMove(np.array(start), np.array(tip), np.array(circle.centre), np.array(circle.normal))
        self._check_circle(line, circle, move)
        chords = self._chords(line, move)
        for point in chords:
            self._trace.move(line, point, axis, positioning=positioning, feed_mm_s=self._feed_mm_s)
        verb = "positions" if positioning else "cuts"
        return f"{verb} along the circle to {_pose((tip, axis))}, {len(chords)} chords" if self._told else ""

    def _check_circle(self, line: int, circle: _Circle, move: CircularMove) -> None:
        """Refuses what is no circle, or one of which the file does not say how far round it goes."""
        height, apart, radius = _plane(move)
        if not (abs(height) <= RADIUS_MM):
            found, bound = f"a circle that ends {height:.6g} mm off its plane", f"<= {RADIUS_MM:g} mm off it"
            raise self._refusal(line, found, bound, CORRECT_CIRCLE)
        if circle.radius_mm is not None and not (abs(circle.radius_mm - radius) <= RADIUS_MM):
            found = f"a circle of radius {circle.radius_mm:.6g} mm"
            bound = f"of {radius:.6g} mm within {RADIUS_MM:g} mm, from its centre to where the tool stands"
            raise self._refusal(line, found, bound, CORRECT_CIRCLE)
        if 0.0 < apart < CLOSE_MM:
            found = f"a circle whose start and end are {apart:.3g} mm apart"
            bound = f"one whose are the same, or >= {CLOSE_MM:g} mm apart: it could be a whole turn"
            remedy = "write the same point for a whole turn, or leave the circle out"
            raise self._refusal(line, found, bound, remedy)

    def _chords(self, line: int, move: CircularMove) -> list[Point]:
        try:
            points, off_mm = move.chords(self._reading.arc_tolerance_mm, self._trace.room)
        except CircleError as error:
            # Too many chords for the path: nothing is wrong with the circle.
            many = error.found.endswith("chords")
            remedy = f"{shorter(self._limit)}, or declare a larger {ARC_OPTION}" if many else CORRECT_CIRCLE
            raise self._refusal(line, error.found, error.bound, remedy) from None
        self._trace.widen(tolerance_mm=off_mm)
        return list(map(tuple, points.tolist()))

    # ------------------------------------------------------------ drilling

    def cycle(self, line: int, rest: str) -> str:
        name, *settings = [token.strip() for token in rest.split(",")]
        name = _upper(name)
        if name == "OFF":
            self._cycle = None
            return "the drilling cycle is off"
        self._check_no_cycle(line, f"CYCLE/{name}")
        if name == "INIT" and not settings:
            return "no drilling cycle is on yet"
        if name not in CYCLES:
            bound = f"one of {', '.join(CYCLES)}, INIT, OFF"
            raise self._unread(line, "CYCLE", rest, bound, HOLES)
        self._scale(line)
        lengths, rate = self._cycle_settings(line, name, settings)
        self._cycle = self._cycle_of(line, name, lengths, rate)
        made = self._cycle
        pecks = f", in {made.pecks} pecks" if made.pecks > 1 else ""
        return (
            f"drills {made.depth:.10g} mm below each point along the tool axis{pecks}, "
            f"from {made.clearance:.10g} mm above it, and leaves to {made.retract:.10g} mm above it"
        )

    def _cycle_settings(
        self, line: int, name: str, settings: list[str]
    ) -> tuple[dict[str, float], _Rate | None]:
        """Lengths in mm by the names of ``CYCLE_KEYS``, and the feed."""
        lengths: dict[str, float] = {}
        rate = None
        if len(settings) % 2:
            found = f"CYCLE/{name} with {settings[-1]} alone at its end"
            raise self._refusal(line, found, "pairs of name and number", "complete the line")
        for key, text in zip(map(_upper, settings[::2]), settings[1::2], strict=True):
            length = CYCLE_KEYS.get(key)
            if length is None and key not in FEED_UNITS:
                bound = f"with {', '.join((*CYCLE_KEYS, *FEED_UNITS))} alone"
                raise self._refusal(line, f"CYCLE/{name} with {key}", bound, HOLES)
            if length in lengths or (length is None and rate is not None):
                bound = "given once: RAPTO is CLEAR, INCR is STEP, and there is one feed"
                raise self._refusal(line, f"CYCLE/{name} with {key} again", bound, "remove one of the two")
            if length is None:
                rate = self._rate_of(line, f"CYCLE/{name}", key, text)
            else:
                lengths[length] = self._number(line, f"CYCLE/{name}", key, text) * self._mm
        return lengths, rate

    def _cycle_of(self, line: int, name: str, lengths: dict[str, float], rate: _Rate | None) -> _Cycle:
        """Judges the lengths of a cycle together."""
        for length, key in (("depth", "FEDTO"), ("clearance", "RAPTO")):
            if length not in lengths:
                bound = f"with {key}: {CYCLE_LENGTHS[key]}"
                raise self._refusal(line, f"CYCLE/{name} without {key}", bound, f"add it, or {HOLES}")
        given = lengths.keys() & _PECKING
        if given not in CYCLES[name]:
            found = " and ".join(key for key, length in CYCLE_KEYS.items() if length in given) or "no peck"
            bound = "without pecks" if name == "DRILL" else "with 1STPECK and SUBPECK, or with INCR or STEP"
            raise self._refusal(line, f"CYCLE/{name} with {found}", bound, HOLES)
        depth, clearance = lengths["depth"], lengths["clearance"]
        every = lengths.get("increment", depth)
        cycle = _Cycle(
            depth=depth,
            clearance=clearance,
            retract=lengths.get("retract", clearance),
            first=lengths.get("first", every),
            step=lengths.get("step", every),
            rate=rate,
        )
        first, step = ("INCR", "INCR") if "increment" in lengths else ("1STPECK", "SUBPECK")
        bounds = (
            ("FEDTO", depth, PECK_MIN_MM, DEPTH_MAX_MM),
            ("RAPTO", clearance, 0.0, DEPTH_MAX_MM),
            ("RTRCTO", cycle.retract, clearance, DEPTH_MAX_MM),
            (first, cycle.first, PECK_MIN_MM, DEPTH_MAX_MM),
            (step, cycle.step, PECK_MIN_MM, DEPTH_MAX_MM),
        )
        for key, value, low, high in bounds:
            if not (low <= value <= high):
                found, bound = f"CYCLE/{name} with {key} {value:.6g} mm", f"{low:g} to {high:g} mm"
                raise self._refusal(line, found, bound, f"{key} is {CYCLE_LENGTHS[key]}: correct it")
        return cycle

    def _drill(self, line: int, cycle: _Cycle, point: Point, axis: Point) -> str:
        """To the clearance above the point, down in its pecks, out again.

        Each peck leaves poses, for it is no shorter than ``PECK_MIN_MM``: the pose limit bounds their number.
        """
        feed_mm_s = self._mm_s(line, cycle.rate or self._rate)
        clear = _along(point, axis, cycle.clearance)
        self._approach(line, clear, axis)
        depth = -cycle.clearance
        for peck in range(cycle.pecks):
            self._trace.move(line, _along(point, axis, -depth), axis, positioning=True)
            depth = min(cycle.depth, cycle.first + peck * cycle.step)
            self._trace.move(line, _along(point, axis, -depth), axis, feed_mm_s=feed_mm_s)
            self._trace.move(line, clear, axis, positioning=True)
        self._trace.move(line, _along(point, axis, cycle.retract), axis, positioning=True)
        return f"drills at {_pose((point, axis))}" if self._told else ""

    def _approach(self, line: int, clear: Point, axis: Point) -> None:
        """To the clearance of a hole: across at the height where the tool stands, at least that of the clearance."""
        pose = self._trace.pose
        if pose is not None:
            tip, stood_axis = pose
            if stood_axis != axis:
                bound, remedy = (
                    f"the tool axis {_at(stood_axis)} of where the tool stands",
                    "add a GOTO with this axis",
                )
                raise self._refusal(
                    line, f"a hole along the tool axis {_at(axis)}", bound, f"{remedy} before CYCLE"
                )
            delta = tuple(c - t for c, t in zip(clear, tip, strict=True))
            rise = sum(d * a for d, a in zip(delta, axis, strict=True))
            if rise > 0.0:
                tip = _along(tip, axis, rise)
                self._trace.move(line, tip, axis, positioning=True)
            else:
                across = tuple(d - rise * a for d, a in zip(delta, axis, strict=True))
                x, y, z = (t + d for t, d in zip(tip, across, strict=True))
                self._trace.move(line, (x, y, z), axis, positioning=True)
        self._trace.move(line, clear, axis, positioning=True)

    # ------------------------------------------------------------ feed and spindle

    def fedrat(self, line: int, rest: str) -> str:
        tokens = [token.strip() for token in rest.split(",")]
        units = [unit for token in tokens if (unit := _upper(token)) in FEED_UNITS]
        values = [token for token in tokens if _ONE.fullmatch(token)]
        if not (len(values) == 1 and len(units) <= 1 and len(units) + 1 == len(tokens)):
            bound = f"one number and one of {', '.join(FEED_UNITS)}"
            raise self._unread(line, "FEDRAT", rest, bound, "have the feed written per minute or revolution")
        if not units and self._feed_unit is None:
            bound = f"with one of {', '.join(FEED_UNITS)}: no FEDRAT before has one"
            raise self._unread(line, "FEDRAT", rest, bound, "add the unit of the feed")
        self._feed_unit = unit = units[0] if units else str(self._feed_unit)
        self._rate = self._rate_of(line, "FEDRAT", unit, values[0])
        self._feed_due = self._rate.per_revolution
        if not self._feed_due:
            self._feed_mm_s = self._mm_s(line, self._rate)
        return f"feed {self._rate.mm:.10g} mm per {'revolution' if self._feed_due else 'minute'}"

    def _rate_of(self, line: int, major: str, unit: str, text: str) -> _Rate:
        mm, per_revolution = FEED_UNITS[unit]
        value = self._number(line, major, unit, text)
        return _Rate(value * (self._scale(line) if mm is None else mm), per_revolution)

    def _mm_s(self, line: int, rate: _Rate | None) -> float | None:
        """A feed at this line; None where the file gives none."""
        if rate is None:
            return None
        if rate.per_revolution and self._rpm is None:
            found, bound = "a feed per revolution", "behind SPINDL with the revolutions per minute"
            raise self._refusal(line, found, bound, "add SPINDL/n,RPM, or give the feed per minute")
        feed_mm_s = rate.mm / 60.0 * (self._rpm if rate.per_revolution and self._rpm else 1.0)
        low, high = FEED_MM_S
        if not (low <= feed_mm_s <= high):
            found, bound = f"a feed of {feed_mm_s:.6g} mm/s", f"{low:g} to {high:g} mm/s"
            raise self._refusal(
                line,
                found,
                bound,
                "correct it, or the speed of the spindle" if rate.per_revolution else "correct it",
            )
        return feed_mm_s

    def spindl(self, _line: int, rest: str) -> str:
        """Its speed, or none where anything is said that could make it another one: it moves nothing."""
        tokens = [token.strip() for token in rest.split(",")]
        speeds = [float(token) for token in tokens if _ONE.fullmatch(token)]
        others = [_upper(token) for token in tokens if not _ONE.fullmatch(token)]
        known = len(speeds) == 1 and speeds[0] > 0.0 and SPINDLE.issuperset(others)
        self._rpm = speeds[0] if known else None
        self._feed_due = self._rate is not None and self._rate.per_revolution
        return (
            f"spindle {self._rpm:.10g} revolutions per minute"
            if self._rpm
            else "spindle, its revolutions unknown"
        )

    # ------------------------------------------------------------ units and coordinates

    def units(self, line: int, rest: str) -> str:
        unit = _upper(rest.strip())
        if unit not in UNITS:
            bound, remedy = f"one of {', '.join(UNITS)}", "write the one that the file was written in"
            raise self._refusal(line, f"unit {unit}", bound, remedy)
        if self._unit is not None and UNITS[unit] != self._mm:
            bound, remedy = f"{self._unit}, as above", "part the file, or have it written in one unit"
            raise self._refusal(line, f"unit {unit}", bound, remedy)
        self._unit, self._mm = unit, UNITS[unit]
        self._bars.pop("unit", None)
        return f"lengths are {'mm' if self._mm == 1.0 else 'inches'}"

    def multax(self, line: int, rest: str) -> str:
        if _upper(rest.strip()) not in {"", "ON", "OFF"}:
            raise self._unread(line, "MULTAX", rest, "ON, OFF or nothing")
        self._settled = False
        return "whether points have tool axes"

    def tlaxis(self, line: int, rest: str) -> str:
        axis = self._axis_of(line, self._numbers(line, "TLAXIS", rest, (3,), "i,j,k"))
        return f"tool axis {_at(axis)}"

    def trntyp(self, line: int, rest: str) -> str:
        name, _, offsets = rest.partition(",")
        none = not offsets.strip() or (_LIST.fullmatch(offsets) and not any(map(float, offsets.split(","))))
        if _upper(name.strip()) != "WORLD" or not none:
            remedy = "have the file written in world coordinates"
            raise self._unread(line, "TRNTYP", rest, "WORLD, without an offset", remedy)
        self._world, self._settled = True, False
        return "coordinates are world coordinates"

    def csys(self, line: int, rest: str) -> str:
        values = self._numbers(line, "CSYS", rest, (12,), "12 numbers, three rows of a transform")
        if values != _IDENTITY and not self._world:
            bound = "the identity, or behind TRNTYP/WORLD: else coordinates may be in this system"
            raise self._unread(
                line, "CSYS", rest, bound, "have the file written in world coordinates, with TRNTYP/WORLD"
            )
        self._frame = self._normalised(line, values[2::4], "a z axis")
        self._settled = False
        return f"coordinate system with the z axis {_at(self._frame)}; coordinates stay as they are"

    def msys(self, line: int, rest: str) -> str:
        values = self._numbers(line, "MSYS", rest, (9,), "nine numbers, origin, x axis, y axis")
        if values != _MSYS_IDENTITY:
            bound = "the identity, 0,0,0,1,0,0,0,1,0"
            raise self._unread(
                line, "MSYS", rest, bound, "have the file written relative to the absolute system"
            )
        self._frame, self._settled = _UP, False
        return "coordinates are absolute"

    def origin(self, line: int, rest: str) -> str:
        if any(self._numbers(line, "ORIGIN", rest, (3,), "x,y,z")):
            raise self._unread(line, "ORIGIN", rest, "0,0,0", "have the file written with its origin there")
        return "the origin stays where it is"

    def cutcom(self, line: int, rest: str) -> str:
        side = _upper(rest.partition(",")[0].strip())
        if side == "OFF":
            return "no cutter compensation"
        if side not in {"LEFT", "RIGHT"}:
            raise self._unread(
                line, "CUTCOM", rest, "LEFT, RIGHT or OFF", "have it written without compensation"
            )
        if not self._reading.cutcom_is_tool_centre:
            bound = "declared: a machine may shift such a path by the tool's radius"
            remedy = f"{CUTCOM_OPTION} if it is the tool's centre already, else have it written without compensation"
            raise self._unread(line, "CUTCOM", rest, bound, remedy)
        return "cutter compensation: coordinates are the tool's centre, as declared"

    # ------------------------------------------------------------ tools

    def load(self, line: int, rest: str) -> str:
        kind, _, others = rest.partition(",")
        if _upper(kind.strip()) != "TOOL":
            raise self._unread(line, "LOAD", rest, "LOAD/TOOL,n")
        return self._load(line, "LOAD/TOOL", others)

    def loadtl(self, line: int, rest: str) -> str:
        return self._load(line, "LOADTL", rest)

    def _load(self, line: int, major: str, rest: str) -> str:
        tool, *settings = [token.strip() for token in rest.split(",")]
        keys = [_upper(key) for key in settings[::2]]
        if len(settings) % 2 or not (LOAD_KEYS.issuperset(keys) and keys.count("LENGTH") <= 1):
            bound = f"a tool, then pairs of a number and one of {', '.join(sorted(LOAD_KEYS))}, LENGTH once"
            raise self._unread(line, major, rest, bound, "complete the pairs, and drop all others")
        length_mm = None
        if "LENGTH" in keys:
            text = settings[1::2][keys.index("LENGTH")]
            length_mm = self._number(line, major, "LENGTH", text) * self._scale(line)
            if not (0.0 < length_mm <= LENGTH_MAX_MM):
                found, bound = f"a tool of length {length_mm:.6g} mm", f"over 0 and <= {LENGTH_MAX_MM:g} mm"
                raise self._refusal(line, found, bound, "correct LENGTH, or the file's unit")
        if self._trace.room != self._operation_room:
            self._operation_tool = None
        self._mount(line, self._tool_name(line, major, tool), length_mm)
        return f"mounts tool {tool}" + (f", {length_mm:.10g} mm long" if length_mm else "")

    def _tool_name(self, line: int, major: str, name: str) -> str:
        if not (0 < len(name) <= NAME_MAX):
            raise self._unread(line, major, name, f"a tool of 1 to {NAME_MAX} characters", "rename the tool")
        return name

    def _mount(self, line: int, tool: str, length_mm: float | None) -> None:
        """Another cut; where nothing has moved since ``FROM``, the tool stands there."""
        self._check_no_cycle(line, "another tool")
        stood = self._stood
        self._trace.mount(line, tool, length_mm)
        if stood is not None and stood[0] == self._trace.room:
            self._trace.move(*stood[1:], positioning=True)
            self._stood = (self._trace.room, *stood[1:])
        self._tool, self._length_mm, self._settled, self._rapid = tool, length_mm, False, False
        self._bars.pop("home", None)
        self._bars.pop("tool", None)

    def toolno(self, line: int, rest: str) -> str:
        tool = self._tool_name(line, "TOOLNO", rest.partition(",")[0].strip())
        self._bars.pop("tool", None)
        if tool != self._tool:
            bound = f"behind LOADTL/{tool} as well: TOOLNO alone does not say whether it is mounted"
            self._bars["tool"] = (
                f"a motion behind TOOLNO/{tool}",
                bound,
                f"add LOADTL/{tool} where it is mounted",
            )
        return f"describes tool {tool}"

    def select(self, line: int, rest: str) -> str:
        if _upper(rest.partition(",")[0].strip()) != "TOOL":
            raise self._unread(line, "SELECT", rest, "SELECT/TOOL,n")
        return "has the next tool made ready; mounts nothing"

    def operation(self, line: int, rest: str) -> str:
        """``TOOL PATH/name,TOOL,tool``: the tool is another one where its name is.

        A ``LOAD`` beside it, before or behind it with no motion between, is of the same tool.
        """
        tokens = [token.strip() for token in rest.split(",")]
        if not (len(tokens) == 3 and _upper(tokens[1]) == "TOOL"):
            raise self._unread(line, "TOOL PATH", rest, "TOOL PATH/name,TOOL,tool")
        tool = self._tool_name(line, "TOOL PATH", tokens[2])
        self._settled = False
        known = tool == self._operation_tool
        if not known:
            self._mount(line, tool, self._length_mm if self._trace.pose is None else None)
        self._operation_tool, self._operation_room = tool, self._trace.room
        return f"{'goes on with' if known else 'mounts'} tool {tool}"

    # ------------------------------------------------------------ ends

    def end(self, _line: int, _rest: str) -> str:
        self._bars["end"] = _ENDED
        return "ends all motion"

    def fini(self, _line: int, _rest: str) -> str:
        self._next = _BEHIND_FINI
        return "ends the file"


def _first(statement: str) -> str:
    """The first word of a statement, in upper case; a slash ends it as a space does."""
    return _upper(statement.partition("/")[0].strip().partition(" ")[0].partition("\t")[0])


def _upper(text: str) -> str:
    """In upper case; letters of other alphabets stay: some become those of the table."""
    return text.upper() if text.isascii() else text


def _at(point: Point) -> str:
    return " ".join(f"{value:.10g}" for value in point)


def _pose(pose: tuple[Point, Point]) -> str:
    tip, axis = pose
    return _at(tip) + ("" if axis == _UP else f" with the axis {_at(axis)}")


def _along(point: Point, axis: Point, length: float) -> Point:
    x, y, z = (p + length * a for p, a in zip(point, axis, strict=True))
    return x, y, z


def _plane(move: CircularMove) -> tuple[float, float, float]:
    """Of a circle, mm: its end above the plane of its start, start and end apart in it, the radius at its start."""
    way, arm = move.end - move.start, move.start - move.centre
    height = float(way @ move.normal)
    apart = float(np.linalg.norm(way - height * move.normal))
    return height, apart, float(np.linalg.norm(arm - (arm @ move.normal) * move.normal))


def _nothing(text: str) -> Handler:
    """Of a statement that neither moves the tool nor says anything of where it goes."""
    return lambda _program, _line, _rest: text


def _refused(major: str, bound: str, remedy: str) -> Handler:
    def handler(program: _Program, line: int, rest: str) -> str:
        raise program._unread(line, major, rest, bound, remedy)  # noqa: SLF001 - a handler as those of the class

    return handler


LOAD_KEYS: Final = frozenset({"LENGTH", "OSETNO", "ADJUST"})
TEXTS: Final = frozenset({"PARTNO", "PPRINT", "REMARK", "INSERT"})
"""Text follows them, behind a space or a slash, to the end of the line."""
PREFIX: Final = "CSI_SET_"
ENDS: Final = frozenset({"FINI", "END", "END-OF-PATH"})
_BEHIND_CIRCLE: Final = _Next(
    frozenset({"GOTO"}), "behind CIRCLE", "GOTO, with the point where it ends", "have the file written anew"
)
_BEHIND_FINI: Final = _Next(
    frozenset(), "behind FINI", "before it: FINI ends the file", "make a file of each program"
)
TRANSFORMING: Final = frozenset({"TRACUT", "COPY", "INDEX", "TRANS", "ROTABL", "ROTATE", "ROTHED"})
UNPROCESSED: Final = frozenset({
    "MACRO", "CALL", "TERMAC", "LOOPST", "LOOPND", "IF", "JUMPTO",
    "GO", "GOFWD", "GOLFT", "GORGT", "INDIRV", "INDIRP", "TLLFT", "TLRGT", "TLON",
})  # fmt: skip
_TRANSFORMED: Final = (
    "left out: it changes the coordinates that follow",
    "have the CAM system carry it out and write the coordinates that result",
)
_UNPROCESSED: Final = (
    "processed: this is a part program, not yet cutter locations",
    "run it through its APT processor, or have the CAM system write all motion as GOTO and CIRCLE",
)

MAJOR: Final[dict[str, Handler]] = {
    "GOTO": _Program.goto,
    "CIRCLE": _Program.circle,
    "GODLTA": _Program.godlta,
    "FROM": _Program.from_,
    "RAPID": _Program.rapid,
    "GOHOME": _Program.gohome,
    "CYCLE": _Program.cycle,
    "FEDRAT": _Program.fedrat,
    "SPINDL": _Program.spindl,
    "UNITS": _Program.units,
    "UNIT": _Program.units,
    "MULTAX": _Program.multax,
    "TLAXIS": _Program.tlaxis,
    "TRNTYP": _Program.trntyp,
    "CSYS": _Program.csys,
    "MSYS": _Program.msys,
    "ORIGIN": _Program.origin,
    "CUTCOM": _Program.cutcom,
    "LOAD": _Program.load,
    "LOADTL": _Program.loadtl,
    "TOOLNO": _Program.toolno,
    "SELECT": _Program.select,
    "TOOL PATH": _Program.operation,
    "END": _Program.end,
    "FINI": _Program.fini,
    "END-OF-PATH": _nothing("ends an operation"),
    **dict.fromkeys(sorted(TEXTS), _nothing("text for people or for another machine")),
    **dict.fromkeys(("CUTTER", "TLDATA", "TPRINT", PREFIX), _nothing("describes the tool")),
    **dict.fromkeys(("COOLNT", "STOP", "OPSTOP", "DELAY"), _nothing("moves nothing")),
    **dict.fromkeys(("MACHIN", "SEQNO", "PAINT", "DISPLY"), _nothing("says nothing of the tool's motion")),
    **dict.fromkeys(("INTOL", "OUTTOL", "TOLER"), _nothing("tolerances of what the points were made from")),
    **{major: _refused(major, *_TRANSFORMED) for major in sorted(TRANSFORMING)},
    **{major: _refused(major, *_UNPROCESSED) for major in sorted(UNPROCESSED)},
}
"""Each major word that is understood, and what it does; every other one is refused."""
