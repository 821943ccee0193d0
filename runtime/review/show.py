"""The story of a log on a terminal: readable at 100 columns, and as plain text when piped."""

import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from itertools import groupby
from typing import Any, Final

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from cutgate.config.screen import printable
from cutgate.runtime.review.stop_words import phase_words, place_words, rest_words
from cutgate.runtime.review.stopped import SAFE
from cutgate.runtime.review.story import failing

GOOD: Final = "bold green"
BAD: Final = "bold red"
_DIGEST: Final = 16
_SHOWN_MAX: Final = 1e15
_UNIT: Final = re.compile(r"[<>]= [-+.e0-9]+ (\S+)")
"""A bound with a unit."""
"""A number beyond it is none that a session wrote."""


def print_story(console: Console, story: Mapping[str, Any]) -> None:
    """Print the document that ``story`` makes."""
    _head(console, story)
    for verdict in story["verdicts"]:
        _verdict(console, verdict)
    for approach in story["approaches"]:
        _approach(console, approach)
    if story["allowed"]:
        _allowed(console, story["allowed"])
    if story["stop"] is not None:
        console.print()
        console.print(*stop_lines(story["stop"]), sep="\n")
    print_time_line(console, story["decisions"])
    _facts(console, story)
    _files(console, story)


def stop_lines(stop: Mapping[str, Any]) -> list[RenderableType]:
    """What is told after a stop (`stop_document`): a block of its own."""
    told = Table.grid(padding=(0, 2, 0, 0))
    told.add_row("  what", Text(printable(f"{stop['text']} ({stop['cause']}, while {phase_words(stop)})")))
    for label, text in place_words(stop):
        told.add_row(f"  {label}", Text(text))
    told.add_row("  at rest", _at_rest(stop))
    steps = Table.grid(padding=(0, 1, 0, 0))
    for number, step in enumerate(stop["next"], 1):
        steps.add_row(f"  {number}.", Text(printable(step), BAD if step in SAFE else ""))
    reason = f": {printable(stop['reason'])}" if stop["reason"] else ""
    return [Text.assemble(("STOPPED", BAD), reason), told, Text("What to do next", "bold"), steps]


def _at_rest(stop: Mapping[str, Any]) -> Text:
    return Text(
        rest_words(stop), GOOD if stop["confirmed"] else BAD if stop["moving"] or stop["where"] else ""
    )


def _head(console: Console, story: Mapping[str, Any]) -> None:
    opened, closed = story["opened"], story["closed"]
    utc_ns = opened.get("utc_ns", 0)
    moment = datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC) if 0 <= utc_ns < 2**62 else None
    style = GOOD if story["judgement"].startswith("OK") else BAD
    judgement = (printable(story["judgement"]), style)
    console.print(Text.assemble(f"Session log {_text(opened, 'log_id')[:_DIGEST]}: ", judgement))
    for reason in (*story["reasons"], *story["notes"]):
        console.print(f"  {printable(str(reason))}")
    rows = {
        "opened": f"{moment:%Y-%m-%d %H:%M:%S} UTC" if moment else "",
        "software": f"{_text(opened, 'software')}, verifier {_text(opened, 'verifier')}",
        "previous session": _previous(opened),
        "who": who(opened),
        "simulation": ", ".join(
            f"{_text(option, 'name')} {_text(option, 'value')}" for option in _entries(opened, "simulation")
        ),
        "ended": _ending(closed) if closed else "no close record",
        "bus": _bus(closed or {}),
    }
    _pairs(console, rows)


def who(opened: Mapping[str, Any]) -> str:
    """Account and host, which the operating system knows, and the name that was given."""
    account, host, operator = (_text(opened, key) for key in ("account", "host", "operator"))
    parts = (operator and f"operator {operator}", account and f"account {account}", host and f"on {host}")
    return ", ".join(filter(None, parts))


def _previous(opened: Mapping[str, Any]) -> str:
    name, note = _text(opened, "previous_log"), _text(opened, "previous_note")
    crashed = opened.get("previous_crashed") is True
    return f"{name}{' CRASHED' * crashed}{f' ({note})' * bool(note)}".strip() or "none in this directory"


def _ending(closed: Mapping[str, Any]) -> str:
    parts = [_text(closed, "final_state"), _text(closed, "outcome")]
    clean = "" if closed.get("clean") is True else "NOT in order"
    return ", ".join(filter(None, [*parts, f"after {closed['offset_s']:.3f} s", clean]))


