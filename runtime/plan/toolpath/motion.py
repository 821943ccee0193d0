"""Where the tool is while an RS-274 program is followed: tip, rotary axes, and the moves between, into a trace.

Coordinates are known once the program has named them: where the machine stood before, at a tool change or at its home
no file says. With tool-centre-point control X, Y and Z are the tip in the workpiece and the tool axis follows the
rotary words; without it they are the tip only while every rotary axis stands at 0, and only that is accepted.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from cutgate.runtime.plan.toolpath.circular import CircleError, CircularMove
from cutgate.runtime.plan.toolpath.expressions import GcodeError
from cutgate.runtime.plan.toolpath.model import Reading
from cutgate.runtime.plan.toolpath.rotary import CONVENTIONS, RotaryConvention
from cutgate.runtime.plan.toolpath.trace import Trace

LINEAR: Final = "XYZ"
ROTARY: Final = "ABC"
UPRIGHT: Final = (0.0, 0.0, 1.0)
SAME_ANGLE: Final = 1e-6
"""rad; ends of an arc that are closer, yet not the same, could be a whole turn or none."""

Tip = list[float | None]
Feed = Callable[[float], float | None]
"""The feed in mm/s of a move whose tip goes so many mm."""


def convention_of(name: str | None) -> RotaryConvention | None:
    """The convention that was declared.

    Raises:
        GcodeError: there is none of this name.
    """
    if name is None:
        return None
    if name not in CONVENTIONS:
        raise GcodeError(f"--rotary {name}", f"one of {', '.join(CONVENTIONS)}", "see docs/files.md")
    return CONVENTIONS[name]


class ToolMotion:
    """The tool's place, and its moves.

    Args:
        trace: takes the poses.
        reading: what was declared.

    Attributes:
        line: of the file, for the poses.
        tip: X, Y, Z in mm; None where unknown.
        tcp: whether tool-centre-point control is on.
        homed: the mounted tool has gone home: what it did is over.

    Raises:
        GcodeError: no such rotary convention.
    """

    def __init__(self, trace: Trace, reading: Reading) -> None:
        self.line = 0
        self.tip: Tip = [None, None, None]
        self.tcp = False
        self.homed = False
        self._trace = trace
        self._reading = reading
        self._convention = convention_of(reading.rotary)
        self._angles: dict[str, float | None] = {}
        self._upright = False

    # ------------------------------------------------------------- what is known

    @property
    def traced(self) -> bool:
        """Whether the mounted tool has a pose already."""
        return self._trace.pose is not None

    def lose(self) -> None:
        """The tool is somewhere that the file does not say; its rotary axes are where they were."""
        self.tip = [None, None, None]

    def lose_height(self) -> None:
        """A tool length is added to Z from now on, or another one: the same Z is another height."""
        self.tip = [*self.tip[:2], None]

    def mount(self, tool: str) -> None:
        """Another tool: neither its place nor that of the rotary axes is known."""
        self._trace.mount(self.line, tool)
        self.lose()
        self._angles = dict.fromkeys(self._angles)
        self.homed = False

    def home(self) -> None:
        """The tool goes home, by way of a point that cuts nothing."""
        self.homed = self.homed or self.traced
        self.lose()
        self._angles = dict.fromkeys(self._angles)

    def has_length(self, length_mm: float) -> None:
        """The file says how long the tool is."""
        self._trace.has_length(length_mm)

    def turned(self, letters: dict[str, float], *, absolute: bool) -> dict[str, float | None]:
        """The rotary axes after these words.

        Raises:
            GcodeError: no convention gives them a meaning, or their place is not known.
        """
        if not letters:
            return self._angles
        convention = self._convention
        if convention is None:
            found, known = f"{next(iter(letters))} word, a rotary axis", ", ".join(CONVENTIONS)
            raise GcodeError(found, "read by a declared convention", f"declare --rotary, one of {known}")
        if self._upright and not self._angles:
            bound = "there from the first position on: the tool axis was taken as (0, 0, 1) so far"
            remedy = f"give {convention.tilt} and {convention.turn} in the first move of the file"
            raise GcodeError("the first rotary word after moves", bound, remedy)
        angles = self._angles or dict.fromkeys((convention.tilt, convention.turn))
        for letter, value in letters.items():
            if letter not in angles:
                bound = f"{convention.tilt} or {convention.turn}, as {convention.name} has them"
                raise GcodeError(f"{letter} word", bound, "declare the convention of this file")
            before = angles[letter]
            if not absolute and before is None:
                raise GcodeError(
                    f"{letter} in G91", f"known before: no {letter} stands above", "use G90 once"
                )
            angles = {**angles, letter: value if absolute or before is None else before + value}
        return angles

    # ------------------------------------------------------------------ moves

    def straight(
        self, tip: Tip, angles: dict[str, float | None], feed: Feed | None, *, named: bool = False
    ) -> None:
        """To a tip and rotary angles, all at constant rates.

        Args:
            tip: mm; None where still unknown.
            angles: deg.
            feed: None of a positioning move.
            named: the block names X, Y and Z, all three.

        Raises:
            GcodeError: a cutting move from or to where nobody knows, or an angle that cannot be understood.
        """
        if feed is not None:
            self._check_start(named=named)
        known = self._known(tip)
        if known is None or self.homed:
            self.tip, self._angles = tip, angles
            return
        before, axis = self._known(self.tip), self._axis(angles)
        if before is None or not self.traced or angles == self._angles:
            self._step(known, axis, feed, _distance(before, known))
        else:
            self._turn(before, known, angles, feed)
        self.tip, self._angles = [*known], angles

    def circular(self, move: CircularMove, feed: Feed, turned: dict[str, float | None]) -> None:
        """Along an arc or a helix, with the tool axis as it is.

        Raises:
            GcodeError: no circle, or rotary words that move something.
        """
        self._check_start(named=False)
        if turned != self._angles:
            bound = "a constant tool axis in an arc"
            raise GcodeError("a rotary word that turns", bound, "have straight moves written instead of arcs")
        axis = self._axis(turned)
        try:
            points, tolerance_mm = move.chords(self._reading.arc_tolerance_mm, self._trace.room)
        except CircleError as error:
            raise GcodeError(error.found, error.bound, "correct the arc") from None
        steps = np.diff(np.vstack([move.start, points]), axis=0)
        rate = feed(float(np.linalg.norm(steps, axis=1).sum()))
        for x, y, z in points.tolist():
            self._trace.move(self.line, (x, y, z), axis, feed_mm_s=rate)
        self._trace.widen(tolerance_mm)
        self.tip = points[-1].tolist()

    def _turn(
        self,
        before: tuple[float, float, float],
        tip: tuple[float, float, float],
        angles: dict[str, float | None],
        feed: Feed | None,
    ) -> None:
        """A straight move in which the rotary axes turn."""
        (convention, start), (_, end) = self._pair(self._angles), self._pair(angles)
        tolerance, room = self._reading.axis_tolerance_deg, self._trace.room
        pieces = convention.pieces(start, end, tolerance, room)
        if pieces is None:
            found = f"over {room} pieces for the turn of the tool axis"
            remedy = "raise --axis-tolerance-deg, or part the program"
            raise GcodeError(found, f"<= {room}, what is left of the pose limit", remedy)
        axes, bound_deg = pieces
        distance, count = _distance(before, tip), len(axes)
        rate = feed(distance) if feed and distance else None
        for k, axis in enumerate(axes[:-1], start=1):
            x, y, z = (p + (q - p) * (k / count) for p, q in zip(before, tip, strict=True))
            self._trace.move(self.line, (x, y, z), axis, positioning=feed is None, feed_mm_s=rate)
        self._trace.move(self.line, tip, axes[-1], positioning=feed is None, feed_mm_s=rate)
        self._trace.widen(0.0, bound_deg)

    def _step(
        self, tip: tuple[float, float, float], axis: tuple[float, float, float], feed: Feed | None, mm: float
    ) -> None:
        rate = feed(mm) if feed and mm else None
        self._trace.move(self.line, tip, axis, positioning=feed is None, feed_mm_s=rate)

    # ------------------------------------------------------------- what is refused

    def _check_start(self, *, named: bool) -> None:
        if self.homed:
            bound = "before its return home (G28, G30, G49): what it does afterwards cannot be joined to it"
            raise GcodeError("a cutting move of the same tool", bound, "mount a tool (T M6) before it")
        known = self._known(self.tip) is not None
        if not (known or (named and self.tip == [None, None, None])):
            unknown = " ".join(c for c, at in zip(LINEAR, self.tip, strict=True) if at is None)
            bound = "from a place that the file names"
            remedy = "position the tool above it with G0 X Y Z"
            raise GcodeError(f"a cutting move while {unknown} is not known", bound, remedy)

    @staticmethod
    def _known(tip: Tip) -> tuple[float, float, float] | None:
        x, y, z = tip
        return None if x is None or y is None or z is None else (x, y, z)

    def _pair(self, angles: dict[str, float | None]) -> tuple[RotaryConvention, tuple[float, float]]:
        """The convention, and tilt and turn in deg.

        Raises:
            GcodeError: one of them is not known.
        """
        convention = self._convention
        values = (angles.get(convention.tilt), angles.get(convention.turn)) if convention else (None, None)
        tilt, turn = values
        if convention is None or tilt is None or turn is None:
            names = " and ".join(letter for letter, at in angles.items() if at is None)
            bound = "named since the beginning or the last tool change, before the tool is positioned"
            raise GcodeError(f"{names} not known", bound, f"give {names} here")
        return convention, (tilt, turn)

    def _axis(self, angles: dict[str, float | None]) -> tuple[float, float, float]:
        """The tool axis at these angles; upright where the file has no rotary word so far.

        Raises:
            GcodeError: they are not known, or need tool-centre-point control.
        """
        if not angles:
            self._upright = True
            return UPRIGHT
        convention, pair = self._pair(angles)
        if not self.tcp and (any(pair) or any(self._angles.values())):
            bound = "all 0 without tool-centre-point control: the tip depends on the machine's pivot"
            remedy = "have it written with G43.4, M428 or TRAORI, before the first move"
            raise GcodeError("a rotary axis not at 0", bound, remedy)
        return convention.axis(*pair)


def _distance(before: tuple[float, float, float] | None, tip: tuple[float, float, float]) -> float:
    if before is None:
        return 0.0
    x, y, z = (p - q for p, q in zip(before, tip, strict=True))
    return float((x * x + y * y + z * z) ** 0.5)


def same_direction(start: complex, end: complex) -> bool:
    """Whether two ends of an arc, seen from its centre, are closer than they can be told apart, and not the same."""
    if not (abs(start) > 0.0 and abs(end) > 0.0):
        return False
    off = abs(start / abs(start) - end / abs(end))
    return 1e-9 <= off < SAME_ANGLE
