"""The suite: each case, what came of it, and the way back to a controller that stands."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.conform.bench import Bench
from cutgate.runtime.conform.cases import Case
from cutgate.runtime.conform.failures import DeviationError, HaltError, InconclusiveError, OperatorError
from cutgate.runtime.conform.heard import STANDING, Seen
from cutgate.runtime.conform.table import NOTHING_MOVED

ATTEMPTS: Final = 3
"""A case that fails while the tester's own loop stood still is run again, so often in all."""


class CaseVerdict(StrEnum):
    """What a case has shown."""

    PASS = "PASS"  # noqa: S105 - a verdict
    FAIL = "FAIL"
    NOT_RUN = "NOT RUN"


@dataclass(frozen=True)
class Result:
    """What came of one case.

    Attributes:
        case: what was said and expected.
        verdict: the answer.
        came: what came, or why the case was not run.
        latency_s: from what was said to what came, where that was measured.
        frames: every frame that passed meanwhile.
    """

    case: Case
    verdict: CaseVerdict
    came: str
    latency_s: float | None = None
    frames: tuple[Seen, ...] = ()


@dataclass(frozen=True)
class SuiteOutcome:
    """What came of the suite.

    Attributes:
        results: one per case, in order.
        state: what the controller announced last; None if it was never heard.
        cause: the cause it announced with it.
    """

    results: tuple[Result, ...]
    state: ControllerState | None
    cause: StopCause | None

    @property
    def passed(self) -> bool:
        """Whether every case has passed; one that was not run has not."""
        return bool(self.results) and all(result.verdict is CaseVerdict.PASS for result in self.results)

    @property
    def needs_reset(self) -> bool:
        """Whether somebody must acknowledge and reset at the controller."""
        return self.state is not ControllerState.INHIBITED


def run(
    bench: Bench, cases: Sequence[Case], tell: Callable[[Result], None] = lambda _r: None
) -> SuiteOutcome:
    """Run the cases one after the other. After a halt nothing more is said to the controller.

    Raises:
        can.CanError: the bus failed.
    """
    suite = Suite(bench)
    results: list[Result] = []
    for case in cases:
        result = suite.judge(case)
        results.append(result)
        tell(result)
    last = bench.announce
    return SuiteOutcome(tuple(results), last.state if last else None, last.cause if last else None)


class Suite:
    """The suite at work, for whoever asks for one case after the other.

    Args:
        bench: the conversation with the controller.

    Attributes:
        halted: why nothing more is said to the controller; None while the suite goes on.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.halted: str | None = None

    def judge(self, case: Case) -> Result:
        """Run one case and come back to a controller that stands; not run after a halt.

        Raises:
            can.CanError: the bus failed.
        """
        if case is NOTHING_MOVED:  # needs no session, is true or not whatever has happened
            return _conclude(self._bench, case, heard=self._bench.announce is not None)
        if self.halted is not None:
            return Result(case, CaseVerdict.NOT_RUN, f"not run: {self.halted}")
        result, self.halted = _repeated(self._bench, case)
        return result


def _conclude(bench: Bench, case: Case, *, heard: bool) -> Result:
    """The last case is judged from what the whole suite has watched."""
    if not heard:
        return Result(case, CaseVerdict.NOT_RUN, "no controller was heard")
    try:
        return Result(case, CaseVerdict.PASS, case.run(bench))
    except DeviationError as error:
        return Result(case, CaseVerdict.FAIL, str(error))


def _repeated(bench: Bench, case: Case) -> tuple[Result, str | None]:
    """A case, repeated where the tester itself was too slow to judge; and why the suite must halt, if so."""
    for _ in range(ATTEMPTS):
        result, halted = _once(bench, case)
        slow_s = bench.longest_gap_s
        if halted is not None or result.verdict is not CaseVerdict.FAIL or slow_s <= bench.allowance_s:
            return result, halted
    text = f"the tester stood still for {slow_s * 1000:.0f} ms, {ATTEMPTS} times over: use a faster machine"
    return Result(case, CaseVerdict.NOT_RUN, f"{text}; came: {result.came}", frames=result.frames), None


def _once(bench: Bench, case: Case) -> tuple[Result, str | None]:
    bench.begin()
    halted: str | None = None
    try:
        verdict, came = CaseVerdict.PASS, case.run(bench)
    except DeviationError as error:
        verdict, came = CaseVerdict.FAIL, str(error)
    except InconclusiveError as error:
        verdict, came = CaseVerdict.NOT_RUN, str(error)
    except HaltError as error:
        bench.stop_now()
        verdict = CaseVerdict.NOT_RUN if isinstance(error, OperatorError) else CaseVerdict.FAIL
        came = halted = str(error)
    latency_s = bench.latency_s
    wrong = bench.violations()
    if verdict is CaseVerdict.PASS and wrong:
        verdict, came = CaseVerdict.FAIL, f"{came}; but the controller's own frames: {'; '.join(wrong)}"
    trouble = _back(bench)
    if trouble is not None:
        verdict, came, halted = CaseVerdict.FAIL, f"{came}; afterwards: {trouble}", halted or trouble
    return Result(case, verdict, came, latency_s, tuple(bench.frames)), halted


def _back(bench: Bench) -> str | None:
    """Back to a controller that stands inhibited, unlatched; why not, if not."""
    try:
        found = bench.finish()
        if found.state is ControllerState.FAULT:
            bench.recover(found.cause)
            found = bench.finish()
    except (HaltError, DeviationError, InconclusiveError) as error:
        return str(error)
    if found.state not in STANDING or found.state is ControllerState.FAULT:
        return f"the controller stays in {found.state.name}: acknowledge and reset it"
    return None
