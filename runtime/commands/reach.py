"""``cutgate reach``: a map of where the bone could stand."""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from cutgate.config.load import InputError, load_robot
from cutgate.config.model import Robot, Site
from cutgate.config.screen import printable
from cutgate.runtime.commands.reach_files import files_for, save
from cutgate.runtime.commands.reach_picture import between, height, signed
from cutgate.runtime.commands.registration_options import (
    DirectionOption,
    FrameOption,
    ResidualOption,
    TakenAtOption,
)
from cutgate.runtime.commands.screen import echo, messages, output, working
from cutgate.runtime.commands.tool_path_options import (
    ArcToleranceOption,
    AxisToleranceOption,
    CutcomOption,
    RotaryOption,
)
from cutgate.runtime.commands.verify import PLAN_HELP, RegistrationOption, RobotOption
from cutgate.runtime.plan.load import load_placed, load_plan
from cutgate.runtime.plan.prepare import Prepared, prepare
from cutgate.runtime.plan.registrations.declared import Declared
from cutgate.runtime.plan.toolpath.model import ARC_TOLERANCE_MM, AXIS_TOLERANCE_DEG, Reading
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.reach import Position
from cutgate.runtime.verification.placing.survey import Work, positions, squares, workers_for
from cutgate.runtime.verification.recorded import off_line_problem
from cutgate.runtime.verification.report.document import document_text

POSITIONS_MAX: Final = 400_000
VALUES_MAX: Final = 73


@contextmanager
def _progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """A bar on standard error; where that is no terminal, one line after half a second."""
    console = messages()
    if not console.is_terminal:
        with working(what):
            yield lambda _: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda count: bar.advance(task, count)


def _values(text: str, option: str, low: float, high: float) -> tuple[float, ...]:
    """Numbers of ``a,b,c`` or ``first:last:step``, ascending, each once.

    Raises:
        typer.BadParameter: anything else, beyond the bounds, or too many.
    """
    expected = f"numbers within {low:g}..{high:g}, as a,b,c or first:last:step, at most {VALUES_MAX} of them"
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            count = (last - first) / step
            ordered = step > 0.0 and 0.0 <= count < VALUES_MAX
            numbers = (
                [round(first + k * step, 6) for k in range(math.floor(count + 1e-9) + 1)] if ordered else []
            )
        else:
            numbers = [float(part) for part in text.split(",")]
    except (ValueError, ZeroDivisionError, OverflowError):
        raise typer.BadParameter(f"{text!r} is not {expected}", param_hint=option) from None
    if not (1 <= len(numbers) <= VALUES_MAX and all(low <= number <= high for number in numbers)):
        raise typer.BadParameter(f"{text!r} is not {expected}", param_hint=option)
    return tuple(sorted({number + 0.0 for number in numbers}))


def _made_for(prepared: Prepared, robot: Robot) -> dict[str, Any]:
    placed = prepared.registration
    return {
        "plan": prepared.plan.value.id,
        "robot": robot.name,
        "elbow": robot.elbow,
        "registration": placed.value.id if placed else None,
        "path_sha256": prepared.path.digest.hex(),
        "registration_sha256": prepared.registration_digest.hex(),
    }