def _bus(closed: Mapping[str, Any]) -> str:
    """What of the controller's frames did not come, came twice or came damaged; nothing where all was well."""
    counts = closed.get("bus")
    if not isinstance(counts, Mapping):
        return ""
    names = {"losses": "lost", "repetitions": "repeated", "crc_failures": "damaged"}
    found = {told: _text(counts, key) for key, told in names.items() if counts.get(key, 0) != 0}
    return ", ".join(f"{count} {told}" for told, count in found.items()) + " frames of the controller" * bool(
        found
    )


def _verdict(console: Console, verdict: Mapping[str, Any]) -> None:
    found = _text(verdict, "verdict")
    style = GOOD if found == "admissible" else BAD
    console.print()
    poses = printable(str(verdict.get("poses", "?")))
    how = f" ({_text(verdict, 'method')}, {poses} poses, {_number(verdict.get('elapsed_ms'))} ms)"
    console.print(Text.assemble("Verdict: ", (found.upper(), style), how))
    if verdict.get("reason"):
        console.print(f"  {_text(verdict, 'reason')}")
    table = _table("boundary", "certified", "clearance", "deadband", "unit", "worst place", "")
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for entry in verdict["boundaries"]:
        violated = entry.get("violated") is not False
        table.add_row(
            _text(entry, "name"),
            _number(entry.get("certified")),
            _number(entry.get("clearance")),
            _number(entry.get("deadband")),
            _text(entry, "unit"),
            f"segment {_text(entry, 'segment')} at {_number(entry.get('fraction'))}"
            if "segment" in entry
            else "",
            Text("VIOLATED" if violated else "", style=BAD),
        )
    console.print(table)
    for warning in verdict["warnings"]:
        console.print(f"WARNING {_text(warning, 'code')}: {_text(warning, 'text')}")
    if verdict["guidance"]:
        console.print(guidance_line(verdict["guidance"]))
    elif "guidance_note" in verdict:
        console.print(f"Guidance: none, {_text(verdict, 'guidance_note')}")


def _approach(console: Console, approach: Mapping[str, Any]) -> None:
    """Approach and retract in one line."""
    found = _text(approach, "verdict")
    style = GOOD if found == "admissible" else BAD
    where = f", entry {_um(approach, 'entry_um')} mm, exit {_um(approach, 'exit_um')} mm; "
    console.print(
        Text.assemble("Approach and retract: ", (found.upper(), style), where, _text(approach, "reason"))
    )


def _allowed(console: Console, allowed: list[dict[str, Any]]) -> None:
    """Why permit and start were allowed: everything that was asked as each left, with its value and bound."""
    console.print()
    console.print("Why it was allowed", style="bold")
    heads = [f"{_text(one, 'what')}, {one['offset_s']:.3f} s" for one in allowed]
    table = _table("permissive", *heads, "required")
    asked: dict[str, list[Text]] = {}
    bounds: dict[str, str] = {}
    for number, one in enumerate(allowed):
        for entry in one["permissives"]:
            name, holds = _text(entry, "name"), entry.get("holds") is True
            cells = asked.setdefault(name, [Text("")] * len(allowed))
            cells[number] = Text(value_of(entry)) if holds else Text(f"{value_of(entry)}: DID NOT HOLD", BAD)
            bounds[name] = _text(entry, "bound")
    for name, cells in asked.items():
        table.add_row(name, *cells, bounds[name])
    console.print(table)


def _um(record: Mapping[str, Any], key: str) -> str:
    value = record.get(key)
    return _number(value / 1000 if isinstance(value, int) and abs(value) <= _SHOWN_MAX else None)


def guidance_line(guidance: Mapping[str, Any]) -> str:
    """The combined move of the bone that was shown, in one line."""
    move = guidance.get("translation_mm")
    if not isinstance(move, list):
        return "Guidance: no translation was found that admits the path."
    turn = guidance.get("yaw_deg")
    turned = f", turn it by {_number(turn)} deg about the vertical" if turn else ""
    proved = "verified" if guidance.get("verified") is True else "NOT verified"
    return f"Guidance: move the bone by ({', '.join(map(_number, move))}) mm{turned} ({proved}), then register it again."


def print_time_line(
    console: Console, decisions: list[dict[str, Any]], title: str = "Time line of decisions"
) -> None:
    """The interlock's steps: when, from where to where, on what, and why."""
    console.print()
    console.print(title, style="bold")
    table = _table("time s", "state", "event", "", "why")
    table.columns[0].justify = "right"
    table.columns[4].ratio = 1
    for first, count in runs(decisions):
        before, after = (_text(first, name).replace("_", " ") for name in ("from_state", "to_state"))
        disposition = _text(first, "disposition")
        table.add_row(
            f"{first['offset_s']:.3f}",
            before if before == after else f"{before} -> {after}",
            _text(first, "event") + (f" (x{count})" if count > 1 else ""),
            "" if disposition == "decided" else disposition.upper(),
            _why(first),
        )
    console.print(table)


