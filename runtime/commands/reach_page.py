"""The map of bone positions as one self-contained page: it draws with a small script of its own and loads nothing.

Data, script and style stand in the page; its policy names the two by their hashes and allows nothing else.
"""

import base64
import html
import json
import math
import zlib
from collections.abc import Sequence
from importlib.resources import files
from typing import Any, Final

import numpy as np

from cutgate.config.screen import printable
from cutgate.protocol.arrays import Ints
from cutgate.runtime.commands.page_policy import page_policy
from cutgate.runtime.commands.reach_picture import (
    KINDS,
    RATIO_MAX,
    Arcs,
    Layer,
    between,
    height,
    kind_of,
    layers,
    ratio_top,
    signed,
)
from cutgate.runtime.verification.placing.cells import State
from cutgate.runtime.verification.placing.reach import CELLS, RATES, Position, Surveyed

CIVIDIS: Final = (
    "#00224e", "#083370", "#35456c", "#4f576c", "#666970", "#7d7c78",
    "#948e77", "#aea371", "#c8b866", "#e5cf52", "#fee838",
)  # fmt: skip
"""Evenly spaced on the scale of the picture, whose lightness grows for every reader, colour-blind ones too."""
NIGHT: Final = (21, 24, 28)
"""What the tints of inadmissible cells are mixed with on a dark screen, where pale ones would glare."""
NIGHT_PART: Final = 0.68
LISTED_MAX: Final = 60
"""Turns and lifts in the table below the map; the map has them all."""

_SIGNS: Final = (
    ("M-7-4-4-7 0-3 4-7 7-4 3 0 7 4 4 7 0 3-4 7-7 4-3 0Z", "where the bone stands now"),
    ("M0-6A6 6 0 1 0 0 6A6 6 0 1 0 0-6Z", "column (axis of q0)"),
)
_MOVE: Final = ("M0-9 7 0 0 9-7 0Z", "the move that guidance chooses")


def page(document: dict[str, Any], found: Surveyed, arcs: Arcs) -> str:
    """The map as HTML.

    Args:
        document: ``cutgate.reach/1``.
        found: all of it.
        arcs: the workspace of the wrist centre.
    """
    drawn = layers(document, found)
    first = max(range(len(drawn)), key=lambda k: _interest(drawn[k], document["guidance"]))
    folder = files("cutgate.runtime.commands")
    script = (folder / "reach_page.js").read_text(encoding="utf-8")
    style = (folder / "reach_page.css").read_text(encoding="utf-8") + _tints()
    policy = page_policy(script, style)
    title = html.escape(printable(f"Where the bone could stand: {document['plan']} on {document['robot']}"))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}, lift {signed(drawn[first].lift_mm)} mm</title><style>{style}</style></head><body>\n"
        f'<h1>{title}, at <span id="lift">lift {signed(drawn[first].lift_mm)} mm</span></h1>\n'
        '<p id="fault" role="alert"></p><noscript><p>The map needs scripts; the table below does not.</p></noscript>\n'
        f"{_body(document, drawn, drawn[first])}{_words(document)}{_table(drawn)}"
        f'<script type="text/plain" id="data">{_data(document, drawn, first, arcs)}</script>\n'
        f"<script>{script}</script></body></html>\n"
    )


def _tints() -> str:
    """The tints of what limits, as colours of the style: by day and by night, and a swatch of each."""
    day, night, swatches = "", "", ""
    for k, kind in enumerate(KINDS.values()):
        mixed = (
            round(int(kind.tint[1 + 2 * c : 3 + 2 * c], 16) * (1.0 - NIGHT_PART) + NIGHT[c] * NIGHT_PART)
            for c in range(3)
        )
        day += f"--k{k}:{kind.tint};"
        night += f"--k{k}:#{''.join(f'{value:02x}' for value in mixed)};"
        swatches += f".k{k}{{background:var(--k{k})}}"
    return (
        f":root{{{day}}}{swatches}"
        f"@media screen and (prefers-color-scheme: dark){{:root:not(.paper){{{night}}}}}"
    )


