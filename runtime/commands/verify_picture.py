"""The picture of a verdict as PNG."""

import io
import textwrap
from typing import Any, Final

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.runtime.commands.reach_page import CIVIDIS
from cutgate.runtime.commands.verify_page import BAD, NONE, TITLES, shades, side_bounds, steps
from cutgate.runtime.commands.verify_scene import LETTERS, MEANINGS, Scene, Window, labels, windows

VERMILION: Final = "#c23b00"
BLUE: Final = "#0b57d0"
GREY: Final = "#9a9a9a"
LISTED: Final = 3
"""Columns of the list of worst places."""


def picture(shown: Scene) -> bytes:
    """The figure as PNG."""
    out = io.BytesIO()
    figure_of(shown).savefig(out, format="png", dpi=100, metadata={"Software": None})
    return out.getvalue()


def figure_of(shown: Scene) -> Any:
    """Workspace and path from above and from the side, near and whole, with the worst places.

    Args:
        shown: what is to be drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - half a second, here only
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(9.0, 10.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, width_ratios=(1.5, 1.0))
    parts = windows(shown)
    for row, view in enumerate(("above", "side")):
        for column, size in enumerate(("near", "whole")):
            axis, window = axes[row, column], parts[view, size]
            _bounds(axis, shown, view)
            _path(axis, shown, view, 1.0 if size == "near" else 0.6)
            if size == "near":
                _marks(axis, shown, view, window)
            else:
                _whole(axis, shown, view, parts[view, "near"])
            axis.set(xlim=(window.x, window.x + window.span), ylim=(window.y, window.y + window.span))
            axis.set_aspect("equal")
            axis.set_title(TITLES[view, size].replace(": ", ":\n"), fontsize=9)
            axis.tick_params(labelsize=8)
            axis.grid(visible=True, linewidth=0.3)
    _scale(figure, axes, shown)
    _legend(figure, shown)
    move = f"\nProposed move: {shown.proposed[1]}" if shown.proposed else ""
    figure.suptitle(
        f"{shown.title}\n{_wrapped(shown.verdict)}{move}", fontsize=10, fontweight="bold", parse_math=False
    )
    return figure


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, 110))


def _bounds(axis: Any, shown: Scene, view: str) -> None:
    edges, keeps = side_bounds(shown)
    if view == "above":
        edges, keeps = [points for _, points in shown.arcs], list(shown.deadbands)
    for points in keeps:
        axis.plot(*points.T, color="black", linewidth=0.8, linestyle="--")
    for points in edges:
        axis.plot(*points.T, color="black", linewidth=1.6)


def _path(axis: Any, shown: Scene, view: str, wide: float) -> None:
    """The path after the move, a dark line under the path, and the path in its colours; those that violate last."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415

    if shown.proposed:
        axis.plot(*getattr(shown.proposed[0], view).T, color=BLUE, linewidth=0.7 * wide)
    points: Floats = getattr(shown.path, view)
    axis.plot(*points.T, color="black", linewidth=2.6 * wide, solid_joinstyle="round")
    numbers = shades(shown)
    order = np.argsort(-numbers, kind="stable")
    lines = np.stack((points[:-1], points[1:]), axis=1)[order]
    colours = [{NONE: GREY, BAD: VERMILION}.get(k) or CIVIDIS[k] for k in numbers[order].tolist()]
    widths = [(2.2 if k == BAD else 1.5) * wide for k in numbers[order].tolist()]
    axis.add_collection(
        LineCollection(lines.tolist(), colors=colours, linewidths=widths, capstyle="round", zorder=3)
    )


def _marks(axis: Any, shown: Scene, view: str, window: Window) -> None:
    for x, y, letters, violated in labels(shown, view, window):
        axis.plot(
            x,
            y,
            marker="x" if violated else "o",
            markersize=8,
            color="black",
            markerfacecolor="white",
            zorder=5,
        )
        left = x > window.x + 0.8 * window.span
        axis.annotate(
            letters, (x, y), (-8 if left else 8, 6), textcoords="offset points", fontsize=10, fontweight="bold",
            ha="right" if left else "left", zorder=6,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
        )  # fmt: skip


def _whole(axis: Any, shown: Scene, view: str, near: Window) -> None:
    """Where the enlarged part is, the column, and the names of the sides."""
    from matplotlib.patches import Rectangle  # noqa: PLC0415

    axis.add_patch(Rectangle((near.x, near.y), near.span, near.span, fill=False, linestyle=":", zorder=6))
    if view == "above":
        axis.plot(0.0, 0.0, marker="o", markersize=8, color="white", markeredgecolor="black")
        names = [(name, points[len(points) // 2]) for name, points in shown.arcs]
    else:
        edges = side_bounds(shown)[0]
        names = [
            (name, points.mean(axis=0))
            for name, points in zip(("bottom", "outer", "top", "inner"), edges, strict=False)
        ]
    for name, (x, y) in names:
        axis.text(
            x, y, name, fontsize=9, ha="center", va="center", clip_on=True,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip


def _scale(figure: Any, axes: Any, shown: Scene) -> None:
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415
    from matplotlib.colors import BoundaryNorm, ListedColormap  # noqa: PLC0415

    edges = steps(shown)
    more = bool((shown.ratios[np.isfinite(shown.ratios)] > edges[-1]).any())
    colours = ListedColormap(list(CIVIDIS)).with_extremes(over=CIVIDIS[-1])
    bar = figure.colorbar(
        ScalarMappable(BoundaryNorm(edges, len(CIVIDIS)), colours),
        ax=axes, shrink=0.7, ticks=edges, extend="max" if more else "neither",
    )  # fmt: skip
    units = {one.unit: f"{one.required:g} {one.unit}" for one in shown.worst}
    bar.set_label(
        f"smallest clearance, in deadbands of {' or '.join(units.values())} (1: just kept)", fontsize=9
    )


def _legend(figure: Any, shown: Scene) -> None:
    """Signs, then the list of worst places."""
    from matplotlib.lines import Line2D  # noqa: PLC0415

    handles = [
        Line2D([], [], color=VERMILION, linewidth=2.4, label="less than the deadband is kept"),
        Line2D([], [], color="black", linewidth=1.6, label="limit of the wrist centre"),
        Line2D([], [], color="black", linewidth=0.8, linestyle="--", label="deadband inside of it"),
    ]
    if shown.proposed:
        handles.append(Line2D([], [], color=BLUE, linewidth=1.0, label="the path after the proposed move"))
    nothing: dict[str, Any] = {"linestyle": "none", "color": "black", "markerfacecolor": "white"}
    handles += [
        Line2D(
            [], [], marker="x" if one.violated else "o", **nothing,
            label=f"{LETTERS[one.name]}  {one.name} ({MEANINGS[one.name]}):\n{one.value}, {one.required:g} required"
            f"{', VIOLATED' if one.violated else ''}",
        )
        for one in shown.worst
    ]  # fmt: skip
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=LISTED,
        fontsize=8,
        title="Wrist centre; worst place of each boundary with the clearance that is proved there, and what is required",
        title_fontsize=8,
    )
