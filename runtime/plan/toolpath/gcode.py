"""G-code (RS-274, ISO 6983) as LinuxCNC writes and runs it, to the poses between which each tool moves.

Every G and M word is a row of ``CODES``: its modal group, what it does, and what is told of it. A block takes one word
of each group; they act in the order of ``ORDER``, whatever their order in the line. A word without a row is refused, and
one that moves the coordinates or that only the machine can interpret has a row that says so.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np

from cutgate.config.load import decode
from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath.blocks import GcodeBlock, read_block
from cutgate.runtime.plan.toolpath.circular import CircularMove
from cutgate.runtime.plan.toolpath.cycles import PECKING, Hole
from cutgate.runtime.plan.toolpath.expressions import GcodeError, Parameters, integer
from cutgate.runtime.plan.toolpath.model import Reading, Told, ToolPath, check_lines
from cutgate.runtime.plan.toolpath.motion import LINEAR, ROTARY, Feed, Tip, ToolMotion, same_direction
from cutgate.runtime.plan.toolpath.program import Program
from cutgate.runtime.plan.toolpath.trace import Trace

EXTENSIONS: Final = (".ngc", ".nc", ".gcode", ".tap")
DECLARED: Final = frozenset({"rotary", "arc_tolerance_mm", "axis_tolerance_deg"})

INCH_MM: Final = 25.4
WORK_PER_POSE: Final = 128
WORK_MAX: Final = 32_000_000
"""So many characters may be executed for each pose that a path may have, and in all, beside those of the file."""
TOLD_MAX: Final = 100_000
TOLD_CHARACTERS: Final = 240
REPEATS_MAX: Final = 10_000
HALF_TURN_MM: Final = 0.00127
"""The ends of an arc may be further apart than twice its radius by twice this, as in LinuxCNC: files round."""
PLANES: Final = MappingProxyType({"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)})
"""First and second axis of each plane, and its normal, right-handed."""
CENTRE: Final = "IJK"


@dataclass(slots=True)
class Modal:
    """What holds until another word of its group.

    Attributes:
        unit_mm: of a coordinate; None before the first unit word.
        assumed_mm: coordinates were read as mm without a unit word.
        feed: the last F, mm per min, per revolution, or 1/min; None where it must be given anew.
        tool: the mounted tool, of T and M6.
        waiting: the T word that M6 will mount.
        length: the tool length word that holds, and the one that this tool has had.
        length_due: the tool before had a length: it holds until a word says another one.
        old_level: G98, a cycle ends where its series began; G99, at R; None before either.
        cycle: R, Z and Q of the cycle that holds, mm.
        level: where the first cycle of a series began along the normal, whatever cycles it consists of, mm; None
            outside of a series.
    """

    motion: str = ""
    plane: str = "G17"
    absolute: bool = True
    arc_absolute: bool = False
    unit_mm: float | None = None
    assumed_mm: bool = False
    feed_mode: str = "G94"
    feed: float | None = None
    speed: float = 0.0
    old_level: bool | None = None
    tool: str = ""
    waiting: str = ""
    length: str = ""
    tool_length: str = ""
    length_due: bool = False
    cycle: dict[str, float] | None = None
    level: float | None = None
    running: bool = True


class Machine:
    """Executes blocks one after the other.

    Args:
        trace: takes the poses.
        reading: what was declared.

    Raises:
        GcodeError: a declaration that means nothing.
    """

    def __init__(self, trace: Trace, reading: Reading) -> None:
        self.modal = Modal()
        self.motion = ToolMotion(trace, reading)
        self.trace = trace

    def execute(self, block: GcodeBlock) -> list[str]:
        """One block; what was understood of it.

        Raises:
            GcodeError: it cannot be executed, or not without the machine.
        """
        rows = self._rows(block)
        if self.modal.feed_mode == "G93":
            self.modal.feed = None
        before = 0
        while before < len(rows) and rows[before].group in _BEFORE_FEED:
            rows[before].act(self, block, rows[before].code)
            before += 1
        self._numbers(block)
        for row in rows[before:]:
            row.act(self, block, row.code)
        if not any(row.moves for row in rows):
            rows += self._implied(block)
        if block.values:
            letter = next(iter(block.values))
            bound = "used by a word of this line"
            raise GcodeError(
                f"{letter} word", bound, "take it out, or add the G or M word that it belongs to"
            )
        return [f"{row.code} {row.meaning}" for row in rows]

    def _rows(self, block: GcodeBlock) -> list["Row"]:
        """The rows of a block's codes, in the order in which they act."""
        rows = []
        for code in block.codes:
            row = CODES.get(code)
            if row is None:
                bound = "a word whose meaning is known (docs/files.md)"
                raise GcodeError(code, bound, "have the program written without it")
            rows.append(row)
        if len(rows) > 1:
            rows.sort(key=lambda row: _RANK[row.group])
            for row, following in pairwise(rows):
                if row.group == following.group:
                    found = f"{row.code} and {following.code} in one line"
                    raise GcodeError(found, f"one word of the group {row.group}", "part the line")
            _check_shared(block, rows)
        return rows

    def _numbers(self, block: GcodeBlock) -> None:
        """F, S and T."""
        values, modal = block.values, self.modal
        if "F" in values:
            feed = values.pop("F")
            if not (feed >= 0.0):
                raise GcodeError(f"F{feed:g}", ">= 0", "correct the feed")
            modal.feed = feed if modal.feed_mode == "G93" else feed * self.unit_mm()
        if "S" in values:
            modal.speed = values.pop("S")
            if not (modal.speed >= 0.0):
                raise GcodeError(f"S{modal.speed:g}", ">= 0", "correct the spindle speed")
        if "T" in values:
            number = integer(values.pop("T"), "the number of a tool")
            if not (number >= 0):
                raise GcodeError(f"T{number}", ">= 0", "correct the tool")
            modal.waiting = str(number)

    def _implied(self, block: GcodeBlock) -> list["Row"]:
        """Axis words without a motion word: the motion that holds is carried out."""
        if not block.values.keys() & _AXES:
            return []
        code = self.modal.motion
        if not code:
            raise GcodeError(
                "axis words without a motion", "after G0, G1, G2, G3 or a cycle", "add the G word"
            )
        CODES[code].act(self, block, code)
        return [CODES[code]]

    # ------------------------------------------------------------------ units

    def unit_mm(self) -> float:
        """What a length of 1 is."""
        if self.modal.unit_mm is None:
            self.modal.assumed_mm = True
            return 1.0
        return self.modal.unit_mm

    def length(self, block: GcodeBlock, letter: str) -> float | None:
        """The value of a letter that is a length, mm."""
        value = block.take(letter)
        return None if value is None else value * self.unit_mm()

    def target(self, block: GcodeBlock) -> tuple[Tip, int]:
        """Where X, Y and Z of a block lead, mm, and how many of them it has.

        Raises:
            GcodeError: a difference to what is not known.
        """
        tip, values, count = [*self.motion.tip], block.values, 0
        if self.modal.length_due:
            bound = "behind its own tool length word: the length of the tool before still holds"
            remedy = f"add G43 H{self.modal.tool} (or G43.1 Z, G49) behind M6"
            raise GcodeError(f"a move of tool {self.modal.tool}", bound, remedy)
        unit, absolute = 0.0, self.modal.absolute
        for index, letter in enumerate(LINEAR):
            if letter in values:
                unit = unit or self.unit_mm()
                value, at = values.pop(letter) * unit, tip[index]
                if not absolute:
                    value += self._known(letter, at)
                tip[index] = value
                count += 1
        return tip, count

    def angles(self, block: GcodeBlock) -> dict[str, float | None]:
        """The rotary axes after a block, deg."""
        return self.motion.turned(self.rotary(block), absolute=self.modal.absolute)

    @staticmethod
    def rotary(block: GcodeBlock) -> dict[str, float]:
        """The rotary words of a block, deg."""
        values = block.values
        return {letter: values.pop(letter) for letter in ROTARY if letter in values} if values else {}

    @staticmethod
    def _known(letter: str, at: float | None) -> float:
        if at is None:
            raise GcodeError(f"{letter} in G91", f"known before: no {letter} stands above", "use G90 once")
        return at

    def here(self) -> tuple[float, float, float]:
        """Where the tip is.

        Raises:
            GcodeError: the file has not said so.
        """
        x, y, z = (self._known_place(c, at) for c, at in zip(LINEAR, self.motion.tip, strict=True))
        return x, y, z

    @staticmethod
    def _known_place(letter: str, at: float | None) -> float:
        if at is None:
            bound = f"from a place that the file names: {letter} is not known"
            raise GcodeError("an arc or a cycle", bound, "position the tool with G0 X Y Z")
        return at

    # ------------------------------------------------------------------- feed

    def feed(self) -> Feed:
        """The feed that holds.

        Raises:
            GcodeError: none does.
        """
        modal = self.modal
        value = modal.feed
        if not (value is not None and value > 0.0):
            where = (
                "in every line of a move in G93" if modal.feed_mode == "G93" else "before a move that cuts"
            )
            raise GcodeError("no feed", f"F over 0 {where}, and anew after G20, G21, G93, G94, G95", "add F")
        if modal.feed_mode == "G95":
            if not (modal.speed > 0.0):
                raise GcodeError("a feed per revolution at S0", "S over 0", "add the spindle speed S")
            value *= modal.speed
        rate = value / 60.0
        return (lambda mm: mm * rate) if modal.feed_mode == "G93" else (lambda _mm: rate)


