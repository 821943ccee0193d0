"""The time line: what runtime and controller were doing, and what was decided, found and said, second by second."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from cutgate.protocol.states import ControllerState
from cutgate.runtime.interlock.phases import ENDED, MOVING, STOPPING
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.report.cards import BAD, GOOD, Card
from cutgate.runtime.review.report.markup import Markup, joined, table, tag
from cutgate.runtime.review.report.numbers import seconds, state, text_of
from cutgate.runtime.review.show import refused, runs, value_of, who, witness_line
from cutgate.runtime.review.story import failing

ROWS_MAX: Final = 1500
MARKS_MAX: Final = 500
"""Of each lane; how many more there are is said in the table of the time line."""
NOTE: Final = "note"
_READY: Final = frozenset(
    {Phase.ADMITTED, Phase.NONCE_PERMIT, Phase.AUTHORISING_PERMIT, Phase.PERMITTING, Phase.PERMITTED}
    | {Phase.NONCE_START, Phase.AUTHORISING_START}
)
_CONTROLLER: Final[dict[str, str]] = {
    ControllerState.CUTTING.name: "moving",
    ControllerState.PERMITTED.name: "ready",
    ControllerState.DONE.name: "ended",
    ControllerState.INHIBITED.name: "stopping",
    ControllerState.FAULT.name: "fault",
}
"""Kinds of the controller's states; any other is idle."""


def kind_of(phase: object) -> str:
    """How a phase of the runtime is shown: idle, ready, moving, stopping, fault or ended."""
    kinds = ((MOVING, "moving"), ({Phase.STOPPED}, "fault"), (STOPPING, "stopping"), (ENDED, "ended"))
    found = next((kind for phases, kind in kinds if phase in phases), None)
    return found or ("ready" if phase in _READY else "idle")


def duration_s(story: Mapping[str, Any]) -> float:
    """From record 0 to the last record that is shown, s."""
    entries = [*_all(story), *([story["closed"]] if story["closed"] else [])]
    return max((seconds(entry.get("offset_s")) for entry in entries), default=0.0)


def lanes(story: Mapping[str, Any], cards: Sequence[Card]) -> list[dict[str, Any]]:
    """The lanes of the time line.

    Args:
        story: what ``story`` made of the log.
        cards: its decisions.
    """
    end_s = duration_s(story)
    steps = [(seconds(one.get("offset_s")), text_of(one, "to_state")) for one in story["decisions"]]
    first = text_of(story["decisions"][0], "from_state") if story["decisions"] else ""
    runtime = [(0.0, first), *steps] if first else steps
    reported = [(seconds(one.get("offset_s")), text_of(one, "state")) for one in story["controller"]]
    return [
        {"name": "runtime", "spans": _spans(runtime, end_s, kind_of)},
        {
            "name": "controller",
            "spans": _spans(reported, end_s, lambda name: _CONTROLLER.get(str(name), "idle")),
        },
        {"name": "verdict", "marks": _verdict_marks(story, cards)},
        {"name": "permissives", "marks": _card_marks(cards)},
        {
            "name": "faults",
            "marks": [
                _mark(entry, f"{text_of(entry, 'cause')} {text_of(entry, 'detail')}".strip(), BAD)
                for entry in story["faults"][:MARKS_MAX]
            ],
        },
        {
            "name": "operator",
            "marks": [
                _mark(entry, _word(entry), NOTE if entry.get("accepted") is True else BAD)
                for entry in story["operator"][:MARKS_MAX]
            ],
        },
    ]


