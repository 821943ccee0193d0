"""What the pictures of a verdict show: the workspace from above and from the side, the path in it, its worst places."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.config.screen import printable
from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.kinematics.pose import lengths
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.bounds.geometry import MIRRORED, Geometry, Segments, canonical
from cutgate.runtime.verification.bounds.points import Points, at
from cutgate.runtime.verification.placing.guidance import moved
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.report.summary import summary
from cutgate.runtime.verification.verdict import BOUNDARIES, Verdict
from cutgate.runtime.workspace.distance import signed_distance, signed_sides
from cutgate.runtime.workspace.planar import SIDES, Arc

VERTICES_MAX: Final = 2500
"""Of the path as it is drawn."""
PIECE_MM: Final = 1.0
PIECES_MAX: Final = 2000
"""A segment is drawn in pieces about so long, or longer, so that all have not many more: from the side they are curves."""
ARC_POINTS: Final = 361
ON_LINE_MM: Final = 1e-6
SAME_ROLL_RAD: Final = 0.01
SMALLEST: Final = 1e-300

LETTERS: Final = dict(
    zip(BOUNDARIES, ("I", "O", "L", "R", "T", "B", "W-", "W+", "P-", "P+", "V"), strict=True)
)
MEANINGS: Final = {
    "inner": "too near the column", "outer": "too far out", "left": "q0 at its upper limit", "right": "q0 at its lower limit",
    "top": "slide at its upper end", "bottom": "slide at its lower end", "roll_min": "q3 at its lower limit",
    "roll_max": "q3 at its upper limit", "pitch_min": "q4 at its lower limit", "pitch_max": "q4 at its upper limit",
    "wrist_singularity": "tool vertical",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Drawn:
    """The wrist centre's way, of n points.

    Attributes:
        above: x and y in slide coordinates, mm, shape (n, 2).
        side: distance from the column and height, mm, shape (n, 2).
        pose: number of the pose that each stems from, with the part of the segment that follows, shape (n,).
        off_mm: what was left out lies no further than this from the lines, in both views.
    """

    above: Floats
    side: Floats
    pose: Floats
    off_mm: float


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst place of one boundary.

    Attributes:
        name: of the boundary.
        above: x and y, mm; None where the boundary has no place.
        side: distance from the column and height, mm; likewise.
        clearance: what is proved there, None where undefined.
        required: its deadband.
        unit: of both.
        violated: whether less is proved than required.
    """

    name: str
    above: tuple[float, float] | None
    side: tuple[float, float] | None
    clearance: float | None
    required: float
    unit: str
    violated: bool

    @property
    def value(self) -> str:
        """The clearance, never shown as more than is proved."""
        if self.clearance is None:
            return "undefined"
        return f"{math.floor(round(self.clearance * 100.0, 6)) / 100.0:.2f} {self.unit}"


@dataclass(frozen=True, slots=True)
class Scene:
    """All that a picture shows.

    Attributes:
        title: plan, registration and robot.
        verdict: in words.
        admissible: the same.
        arcs: names and points of the arcs that bound the workspace, shape (m, 2), mm.
        deadbands: lines at the deadband's distance inside of them, likewise.
        radii: of the inner and outer circle, mm; None without a workspace.
        heights: lower and upper end of the slide, mm.
        arm_mm: deadband of arm and slide.
        path: the wrist centre's way.
        names: boundaries that the colours take into account.
        values: smallest clearance of each on each line of the path, mm or deg, shape (names, n - 1); infinite where undefined.
        required: their deadbands, shape (names,).
        worst: of every boundary.
        proposed: where the path would lie after the verified move, and the move in words.
        notes: what the picture leaves out.
    """

    title: str
    verdict: str
    admissible: bool
    arcs: tuple[tuple[str, Floats], ...]
    deadbands: tuple[Floats, ...]
    radii: tuple[float, float] | None
    heights: tuple[float, float]
    arm_mm: float
    path: Drawn
    names: tuple[str, ...]
    values: Floats
    required: Floats
    worst: tuple[Worst, ...]
    proposed: tuple[Drawn, str] | None
    notes: tuple[str, ...]

    @property
    def ratios(self) -> Floats:
        """Smallest clearance of each line of the path in deadbands, shape (n - 1,); infinite where nothing is defined."""
        shape = self.values.shape[1]
        return (self.values / self.required[:, None]).min(axis=0) if self.names else np.full(shape, np.inf)

    @property
    def limiting(self) -> Ints:
        """Which of the names that is, shape (n - 1,)."""
        out: Ints = np.argmin(self.values / self.required[:, None], axis=0)
        return out


