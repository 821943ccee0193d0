"""A log as one document for people: what was decided, when, why, and where the files are."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import DEFAULT_LIMIT
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit import names
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import (
    AuditApproach,
    AuditAttachment,
    AuditBoundary,
    AuditClose,
    AuditCollected,
    AuditController,
    AuditDecision,
    AuditFault,
    AuditGuidance,
    AuditOpen,
    AuditOperator,
    AuditPermit,
    AuditProcess,
    AuditRecord,
    AuditSession,
    AuditVerdict,
    AuditWitness,
    CanFrame,
)
from cutgate.runtime.interlock.phases import MOVING, STOPPING
from cutgate.runtime.review.last_seen import LastSeen
from cutgate.runtime.review.stopped import Stopped, Way, stop_document

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
    opened = _first(log, AuditOpen)
    start_ns = _nanoseconds(opened.get("monotonic"))
    timed = {
        model: [_entry(record, start_ns) for record in log.of(model.TOPIC) if record]  # empty: not JSON
        for model in (
            AuditDecision,
            AuditCollected,
            AuditVerdict,
            AuditBoundary,
            AuditApproach,
            AuditGuidance,
            AuditPermit,
            AuditWitness,
            AuditController,
            AuditFault,
            AuditOperator,
            AuditProcess,
            AuditAttachment,
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
        "session": _entry(_first(log, AuditSession), start_ns) or None,
        "verdicts": _verdicts(timed[AuditVerdict], timed[AuditBoundary], timed[AuditGuidance]),
        "approaches": timed[AuditApproach],
        "decisions": timed[AuditDecision],
        "collected": timed[AuditCollected],
        "permits": timed[AuditPermit],
        "witness": timed[AuditWitness],
        "controller": timed[AuditController],
        "faults": timed[AuditFault],
        "operator": timed[AuditOperator],
        "processes": timed[AuditProcess],
        "attachments": timed[AuditAttachment],
        "allowed": [_entry(one, start_ns) | {"what": what} for what, one in _allowed(log).items()],
        "stop": _stop(log),
        "closed": _entry(_first(log, AuditClose), start_ns) or None,
    }


def failing(decision: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The permissives of a decision that did not hold."""
    return [entry for entry in permissives_of(decision) if entry.get("holds") is not True]


def permissives_of(decision: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a decision rested on."""
    permissives = decision.get("permissives")
    return (
        [entry for entry in permissives if isinstance(entry, dict)] if isinstance(permissives, list) else []
    )


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
        warned = _json(verdict).get("warnings")
        warnings = [one for one in warned if isinstance(one, dict)] if isinstance(warned, list) else []
        found.append(
            {
                **verdict,
                "boundaries": own,
                "warnings": warnings,
                "guidance": _guidance(verdict, told),
                **noted,
            }
        )
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


SENT: Final = {"send Permit": "permit", "send Start": "start"}


def _allowed(log: Log) -> dict[str, dict[str, Any]]:
    """The decisions by which the permit and the start left; of several the last."""
    found = {}
    for decision in log.of(AuditDecision.TOPIC):
        effects = decision.get("effects")
        for effect in effects if isinstance(effects, list) else ():
            if decision.get("disposition") == "sent" and isinstance(effect, str) and effect in SENT:
                found[SENT[effect]] = {**decision, "permissives": permissives_of(decision)}
    return found


AT_REST: Final = (ControllerState.INHIBITED.name, ControllerState.FAULT.name)
BROKEN_OFF: Final[dict[str, Any]] = {
    "reason": "the log ends here: the runtime was killed, or its computer lost power, while the arm could move"
}
ENTRY_UM_MAX: Final = 10_000_000
"""No approach is longer."""


def _stop(log: Log) -> dict[str, Any] | None:
    """What is to be known after a stop, from the log alone; None where it tells of none."""
    steps = [one for one in log.of(AuditDecision.TOPIC) if isinstance(one.get("from_state"), str)]
    first = next(
        (one for one in steps if one["from_state"] not in STOPPING and one.get("to_state") in STOPPING), None
    )
    if first is None and not _broken_off(log, steps):
        return None
    first = first or BROKEN_OFF | {"from_state": steps[-1]["to_state"]}
    controller = next(iter(log.of(AuditController.TOPIC)[-1:]), {})
    session = next((one["session"] for one in steps if one.get("session")), None)
    seen, tag = _last_seen(log), _tag(session)
    return stop_document(
        Stopped(
            cause=_cause(first.get("first_out")),
            reason=str(first.get("reason") or ""),
            phase=first["from_state"],
            at_rest=first.get("first_out") is not None and controller.get("state") in AT_REST,
            latched=controller.get("state") == ControllerState.FAULT.name,
            standing=_cause(controller.get("cause")),
            progress=seen.progress(tag),
            joints_u=seen.joints_u(tag),
        ),
        _permitted(log),
    )


def _broken_off(log: Log, steps: list[dict[str, Any]]) -> bool:
    """Whether the log ends while the arm could move."""
    return bool(steps) and steps[-1].get("to_state") in MOVING and not log.of(AuditClose.TOPIC)


def _cause(name: object) -> StopCause:
    return StopCause[name] if isinstance(name, str) and name in StopCause.__members__ else StopCause.NONE


def _last_seen(log: Log) -> LastSeen:
    """What the controller sent of where the arm is."""
    seen = LastSeen()
    for data in log.one_by_one(CanFrame.TOPIC):
        with suppress(ValueError, TypeError, KeyError):  # it is data
            plain = not (data["is_extended"] or data["is_rtr"] or data["is_error"])
            if data["direction"] == "received" and plain:
                seen.frame(int(data["id"]), bytes.fromhex(data["data"]))
    return seen


def _tag(session: object) -> int:
    """The tag that protects a session's frames; 0, that of none, where its digest is not known."""
    try:
        return int.from_bytes(bytes.fromhex(str(session))[:4], "little")
    except ValueError:
        return 0


def _permitted(log: Log) -> Way | None:
    """What the arm was to do, by the attachments and the approach."""
    approach = next(iter(log.of(AuditApproach.TOPIC)[-1:]), {})
    entry_um = approach.get("entry_um")
    if not isinstance(entry_um, int) or not 0 <= entry_um <= ENTRY_UM_MAX:
        return None
    found = [log.scan.attachment(name) for name in (names.PATH, names.CALIBRATION, names.TOOL)]
    parts = [entry.data for entry in found if entry is not None and entry.size <= DEFAULT_LIMIT]
    if len(parts) < len(found):
        return None
    path, calibration, tool = parts
    return Way(path, calibration, tool, entry_um)


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
