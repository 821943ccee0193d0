"""LinuxCNC's stand-alone interpreter as an oracle: random programs, and what it makes of them, as straight moves and arcs.

It is a program of its own, named by an environment variable; nothing of ours is in it. Its output has four decimals.
"""

import math
import os
import random
import re
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cutgate.runtime.plan.toolpath.model import Cut

VARIABLE = "CUTGATE_RS274"
"""Names the program ``rs274``; what it needs to run (LD_LIBRARY_PATH) is the environment's."""
_CALL = re.compile(r"([A-Z_]+)\(([^)]*)\)")
_PLANES = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "ZX": (2, 0, 1), "YZ": (1, 2, 0)}
INCH_MM = 25.4
Point = tuple[float, float, float]


def interpreter() -> str | None:
    return os.environ.get(VARIABLE)


@dataclass(frozen=True)
class Move:
    """One canonical move, mm."""

    end: Point
    feeds: bool
    centre: Point | None = None
    plane: tuple[int, int, int] = (0, 1, 2)
    turns: int = 0


def interpreted(program: str, folder: Path) -> tuple[list[Move], bool]:
    """What the interpreter does, and whether it came to the program's end."""
    for name, text in (
        ("program.ngc", program),
        ("tools.tbl", "T1 P1 Z0\nT2 P2 Z0\n"),
        ("parameters.var", ""),
    ):
        (folder / name).write_text(text, encoding="utf-8")
    command = [str(interpreter()), "-g", "-t", "tools.tbl", "-v", "parameters.var", "program.ngc"]
    # It maps its tool table into a file at home: two at once would share it.
    home = {**os.environ, "HOME": str(folder)}
    done = subprocess.run(
        command, cwd=folder, env=home, capture_output=True, text=True, timeout=60, check=False
    )
    return list(_moves(done.stdout)), "PROGRAM_END()" in done.stdout


def _moves(output: str) -> Iterator[Move]:
    plane, scale, at = _PLANES["XY"], 1.0, [0.0, 0.0, 0.0]
    for name, text in _CALL.findall(output):
        words = [word.strip() for word in text.split(",")]
        if name == "USE_LENGTH_UNITS":
            scale = INCH_MM if "INCH" in text else 1.0
        elif name == "SELECT_PLANE":
            plane = _PLANES[text[-2:]]
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            at = [float(word) * scale for word in words[:3]]
            yield Move(tuple(at), name == "STRAIGHT_FEED")
        elif name == "ARC_FEED":
            first, second, across = plane
            centre, turns = list(at), int(words[4])
            at = list(at)
            at[first], at[second], at[across] = (float(words[i]) * scale for i in (0, 1, 5))
            centre[first], centre[second] = (float(words[i]) * scale for i in (2, 3))
            yield Move(tuple(at), True, tuple(centre), plane, turns)


def differs(moves: list[Move], cut: Cut, tolerance_mm: float, arc_mm: float) -> str:
    """The first difference between what the interpreter does and a cut; empty where there is none.

    Args:
        moves: of the interpreter.
        cut: ours, arcs as chords.
        tolerance_mm: of places, by the decimals of the interpreter.
        arc_mm: of points on arcs.
    """
    tips, index, at = cut.tips_mm, 0, None
    for number, move in enumerate(moves):
        start, at = at, move.end
        if move.centre is not None and start is not None:
            count, off = _along_arc(tips[index:], start, move)
            if not (count and off <= arc_mm and _near(tips[index + count - 1], move.end, tolerance_mm)):
                return f"arc {number}, {move}, line {cut.lines[min(index, len(tips) - 1)]}: {off:g} mm off"
            index += count
        elif index < len(tips) and _near(tips[index], move.end, tolerance_mm):
            if index and bool(cut.positioning[index]) is move.feeds:
                return f"move {number}, {move}, line {cut.lines[index]}: cutting or positioning"
            index += 1
        elif start is None or not _near(start, move.end, tolerance_mm):  # what moves nothing leaves no pose
            return f"move {number}, {move}: {tips[index : index + 1]} in line {cut.lines[index : index + 1]}"
    return "" if index == len(tips) else f"{len(tips) - index} poses more, from line {cut.lines[index]}"


def _near(point: Sequence[float] | np.ndarray, other: Sequence[float], tolerance_mm: float) -> bool:
    return bool(np.abs(np.subtract(point, other)).max() <= tolerance_mm)


