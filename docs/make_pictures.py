"""Draws the pictures of the documentation into ``docs/pictures``: ``python docs/make_pictures.py [FOLDER]``.

The same files come out on every run with the same libraries. Colours are Okabe and Ito's, told apart by colour-blind
readers; what matters differs in line or mark as well.
"""
# ruff: noqa: INP001

import math
import sys
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.runtime.commands.verify_picture import figure_of
from cutgate.runtime.commands.verify_scene import scene
from cutgate.runtime.kinematics.arm import TrueArm
from cutgate.runtime.library.printed import printed_distance
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import prepare
from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.placing.guidance import guide
from cutgate.runtime.verification.problem import Arm, Deadband, Problem
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES, WRIST_BOUNDARIES, Verdict
from cutgate.runtime.workspace.distance import side_distances, signed_distance, signed_sides
from cutgate.runtime.workspace.planar import SIDES, PlanarWorkspace

Floats = NDArray[np.float64]

ROOT: Final = Path(__file__).parents[1]
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
GREY: Final = "#666666"
COLOUR: Final = {
    "inner": PURPLE, "outer": BLUE, "left": GREEN, "right": ORANGE, "top": BLACK, "bottom": GREY,
    "roll_min": BLUE, "roll_max": ORANGE, "pitch_min": GREEN, "pitch_max": PURPLE, "wrist_singularity": BLACK,
}  # fmt: skip
DASHED: Final = ("bottom", "wrist_singularity")
DOTS_PER_INCH: Final = 110


def hip_stem(name: str) -> tuple[Problem, Verdict]:
    """The hip-stem example at one of its registrations, and its certified verdict."""
    examples = ROOT / "examples"
    robot = load_robot(examples / "robot.toml").value
    placed = load_registration(examples / f"registration-{name}.json")
    plan, now = load_plan(examples / "hip-stem.plan.json"), datetime.now(UTC)
    path = prepare(plan, placed, robot, now=now, clock_skew_s=0.0).path
    bodies = (limits_record(robot).body(), calibration_record(robot).body(), tool_record(robot).body())
    problem = problem_from_records(path.body(), *bodies, robot, any_branch=True)
    return problem, certified.verify(problem)


def wrist_centres(problem: Problem) -> Floats:
    """Of the poses, (n, 3)."""
    return problem.tips_mm + problem.tool_length_mm * problem.axes


def planar(problem: Problem) -> PlanarWorkspace:
    """Of a right-elbow robot without calibration."""
    return PlanarWorkspace(
        problem.arm.upper_mm, problem.arm.forearm_mm, *np.stack((problem.lower, problem.upper), 1)[:2].ravel()
    )


def clearances(problem: Problem, verdict: Verdict) -> dict[str, Floats]:
    """Of every boundary at every pose, mm and deg; NaN where undefined. Right elbow, no calibration."""
    wrist, space = wrist_centres(problem), planar(problem)
    inside = space.inside(wrist[:, :2])
    sides = signed_sides(side_distances(wrist[:, :2], space), inside, full_revolution=False)
    arm = TrueArm(problem.arm.upper_mm, problem.arm.forearm_mm, 1.0, np.zeros(5), np.zeros(2))
    with np.errstate(invalid="ignore"):
        q = arm.joints(problem.tips_mm, problem.axes, problem.tool_length_mm)
    roll = np.unwrap(q[:, 3]) if verdict.branch else q[:, 3]
    roll = np.where(inside, roll, np.nan)
    lower, upper = problem.lower, problem.upper
    angles = (roll - lower[3], upper[3] - roll, q[:, 4] - lower[4], upper[4] - q[:, 4])
    out = dict(zip(SIDES, sides.T, strict=True))
    out |= {"top": upper[2] - wrist[:, 2], "bottom": wrist[:, 2] - lower[2]}
    singular = np.minimum(q[:, 4], math.pi - q[:, 4])
    return out | {name: np.degrees(v) for name, v in zip(WRIST_BOUNDARIES, (*angles, singular), strict=True)}


def outline(axes: Axes, space: PlanarWorkspace, *, width: float = 2.0, colour: str | None = None) -> None:
    """The four clipped arcs."""
    for name, arc in zip(SIDES, space.arcs, strict=True):
        t = arc.start + np.linspace(0.0, arc.span, 400)
        x, y = arc.x + arc.radius * np.cos(t), arc.y + arc.radius * np.sin(t)
        axes.plot(x, y, color=colour or COLOUR[name], lw=width, label=None if colour else name)


