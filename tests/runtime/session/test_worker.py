"""The verification process, seen from the runtime: it cannot hold it up, outlive it, or bring it to run anything."""

import os
import select
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from cutgate.runtime.session import worker as workers
from cutgate.runtime.session.messages import Broken, framed
from cutgate.runtime.session.prover import answers
from cutgate.runtime.session.worker import Line, Worker
from tests.runtime.session.pair import INADMISSIBLE_MM, NoProcess, request_of

PATIENCE_S = 60.0
REASON = "the verification process "


def answer_of(worker):
    ready, _, _ = select.select([worker.fileno()], [], [], PATIENCE_S)
    assert ready, "no answer"
    return worker.poll() or answer_of(worker)  # a long one comes in parts


@pytest.fixture
def talk():
    """A worker without a process, and what stands for the process's end of its socket."""
    ours, theirs = socket.socketpair()
    with theirs:
        worker = Worker(NoProcess(), Line(ours))
        yield worker, theirs
        worker.close()


@pytest.fixture
def nobody():
    """A descriptor that nothing is ever written to."""
    reading, writing = os.pipe()
    yield reading
    os.close(reading)
    os.close(writing)


# ---------------------------------------------------------------- a real process


@pytest.mark.processes
def test_a_worker_answers_says_what_broke_and_ends_with_its_socket(tmp_path_factory):
    asked = request_of(tmp_path_factory)
    worker = Worker.start(asked.path)
    assert worker.pid > 0
    assert worker.poll() is None
    worker.submit(asked)
    worker.submit(replace(asked, number=6, limits=b"none"))
    assert [answer_of(worker)] == list(answers(asked))
    second = answer_of(worker)
    assert (second.request, second.reason[:12]) == (6, "RecordError:")
    worker.close()
    assert worker._process.returncode == 0


@pytest.mark.processes
def test_a_worker_that_died_is_reported_and_can_still_be_asked(tmp_path_factory):
    worker = Worker.start(b"")
    worker._process.kill()
    worker._process.wait(PATIENCE_S)
    assert answer_of(worker) == Broken(reason="the verification process ended with code -9")
    worker.submit(request_of(tmp_path_factory))
    assert isinstance(worker.poll(), Broken)
    worker.close()


@pytest.mark.processes
def test_a_worker_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(workers, "JOIN_S", 0.05)
    worker = Worker.start(b"")  # still importing when its socket ends
    worker.close()
    assert worker._process.wait(PATIENCE_S) == -signal.SIGKILL


@pytest.mark.processes
def test_what_the_terminal_sends_never_reaches_it():
    """It is in a session of its own, and SIGINT and SIGTERM are blocked in it from its first instruction on."""
    worker = Worker.start(b"")
    assert os.getsid(worker.pid) == worker.pid != os.getsid(0)
    status = Path(f"/proc/{worker.pid}/status").read_text(encoding="ascii")
    (blocked,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigBlk:"))
    for number in (signal.SIGINT, signal.SIGTERM):
        assert int(blocked, 16) >> (number - 1) & 1
    worker.close()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()


@pytest.mark.processes
def test_it_takes_no_code_from_the_working_directory_or_from_where_the_environment_says(
    tmp_path, tmp_path_factory, monkeypatch
):
    """A module planted under every name that it imports; one of them is enough to be found."""
    planted = "import os; open(os.environ['MARKER'], 'w').write(__name__)"
    for name in (
        "multiprocessing",
        "numpy",
        "json",
        "socket",
        "struct",
        "pickle",
        "cutgate",
        "sitecustomize",
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(planted, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("MARKER", str(tmp_path / "marker"))
    asked = request_of(tmp_path_factory)
    worker = Worker.start(asked.path)
    worker.submit(asked)
    assert [answer_of(worker)] == list(answers(asked))
    worker.close()
    assert not (tmp_path / "marker").exists()


@pytest.mark.processes
@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import sys; sys.exit(3)", ""),
        (
            "import sys; print('some\\nlast \\x1b[2Jword', file=sys.stderr); sys.exit(3)",
            ": last \\x1b[2Jword",
        ),
        ("import sys; sys.stderr.write('x' * 60_000); sys.exit(3)", ": " + "x" * 200),
        ("import sys; sys.stderr.buffer.write(b'\\xff\\n\\n'); sys.exit(3)", ": \ufffd"),
    ],
)
def test_the_last_words_of_a_process_that_fails_are_told_escaped_and_bounded(monkeypatch, program, said):
    monkeypatch.setattr(workers, "program", lambda _module: [sys.executable, "-c", program])
    worker = Worker.start(b"")
    worker._process.wait(PATIENCE_S)
    assert answer_of(worker).reason == f"the verification process ended with code 3{said}"
    worker.close()


# ---------------------------------------------------------------- what comes over the socket


@pytest.mark.parametrize("parts", [(1,), (3, 5), (4,), (5,), (4, 100, 101)])
def test_half_an_answer_is_no_answer_and_nobody_waits_for_the_rest(talk, parts):
    """The process is stopped in the middle of its sending, and then goes on; a second answer follows at once."""
    worker, theirs = talk
    first, second = Broken(request=7, reason="x" * 200), Broken(request=8, reason="y")
    stream = b"".join(framed(said.model_dump_json().encode()) for said in (first, second))
    for begin, end in pairwise((0, *parts, len(stream))):
        assert worker.poll() is None
        theirs.sendall(stream[begin:end])
    assert worker.poll() == first
    assert worker.poll() == second
    assert worker.poll() is None


def test_a_process_that_hangs_up_has_failed_even_if_it_still_runs(talk):
    worker, theirs = talk
    theirs.close()
    assert worker.poll().reason == "the verification process ended"


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"\xff\xff\xff\xff", "a message of 4294967295 bytes is announced, must have 1..16384"),
        (b"\0\0\0\0", "a message of 0 bytes is announced, must have 1..16384"),
        (b"\x80\x04\x95\x1f and the rest of a pickle", "a message of 2147783967 bytes is announced"),
        (framed(b"null"), "Input should be"),
    ],
)
def test_what_is_no_answer_is_told_in_words(talk, sent, said):
    worker, theirs = talk
    theirs.sendall(sent)
    reason = worker.poll().reason
    assert reason.startswith("the verification process's answer is none: ")
    assert said in reason