def scene(problem: Problem, verdict: Verdict, guidance: Guidance | None, title: str) -> Scene:
    """What is to be drawn of a verdict.

    Args:
        problem: what was verified.
        verdict: the answer.
        guidance: how to move the bone, where it is known.
        title: plan, registration and robot.
    """
    geometry, segments = canonical(problem)
    where, along = _samples(geometry, segments)
    points = at(geometry, segments, where, along)
    names, values, notes = _clearances(geometry, verdict, points)
    lines = np.minimum(values[:, :-1], values[:, 1:])
    path, lines = thinned(_drawn(geometry, points, where + along), lines)
    answer = "ADMISSIBLE" if verdict.admissible else "INADMISSIBLE"
    bounding = _bounding(geometry)
    radii = (bounding[0].radius, bounding[1].radius) if bounding else None
    if path.off_mm:
        notes.append(
            f"The path is drawn with {len(path.pose)} points; what is left out is off it by at most {math.ceil(path.off_mm * 1000.0) / 1000.0:g} mm."
        )
    if geometry.tilt.any():
        notes.append("The slide leans: x and y are where the column is at slide height 0.")
    return Scene(
        title=printable(title),
        verdict=printable(f"{answer}: {summary(verdict)}"),
        admissible=verdict.admissible,
        arcs=tuple(
            (_named(name, geometry), _shown(geometry, arc_points(arc)))
            for name, arc in zip(SIDES, bounding, strict=False)
        ),
        deadbands=tuple(_shown(geometry, line) for line in deadband_lines(geometry, bounding)),
        radii=radii,
        heights=(float(geometry.lower[2]), float(geometry.upper[2])),
        arm_mm=geometry.arm_mm,
        path=path,
        names=names,
        values=lines,
        required=np.array([verdict.boundaries[name].deadband for name in names]),
        worst=_worst(geometry, segments, verdict),
        proposed=_proposed(problem, guidance),
        notes=tuple(notes),
    )


def _named(name: str, geometry: Geometry) -> str:
    """A boundary of the canonical arm as that of the arm as given, and the other way round."""
    return MIRRORED.get(name, name) if geometry.side < 0.0 else name


def _shown(geometry: Geometry, points: Floats) -> Floats:
    """From the canonical arm to the arm as given."""
    out: Floats = points * (1.0, geometry.side)
    return out


def _bounding(geometry: Geometry) -> tuple[Arc, ...]:
    """The arcs that bound the workspace: after a whole turn of the shoulder the circles alone do."""
    return geometry.arcs[:2] if geometry.workspace.full_revolution else geometry.arcs


def arc_points(arc: Arc, inward_mm: float = 0.0) -> Floats:
    """Points of an arc, or of one so much smaller about the same centre, shape (m, 2)."""
    angles = arc.start + np.linspace(0.0, arc.span, ARC_POINTS)
    radius = arc.radius - inward_mm
    return np.stack((arc.x + radius * np.cos(angles), arc.y + radius * np.sin(angles)), axis=1)


def deadband_lines(geometry: Geometry, arcs: Sequence[Arc]) -> list[Floats]:
    """Where a wrist centre is just the deadband away from the workspace's boundary, as lines of points, shape (m, 2).

    Such points lie on arcs about the same centres as the boundary's: all its corners are convex, being those of the
    joints' rectangle. Of the points of these arcs the signed distance tells which are on the line.
    """
    keep = geometry.arm_mm
    lines: list[Floats] = []
    for arc, inward in ((arc, inward) for arc in arcs for inward in (keep, -keep) if arc.radius > inward):
        points = arc_points(arc, inward)
        on = np.abs(signed_distance(points, geometry.workspace) - keep) <= ON_LINE_MM
        changes = np.flatnonzero(np.diff(on.astype(np.int8))) + 1
        parts = zip(np.split(points, changes), np.split(on, changes), strict=True)
        lines += [part for part, kept in parts if kept[0] and len(part) > 1]
    return lines


def _samples(geometry: Geometry, segments: Segments) -> tuple[Ints, Floats]:
    """Segment and fraction of every pose, and of points between those that are far from each other."""
    wrist = segments.tip + geometry.tool_mm * segments.axis
    way = np.maximum(lengths(np.diff(wrist, axis=0)), geometry.tool_mm * segments.theta)
    pieces = np.maximum(1, np.ceil(way / max(PIECE_MM, float(way.sum()) / PIECES_MAX))).astype(np.int64)
    where = np.repeat(np.arange(len(segments)), pieces)
    begin = np.repeat(np.cumsum(pieces) - pieces, pieces)
    along = (np.arange(len(where)) - begin) / pieces[where]
    return np.append(where, len(segments) - 1), np.append(along, 1.0)


