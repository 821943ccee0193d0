"""The map of bone positions as one picture, and what map and page have in common."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cutgate.config.screen import printable
from cutgate.protocol.arrays import Floats
from cutgate.runtime.verification.placing.cells import Squares, State
from cutgate.runtime.verification.placing.reach import RATES, Position, Surveyed

Arcs = Sequence[tuple[str, Floats]]

PANELS_MAX: Final = 12
LETTERS: Final = 9
"""About so many letters across a panel say what limits, for readers who cannot tell the tints apart."""
COLOUR_MAP: Final = "cividis"
RATIO_MAX: Final = 20.0
FINE_MAX: Final = 2048
"""A panel is drawn in no more than about so many squares either way: there are no more dots on it."""


@dataclass(frozen=True, slots=True)
class PictureKind:
    """What keeps a position from being admissible: a letter, a pale tint, and words."""

    letter: str
    tint: str
    words: str


KINDS: Final = {
    "inner": PictureKind("I", "#f7d3bd", "I: too near the column (inner)"),
    "outer": PictureKind("O", "#d2e6f7", "O: too far out (outer)"),
    "left": PictureKind("L", "#ddd0ef", "L: q0 at its upper limit (left)"),
    "right": PictureKind("R", "#d9cba3", "R: q0 at its lower limit (right)"),
    "top": PictureKind("T", "#dddddd", "T: slide at its upper end (top)"),
    "bottom": PictureKind("B", "#c6c6c6", "B: slide at its lower end (bottom)"),
    "roll": PictureKind("W", "#f4c6dd", "W: roll of the wrist (q3)"),
    "pitch": PictureKind("P", "#c3e6d8", "P: pitch of the tool (q4)"),
    "speed": PictureKind("S", "#fbc4c4", "S: joint too fast, or accelerating too much, at this feed"),
}


def kind_of(limiting: str) -> str:
    """The kind of a boundary or rate."""
    if limiting.startswith(RATES):
        return "speed"
    if limiting.startswith("roll"):
        return "roll"
    return "pitch" if limiting.startswith(("pitch", "wrist")) else limiting


@dataclass(frozen=True, slots=True)
class Layer:
    """All displacements at one yaw and lift, rows of y and in them x, and the squares that cover the map."""

    yaw_deg: float
    lift_mm: float
    positions: tuple[Position, ...]
    shape: tuple[int, int]
    squares: Squares
    middles: tuple[Position, ...]

    @property
    def ratio(self) -> Floats:
        """Clearance per deadband where admissible, else NaN."""
        return np.array([_ratio(p) for p in self.positions], dtype=np.float64).reshape(self.shape)

    @property
    def kind(self) -> Floats:
        """Number of the kind that limits where inadmissible, else NaN."""
        return np.array([_kind(p) for p in self.positions], dtype=np.float64).reshape(self.shape)

    def drawn(self) -> tuple[Floats, Floats]:
        """Both as they are drawn, finer: of positions in squares of the step and larger, of the middles of smaller ones.

        Where nothing is proved of a square both are NaN, whatever its position is.
        """
        squares, whole = self.squares, self.squares.lattice.whole
        most = int(squares.where[:, 0].max(initial=whole))
        fine = min(most - whole, max(0, int(math.log2(FINE_MAX / max(self.shape)))))
        n = 1 << fine
        out = [np.repeat(np.repeat(values, n, axis=0), n, axis=1) for values in (self.kind, self.ratio)]
        unknown = squares.where[squares.states == State.UNKNOWN]
        smaller = squares.where[squares.smaller]
        nothing = [(math.nan, math.nan)] * len(unknown)
        pairs = [(_kind(p), _ratio(p)) for p in self.middles]
        for where, values in ((smaller, pairs), (unknown, nothing)):
            for (level, i, j), pair in zip(where.tolist(), values, strict=True):
                size = whole + fine - level
                k = max(1, 1 << max(size, 0))
                x, y = (v << size if size >= 0 else v >> -size for v in (i, j))
                for raster, value in zip(out, pair, strict=True):
                    raster[y : y + k, x : x + k] = value
        return out[0], out[1]

    @property
    def title(self) -> str:
        """Yaw and lift."""
        return f"yaw {signed(self.yaw_deg)}°, lift {signed(self.lift_mm)} mm"

    def holds(self, guidance: dict[str, Any] | None) -> bool:
        """Whether guidance's move has this yaw and lift."""
        return guidance is not None and (guidance["yaw_deg"], guidance["translation_mm"][2]) == (
            self.yaw_deg,
            self.lift_mm,
        )


