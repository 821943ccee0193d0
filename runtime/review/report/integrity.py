"""Whether a log can be believed, in the order in which it is asked, and what no verification can find."""

from collections.abc import Iterator

from cutgate.runtime.audit.inspect import Report, Status
from cutgate.runtime.audit.replay import Replay, ReplayOutcome
from cutgate.runtime.audit.trust import NOT_FOUND, REPLAY, TrustAnswer, TrustStep
from cutgate.runtime.review.report.markup import Markup, joined, listed, table, tag

SHAPES = {
    TrustAnswer.YES: "\N{HEAVY CHECK MARK} yes",
    TrustAnswer.NO: "\N{HEAVY BALLOT X} NO",
    TrustAnswer.NOT_CHECKED: "? not checked",
}
"""Told by shape and word, not by colour."""
NOT_REPLAYED = "not replayed: it was left out with --no-replay"
_ANSWERS = {
    ReplayOutcome.IDENTICAL: TrustAnswer.YES,
    ReplayOutcome.DIFFERS: TrustAnswer.NO,
    ReplayOutcome.BAD_INPUT: TrustAnswer.NO,
}


def steps_of(report: Report, replay: Replay | None) -> tuple[TrustStep, ...]:
    """Every step's answer, with what deciding again has shown in the place of the last.

    Args:
        report: of the log.
        replay: None where it was left out.
    """
    return tuple(_replayed(replay) if step.name == REPLAY else step for step in report.steps)


def section(report: Report, replay: Replay | None, steps: tuple[TrustStep, ...]) -> Markup:
    """The judgement with its reasons, the steps, what deciding again has found, and what cannot be found.

    Args:
        report: of the log.
        replay: None where it was left out.
        steps: as ``steps_of`` has them.
    """
    return joined(_parts(report, replay, steps))


def _parts(report: Report, replay: Replay | None, steps: tuple[TrustStep, ...]) -> Iterator[Markup]:
    good = report.status is Status.OK
    yield tag("p", tag("strong", report.headline), class_="good" if good else "bad")
    yield listed((*report.reasons, *report.notes))
    if report.dropped_bytes:
        yield tag("p", f"{report.dropped_bytes} bytes at the end are no whole record.")
    rows = [
        (step.name, tag("span", SHAPES[step.answer], class_=_kind(step.answer)), step.text) for step in steps
    ]
    yield table(("asked in this order", "answer", "what was found"), rows, class_="trust")
    if replay is not None:
        yield listed((*replay.differences, *replay.notes))
    first, *rest = NOT_FOUND.split("\n")
    yield tag("h3", first)
    yield tag("pre", "\n".join(rest))


def _kind(answer: TrustAnswer) -> str:
    return {TrustAnswer.YES: "good", TrustAnswer.NO: "bad"}.get(answer, "note")


def _replayed(replay: Replay | None) -> TrustStep:
    if replay is None:
        return TrustStep(REPLAY, TrustAnswer.NOT_CHECKED, NOT_REPLAYED)
    found = replay.outcome.name.replace("_", " ")
    first = next(iter(replay.differences), "decided again from the log alone: the same")
    return TrustStep(REPLAY, _ANSWERS[replay.outcome], f"{found}: {first}")