def _clearances(
    geometry: Geometry, verdict: Verdict, points: Points
) -> tuple[tuple[str, ...], Floats, list[str]]:
    """Of each boundary at each point, mm or deg, as the verifier evaluates points; and which are left out."""
    full = geometry.workspace.full_revolution
    sides = signed_sides(points.distances, points.inside, full_revolution=full)
    found = dict(zip(SIDES[: 2 if full else 4], sides.T, strict=False))
    found |= {"top": geometry.upper[2] - points.height, "bottom": points.height - geometry.lower[2]}
    angles = {
        "pitch_min": points.pitch - geometry.lower[4],
        "pitch_max": geometry.upper[4] - points.pitch,
        "wrist_singularity": np.minimum(points.pitch, math.pi - points.pitch),
    } | _rolls(geometry, verdict, points)
    found = {_named(name, geometry): value for name, value in found.items()}
    found |= {_named(name, geometry): np.degrees(value) for name, value in angles.items()}
    names = tuple(name for name in BOUNDARIES if name in found and name in verdict.boundaries)
    out = [name for name in verdict.boundaries if name not in names]
    notes = [f"Not in the colours: {', '.join(out)}; see the table."] if out else []
    values = np.array([found[name] for name in names]).reshape(len(names), len(points))
    return names, np.where(np.isnan(values), np.inf, values), notes


def _rolls(geometry: Geometry, verdict: Verdict, points: Points) -> dict[str, Floats]:
    """Clearance of the roll, rad, in the turn that the verdict has found; nothing where that is not the same."""
    least, most = (verdict.boundaries.get(_named(name, geometry)) for name in ("roll_min", "roll_max"))
    if least is None or most is None or least.clearance is None or most.clearance is None:
        return {}
    ends = math.radians(least.clearance), math.radians(most.clearance)
    if "wrist_singularity" not in verdict.boundaries:  # a vertical tool whose roll is held
        return {
            name: np.full(len(points), end) for name, end in zip(("roll_min", "roll_max"), ends, strict=True)
        }
    roll = np.unwrap(points.roll)
    low, high = roll - points.widening[:, 0], -(roll + points.widening[:, 1])
    low, high = low - low.min() + ends[0], high - high.min() + ends[1]
    span = geometry.upper[3] - geometry.lower[3] - points.widening.sum(axis=1)
    if not np.all(np.abs(low + high - span) <= SAME_ROLL_RAD):
        return {}
    return {"roll_min": low, "roll_max": high}


def _drawn(geometry: Geometry, points: Points, pose: Floats) -> Drawn:
    above = _shown(geometry, points.centre)
    side = np.stack((np.hypot(above[:, 0], above[:, 1]), points.height), axis=1)
    return Drawn(above, side, pose, 0.0)


def thinned(drawn: Drawn, lines: Floats, most: int = VERTICES_MAX) -> tuple[Drawn, Floats]:
    """The same with fewer points, at most so many, and how far the others are off.

    Every second point is left out where it is near the line between its neighbours, and again, with a tolerance that
    grows where too few are, until few enough are left.

    Args:
        drawn: n points.
        lines: a value for each line between them, shape (m, n - 1); of lines that become one the least is kept.
        most: so many points at most, 2 or more.
    """
    places = np.concatenate((drawn.above, drawn.side), axis=1)
    kept, tolerance = np.arange(len(places)), 0.001
    while len(kept) > most:
        middle = np.arange(1, len(kept) - 1, 2)
        begin, point, end = (places[kept[middle + step]] for step in (-1, 0, 1))
        away = _from_line(point, begin, end)
        near = np.flatnonzero(away <= tolerance)
        if len(near) * 20 < len(middle):
            tolerance *= 2.0
            continue
        leave = near[np.argsort(away[near], kind="stable")][: len(kept) - most]
        kept = np.delete(kept, middle[leave])
    # A line's distance from a line is largest at its ends, so that of the points bounds that of all between them.
    line = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
    off = _from_line(places[:-1], places[kept[line]], places[kept[line + 1]])
    off_mm = float(off.max()) if len(kept) < len(places) else 0.0
    least = np.minimum.reduceat(lines, kept[:-1], axis=1) if len(lines) else lines[:, : len(kept) - 1]
    return Drawn(drawn.above[kept], drawn.side[kept], drawn.pose[kept], off_mm), least


def _from_line(points: Floats, begin: Floats, end: Floats) -> Floats:
    """Distance of each point from its straight line between two others, shape (m,)."""
    chord = end - begin
    square = np.maximum(np.einsum("ij,ij->i", chord, chord), SMALLEST)
    foot = np.clip(np.einsum("ij,ij->i", points - begin, chord) / square, 0.0, 1.0)
    out: Floats = np.linalg.norm(points - begin - foot[:, None] * chord, axis=1)
    return out


