"""``cutgate reach``: a map of where the bone could stand."""

import csv
import io
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from cutgate.config.load import InputError, load_robot
from cutgate.config.model import Robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.config.screen import printable
from cutgate.protocol import records
from cutgate.runtime.arrays import Floats, Vector
from cutgate.runtime.commands.reach_page import page
from cutgate.runtime.commands.reach_picture import height, picture, signed
from cutgate.runtime.commands.screen import echo, messages, output, working
from cutgate.runtime.commands.verify import PLAN_HELP, RegistrationOption, RobotOption
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import Prepared, prepare
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.bounds.geometry import canonical
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.guidance import Quantise
from cutgate.runtime.verification.placing.reach import Grid, Position
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.report.document import document_text
from cutgate.runtime.verification.verdict import Boundary

POSITIONS_MAX: Final = 400_000
VALUES_MAX: Final = 73
CHUNK: Final = 32
"""Positions judged in one go, a fraction of a second: what the progress bar moves by."""
KINDS: Final = (".png", ".html", ".csv", ".json")
DRAWN_BY: Final = {".png": "matplotlib"}
"""Not installed with cutgate alone: nobody draws beside a controller. The page draws itself."""


@dataclass(frozen=True, slots=True)
class Work:
    """What every worker knows: the path where the bone stands, and how it is quantised."""

    problem: Problem
    feed_mm_s: float
    tool_length_mm: float

    def quantise(self, tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """What the wire does to poses."""
        path = records.Path.quantised(
            tips_mm,
            axes,
            feed_mm_s=self.feed_mm_s,
            tool_length_mm=self.tool_length_mm,
            elbow=self.problem.arm.elbow,
        )
        return path.tips_mm, path.axes

    def judge(self, yaw_deg: float, translations_mm: list[Vector]) -> list[Position]:
        """Positions by the certified method."""
        quantise: Quantise = self.quantise
        return [reach.judged(self.problem, quantise, yaw_deg, t) for t in translations_mm]


def survey(work: Work, grid: Grid, cores: int, done: Callable[[int], None]) -> list[Position]:
    """Judges every position of a grid, in the order yaw, lift, y, x.

    Args:
        work: the path.
        grid: the positions.
        cores: how many processes; with one, this one.
        done: told how many positions are judged since the last call.
    """
    unrecoverable = reach.unrecoverable(work.problem, certified.verify(work.problem))
    if unrecoverable is not None:
        return [_unrecoverable(unrecoverable, *where) for where in _everywhere(grid)]
    found: list[Position | Vector] = []
    chunks: list[tuple[list[int], float, list[Vector]]] = []
    for yaw in grid.yaw_deg:
        for lift in grid.lift_mm:
            layer = reach.excluded(work.problem, grid, yaw, lift)
            open_ = [i for i, item in enumerate(layer) if isinstance(item, tuple)]
            for k in range(0, len(open_), CHUNK):
                part = open_[k : k + CHUNK]
                places = [item for i in part if isinstance(item := layer[i], tuple)]
                chunks.append(([len(found) + i for i in part], yaw, places))
            found += layer
            done(len(layer) - len(open_))
    for numbers, positions in _judged(work, chunks, cores):
        for i, position in zip(numbers, positions, strict=True):
            found[i] = position
        done(len(numbers))
    return [item for item in found if isinstance(item, Position)]


def _everywhere(grid: Grid) -> Iterator[tuple[float, float, float, float]]:
    for yaw in grid.yaw_deg:
        for lift in grid.lift_mm:
            yield from ((x, y, yaw, lift) for y in grid.y_mm for x in grid.x_mm)


def _unrecoverable(b: Boundary, x: float, y: float, yaw: float, lift: float) -> Position:
    ratio = None if b.certified is None else b.certified / b.deadband
    return Position(x, y, yaw, lift, False, "pose", b.name, b.unit, b.certified, b.deadband, ratio)


def _judged(
    work: Work, chunks: list[tuple[list[int], float, list[Vector]]], cores: int
) -> Iterator[tuple[list[int], list[Position]]]:
    """Each chunk's numbers and positions, in the order in which they are ready."""
    if cores == 1 or len(chunks) < 2:
        for numbers, yaw, places in chunks:
            yield numbers, work.judge(yaw, places)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(cores, len(chunks)), context, _begin, (work,))
    try:
        with _held_back(signal.SIGINT):  # the workers inherit it: Ctrl-C is this process's to handle
            waiting: dict[Future[list[Position]], list[int]] = {
                pool.submit(_judge, yaw, places): numbers for numbers, yaw, places in chunks
            }
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    except BaseException:  # Ctrl-C or a failure: what the workers still do is of no use
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_WORK: list[Work] = []


def _begin(work: Work) -> None:
    """In a worker: keeps the path."""
    _WORK.append(work)


