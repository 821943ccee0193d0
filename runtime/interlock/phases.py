"""The phases of a session, one row each: what is so in a phase, whatever happens in it.

What happens in it stands in ``table``. Nothing else in the program keeps a list by phases.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from cutgate.config.exits import OK, STOPPED
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.runtime.interlock.permissives import AT_START, COLLECTED, FOR_PERMIT, FOR_START, Evaluate
from cutgate.runtime.interlock.state import Job, Phase

NOT_ADMITTED: Final = 1
"""``run``: exit code of a session that ended in order, with nothing enabled."""


@dataclass(frozen=True)
class Deadline:
    """How long a phase may last, and what it means if it lasts longer.

    Attributes:
        seconds: of the job's timing and deadlines.
        cause: NOT_ADMITTED refuses, NONE ends the wait for a confirmation, any other stops.
        missed: what has not come, in words.
    """

    seconds: Callable[[Job], float]
    cause: StopCause
    missed: str


@dataclass(frozen=True)
class Ending:
    """What came of a session, for each of those who ask.

    Attributes:
        document: in JSON.
        headline: on a screen.
        exit_code: of ``run``, if the log was closed as well.
    """

    document: str
    headline: str
    exit_code: int


@dataclass(frozen=True)
class PhaseRow:
    """One phase.

    Attributes:
        situation: what is so, to be read after "while"; for a command that does not apply; empty where none is answered.
        deadline: None where it lasts as long as heartbeats do, or is an end.
        expected: what the controller may report, anything else stops; None where the phase's own handler judges that.
        heartbeat: what this side's heartbeat says.
        permissives: what a decision taken in it rests on, for the log.
        announced: what a person is told on entering it; empty for nothing.
        moving: the arm may be moving.
        authorising: a decision is being made durable; nothing has left.
        signed: the answer to a signed record is awaited.
        ending: what came of the session, None while it lasts.
    """

    situation: str = ""
    deadline: Deadline | None = None
    expected: frozenset[ControllerState] | None = None
    heartbeat: RuntimeCode = RuntimeCode.INHIBIT
    permissives: tuple[Evaluate, ...] = ()
    announced: str = ""
    moving: bool = False
    authorising: bool = False
    signed: bool = False
    ending: Ending | None = None


P, C, S = Phase, ControllerState, StopCause


def _on(*states: ControllerState) -> frozenset[ControllerState]:
    return frozenset(states)


PHASES: Final[dict[Phase, PhaseRow]] = {
    P.WAITING: PhaseRow(
        "no controller has announced itself",
        Deadline(lambda job: job.deadlines.announce_wait_s, S.NOT_ADMITTED, "no controller announced itself"),
        expected=_on(),
    ),
    P.OPENING: PhaseRow(
        "the session is being opened",
        Deadline(
            lambda job: job.deadlines.reply_timeout_s,
            S.NOT_ADMITTED,
            "the controller did not open the session",
        ),
        announced="controller found, opening a session",
    ),
    P.HELD: PhaseRow(
        "the controller carries a stop or a latched fault",
        Deadline(
            lambda job: job.deadlines.operator_wait_s,
            S.NOT_ADMITTED,
            "the controller's stop was not acknowledged and reset",
        ),
        announced="the controller carries a stop or a latched fault",
    ),
    P.NONCE_RESET: PhaseRow(
        "the reset is being prepared",
        Deadline(lambda job: job.deadlines.reply_timeout_s, S.TRANSFER_FAILED, "no nonce for the reset"),
    ),
    P.AUTHORISING_RESET: PhaseRow(
        "the reset is being recorded",
        Deadline(
            lambda job: job.deadlines.commit_deadline_s,
            S.AUDIT_FAILED,
            "the reset's record did not reach the disk",
        ),
        authorising=True,
    ),
    P.RESETTING: PhaseRow(
        "the answer to the reset is awaited",
        Deadline(
            lambda job: job.deadlines.reply_timeout_s,
            S.TRANSFER_FAILED,
            "the controller did not report that its fault is reset",
        ),
        signed=True,
    ),
    P.COLLECTING: PhaseRow(
        "limits, calibration and tool are being collected",
        Deadline(
            lambda job: job.deadlines.reply_timeout_s,
            S.TRANSFER_FAILED,
            "limits, calibration and tool did not arrive",
        ),
        expected=_on(C.OPEN),
        permissives=COLLECTED,
        announced="collecting limits, calibration and tool",
    ),
    P.UPLOADING: PhaseRow(
        "the path is being uploaded",
        Deadline(
            lambda job: job.deadlines.transfer_timeout_s,
            S.TRANSFER_FAILED,
            "the path was not stored, or no measured joints came",
        ),
        expected=_on(C.OPEN, C.LOADED),
        announced="limits, calibration and tool equal the approved; uploading the path",
    ),
    P.VERIFYING: PhaseRow(
        "the path is being verified",
        Deadline(lambda job: job.deadlines.verify_timeout_s, S.NOT_ADMITTED, "no verdict"),
        expected=_on(C.OPEN, C.LOADED),
        permissives=FOR_PERMIT,
        announced="path stored by the controller; verifying it",
    ),
    P.ADMITTED: PhaseRow(
        "the permissives for the permit are awaited",
        Deadline(
            lambda job: job.deadlines.operator_wait_s,
            S.NOT_ADMITTED,
            "the permissives for the permit did not all hold",
        ),
        expected=_on(C.LOADED),
        permissives=FOR_PERMIT,
        announced="admitted; waiting for the permissives of the permit",
    ),
    P.NONCE_PERMIT: PhaseRow(
        "the permit is being prepared",
        Deadline(lambda job: job.deadlines.reply_timeout_s, S.TRANSFER_FAILED, "no nonce for the permit"),
        expected=_on(C.LOADED),
        permissives=FOR_PERMIT,
        announced="every permissive for the permit holds",
    ),
    P.AUTHORISING_PERMIT: PhaseRow(
        "the permit is being recorded",
        Deadline(
            lambda job: job.deadlines.commit_deadline_s,
            S.AUDIT_FAILED,
            "the permit's record did not reach the disk",
        ),
        expected=_on(C.LOADED),
        permissives=FOR_PERMIT,
        announced="permit authorised, its record is being made durable",
        authorising=True,
    ),
    P.PERMITTING: PhaseRow(
        "the answer to the permit is awaited",
        Deadline(
            lambda job: job.deadlines.reply_timeout_s,
            S.TRANSFER_FAILED,
            "the controller did not report that it is permitted",
        ),
        expected=_on(C.LOADED, C.PERMITTED),
        heartbeat=RuntimeCode.READY,
        announced="record durable, permit sent",
        signed=True,
    ),
    P.PERMITTED: PhaseRow(
        "the start is awaited",
        Deadline(
            lambda job: float(job.timing.permit_lifetime_s), S.PERMIT_EXPIRED, "the operator did not start"
        ),
        expected=_on(C.PERMITTED),
        heartbeat=RuntimeCode.READY,
        permissives=FOR_START,
        announced="permitted: cutting mode is on. Release the enabling device, hold it, then say start",
    ),
    P.NONCE_START: PhaseRow(
        "the start is being prepared",
        Deadline(lambda job: job.deadlines.reply_timeout_s, S.TRANSFER_FAILED, "no nonce for the start"),
        expected=_on(C.PERMITTED),
        heartbeat=RuntimeCode.READY,
        permissives=FOR_START,
    ),
    P.AUTHORISING_START: PhaseRow(
        "the start is being recorded",
        Deadline(
            lambda job: job.deadlines.commit_deadline_s,
            S.AUDIT_FAILED,
            "the start's record did not reach the disk",
        ),
        expected=_on(C.PERMITTED),
        heartbeat=RuntimeCode.READY,
        permissives=FOR_START,
        announced="start authorised, its record is being made durable",
        authorising=True,
    ),
    P.STARTING: PhaseRow(
        "the answer to the start is awaited",
        Deadline(
            lambda job: job.deadlines.reply_timeout_s,
            S.TRANSFER_FAILED,
            "the controller did not report that it cuts",
        ),
        expected=_on(C.PERMITTED, C.CUTTING, C.DONE),
        heartbeat=RuntimeCode.CUT,
        announced="record durable, start sent",
        moving=True,
        signed=True,
    ),
    P.CUTTING: PhaseRow(
        "the arm moves",
        expected=_on(C.CUTTING, C.DONE),
        heartbeat=RuntimeCode.CUT,
        announced="moving: approach, then cutting",
        moving=True,
    ),
    P.FINISHING: PhaseRow(
        "the end of the path is being confirmed",
        Deadline(
            lambda job: 2 * job.timing.timeout_s,  # as long as the tracking monitor waits for a sample
            S.TRACKING_DEVIATION,
            "no measured joints after the end was reported",
        ),
        expected=_on(C.DONE),
        permissives=AT_START,
        announced="the controller reports the end of the retract",
        moving=True,
    ),
    P.STOPPING: PhaseRow(
        deadline=Deadline(lambda job: job.deadlines.stop_confirm_s, S.NONE, "no confirmation of the stop"),
        announced="STOP sent",
    ),
    P.DONE: PhaseRow(ending=Ending("completed", "CUT COMPLETED", OK)),
    P.REFUSED: PhaseRow(ending=Ending("not_admitted", "NOT ADMITTED", NOT_ADMITTED)),
    P.STOPPED: PhaseRow(ending=Ending("stopped", "STOPPED", STOPPED)),
}


def _where(holds: Callable[[PhaseRow], bool]) -> frozenset[Phase]:
    return frozenset(phase for phase, row in PHASES.items() if holds(row))


MOVING: Final = _where(lambda row: row.moving)
AUTHORISING: Final = _where(lambda row: row.authorising)
SIGNED: Final = _where(lambda row: row.signed)
ENDINGS: Final = {phase: row.ending for phase, row in PHASES.items() if row.ending is not None}
ENDED: Final = frozenset(ENDINGS)
STOPPING: Final = frozenset({P.STOPPING, P.STOPPED})
"""After a stop, whether it is confirmed or not."""
