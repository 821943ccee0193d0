"""Whether a session was healthy, from its log and its outcome, and whether what was not is what a test expects. Pure."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from cutgate.protocol.states import StopCause

OUTCOMES: Final = ("not-admitted", "refused", "unfinished")
FINDINGS: Final = {
    **{cause.name: "the session stopped or reported a fault with this cause" for cause in StopCause},
    "not-admitted": "the session was not admitted",
    "refused": "the runtime refused its input: no session began",
    "unfinished": "the runtime was still running, or was killed, when the test ended",
    "error-frame": "an error frame was on the bus",
    "overrun": "frames were dropped because one side read too slowly",
    "late-loop": "the runtime's loop stood still for three quarters of the time-out",
    "log": "the audit log is not whole, or not as it was written",
    "controller-ended": "the simulated controller ended by itself",
}
"""What a health check finds, by the name that ``cutgate_expect`` takes."""
LATE_PART: Final = 0.75
ERROR_CONTROLLER: Final = 0x004
RECEIVE_OVERFLOW: Final = 0x01


@dataclass(frozen=True)
class HealthFinding:
    """One thing that was not as it is in a session that comes to its end: a name of ``FINDINGS``, and where it shows."""

    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


def of_outcome(document: Mapping[str, Any] | None, exit_code: int | None) -> list[HealthFinding]:
    """What the runtime says of its end.

    Args:
        document: what ``run --json`` printed; None where there is none.
        exit_code: of the runtime; None where it was still running.
    """
    if exit_code is None or exit_code < 0:
        return [HealthFinding("unfinished", "it had to be ended when the test was over")]
    if document is None:
        return [HealthFinding("refused", f"no session; exit code {exit_code}")]
    if exit_code == 0:
        return []
    if exit_code == 1:
        return [HealthFinding("not-admitted", str(document.get("reason")))]
    cause = str(document.get("cause"))
    return [HealthFinding(cause if cause in FINDINGS else "INTERNAL_ERROR", str(document.get("reason")))]


def of_faults(records: Iterable[Mapping[str, Any]]) -> list[HealthFinding]:
    """What ``/audit/fault`` holds."""
    return [
        HealthFinding(
            str(record["cause"]), f"fault of the {record['source']}: {record.get('detail') or record['code']}"
        )
        for record in records
        if record.get("cause") in FINDINGS
    ]


def of_frames(records: Iterable[Mapping[str, Any]]) -> list[HealthFinding]:
    """What ``/can/frame`` holds: error frames, and among them those that stand for dropped ones. One finding of each."""
    found: dict[str, int] = {}
    for record in records:
        if record.get("is_error"):
            data = bytes.fromhex(str(record.get("data", "")))
            lost = record.get("id") == ERROR_CONTROLLER and len(data) > 1 and data[1] & RECEIVE_OVERFLOW
            name = "overrun" if lost else "error-frame"
            found[name] = found.get(name, 0) + 1
    return [HealthFinding(name, f"{times} error frames in the log") for name, times in found.items()]


def of_timing(records: Iterable[Mapping[str, Any]]) -> list[HealthFinding]:
    """What ``/timing`` holds."""
    longest_ms, timeout_ms = 0.0, 0.0
    for record in records:
        gap_ms = float(record.get("longest_gap_ms", 0.0))
        if gap_ms > longest_ms:
            longest_ms, timeout_ms = gap_ms, float(record.get("timeout_ms", 0.0))
    if not longest_ms > LATE_PART * timeout_ms:
        return []
    return [
        HealthFinding(
            "late-loop", f"{longest_ms:.0f} ms between two cycles, the time-out is {timeout_ms:.0f} ms"
        )
    ]


_OF_RECORDS: Final = {"/audit/fault": of_faults, "/can/frame": of_frames, "/timing": of_timing}
TOPICS: Final = tuple(_OF_RECORDS)
"""Of the records that are looked at."""


def of_log(reasons: Sequence[str], records: Iterable[tuple[str, Mapping[str, Any]]]) -> list[HealthFinding]:
    """What a session's log says.

    Args:
        reasons: why it is not whole; empty where it is.
        records: of it, each with its topic.
    """
    read = [(topic, record) for topic, record in records if topic in _OF_RECORDS]
    findings = [HealthFinding("log", "; ".join(reasons))] if reasons else []
    for wanted, judge in _OF_RECORDS.items():
        findings += judge(record for topic, record in read if topic == wanted)
    return findings


def but_the_tests_end(findings: Iterable[HealthFinding], *, unfinished: bool) -> list[HealthFinding]:
    """Without the stop by which a session ends that was still running when its test was over: it is one finding already."""
    ended_here = StopCause.OPERATOR_QUIT.name if unfinished else None
    return [finding for finding in findings if finding.name != ended_here]


@dataclass(frozen=True)
class Expectation:
    """What a ``cutgate_expect`` marker says: at least one of these must come, and those may come besides."""

    must: tuple[str, ...]
    may: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in (*self.must, *self.may):
            if name not in FINDINGS:
                raise ValueError(f"cutgate_expect: {name!r} is not known; use {', '.join(FINDINGS)}")


def unexpected(findings: Iterable[HealthFinding], expectations: Iterable[Expectation]) -> list[str]:
    """What is wrong with these findings, one line each; empty where everything is as the markers say."""
    found, wanted = list(findings), list(expectations)
    names = {finding.name for finding in found}
    allowed = {name for expectation in wanted for name in (*expectation.must, *expectation.may)}
    missing = [one.must for one in wanted if one.must and names.isdisjoint(one.must)]
    return [
        *(str(finding) for finding in found if finding.name not in allowed),
        *(f"expected and did not come: {' or '.join(must)}" for must in missing),
    ]