def millimetres(axes: Axes, title: str) -> None:
    """Equal scales, units, title."""
    axes.set_aspect("equal")
    axes.set_xlabel("x, mm")
    axes.set_ylabel("y, mm")
    axes.set_title(title, fontsize=10)


def field(axes: Axes, step: float) -> tuple[Floats, tuple[int, int]]:
    """Points on a grid over the axes' limits, (n, 2), and the grid's shape."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    x, y = np.meshgrid(np.arange(x0 + step / 2, x1, step), np.arange(y0 + step / 2, y1, step))
    return np.stack((x.ravel(), y.ravel()), axis=1), x.shape


def paint(axes: Axes, values: NDArray[np.int64], shape: tuple[int, int], colours: list[str]) -> None:
    """A map of classes under everything else."""
    axes.imshow(
        values.reshape(shape), cmap=ListedColormap(colours), vmin=-0.5, vmax=len(colours) - 0.5,
        origin="lower", extent=(*axes.get_xlim(), *axes.get_ylim()), interpolation="nearest", zorder=0,
    )  # fmt: skip


def workspace_and_path() -> Figure:
    """The exact workspace with both placements of the hip stem, and the place where it matters, enlarged."""
    figure = Figure(figsize=(9.0, 4.9), layout="constrained")
    whole, near = figure.subplots(1, 2, width_ratios=(1.0, 1.12))
    cases = {name: hip_stem(name) for name in ("first", "second")}
    space = planar(cases["first"][0])
    whole.set(xlim=(-620, 960), ylim=(-960, 960))
    near.set(xlim=(655, 835), ylim=(355, 535))
    for axes, step in ((whole, 2.0), (near, 0.3)):
        points, shape = field(axes, step)
        d = signed_distance(points, space)
        paint(axes, (d >= 0.0).astype(int) + (d >= 5.0), shape, ["#FFFFFF", "#F5C07A", "#E8F2F9"])
        outline(axes, space)
        for name, (problem, verdict) in cases.items():
            trace(axes, problem, verdict, name, detail=axes is near)
    whole.add_patch(Rectangle((655, 355), 180, 180, fill=False, ec=GREY, lw=1))
    millimetres(whole, "Exact workspace of the wrist centre")
    millimetres(near, "Enlarged: 5 mm deadband in orange")
    whole.plot(0, 0, "k+", ms=9)
    whole.annotate("shoulder", (0, 0), (-18, -12), textcoords="offset points", fontsize=8, ha="right")
    whole.legend(loc="lower left", fontsize=8, title="boundary", title_fontsize=8)
    shown = near.get_legend_handles_labels()
    near.legend(*(part[len(SIDES) :] for part in shown), loc="lower right", fontsize=8)
    return figure


def trace(axes: Axes, problem: Problem, verdict: Verdict, name: str, *, detail: bool) -> None:
    """One placement's wrist-centre path, its violations and its worst place."""
    wrist = wrist_centres(problem)
    least = np.minimum.reduce([v for k, v in clearances(problem, verdict).items() if k in SIDES])
    wrong = least < problem.deadband.arm_mm
    word = "admissible" if verdict.admissible else "inadmissible"
    axes.plot(*wrist[:, :2].T, color=BLACK, lw=0.5, ls="-" if name == "first" else "--", alpha=0.75,
              label=f"{name} registration: {word}" if detail else None)  # fmt: skip
    if wrong.any():
        axes.plot(*wrist[wrong, :2].T, "x", color=RED, ms=3.0, mew=0.7, alpha=0.7,
                  label=f"nearer than 5 mm: {wrong.sum()} of {len(wrong)} poses" if detail else None)  # fmt: skip
    worst = min((verdict.boundaries[side] for side in SIDES), key=lambda b: b.certified or 0.0)
    i, s = worst.segment or 0, worst.fraction or 0.0
    x, y = wrist[i, :2] + s * (wrist[i + 1, :2] - wrist[i, :2])
    if not detail:
        return
    axes.plot(x, y, "D", color=YELLOW, mec=BLACK, ms=7, zorder=5)
    axes.annotate(
        f"worst place, {name}:\n{worst.name} {worst.clearance:.1f} mm", (x, y), (-120, 14) if name == "first" else (-95, 40),
        textcoords="offset points", fontsize=8, arrowprops={"arrowstyle": "-", "lw": 0.7}, zorder=6,
        bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": GREY, "lw": 0.6},
    )  # fmt: skip


