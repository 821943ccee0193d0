"""The map of bone positions as one self-contained page: it holds its own drawing program and loads nothing."""

import html
import json
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from cutgate.runtime.commands.reach_picture import (
    KINDS,
    RATIO_MAX,
    Arcs,
    Layer,
    kind_of,
    layers,
    letters,
    ratio_top,
)
from cutgate.runtime.verification.reach import RATES, Position

HOVER: Final = (
    "reference point x %{x:.0f}  y %{y:.0f} mm<br>move x %{customdata[0]}  y %{customdata[1]} mm, "
    "%{customdata[2]}<br>%{customdata[3]}<extra></extra>"
)
POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


def page(document: dict[str, Any], positions: Sequence[Position], arcs: Arcs) -> str:
    """The map as HTML.

    Args:
        document: ``cutgate.reach/1``.
        positions: all of them.
        arcs: the workspace of the wrist centre.
    """
    from plotly.offline import (  # type: ignore[import-untyped]  # noqa: PLC0415 - five megabytes, here only
        get_plotlyjs,
    )

    drawn = layers(document, positions)
    first = max(range(len(drawn)), key=lambda k: _interest(drawn[k]))
    title = f"Where the bone could stand: {document['plan']} on {document['robot']}"
    data = _static(document, arcs, drawn)
    fixed = len(data)
    for k, layer in enumerate(drawn):
        data += _heatmaps(document, layer, ratio_top(drawn), visible=k == first)
    figure = json.dumps(
        [data, _layout(document, drawn, fixed, first)], allow_nan=False, separators=(",", ":")
    ).replace("</", "<\\/")
    config = json.dumps(
        {"responsive": True, "displaylogo": False, "plotlyServerURL": "", "showSendToCloud": False}
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{html.escape(title)}</title>"
        "<style>body{font-family:sans-serif;margin:1em}#map{width:100%;height:82vh}p{max-width:75em}</style></head><body>"
        f"<h1>{html.escape(title)}</h1>{_words(document)}"
        f'<div id="map"></div><script>{get_plotlyjs()}</script>\n'
        f"<script>const [data, layout] = {figure};\nPlotly.newPlot('map', data, layout, {config});</script></body></html>\n"
    )


def _interest(layer: Layer) -> tuple[bool, float, int]:
    """What to show first: where the bone could stand, with the least turn and lift."""
    good = sum(p.admissible for p in layer.positions)
    return good > 0, -abs(layer.yaw_deg) - abs(layer.lift_mm), good


def _words(document: dict[str, Any]) -> str:
    counts, registration = document["counts"], document["registration"]
    placed = f"registration {registration}" if registration else "no registration (identity)"
    return (
        f"<p>{html.escape(placed)}. {counts['admissible']} of {counts['positions']} positions are admissible, each by "
        f"the certified method. Each cell is a new registration: turn the bone by the yaw about the vertical through "
        f"the cross, then move it. A moved bone needs a new registration, which is verified anew.</p>"
    )


def _static(document: dict[str, Any], arcs: Arcs, drawn: Sequence[Layer]) -> list[dict[str, Any]]:
    """What does not change with yaw and lift: outline, column, the bone's present place, and the legend's tints."""
    px, py, _ = document["pivot_mm"]
    line = {"type": "scatter", "mode": "lines", "line": {"color": "black", "width": 1.5}, "hoverinfo": "skip"}
    sign = {"type": "scatter", "mode": "markers", "hoverinfo": "name"}
    traces: list[dict[str, Any]] = [
        {
            **line,
            "x": np.round(points[:, 0], 2).tolist(),
            "y": np.round(points[:, 1], 2).tolist(),
            "name": "workspace of the wrist centre",
            "legendgroup": "workspace",
            "showlegend": k == 0,
        }
        for k, (_, points) in enumerate(arcs)
    ]
    for name, x, y, symbol in (
        ("column (axis of q0)", 0.0, 0.0, "circle"),
        ("where the bone stands now", px, py, "x"),
    ):
        marker = {"symbol": symbol, "size": 13, "color": "white", "line": {"color": "black", "width": 2}}
        traces.append({**sign, "name": name, "x": [x], "y": [y], "marker": marker})
    found = {kind_of(p.limiting) for layer in drawn for p in layer.positions if not p.admissible}
    for name, kind in KINDS.items():
        if name in found:
            marker = {
                "symbol": "square",
                "size": 12,
                "color": kind.tint,
                "line": {"color": "gray", "width": 1},
            }
            traces.append({**sign, "name": kind.words, "x": [None], "y": [None], "marker": marker})
    return traces


