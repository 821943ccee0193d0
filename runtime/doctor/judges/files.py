"""Whether key, log directory and disk are what a session needs, and whether loop and disk keep their times."""

from collections.abc import Iterable
from typing import Final

from cutgate.config.records import timing_record
from cutgate.config.refusal import FileProblem
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Delays, FreeSpace, KeyFile, LogFolder
from cutgate.runtime.doctor.finding import Condition, Finding, within
from cutgate.runtime.session.space import space

HOUR_S: Final = 3600.0
"""A session that is longer than most."""
RESERVE: Final = 2
"""The interlock asks for so many times what a session takes (``permissives.log_space``)."""
MEGABYTE: Final = 1e6
HALF: Final = 0.5
"""Of a deadline: what is later has little left for the day on which the disk is busy."""


def judge_key(facts: KeyFile, _examined: Examined) -> Iterable[Finding]:
    """The key is this user's alone, and a key; which one says its fingerprint."""
    bound = "a key that only this user may read"
    if facts.problem is not None:
        yield _refused("key", facts.problem, bound)
        return
    found = f"{facts.path}, fingerprint {facts.fingerprint}"
    yield Finding("key", Condition.OK, found, f"{bound}; the controller's fingerprint is the same")


def judge_log_folder(facts: LogFolder, _examined: Examined) -> Iterable[Finding]:
    """A session could begin a log there."""
    bound = "this user's own, or to be made; no session there"
    if facts.problem is not None:
        yield _refused("log directory", facts.problem, bound)
    elif facts.session is not None:
        found = f"{facts.path}: in use by process {facts.session}"
        yield Finding("log directory", Condition.FAIL, found, bound, "wait for that session, or end it")
    else:
        found = facts.path if facts.there else f"{facts.path}: the first session makes it"
        yield Finding("log directory", Condition.OK, found, bound)


def judge_space(facts: FreeSpace, examined: Examined) -> Iterable[Finding]:
    """Room for a session of an hour; without room for one that only waits for its operator none is permitted."""
    waiting_s = float(examined.site.timing.operator_wait_s + examined.site.permit.permit_lifetime_s)
    least, hour = (needed_bytes(examined, seconds) for seconds in (waiting_s, HOUR_S))
    asked = max(least, hour)
    state = (
        Condition.FAIL
        if not facts.free_bytes >= least
        else within(facts.free_bytes >= asked, Condition.WARNING)
    )
    found = f"{facts.free_bytes / MEGABYTE:.0f} MB free on the disk of {facts.folder}"
    bound = f">= {asked / MEGABYTE:.0f} MB: twice what an hour's session takes"
    remedy = f"free {(asked - facts.free_bytes) / MEGABYTE:.0f} MB there, or name another disk with --log-dir"
    yield Finding("log space", state, found, bound, "" if state is Condition.OK else remedy)


def needed_bytes(examined: Examined, seconds: float) -> int:
    """What the interlock asks for, for a session of so many seconds."""
    site = examined.site
    period_s = site.log.chunk_period_ms / 1000
    taken = space(seconds, timing_record(site), chunk_period_s=period_s, interface=examined.channel)
    return RESERVE * taken.total


def judge_disk(facts: Delays, examined: Examined) -> Iterable[Finding]:
    """A record that enables is durable in time."""
    deadline_ms = examined.site.log.commit_deadline_ms
    found = (
        f"fdatasync of {facts.count} writes: median {facts.median_ms:.1f} ms, worst {facts.worst_ms:.1f} ms"
    )
    bound = f"worst under commit_deadline_ms = {deadline_ms}"
    remedy = (
        "keep the log on a disk of its own that is not on the network, away from what writes much; "
        "or raise commit_deadline_ms"
    )
    yield _delay("log disk", facts, (HALF * deadline_ms, deadline_ms), found, bound, remedy)


def judge_loop(facts: Delays, examined: Examined) -> Iterable[Finding]:
    """A loop that is late by a whole heartbeat leaves one out; by the rest of the time-out, it is given up."""
    timing = examined.site.timing
    left_ms = timing.timeout_ms - timing.heartbeat_ms
    found = f"{facts.count} cycles beside a busy process: median {facts.median_ms:.1f} ms late, worst {facts.worst_ms:.1f} ms"
    bound = f"worst under {timing.heartbeat_ms} ms (heartbeat); {left_ms} ms lose the time-out of {timing.timeout_ms} ms"
    remedy = "give the loop its priority, or choose longer heartbeat_ms and timeout_ms (docs/timing.md)"
    yield _delay("loop latency", facts, (timing.heartbeat_ms, left_ms), found, bound, remedy)


def _delay(
    name: str, facts: Delays, limits_ms: tuple[float, float], found: str, bound: str, remedy: str
) -> Finding:
    """By the worst: under the first limit it is good, from the second on a failure."""
    warned_ms, failed_ms = limits_ms
    state = (
        Condition.FAIL
        if not facts.worst_ms < failed_ms
        else within(facts.worst_ms < warned_ms, Condition.WARNING)
    )
    return Finding(name, state, found, bound, "" if state is Condition.OK else remedy)


def _refused(name: str, problem: FileProblem, bound: str) -> Finding:
    """As a session would be told: the place, the value and its bound, and the remedy for it."""
    place = f"{problem.file}: {problem.key}" if problem.key else problem.file
    if problem.value:
        return Finding(name, Condition.FAIL, f"{place} is {problem.value}", problem.bound, problem.remedy)
    return Finding(name, Condition.FAIL, f"{place}: {problem.bound}", bound, problem.remedy)
