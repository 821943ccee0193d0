"""``cutgate verify``: off-line verification of a plan or tool path."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from cutgate.config.load import BYTES_PER_MB, PRESETS, InputError, load_robot, load_site
from cutgate.config.model import Site
from cutgate.config.records import calibration_record, limits_record
from cutgate.config.screen import printable
from cutgate.protocol.records import digest
from cutgate.runtime.commands.registration_options import (
    DirectionOption,
    FrameOption,
    ResidualOption,
    TakenAtOption,
    how_read,
)
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.commands.tool_path_options import (
    ArcToleranceOption,
    AxisToleranceOption,
    CutcomOption,
    RotaryOption,
)
from cutgate.runtime.commands.tool_path_view import facts as tool_path_facts
from cutgate.runtime.commands.tool_path_view import title, whole, with_tool_path
from cutgate.runtime.commands.verdict_view import (
    check_point_facts,
    print_cautions,
    print_end,
    print_other_elbow,
    print_tolerated,
    print_verdict,
    where_facts,
)
from cutgate.runtime.commands.verify_plot import PlotOption, save_plots
from cutgate.runtime.plan.load import PLANS, load_placed, load_plans, single_tool
from cutgate.runtime.plan.prepare import Prepared, prepare, with_branch
from cutgate.runtime.plan.registration import checked as checked_points
from cutgate.runtime.plan.registrations.declared import NOTHING, Declared
from cutgate.runtime.plan.toolpath.model import ARC_TOLERANCE_MM, AXIS_TOLERANCE_DEG, PLAIN, Reading, Told
from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.asked import BEST, AskedTurns, in_branch
from cutgate.runtime.verification.certificate import certify
from cutgate.runtime.verification.placing.guidance import guide
from cutgate.runtime.verification.placing.other_elbow import other_elbow
from cutgate.runtime.verification.placing.tolerated import tolerated
from cutgate.runtime.verification.plausibility import (
    Caution,
    Placed,
    cautions,
    cautions_of_move,
    described,
    extent,
    place,
)
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import off_line_problem
from cutgate.runtime.verification.report.document import Digests, document_text, verdict_document
from cutgate.runtime.verification.verdict import Verdict

ADMISSIBLE, INADMISSIBLE = 0, 1

PLAN_HELP = f"Plan (.json), tool path (CSV, APT/CL, G-code) or example ({', '.join(PLANS.names)})."
ROBOT_HELP = f"robot.toml or preset ({', '.join(PRESETS.names)})"
REGISTRATION_HELP = (
    "Where the bone stands: registration.json, an example's, or another program's (.tfm, .h5, .txt, .mat)"
)

PathArgument = Annotated[Path, typer.Argument(metavar="PATH", help=PLAN_HELP)]
RobotOption = Annotated[Path, typer.Option(help=f"The robot's description: {ROBOT_HELP}.")]
RegistrationOption = Annotated[Path | None, typer.Option(help=f"{REGISTRATION_HELP}; identity if left out.")]
ToolOption = Annotated[
    float | None, typer.Option(min=0.0, max=2000.0, help="Replaces the robot's tool length.")
]
FeedOption = Annotated[
    float | None, typer.Option(min=0.001, max=10_000.0, help="Feed where the file has none (default 10).")
]


Q0TurnsOption = Annotated[
    int | None,
    typer.Option(
        min=-100,
        max=100,
        help="Whole turns of the shoulder at the first pose; the best are chosen if left out.",
    ),
]
RollTurnsOption = Annotated[int | None, typer.Option(min=-100, max=100, help="Likewise of the roll.")]


class Method(StrEnum):
    """How to decide; the gate uses ``certified``."""

    certified = "certified"
    stocco = "stocco"


@dataclass(frozen=True, slots=True)
class Checked:
    """A verdict and what it was made for."""

    problem: Problem
    verdict: Verdict
    digests: Digests
    poses: int
    elapsed_ms: float


def check(prepared: Prepared, method: Method = Method.certified, asked: AskedTurns = BEST) -> Checked:
    """Verifies off-line exactly what the controller would be given.

    Args:
        prepared: the quantised path, and the robot with its limits, calibration and deadband.
        method: which verifier decides.
        asked: the turns of the joint branch, where not the best are to be taken.

    Raises:
        InputError: the path does not fit in the turns asked for.
    """
    robot = prepared.robot
    limits, calibration = limits_record(robot).body(), calibration_record(robot).body()
    problem = in_branch(off_line_problem(prepared.path, robot), asked)
    decide = certified.verify if method is Method.certified else stocco.verify
    with working(f"verifying {len(prepared.path)} poses"):
        began = time.perf_counter()
        verdict = decide(problem)
        elapsed_ms = (time.perf_counter() - began) * 1000.0
    branch = verdict.branch
    path = with_branch(prepared.path, branch.q0_turns, branch.roll_turns) if branch else prepared.path
    digests = Digests(path.digest, digest(limits), digest(calibration), prepared.registration_digest)
    return Checked(problem, verdict, digests, len(path), elapsed_ms)


def read(
    path: Path,
    robot: Path,
    registration: Path | None,
    tool_length_mm: float | None,
    feed_mm_s: float | None,
    site: Site | None = None,
    *,
    reading: Reading = PLAIN,
    declared: Declared = NOTHING,
    told: Told | None = None,
) -> tuple[Prepared, ...]:
    """Reads the files and prepares the paths that the controller would be given, one for each tool of a tool path.

    Raises:
        InputError: a file that cannot be used.
    """
    with nullcontext() if told else working(f"reading {path}"):
        arm = load_robot(robot).value
        settings = site or Site()
        bounds = settings.files
        plans = load_plans(
            path,
            size_limit=bounds.file_size_limit_mb * BYTES_PER_MB,
            pose_limit=bounds.pose_limit,
            reading=reading,
            told=told,
        )
        placed = load_placed(registration, declared)
        return tuple(
            prepare(
                plan,
                placed,
                arm,
                now=datetime.now(UTC),
                clock_skew_s=settings.clock_skew_s,
                tool_length_mm=tool_length_mm,
                feed_mm_s=feed_mm_s,
            )
            for plan in plans
        )


def one(prepared: tuple[Prepared, ...]) -> Prepared:
    """The only one.

    Raises:
        InputError: the file has several tools.
    """
    single_tool(prepared[0].plan.path, [ready.plan.value for ready in prepared])
    return prepared[0]


def _write_proof(file: Path, problem: Problem, verdict: Verdict) -> None:
    """Writes the certificate of an admissible verdict; says so where there is none."""
    proof = certify(problem, verdict)
    if proof is None:
        echo(f"{printable(str(file))}: not written, only an admissible verdict has a proof", err=True)
        return
    try:
        file.write_bytes(proof.body())
    except OSError as error:
        raise InputError(
            file, "", None, f"cannot be written: {error.strerror}", "name another file"
        ) from None
    echo(
        f"{printable(str(file))}: proof of {len(proof.body())} bytes, check it with `cutgate recheck`",
        err=True,
    )


def _placed(prepared: Prepared, site: Site) -> Placed | None:
    """How the bone was registered, and what the site asks of that."""
    if prepared.registration is None:
        return None
    value, most_mm = prepared.registration.value, site.registration_max_residual_mm
    return Placed(value.matrix, value.residual_rms_mm, most_mm, checked_points(value, site))


@dataclass(frozen=True, slots=True)
class _Judged:
    """One tool's path with its verdict, and what looks wrong with it."""

    prepared: Prepared
    checked: Checked
    placed: Placed | None
    cautions: tuple[Caution, ...]

    @classmethod
    def of(cls, prepared: Prepared, method: Method, asked: AskedTurns, settings: Site) -> "_Judged":
        checked, placed = check(prepared, method, asked), _placed(prepared, settings)
        return cls(prepared, checked, placed, cautions(checked.problem, checked.verdict, placed))


