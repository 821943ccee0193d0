"""Verification in a process of its own, so that heartbeats never wait for it.

The worker is started before the session opens and answers one request after the other. It ends when its pipe
does, so it cannot outlive the runtime.
"""

import multiprocessing
import os
import pickle
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

from cutgate.config.model import Robot
from cutgate.config.signals import ENDING, SUSPENDING
from cutgate.protocol import records
from cutgate.runtime.interlock.state import Timing, Verdict
from cutgate.runtime.plan.prepare import Quantise
from cutgate.runtime.session.course import course_of
from cutgate.runtime.verification import approach, certificate, certified
from cutgate.runtime.verification import verdict as verdicts
from cutgate.runtime.verification.document import Digests, verdict_document
from cutgate.runtime.verification.guidance import Guidance, guide
from cutgate.runtime.verification.problem import Floats, Problem
from cutgate.runtime.verification.recorded import problem_from_records
from cutgate.runtime.verification.summary import summary

RUNTIMES_BUSINESS = ENDING | SUSPENDING
JOIN_S = 2.0
LENGTH_BYTES = 4
READ_BYTES = 1 << 20
NOWHERE = (0, 0, 0, 0, 0)
"""Stands in a request until the arm's joints have been measured."""


@dataclass(frozen=True)
class Request:
    """What is to be proved: the bytes the controller stored and reported, and where its arm stands.

    ``path`` is empty for the one that the worker was started with: 20 MB would hold up the loop that submits them.
    """

    number: int
    path: bytes
    limits: bytes
    calibration: bytes
    tool: bytes
    registration: bytes
    robot: Robot
    timing: Timing
    start_joints_u: tuple[int, ...] = NOWHERE

    @property
    def start(self) -> approach.Start:
        """Where approach and retract begin and end."""
        return approach.Start.of(
            self.start_joints_u,
            clearance_um=round(self.timing.approach_clearance_mm * 1000),
            tolerance_mm=self.timing.start_tolerance_mm,
            tolerance_deg=self.timing.start_tolerance_deg,
        )


@dataclass(frozen=True)
class Answer:
    """The verdict for the interlock; what was proved, for people; and documents and proof, for the log.

    ``approach``, its document and ``proof`` (a certificate's bytes) are None where the cut itself is not admissible.
    """

    verdict: Verdict
    proved: verdicts.Verdict
    guidance: Guidance | None
    digests: Digests
    document: dict[str, Any]
    approach: approach.Approach | None
    approach_document: dict[str, Any] | None
    proof: bytes | None = None


@dataclass(frozen=True)
class Broken:
    """Nothing was proved: the worker failed."""

    number: int
    reason: str


def prove(request: Request) -> Answer:
    """Verify the uploaded path, its approach and retract; the only place where a session's verdict comes from.

    Raises:
        cutgate.protocol.records.RecordError: the records pose no problem that can be verified.
    """
    path = records.Path.parse(request.path)
    problem = problem_from_records(
        request.path, request.limits, request.calibration, request.tool, request.robot
    )
    began_s = time.perf_counter()
    verdict = certified.verify(problem)
    elapsed_ms = (time.perf_counter() - began_s) * 1000.0
    digests = Digests(
        path.digest, records.digest(request.limits), records.digest(request.calibration), request.registration
    )
    guidance = None if verdict.admissible else guide(problem, verdict, _quantiser(path))
    document = verdict_document(
        verdict, poses=len(path), guidance=guidance, digests=digests, elapsed_ms=elapsed_ms
    )
    proof = _checked_proof(problem, verdict)
    ways = approach.verify(problem, request.start) if verdict.admissible else None
    bound = approach.bound(ways, request.timing.approach_speed_percent) if ways else None
    answer = Verdict(
        request=request.number,
        admissible=verdict.admissible,
        path=path.digest,
        limits=digests.limits,
        calibration=digests.calibration,
        tool=records.digest(request.tool),
        start_joints_u=request.start_joints_u,
        reason=summary(verdict),
        approach=bound,
        approach_reason=approach.summary(ways) if ways else "not verified: the cut is not admissible",
        trajectory=course_of(problem, request.start_joints_u, bound) if bound else None,
    )
    told = approach.document(ways, request.start) if ways else None
    return Answer(answer, verdict, guidance, digests, document, ways, told, proof)