def reach_command(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help=PLAN_HELP)],
    *,
    robot: RobotOption,
    registration: RegistrationOption = None,
    step_mm: Annotated[
        float, typer.Option(min=0.5, max=500.0, help="Distance of neighbouring positions.")
    ] = 20.0,
    yaw_deg: Annotated[
        str | None,
        typer.Option(
            help="Turns about the vertical: a,b,c or first:last:step; if left out 0, and the turn that guidance needs."
        ),
    ] = None,
    lift_mm: Annotated[
        str | None,
        typer.Option(
            help="Displacements along z: a,b,c or first:last:step; if left out the height that guidance would choose."
        ),
    ] = None,
    cutcom_is_tool_centre: CutcomOption = False,
    rotary: RotaryOption = None,
    arc_tolerance_mm: ArcToleranceOption = ARC_TOLERANCE_MM,
    axis_tolerance_deg: AxisToleranceOption = AXIS_TOLERANCE_DEG,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for reach.png, .html, .csv and .json, or one file of these kinds."),
    ] = None,
    cores: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes; all cores if left out.")
    ] = None,
    registration_frame: FrameOption = None,
    registration_direction: DirectionOption = None,
    taken_at: TakenAtOption = None,
    registration_residual_mm: ResidualOption = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Map where the bone could stand so that the whole cut path keeps its distance from every limit.

    Exit code: 0 map made, 2 refused input.
    """
    yaws = None if yaw_deg is None else _values(yaw_deg, "--yaw-deg", -180.0, 180.0)
    lifts = None if lift_mm is None else _values(lift_mm, "--lift-mm", -2000.0, 2000.0)
    arm = load_robot(robot)
    declared = Declared(registration_frame, registration_direction, taken_at, registration_residual_mm)
    placed = load_placed(registration, declared)
    now, skew_s = datetime.now(UTC), Site().clock_skew_s
    reading = Reading(cutcom_is_tool_centre, rotary, arc_tolerance_mm, axis_tolerance_deg)
    wanted = load_plan(plan, reading=reading)
    prepared = prepare(wanted, placed, arm.value, now=now, clock_skew_s=skew_s)
    problem = off_line_problem(prepared.path, prepared.robot)
    if canonical(problem)[0].workspace.empty:
        raise InputError(
            robot, "limits", None, "a workspace: the limits leave none", "correct limits or offsets"
        )
    work = Work(problem, prepared.path.feed_mm_s, prepared.path.tool_length_mm)
    begun = None
    if lifts is None:
        with working("looking for the height to begin with"):
            begun = reach.start(problem, work.quantise)
        lifts = (begun.lift_mm,)
    if yaws is None:
        yaws = tuple(sorted({0.0, begun.yaw_deg if begun else 0.0}))
    grid = reach.grid_of(problem, step_mm, yaws, lifts)
    if not (len(grid) <= POSITIONS_MAX):
        bound = f"{len(grid)} positions, at most {POSITIONS_MAX}: take longer steps or fewer turns and lifts"
        raise typer.BadParameter(bound, param_hint="--step-mm")
    files = files_for(out, json=json)
    with workers_for(work, cores or os.cpu_count() or 1) as workers:
        with _progress(len(grid), f"judging what lies about {len(grid)} positions of the bone") as done:
            cells = squares(work, workers, grid, done)
        with _progress(len(grid), f"judging {len(grid)} positions of the bone") as done:
            found = positions(work, workers, grid, cells, done)
    document = reach.reach_document(problem, grid, found, _made_for(prepared, arm.value), begun)
    with working("drawing the map"):
        save(files, problem, document, found)
    if json:
        echo(document_text(document))
    else:
        _summary(document, found.positions, files)


def _summary(document: dict[str, Any], positions: list[Position], files: dict[str, Path]) -> None:
    """The answer in a few lines: how much room there is, and where most of it."""
    console, counts = output(), document["counts"]
    lifts = document["grid"]["lift_mm"]
    for lift in lifts if len(lifts) == 1 else ():
        console.print(f"Map at lift {signed(lift)} mm: {height(document, lift)}.")
    if chosen := document["guidance"]:
        x, y, z = (signed(value) for value in chosen["translation_mm"])
        yaw = f"yaw {signed(chosen['yaw_deg'])} deg, " if chosen["yaw_deg"] else ""
        console.print(
            f"Where the bone stands now it is inadmissible; guidance moves it: {yaw}x {x}  y {y}  lift {z} mm."
        )
    console.print(
        f"{counts['admissible']} of {counts['positions']} positions are admissible, each of them proved; "
        f"{counts['excluded_by_a_pose']} are excluded by one pose alone."
    )
    console.print(between(document))
    here = next((p for p in positions if not (p.x_mm or p.y_mm or p.yaw_deg or p.lift_mm)), None)
    if here is not None:
        verdict = "admissible" if here.admissible else "inadmissible"
        console.print(f"Where the bone stands now it is {verdict}; tightest there is {_tightest(here)}.")
    good = [p for p in positions if p.admissible and p.ratio is not None]
    if good:
        near = min(good, key=_farness)
        best = max(good, key=lambda p: (round(p.ratio or 0.0, 3), *(-v for v in _farness(p))))
        for label, p in (("Most room:", best), ("Nearest:  ", near)):
            console.print(
                Text(
                    f"{label} yaw {p.yaw_deg:+g} deg, move x {p.x_mm:+g}  y {p.y_mm:+g}  lift {p.lift_mm:+g} mm; "
                    f"tightest there is {_tightest(p)}"
                )
            )
        console.print("A moved bone needs a new registration, which is verified anew.")
    else:
        limits = sorted({p.limiting for p in positions})
        console.print(f"None is admissible; what limits: {', '.join(limits)}.")
        if chosen:
            console.print("The move that guidance chooses lies between them: take a shorter --step-mm.")
    for path in files.values():
        console.print(printable(f"Written: {path}"), soft_wrap=True)


def _farness(p: Position) -> tuple[float, float]:
    """How far the bone is moved, mm, then how far it is turned, deg."""
    return math.hypot(p.x_mm, p.y_mm, p.lift_mm), abs(p.yaw_deg)


def _tightest(p: Position) -> str:
    value = "undefined" if p.clearance is None else f"{p.clearance:.2f} {p.unit}"
    return f"{p.limiting}, {value} with {p.bound:g} {p.unit} {'allowed' if p.limiting.startswith(reach.RATES) else 'required'}"


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("reach")(reach_command)