def _document(judged: _Judged, guidance: Guidance | None) -> dict[str, Any]:
    """The verdict's document, with where the cut lies and what looks wrong."""
    checked = judged.checked
    problem, verdict = checked.problem, checked.verdict
    document = verdict_document(
        verdict,
        poses=checked.poses,
        guidance=guidance,
        digests=checked.digests,
        elapsed_ms=checked.elapsed_ms,
        other_elbow=other_elbow(problem, verdict),
    )
    found = (*judged.cautions, *cautions_of_move(guidance))
    known = described(document, problem, verdict, found, judged.placed)
    error = tolerated(problem, verdict)
    known["registration_error"] = None if error is None else asdict(error)
    return with_tool_path(known, problem, judged.prepared.plan.value.cut)


def _guidance(judged: _Judged) -> Guidance | None:
    """How to move the bone, where the certified method does not admit the path."""
    checked = judged.checked
    if checked.verdict.admissible or checked.verdict.method != Method.certified:
        return None
    with working("looking for the smallest move of the bone"):
        return guide(checked.problem, checked.verdict, judged.prepared.quantise)


def verify(
    path: PathArgument,
    *,
    robot: RobotOption,
    registration: RegistrationOption = None,
    tool_length_mm: ToolOption = None,
    feed_mm_s: FeedOption = None,
    site: Annotated[
        Path | None,
        typer.Option(help="site.toml: how large the files may be, and what is asked of the registration."),
    ] = None,
    q0_turns: Q0TurnsOption = None,
    roll_turns: RollTurnsOption = None,
    cutcom_is_tool_centre: CutcomOption = False,
    rotary: RotaryOption = None,
    arc_tolerance_mm: ArcToleranceOption = ARC_TOLERANCE_MM,
    axis_tolerance_deg: AxisToleranceOption = AXIS_TOLERANCE_DEG,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print what was understood of a tool path, line by line, first.")
    ] = False,
    certificate: Annotated[
        Path | None, typer.Option(help="Write the proof of an admissible verdict here; see `recheck`.")
    ] = None,
    plot: PlotOption = None,
    registration_frame: FrameOption = None,
    registration_direction: DirectionOption = None,
    taken_at: TakenAtOption = None,
    registration_residual_mm: ResidualOption = None,
    method: Annotated[Method, typer.Option(help="The gate uses certified.")] = Method.certified,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show the digests and every worst place as well.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Check off-line whether a whole cut path keeps its distance from every limit of the robot.

    Exit code: 0 admissible, 1 inadmissible, 2 refused input.
    """
    if certificate is not None and method is not Method.certified:
        raise typer.BadParameter(
            "the published march proves nothing between its steps; use --method certified"
        )
    if explain and json:
        raise typer.BadParameter("one JSON document leaves no room for --explain")
    settings = load_site(site).value if site else Site()
    declared = Declared(registration_frame, registration_direction, taken_at, registration_residual_mm)
    reading = Reading(cutcom_is_tool_centre, rotary, arc_tolerance_mm, axis_tolerance_deg)
    told = _explain if explain else None
    tools = read(
        path,
        robot,
        registration,
        tool_length_mm,
        feed_mm_s,
        settings,
        reading=reading,
        declared=declared,
        told=told,
    )
    if certificate is not None or plot:
        one(tools)
    asked = AskedTurns(q0_turns, roll_turns)
    judged = [_Judged.of(prepared, method, asked, settings) for prepared in tools]
    if certificate is not None:
        _write_proof(certificate, judged[0].checked.problem, judged[0].checked.verdict)
    if json:
        guides = [_guidance(each) for each in judged]
        found = [_document(each, guidance) for each, guidance in zip(judged, guides, strict=True)]
        echo(document_text(whole(found)))
    else:
        guides = _print(judged, verbose=verbose)
    if plot:
        save_plots(plot, judged[0].checked.problem, judged[0].checked.verdict, guides[0], judged[0].prepared)
    admissible = all(each.checked.verdict.admissible for each in judged)
    raise typer.Exit(ADMISSIBLE if admissible else INADMISSIBLE)


def _explain(line: int, text: str) -> None:
    """One line of a tool path file, as it was understood."""
    echo(f"line {line}: {printable(text)}")


def _print(judged: Sequence[_Judged], *, verbose: bool) -> list[Guidance | None]:
    """Each tool's verdict, under a title where there are several; then how many are admissible. Where to move the bone for each."""
    console, count, guides = output(), len(judged), []
    for number, each in enumerate(judged, start=1):
        if count > 1:
            console.rule(printable(title(each.prepared.plan.value.cut, number, count)), align="left")
        guides.append(_print_one(console, each, verbose=verbose))
    if count > 1:
        good = sum(each.checked.verdict.admissible for each in judged)
        console.rule(align="left")
        console.print(
            f"{good} of {count} tools' paths are admissible; `cutgate run` takes a path of one tool."
        )
    return guides