def _along_arc(points: np.ndarray, start: Point, move: Move) -> tuple[int, float]:
    """How many of the points follow an arc to its end, and how far off they are: each has its angle from the last one."""
    first, second, across = move.plane
    spans = [(p[first] - move.centre[first], p[second] - move.centre[second]) for p in (start, move.end)]
    angles, radii = [math.atan2(v, u) for u, v in spans], [math.hypot(u, v) for u, v in spans]
    sense = 1.0 if move.turns > 0 else -1.0
    once = (sense * (angles[1] - angles[0])) % math.tau
    once = math.tau if once < 1e-5 or once > math.tau - 1e-5 else once
    sweep = once + math.tau * (abs(move.turns) - 1)
    total, last, worst = 0.0, angles[0], 0.0
    for count, point in enumerate(points, start=1):
        u, v = point[first] - move.centre[first], point[second] - move.centre[second]
        step = (sense * (math.atan2(v, u) - last)) % math.tau
        total, last = total + step, math.atan2(v, u)
        along = total / sweep
        radius = radii[0] + along * (radii[1] - radii[0])
        height = start[across] + along * (move.end[across] - start[across])
        worst = max(worst, abs(math.hypot(u, v) - radius), abs(point[across] - height))
        if total >= sweep - 2e-3:
            return count, max(worst, abs(total - sweep) * radii[0])
    return 0, worst