def test_of_endless_bytes_no_more_is_read_than_a_message_has(talk):
    worker, theirs = talk
    theirs.setblocking(False)
    theirs.send((16_384).to_bytes(4, "big") + bytes(100_000))
    before = theirs.send(b"")
    assert worker.poll().reason.startswith("the verification process's answer is none: ")
    assert before == 0
    left = worker._line._socket.recv(1 << 20)
    assert len(left) > 50_000


def test_asking_never_waits(talk, tmp_path_factory):
    worker, theirs = talk
    for number in range(2000):  # until nothing more fits
        worker.submit(replace(request_of(tmp_path_factory), number=number))
    assert theirs.recv(4) != b""


# ---------------------------------------------------------------- waiting for it


def test_an_answer_is_waited_for_in_parts(talk, nobody):
    worker, theirs = talk
    body = framed(Broken(reason="no").model_dump_json().encode())
    theirs.sendall(body[:5])
    assert worker.wait(nobody, 0.01) is None
    theirs.sendall(body[5:])
    assert worker.wait(nobody, PATIENCE_S) == Broken(reason="no")


def test_nobody_is_kept_who_wants_to_leave(talk):
    worker, _ = talk
    reading, writing = os.pipe()
    os.write(writing, b"\0")
    assert worker.wait(reading, PATIENCE_S) is None
    os.close(reading)
    os.close(writing)


def test_a_process_that_ends_is_waited_for_no_longer(talk, nobody):
    worker, theirs = talk
    theirs.close()
    assert worker.wait(nobody, PATIENCE_S).reason == "the verification process ended"


class Stubborn(NoProcess):
    """Neither ends nor can be killed."""

    killed = 0

    def wait(self, timeout=None):
        raise subprocess.TimeoutExpired("verifier", timeout)

    def kill(self):
        self.killed += 1


def test_a_process_that_cannot_even_be_killed_does_not_keep_the_log_from_being_closed():
    ours, theirs = socket.socketpair()
    process = Stubborn()
    Worker(process, Line(ours)).close()
    assert process.killed == 1
    theirs.close()


@pytest.mark.processes
def test_a_guidance_search_that_goes_on_is_killed_when_the_session_is_over(tmp_path_factory, monkeypatch):
    """It has nothing to lose; whoever wants to leave is not kept."""
    monkeypatch.setattr(workers, "JOIN_S", 0.05)
    monkeypatch.setattr(
        workers,
        "program",
        lambda _module: [sys.executable, "-c", "import signal\nwhile True: signal.pause()"],
    )
    worker = Worker.start(request_of(tmp_path_factory, INADMISSIBLE_MM).path)
    worker.close()
    assert worker._process.returncode == -signal.SIGKILL
