"""The picture of a verdict as one self-contained page: drawn here as SVG, which a small script reads out.

Without scripts it shows the same. Its policy names script and style by their hashes and allows nothing else.
"""

import html
import json
import math
from importlib.resources import files
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.commands.page_policy import page_policy
from cutgate.runtime.commands.reach_page import CIVIDIS
from cutgate.runtime.commands.verify_scene import LETTERS, MEANINGS, Drawn, Scene, Window, labels, windows

STEPS: Final = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Of the colour scale, in deadbands; what keeps more than the last one reaches has its last colour."""
UNITS_PER_MM: Final = 100
SIZE: Final = 1000.0
"""Both sides of a view in its own units."""
TEXT: Final = {"near": 26.0, "whole": 40.0}
"""Height of letters, in these units: about 12 px on a page 800 px wide."""
NONE: Final = -2
BAD: Final = -1
SCALE_STYLE: Final = "".join(f".c{k}{{stroke:{colour}}}" for k, colour in enumerate(CIVIDIS))
"""The classes of the lines' colours."""
TITLES: Final = {
    ("above", "near"): "From above, near the path (mm)",
    ("above", "whole"): "From above, the whole workspace",
    ("side", "near"): "From the side, near the path: distance from the column, and height (mm)",
    ("side", "whole"): "From the side, the whole workspace",
}


def steps(shown: Scene) -> list[float]:
    """The ratios at which colours begin, and at which the last one ends.

    From 1 in round steps, the shortest that reach far enough, or the longest.
    """
    ratios = shown.ratios[np.isfinite(shown.ratios)]
    best, count = float(ratios.max(initial=1.0)), len(CIVIDIS)
    step = next((one for one in STEPS if 1.0 + count * one >= best), STEPS[-1])
    return [1.0 + k * step for k in range(count + 1)]


def shades(shown: Scene) -> Ints:
    """Number of each line's colour; `BAD` where less than the deadband is kept, `NONE` where nothing is defined."""
    ratios = shown.ratios
    numbers = np.searchsorted(steps(shown), ratios, side="right") - 1
    numbers = np.minimum(numbers, len(CIVIDIS) - 1)
    numbers[~(ratios >= 1.0)] = BAD
    numbers[~np.isfinite(ratios)] = NONE
    return numbers


def page(shown: Scene) -> str:
    """The page as HTML."""
    folder = files("cutgate.runtime.commands")
    script = (folder / "verify_page.js").read_text(encoding="utf-8")
    style = (folder / "verify_page.css").read_text(encoding="utf-8") + SCALE_STYLE
    policy = page_policy(script, style)
    title = html.escape(shown.title)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{style}</style></head><body>\n"
        f'<h1>{title}</h1>\n<p id="verdict">{html.escape(shown.verdict)}</p>\n{_move(shown)}'
        f'<div class="views">{pictures(shown)}</div>\n'
        '<section id="tools" hidden><label for="along">Along the path</label>'
        '<input type="range" id="along" min="0" value="0"><p id="reading" aria-live="polite">'
        "Point at the path, or move the slider.</p></section>\n"
        f"{legend(shown)}{_table(shown)}{_notes(shown)}"
        f'<script type="application/json" id="data">{_data(shown)}</script>\n'
        f"<script>{script}</script></body></html>\n"
    )


def _move(shown: Scene) -> str:
    return f"<p>Proposed move: {html.escape(shown.proposed[1])}</p>\n" if shown.proposed else ""


def pictures(shown: Scene, prefix: str = "") -> str:
    """All four views; the path of a view is drawn once and used twice.

    Args:
        shown: what they show.
        prefix: of the names of parts that are used twice, each scene's own in a page of several.
    """
    parts = windows(shown)
    out = ""
    for view in ("above", "side"):
        for size in ("near", "whole"):
            window = parts[view, size]
            title = TITLES[view, size]
            inner = _grid(window, TEXT[size]) + _bounds(shown, view, window)
            if size == "near":
                inner += f'<g id="{prefix}{view}" transform="{_onto(window)}">{_paths(shown, view)}</g>'
                inner += _marks(shown, view, window)
            else:
                inner += f'<use href="#{prefix}{view}" transform="{_across(parts[view, "near"], window)}"/>'
                inner += _frame(parts[view, "near"], window) + _column(shown, view, window)
            out += (
                f"<figure><figcaption>{title}</figcaption>"
                f'<svg class="view {size}" viewBox="0 0 1000 1000" role="img" aria-label="{title}" data-view="{view}" '
                f'data-window="{window.x:.6g} {window.y:.6g} {window.span:.6g}">{inner}'
                '<circle class="here" r="16"/></svg></figure>\n'
            )
    return out


def _onto(window: Window) -> str:
    """The transform from hundredths of a mm to a view's units."""
    k = SIZE / window.span
    f = k / UNITS_PER_MM
    return f"matrix({f:.8g} 0 0 {-f:.8g} {-k * window.x:.8g} {k * (window.y + window.span):.8g})"