class Programs:
    """Random programs; most are right."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._label = 100

    def program(self) -> str:
        r = self._random
        self._loops = r.choice([(10, 11, 12), (10, 12), (11,)])
        self._inch = r.random() < 0.2
        unit = "G20" if self._inch else "G21"
        lines = [f"{unit} G90 G17 G94", "#1=2 #2=-3.5 #<a>=1.25 #100=4 #<_g>=0.5", "F100"]
        lines += ["o50 sub", "G1 X#1 Y[#2*#<_g>]", "o51 if [#1 gt 2]", "G0 Z[#1+1]", "o50 return [#1]"]
        lines += ["o51 endif", "G1 Z#2", "o50 endsub [#2]"]
        lines += [f"G0 X{self.number()} Y{self.number()} Z{self.number()}"]
        for _ in range(r.randint(3, 14)):
            lines += self.statement(0)
        return "\n".join([*lines, "M2", ""])

    def number(self) -> str:
        return f"{self._random.uniform(-20, 20):.{self._random.randint(0, 4)}f}"

    def value(self, depth: int = 0) -> str:
        r = self._random
        kind = r.randint(0, 9 if depth < 3 else 3)
        if kind <= 2:
            return self.number() if depth == 0 else f"{r.uniform(0, 9):.2f}"
        if kind == 3:
            return r.choice(["#1", "#2", "#<a>", "#100", "#<_g>", "-#1", "#[99+1]"])
        if kind == 4:
            name = r.choice(["abs", "cos", "sin", "fix", "fup", "round"])
            return f"{name}[{self.value(depth + 1)}]"
        if kind == 5:
            return f"atan[{self.value(depth + 1)}]/[{self.value(depth + 1)}]"
        if kind == 6:
            return f"sqrt[abs[{self.value(depth + 1)}]]"
        if kind == 7:
            return f"[{self.value(depth + 1)} {r.choice(['lt', 'gt', 'and', 'or', 'xor', 'LE', 'GE'])} {self.value(depth + 1)}]"
        terms = [self.value(depth + 1) for _ in range(r.randint(2, 4))]
        text = terms[0]
        for term in terms[1:]:
            text += f" {r.choice(['+', '-', '*', '+', '-', 'mod'])} {term}"
        return f"[{text}]"

    def small(self) -> str:
        """A value that stays within some metres: never a product of many."""
        return f"[{self.value(1)} mod 50]" if self._random.random() < 0.4 else self.number()

    def words(self) -> str:
        r = self._random
        chosen = r.sample("XYZ", r.randint(1, 3))
        return " ".join(
            f"{letter if r.random() < 0.8 else letter.lower()}{self.small()}" for letter in chosen
        )

    def arc(self) -> list[str]:
        """A circle by its centre, from where the tool is: by differences, so that they are right wherever it is."""
        r = self._random
        plane = r.choice([("G17", "XYZ", "IJ"), ("G18", "ZXY", "KI"), ("G19", "YZX", "JK")])
        code, axes, centre = plane
        radius, start, sweep = r.uniform(1, 12), r.uniform(0, math.tau), r.uniform(0.05, math.tau - 0.05)
        way = r.choice(["G2", "G3"])
        c = (-radius * math.cos(start), -radius * math.sin(start))
        end = start + (sweep if way == "G3" else -sweep)
        d = (c[0] + radius * math.cos(end), c[1] + radius * math.sin(end))
        lines = [f"{code} G91"]
        helix = f" {axes[2]}{r.uniform(-5, 5):.3f}" if r.random() < 0.5 else ""
        kind = r.random()
        if kind < 0.2:
            lines.append(f"{way} {centre[0]}{c[0]:.4f} {centre[1]}{c[1]:.4f}{helix} P{r.randint(1, 3)}")
        elif kind < 0.6:
            turns = f" P{r.randint(1, 3)}" if r.random() < 0.3 else ""
            lines.append(
                f"{way} {axes[0]}{d[0]:.5f} {axes[1]}{d[1]:.5f} {centre[0]}{c[0]:.5f} {centre[1]}{c[1]:.5f}{helix}{turns}"
            )
        else:
            sign = "-" if sweep > math.pi else ""
            lines.append(f"{way} {axes[0]}{d[0]:.5f} {axes[1]}{d[1]:.5f} R{sign}{radius:.5f}{helix}")
        return [*lines, "G17 G90"] if r.random() < 0.7 else [*lines, "G90"]

    def cycle(self) -> list[str]:
        r = self._random
        code = r.choice(["G81", "G82 P0.5", "G83 Q1.5", "G73 Q2"])
        level = r.choice(["G98", "G99"])
        if r.random() < 0.5:
            lines = [
                f"G90 {level} {code} X{self.number()} Y{self.number()} Z{r.uniform(-25, -21):.2f} R{self.number()}"
            ]
        else:
            lines = [
                f"G91 {level} {code} X{self.number()} Z{r.uniform(-9, -1):.2f} R{r.uniform(-3, 3):.2f} L{r.randint(1, 3)}"
            ]
        for _ in range(r.randint(0, 2)):
            lines.append(f"{r.choice(['', 'G98 ', 'G99 '])}{r.choice('XY')}{self.number()}")
        return ["G17", *lines, "G80 G90"]

    def statement(self, depth: int) -> list[str]:
        r = self._random
        kind = r.choice([*range(9), 9, 13, *self._loops] if depth < 2 else range(9))
        if kind <= 2:
            return [f"{r.choice(['G0', 'G1', 'g01', 'G 1', 'g00'])} {self.words()}"]
        if kind == 3:
            return ["G1", f"N{r.randint(1, 99)} {self.words()} (a comment) ; and another"]
        if kind == 4:
            return [f"{r.choice(['#1', '#2', '#<a>', '#100', '#<_g>'])}=[{self.value(1)} mod 30 - 15]"]
        if kind == 5:
            return self.arc()
        if kind == 6:
            return self.cycle()
        if kind == 7:
            return ["G91", f"G1 {self.words()}", "G90"]
        if kind == 8:
            return [r.choice(["M3 S500", "M8", "G4 P0.1", "G64", "G61", "G40", "G49", "T1 ", "S100 F50"])]
        return self._compound(depth, kind)

    def _compound(self, depth: int, kind: int) -> list[str]:
        r = self._random
        self._label += 1
        name, counter = f"o{self._label}", f"#<n{self._label}>"
        body = [line for _ in range(r.randint(1, 3)) for line in self.statement(depth + 1)]
        if kind == 9:
            other, second = self.statement(depth + 1), self.statement(depth + 1)
            middle = [f"{name} elseif [{self.value(1)} gt 1]", *second] if r.random() < 0.5 else []
            return [
                f"{name} if [{self.value(1)} gt 0]",
                *body,
                *middle,
                f"{name} else",
                *other,
                f"{name} endif",
            ]
        if kind == 10:
            return [f"{name} repeat [{r.randint(0, 3)}]", *body, f"{name} endrepeat"]
        head, step = f"{counter}=0", f"{counter}=[{counter}+1]"
        leaving = []
        if len(self._loops) < 3 and r.random() < 0.5:
            word = r.choice(["break", "continue"])
            leaving = [f"{name}9 if [{counter} eq 2]", f"{name} {word}", f"{name}9 endif"]
        if kind == 11:
            end = f"{name} while [{counter} lt 3]"
            return [head, f"{name} do", step, *leaving, *body, end]
        if kind == 12:
            return [head, f"{name} while [{counter} lt 3]", step, *leaving, *body, f"{name} endwhile"]
        return [f"o50 call [{self.small()}] [{self.small()}]", "G1 X[#<_value> mod 20] Y#1"]
