"""What a reviewer asks first of a session, answered from its log.

Was it allowed and why; what stopped it, where, and what was done then; how close did it come. Words alone, nothing is
decided. Never raises, whatever the log holds.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from cutgate.runtime.audit.configuration import SIMULATED
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.permissives import FOLLOWING
from cutgate.runtime.review.comparable import is_number
from cutgate.runtime.review.report.measured import Measured
from cutgate.runtime.review.report.numbers import measure, plain
from cutgate.runtime.review.show import value_of, who
from cutgate.runtime.review.stop_words import phase_words, place_words, rest_words
from cutgate.runtime.review.stopped import CUT
from cutgate.runtime.review.story import BROKEN_OFF, SENT, failing

DONE: Final = "done"
NOT_BELIEVED: Final = {
    Status.TAMPERED: "The log was TAMPERED with: nothing that it says is to be believed.",
    Status.UNREADABLE: "The log cannot be read: nothing that it seems to say is to be believed.",
}
DECIDED_OTHERWISE: Final = "What was decided cannot be decided again from what the log holds: none of its decisions is to be believed."
VERDICT: Final = "verdict"
SHOWN_FAILING: Final = 3
"""Permissives that did not hold, told in the first screen; the decision's card has all."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One line of what is known about the session.

    Attributes:
        name: of the line.
        text: what it says.
        good: whether that is as it should be; None where it is neither.
        place: the part of the page that shows more, empty for none.
    """

    name: str
    text: str
    good: bool | None = None
    place: str = ""


@dataclass(frozen=True, slots=True)
class Answers:
    """The first screen.

    Attributes:
        outcome: one sentence.
        good: the path was cut to its end, and neither the log nor what it decided is in doubt.
        warning: why nothing here is to be believed; empty where it is.
        facts: line by line.
        allowed, stopped, close: the three answers, a sentence or some each.
    """

    outcome: str
    good: bool
    warning: str
    facts: tuple[Fact, ...]
    allowed: tuple[str, ...]
    stopped: tuple[str, ...]
    close: tuple[str, ...]


def answers(
    story: Mapping[str, Any], status: Status, replayed: Fact, measured: Measured | None = None
) -> Answers:
    """The answers.

    Args:
        story: what `story` made of the log.
        status: of the log.
        replayed: what deciding again has shown.
        measured: what the log says of the arm's way; None where it says nothing.
    """
    warning = NOT_BELIEVED.get(status, "" if replayed.good is not False else DECIDED_OTHERWISE)
    return Answers(
        outcome=_outcome(story),
        good=_final(story) == DONE and not warning,
        warning=warning,
        facts=tuple(_facts(story, status, replayed)),
        allowed=tuple(_allowed(story)),
        stopped=tuple(_stopped(story)),
        close=tuple(_close(story, measured)),
    )


def _final(story: Mapping[str, Any]) -> str:
    return str((story["closed"] or {}).get("final_state", ""))


def _outcome(story: Mapping[str, Any]) -> str:
    """In one sentence."""
    if story["stop"] is not None:
        return _stop_outcome(story["stop"])
    if _final(story) == DONE:
        return "The path was allowed and cut to its end; nothing stopped it."
    if story["closed"] is None:
        return "The log has no end: the session was broken off before anything moved."
    if "start" not in _left(story):
        return "REFUSED: cutting was not allowed, and nothing moved."
    return f"The session ended as: {_final(story) or 'it does not say how'}."


def _stop_outcome(stop: Mapping[str, Any]) -> str:
    if broken_off(stop):
        return f"BROKEN OFF while {phase_words(stop)}: {stop['reason']}."
    if stop["moving"]:
        return f"STOPPED while {phase_words(stop)}: {stop['text']}"
    return f"STOPPED before anything moved: {stop['text']}"


def broken_off(stop: Mapping[str, Any]) -> bool:
    """Whether there was no stop: the log ends while the arm could move."""
    return bool(stop["reason"] == BROKEN_OFF["reason"])


def _left(story: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """When permit and start left."""
    return {one["what"]: one for one in story["allowed"]}


# ---------------------------------------------------------------- facts


def _facts(story: Mapping[str, Any], status: Status, replayed: Fact) -> Iterator[Fact]:
    opened = story["opened"]
    yield Fact("Log", str(story["judgement"]), status is Status.OK, "integrity")
    yield replayed
    verdict = next(reversed(story["verdicts"]), None)
    if verdict is not None:
        yield Fact(
            "Verdict",
            str(verdict.get("verdict", "")).upper(),
            verdict.get("verdict") == "admissible",
            "decisions",
        )
    tightest = tightest_of(story)
    if tightest is not None:
        yield Fact("Nearest limit", boundary_words(tightest), not tightest.get("violated"), "place")
    yield from _options(opened)
    yield Fact("Opened", f"{_moment(opened.get('utc_ns'))}{_lasted(story)}")
    yield Fact("Who", who(opened) or "not recorded")


def _options(opened: Mapping[str, Any]) -> Iterator[Fact]:
    """Whether the controller may have been a simulated one; and what else was set."""
    given = opened.get("simulation")
    options = [one for one in given if isinstance(one, Mapping)] if isinstance(given, list) else []
    simulated = [one.get("value") for one in options if one.get("name") == SIMULATED]
    if simulated:
        yield Fact("Simulation", f"YES: {SIMULATED}, {simulated[0]}")
    else:
        yield Fact("Simulation", "no simulated controller was allowed")
    others = [f"{one.get('name')} {one.get('value')}" for one in options if one.get("name") != SIMULATED]
    if others:
        yield Fact("Options", "; ".join(others))


def _moment(utc_ns: object) -> str:
    if not isinstance(utc_ns, int) or not 0 < utc_ns < 2**62:
        return "at a time that is not known"
    return f"{datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _lasted(story: Mapping[str, Any]) -> str:
    closed = story["closed"]
    return f", for {closed['offset_s']:.1f} s" if closed else ""


# ---------------------------------------------------------------- was it allowed, and why


def _allowed(story: Mapping[str, Any]) -> Iterator[str]:
    left = _left(story)
    for what in SENT.values():
        if what in left:
            asked = left[what]["permissives"]
            held = sum(entry.get("holds") is True for entry in asked)
            yield (
                f"The {what} left at {left[what]['offset_s']:.3f} s: {held} of {len(asked)} permissives held, "
                "and its record was on the disk before."
            )
    if "start" not in left:
        yield (
            "No: cutting was never started."
            if "permit" in left
            else "No: no permit left, so that nothing could move."
        )
    verdict = next(reversed(story["verdicts"]), None)
    if verdict is None:
        yield "No verdict was reached."
    elif verdict.get("reason"):
        yield f"Verdict: {verdict['reason']}."
    if "permit" not in left:
        yield from _move(verdict or {})
    if "start" not in left and story["stop"] is None:
        yield from _why_not(story, since_s=left["permit"]["offset_s"] if "permit" in left else 0.0)


def _why_not(story: Mapping[str, Any], since_s: float) -> Iterator[str]:
    """The permissives that did not hold when it was decided last, of what was decided since then."""
    steps = [failing(one) for one in story["decisions"] if one["offset_s"] > since_s]
    found: list[dict[str, Any]] = next(filter(None, reversed(steps)), [])
    own = [entry for entry in found if str(entry.get("name")) not in FOLLOWING]
    found = [entry for entry in own or found if entry.get("name") != VERDICT]  # that is told already
    for entry in found[:SHOWN_FAILING]:
        told = f"{entry.get('name')}: {value_of(entry)} (required: {entry.get('bound')})"
        yield f"Did not hold: {told}. {_sentence(entry.get('remedy'))}."
    if len(found) > SHOWN_FAILING:
        yield f"{len(found) - SHOWN_FAILING} more did not hold."


def _sentence(text: object) -> str:
    told = str(text or "")
    return told[:1].upper() + told[1:]


def _move(verdict: Mapping[str, Any]) -> Iterator[str]:
    """Where the bone was to be moved."""
    guidance = verdict.get("guidance")
    if not isinstance(guidance, Mapping):
        return
    move = guidance.get("translation_mm")
    if not isinstance(move, list) or len(move) != 3 or not all(map(is_number, move)):
        yield "No translation was found that admits the path."
        return
    turn = guidance.get("yaw_deg")
    turned = f", turned by {turn:+g} deg about the vertical" if is_number(turn) and turn else ""
    proved = "verified" if guidance.get("verified") is True else "NOT verified"
    x, y, z = move
    yield f"What was to be done: move the bone by x {x:+g}, y {y:+g}, z {z:+g} mm{turned} ({proved}), then register it again."


# ---------------------------------------------------------------- what stopped it


def _stopped(story: Mapping[str, Any]) -> Iterator[str]:
    stop = story["stop"]
    if stop is None:
        yield (
            "Nothing: it came to its end."
            if _final(story) == DONE
            else "Nothing moved, so that nothing was to be stopped."
        )
        return
    cause = f" ({stop['cause']}, while {phase_words(stop)})"
    if broken_off(stop):
        yield f"{_sentence(stop['reason'])} ({phase_words(stop)})."
    elif str(stop["reason"]).casefold().rstrip(".") == str(stop["text"]).casefold().rstrip("."):
        yield f"{stop['text']}{cause}"
    else:
        yield f"{stop['text']}{cause}" + (f" What was found: {stop['reason']}." if stop["reason"] else "")
    yield " ".join(f"{_sentence(label)}: {text}." for label, text in place_words(stop)) + _length(stop)
    yield f"At rest: {rest_words(stop)}."
    yield from _then(story)
    yield "What was to be done next: " + " ".join(stop["next"])


def _length(stop: Mapping[str, Any]) -> str:
    """How much of the path was cut, mm of how many; empty where that is not known."""
    where = stop["where"]
    if (
        where is None
        or where["segment"] is None
        or where["leg"] not in (CUT, None)
        or not where["percent"] < 100.0
    ):
        return ""
    whole_mm = where["to_go_mm"] / (1.0 - where["percent"] / 100.0)
    return f" Cut: {whole_mm - where['to_go_mm']:.1f} mm of {whole_mm:.1f} mm."


def _then(story: Mapping[str, Any]) -> Iterator[str]:
    """What both sides and the operator did from the stop on."""
    steps = [one for one in story["decisions"] if one.get("first_out")]
    if not steps:
        return
    at_s = steps[0]["offset_s"]
    told = [f"the runtime stopped at {at_s:.3f} s"]
    states = [one for one in story["controller"] if one["offset_s"] >= at_s]
    told += [f"the controller said {one.get('state')} at {one['offset_s']:.3f} s" for one in states[:2]]
    words = [one for one in story["operator"] if one["offset_s"] >= at_s]
    told += [f"the operator said {one.get('word')} at {one['offset_s']:.3f} s" for one in words[:3]]
    yield f"Then: {'; '.join(told)}."


# ---------------------------------------------------------------- how close did it come


def tightest_of(story: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The boundary of the last verdict whose certified clearance exceeds its deadband least, in deadbands."""
    verdict = next(reversed(story["verdicts"]), None)
    boundaries = verdict["boundaries"] if verdict is not None else []
    return min(boundaries, key=_margin, default=None)


