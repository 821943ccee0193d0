"""What each joint travels on the approach, for people: before the start, and in words where it is more than one turn."""

from collections.abc import Sequence

from rich.text import Text

from cutgate.protocol.records import joints_to_memory
from cutgate.runtime.commands.verdict_view import WARNED
from cutgate.runtime.verification.approach.model import ApproachVerdict
from cutgate.runtime.verification.approach.report import shown
from cutgate.runtime.verification.asked import OPTION
from cutgate.runtime.verification.verdict import JointBranch, Verdict, Winding

REVOLUTION_DEG = 360.0


def travel_lines(planned: ApproachVerdict, start_joints_u: tuple[int, ...], cut: Verdict) -> list[Text]:
    """How far each joint goes from where the arm stands to the entry pose, and a warning for each that winds.

    Args:
        planned: approach and retract of the cut.
        start_joints_u: where the arm stands, 1e-6 deg | mm.
        cut: its verdict: in which other turns it fits.
    """
    ends = (shown(joints_to_memory(start_joints_u)), [] if planned.entry is None else shown(planned.entry))
    if len(ends[1]) != len(ends[0]) or None in (*ends[0], *ends[1]):
        return []
    travels = [float(to or 0.0) - float(stands or 0.0) for stands, to in zip(*ends, strict=True)]
    parts = [_part(joint, travel) for joint, travel in enumerate(travels)]
    lines = [Text(f"the approach moves {', '.join(parts)}")]
    for joint, travel in enumerate(travels):
        if joint != 2 and abs(travel) > REVOLUTION_DEG:
            text = (
                f" q{joint} turns {abs(travel) / REVOLUTION_DEG:.1f} times on the approach, from {ends[0][joint]:.1f} to "
                f"{ends[1][joint]:.1f} deg, and back on the retract: cables and hoses must allow it{_nearer(joint, travel, cut)}"
            )
            lines.append(Text.assemble(("WARNING", WARNED), text))
    return lines


def _part(joint: int, travel: float) -> str:
    if joint == 2:
        return f"q2 {travel:+.1f} mm"
    return f"q{joint} {travel:+.1f} deg ({abs(travel) / REVOLUTION_DEG:.1f} turns)"


def _nearer(joint: int, travel: float, cut: Verdict) -> str:
    """Which other turns would spare it, and which there are."""
    found = _winding(cut.windings, joint)
    if found is None or cut.branch is None:
        return ""
    taken = _taken(cut.branch, joint)
    nearest = min(max(taken - round(travel / REVOLUTION_DEG), found.first), found.last)
    option = OPTION[found.joint]
    if nearest == taken:
        return f"; the path fits in no turns nearer to where the arm stands ({option} {found.feasible})"
    return f"; {option} {nearest} is nearest to where the arm stands (the path fits in {found.feasible})"


def _winding(windings: Sequence[Winding], joint: int) -> Winding | None:
    return next((one for one in windings if one.joint == f"q{joint}"), None)


def _taken(branch: JointBranch, joint: int) -> int:
    return branch.q0_turns if joint == 0 else branch.roll_turns
