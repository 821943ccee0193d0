"""The verification process: a program of its own, started by the runtime, which believes nothing it says.

It has the path as standard input and speaks over the socket that is its standard output (`messages`). It ends when
the runtime closes that, or dies. Signals of the terminal are the runtime's business: it is started with SIGINT and
SIGTERM blocked, in a session of its own.
"""

import os
import socket
from collections.abc import Iterator

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats
from cutgate.runtime.session.messages import (
    REQUEST_BYTES_MAX,
    TEXT_MAX,
    Answer,
    Bound,
    Broken,
    Claim,
    Frames,
    Guided,
    Request,
    framed,
    shown,
)
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.approach import decision, report
from cutgate.runtime.verification.placing.guidance import Quantise, guide
from cutgate.runtime.verification.recorded import problem_from_records


def answers(request: Request) -> Iterator[Answer]:
    """Verify the uploaded path, its approach and retract; then, if the cut is inadmissible, look for a move of the bone.

    Raises:
        cutgate.protocol.records.RecordError: the records pose no problem that can be verified.
    """
    problem = problem_from_records(
        request.path, request.limits, request.calibration, request.tool, request.robot
    )
    verdict = certified.verify(problem)
    way = decision.verify(problem, request.start) if verdict.admissible else None
    bound = report.bound(way, request.speed_percent) if way else None
    yield Claim(
        request=request.number,
        admissible=verdict.admissible,
        path=records.digest(request.path).hex(),
        limits=records.digest(request.limits).hex(),
        calibration=records.digest(request.calibration).hex(),
        tool=records.digest(request.tool).hex(),
        start_joints_u=request.start_joints_u,
        approach=Bound.of(bound),
    )
    if not verdict.admissible:
        path = records.Path.parse(request.path)
        yield Guided.of(request.number, guide(problem, verdict, _quantiser(path)))


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


def serve(line: socket.socket, path: bytes) -> None:
    """Answer one request after the other until the runtime has gone."""
    frames = Frames(REQUEST_BYTES_MAX)
    try:
        while came := line.recv(frames.missing):
            body = frames.add(came)
            if body is not None:
                for answer in answered(body, path):
                    line.sendall(framed(answer.model_dump_json().encode()))
    except OSError:  # the runtime has gone, killed perhaps: nobody waits for an answer
        return


def answered(body: bytes, path: bytes) -> Iterator[Answer]:
    """What a request, as it came, is answered with; whatever goes wrong, nothing was verified and the runtime is told."""
    number = 0
    try:
        request = Request.parse(body, path)
        number = request.number
        yield from answers(request)
    except Exception as error:  # noqa: BLE001 - as the docstring says
        yield Broken(request=number, reason=shown(f"{type(error).__name__}: {error}", TEXT_MAX))


def main() -> None:
    """The program."""
    with open(0, "rb", closefd=False) as stored:
        path = stored.read()
    line = os.dup(1)
    os.dup2(2, 1)  # whatever a library prints is no message
    with socket.socket(fileno=line) as connected:
        serve(connected, path)


if __name__ == "__main__":
    main()