def _interest(layer: Layer, guidance: dict[str, Any] | None) -> tuple[bool, bool, float, int]:
    """What to show first: where the bone could stand, guidance's move, then the least turn and lift."""
    good = sum(p.admissible for p in layer.positions)
    return good > 0, layer.holds(guidance), -abs(layer.yaw_deg) - abs(layer.lift_mm), good


def _words(document: dict[str, Any]) -> str:
    counts, registration = document["counts"], document["registration"]
    placed = f"Registration {registration}" if registration else "No registration (identity)"
    return (
        f"<p>{html.escape(placed)}. {counts['admissible']} of {counts['positions']} positions are admissible, each "
        f"of them proved. {html.escape(between(document))} Each position, every {document['grid']['step_mm']:g} mm, is a new "
        "registration: turn the bone by the yaw about the vertical through the cross, then move it, lift included. A moved "
        "bone needs a new registration, which is verified anew.</p>\n"
    )


def _body(document: dict[str, Any], drawn: Sequence[Layer], shown: Layer) -> str:
    """Map, controls, reading and legend; the script fills them."""
    top = ratio_top(drawn)
    found = {
        kind_of(p.limiting) for layer in drawn for p in (*layer.positions, *layer.middles) if not p.admissible
    }
    signs = (*_SIGNS, _MOVE) if document["guidance"] else _SIGNS
    legend = "".join(
        f'<li><svg viewBox="-10 -10 20 20" aria-hidden="true"><path d="{path}" fill="#fff" stroke="#000" '
        f'stroke-width="2"/></svg>{words}</li>'
        for path, words in signs
    )
    legend += (
        '<li><svg viewBox="0 0 20 20" aria-hidden="true"><path d="M0 10H20" stroke="currentColor" stroke-width="2.5" '
        'stroke-dasharray="7 4"/></svg>workspace of the wrist centre</li>'
    )
    legend += "".join(
        f'<li><span class="swatch k{k}"></span>{html.escape(kind.words)}</li>'
        for k, (name, kind) in enumerate(KINDS.items())
        if name in found
    )
    if any((layer.squares.states == State.UNKNOWN).any() for layer in drawn):
        legend += '<li><span class="swatch undecided"></span>not decided: here and there may be either</li>'
    reading = "".join(
        f'<dt>{name}</dt><dd id="{key}"></dd>'
        for key, name in (
            ("verdict", "Verdict"),
            ("how", "Judged"),
            ("limit", "Limit"),
            ("clearance", "Clearance"),
            ("around", "Around it"),
            ("move", "Move"),
            ("point", "Place"),
        )
    )
    return (
        f'<main><div class="picture"><h2 id="heading" aria-live="polite">{shown.title}</h2>'
        f'<p class="small" id="height">{height(document, shown.lift_mm)}</p>'
        '<canvas id="map" role="img" tabindex="0" aria-describedby="reading"></canvas></div>\n<div class="side">'
        f'<section id="seen" hidden><h2>At the marked place</h2><dl id="reading" aria-live="polite">{reading}</dl></section>\n'
        '<section id="tools" hidden>'
        '<label>Turn <output for="yaws"></output><input type="range" id="yaws" min="0"></label>'
        '<label>Height <output for="lifts"></output><input type="range" id="lifts" min="0"></label>'
        '<label>Show<select id="view"><option value="all">all that the arm might reach</option>'
        '<option value="near">the admissible places</option></select></label>'
        '<div class="buttons"><button type="button" id="here">Where it stands</button>'
        '<button type="button" id="near">Nearest admissible</button>'
        '<button type="button" id="room">Most room</button></div></section>\n'
        "<section><h2>Admissible: smallest clearance, in deadbands</h2>"
        '<canvas id="bar" aria-hidden="true"></canvas>'
        f'<div class="ends"><span>1: just kept</span><span>{top:g}{" or more" if top == RATIO_MAX else ""}</span></div>'
        f"<ul>{legend}</ul></section></div></main>\n"
    )


