"""The interlock's phases, permissives and tracking rules as tables, read from the code."""

from collections import defaultdict
from dataclasses import replace
from typing import Final

from cutgate.protocol.records import joints_to_memory
from cutgate.protocol.states import ControllerState
from cutgate.runtime.interlock import permissives
from cutgate.runtime.interlock import state as interlock_state
from cutgate.runtime.interlock import table as interlock_table
from cutgate.runtime.interlock.phases import ENDED, MOVING, PHASES, Deadline
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.interlock.tracking import Deviation, FrameSeen
from docs.state_machines.interlock import runtime_edges
from docs.state_machines.tables import names, table
from tests.runtime.interlock import builders

C: Final = ControllerState


def _seconds(deadline: Deadline) -> str:
    """The setting that a deadline reads, and its default."""
    read: list[str] = []

    class Probe:
        def __getattr__(self, name: str) -> "Probe":
            read.append(name)
            return self

        def __float__(self) -> float:
            return 0.0

        def __rmul__(self, factor: float) -> float:
            return 0.0

    deadline.seconds(Probe())  # type: ignore[arg-type]
    return f"`{read[-1]}`, {deadline.seconds(builders.JOB):g} s"


def phases() -> str:
    """What each phase says, expects and waits for."""
    rows = []
    for phase in Phase:
        if phase in ENDED:
            continue
        row = PHASES[phase]
        ends = {
            edge.target
            for edge in runtime_edges()
            if (edge.source, edge.case) == (phase.name, "deadline missed")
        }
        deadline, missed = row.deadline, "–"
        if deadline is not None:
            cause = f" ({deadline.cause.name})" if deadline.cause else ""
            missed = f"{deadline.missed}: {names(sorted(ends))}{cause}"
        expected = None if row.expected is None else names(kind.name for kind in C if kind in row.expected)
        rows.append(
            (
                phase.name,
                row.heartbeat.name,
                "not judged" if expected is None else expected or "none",
                _seconds(deadline) if deadline is not None else "none",
                missed,
            )
        )
    head = ("phase", "heartbeat says", "controller may report", "deadline", "missed")
    return table(head, rows)


LISTS: Final = ("IDENTITY", "COLLECTED", "FOR_RESET", "FOR_PERMIT", "FOR_START", "AT_START", "FINAL")
NAMED_BOUNDS: Final = {
    "serial_number": "`[controller] serial` of site.toml; any where none is set",
    "limits_approved": "equal to robot.toml's, as canonical bytes",
    "calibration_approved": "equal to robot.toml's, as canonical bytes",
    "tool_approved": "equal to robot.toml's, as canonical bytes",
    "path_digest": "SHA-256 of the path that was sent",
    "verdict_current": "digests of path, limits, calibration and tool equal",
    "registration_age": "<= `registration_max_age_s` of site.toml; none where it is not set",
    "registration_residual": "<= `registration_max_residual_mm` of site.toml; none where it is not set",
    "check_points": "at least `check_points_min`, each within `check_point_tolerance_mm` of site.toml",
    "log_space": ">= twice the bytes this path's log needs",
    "epoch_current": "the session's epoch",
}
"""Bounds that depend on the job: their value says nothing, so that here stands where it comes from."""


def permissive_table() -> str:
    """Every permissive in the order in which it is judged, and the lists that it stands in."""
    lists = {name: getattr(permissives, name) for name in LISTS}
    rows = []
    for judge in dict.fromkeys(judge for members in lists.values() for judge in members):
        permissive = judge(builders.READY, builders.NOW)
        bound = NAMED_BOUNDS.get(judge.__name__, permissive.bound)
        marks = ("yes" if judge in members else "" for members in lists.values())
        rows.append((permissive.name, bound, permissive.remedy, *marks))
    return table(("permissive", "bound", "remedy", *(f"`{name}`" for name in LISTS)), rows)


def tracking_table() -> str:
    """Every rule of the tracking monitor, from steps that break it in each phase in which it does."""
    begun, seen = builders.monitor(builders.NOW), builders.monitor(builders.NOW - 10.0, builders.NOW)
    half_way = builders.measured(builders.HALF_WAY.joints_u, builders.NOW)
    ahead, _ = seen.sample(joints_to_memory(half_way.joints_u), builders.NOW, builders.NOW)
    silent = replace(seen, progressed=FrameSeen(0.0, builders.NOW - 9.0))
    breaking = (
        (seen, builders.measured(builders.ELSEWHERE, builders.NOW), 0.0),
        (begun, half_way, -1.0),
        (seen, interlock_state.ProgressReported(2, 0), 0.0),
        (replace(seen, progress=(1, 1)), builders.ON, 0.0),
        (begun, builders.BEYOND, 0.0),
        (ahead, interlock_state.ProgressReported(0, 0), 0.2),
        (begun, builders.beat(C.DONE), 0.0),
        (begun, interlock_state.Tick(), 0.201),
        (silent, interlock_state.Tick(), 0.16),
        (seen, half_way, 0.0),
    )
    rows: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for monitor, event, after_s in breaking:
        for phase in (phase for phase in Phase if phase in MOVING):
            state = builders.in_phase(phase, tracking=monitor, since_s=builders.NOW - 0.05)
            _, effects = interlock_table.step(state, event, builders.NOW + after_s)
            for deviation in (effect for effect in effects if isinstance(effect, Deviation)):
                for rule in deviation.judged:
                    row = (rule.name, type(event).__name__, rule.bound, deviation.reason)
                    rows[row].append(phase.name)
    head = ("rule", "asked on", "in", "bound, in an example", "what the stop says then")
    return table(head, ((rule, on, names(where), *rest) for (rule, on, *rest), where in rows.items()))
