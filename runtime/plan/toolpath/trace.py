"""Collects the poses of a tool path while a reader follows its file."""

import math
from array import array
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.poses import COORDINATE_MM, shorter
from cutgate.runtime.plan.toolpath.model import Cut, ToolPath, too_many

Point = tuple[float, float, float]

TOOLS_MAX: Final = 1000
"""Cuts of one file."""


@dataclass(slots=True)
class _Open:
    """A cut that is being collected; ``rows`` holds x, y, z, i, j, k of each pose.

    Python 3.11 has no ``array[float]`` to evaluate: it stands in quotes.
    """

    tool: str
    tool_length_mm: float | None
    rows: "array[float]" = field(default_factory=lambda: array("d"))
    lines: "array[int]" = field(default_factory=lambda: array("q"))
    positioning: bytearray = field(default_factory=bytearray)
    feeds_mm_s: "array[float]" = field(default_factory=lambda: array("d"))
    tolerance_mm: float = 0.0
    tolerance_deg: float = 0.0

    def closed(self) -> Cut:
        table = np.array(self.rows, dtype=np.float64).reshape(-1, 6)
        return Cut(
            tool=self.tool,
            tool_length_mm=self.tool_length_mm,
            tips_mm=table[:, :3].copy(),
            axes=table[:, 3:].copy(),
            lines=np.array(self.lines, dtype=np.int64),
            positioning=np.frombuffer(bytes(self.positioning), dtype=np.bool_),
            feeds_mm_s=np.array(self.feeds_mm_s, dtype=np.float64),
            tolerance_mm=self.tolerance_mm,
            tolerance_deg=self.tolerance_deg,
        )


class Trace:
    """What the tool has done so far.

    Args:
        file: for messages.
        pose_limit: most poses of all cuts together.
    """

    def __init__(self, file: object, pose_limit: int) -> None:
        self._file = file
        self._limit = pose_limit
        self._count = 0
        self._cuts: list[Cut] = []
        self._open = _Open("", None)

    @property
    def pose(self) -> tuple[Point, Point] | None:
        """Tip and axis where the tool stands; None before the first position of this tool."""
        rows = self._open.rows
        if not rows:
            return None
        x, y, z, i, j, k = rows[-6:]
        return (x, y, z), (i, j, k)

    @property
    def room(self) -> int:
        """So many poses may still be added."""
        return self._limit - self._count

    def mount(self, line: int, tool: str, length_mm: float | None = None) -> None:
        """Another tool, or the same anew: where it goes first is not known to be reached in any way.

        Raises:
            InputError: more than ``TOOLS_MAX`` cuts.
        """
        self._close()
        if not (len(self._cuts) < TOOLS_MAX):
            found, bound = f"over {TOOLS_MAX} tools", f"<= {TOOLS_MAX} tools"
            raise InputError(self._file, f"line {line}", found, bound, "part the file")
        self._open = _Open(tool, length_mm)

    def has_length(self, length_mm: float) -> None:
        """The file says how long the mounted tool is; whether two words agree is the reader's to check."""
        self._open.tool_length_mm = length_mm

    def move(
        self, line: int, tip: Point, axis: Point, *, positioning: bool = False, feed_mm_s: float | None = None
    ) -> None:
        """Straight to a pose, or there at once if it is the tool's first.

        A move that changes nothing leaves no pose.

        Args:
            line: where the file says so.
            tip: mm.
            axis: of length 1, from the tip toward the holder.
            positioning: nothing is to be cut on the way.
            feed_mm_s: of the tip, if the file gives one.

        Raises:
            InputError: beyond the limits of coordinates or poses.
        """
        row, path = (*tip, *axis), self._open
        if not all(math.isfinite(x) and abs(x) <= COORDINATE_MM for x in tip):
            bound = f"x, y, z within +-{COORDINATE_MM:g} mm"
            raise InputError(self._file, f"line {line}", list(tip), bound, "check its units")
        if path.rows and tuple(path.rows[-6:]) == row:
            return
        if not (self._count < self._limit):
            raise too_many(self._file, line, self._limit, shorter(self._limit))
        first = not path.rows
        self._count += 1
        path.rows.extend(row)
        path.lines.append(line)
        path.positioning.append(positioning or first)
        cutting = feed_mm_s is not None and not positioning and not first
        path.feeds_mm_s.append(feed_mm_s if cutting and feed_mm_s is not None else math.nan)

    def widen(self, tolerance_mm: float = 0.0, tolerance_deg: float = 0.0) -> None:
        """What the file describes may be this far from the straight moves that replace it."""
        path = self._open
        path.tolerance_mm = max(path.tolerance_mm, tolerance_mm)
        path.tolerance_deg = max(path.tolerance_deg, tolerance_deg)

    def finish(self) -> ToolPath:
        """All cuts; one without a move is none, unless the file has no other.

        Raises:
            InputError: the file moves no tool.
        """
        self._close()
        moving = tuple(cut for cut in self._cuts if len(cut.tips_mm) > 1)
        if not moving:
            raise InputError(self._file, "", None, "it moves no tool: a path needs two poses or more", "")
        return ToolPath(moving)

    def _close(self) -> None:
        if self._open.rows:
            self._cuts.append(self._open.closed())