def _check_shared(block: GcodeBlock, rows: list["Row"]) -> None:
    """Refuses two words that would take the same letters."""
    axes = [row.code for row in rows if row.moves]
    if len(axes) > 1:
        raise GcodeError(f"{' and '.join(axes)} in one line", "one word that uses X Y Z", "part the line")
    dwells = [row.code for row in rows if row.code in _TAKES_P]
    if len(dwells) > 1 and "P" in block.values:
        raise GcodeError(f"P with {' and '.join(dwells)}", "of one word only", "part the line")


Act = Callable[[Machine, GcodeBlock, str], None]


@dataclass(frozen=True, slots=True)
class Row:
    """What one G or M word is.

    Attributes:
        code: the word.
        group: modal group.
        act: what it does to the machine, with the block and the code.
        meaning: for people.
        moves: it uses the axis words of its block.
    """

    code: str
    group: str
    act: Act
    meaning: str
    moves: bool = False


# -------------------------------------------------------------------- motion


def _straight(machine: Machine, block: GcodeBlock, code: str) -> None:
    modal, motion = machine.modal, machine.motion
    modal.motion, modal.level = code, None
    tip, count = machine.target(block)
    angles = machine.angles(block)
    if not count and angles is motion.turned({}, absolute=True):
        return  # a motion word alone: nothing moves
    motion.straight(tip, angles, machine.feed() if code == "G1" else None, named=count == 3)