def clearance_along_path() -> Figure:
    """Every boundary's clearance over the tip path, with its certified value and the deadband."""
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=(1.0, 2.0, 2.0))
    for column, name in enumerate(("first", "second")):
        problem, verdict = hip_stem(name)
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(problem.tips_mm, axis=0), axis=1))))
        values = clearances(problem, verdict)
        word = "admissible" if verdict.admissible else "inadmissible"
        grid[0, column].set_title(f"{name} registration: {word}", fontsize=10)
        arm, wrist = problem.deadband.arm_mm, math.degrees(problem.deadband.wrist_rad)
        rows = ((ARM_BOUNDARIES, arm, "mm"), (ARM_BOUNDARIES, arm, "mm"), (WRIST_BOUNDARIES, wrist, "deg"))
        for axes, (names, deadband, unit) in zip(grid[:, column], rows, strict=True):
            axes.axhspan(-1000, deadband, color="#F5C07A", alpha=0.45, lw=0, zorder=0)
            axes.axhline(deadband, color=RED, lw=1.2, ls="--", label=f"deadband {deadband:g} {unit}")
            axes.grid(visible=True, lw=0.3)
            curves(axes, along, values, names, verdict)
    grid[0, 0].set(ylim=(240, 800), ylabel="arm, far: mm")
    grid[1, 0].set(ylim=(-40, 140), ylabel="arm, near: clearance, mm")
    grid[2, 0].set(ylim=(-10, 210), ylabel="wrist: clearance, deg")
    for axes in grid[2]:
        axes.set_xlabel("length along the tip path, mm")
    for row in grid[1:]:
        row[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    figure.supxlabel(
        "triangle: worst place, at the certified value; the roll is undefined where the path is out of reach",
        fontsize=8,
    )
    return figure


def curves(
    axes: Axes, along: Floats, values: dict[str, Floats], names: tuple[str, ...], verdict: Verdict
) -> None:
    """The curves of one panel and the certified values."""
    for name in names:
        style = "--" if name in DASHED else "-"
        axes.plot(along, values[name], color=COLOUR[name], lw=0.8, ls=style, label=name)
        found = verdict.boundaries[name]
        if found.certified is not None and found.tip_length_mm is not None:
            axes.plot(
                found.tip_length_mm,
                found.certified,
                "v",
                color=COLOUR[name],
                mec=BLACK,
                mew=0.5,
                ms=6,
                zorder=4,
            )


def verdict_of_the_first() -> Figure:
    """What ``cutgate verify --plot`` draws of the hip stem where the bone first stands."""
    robot = load_robot(ROOT / "examples" / "robot.toml").value
    placed = load_registration(ROOT / "examples" / "registration-first.json")
    plan = load_plan(ROOT / "examples" / "hip-stem.plan.json")
    prepared = prepare(plan, placed, robot, now=datetime.now(UTC), clock_skew_s=0.0)
    problem, verdict = hip_stem("first")
    guidance = guide(problem, verdict, prepared.quantise)
    title = f"{plan.value.id}, registration {placed.value.id}"
    figure: Figure = figure_of(scene(problem, verdict, guidance, title))
    return figure


TABLE_1: Final = (
    (765.299, 90.0, "strokes tangential, near the outer circle"),
    (274.514, 90.0, "strokes tangential, near the inner circle"),
    (500.0, 90.0, "strokes tangential, in the middle"),
    (546.458, 0.0, "strokes radial, as far from both"),
)


def zigzag(rho: float, phi_deg: float) -> Floats:
    """The reconstructed path of Table 1: 25 equal strokes, 17501 mm long, 225 mm across; (26, 2)."""
    k = np.arange(26)
    width = math.sqrt(17501.0**2 - 225.0**2) / 25
    x, y = -width / 2 * (-1.0) ** k, -225.0 / 2 + k * 225.0 / 25
    c, s = math.cos(math.radians(phi_deg)), math.sin(math.radians(phi_deg))
    return np.stack((c * x - s * y + rho, s * x + c * y), axis=1)


def annulus_problem(path: Floats) -> Problem:
    """The arm of the paper's Figure 2, its tool level, deadband 25 mm."""
    wide = math.radians(36000.0)
    tips = np.column_stack((path, np.zeros(len(path))))
    return Problem(
        tips_mm=tips, axes=np.tile((1.0, 0.0, 0.0), (len(path), 1)), feed_mm_s=10.0, tool_length_mm=0.0,
        arm=Arm(550.0, 450.0, "right"), lower=np.array([-wide, 0.0, -1e3, -wide, 0.0]),
        upper=np.array([wide, math.pi, 1e3, wide, math.pi]), speed=np.full(5, 1e9),
        deadband=Deadband(25.0, math.radians(2.0)),
    )  # fmt: skip


def table_1() -> Figure:
    """The four placements of the zigzag with the published march's evaluations."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    t = np.linspace(0.0, 2.0 * math.pi, 400)
    for axes, (rho, phi, words), number in zip(
        figure.subplots(1, 4, sharey=True), TABLE_1, range(1, 5), strict=True
    ):
        problem = annulus_problem(zigzag(rho, phi))
        marched, exact = stocco.verify(problem), certified.verify(problem)
        least = min(exact.boundaries[name].clearance or math.nan for name in ("inner", "outer"))
        for radius in (100.0, 1000.0):
            axes.plot(radius * np.cos(t), radius * np.sin(t), color=BLACK, lw=1.2)
            edge = radius + (25.0 if radius < 500 else -25.0)
            axes.plot(edge * np.cos(t), edge * np.sin(t), color=RED, lw=0.7, ls="--")
        axes.plot(*problem.tips_mm[:, :2].T, color=BLUE, lw=0.7)
        millimetres(axes, f"({number}) " + words.replace(", ", ",\n"))
        axes.set(xlim=(-160, 1060), ylim=(-700, 700), xticks=(0, 500, 1000))
        count = marched.evaluations
        axes.text(
            0.03, 0.02, f"{count.arm} evaluations\nof {count.best_case} to {count.worst_case}\nclearance {least:.1f} mm",
            transform=axes.transAxes, fontsize=8.5, bbox={"fc": "white", "ec": "none", "pad": 1.5, "alpha": 0.85},
        )  # fmt: skip
        axes.label_outer()
    return figure


def printed_equations() -> Figure:
    """Where D as printed accepts what is unreachable, and where it rejects what is reachable."""
    figure = Figure(figsize=(9.0, 5.3), layout="constrained")
    names = [
        "rejected, unreachable",
        "accepted, reachable",
        "accepted, but unreachable",
        "rejected, but reachable",
    ]
    colours = ["#FFFFFF", "#CFE6F5", ORANGE, PURPLE]
    for axes, half in zip(figure.subplots(1, 2, sharey=True), (60.0, 125.0), strict=True):
        space = PlanarWorkspace(
            500.0, 500.0, math.radians(-half), math.radians(half), 0.0, math.radians(150.0)
        )
        axes.set(xlim=(-1080, 1080), ylim=(-1080, 1080))
        points, shape = field(axes, 4.0)
        accepted, inside = printed_distance(points, space) > 0.0, space.inside(points)
        classes = np.select([accepted & inside, accepted, inside], [1, 2, 3], 0)
        paint(axes, classes, shape, colours)
        outline(axes, space, width=1.6, colour=BLACK)
        axes.plot(0, 0, "k+", ms=9)
        told = (
            f"{100.0 * (accepted & ~inside).sum() / accepted.sum():.1f} % of the accepted area is unreachable"
        )
        if half > 90.0:
            told = (
                f"{100.0 * (inside & ~accepted).sum() / inside.sum():.0f} % of the reachable area is rejected"
            )
        millimetres(axes, f"J1 {-half:g} to {half:g} deg:\n{told}")
        if half < 90.0:
            wedge_point(axes)
        axes.label_outer()
    marks = [Rectangle((0, 0), 1, 1, fc=c, ec=GREY, lw=0.6) for c in colours]
    exact = figure.axes[0].lines[0]
    figure.legend(
        [*marks, exact], [*names, "exact boundary"], loc="outside lower center", ncols=3, fontsize=8.5
    )
    return figure


def wedge_point(axes: Axes) -> None:
    """Where D of an unreachable point is largest."""
    x, y = 800.0 * math.cos(math.radians(-120.0)), 800.0 * math.sin(math.radians(-120.0))
    axes.plot(x, y, "D", color=YELLOW, mec=BLACK, ms=7)
    axes.annotate(
        "D up to 200 mm\nat -120 deg, 800 mm", (x, y), (-1040, -420), fontsize=8.5, va="bottom",
        arrowprops={"arrowstyle": "-", "lw": 0.8},
        bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": GREY, "lw": 0.6},
    )  # fmt: skip


PICTURES: Final = {
    "workspace-and-path.png": workspace_and_path,
    "clearance-along-path.png": clearance_along_path,
    "table-1.png": table_1,
    "printed-equations.png": printed_equations,
    "verify-hip-stem.png": verdict_of_the_first,
}


def save(figure: Figure, file: Path) -> None:
    """As a PNG of 128 colours, a third of the size of one in full colour."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=DOTS_PER_INCH, format="png", metadata={"Software": None})
    full = Image.open(buffer).convert("RGB")
    full.quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)


def main(folder: Path) -> None:
    """Writes every picture."""
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"font.size": 9.0}):
        for name, draw in PICTURES.items():
            save(draw(), folder / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "pictures")
