"""The verdict that counts: this side's own, found in small steps, once the verification process says the same.

Used by the loop in each cycle, after `begin`: `hear` when the process's socket can be read, `go_on` when the cycle's
work is done, then `agreed`. Each says what came of it; nothing is decided before both have spoken.
"""

from collections.abc import Callable
from dataclasses import dataclass

from cutgate.runtime.interlock.state import Collected, Verify
from cutgate.runtime.session.check import Answer, Check, disagreement
from cutgate.runtime.session.messages import Broken, Claim, Guided
from cutgate.runtime.session.worker import Worker
from cutgate.runtime.verification.steps import Steps

UNASKED = "the verification process says what it was not asked"


@dataclass(frozen=True)
class NotVerified:
    """There is no verdict, and why."""

    reason: str


class Verifying:
    """Both verifications of one session.

    Args:
        check: this side's own.
        worker: the verification process.
    """

    def __init__(self, check: Check, worker: Worker) -> None:
        self.listening = True
        """To the process: until it has said all that it is asked, whatever becomes of it then stops no cut."""
        self._check = check
        self._worker = worker
        self._steps: Steps[Answer] | None = None
        self._own: Answer | None = None
        self._claim: Claim | None = None

    @property
    def busy(self) -> bool:
        """There is something to do that waits for nobody."""
        return self._steps is not None or self._both

    @property
    def _both(self) -> bool:
        return self._own is not None and self._claim is not None

    def begin(self, wanted: Verify, held: Collected) -> None:
        """Ask the process, and begin this side's own."""
        self._worker.submit(self._check.request(wanted.request, wanted.start_joints_u, held))
        self._steps = self._check.steps(wanted.request, wanted.start_joints_u)

    def hear(self) -> NotVerified | None:
        """Read what the process says, if all of an answer is there; None if that is as it should be."""
        answer = self._worker.poll()
        if answer is None:
            return None
        self.listening = False
        if isinstance(answer, Claim):
            self._claim = answer
            return None
        return NotVerified(answer.reason if isinstance(answer, Broken) else UNASKED)

    def go_on(self, clock: Callable[[], float], until_s: float) -> Answer | NotVerified | None:
        """Some steps of this side's own, each far shorter than a cycle, until it is late enough or all is done.

        Args:
            clock: monotonic seconds.
            until_s: no step begins later.
        """
        while self._steps is not None and clock() < until_s:
            try:
                next(self._steps)
            except StopIteration as end:
                self._steps, self._own = None, end.value
                return self._own
            except ValueError as error:
                self._steps, self.listening = None, False
                return NotVerified(f"{type(error).__name__}: {error}")
        return None

    def agreed(self) -> Answer | NotVerified | None:
        """This side's own verdict if the process says the same, once; None while one of the two is missing."""
        own, claim = self._own, self._claim
        if own is None or claim is None:
            return None
        self._own, self._claim = None, None
        otherwise = disagreement(claim, own.verdict)
        return NotVerified(otherwise) if otherwise else own

    def guided(self, wake: int, timeout_s: float, request: int) -> Guided | NotVerified:
        """Where to move the bone, as the process says; waited for, when the session has ended.

        Args:
            wake: descriptor that becomes readable when somebody wants to leave.
            timeout_s: for so long.
            request: what it must be about.
        """
        match self._worker.wait(wake, timeout_s):
            case Guided(request=number) as told if number == request:
                return told
            case Broken(reason=reason):
                return NotVerified(reason)
            case Claim() | Guided():
                return NotVerified(UNASKED)
        return NotVerified(f"not found within {timeout_s:g} s, or not waited for")