def _worst(geometry: Geometry, segments: Segments, verdict: Verdict) -> tuple[Worst, ...]:
    out = []
    for b in verdict.boundaries.values():
        above = side = None
        if b.segment is not None and b.fraction is not None:
            place = at(geometry, segments, np.array([b.segment]), np.array([b.fraction]))
            one = _drawn(geometry, place, np.zeros(1))
            above, side = ((float(v[0, 0]), float(v[0, 1])) for v in (one.above, one.side))
        out.append(Worst(b.name, above, side, b.certified, b.deadband, b.unit, b.violated))
    return tuple(out)


def _proposed(problem: Problem, guidance: Guidance | None) -> tuple[Drawn, str] | None:
    """Where the path lies after the move that was verified."""
    if guidance is None or guidance.translation_mm is None or not guidance.verified:
        return None
    geometry, segments = canonical(
        moved(problem, guidance.yaw_deg, guidance.pivot_mm, guidance.translation_mm)
    )
    where, along = _samples(geometry, segments)
    points = at(geometry, segments, where, along)
    drawn = thinned(_drawn(geometry, points, where + along), np.zeros((0, len(where) - 1)))[0]
    x, y, z = (f"{value:+g}" if value else "0" for value in guidance.translation_mm)
    turn = f"turn {guidance.yaw_deg:+g} deg about the vertical, then " if guidance.yaw_deg else ""
    return drawn, f"{turn}x {x}  y {y}  z {z} mm (verified; a moved bone needs a new registration)"


@dataclass(frozen=True, slots=True)
class Window:
    """A square part of a view, mm: from ``x``, ``y`` over ``span`` both ways."""

    x: float
    y: float
    span: float

    def ticks(self) -> tuple[list[float], list[float]]:
        """Round numbers along both edges, about five each."""
        rough = self.span / 5.0
        unit = 10.0 ** math.floor(math.log10(rough))
        step = next(unit * k for k in (1.0, 2.0, 5.0, 10.0) if unit * k >= rough)
        return tuple(  # type: ignore[return-value]
            [k * step for k in range(math.ceil(low / step), math.floor((low + self.span) / step) + 1)]
            for low in (self.x, self.y)
        )


def window_of(parts: Sequence[Floats], margin: float, least_mm: float) -> Window:
    """The square about all points of these, shape (m, 2) each, with a margin in parts of its size."""
    points = np.concatenate(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    span = max(float((high - low).max()), least_mm) * (1.0 + 2.0 * margin)
    x, y = ((low + high) / 2.0 - span / 2.0).tolist()
    return Window(x, y, span)


def windows(shown: Scene) -> dict[tuple[str, str], Window]:
    """Of each view, ``above`` and ``side``: ``near`` the path, and the ``whole`` workspace."""
    drawn = [shown.path, *([shown.proposed[0]] if shown.proposed else [])]
    out = {}
    for view in ("above", "side"):
        paths = [getattr(one, view) for one in drawn]
        whole = list(paths)
        if view == "above":
            whole += [points for _, points in shown.arcs] + [np.zeros((1, 2))]
        elif shown.radii is not None:
            whole.append(np.stack((shown.radii, np.clip(shown.heights, -1e4, 1e4)), axis=1))
        out[view, "near"] = window_of(paths, 0.12, 4.0 * shown.arm_mm)
        out[view, "whole"] = window_of(whole, 0.06, 4.0 * shown.arm_mm)
    return out


def labels(shown: Scene, view: str, window: Window) -> list[tuple[float, float, str, bool]]:
    """Worst places within a window: x, y, the letters of those that lie together, and whether one is violated.

    The letters of a boundary that is violated are followed by ``!``.
    """
    groups: list[tuple[float, float, list[str], bool]] = []
    for one in sorted(shown.worst, key=lambda worst: not worst.violated):
        place = getattr(one, view)
        if place is None:
            continue
        x, y = place
        if not (window.x <= x <= window.x + window.span and window.y <= y <= window.y + window.span):
            continue
        near = next(
            (k for k, g in enumerate(groups) if math.hypot(g[0] - x, g[1] - y) < window.span * 0.06), None
        )
        letters = LETTERS[one.name] + ("!" if one.violated else "")
        if near is None:
            groups.append((x, y, [letters], one.violated))
        else:
            groups[near][2].append(letters)
    return [(x, y, " ".join(letters), violated) for x, y, letters, violated in groups]