@contextmanager
def _held_back(number: signal.Signals) -> Iterator[None]:
    """A signal that arrives meanwhile is delivered afterwards; processes started meanwhile never get it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _judge(yaw_deg: float, translations_mm: list[Vector]) -> list[Position]:
    return _WORK[0].judge(yaw_deg, translations_mm)


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


def _files(out: Path | None, *, json: bool) -> dict[str, Path]:
    """What to write where, by kind: one file, a folder of all four, or nothing.

    Raises:
        InputError: a folder that cannot be made, or a picture that nothing here can draw.
    """
    if out is None:
        if json:
            return {}
        out = Path("cutgate-reach")
    if out.suffix.lower() in KINDS:
        folder, files = out.parent, {out.suffix.lower(): out}
    else:
        folder, files = out, {kind: out / f"reach{kind}" for kind in KINDS}
    if missing := sorted(DRAWN_BY[kind] for kind in DRAWN_BY.keys() & files if not find_spec(DRAWN_BY[kind])):
        raise InputError(
            out,
            "--out",
            None,
            f"needs {' and '.join(missing)}, not installed here",
            "pip install 'cutgate[pictures]', or ask for what needs none: --out FILE.html, FILE.csv or FILE.json, or --json",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            folder, "--out", None, f"cannot be made ({error.strerror})", "name another"
        ) from None
    return files


def _write(path: Path, content: bytes) -> None:
    """Writes a whole file or none: beside it first, then into its place."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    except OSError as error:
        raise InputError(
            path, "--out", None, f"cannot be written ({error.strerror})", "name another"
        ) from None
    finally:
        beside.unlink(missing_ok=True)


def table(positions: list[Position]) -> str:
    """All positions as CSV; undefined values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(reach.COLUMNS)
    writer.writerows(
        ("" if v is None else int(v) if isinstance(v, bool) else v for v in astuple(p)) for p in positions
    )
    return text.getvalue()


def _problem(prepared: Prepared, robot: Robot) -> Problem:
    """The verification problem where the bone stands now, any branch."""
    limits, calibration = limits_record(robot).body(), calibration_record(robot).body()
    tool = tool_record(robot, prepared.path.tool_length_mm).body()
    return problem_from_records(prepared.path.body(), limits, calibration, tool, robot, any_branch=True)


def _made_for(prepared: Prepared, robot: Robot) -> dict[str, Any]:
    placed = prepared.registration
    return {
        "plan": prepared.plan.value.id,
        "robot": robot.name,
        "elbow": robot.elbow,
        "registration": placed.value.id if placed else None,
        "path_sha256": prepared.path.digest.hex(),
        "registration_sha256": prepared.registration_sha256.hex(),
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
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for reach.png, .html, .csv and .json, or one file of these kinds."),
    ] = None,
    cores: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes; all cores if left out.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Map where the bone could stand so that the whole cut path keeps its distance from every limit.

    Exit code: 0 map made, 2 refused input.
    """
    yaws = None if yaw_deg is None else _values(yaw_deg, "--yaw-deg", -180.0, 180.0)
    lifts = None if lift_mm is None else _values(lift_mm, "--lift-mm", -2000.0, 2000.0)
    arm = load_robot(robot)
    placed = load_registration(registration) if registration else None
    prepared = prepare(load_plan(plan), placed, arm.value, now=datetime.now(UTC))
    problem = _problem(prepared, arm.value)
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
    files = _files(out, json=json)
    with _progress(len(grid), f"judging {len(grid)} positions of the bone") as done:
        positions = survey(work, grid, cores or os.cpu_count() or 1, done)
    document = reach.reach_document(problem, grid, positions, _made_for(prepared, arm.value), begun)
    with working("drawing the map"):
        _save(files, problem, document, positions)
    if json:
        echo(document_text(document))
    else:
        _summary(document, positions, files)


def _save(
    files: dict[str, Path], problem: Problem, document: dict[str, Any], positions: list[Position]
) -> None:
    """Writes the files asked for."""
    arcs = list(reach.outline(problem))
    makers: dict[str, Callable[[], bytes]] = {
        ".png": lambda: picture(document, positions, arcs),
        ".html": lambda: page(document, positions, arcs).encode(),
        ".csv": lambda: table(positions).encode(),
        ".json": (document_text(document) + "\n").encode,
    }
    for kind, path in files.items():
        _write(path, makers[kind]())


def _summary(document: dict[str, Any], positions: list[Position], files: dict[str, Path]) -> None:
    """The answer in a few lines: how much room there is, and where most of it."""
    console, counts = output(), document["counts"]
    lifts = document["grid"]["lift_mm"]
    for lift in lifts if len(lifts) == 1 else ():
        console.print(f"Map at lift {signed(lift)} mm: {height(document, lift)}.")
    if chosen := document["guidance"]:
        x, y, z = (signed(value) for value in chosen["translation_mm"])
        turn = f"yaw {signed(chosen['yaw_deg'])} deg, " if chosen["yaw_deg"] else ""
        console.print(
            f"Where the bone stands now it is inadmissible; guidance moves it: {turn}x {x}  y {y}  lift {z} mm."
        )
    console.print(
        f"{counts['admissible']} of {counts['positions']} positions are admissible, each by the certified method; "
        f"{counts['excluded_by_a_pose']} are excluded by one pose alone."
    )
    here = next((p for p in positions if not (p.x_mm or p.y_mm or p.yaw_deg or p.lift_mm)), None)
    if here is not None:
        word = "admissible" if here.admissible else "inadmissible"
        console.print(f"Where the bone stands now it is {word}; tightest there is {_tightest(here)}.")
    good = [p for p in positions if p.admissible and p.ratio is not None]
    if good:
        near = min(good, key=_farness)
        best = max(good, key=lambda p: (round(p.ratio or 0.0, 3), *(-v for v in _farness(p))))
        for word, p in (("Most room:", best), ("Nearest:  ", near)):
            console.print(
                Text(
                    f"{word} yaw {p.yaw_deg:+g} deg, move x {p.x_mm:+g}  y {p.y_mm:+g}  lift {p.lift_mm:+g} mm; "
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
