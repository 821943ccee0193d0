"""Decisions as cards: what was decided, why in a sentence, and everything that it rested on."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from cutgate.runtime.interlock.phases import ENDED, STOPPING
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.report.markup import Markup, joined, listed, pairs, table, tag
from cutgate.runtime.review.report.numbers import seconds, state, text_of
from cutgate.runtime.review.show import value_of
from cutgate.runtime.review.stopped import WORDS
from cutgate.runtime.review.story import SENT, failing, permissives_of

CARDS_MAX: Final = 200
"""A session decides some ten times; how many more a log claims is said."""
GOOD: Final = "good"
BAD: Final = "bad"
_RESET: Final = {"send Reset": "reset"}
_INPUTS: Final = ("path", "limits", "calibration", "tool", "registration", "configuration")


@dataclass(frozen=True)
class Card:
    """One decision.

    Attributes:
        id: of its element, by which time line and frames refer to it.
        t_s: since record 0.
        title: what was decided.
        kind: `GOOD` or `BAD`: whether something was enabled or completed, or refused or stopped.
        why: a sentence.
        decision: its record.
        inputs: name and SHA-256 of what it was decided on.
    """

    id: str
    t_s: float
    title: str
    kind: str
    why: str
    decision: Mapping[str, Any]
    inputs: tuple[tuple[str, str], ...] = ()


def cards_of(story: Mapping[str, Any], prefix: str = "c") -> list[Card]:
    """The cards of a session, in the order of the log; at most `CARDS_MAX`.

    Args:
        story: what ``story`` made of the log.
        prefix: of the ids; each session of a page has its own.
    """
    return [
        Card(
            f"{prefix}{number}",
            seconds(decision.get("offset_s")),
            *_told(decision, story),
            decision,
            _inputs(decision, story),
        )
        for number, decision in enumerate(_decisive(story["decisions"])[:CARDS_MAX], 1)
    ]


def section(story: Mapping[str, Any], cards: list[Card]) -> Markup:
    """Every card.

    Args:
        story: what ``story`` made of the log.
        cards: as ``cards_of`` made them of it.
    """
    more = len(_decisive(story["decisions"])) - len(cards)
    left_out = tag("p", f"{more} decisions more are in the log.") if more else Markup()
    none = Markup() if cards else tag("p", "The log holds no decision.")
    return joined([none, *(_card(card) for card in cards), left_out])


def _decisive(decisions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those by which something was admitted, enabled, withheld, refused, stopped or ended."""
    return [one for one in decisions if _is_decisive(one)]


def _is_decisive(one: Mapping[str, Any]) -> bool:
    before, after = one.get("from_state"), one.get("to_state")
    moved = before != after
    return (
        one.get("disposition") in ("sent", "withheld")
        or _stops(one)
        or (moved and before == Phase.VERIFYING)
        or (moved and after in ENDED)
    )


def _stops(one: Mapping[str, Any]) -> bool:
    return one.get("from_state") not in STOPPING and one.get("to_state") in STOPPING


def _sent(one: Mapping[str, Any]) -> str:
    """What left with this decision; empty where nothing that enables did."""
    effects = one.get("effects")
    for effect in effects if isinstance(effects, list) else ():
        if isinstance(effect, str) and effect in SENT | _RESET:
            return (SENT | _RESET)[effect]
    return ""


def _told(one: Mapping[str, Any], story: Mapping[str, Any]) -> tuple[str, str, str]:
    """Title, kind and the sentence. What stopped is said before what left: a stop is never shown as something good."""
    reason, after = text_of(one, "reason"), one.get("to_state")
    missing = failing(one)
    if _stops(one):
        cause = text_of(one, "first_out")
        words = next((text for known, text in WORDS.items() if known.name == cause), "")
        return "stop", BAD, _sentence(words, reason)
    if one.get("disposition") == "withheld":
        return "withheld: nothing left", BAD, _sentence("It was authorised and did not leave.", reason)
    if one.get("disposition") == "sent" and _sent(one):
        count = len(permissives_of(one))
        all_held = f"Every one of its {count} permissives held as it left." if count else ""
        held = all_held if not missing else f"{len(missing)} of its {count} permissives did NOT hold."
        return f"{_sent(one)} left", BAD if missing else GOOD, _sentence(held, reason)
    if one.get("from_state") == Phase.VERIFYING:
        found = text_of(story["verdicts"][-1], "verdict") if story["verdicts"] else "none"
        good = found == "admissible" and after not in ENDED
        why = reason or (text_of(story["verdicts"][-1], "reason") if story["verdicts"] else "")
        return f"verdict: {found}", GOOD if good else BAD, why
    return f"end: {state(after)}", GOOD if after == Phase.DONE else BAD, reason


def _sentence(*parts: str) -> str:
    return " ".join(filter(None, parts))


def _inputs(one: Mapping[str, Any], story: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The digests that a permit bound, or of what the verdict is."""
    kind = _sent(one)
    permits = [entry for entry in story["permits"] if entry.get("kind") == "permit"]
    source: Mapping[str, Any] = {}
    if kind in ("permit", "start") and permits:
        source = permits[-1]
    elif one.get("from_state") == Phase.VERIFYING and story["verdicts"]:
        source = story["verdicts"][-1]
    found = ((name, text_of(source, f"{name}_sha256")) for name in _INPUTS)
    return tuple((name, digest) for name, digest in found if digest)


def _card(card: Card) -> Markup:
    return tag(
        "article",
        tag("h3", tag("span", _SHAPES[card.kind], class_="shape"), f" {card.title} at {card.t_s:.3f} s"),
        tag("p", card.why) if card.why else "",
        *_body(card),
        tag("div", class_="frames", data_card=card.id),
        class_=f"card {card.kind}",
        id=card.id,
    )


_SHAPES: Final = {GOOD: "\N{HEAVY CHECK MARK}", BAD: "\N{HEAVY BALLOT X}"}
"""A state is told by its shape as well as by its colour."""


def _body(card: Card) -> Iterator[Markup]:
    """From which state to which, first-out, permissives and inputs."""
    one = card.decision
    yield pairs(
        (
            ("step", f"{state(one.get('from_state'))} \N{RIGHTWARDS ARROW} {state(one.get('to_state'))}"),
            ("on", text_of(one, "event")),
            ("disposition", text_of(one, "disposition")),
            ("first-out", text_of(one, "first_out")),
        )
    )
    entries = permissives_of(one)
    bad = failing(one)
    if bad:
        yield tag("h4", "What did not hold, and what to do")
        yield listed(
            f"{text_of(entry, 'name')}: {value_of(entry)}, required: {text_of(entry, 'bound')}. "
            f"Remedy: {text_of(entry, 'remedy')}"
            for entry in bad
        )
    if entries:
        yield _folded(
            f"Permissives: {len(entries) - len(bad)} of {len(entries)} hold",
            table(
                ("permissive", "holds", "value", "required", "remedy"),
                (
                    (
                        text_of(entry, "name"),
                        "yes" if entry.get("holds") is True else "NO",
                        value_of(entry),
                        text_of(entry, "bound"),
                        "" if entry.get("holds") is True else text_of(entry, "remedy"),
                    )
                    for entry in entries
                ),
                class_="permissives",
            ),
        )
    if card.inputs:
        yield _folded(
            "Inputs, by SHA-256",
            table(
                ("input", "SHA-256"),
                ((name, tag("code", digest)) for name, digest in card.inputs),
                class_="inputs",
            ),
        )


def _folded(title: str, body: Markup) -> Markup:
    return tag("details", tag("summary", title), body)
