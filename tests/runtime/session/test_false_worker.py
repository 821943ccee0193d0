"""A verification process that lies, or is somebody else's: whatever it says, it can refuse and cannot permit."""

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import RuntimeHeartbeat
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.messages import ANSWER_BYTES_MAX, Broken, Claim, framed
from cutgate.runtime.verification.steps import finished
from tests.runtime.session.pair import (
    ADMISSIBLE_MM,
    CYCLE_S,
    STANDS,
    answers,
    check_of,
    claim_of,
    job_of,
    pair_of,
)
from tests.runtime.session.test_session import first_frames


@pytest.fixture
def admissible(tmp_path_factory):
    """What an honest process says of a path that is admissible."""
    files, job = job_of(tmp_path_factory, ADMISSIBLE_MM)
    return claim_of(finished(check_of(job, files.robot.value).steps(0, STANDS)).verdict)


def refused(pair, reason, phase=Phase.STOPPED):
    """Nothing was permitted; people and the log are told why."""
    assert pair.end() is phase
    assert reason in pair.state.reason
    assert not first_frames(pair, records.Permit)
    assert not first_frames(pair, records.Start)
    assert pair.state.permit is None
    pair.close()
    log = pair.read()
    assert log.of("/audit/permit") == []
    if phase is Phase.STOPPED:
        assert pair.state.cause is StopCause.INTERNAL_ERROR
        (fault,) = [entry for entry in log.of("/audit/fault") if entry["source"] == "runtime"]
        assert reason in fault["detail"]


# ---------------------------------------------------------------- well-formed lies about an inadmissible path


def lies(request, claim, /, **changes):
    """The admissible path's claim, said of what was asked."""
    asked = {
        "path": records.digest(request.path).hex(),
        "limits": records.digest(request.limits).hex(),
        "calibration": records.digest(request.calibration).hex(),
        "tool": records.digest(request.tool).hex(),
        "start_joints_u": request.start_joints_u,
    }
    return claim.model_copy(update={"request": request.number, **asked, **changes})


def test_an_inadmissible_path_that_is_said_to_be_admissible_is_not_permitted(outside, admissible):
    outside.begin().prover.answer = lambda request: [lies(request, admissible)]
    refused(
        outside,
        "verification failed: the verification process said ADMISSIBLE, "
        "this side's own check says INADMISSIBLE: outer short by",
    )


@pytest.mark.parametrize("which", ["pair", "outside"])
@pytest.mark.parametrize("name", ["path", "limits", "calibration", "tool"])
def test_a_verdict_on_another_path_or_record_does_not_count(request, admissible, which, name):
    """Of an inadmissible cut as of an admissible one."""
    pair = request.getfixturevalue(which)
    other = {name: getattr(admissible, "limits" if name == "path" else "path")}
    pair.begin().prover.answer = lambda asked: [lies(asked, admissible, **other)]
    refused(pair, f"the verification process answered for another {name}")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"request": 77}, "answered another request"),
        ({"start_joints_u": (0, 0, 0, 0, 0)}, "answered another request"),
        ({"admissible": False, "approach": None}, "said INADMISSIBLE, this side's own check says ADMISSIBLE"),
        (
            {"approach": None},
            "said INADMISSIBLE of approach and retract, this side's own check says ADMISSIBLE",
        ),
    ],
)
def test_a_claim_that_is_not_this_sides_own_verdict_permits_nothing(pair, admissible, changes, said):
    pair.begin().prover.answer = lambda request: [lies(request, admissible, **changes)]
    refused(pair, f"the verification process {said}")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("entry_um", 0),
        ("exit_um", 0),
        ("entry_joints_u", STANDS),
        ("exit_joints_u", STANDS),
        ("speed_percent", 100),
    ],
)
def test_an_approach_that_this_side_has_not_verified_is_not_bound(pair, admissible, name, value):
    other = admissible.approach.model_copy(update={name: value})
    pair.begin().prover.answer = lambda request: [lies(request, admissible, approach=other)]
    refused(pair, "said another entry, exit or speed than this side has verified")