def _across(near: Window, whole: Window) -> str:
    """The transform from the units of one window to those of another, of what has its own transform already."""
    k = near.span / whole.span
    x, y = _place(near.x, near.y + near.span, whole)
    return f"matrix({k:.8g} 0 0 {k:.8g} {x:.8g} {y:.8g})"


def _place(x: float, y: float, window: Window) -> tuple[float, float]:
    return (x - window.x) / window.span * SIZE, SIZE - (y - window.y) / window.span * SIZE


def _line(points: Floats) -> str:
    """A polyline's data, in whole hundredths of a mm, each point as the step from the one before."""
    whole = np.rint(points * UNITS_PER_MM).astype(np.int64)
    steps_of = np.diff(whole, axis=0).tolist()
    x, y = whole[0].tolist()
    return f"M{x} {y}l" + " ".join(f"{dx}{dy}" if dy < 0 else f"{dx} {dy}" for dx, dy in steps_of)


def _paths(shown: Scene, view: str) -> str:
    """The path after the move, a halo under the path, and the path in its colours; those that violate last."""
    points: Floats = getattr(shown.path, view)
    out = ""
    if shown.proposed:
        moved: Drawn = shown.proposed[0]
        out += f'<path class="move" d="{_line(getattr(moved, view))}"/>'
    out += f'<path class="path halo" d="{_line(points)}"/>'
    numbers = shades(shown)
    cuts = np.flatnonzero(np.diff(numbers)) + 1
    data: dict[int, list[str]] = {}
    for begin, end in zip([0, *cuts.tolist()], [*cuts.tolist(), len(numbers)], strict=True):
        data.setdefault(int(numbers[begin]), []).append(_line(points[begin : end + 1]))
    lines = "".join(
        f'<path class="path line {_class(k)}" d="{"".join(data[k])}"/>'
        for k in sorted(data, key=lambda k: -k)
    )
    return out + lines


def _class(number: int) -> str:
    return {NONE: "none", BAD: "bad wrong"}.get(number, f"c{number}")


def _bounds(shown: Scene, view: str, window: Window) -> str:
    """What bounds the workspace, and the deadband inside of it."""
    if view == "above":
        edges = [points for _, points in shown.arcs]
        keeps = list(shown.deadbands)
    else:
        edges, keeps = side_bounds(shown)
    out = "".join(f'<path class="keep" d="{_line(points)}"/>' for points in keeps)
    out += "".join(f'<path class="edge" d="{_line(points)}"/>' for points in edges)
    return f'<g transform="{_onto(window)}">{out}</g>'


def side_bounds(shown: Scene) -> tuple[list[Floats], list[Floats]]:
    """Boundary and deadband lines of the view from the side: inner, outer, top and bottom, shape (2, 2) each, mm."""
    if shown.radii is None:
        return [], []
    out = []
    for inward in (0.0, shown.arm_mm):
        (near, far), (low, high) = shown.radii, shown.heights
        near, far, low, high = near + inward, far - inward, low + inward, high - inward
        corners = ((near, low), (far, low), (far, high), (near, high), (near, low))
        out.append([np.array(corners[k : k + 2]) for k in range(4)] if near < far and low < high else [])
    return out[0], out[1]


def _grid(window: Window, size: float) -> str:
    out = ""
    x_ticks, y_ticks = window.ticks()
    for value in x_ticks:
        x = _place(value, 0.0, window)[0]
        out += f'<path class="grid" d="M{x:.1f} 0V1000"/>'
        if size < x < SIZE - size:
            out += f'<text class="tick" x="{x:.1f}" y="985" font-size="{size:g}" text-anchor="middle">{value:g}</text>'
    for value in y_ticks:
        y = _place(0.0, value, window)[1]
        out += f'<path class="grid" d="M0 {y:.1f}H1000"/>'
        if size < y < SIZE - 2 * size:
            out += f'<text class="tick" x="8" y="{y + size / 3:.1f}" font-size="{size:g}">{value:g}</text>'
    return out


def _marks(shown: Scene, view: str, window: Window) -> str:
    """Worst places with their letters."""
    out, size = "", TEXT["near"] * 1.15
    for x, y, letters, violated in labels(shown, view, window):
        px, py = _place(x, y, window)
        left = px > SIZE * 0.8
        shape = (
            f'<path class="mark bad" d="M{px - 14:.1f} {py - 14:.1f}l28 28m0 -28l-28 28"/>'
            if violated
            else f'<circle class="mark" cx="{px:.1f}" cy="{py:.1f}" r="10"/>'
        )
        out += (
            f'{shape}<text class="letter" x="{px + (-20 if left else 20):.1f}" y="{py - 14:.1f}" '
            f'font-size="{size:g}" text-anchor="{"end" if left else "start"}">{letters}</text>'
        )
    return out


def _frame(near: Window, whole: Window) -> str:
    """Where the enlarged part is."""
    x, y = _place(near.x, near.y + near.span, whole)
    side = near.span / whole.span * SIZE
    return f'<rect class="frame" x="{x:.1f}" y="{y:.1f}" width="{side:.1f}" height="{side:.1f}"/>'