def _table(drawn: Sequence[Layer]) -> str:
    """Turns and lifts as text, for readers without the map and on paper."""
    rows = "".join(
        f"<tr><td>{signed(layer.yaw_deg)}°</td><td>{signed(layer.lift_mm)} mm</td>"
        f"<td>{sum(p.admissible for p in layer.positions)} of {len(layer.positions)}</td><td>{_roomiest(layer)}</td></tr>"
        for layer in drawn[:LISTED_MAX]
    )
    more = f"<p>The first {LISTED_MAX} of {len(drawn)}.</p>" if len(drawn) > LISTED_MAX else ""
    return (
        f'<section class="wide"><h2>Turns and lifts</h2><table><thead><tr><th scope="col">yaw</th>'
        '<th scope="col">lift</th><th scope="col">admissible</th><th scope="col">most room</th></tr></thead>'
        f"<tbody>{rows}</tbody></table>{more}</section>\n"
    )


def _roomiest(layer: Layer) -> str:
    good = [p for p in layer.positions if p.admissible and p.ratio is not None]
    if not good:
        return "none"
    p = max(good, key=lambda one: (round(one.ratio or 0.0, 3), -math.hypot(one.x_mm, one.y_mm)))
    return f"x {signed(p.x_mm)}, y {signed(p.y_mm)} mm: {p.limiting} {_hundredths(p) / 100:.2f} {p.unit}"


def _hundredths(p: Position) -> int:
    """Of the clearance, never shown as more than was proved; of a rate never as less than it is."""
    value = round((p.clearance or 0.0) * 100.0, 6)
    return math.ceil(value) if p.limiting.startswith(RATES) else math.floor(value)


_CHECKED: Final = {
    ("pose", False): 0,
    ("certified", False): 1,
    ("certified", True): 2,
    ("proved", True): 3,
}
_INITIALS: Final = {cell: cell[0] for cell in CELLS.values()}


def _steps(where: Ints) -> list[list[int]]:
    """Levels, columns and rows, each as what it is more than the one before: that deflates well."""
    steps: list[list[int]] = np.diff(where, axis=0, prepend=0).T.tolist()
    return steps


def _data(document: dict[str, Any], drawn: Sequence[Layer], first: int, arcs: Arcs) -> str:
    """All that the script draws, deflated, base64: ``codes`` are limit, and how it was judged, in one."""
    grid, kinds = document["grid"], list(KINDS)
    limits = {
        (p.limiting, p.unit, p.bound): None for layer in drawn for p in (*layer.positions, *layer.middles)
    }
    numbers = {limit: k for k, limit in enumerate(limits)}
    guidance = document["guidance"]
    data = {
        "x": grid["x_mm"],
        "y": grid["y_mm"],
        "yaw": grid["yaw_deg"],
        "lift": grid["lift_mm"],
        "step": grid["step_mm"],
        "pivot": document["pivot_mm"],
        "arcs": [np.round(points, 1).tolist() for _, points in arcs],
        "move": {"by": guidance["translation_mm"], "yaw": guidance["yaw_deg"]} if guidance else None,
        "words": [height(document, lift) for lift in grid["lift_mm"]],
        "limits": [
            {
                "name": name,
                "unit": unit,
                "bound": round(bound, 6),
                "rate": name.startswith(RATES),
                "kind": kinds.index(kind_of(name)),
                "words": KINDS[kind_of(name)].words.split(": ", 1)[1].removesuffix(f" ({name})"),
            }
            for name, unit, bound in limits
        ],
        "kinds": [kind.letter for kind in KINDS.values()],
        "scale": CIVIDIS,
        "top": ratio_top(drawn),
        "first": first,
        "codes": [
            [
                4 * numbers[p.limiting, p.unit, p.bound] + _CHECKED[p.checked, p.admissible]
                for p in (*layer.positions, *layer.middles)
            ]
            for layer in drawn
        ],
        "clearances": [
            [None if p.clearance is None else _hundredths(p) for p in layer.positions]
            + [None if p.clearance is None else 50 * (_hundredths(p) // 50) for p in layer.middles]
            for layer in drawn
        ],
        "cells": ["".join(_INITIALS[p.cell] for p in layer.positions) for layer in drawn],
        "first_steps": drawn[0].squares.lattice.first,
        "squares": [_steps(layer.squares.where[layer.squares.smaller]) for layer in drawn],
        "unknown": [_steps(layer.squares.where[layer.squares.states == State.UNKNOWN]) for layer in drawn],
    }
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()