def _arc(machine: Machine, block: GcodeBlock, code: str) -> None:
    modal = machine.modal
    modal.motion, modal.level = code, None
    start = np.array(machine.here())
    tip, _ = machine.target(block)
    angles = machine.angles(block)
    end = np.array(tip, dtype=np.float64)
    radius = machine.length(block, "R")
    turns = integer(block.values.pop("P", 1.0), "the turns of an arc")
    if not (turns >= 1):
        raise GcodeError(f"P{turns}", ">= 1", "correct the number of turns")
    if radius is None:
        centre = _centre(machine, block, start)
    else:
        centre = _centre_of_radius(start, end, radius, PLANES[modal.plane], clockwise=code == "G2")
    first, second, across = PLANES[modal.plane]
    ends = [complex(p[first] - centre[first], p[second] - centre[second]) for p in (start, end)]
    if same_direction(*ends):
        bound = "the same point, or points that can be told apart"
        raise GcodeError("start and end of an arc within a millionth of its radius", bound, "correct the arc")
    normal = np.zeros(3)
    normal[across] = -1.0 if code == "G2" else 1.0
    whole = CircularMove(start, end, centre, normal, turns - 1)
    machine.motion.circular(whole, machine.feed(), angles)
    if radius is not None:
        machine.trace.widen(abs(abs(radius) - float(np.linalg.norm(ends[0]))))


