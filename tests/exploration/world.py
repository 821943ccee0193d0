"""What the exploration is about: one job, its records, the names in use, and what may happen besides the bus."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from cutgate.runtime.interlock import state as r
from tests.exploration.invariants import JudgedController
from tests.exploration.names import BOOT, EPOCH, OPEN, TOKEN
from tests.firmware_sim import controllers as fixed
from tests.runtime.interlock import builders

FOUND, MISSED = (r.WitnessSought(found=found, text="") for found in (True, False))
"""Whether the log that the controller saw last is here."""
PERMIT_LOG, START_LOG = fixed.PERMIT_LOG, fixed.START_LOG
JOB = replace(
    builders.JOB,
    path=fixed.PATH.body(),
    branch=fixed.PERMIT.branch,
    registration=OPEN.registration_digest,
    place=OPEN.place_digest,
    registration_time_us=OPEN.registration_time_us,
    configuration=OPEN.configuration_digest,
    verifier=OPEN.verifier_version,
    timing=OPEN.timing,
    registration_max_age_s=None,
)
FRESH = r.Interlock(job=JOB, log=builders.READY.log, token=TOKEN)
VERDICT = r.CutVerdict(
    request=TOKEN,
    admissible=True,
    path=fixed.PATH.digest,
    limits=fixed.PERMIT.limits_digest,
    calibration=fixed.PERMIT.calibration_digest,
    tool=fixed.PERMIT.tool_digest,
    start_joints_u=fixed.START_JOINTS,
    reason="",
    approach=fixed.PERMIT.approach,
    approach_reason="",
    trajectory=builders.trajectory(fixed.START_JOINTS),
)
WARNED = replace(VERDICT, to_confirm=("CUT_TINY",))
POWERED_UP = JudgedController(**{**vars(fixed.POWERED_UP), "announce_nonce": BOOT, "epoch": EPOCH})
OFF_START = (0, *fixed.START_JOINTS[1:])
OTHER_LIMITS = fixed.OTHER_LIMITS.body()
FLIPPED_PATH = fixed.PATH.body()[:-1] + bytes([fixed.PATH.body()[-1] ^ 1])


@dataclass(frozen=True)
class World:
    """What may happen besides everything on the bus, the enabling device, stops, time-outs and new sessions.

    Attributes:
        reboots: the controller loses power.
        limits: limits change, with a word and without; a bit of the stored path flips.
        bone: it moves, the registration is withdrawn, and there is another one.
        emergency_stop: it is pressed and released.
        disk: records late, log failing, the arm away from where it was verified, verdicts against the path.
        warned: the verdict comes with a warning, and the controller may have seen a log, which is found or not; the
            operator confirms or does not.
        link: what the link of either side lets through although it must not (seeded faults).
        exact: of the signed records of the present session only those are said again that were said. Without it
            every record is taken as said already that differs in nothing but an earlier nonce, epoch, session or boot.
        begin: the controller at the beginning.
    """

    reboots: bool = False
    limits: bool = False
    bone: bool = False
    emergency_stop: bool = False
    disk: bool = False
    warned: bool = False
    link: str = ""
    exact: bool = False
    begin: JudgedController = POWERED_UP


class Move(NamedTuple):
    """What happens; ``sound``: part of a continuation without faults; ``wrong``: the invariant it breaks."""

    actor: str
    text: str
    sound: bool = False
    wrong: str | None = None


class Change(NamedTuple):
    """One side's new value.

    Attributes:
        side: its number.
        sent: what it sent, as messages.
        passing: what ceased to be the present one by it (``names.Passing``).
    """

    move: Move
    side: int
    sent: tuple[Any, ...] = ()
    passing: int = 0


class Numbers:
    """Canonical values by number."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.numbers: dict[Any, int] = {}

    def number(self, value: Any) -> int:
        """The value's number, a new one where it is new."""
        found = self.numbers.get(value)
        if found is None:
            found = self.numbers[value] = len(self.values)
            self.values.append(value)
        return found


def distinct(side: int, changes: list[Change]) -> list[Change]:
    """One of each outcome, and none that changes and says nothing, unless it is wrong."""
    found: dict[Any, Change] = {}
    for one in changes:
        if one.side != side or one.sent or one.passing or one.move.wrong:
            found.setdefault((one.side, one.sent, one.passing, one.move.wrong), one)
    return list(found.values())
