"""One line about each session: when it was, what came of it, and how near it went to a limit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cutgate.runtime.audit.folder import nanoseconds, text
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import AuditBoundary, AuditClose, AuditOpen, AuditVerdict

NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class SessionSummary:
    """What a table of sessions says of one.

    Attributes:
        opened_ns: UTC.
        outcome: the state in which it ended; empty where it was not closed.
        reason: why, in words.
        verdict: the last one; empty where there was none.
        boundary: whose certified clearance exceeds its deadband least; empty where nothing was certified.
        certified: that clearance.
        unit: of it.
        replay: what deciding again showed.
    """

    opened_ns: int
    outcome: str = ""
    reason: str = ""
    verdict: str = ""
    boundary: str = ""
    certified: float | None = None
    unit: str = ""
    replay: str = NOT_CHECKED


def summary_of(log: Log, replayed: str = NOT_CHECKED) -> SessionSummary:
    """The summary of a log, whatever it holds."""
    opened, closed = (_last(log, topic) for topic in (AuditOpen.TOPIC, AuditClose.TOPIC))
    verdict = _last(log, AuditVerdict.TOPIC)
    worst, certified = text(verdict, "worst_boundary") or "", _number(verdict.get("worst_certified"))
    units = (one.get("unit") for one in log.one_by_one(AuditBoundary.TOPIC) if one.get("name") == worst)
    unit = next((unit for unit in units if unit in ("mm", "deg")), "")
    return SessionSummary(
        nanoseconds(opened.get("utc")),
        text(closed, "final_state") or "",
        text(closed, "outcome") or "",
        text(verdict, "verdict") or "",
        worst,
        certified,
        unit,
        replayed,
    )


def _last(log: Log, topic: str) -> Mapping[str, Any]:
    found: dict[str, Any] = {}
    for record in log.one_by_one(topic):
        found = record
    return found


def _number(value: object) -> float | None:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e15:
        return float(value) if math.isfinite(value) else None
    return None