def _centre(machine: Machine, block: GcodeBlock, start: np.ndarray) -> np.ndarray:
    """The centre of an arc from I, J and K, mm; along the normal it is where the start is."""
    modal = machine.modal
    first, second, across = PLANES[modal.plane]
    if CENTRE[across] in block.values:
        bound = f"{CENTRE[first]} and {CENTRE[second]} in {modal.plane}"
        raise GcodeError(f"{CENTRE[across]} of an arc", bound, "select the plane of the arc")
    given = {axis: machine.length(block, CENTRE[axis]) for axis in (first, second)}
    missing = [CENTRE[axis] for axis, value in given.items() if value is None]
    if len(missing) == 2 or (missing and modal.arc_absolute):
        bound = f"given by R, or by {CENTRE[first]} and {CENTRE[second]} (G90.1: both)"
        raise GcodeError(f"an arc without {' '.join(missing)}", bound, "add them")
    centre = start.copy()
    for axis, value in given.items():
        offset = 0.0 if value is None else value
        centre[axis] = offset if modal.arc_absolute else start[axis] + offset
    return centre


def _centre_of_radius(
    start: np.ndarray, end: np.ndarray, radius: float, plane: tuple[int, int, int], *, clockwise: bool
) -> np.ndarray:
    """The centre of an arc of this radius: of at most half a turn, or of more if it is negative."""
    first, second, _ = plane
    u, v = float(end[first] - start[first]), float(end[second] - start[second])
    half = 0.5 * math.hypot(u, v)
    if not (half > 0.0):
        raise GcodeError("an arc of R back to its start", "given by I, J, K", "give its centre")
    if not (half <= abs(radius) + HALF_TURN_MM):
        bound = f">= {half:.6g} mm, half the way between its ends"
        raise GcodeError(f"R{radius:g} mm", bound, "correct the radius or the end")
    # Files round: half a turn may come out slightly too wide. Then its centre is in the middle.
    height = math.sqrt(max(0.0, radius * radius - half * half))
    side = 1.0 if (radius > 0.0) != clockwise else -1.0
    centre = start.copy()
    centre[first] += 0.5 * u - side * height * v / (2.0 * half)
    centre[second] += 0.5 * v + side * height * u / (2.0 * half)
    return centre


def _cycle(machine: Machine, block: GcodeBlock, code: str) -> None:
    """A canned cycle, at one place or at several."""
    modal = machine.modal
    if modal.feed_mode == "G93":
        raise GcodeError(f"{code} in G93", "a feed per minute or revolution", "use G94")
    if modal.old_level is None:
        bound = "behind G98 or G99: which of them holds at first is set at the machine"
        raise GcodeError(code, bound, "add G98 (back to where the cycle began) or G99 (back to R)")
    if modal.motion != code:
        modal.cycle = None
    first, second, across = PLANES[modal.plane]
    start = machine.here()
    depth = _depths(machine, block, code, across)
    modal.level = began = start[across] if modal.level is None else modal.level
    block.values.pop("P", None)  # a dwell moves nothing
    repeats = integer(block.values.pop("L", 1.0), "how often")
    if not (1 <= repeats <= REPEATS_MAX):
        raise GcodeError(f"L{repeats}", f"1 to {REPEATS_MAX}", "correct it")
    tip, _ = machine.target(block)
    if machine.angles(block) != machine.motion.turned({}, absolute=True):
        raise GcodeError("a rotary word in a cycle", "a constant tool axis", "turn before the cycle")
    modal.motion, modal.cycle = code, depth
    there = (float(tip[first] or 0.0), float(tip[second] or 0.0))
    step = (0.0, 0.0) if modal.absolute else (there[0] - start[first], there[1] - start[second])
    base = 0.0 if modal.absolute else began
    retract = base + depth["R"]
    bottom = depth["Z"] if modal.absolute else retract + depth["Z"]
    if not (retract >= bottom):
        raise GcodeError(f"R at {retract:g} mm", f">= the bottom, {bottom:g} mm", "correct R or the depth")
    # A series that began below R comes to R where it stands. Else the tool stays above R on its way across, and from R
    # or below goes to where it leaves the hole.
    clear = max(retract, began) if modal.old_level else retract
    level = start[across] if start[across] > retract else clear
    if began < retract:
        level = retract
        _to(machine, (start[first], start[second]), level, None)
    for repeat in range(repeats):
        at = (there[0] + repeat * step[0], there[1] + repeat * step[1])
        _drill(machine, at, Hole(code, level, retract, bottom, clear, depth["Q"]))
        level = clear


