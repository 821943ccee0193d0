"""What a log tells of its session as a whole: the arm, the verdict's scene, the reference trajectory; computed again. Pure."""

from typing import Final

from cutgate.protocol import records as wire
from cutgate.protocol.records import RecordError
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.recomputed.inputs import ReplayError, ReplayInputs, inputs_of, typed
from cutgate.runtime.audit.records import AuditApproach, AuditVerdict, TrackingSample
from cutgate.runtime.commands.foxglove.arm import ShownArm
from cutgate.runtime.commands.foxglove.decided import DrawnDecision
from cutgate.runtime.commands.foxglove.streams import Known
from cutgate.runtime.commands.verify_scene import scene
from cutgate.runtime.interlock.tracking import ReferenceTrajectory
from cutgate.runtime.review.story import ENTRY_UM_MAX
from cutgate.runtime.session.reference import between, from_start
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.steps import finished

JOINTS: Final = 5
_REPLAY: Final = "cutgate audit replay says more"


def known_of(log: Log, name: str) -> tuple[Known, int, list[str]]:
    """What is known of a session beside its records, the number of its verdicts, and what cannot be drawn, with why.

    Args:
        log: the log as read.
        name: its file's.
    """
    notes: list[str] = []
    follows = TrackingSample.TOPIC in log.topics
    try:
        verdicts = typed(log, AuditVerdict)
        if not verdicts:
            return Known(name), 0, ["the session ended before a verdict: neither path nor arm is drawn"]
        inputs = inputs_of(log)
        arm = ShownArm.of(inputs.limits, inputs.calibration, inputs.tool)
    except (ReplayError, RecordError) as error:
        notes.append(f"neither path nor arm is drawn: {error}")
        return Known(name), sum(topic == AuditVerdict.TOPIC for topic, _, _ in log.places), notes
    decision = trajectory = None
    try:
        decision = _decision(inputs, verdicts[-1], name)
        trajectory = _trajectory(inputs.problem, typed(log, AuditApproach))
    except ReplayError as error:
        what = "the reference of the joints is not written" if decision else "the path is not drawn"
        notes.append(f"{what}: {error}; {_REPLAY}")
    return Known(name, arm, decision, trajectory, follows), len(verdicts), notes


def _decision(inputs: ReplayInputs, recorded: AuditVerdict, name: str) -> DrawnDecision:
    """What is drawn of the verdict, if deciding again comes to the same.

    Raises:
        ReplayError: it does not, or there is nothing to decide on.
    """
    problem = inputs.problem
    verdict = certified.verify(problem)
    found = "admissible" if verdict.admissible else "inadmissible"
    if found != recorded.verdict:
        raise ReplayError(f"the log's verdict is {recorded.verdict}, deciding again comes to {found}")
    place = None if inputs.placed is None else inputs.placed.matrix
    return DrawnDecision(problem, scene(problem, verdict, None, f"session {name}"), place)


def _trajectory(problem: Problem, approaches: list[AuditApproach]) -> ReferenceTrajectory | None:
    """What the moving arm was held against; None where none was permitted.

    Raises:
        ReplayError: approach and retract are none that a session permits.
    """
    for approach in approaches[-1:]:
        if approach.verdict != "admissible":
            return None
        joints = (approach.start_joints_u, approach.entry_joints_u, approach.exit_joints_u)
        whole = all(len(counts) == JOINTS for counts in joints)
        near = 0 <= approach.entry_um <= ENTRY_UM_MAX and 0 <= approach.exit_um <= ENTRY_UM_MAX
        if not (whole and near and 1 <= (approach.speed_percent or 0) <= 100):
            raise ReplayError("its record of approach and retract is none that a session writes")
        bound = wire.Approach(
            approach.entry_um,
            approach.exit_um,
            approach.entry_joints_u,
            approach.exit_joints_u,
            approach.speed_percent or 0,
        )
        try:
            return finished(from_start(between(problem, bound), approach.start_joints_u))
        except ValueError as error:
            raise ReplayError(str(error)) from None
    return None
