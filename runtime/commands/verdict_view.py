"""A verdict for people: the answer in one line, every boundary, the speeds, and how to move the bone."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from cutgate.config.screen import printable
from cutgate.runtime.commands.tables import Fitting
from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual
from cutgate.runtime.verification.advice import Guidance, Move, OtherElbow
from cutgate.runtime.verification.placing.tolerated import Tolerated
from cutgate.runtime.verification.plausibility import Caution
from cutgate.runtime.verification.report.document import Digests
from cutgate.runtime.verification.report.summary import summary, worst
from cutgate.runtime.verification.verdict import Verdict

MEANING: Final = {
    "inner": "reach, near",
    "outer": "reach, far",
    "left": "q0 upper",
    "right": "q0 lower",
    "top": "slide upper",
    "bottom": "slide lower",
    "roll_min": "q3 lower",
    "roll_max": "q3 upper",
    "pitch_min": "q4 lower",
    "pitch_max": "q4 upper",
    "wrist_singularity": "tool vertical",
}
PLACE: Final = ("at segment", "path mm")
JOINT_UNIT: Final = ("rad/s", "rad/s", "mm/s", "rad/s", "rad/s")
METHOD: Final = {"certified": "certified", "stocco": "stocco (for comparison, never the gate)"}
GOOD: Final = "bold green"
BAD: Final = "bold red"
WARNED: Final = "bold yellow"


def print_verdict(
    console: Console, verdict: Verdict, digests: Digests, facts: dict[str, str], *, hashes: bool = False
) -> None:
    """Prints everything about one verdict but how to move the bone (`print_end`), which takes longer to find.

    Args:
        console: where to.
        verdict: the answer.
        digests: what the verdict was made for.
        facts: further lines, label and value, for example the plan and the registration.
        hashes: whether the digests are shown.
    """
    console.print(headline(verdict))
    parts: list[RenderableType] = [boundaries_table(verdict)]
    if verdict.speed:
        parts.append(speed_table(verdict))
    if verdict.reasons:
        parts.append(reason_lines(verdict))
    parts.append(facts_table({**_path_facts(verdict), **facts, **(_digest_facts(digests) if hashes else {})}))
    for part in parts:
        console.print()
        console.print(part)
    console.file.flush()


def print_cautions(console: Console, found: Sequence[Caution]) -> None:
    """Prints what looks wrong, before anybody acts on the rest."""
    for caution in found:
        console.print()
        console.print(caution_line(caution))


def caution_line(caution: Caution) -> Text:
    """One warning, and whether it keeps from a permit."""
    asked = f" (before a permit: confirm {caution.code})" if caution.confirm else ""
    return Text.assemble(("WARNING", WARNED), f" {caution.code}: {printable(caution.text)}{asked}")


def print_tolerated(console: Console, found: Tolerated | None) -> None:
    """Prints what error of the registration an admitted path tolerates, where that is proved."""
    if found is not None:
        console.print()
        console.print(Text(found.text))


def print_other_elbow(console: Console, found: OtherElbow | None) -> None:
    """Prints what the other elbow would say, where that was asked: before any move of the bone."""
    if found is not None:
        console.print()
        console.print(Text(f"Other elbow: {found.text}"))


def print_end(console: Console, verdict: Verdict, guidance: Guidance | None) -> None:
    """Prints how to move the bone, where it is known; and last the answer and the move: what a screen still shows.

    The first line cannot have the move: an answer does not wait until one is found.
    """
    if guidance is not None:
        console.print()
        console.print(guidance_lines(guidance))
    console.print()
    console.print(headline(verdict))
    if guidance is not None and guidance.translation_mm is not None:
        for line in _combined_move(guidance, guidance.translation_mm):
            console.print(line)


def headline(verdict: Verdict) -> Text:
    """The answer, in one line, and what decided it."""
    verdict_text, style = ("ADMISSIBLE", GOOD) if verdict.admissible else ("INADMISSIBLE", BAD)
    return Text.assemble((verdict_text, style), f": {summary(verdict)}")


def boundaries_table(verdict: Verdict) -> RenderableType:
    """Every boundary's worst place on the whole path."""
    values = ("certified", "clearance", "deadband", "margin")
    rows: list[list[str | Text]] = []
    for boundary in verdict.boundaries.values():
        margin = None if boundary.certified is None else boundary.certified - boundary.deadband
        style = BAD if boundary.violated else GOOD
        rows.append(
            [
                Text(boundary.name, style=style),
                MEANING[boundary.name],
                _value(boundary.certified),
                _value(boundary.clearance),
                f"{boundary.deadband:.3f}",
                Text(_value(margin), style=style),
                boundary.unit,
                _value(boundary.segment, digits=0),
                _value(boundary.tip_length_mm, digits=1),
            ]
        )
    return Fitting(
        ("boundary", "limit", *values, "", *PLACE),
        rows,
        (*values, *PLACE),
        dispensable=("limit", "clearance"),
    )


