"""Who says what when, how each session is to end, and what to say where one ends otherwise."""

from dataclasses import dataclass
from typing import Any, Final

from cutgate.protocol.states import StopCause

PLAN: Final = "hip-stem.plan.json"
STORY: Final = {
    "registration-first.json": ("inadmissible", "not_admitted"),
    "registration-second.json": ("admissible", "completed"),
}
"""Each session's registration, its verdict and how it is to end."""
TIME_SCALE: Final = 100
"""Plant time runs so many times faster than the clock."""


@dataclass(frozen=True)
class Cue:
    """When a line of one process holds ``text``, give another this command."""

    text: str
    to: str
    command: str


CUES: Final = (
    Cue(
        "say acknowledge", "runtime", "acknowledge"
    ),  # of a stop that came late to the session before, if any did
    Cue("permitted: cutting mode is on", "controller", "hold"),
    Cue("enabling device is held: say start", "runtime", "start"),
)
"""The operator and the person at the controller, as a table."""

LATE: Final = frozenset({StopCause.HEARTBEAT_LOST.name, StopCause.LOOP_STALLED.name})
STALLED: Final = "this computer stood still"
"""What the controller says of its own lateness."""
TOO_BUSY: Final = (
    "runtime and controller share this machine, and one of them did not get the processor in time: run the demo again with "
    "less beside it, or with priority: chrt --rr 10 cutgate demo (docs/timing.md says who may)"
)


def departure(registration: str, run: dict[str, Any], stalled: list[str]) -> list[str]:
    """Why a session did not end as it was to, and what to do; nothing where it did.

    Args:
        registration: the session's.
        run: what ``run --json`` said.
        stalled: what the controller said of its own lateness.
    """
    ended = ((run["verdict"] or {}).get("verdict", "no verdict"), run["outcome"])
    if ended == STORY[registration]:
        return []
    was_to_be, became = (", ".join(words).replace("_", " ") for words in (STORY[registration], ended))
    why = [f"the session with {registration} was to be {was_to_be}, and became {became}: {run['reason']}"]
    if run["cause"] in LATE:
        why += [*stalled, TOO_BUSY]
    return why