def _drill(machine: Machine, at: tuple[float, float], hole: Hole) -> None:
    feed = machine.feed()
    _to(machine, at, hole.level, None)
    for height, feeds in hole.heights(machine.trace.room):
        _to(machine, at, height, feed if feeds else None)


def _depths(machine: Machine, block: GcodeBlock, code: str, across: int) -> dict[str, float]:
    """R, the depth (``Z``, whatever the plane) and Q of a cycle: given, or those of the block before it; mm."""
    modal, normal = machine.modal, LINEAR[across]
    kept = modal.cycle or {}
    depth: dict[str, float] = {"Q": 0.0}
    for name, letter in (("R", "R"), ("Z", normal), ("Q", "Q")):
        if letter == "Q" and code not in PECKING:
            continue
        value = machine.length(block, letter)
        if value is None and name not in kept:
            raise GcodeError(f"{code} without {letter}", f"with {letter} in its first line", f"add {letter}")
        depth[name] = kept[name] if value is None else value
    if code in PECKING and not (depth["Q"] > 0.0):
        raise GcodeError(f"Q{depth['Q']:g}", "over 0", "correct the depth of a peck")
    return depth


def _to(machine: Machine, at: tuple[float, float], height: float, feed: Feed | None) -> None:
    """A straight move of a cycle, in coordinates of the plane."""
    first, second, across = PLANES[machine.modal.plane]
    tip: Tip = [0.0, 0.0, 0.0]
    tip[first], tip[second], tip[across] = at[0], at[1], height
    machine.motion.straight(tip, machine.motion.turned({}, absolute=True), feed)


def _cancel_motion(machine: Machine, block: GcodeBlock, code: str) -> None:
    if block.values.keys() & _AXES:
        raise GcodeError(f"axis words with {code}", "a motion word with them", "add G0 or G1 instead")
    machine.modal.motion = ""
    machine.modal.cycle = machine.modal.level = None


