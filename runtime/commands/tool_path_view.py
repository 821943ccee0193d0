"""What a tool path's file says beside its poses, for people and as JSON; and one answer for all tools of a file."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from cutgate.runtime.kinematics.pose import lengths
from cutgate.runtime.plan.toolpath.model import Cut, Flags
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.quantities import wrist_lengths

ADMISSIBLE: Final = "admissible"


@dataclass(frozen=True, slots=True)
class Travelled:
    """Of the moves that cut, or of those that position: how many straight segments, and their lengths."""

    segments: int
    tip_length_mm: float
    wrist_length_mm: float


def travelled(problem: Problem, cut: Cut) -> tuple[Travelled, Travelled]:
    """What is cut, and what is only positioned, of a tool's path."""
    geometry, segments = canonical(problem)
    tips = lengths(problem.tips_mm[1:] - problem.tips_mm[:-1])
    wrists = wrist_lengths(segments, geometry.tool_mm)

    def those(chosen: Flags) -> Travelled:
        return Travelled(int(chosen.sum()), float(tips[chosen].sum()), float(wrists[chosen].sum()))

    positioning = cut.positioning[1:]
    return those(~positioning), those(positioning)


def facts(problem: Problem, cut: Cut, feed_mm_s: float) -> dict[str, str]:
    """Label and value."""
    cutting, positioning = travelled(problem, cut)
    told = {"tool path": f"{_name(cut)}, {_where(cut)}"}
    told["cutting"] = f"{cutting.segments} segments, tip {cutting.tip_length_mm:.1f} mm"
    if positioning.segments:
        told["positioning"] = (
            f"{positioning.segments} segments, tip {positioning.tip_length_mm:.1f} mm: verified as well, and run at the "
            "same feed"
        )
    feeds = cut.feed_range_mm_s
    if feeds and feeds[0] != feeds[1]:
        least, most = feeds
        told["feed"] = f"{feed_mm_s:.4g} mm/s for all of it; the file has {least:.4g} to {most:.4g} mm/s"
    if cut.tolerance_mm or cut.tolerance_deg:
        told["straightened"] = (
            f"arcs within {cut.tolerance_mm:.3g} mm, turns within {cut.tolerance_deg:.3g} deg: widens the deadbands"
        )
    return told


def _name(cut: Cut) -> str:
    return f"tool {cut.tool}" if cut.tool else "one tool"


def _where(cut: Cut) -> str:
    return f"lines {cut.lines.min()} to {cut.lines.max()}"


def title(cut: Cut | None, number: int, count: int) -> str:
    """What stands above one tool's verdict."""
    told = f": {_name(cut)}, {_where(cut)}" if cut else ""
    return f"Part {number} of {count}{told}"


def line_of(cut: Cut, segment: int | None, fraction: float | None) -> int | None:
    """The line of the file that a place on a segment stems from: of its first pose, or of the move behind that."""
    return None if segment is None else int(cut.lines[segment + bool(fraction)])


def with_tool_path(document: dict[str, Any], problem: Problem, cut: Cut | None) -> dict[str, Any]:
    """A verdict's document with what the tool path's file says; ``path`` has the lengths of what is cut alone."""
    if cut is None:
        return document
    cutting, positioning = travelled(problem, cut)
    path = {
        **document["path"],
        "tip_length_mm": cutting.tip_length_mm,
        "wrist_length_mm": cutting.wrist_length_mm,
    }
    boundaries = {
        name: {**entry, "line": line_of(cut, entry["segment"], entry["fraction"])}
        for name, entry in document["boundaries"].items()
    }
    told = {
        "tool": cut.tool,
        "lines": [int(cut.lines.min()), int(cut.lines.max())],
        "cutting": asdict(cutting),
        "positioning": asdict(positioning),
        "feeds_mm_s": cut.feed_range_mm_s and list(cut.feed_range_mm_s),
        "tolerance_mm": cut.tolerance_mm,
        "tolerance_deg": cut.tolerance_deg,
    }
    return {**document, "path": path, "boundaries": boundaries, "tool_path": told}


def whole(documents: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One document: of several tools their sums and worst values, and each tool's own document under ``tools``."""
    if len(documents) == 1:
        return documents[0]
    first = documents[0]
    admissible = all(document["verdict"] == ADMISSIBLE for document in documents)
    return {
        "schema": first["schema"],
        "verdict": ADMISSIBLE if admissible else f"in{ADMISSIBLE}",
        "method": first["method"],
        "path": _sums([document["path"] for document in documents]),
        "deadband": _each(max, [document["deadband"] for document in documents]),
        "branch": None,
        "evaluations": _sums([document["evaluations"] for document in documents]),
        "boundaries": _worst(documents),
        "speed": _fastest([document["speed"] for document in documents]),
        "digests": {**first["digests"], "path": None},
        "guidance": None,
        "guidance_note": "each tool's own stands under tools",
        "elapsed_ms": sum(document["elapsed_ms"] for document in documents),
        "tools": list(documents),
    }


def _sums(entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return _each(sum, entries)


def _each(combine: Callable[[list[Any]], Any], entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Each key's values combined; None where one of them is."""
    columns = {name: [entry[name] for entry in entries] for name in entries[0]}
    return {name: None if None in values else combine(values) for name, values in columns.items()}


def _fastest(lines: Sequence[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each joint the line with the highest peak, an undefined one before any, and the number of its part from 0."""
    numbered = [[{**line, "part": part} for line in found] for part, found in enumerate(lines)]
    return [max(joint, key=_peak) for joint in zip(*numbered, strict=False)]


def _peak(line: dict[str, Any]) -> float:
    return float("inf") if line["peak"] is None else float(line["peak"])


def _worst(documents: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of each boundary the entry with the least that is proved, and the number of its part from 0."""
    worst: dict[str, Any] = {}
    for number, document in enumerate(documents):
        for name, entry in document["boundaries"].items():
            here = {**entry, "part": number}
            worst[name] = min(worst.get(name, here), here, key=_certified)
    return worst


def _certified(entry: dict[str, Any]) -> float:
    return float("-inf") if entry["certified"] is None else float(entry["certified"])
