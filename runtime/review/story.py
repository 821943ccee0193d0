"""A log as one document for people: what was decided, when, why, and where the files are."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import (
    Approach,
    Attachment,
    AuditRecord,
    Boundary,
    Close,
    Collected,
    Decision,
    Fault,
    Guidance,
    Open,
    Operator,
    Permit,
    Process,
    Verdict,
)

SCHEMA = "cutgate.audit-show/1"
_STAMPS = set(AuditRecord.model_fields)
_NANOSECONDS_MAX = 1 << 64
"""What a log's own times can hold; JSON has integers without end."""


def story(log: Log, path: Path, candump: Path | None) -> dict[str, Any]:
    """What ``cutgate audit show --json`` prints. Never raises, whatever the log holds.

    Args:
        log: the log as read.
        path: its file.
        candump: the raw frames beside it, or None if they are not there.
    """
    opened = _first(log, Open)
    start_ns = _nanoseconds(opened.get("monotonic"))
    timed = {
        model: [_entry(record, start_ns) for record in log.of(model.TOPIC) if record]  # empty: not JSON
        for model in (
            Decision,
            Collected,
            Verdict,
            Boundary,
            Approach,
            Guidance,
            Permit,
            Fault,
            Operator,
            Process,
            Attachment,
        )
    }
    return {
        "schema": SCHEMA,
        "log": str(path),
        "candump": None if candump is None else str(candump),
        "judgement": log.report.headline,
        "reasons": list(log.report.reasons),
        "notes": list(log.report.notes),
        "messages": log.report.messages,
        "head": log.report.head,
        "opened": _entry(opened, start_ns) | {"utc_ns": _nanoseconds(opened.get("utc"))},
        "verdicts": _verdicts(timed[Verdict], timed[Boundary], timed[Guidance]),
        "approaches": timed[Approach],
        "decisions": timed[Decision],
        "collected": timed[Collected],
        "permits": timed[Permit],
        "faults": timed[Fault],
        "operator": timed[Operator],
        "processes": timed[Process],
        "attachments": timed[Attachment],
        "closed": _entry(_first(log, Close), start_ns) or None,
    }


def failing(decision: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The permissives of a decision that did not hold."""
    permissives = decision.get("permissives")
    entries = permissives if isinstance(permissives, list) else []
    return [entry for entry in entries if isinstance(entry, dict) and entry.get("holds") is not True]


def _verdicts(
    verdicts: list[dict[str, Any]], boundaries: list[dict[str, Any]], guidance: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Each verdict with the boundaries, and the guidance, recorded from it until the next one."""
    found = []
    for number, verdict in enumerate(verdicts):
        start = verdict["offset_s"]
        end = verdicts[number + 1]["offset_s"] if number + 1 < len(verdicts) else float("inf")
        own, told = (
            [entry for entry in entries if start <= entry["offset_s"] < end]
            for entries in (boundaries, guidance)
        )
        note = next((entry["note"] for entry in told if "note" in entry), None)
        noted = {} if note is None else {"guidance_note": note}
        found.append({**verdict, "boundaries": own, "guidance": _guidance(verdict, told), **noted})
    return found


def _guidance(verdict: Mapping[str, Any], told: list[dict[str, Any]]) -> dict[str, Any] | None:
    """How the bone was to be moved, by its own record or, in logs of 0.1.0, by the verdict's document; else None."""
    for document in (_json(verdict).get("guidance"), *map(_json, told)):
        if isinstance(document, dict) and document:
            return document
    return None


def _json(record: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a record; empty where it has none that can be read."""
    try:
        document = json.loads(record["document"])
    except (KeyError, TypeError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def _first(log: Log, model: type[AuditRecord]) -> dict[str, Any]:
    return next(iter(log.of(model.TOPIC)), {})


def _entry(record: Mapping[str, Any], start_ns: int) -> dict[str, Any]:
    """A record without its chain and clocks, but with seconds since record 0."""
    if not record:
        return {}
    offset_s = (_nanoseconds(record.get("monotonic")) - start_ns) / 1e9
    return {"offset_s": offset_s} | {key: value for key, value in record.items() if key not in _STAMPS}


def _nanoseconds(time: object) -> int:
    """A stored time; 0 where it is none."""
    if isinstance(time, dict) and isinstance(time.get("sec"), int) and isinstance(time.get("nsec"), int):
        found = int(time["sec"]) * 1_000_000_000 + int(time["nsec"])
        return found if abs(found) < _NANOSECONDS_MAX else 0
    return 0