def runs(decisions: list[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], int]]:
    """Equal steps that follow each other as one line: the first, and how many."""

    def key(decision: dict[str, Any]) -> tuple[str, ...]:
        names = ("from_state", "to_state", "event", "disposition", "first_out")
        shown = tuple(_text(decision, name) for name in names)
        return shown if shown[0] == shown[1] else (*shown, str(decision.get("sequence")))

    for _, group in groupby(decisions, key):
        entries = list(group)
        yield entries[0], len(entries)


def _why(decision: Mapping[str, Any]) -> str:
    """First-out, reason, and each permissive that does not hold with its value, bound and remedy."""
    reason, first_out = _text(decision, "reason"), _text(decision, "first_out")
    missing = [
        f"{_text(entry, 'name')}: {value_of(entry)} (required: {_text(entry, 'bound')})"
        for entry in failing(decision)
    ]
    told_already = any(reason in line for line in missing)
    parts = [f"first-out {first_out}" if first_out else "", "" if told_already else reason, *missing]
    return "\n".join(filter(None, parts))


def value_of(permissive: Mapping[str, Any]) -> str:
    """A permissive's value, in the unit of its bound."""
    if "value" not in permissive:
        return _text(permissive, "text")
    value, unit = permissive["value"], _UNIT.fullmatch(_text(permissive, "bound"))
    whole = isinstance(value, float) and value.is_integer() and abs(value) <= _SHOWN_MAX
    return (f"{value:.0f}" if whole else _number(value)) + (f" {unit[1]}" if unit else "")


def _facts(console: Console, story: Mapping[str, Any]) -> None:
    """Faults, operator commands and the controller's records, as far as there are any."""
    lines = [
        *(
            (
                entry["offset_s"],
                f"operator: {_text(entry, 'word')} {_text(entry, 'what')}".rstrip() + refused(entry),
            )
            for entry in story["operator"]
        ),
        *(
            (
                entry["offset_s"],
                f"fault of the {_text(entry, 'source')}: {_text(entry, 'cause')} {_text(entry, 'detail')}",
            )
            for entry in story["faults"]
        ),
        *(
            (
                entry["offset_s"],
                f"the controller's {_text(entry, 'kind')} otherwise than approved: {_text(entry, 'difference')}",
            )
            for entry in story["collected"]
            if entry.get("matches_approved") is not True
        ),
        *((entry["offset_s"], witness_line(entry)) for entry in story["witness"]),
    ]
    if not lines:
        return
    console.print()
    for offset_s, text in sorted(lines):
        console.print(f"{offset_s:9.3f}  {text.strip()}")


def witness_line(entry: Mapping[str, Any]) -> str:
    """Whether the log was found that the controller saw at the start before this session."""
    reason = _text(entry, "reason")
    found = _text(entry, "log") if entry.get("found") is True else "NOT FOUND"
    return f"the log that the controller saw last: {': '.join(filter(None, (found, reason)))}"


def refused(entry: Mapping[str, Any]) -> str:
    """Why a word of the operator was not taken, in brackets; empty where it was."""
    return "" if entry.get("accepted") is True else f" (refused: {_text(entry, 'reason')})"


def _files(console: Console, story: Mapping[str, Any]) -> None:
    console.print()
    # Never wrapped, so that a path can be copied.
    for label, path in (("log", story["log"]), ("raw frames", story["candump"] or "not beside the log")):
        console.print(f"  {label:<11}  {printable(path)}", soft_wrap=True)
    rows = {
        "attachments": ", ".join(_text(entry, "name") for entry in story["attachments"]),
        "records": f"{story['messages']}, chain head {story['head'][:_DIGEST]}",
    }
    _pairs(console, rows)


def _pairs(console: Console, rows: Mapping[str, str]) -> None:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column()
    table.add_column(overflow="fold")
    for label, value in rows.items():
        if value:
            table.add_row(f"  {label}", value)
    console.print(table)


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, overflow="fold")  # a digit that is cut off makes another number
    return table


def _entries(record: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    value = record.get(key)
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def _text(record: Mapping[str, Any], key: str) -> str:
    """What a log says there, on one line: it is data."""
    value = record.get(key)
    return "" if value is None else printable(str(value))


def _number(value: object) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _SHOWN_MAX:
        return f"{value:.3f}"
    return "undefined"