def speed_table(verdict: Verdict) -> RenderableType:
    """Each joint's largest speed and, where limited, acceleration at the planned feed."""
    rows: list[list[str | Text]] = []
    for line in (*verdict.speed, *verdict.acceleration):
        state = "ok" if line.ok else "undefined" if line.peak is None else "too high"
        rows.append(
            [
                f"q{line.joint}",
                line.quantity,
                Text(state, style=GOOD if line.ok else BAD),
                _value(line.peak),
                f"{line.limit:.3f}",
                JOINT_UNIT[line.joint] + ("2" if line.quantity == "acceleration" else ""),
                _value(line.segment, digits=0),
            ]
        )
    columns = ("joint", "", "at the feed", "peak", "limit", "", PLACE[0])
    return Fitting(columns, rows, ("peak", "limit", PLACE[0]), dispensable=(PLACE[0],))


def reason_lines(verdict: Verdict) -> RenderableType:
    """The verifier's own sentences, each with a hanging indent."""
    table = Table.grid(padding=(0, 1, 0, 0))
    for reason in verdict.reasons:
        table.add_row("  -", reason)
    return Group(Text("Reasons", style="bold"), table)


def guidance_lines(guidance: Guidance) -> RenderableType:
    """How to move the bone: the combined move first, then each boundary's own hint."""
    lines: list[RenderableType] = [Text("How to move the bone (robot frame, z up)", style="bold")]
    if guidance.translation_mm is None:
        proved = "No translation of the bone cures this path" + (
            ": proved." if guidance.none_possible else ", none was found."
        )
        lines.append(Text(f"  {proved}", style=BAD))
    else:
        lines += _combined_move(guidance, guidance.translation_mm)
    sentences = Table.grid(padding=(0, 1, 0, 0))
    for part in guidance.text.split("; "):
        sentences.add_row("  -", f"{part[:1].upper()}{part[1:]}.")
    lines.append(sentences)
    if guidance.moves:
        lines.append(Text("  For each violated boundary's worst place alone (a hint, not verified):"))
        lines += [Text(f"    {_move(move)}") for move in guidance.moves]
    return Group(*lines)


def _combined_move(guidance: Guidance, translation_mm: tuple[float, float, float]) -> list[RenderableType]:
    """What to do with the bone, in the order in which it is to be done."""
    x, y, z = translation_mm
    move = (f"x {x:+.1f}  y {y:+.1f}  z {z:+.1f} mm", "bold")
    lines: list[RenderableType] = []
    if guidance.yaw_deg:
        sense = "counter-clockwise" if guidance.yaw_deg > 0.0 else "clockwise"
        px, py, _ = guidance.pivot_mm
        turn = (f"{guidance.yaw_deg:+.1f} deg", "bold")
        lines.append(
            Text.assemble(
                "  First turn it by ", turn, f" ({sense} seen from above) about the vertical through "
                f"x {px:.1f}  y {py:.1f} mm, without tilting it."
            )
        )  # fmt: skip
    clearance = guidance.predicted_clearance_mm
    lines.append(
        Text.assemble(
            "  Then move it " if guidance.yaw_deg else "  Move it ", move, f" ({math.hypot(x, y, z):.1f} mm): ",
            ("verified", GOOD) if guidance.verified else ("not verified", BAD),
            "" if clearance is None else f", smallest clearance then {clearance:.2f} mm",
        )
    )  # fmt: skip
    return lines