def _home(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
    """By way of the block's point, at which nothing is cut, to where the machine has its home."""
    if machine.motion.traced and not machine.motion.homed and block.values.keys() & _AXES:
        tip, _ = machine.target(block)
        machine.motion.straight(tip, machine.angles(block), None)
    else:  # from where the file has not said
        for letter in LINEAR:
            block.take(letter)
        machine.motion.turned(machine.rotary(block), absolute=True)
    machine.motion.home()


# ------------------------------------------------------------- modal settings


def _setting(name: str, value: object) -> Act:
    def act(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
        setattr(machine.modal, name, value)

    return act


def _nothing(machine: Machine, block: GcodeBlock, code: str) -> None:
    """It moves nothing."""


def _parameters(*letters: str, needed: bool = False) -> Act:
    """It moves nothing, and takes these letters."""

    def act(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
        for letter in letters:
            value = block.need(letter, code) if needed else block.take(letter)
            if not (value is None or value >= 0.0):
                raise GcodeError(f"{letter}{value:g}", ">= 0", "correct it")

    return act


def _units(machine: Machine, block: GcodeBlock, code: str) -> None:
    modal = machine.modal
    unit_mm = INCH_MM if code == "G20" else 1.0
    if modal.assumed_mm and unit_mm != 1.0:
        bound = "before the first length: what stands above was read as mm"
        raise GcodeError(code, bound, "write it at the beginning of the program")
    if modal.unit_mm not in (None, unit_mm):
        if "F" in block.values:
            bound = "in a line of its own: in which unit F is, is not clear"
            raise GcodeError(f"{code} and F", bound, "part the line")
        modal.feed, modal.cycle = None, None
        if modal.motion not in ("G0", "G1", "G2", "G3"):
            modal.motion = ""
    modal.unit_mm = unit_mm


def _feed_mode(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
    if machine.modal.feed_mode != code:
        machine.modal.feed_mode, machine.modal.feed = code, None


def _refused(bound: str, remedy: str) -> Act:
    def act(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
        raise GcodeError(code, bound, remedy)

    return act


_COORDINATES: Final = _refused(
    "left out: it moves the coordinates by what the machine holds, or away from the first work offset",
    "have the program written in one coordinate system, that of G54",
)
_RADIUS: Final = _refused(
    "left out: the tool's radius is not in the file, and the path of its centre depends on it",
    "have the program written for the tool's centre, with G40",
)
_MACHINE: Final = _refused(
    "left out: what it does depends on the machine or on a measurement",
    "have the program written without it",
)
_PROGRAMS: Final = _refused(
    "left out: it runs another program", "put its lines here, as a subroutine (O-words)"
)
_CYCLES: Final = _refused(
    "one of the cycles G73, G81, G82, G83", "have the moves written instead of the cycle"
)


def _plane(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
    if machine.modal.plane != code:
        machine.modal.plane, machine.modal.cycle = code, None


# ------------------------------------------------------------------ tools


def _mount(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
    modal = machine.modal
    if not modal.waiting:
        raise GcodeError("M6 without T", "after a T word", "say which tool")
    modal.length_due = modal.length_due or bool(modal.length)
    modal.tool, modal.length, modal.tool_length = modal.waiting, "", ""
    machine.motion.mount(modal.tool)


def _length_of_table(machine: Machine, block: GcodeBlock, code: str) -> None:
    """Which tool's length of the machine's table holds."""
    tool = machine.modal.tool
    number = block.take("H")
    name = tool if number is None else str(integer(number, "the number of a tool length"))
    if not name:
        raise GcodeError(f"{code} without H", "with H, or after T and M6", "say which tool's length")
    if tool and name != tool:
        bound = f"H{tool}, the length of the mounted tool"
        raise GcodeError(f"H{name}", bound, "correct H, or mount that tool")
    _use_length(machine, f"H{name}")
    if code == "G43.4":
        machine.motion.tcp = True


def _length_given(machine: Machine, block: GcodeBlock, code: str) -> None:
    """The tool's length, along Z alone."""
    value = machine.length(block, "Z")
    for letter in ("X", "Y", *ROTARY):
        if block.take(letter):
            raise GcodeError(f"{code} {letter}", "a length along Z alone", "take it out")
    if value is None or not (value >= 0.0):
        raise GcodeError(f"{code} without a length", "with Z >= 0", "add the tool's length, Z")
    _use_length(machine, f"Z{value:g}")
    machine.motion.has_length(value)


def _use_length(machine: Machine, length: str) -> None:
    modal = machine.modal
    if modal.tool_length and modal.tool_length != length:
        bound = f"{modal.tool_length}, as above: a tool has one length"
        raise GcodeError(f"tool length {length}", bound, "correct one of them, or mount the other tool")
    if not modal.length and machine.motion.traced:
        bound = "before the tool's first position: coordinates above it are another point's"
        raise GcodeError(f"tool length {length}", bound, "write it before the first X Y Z")
    if not modal.length:
        machine.motion.lose_height()
    modal.length = modal.tool_length = length
    modal.length_due = False


def _length_off(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
    machine.motion.tcp = False
    machine.modal.length_due = False
    if machine.modal.length:
        machine.modal.length = ""
        machine.motion.home()


def _tcp(*, on: bool) -> Act:
    def act(machine: Machine, block: GcodeBlock, code: str) -> None:  # noqa: ARG001 - an `Act`
        machine.motion.tcp = on

    return act


# ---------------------------------------------------------------- the table

ORDER: Final = (
    "feed mode",
    "units",
    "tool change",
    "input and output",
    "spindle",
    "coolant",
    "overrides",
    "user",
    "kinematics",
    "spindle mode",
    "lathe",
    "plane",
    "cutter compensation",
    "tool length",
    "work offset",
    "path control",
    "distance",
    "arc distance",
    "retract",
    "non-modal",
    "motion",
    "stop",
)
"""Modal groups, in the order in which their words act."""
_BEFORE_FEED: Final = frozenset({"feed mode", "units"})
_RANK: Final = MappingProxyType({group: rank for rank, group in enumerate(ORDER)})
_AXES: Final = frozenset(LINEAR + ROTARY)
_TAKES_P: Final = frozenset({"G2", "G3", "G4", "G64", "G73", "G81", "G82", "G83"})


def _table() -> dict[str, Row]:
    rows = [
        Row("G0", "motion", _straight, "positioning", moves=True),
        Row("G1", "motion", _straight, "straight at the feed", moves=True),
        Row("G2", "motion", _arc, "arc or helix, clockwise", moves=True),
        Row("G3", "motion", _arc, "arc or helix, counter-clockwise", moves=True),
        Row("G73", "motion", _cycle, "drill in pecks, breaking chips", moves=True),
        Row("G80", "motion", _cancel_motion, "no motion, no cycle"),
        Row("G81", "motion", _cycle, "drill", moves=True),
        Row("G82", "motion", _cycle, "drill and dwell", moves=True),
        Row("G83", "motion", _cycle, "drill in pecks, clearing chips", moves=True),
        *(Row(code, "plane", _plane, f"plane {axes}") for code, axes in _PLANE_AXES),
        Row("G20", "units", _units, "inches"),
        Row("G21", "units", _units, "mm"),
        Row("G90", "distance", _setting("absolute", value=True), "coordinates are absolute"),
        Row("G91", "distance", _setting("absolute", value=False), "coordinates are differences"),
        Row("G90.1", "arc distance", _setting("arc_absolute", value=True), "centres are absolute"),
        Row("G91.1", "arc distance", _setting("arc_absolute", value=False), "centres from the start"),
        Row("G93", "feed mode", _feed_mode, "a move takes 1/F min"),
        Row("G94", "feed mode", _feed_mode, "F per min"),
        Row("G95", "feed mode", _feed_mode, "F per revolution"),
        Row("G98", "retract", _setting("old_level", value=True), "cycles end where they began"),
        Row("G99", "retract", _setting("old_level", value=False), "cycles end at R"),
        Row("G4", "non-modal", _parameters("P", needed=True), "dwell"),
        Row("G28", "non-modal", _home, "return home: the tool's part ends", moves=True),
        Row("G30", "non-modal", _home, "return home: the tool's part ends", moves=True),
        Row("G40", "cutter compensation", _nothing, "no cutter compensation"),
        Row("G43", "tool length", _length_of_table, "tool length of the machine's table"),
        Row("G43.1", "tool length", _length_given, "tool length Z", moves=True),
        Row("G43.4", "tool length", _length_of_table, "tool length, tool-centre-point control on"),
        Row("G49", "tool length", _length_off, "no tool length, no tool-centre-point control"),
        Row("G54", "work offset", _nothing, "the first work offset"),
        Row("G61", "path control", _nothing, "exact path"),
        Row("G61.1", "path control", _nothing, "exact stop"),
        Row("G64", "path control", _parameters("P", "Q"), "corners blended by the controller"),
        Row("G8", "lathe", _nothing, "X is a radius"),
        Row("G97", "spindle mode", _nothing, "S is a speed"),
        Row("M428", "kinematics", _tcp(on=True), "tool-centre-point control on"),
        Row("M429", "kinematics", _tcp(on=False), "tool-centre-point control off"),
        Row("M6", "tool change", _mount, "the tool of T is mounted"),
        *(Row(code, "spindle", _nothing, "spindle") for code in ("M3", "M4", "M5")),
        *(Row(code, "coolant", _nothing, "coolant") for code in ("M7", "M8", "M9")),
        *(Row(code, "overrides", _nothing, "overrides") for code in ("M48", "M49")),
        *(Row(code, "stop", _nothing, "the machine waits") for code in ("M0", "M1")),
        *(Row(code, "stop", _setting("running", value=False), "end") for code in ("M2", "M30")),
    ]
    for group, act, codes in _REFUSED:
        rows += [Row(code, group, act, "refused") for code in codes.split()]
    return {row.code: row for row in rows}


_PLANE_AXES: Final = (("G17", "XY"), ("G18", "ZX"), ("G19", "YZ"))
_REFUSED: Final[tuple[tuple[str, Act, str], ...]] = (
    ("cutter compensation", _RADIUS, "G41 G41.1 G42 G42.1"),
    ("work offset", _COORDINATES, "G55 G56 G57 G58 G59 G59.1 G59.2 G59.3"),
    ("non-modal", _COORDINATES, "G10 G50 G51 G52 G53 G68 G68.2 G69 G92 G92.1 G92.2 G92.3"),
    ("tool length", _COORDINATES, "G43.2 G43.5"),
    ("non-modal", _MACHINE, "G28.1 G30.1"),
    ("motion", _MACHINE, "G33 G33.1 G38.2 G38.3 G38.4 G38.5"),
    ("motion", _CYCLES, "G76 G84 G85 G86 G87 G88 G89"),
    ("lathe", _MACHINE, "G7"),
    ("spindle mode", _MACHINE, "G96"),
    ("input and output", _MACHINE, "M62 M63 M64 M65 M66 M67 M68"),
    ("overrides", _MACHINE, "M50 M51 M52 M53"),
    ("tool change", _MACHINE, "M61"),
    ("stop", _MACHINE, "M60"),
    ("user", _PROGRAMS, "M98 M99"),
    ("kinematics", _MACHINE, "M430"),
)
CODES: Final = MappingProxyType(_table())
"""Every G and M word that is known."""
NAMED: Final = MappingProxyType({"TRAORI": "M428", "TRAFOOF": "M429"})
"""Tool-centre-point control by a name, alone in its line."""


# ----------------------------------------------------------------- the reader


class _Remarks:
    """What is told of the lines: bounded, and nothing where nobody wants to know."""

    def __init__(self, told: Told | None) -> None:
        self._told = told
        self._left = TOLD_MAX
        self._assumed = False

    def tell(self, line: int, understood: list[str], machine: Machine) -> None:
        """What one block did, and where the tip is."""
        if self._told is None or not self._left:
            return
        modal, tip = machine.modal, machine.motion.tip
        place = " ".join(
            f"{letter}{at:.6g}" for letter, at in zip(LINEAR, tip, strict=True) if at is not None
        )
        text = "; ".join([*understood, f"tip {place or 'not known'} (mm)"])
        if modal.assumed_mm and not self._assumed:
            self._assumed = True
            text = f"no G20 or G21 above: lengths are read as mm; {text}"
        self._left -= 1
        self._told(line, text[:TOLD_CHARACTERS])
        if not self._left:
            self._told(line, f"more than {TOLD_MAX} lines: nothing more is told")


def read_gcode(file: object, data: bytes, reading: Reading, pose_limit: int, told: Told | None) -> ToolPath:
    """The poses of a G-code program.

    Raises:
        InputError: names the line, what was found, and what is accepted.
    """
    check_lines(file, data, pose_limit)
    lines = decode(file, data).split("\n")
    trace, remarks = Trace(file, pose_limit), _Remarks(told)
    program = None
    try:
        machine = Machine(trace, reading)
        parameters = Parameters()
        program = Program(lines, parameters, len(data) + min(WORK_PER_POSE * pose_limit, WORK_MAX))
        for text in program.blocks():
            if text:
                machine.motion.line = program.index + 1
                understood = _execute(machine, parameters, text)
                remarks.tell(program.index + 1, understood, machine)
                if not machine.modal.running:
                    break
    except GcodeError as error:
        place = f"line {error.line}" if error.line else f"line {program.index + 1}" if program else ""
        raise InputError(file, place, error.found, error.bound, error.remedy) from None
    return trace.finish()


def _execute(machine: Machine, parameters: Parameters, text: str) -> list[str]:
    """One line; a name of tool-centre-point control stands for its M word."""
    named = NAMED.get(text) if text.startswith("TRA") else None
    block = GcodeBlock(codes=[named]) if named else read_block(text, parameters)
    return machine.execute(block)