def _ratio(p: Position) -> float:
    return p.ratio if p.admissible and p.ratio is not None else math.nan


def _kind(p: Position) -> float:
    return math.nan if p.admissible else float(list(KINDS).index(kind_of(p.limiting)))


def signed(value: float) -> str:
    """A move with its direction."""
    return f"{value:+g}" if value else "0"


CHOSEN_BY: Final = {
    "asked": "as asked for",
    "present": "the bone's present height",
    "guidance": "the height that guidance chooses",
    "slide": "the middle of the slide's range",
}


def height(document: dict[str, Any], lift_mm: float) -> str:
    """What a lift does with the bone, and who chose it."""
    done = "bone raised" if lift_mm > 0.0 else "bone lowered" if lift_mm < 0.0 else "height unchanged"
    return f"{done}, {CHOSEN_BY[document['lift_chosen_by']]}"


def between(document: dict[str, Any]) -> str:
    """How much of the map is proved, in a sentence."""
    area = {
        name: sum(one[f"{name}_mm2"] for one in document["cells"])
        for name in ("admissible", "inadmissible", "unknown")
    }
    whole = sum(area.values())
    return (
        f"Between the positions as well: {100.0 * area['admissible'] / whole:.1f} % of the map is proved admissible, "
        f"{100.0 * area['inadmissible'] / whole:.1f} % is proved inadmissible, {100.0 * area['unknown'] / whole:.1f} % is not "
        "decided."
    )


def layers(document: dict[str, Any], found: Surveyed) -> list[Layer]:
    """The map, cut into layers in the order yaw, lift."""
    grid = document["grid"]
    shape = (len(grid["y_mm"]), len(grid["x_mm"]))
    size = shape[0] * shape[1]
    pairs = [(yaw, lift) for yaw in grid["yaw_deg"] for lift in grid["lift_mm"]]
    return [
        Layer(yaw, lift, tuple(found.positions[k * size : (k + 1) * size]), shape, squares, tuple(middles))
        for k, ((yaw, lift), squares, middles) in enumerate(
            zip(pairs, found.squares, found.middles, strict=True)
        )
    ]