def _move(move: Move) -> str:
    """One boundary's hint as a sentence."""
    direction = "({:+.2f}, {:+.2f}, {:+.2f})".format(*move.direction)
    if move.kind == "turn":
        return f"{move.boundary}: turn by {_value(move.angle_deg)} deg about the axis {direction}"
    return f"{move.boundary}: move by {_value(move.distance_mm)} mm along {direction}"


def _path_facts(verdict: Verdict) -> dict[str, str]:
    """What was measured on the path, and how."""
    branch = verdict.branch
    turns = (
        f"{branch.elbow} elbow, q0 turns {branch.q0_turns}, roll turns {branch.roll_turns}"
        if branch
        else "none"
    )
    others = [f"{one.joint} {one.feasible}" for one in verdict.windings if one.first < one.last]
    if others:
        turns += f"; turns in which the path fits: {', '.join(others)}"
    evaluations = verdict.evaluations
    least = "at most" if evaluations.best_case is None else f"{evaluations.best_case} to"
    return {
        "path length": f"tip {verdict.tip_length_mm:.1f} mm, wrist centre {verdict.wrist_length_mm:.1f} mm, "
        f"tool axis {math.degrees(verdict.axis_angle_rad):.1f} deg",
        "joint branch": turns,
        "method": f"{METHOD[verdict.method]}: {evaluations.arm} arm and {evaluations.wrist} wrist evaluations of "
        f"{least} {evaluations.worst_case}",
    }


def where_facts(
    where: Mapping[str, Sequence[float]],
    verdict: Verdict,
    tips_mm: Mapping[str, Sequence[float] | None],
    *,
    every_place: bool = False,
) -> dict[str, str]:
    """Where the cut lies, in the robot frame: its box, entry, tilt, and the tip at what decided, or at every worst place.

    Args:
        where: as `Extent` has it.
        verdict: what was found.
        tips_mm: of each boundary's worst place; None where it has none.
        every_place: of boundaries that decided nothing as well.
    """
    shown = tuple(verdict.boundaries.values()) if every_place else worst(verdict)
    places = {b.name: _xyz(tip) for b in shown if (tip := tips_mm[b.name]) is not None}
    size_mm = math.dist(where["min_mm"], where["max_mm"])
    least, largest = where["tilt_deg"]
    facts = {
        "where it lies": f"{_xyz(where['min_mm'])} to {_xyz(where['max_mm'])} mm, {size_mm:.1f} mm across; "
        f"tool tilted {least:.1f} to {largest:.1f} deg",
        "entry tip": f"{_xyz(where['entry_tip_mm'])} mm",
    }
    told = "; ".join(f"{name} at {place}" for name, place in places.items())
    return facts | ({"worst" if len(places) == 1 else "worst places": f"tip {told} mm"} if told else {})


def check_point_facts(asked: CheckPoints) -> dict[str, str]:
    """How far every check point of the registration is off; nothing where there is none and none is asked for."""
    if not asked.points and not asked.least:
        return {}
    least = f"at least {asked.least}, " if asked.least else ""
    told = "; ".join(check_point_line(asked, one) for one in asked.points) or "none"
    return {"check points": f"{told} (required: {least}each within {asked.tolerance_mm:g} mm)"}


def check_point_line(asked: CheckPoints, one: PointResidual) -> str:
    """How far one is off, and whether that is too far."""
    return f"{one.id} {one.residual_mm:.3f} mm off{'' if asked.within(one) else ', TOO FAR'}"


def _xyz(values: Sequence[float]) -> str:
    return "x y z " + " ".join(f"{value:.1f}" for value in values)


def _digest_facts(digests: Digests) -> dict[str, str]:
    """The digests in full: they are compared by eye with the controller's and the log's."""
    names = ("path", "limits", "calibration", "registration")
    return {f"{name} SHA-256": getattr(digests, name).hex() for name in names}


def facts_table(facts: Mapping[str, str]) -> Table:
    """Label and value, aligned."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, value in facts.items():
        table.add_row(label, printable(value))
    return table


def _value(value: float | None, digits: int = 3) -> str:
    """A number as people read it; a dash where it is undefined."""
    return "-" if value is None else f"{value:.{digits}f}"
