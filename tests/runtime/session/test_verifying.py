"""Two verifications of one session: neither alone makes a verdict."""

from dataclasses import FrozenInstanceError
from types import SimpleNamespace

import pytest

from cutgate.runtime.interlock.state import Collected, Verify
from cutgate.runtime.session.messages import Broken, Claim, Guided
from cutgate.runtime.session.verifying import UNASKED, NotVerified, Verifying
from tests.runtime.interlock.builders import START_JOINTS, VERDICT

WANTED = Verify(VERDICT.request, START_JOINTS)
HELD = Collected(b"limits", b"calibration", b"tool")
OWN = SimpleNamespace(verdict=VERDICT)
CLAIM = Claim(
    request=VERDICT.request,
    admissible=True,
    path=VERDICT.path.hex(),
    limits=VERDICT.limits.hex(),
    calibration=VERDICT.calibration.hex(),
    tool=VERDICT.tool.hex(),
    start_joints_u=VERDICT.start_joints_u,
    approach=None,
)
OTHER = CLAIM.model_copy(update={"request": VERDICT.request + 1})


class Own:
    """This side's check: so many steps, then the answer or an error."""

    def __init__(self, steps, end=OWN):
        self.left, self.end, self.asked = steps, end, []

    def request(self, *asked):
        self.asked.append(asked)
        return "request"

    def steps(self, *asked):
        self.asked.append(asked)
        while self.left:
            self.left -= 1
            yield
        if isinstance(self.end, ValueError):
            raise self.end
        return self.end


class Process:
    """The verification process: says these, one after the other, and nothing between."""

    def __init__(self, *says):
        self.says, self.asked = list(says), []

    def submit(self, request):
        self.asked.append(request)

    def poll(self):
        return self.says.pop(0)

    def wait(self, wake, timeout_s):
        self.asked.append((wake, timeout_s))
        return self.says.pop(0)


@pytest.fixture(autouse=True)
def _approach_is_as_claimed(monkeypatch):
    monkeypatch.setattr("cutgate.runtime.session.check.Bound.of", lambda _: None)


def begun(*says, steps=0, end=OWN):
    both = Verifying(Own(steps, end), Process(*says))
    both.begin(WANTED, HELD)
    return both


def at_once(both):
    return both.go_on(lambda: 0.0, 1.0)


def test_a_reason_is_not_changed_afterwards():
    with pytest.raises(FrozenInstanceError):
        NotVerified("it died").reason = ""


def test_before_it_begins_there_is_nothing_to_do():
    both = Verifying(Own(0), Process())
    assert (both.busy, both.listening, at_once(both), both.agreed()) == (False, True, None, None)


def test_both_are_asked_about_what_the_controller_holds_and_where_the_arm_stands():
    both = begun()
    assert both._check.asked == [(WANTED.request, WANTED.start_joints_u, HELD)]
    assert both._worker.asked == ["request"]
    at_once(both)
    assert both._check.asked[1:] == [(WANTED.request, WANTED.start_joints_u)]


@pytest.mark.parametrize("first", ["own", "process"])
def test_the_verdict_counts_once_when_both_have_spoken_whoever_is_first(first):
    both = begun(CLAIM)
    assert both.busy, "its own check has begun"
    speak = [lambda: at_once(both) is OWN, lambda: both.hear() is None]
    first_speaks, second_speaks = speak if first == "own" else reversed(speak)
    assert both.agreed() is None
    assert first_speaks()
    assert (both.agreed(), both.busy) == (None, first == "process"), "for what is not there nobody turns"
    assert second_speaks()
    assert both.busy
    assert both.agreed() is OWN
    assert (both.agreed(), both.busy) == (None, False)


def test_once_the_process_has_spoken_it_is_not_listened_to_any_more():
    both = begun(None, CLAIM)
    assert (both.hear(), both.listening) == (None, True), "not all of it is there"
    assert (both.hear(), both.listening) == (None, False)


@pytest.mark.parametrize(
    ("says", "reason"),
    [(Broken(reason="it died"), "it died"), (Guided(request=VERDICT.request, guidance=None), UNASKED)],
)
def test_a_process_that_fails_or_says_what_it_was_not_asked_verifies_nothing(says, reason):
    both = begun(says)
    assert both.hear() == NotVerified(reason)
    assert (at_once(both), both.agreed(), both.listening) == (OWN, None, False)


def test_where_the_two_differ_there_is_no_verdict():
    both = begun(OTHER)
    at_once(both)
    both.hear()
    assert both.agreed() == NotVerified("the verification process answered another request")
    assert both.agreed() is None


def test_an_own_check_that_fails_says_why_and_nothing_more_is_asked():
    both = begun(CLAIM, steps=1, end=ValueError("it bends too much"))
    assert at_once(both) == NotVerified("ValueError: it bends too much")
    assert (both.listening, both.busy, both.agreed()) == (False, False, None)


def test_steps_are_taken_while_there_is_time():
    times = iter([0.0, 0.4, 0.9, 1.0, 1.0, 0.0])
    both = begun(steps=4)
    assert (both.go_on(lambda: next(times), 1.0), both._check.left) == (None, 1), "none begins at its end"
    assert (both.go_on(lambda: next(times), 1.0), both._check.left) == (None, 1)
    assert (both.go_on(lambda: 0.0, 1.0), both._check.left) == (OWN, 0)


def test_guidance_is_what_the_process_says_of_this_verdict():
    said = Guided(request=VERDICT.request, guidance=None)
    both = begun(said)
    assert both.guided(7, 5.0, VERDICT.request) is said
    assert both._worker.asked[1:] == [(7, 5.0)]


@pytest.mark.parametrize(
    ("says", "reason"),
    [
        (None, "not found within 2.5 s, or not waited for"),
        (Broken(reason="it died"), "it died"),
        (CLAIM, UNASKED),
        (Guided(request=VERDICT.request + 1, guidance=None), UNASKED),
    ],
)
def test_guidance_that_does_not_come_has_its_reason(says, reason):
    assert begun(says).guided(7, 2.5, VERDICT.request) == NotVerified(reason)