def _heatmaps(document: dict[str, Any], layer: Layer, top: float, *, visible: bool) -> list[dict[str, Any]]:
    """Inadmissible cells by what limits, admissible ones by their clearance."""
    grid, (px, py, _) = document["grid"], document["pivot_mm"]
    said = [[p.x_mm, p.y_mm, layer.title, _said(p)] for p in layer.positions]
    rows, columns = layer.shape
    custom = [said[i * columns : (i + 1) * columns] for i in range(rows)]
    text = [[""] * columns for _ in range(rows)]
    for i, j, letter in letters(layer):
        text[i][j] = letter
    common = {
        "type": "heatmap",
        "x": [round(x + px, 3) for x in grid["x_mm"]],
        "y": [round(y + py, 3) for y in grid["y_mm"]],
        "customdata": custom,
        "hovertemplate": HOVER,
        "hoverongaps": False,
        "visible": visible,
    }
    last = len(KINDS) - 1
    tints = [
        [edge, kind.tint]
        for k, kind in enumerate(KINDS.values())
        for edge in (k / (last + 1), (k + 1) / (last + 1))
    ]
    label = (
        f"smallest clearance, in deadbands (1 = just kept{'; more at the end' if top == RATIO_MAX else ''})"
    )
    return [
        {
            **common, "z": _plain(layer.kind), "zmin": -0.5, "zmax": last + 0.5, "colorscale": tints,
            "showscale": False, "text": text, "texttemplate": "%{text}", "textfont": {"color": "#404040", "size": 10},
        },
        {
            **common, "z": _plain(layer.ratio), "zmin": 1.0, "zmax": top, "colorscale": "Cividis",
            "colorbar": {"title": {"text": label, "side": "right"}, "len": 0.8},
        },
    ]  # fmt: skip


def _plain(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[list[float | None]]:
    """Rows of numbers, None where there is none."""
    return [[round(v, 3) if math.isfinite(v) else None for v in row] for row in values.tolist()]


def _said(p: Position) -> str:
    """What decides at a position, in words."""
    verdict = "admissible" if p.admissible else "inadmissible"
    how = "certified" if p.checked == "certified" else "a pose excludes it"
    value = "undefined" if p.clearance is None else f"{p.clearance:.2f} {p.unit}"
    word = "allowed" if p.limiting.startswith(RATES) else "required"
    return f"<b>{verdict}</b> ({how})<br>limit: {p.limiting}, {value}, {p.bound:g} {p.unit} {word}"


def _layout(document: dict[str, Any], drawn: Sequence[Layer], fixed: int, first: int) -> dict[str, Any]:
    """Axes, legend, and a slider over turns and lifts."""
    steps = [
        {
            "label": layer.title,
            "method": "update",
            "args": [{"visible": [True] * fixed + [k == j for j in range(len(drawn)) for _ in range(2)]}],
        }
        for k, layer in enumerate(drawn)
    ]
    step = document["grid"]["step_mm"]
    return {
        "xaxis": {
            "constrain": "domain",
            "title": {
                "text": f"x of the bone's reference point (mean cutter tip), mm; one cell is {step:g} mm"
            },
        },
        "yaxis": {"title": {"text": "y, mm (robot frame)"}, "scaleanchor": "x", "constrain": "domain"},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.02},
        "margin": {"t": 60, "r": 20},
        "plot_bgcolor": "white",
        "modebar": {"orientation": "v"},
        "sliders": [{"active": first, "steps": steps, "pad": {"t": 50}}],
    }
