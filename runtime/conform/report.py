"""The report: one document for machines, one table for people."""

import math
from typing import Any, Final

from cutgate.protocol import records
from cutgate.runtime.conform.suite import CaseVerdict, Result, SuiteOutcome

SCHEMA: Final = "cutgate.conform/1"

ABOUT: Final = """\
This opens sessions with the controller and says what it must refuse: wrong versions, nonces, digests, codes,
corrupted and stale frames. In some cases a right permit is given: the controller then enters cutting mode and its
cutter may spin up. START is sent as well, and must be refused because the enabling device is released.
- The plant must be disconnected: no power to axes and cutter.
- Keep the enabling device released until the report stands.
- The last cases latch a fault; the suite acknowledges and resets it.
- One throw-away registration is put on the controller's withdrawn list for good."""


def document(
    outcome: SuiteOutcome, announce: records.Announce | None, timing: records.Timing, *, bus: str, whole: bool
) -> dict[str, Any]:
    """The report as one JSON document.

    Args:
        outcome: what came of the suite.
        announce: the controller as it announced itself; None if it was never heard.
        timing: what OPEN proposed.
        bus: interface and channel.
        whole: whether all cases were asked for.
    """
    counts = {verdict.value: 0 for verdict in CaseVerdict}
    for result in outcome.results:
        counts[result.verdict.value] += 1
    return {
        "schema": SCHEMA,
        "bus": bus,
        "protocol_version": records.PROTOCOL_VERSION,
        "controller": None
        if announce is None
        else {
            "serial": announce.serial,
            "firmware": announce.firmware_version,
            "protocol_version": announce.protocol_version,
            "announce_nonce": announce.announce_nonce.hex(),
        },
        "timing": {name: getattr(timing, name) for name in timing.__dataclass_fields__},
        "conforms": outcome.passed and whole,
        "passed": outcome.passed,
        "whole_suite": whole,
        "counts": counts,
        "needs_reset": outcome.needs_reset,
        "state": outcome.state.name if outcome.state else None,
        "cause": outcome.cause.name if outcome.cause else None,
        "cases": [_case(result) for result in outcome.results],
    }


def _case(result: Result) -> dict[str, Any]:
    case = result.case
    return {
        "name": case.name,
        "requirement": f"docs/protocol.md: {case.requirement}",
        "sent": case.sent,
        "expected": case.expected,
        "came": result.came,
        "verdict": result.verdict.value,
        "latency_ms": milliseconds(result.latency_s),
    }


def summary(outcome: SuiteOutcome, *, whole: bool) -> str:
    """The last lines for people."""
    found = {v: sum(result.verdict is v for result in outcome.results) for v in CaseVerdict}
    text = f"{found[CaseVerdict.PASS]} passed, {found[CaseVerdict.FAIL]} failed, {found[CaseVerdict.NOT_RUN]} not run."
    if outcome.passed:
        text += (
            " The controller conforms."
            if whole
            else " A selection only: nothing is said about the other cases."
        )
    else:
        text += " The controller does not conform, or it was not shown."
    if outcome.needs_reset:
        state = outcome.state.name if outcome.state else "unknown"
        text += f"\nThe controller's last known state is {state}: acknowledge and reset it by hand."
    return text


def milliseconds(seconds: float | None) -> float | None:
    """For people: ms to a tenth."""
    return None if seconds is None or not math.isfinite(seconds) else round(seconds * 1000.0, 1)