def test_an_arm_that_cannot_get_there_is_not_permitted_whatever_is_said(pair, admissible):
    """It stands 2.05 mm above its lower limit."""
    low = (-40.0, 95.0, 52.05, -50.0, 32.0)
    pair.power_up(joints=tuple(low[i] if i == 2 else low[i] * 3.141592653589793 / 180 for i in range(5)))
    pair.begin().prover.answer = lambda request: [lies(request, admissible)]
    refused(pair, "said ADMISSIBLE of approach and retract, this side's own check says INADMISSIBLE")


def test_what_is_said_before_anything_was_asked_is_held_against_what_is_found_then(outside, admissible):
    """It can guess the request and where the arm stands; it gains nothing by it."""
    outside.begin()
    _, job = outside.files, outside.job
    guessed = admissible.model_copy(
        update={"request": 1, "path": records.digest(job.path).hex(), "start_joints_u": STANDS}
    )
    outside.prover.answer = lambda _request: None
    outside.prover.give(guessed)
    refused(outside, "the verification process ")


def test_what_was_permitted_is_what_this_side_has_found(pair):
    pair.to(Phase.PERMITTED)
    own = finished(check_of(pair.job, pair.files.robot.value).steps(1, pair.prover.asked[0].start_joints_u))
    permit = pair.controller.permit
    assert permit.approach == own.verdict.approach
    assert permit.path_digest == own.verdict.path
    assert pair.state.verdict.trajectory is pair.session.answer.verdict.trajectory


# ---------------------------------------------------------------- no message at all


class Bomb:
    """What pickle would run."""

    went_off = False

    def __reduce__(self):
        return setattr, (Bomb, "went_off", True)


def body_of(claim: Claim) -> bytes:
    return claim.model_dump_json().encode()


NO_MESSAGES = {
    "longer than any": lambda _: (1 << 31).to_bytes(4, "big"),
    "endless": lambda _: b"\xff" * 100_000,
    "zeros": lambda _: bytes(100_000),
    "as long as allowed": lambda _: framed(b"[" * ANSWER_BYTES_MAX),
    "deep": lambda _: framed(b'{"approach":' * 1000),
    "not a number": lambda claim: framed(
        body_of(claim).replace(b'"speed_percent":25', b'"speed_percent":NaN')
    ),
    "a number too long": lambda claim: framed(body_of(claim).replace(b":25", b":" + b"9" * 5000)),
    "a field more": lambda claim: framed(body_of(claim)[:-1] + b',"proof":"forged"}'),
    "a field less": lambda claim: framed(
        json.dumps({k: v for k, v in json.loads(body_of(claim)).items() if k != "tool"}).encode()
    ),
    "cut off": lambda claim: framed(body_of(claim)[:-1]),
    "another alphabet": lambda claim: framed(body_of(claim).decode().encode("utf-16")),
    "pickled": lambda _: len(pickle.dumps(Bomb())).to_bytes(4, "big") + pickle.dumps(Bomb()),
    "guidance first": lambda _: framed(b'{"kind":"guided","request":1,"guidance":null}'),
    "escapes": lambda _: framed(b'{"kind":"broken","request":1,"reason":"\\u001b[2J"}'),
}


@pytest.mark.parametrize("name", NO_MESSAGES)
def test_what_is_no_answer_permits_nothing_and_is_told(pair, admissible, name):
    pair.begin().prover.answer = lambda request: [NO_MESSAGES[name](lies(request, admissible))]
    refused(pair, "verification failed: the verification process")
    assert not Bomb.went_off
    assert pair.state.reason.isprintable()
    assert len(pair.state.reason) < 400


def test_half_an_answer_is_waited_for_no_longer_than_for_any(pair, admissible):
    pair.begin(replace(pair.job, deadlines=replace(pair.job.deadlines, verify_timeout_s=0.3)))
    pair.prover.answer = lambda request: [framed(body_of(lies(request, admissible)))[:-1]]
    refused(pair, "no verdict within 0.3 s", Phase.REFUSED)


# ---------------------------------------------------------------- after its verdict it is not listened to