def _column(shown: Scene, view: str, window: Window) -> str:
    """The axis of q0, and the names of the sides."""
    out, size = "", TEXT["whole"]
    if view == "above":
        x, y = _place(0.0, 0.0, window)
        out = f'<circle class="column" cx="{x:.1f}" cy="{y:.1f}" r="14"/>'
        names = [(name, points[len(points) // 2]) for name, points in shown.arcs]
    else:
        edges = side_bounds(shown)[0]
        names = [
            (name, points.mean(axis=0))
            for name, points in zip(("bottom", "outer", "top", "inner"), edges, strict=False)
        ]
    for name, (x_mm, y_mm) in names:
        x, y = _place(float(x_mm), float(y_mm), window)
        x, y = min(max(x, 90.0), 910.0), min(max(y, 50.0), 950.0)
        out += f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="middle">{name}</text>'
    return out


def legend(shown: Scene) -> str:
    """What its colours and lines mean."""
    edges = steps(shown)
    open_end = bool((shown.ratios[np.isfinite(shown.ratios)] > edges[-1]).any())
    scale = "".join(
        f'<li><svg viewBox="0 0 10 2" preserveAspectRatio="none" aria-hidden="true"><path class="c{k}" stroke-width="9" d="M0 1H10"/></svg>'
        f"{low:g}{'+' if k == len(CIVIDIS) - 1 and open_end else ''}</li>"
        for k, low in enumerate(edges[:-1])
    )
    units = {unit: f"{required:g} {unit}" for required, unit in ((w.required, w.unit) for w in shown.worst)}
    keys = [
        ('<path class="path bad wrong" d="M0 5H22"/>', "less than the deadband is kept"),
        ('<path class="edge" d="M0 5H22"/>', "limit of the wrist centre"),
        ('<path class="keep" d="M0 5H22"/>', "deadband inside of it"),
        ('<path class="mark bad" d="M6 0l10 10m0 -10l-10 10"/>', "worst place, violated (letters with !)"),
        ('<circle class="mark" cx="11" cy="5" r="4"/>', "worst place, kept"),
    ]
    if shown.proposed:
        keys.insert(1, ('<path class="move" d="M0 5H22"/>', "the path after the proposed move"))
    if (shades(shown) == NONE).any():
        keys.append(('<path class="path line none" d="M0 5H22"/>', "no clearance is defined"))
    key = "".join(
        f'<li><svg viewBox="0 0 22 10" aria-hidden="true">{drawn}</svg>{words}</li>' for drawn, words in keys
    )
    return (
        "<section><h2>Path of the wrist centre: smallest clearance there, in deadbands (1: just kept)</h2>"
        f'<ul class="scale">{scale}</ul><p class="small">Each number is where its colour begins; the last colour '
        f"{'holds all above' if open_end else f'ends at {edges[-1]:g}'}. One deadband is {html.escape(' or '.join(units.values()))}.</p>"
        f'<ul class="key">{key}</ul></section>\n'
    )


def _table(shown: Scene) -> str:
    rows = "".join(
        f"<tr{' class=violated' if one.violated else ''}><td>{html.escape(LETTERS[one.name])}</td><td>{one.name}</td>"
        f'<td>{MEANINGS[one.name]}</td><td class="number">{one.value}</td>'
        f'<td class="number">{one.required:g} {one.unit}</td><td>{"violated" if one.violated else "kept"}</td></tr>'
        for one in shown.worst
    )
    return (
        '<section class="wide"><h2>Worst place of each boundary</h2><table><thead><tr><th scope="col">mark</th>'
        '<th scope="col">boundary</th><th scope="col">what lies beyond</th><th scope="col" class="number">clearance, proved</th>'
        '<th scope="col" class="number">required</th><th scope="col"></th></tr></thead>'
        f"<tbody>{rows}</tbody></table></section>\n"
    )


def _notes(shown: Scene) -> str:
    notes = (
        "Colours are of points of the path; that the whole path keeps its distance is what the table's clearances prove.",
        "From the side the limits left and right are not seen: they are seen from above.",
        *shown.notes,
    )
    return "".join(f'<p class="small">{html.escape(text)}</p>\n' for text in notes)


def _data(shown: Scene) -> str:
    """What the script reads out, as JSON in which nothing is markup."""
    limiting = shown.limiting if shown.names else np.zeros(len(shown.path.pose) - 1, dtype=np.int64)
    least = shown.values[limiting, np.arange(len(limiting))] if shown.names else shown.ratios
    units = {one.name: one for one in shown.worst}
    # Rounded down: a clearance is never shown as more than it is.
    down = np.floor(np.round(least * 100.0, 6)) / 100.0
    value = [float(v) if math.isfinite(v) else None for v in down]
    data = {
        "x": np.round(shown.path.above[:, 0], 1).tolist(),
        "y": np.round(shown.path.above[:, 1], 1).tolist(),
        "z": np.round(shown.path.side[:, 1], 1).tolist(),
        "pose": np.round(shown.path.pose, 2).tolist(),
        "limiting": limiting.tolist(),
        "value": value,
        "names": [
            {"name": name, "unit": units[name].unit, "required": f"{units[name].required:g}"}
            for name in shown.names
        ],
    }
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c")