def section(story: Mapping[str, Any], cards: Sequence[Card]) -> Markup:
    """Every step of both sides in words, faults, what the operator said and where.

    Args:
        story: what ``story`` made of the log.
        cards: its decisions, to which the rows lead.
    """
    rows = sorted(_rows(story, cards), key=lambda row: row[0])
    shown = [(f"{at_s:.3f}", who_, what, why) for at_s, who_, what, why in rows[: ROWS_MAX // 2]]
    rest = rows[ROWS_MAX // 2 :]
    if len(rest) > ROWS_MAX // 2:
        left_out = len(rest) - ROWS_MAX // 2
        shown.append(("", "", f"{left_out} rows are left out here; the log has them", ""))
        rest = rest[-(ROWS_MAX // 2) :]
    shown += [(f"{at_s:.3f}", who_, what, why) for at_s, who_, what, why in rest]
    said_by = who(story["opened"])
    named = tag("p", f"Words of the operator were said here: {said_by}.") if said_by else Markup()
    return joined([named, table(("time s", "who", "what", "why"), shown, class_="timeline")])


def _all(story: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    for name in (
        "verdicts",
        "decisions",
        "permits",
        "faults",
        "operator",
        "collected",
        "witness",
        "controller",
    ):
        yield from story[name]


def _spans(steps: Sequence[tuple[float, str]], end_s: float, kind: Any) -> list[dict[str, Any]]:
    """States that follow each other; one that goes on is one span."""
    spans: list[dict[str, Any]] = []
    for at_s, name in steps[:ROWS_MAX]:
        if spans and spans[-1]["_"] == name:
            continue
        if spans:
            spans[-1]["to_s"] = max(at_s, spans[-1]["from_s"])
        spans.append({"from_s": at_s, "to_s": end_s, "state": state(name), "kind": kind(name), "_": name})
    return [{key: value for key, value in span.items() if key != "_"} for span in spans]


def _mark(entry: Mapping[str, Any], text: str, kind: str, card: str | None = None) -> dict[str, Any]:
    return {"t_s": seconds(entry.get("offset_s")), "text": text, "kind": kind, "card": card}


def _card_marks(cards: Sequence[Card]) -> list[dict[str, Any]]:
    return [{"t_s": card.t_s, "text": card.title, "kind": card.kind, "card": card.id} for card in cards]


def _verdict_marks(story: Mapping[str, Any], cards: Sequence[Card]) -> list[dict[str, Any]]:
    """Each verdict; a mark leads to the decision that followed it."""
    found = []
    for verdict in story["verdicts"][:MARKS_MAX]:
        name, at_s = text_of(verdict, "verdict"), seconds(verdict.get("offset_s"))
        card = next((c.id for c in cards if c.title.startswith("verdict") and c.t_s >= at_s), None)
        found.append(_mark(verdict, name, GOOD if name == "admissible" else BAD, card))
    return found


def _rows(story: Mapping[str, Any], cards: Sequence[Card]) -> Iterator[tuple[float, str, object, object]]:
    """Time, who, what, why."""
    at = {id(card.decision): card for card in cards}
    for first, count in runs(story["decisions"]):
        yield seconds(first.get("offset_s")), "runtime", _step(first, count, at.get(id(first))), _why(first)
    for entry in story["controller"]:
        cause = text_of(entry, "cause")
        told = f", cause {cause}" if cause not in ("", "NONE") else ""
        yield seconds(entry.get("offset_s")), "controller", f"{state(text_of(entry, 'state'))}{told}", ""
    for entry in story["faults"]:
        text = f"fault: {text_of(entry, 'cause')}"
        yield seconds(entry.get("offset_s")), text_of(entry, "source"), text, text_of(entry, "detail")
    for entry in story["operator"]:
        yield seconds(entry.get("offset_s")), "operator", _word(entry), refused(entry).strip()
    for entry in story["collected"]:
        kind, same = text_of(entry, "kind"), entry.get("matches_approved") is True
        what = f"{kind} {'equal' if same else 'NOT equal to'} the approved"
        yield seconds(entry.get("offset_s")), "controller", what, text_of(entry, "difference")
    for entry in story["witness"]:
        yield seconds(entry.get("offset_s")), "controller", witness_line(entry), ""
    if story["closed"]:
        outcome = text_of(story["closed"], "outcome")
        yield seconds(story["closed"].get("offset_s")), "runtime", "log closed", outcome


def _word(entry: Mapping[str, Any]) -> str:
    return f"{text_of(entry, 'word')} {text_of(entry, 'what')}".strip()


def _step(first: Mapping[str, Any], count: int, card: Card | None) -> Markup:
    """From state to state, on what, with a link to the card where there is one."""
    before, after = (state(first.get(name)) for name in ("from_state", "to_state"))
    moved = before if before == after else f"{before} \N{RIGHTWARDS ARROW} {after}"
    times = f" (\N{MULTIPLICATION SIGN}{count})" if count > 1 else ""
    disposition = text_of(first, "disposition")
    how = "" if disposition in ("", "decided") else f", {disposition.upper()}"
    text = f"{moved}, on {text_of(first, 'event')}{times}{how}"
    return joined([tag("a", text, href=f"#{card.id}") if card else text])


def _why(decision: Mapping[str, Any]) -> str:
    """First-out, reason, and each permissive that does not hold; what a screen's time line says, on one line."""
    missing = [
        f"{text_of(entry, 'name')}: {value_of(entry)} (required: {text_of(entry, 'bound')})"
        for entry in failing(decision)
    ]
    first_out, reason = text_of(decision, "first_out"), text_of(decision, "reason")
    known = any(reason in line for line in missing)
    return "; ".join(
        filter(None, (f"first-out {first_out}" if first_out else "", "" if known else reason, *missing))
    )