def _print_one(console: Console, each: _Judged, *, verbose: bool) -> Guidance | None:
    checked, verdict = each.checked, each.checked.verdict
    facts = _facts(each.prepared, checked, each.placed, every_place=verbose)
    print_verdict(console, verdict, checked.digests, facts, hashes=verbose)
    print_cautions(console, each.cautions)
    print_tolerated(console, tolerated(checked.problem, verdict))
    print_other_elbow(console, other_elbow(checked.problem, verdict))
    guidance = _guidance(each)
    print_cautions(console, cautions_of_move(guidance))
    print_end(console, verdict, guidance)
    return guidance


def _facts(
    prepared: Prepared, checked: Checked, placed: Placed | None, *, every_place: bool
) -> dict[str, str]:
    """What was verified, for the reader."""
    plan, registration, path = prepared.plan, prepared.registration, prepared.path
    facts = {
        "plan": f"{plan.value.id} ({plan.path})",
        "cut": f"{checked.poses} poses, feed {path.feed_mm_s:g} mm/s, tool {path.tool_length_mm:g} mm",
        "registration": f"{registration.value.id} ({registration.path})"
        if registration
        else "none given: identity",
    }
    if how := how_read(registration):
        facts["read as"] = how
    if placed:
        facts["CT"] = f"{prepared.ct_link}; registration residual {placed.residual_mm:g} mm rms"
        facts |= check_point_facts(placed.check_points)
    if plan.value.cut is not None:
        facts |= tool_path_facts(checked.problem, plan.value.cut, path.feed_mm_s)
    tips = {name: place(checked.problem, boundary) for name, boundary in checked.verdict.boundaries.items()}
    facts |= where_facts(asdict(extent(checked.problem)), checked.verdict, tips, every_place=every_place)
    return facts | {"elapsed": f"{checked.elapsed_ms:.1f} ms"}


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("verify")(verify)