def _margin(boundary: Mapping[str, Any]) -> float:
    certified, deadband = boundary.get("certified"), boundary.get("deadband")
    if not is_number(certified) or not is_number(deadband) or not deadband > 0.0:
        return math.inf  # undefined is no number to be told as the tightest, where another is one
    return certified / deadband


def boundary_words(boundary: Mapping[str, Any]) -> str:
    """Clearance, deadband and place; a clearance is never told as more than is proved."""
    unit, certified = boundary.get("unit", ""), boundary.get("certified")
    told = f"{boundary.get('name')}: {measure(certified, unit)} (required: {plain(boundary.get('deadband'))} {unit})"
    if "segment" in boundary:
        length = boundary.get("tip_length_mm")
        along = f", {length:.1f} mm along the path" if is_number(length) else ""
        told += f", at segment {boundary['segment']}{along}"
    return told


def _close(story: Mapping[str, Any], measured: Measured | None) -> Iterator[str]:
    tightest = tightest_of(story)
    if tightest is None:
        yield "No clearance was computed: no verdict was reached."
    else:
        violated = [one for one in story["verdicts"][-1]["boundaries"] if one.get("violated") is not False]
        if violated:
            yield f"Too close, by the proved bounds of the whole path: {'; '.join(map(boundary_words, violated))}."
        else:
            yield f"As proved for the whole path before the cut, nearest was {boundary_words(tightest)}."
    approach = next(reversed(story["approaches"]), None)
    if approach is not None and is_number(approach.get("worst_certified")):
        leg, boundary = approach.get("worst_leg"), approach.get("worst_boundary")
        known = story["verdicts"][-1]["boundaries"] if story["verdicts"] else []
        unit = next((one.get("unit") for one in known if one.get("name") == boundary), "")
        yield f"On approach and retract, nearest was {boundary} on the {leg}: {measure(approach['worst_certified'], unit)}."
    if measured is not None:
        yield measured.words
    elif "start" in _left(story):
        yield "How far the moving arm was from the path is not in this log."
    else:
        yield "The arm did not move."
