"""The verification process: one answer to each request, and no way to outlive or to hold up the runtime."""

import multiprocessing
import os
import select
import socket
from dataclasses import replace
from itertools import pairwise

import pytest

from cutgate.protocol import records
from cutgate.runtime.session import worker as workers
from cutgate.runtime.session.worker import Answer, Broken, Request, Worker, prove
from cutgate.runtime.verification import certificate
from cutgate.runtime.verification.recorded import problem_from_records
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, STANDS, job_of

pytestmark = pytest.mark.processes

PATIENCE_S = 60.0


def request(tmp_path_factory, bone_x_mm=ADMISSIBLE_MM, number=5):
    files, job = job_of(tmp_path_factory, bone_x_mm)
    return Request(
        number,
        job.path,
        job.limits,
        job.calibration,
        job.tool,
        job.registration,
        files.robot.value,
        job.timing,
        STANDS,
    )


def test_an_admissible_path_is_proved_for_exactly_what_was_asked(tmp_path_factory):
    asked = request(tmp_path_factory)
    answer = prove(asked)
    verdict = answer.verdict
    assert (verdict.request, verdict.admissible) == (5, True)
    assert (verdict.path, verdict.limits, verdict.calibration, verdict.tool) == tuple(
        records.digest(data) for data in (asked.path, asked.limits, asked.calibration, asked.tool)
    )
    assert verdict.start_joints_u == STANDS
    assert verdict.approach is not None
    assert (verdict.approach.entry_um, verdict.approach.exit_um) == (10_670, 10_000)
    assert verdict.approach.speed_percent == asked.timing.approach_speed_percent == 25
    assert answer.approach is not None
    assert answer.approach_document["verdict"] == "admissible"
    assert answer.guidance is None
    assert answer.document["verdict"] == "admissible"


def test_an_admissible_verdict_comes_with_its_proof_and_an_inadmissible_one_has_none(tmp_path_factory):
    asked = request(tmp_path_factory)
    problem = problem_from_records(asked.path, asked.limits, asked.calibration, asked.tool, asked.robot)
    assert certificate.recheck(problem, certificate.Certificate.parse(prove(asked).proof)) == ()
    assert prove(request(tmp_path_factory, INADMISSIBLE_MM)).proof is None


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ({"certify": lambda _problem, _verdict: None}, "has no proof"),
        ({"recheck": lambda _problem, _proof: ("outer: nothing is proven",)}, "outer: nothing is proven"),
    ],
)
def test_without_a_proof_that_holds_there_is_no_verdict(tmp_path_factory, monkeypatch, broken, said):
    for name, instead in broken.items():
        monkeypatch.setattr(certificate, name, instead)
    with pytest.raises(ValueError, match=said):
        prove(request(tmp_path_factory))


def test_an_inadmissible_path_comes_with_guidance_and_no_start(tmp_path_factory):
    answer = prove(request(tmp_path_factory, INADMISSIBLE_MM))
    assert not answer.verdict.admissible
    assert (answer.verdict.approach, answer.approach, answer.approach_document) == (None, None, None)
    assert "not verified" in answer.verdict.approach_reason
    assert answer.guidance is not None
    assert answer.document["guidance"]["verified"] is True


def test_an_approach_that_is_not_admissible_binds_nothing(tmp_path_factory):
    """The arm stands 2.05 mm above its lower limit."""
    low = (*STANDS[:2], 52_050_000, *STANDS[3:])
    answer = prove(replace(request(tmp_path_factory), start_joints_u=low))
    assert answer.verdict.admissible
    assert answer.verdict.approach is None
    assert "bottom: clearance 2.050000 mm, needs 5.5 mm" in answer.verdict.approach_reason
    assert answer.approach_document["verdict"] == "inadmissible"


def test_the_start_tolerance_and_the_clearance_are_the_sites(tmp_path_factory):
    asked = request(tmp_path_factory)
    timing = replace(asked.timing, start_tolerance_mm=1.5, approach_clearance_mm=20.0)
    answer = prove(replace(asked, timing=timing))
    assert answer.approach.legs[0].boundaries["bottom"].deadband == 6.5
    assert (answer.approach.entry_um, answer.approach.exit_um) == (20_670, 20_000)