def _checked_proof(problem: Problem, verdict: verdicts.Verdict) -> bytes | None:
    """The proof of an admissible verdict, as the log will hold it, checked before anything is permitted on it.

    Raises:
        ValueError: there is none, or it does not hold; then there is no verdict either.
    """
    if not verdict.admissible:
        return None
    proof = certificate.certify(problem, verdict)
    if proof is None:
        raise ValueError("the admissible verdict has no proof")
    body = proof.body()
    reasons = certificate.recheck(problem, certificate.Certificate.parse(body))
    if reasons:
        raise ValueError(f"the proof of the admissible verdict does not hold: {'; '.join(reasons)}")
    return body


def _quantiser(path: records.Path) -> Quantise:
    def quantise(tips_mm: Floats, axes: Floats) -> tuple[Floats, Floats]:
        moved = records.Path.quantised(
            tips_mm,
            axes,
            feed_mm_s=path.feed_mm_s,
            tool_length_mm=path.tool_length_mm,
            elbow=path.elbow,
        )
        return moved.tips_mm, moved.axes

    return quantise


def _serve(requests: Connection, path: bytes) -> None:
    """The worker's process: answer until the pipe ends. Signals are the runtime's business."""
    for number in RUNTIMES_BUSINESS:
        signal.signal(number, signal.SIG_IGN)
    while True:
        try:
            request: Request = requests.recv()
        except (EOFError, OSError):  # the runtime has gone, killed perhaps
            return
        try:
            answer: Answer | Broken = prove(request if request.path else replace(request, path=path))
        except Exception as error:  # noqa: BLE001 - whatever it is, nothing was proved and the runtime is told
            answer = Broken(request.number, f"{type(error).__name__}: {error}")
        try:
            requests.send(answer)
        except OSError:  # the runtime has gone meanwhile: nobody waits for an answer
            return


@contextmanager
def _signals_wait() -> Iterator[None]:
    """A process started in here sees no signal of the runtime's, nor does its interpreter while it starts.

    Ctrl-C, Ctrl-Z and a terminal that hangs up reach everything that was started from it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, RUNTIMES_BUSINESS)
    try:
        resource_tracker.ensure_running()  # on the way otherwise; it lets SIGINT and SIGTERM through again, here too
        signal.pthread_sigmask(signal.SIG_BLOCK, RUNTIMES_BUSINESS)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Worker:
    """The verification process, seen from the loop: submit, poll ``fileno``, collect.

    Args:
        path: what requests without a path are about.
    """

    def __init__(self, path: bytes = b"") -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._came = bytearray()
        self._process = context.Process(
            target=_serve, args=(theirs, path), name="cutgate-verifier", daemon=True
        )
        with _signals_wait():
            self._process.start()
        theirs.close()

    @property
    def pid(self) -> int:
        """The worker's process number."""
        return self._process.pid or 0

    def fileno(self) -> int:
        """Readable when an answer waits, or when the worker has died."""
        return self._pipe.fileno()

    def submit(self, request: Request) -> None:
        """Send a request; never waits for its answer."""
        try:
            self._pipe.send(request)
        except OSError:  # the worker is gone: poll() says so
            return

    def poll(self) -> Answer | Broken | None:
        """The next answer, once all of it is there; Broken if the worker has died. Never waits for the worker.

        Read as ``Connection.send`` writes it: four bytes of length, then the pickled answer; nothing of the next one.
        """
        with socket.socket(fileno=os.dup(self._pipe.fileno())) as pipe:
            try:
                while not self._whole:
                    came = pipe.recv(min(self._missing, READ_BYTES), socket.MSG_DONTWAIT)
                    if not came:
                        raise ConnectionResetError
                    self._came += came
            except BlockingIOError:
                return None
            except OSError:
                return Broken(0, f"the verification process ended with code {self._process.exitcode}")
        answer: Answer | Broken = pickle.loads(self._came[LENGTH_BYTES:])  # noqa: S301 - from our own process
        self._came.clear()
        return answer

    @property
    def _missing(self) -> int:
        """Bytes that are still to come, of the length or else of the answer."""
        head = self._came[:LENGTH_BYTES]
        end = LENGTH_BYTES + (int.from_bytes(head, "big") if len(head) == LENGTH_BYTES else 0)
        return end - len(self._came)

    @property
    def _whole(self) -> bool:
        return len(self._came) > LENGTH_BYTES and self._missing == 0

    def close(self) -> None:
        """End the worker; killed if it does not end by itself within a bounded time."""
        self._pipe.close()
        self._process.join(JOIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(JOIN_S)