def letters(layer: Layer) -> list[tuple[int, int, str]]:
    """Row, column and letter of a few inadmissible cells, evenly spread."""
    kind, order = layer.kind, list(KINDS.values())
    step = max(1, max(layer.shape) // LETTERS)
    return [
        (i, j, order[int(kind[i, j])].letter)
        for i in range(step // 2, layer.shape[0], step)
        for j in range(step // 2, layer.shape[1], step)
        if math.isfinite(kind[i, j])
    ]


def ratio_top(drawn: Sequence[Layer]) -> float:
    """Upper end of the colour scale: the best ratio of all, rounded up, at least 2."""
    best = max((float(np.nanmax(one.ratio)) for one in drawn if np.isfinite(one.ratio).any()), default=2.0)
    return min(max(math.ceil(best), 2.0), RATIO_MAX)


def picture(document: dict[str, Any], found: Surveyed, arcs: Arcs) -> bytes:
    """The map as PNG: one panel for each yaw and lift, at most `PANELS_MAX`.

    Args:
        document: ``cutgate.reach/1``.
        found: all of it.
        arcs: the workspace of the wrist centre.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - half a second, here only
    from matplotlib.figure import Figure  # noqa: PLC0415

    drawn = layers(document, found)
    shown = drawn[:PANELS_MAX]
    columns = min(len(shown), 3 if len(shown) != 4 else 2)
    rows = math.ceil(len(shown) / columns)
    figure = Figure(
        figsize=(max(4.6 * columns + 1.2, 9.0), max(4.7 * rows, 5.5 if columns == 1 else 0.0) + 1.6),
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    top = ratio_top(shown)
    scale = None
    for axis, layer in zip(axes.flat, shown, strict=False):
        scale = _panel(axis, document, layer, arcs, top)
    for axis in axes.flat[len(shown) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel("y, mm (robot frame)")
    if scale is not None:
        bar = figure.colorbar(scale, ax=axes, shrink=0.8, extend="max" if top == RATIO_MAX else "neither")
        bar.set_label("admissible: smallest clearance, in deadbands (1 = just kept)")
    _legend(figure, drawn, document)
    title = printable(f"Where the bone could stand: {document['plan']} on {document['robot']}")
    if len({layer.lift_mm for layer in drawn}) == 1:
        title += f"\nat lift {signed(drawn[0].lift_mm)} mm ({height(document, drawn[0].lift_mm)})"
    if len(shown) < len(drawn):
        title += f" (the first {len(shown)} of {len(drawn)} turns and lifts)"
    figure.suptitle(title, fontweight="bold", parse_math=False)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100, metadata={"Software": None})
    return out.getvalue()


def _panel(axis: Any, document: dict[str, Any], layer: Layer, arcs: Arcs, top: float) -> Any:
    """One yaw and lift; returns what the colour scale is for."""
    from matplotlib.colors import ListedColormap  # noqa: PLC0415

    grid, (px, py, _) = document["grid"], document["pivot_mm"]
    x, y = np.array(grid["x_mm"]) + px, np.array(grid["y_mm"]) + py
    tints = ListedColormap([kind.tint for kind in KINDS.values()])
    half = grid["step_mm"] / 2.0
    kinds, ratios = layer.drawn()
    drawn = {"origin": "lower", "extent": (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)}
    drawn |= {"interpolation": "nearest"}
    axis.imshow(kinds, cmap=tints, vmin=-0.5, vmax=len(KINDS) - 0.5, **drawn)
    scale = axis.imshow(ratios, cmap=COLOUR_MAP, vmin=1.0, vmax=top, **drawn)
    for i, j, letter in letters(layer):
        axis.text(x[j], y[i], letter, ha="center", va="center", fontsize=7, color="#404040")
    for _, points in arcs:
        axis.plot(points[:, 0], points[:, 1], color="black", linewidth=1.1)
    axis.plot(0.0, 0.0, marker="o", markersize=9, color="white", markeredgecolor="black", markeredgewidth=1.5)
    axis.plot(px, py, marker="X", markersize=10, color="white", markeredgecolor="black", markeredgewidth=1.5)
    axis.set_xlabel(f"x of the reference point, mm, at lift {signed(layer.lift_mm)} mm")
    if layer.holds(document["guidance"]):
        x_mm, y_mm, _ = document["guidance"]["translation_mm"]
        axis.plot(px + x_mm, py + y_mm, marker="D", markersize=8, color="white", markeredgecolor="black")
    good = sum(p.admissible for p in layer.positions)
    axis.set_title(f"{layer.title}: {good} of {len(layer.positions)} admissible", fontsize=10)
    axis.set_aspect("equal")
    outline = np.concatenate([points for _, points in arcs])
    low, high = np.minimum(outline.min(axis=0), (x[0], y[0])), np.maximum(outline.max(axis=0), (x[-1], y[-1]))
    axis.set_xlim(low[0] - half, high[0] + half)
    axis.set_ylim(low[1] - half, high[1] + half)
    return scale


def _legend(figure: Any, drawn: Sequence[Layer], document: dict[str, Any]) -> None:
    """Signs and tints that occur, below the panels."""
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    marks: dict[str, Any] = {"color": "white", "markeredgecolor": "black", "linestyle": "none"}
    step = document["grid"]["step_mm"]
    handles: list[Any] = [
        Line2D([], [], marker="X", markersize=9, label="where the bone stands now", **marks),
        Line2D([], [], marker="o", markersize=8, label="column (axis of q0)", **marks),
        Line2D([], [], color="black", label="workspace of the wrist centre"),
    ]
    found = {kind_of(p.limiting) for layer in drawn for p in layer.positions if not p.admissible}
    if any(layer.holds(document["guidance"]) for layer in drawn):
        handles.append(
            Line2D([], [], marker="D", markersize=7, label="the move that guidance chooses", **marks)
        )
    handles += [
        Patch(facecolor=kind.tint, edgecolor="#808080", label=kind.words)
        for name, kind in KINDS.items()
        if name in found
    ]
    if any((layer.squares.states == State.UNKNOWN).any() for layer in drawn):
        handles.append(Patch(facecolor="white", edgecolor="#808080", label="not decided"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=3,
        fontsize=8,
        title=f"Reference point: mean cutter tip, which is also the pivot of a turn. Judged every {step:g} mm, "
        "proved between. Tints: inadmissible, and what limits.",
        title_fontsize=8,
    )