def without_trajectory(answer):
    """The verdict but for what equals itself alone."""
    assert answer.verdict.trajectory is not None
    return replace(answer.verdict, trajectory=None)


def answer_of(worker):
    ready, _, _ = select.select([worker.fileno()], [], [], PATIENCE_S)
    assert ready, "no answer"
    return worker.poll() or answer_of(worker)  # a long one comes in parts


def test_a_worker_answers_says_what_broke_and_ends_with_its_pipe(tmp_path_factory):
    asked = request(tmp_path_factory)
    worker = Worker()
    assert worker.pid > 0
    assert worker.poll() is None
    worker.submit(asked)
    worker.submit(replace(asked, number=6, path=b"no path"))
    first, second = answer_of(worker), answer_of(worker)
    assert isinstance(first, Answer)
    assert without_trajectory(first) == without_trajectory(prove(asked))
    assert (second.number, second.reason[:12]) == (6, "RecordError:")
    worker.close()
    assert worker._process.exitcode == 0


def test_a_worker_that_died_is_reported_and_can_still_be_asked(tmp_path_factory):
    worker = Worker()
    worker._process.kill()
    worker._process.join(PATIENCE_S)
    found = answer_of(worker)
    assert isinstance(found, Broken)
    assert "the verification process ended with code -9" in found.reason
    worker.submit(request(tmp_path_factory))
    assert isinstance(worker.poll(), Broken)
    worker.close()


def test_a_worker_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(workers, "JOIN_S", 0.05)
    worker = Worker()  # still importing when its pipe ends
    worker.close()
    worker._process.join(PATIENCE_S)
    assert not worker._process.is_alive()


class Pipe:
    """The worker's end of the pipe."""

    def __init__(self, *requests, deaf=False):
        self.requests, self.answers, self.deaf = list(requests), [], deaf

    def recv(self):
        if not self.requests:
            raise EOFError
        return self.requests.pop(0)

    def send(self, answer):
        if self.deaf:
            raise BrokenPipeError
        self.answers.append(answer)


@pytest.fixture
def _signals_stay(monkeypatch):
    monkeypatch.setattr(workers.signal, "signal", lambda *_: None)


@pytest.mark.usefixtures("_signals_stay")
def test_the_workers_process_answers_until_the_pipe_ends(tmp_path_factory):
    asked = request(tmp_path_factory)
    pipe = Pipe(asked, replace(asked, number=9, path=b""))
    workers._serve(pipe, b"no path")
    assert pipe.answers[0].verdict.request == 5
    assert pipe.answers[1].number == 9


@pytest.mark.usefixtures("_signals_stay")
def test_a_request_without_a_path_is_about_the_one_the_worker_was_started_with(tmp_path_factory):
    asked = request(tmp_path_factory)
    pipe = Pipe(replace(asked, path=b""))
    workers._serve(pipe, asked.path)
    assert without_trajectory(pipe.answers[0]) == without_trajectory(prove(asked))


@pytest.mark.parametrize("parts", [(1,), (3, 5), (4,), (5,), (4, 100, 101)])
def test_half_an_answer_is_no_answer_and_nobody_waits_for_the_rest(parts):
    """The worker is stopped in the middle of its sending, and then goes on; a second answer follows at once."""
    worker = Worker()
    worker._process.kill()
    worker._process.join(PATIENCE_S)
    worker._pipe.close()
    worker._pipe, theirs = multiprocessing.Pipe()
    theirs.send(Broken(7, "x" * 200))
    theirs.send(Broken(8, "y"))
    with socket.socket(fileno=os.dup(worker._pipe.fileno())) as source:
        sent = source.recv(10_000)
    for begin, end in pairwise((0, *parts, len(sent))):
        assert worker.poll() is None
        os.write(theirs.fileno(), sent[begin:end])
    assert worker.poll() == Broken(7, "x" * 200)
    assert worker.poll() == Broken(8, "y")
    assert worker.poll() is None
    theirs.close()
    assert isinstance(worker.poll(), Broken)
    worker.close()


@pytest.mark.usefixtures("_signals_stay")
def test_the_workers_process_ends_when_nobody_listens(tmp_path_factory):
    pipe = Pipe(request(tmp_path_factory), request(tmp_path_factory), deaf=True)
    workers._serve(pipe, b"")
    assert len(pipe.requests) == 1