@pytest.mark.parametrize(
    "more",
    [
        lambda prover, claim: prover.give(*[claim] * 50),
        lambda prover, _claim: prover.give(b"\xff" * 50_000),
        lambda prover, _claim: prover.give(Broken(reason="it is over")),
        lambda prover, _claim: prover.die(),
    ],
    ids=["claims", "noise", "failure", "death"],
)
@pytest.mark.parametrize("at", [Phase.VERIFYING, Phase.PERMITTED, Phase.CUTTING])
def test_whatever_it_does_after_its_verdict_stops_no_cut(pair, admissible, more, at):
    pair.to(at)
    more(pair.prover, lies(pair.prover.asked[0], admissible))
    assert pair.end() is Phase.DONE
    pair.close()
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


@pytest.mark.parametrize("at", [Phase.WAITING, Phase.COLLECTING, Phase.UPLOADING])
def test_a_process_that_dies_before_its_verdict_stops_the_session(pair, at):
    pair.to(at).prover.die()
    refused(pair, "verification failed: the verification process ended")


def test_a_process_that_does_not_answer_while_this_side_has_long_found_it_admissible_permits_nothing(pair):
    pair.begin(replace(pair.job, deadlines=replace(pair.job.deadlines, verify_timeout_s=0.3)))
    pair.prover.answer = lambda _request: None
    refused(pair, "no verdict within 0.3 s", Phase.REFUSED)


def test_a_stop_while_it_is_being_verified_is_not_made_another_by_what_comes_then(pair):
    """The claim that was on its way is no failure, and no verdict either."""
    pair.begin().prover.answer = lambda _request: None
    pair.to(Phase.VERIFYING).say("stop")
    pair.prover.give(*answers(pair.prover.asked[0]))
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.OPERATOR_STOP
    assert pair.state.stops_sent == {StopCause.OPERATOR_STOP}


# ---------------------------------------------------------------- between the turns


STEP_S = 0.001


def test_the_runtimes_own_check_never_holds_up_a_turn(pair):
    """Steps of a millisecond each, a hundred of them: at most a quarter of a heartbeat in one cycle, and at once again."""
    pair.begin()
    check, a_turn = pair.session._verifying._check, []

    class Slow(type(check)):
        def __init__(self):
            """It has nothing of its own."""

        def request(self, *asked):
            return check.request(*asked)

        def steps(self, request, start_joints_u):
            for _ in range(100):
                pair.clock.now_s += STEP_S
                a_turn[-1] += 1
                yield
            return (yield from check.steps(request, start_joints_u))

    pair.session._verifying._check = Slow()
    heartbeat_s = pair.job.timing.heartbeat_ms / 1000
    while pair.phase is not Phase.ADMITTED and pair.phase is not Phase.NONCE_PERMIT:
        a_turn.append(0)
        pair.run_cycle()
        if pair.session._verifying._steps is not None:  # nobody waits for a heartbeat before it goes on
            before_s = pair.clock()
            pair.session._wait(pair.wake[0])
            assert pair.clock() == before_s
    assert sum(a_turn) == 100
    assert max(a_turn) * STEP_S <= heartbeat_s / 4
    times = [seen.at_s for seen, _ in pair.wire.frames(RuntimeHeartbeat)]
    assert max(b - a for a, b in pairwise(times)) <= heartbeat_s * 1.25 + CYCLE_S + 1e-9
    assert pair.end() is Phase.DONE


def test_without_a_verdict_of_its_own_the_session_stops_and_says_why(pair):
    pair.begin()
    check = pair.session._verifying._check

    class Failing:
        request = check.request

        def steps(self, _request, _start_joints_u):
            yield
            raise ValueError("the verified path bends too much to be followed on segment 3")

    pair.session._verifying._check = Failing()
    refused(pair, "verification failed: ValueError: the verified path bends too much")


def test_the_records_of_the_controller_must_be_the_approved_ones_whatever_anybody_says(
    tmp_path, tmp_path_factory, admissible
):
    """Checked is what is approved; a controller that holds anything else is refused before the path is uploaded."""
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as pair:
        limits = records.Limits.parse(pair.job.limits)
        q_max_u = (limits.q_max_u[0] - 1, *limits.q_max_u[1:])
        other = replace(limits, q_max_u=q_max_u).body()
        pair.process.controller = replace(
            pair.controller, holdings=replace(pair.controller.holdings, limits=other)
        )
        pair.begin().prover.answer = lambda request: [lies(request, admissible)]
        refused(pair, "controller's joint limits equal the approved", Phase.REFUSED)
        assert pair.prover.asked == []
