"""The verification process's program: what it answers to each request, and that it ends when nobody asks any more."""

import io
import os
import socket
import threading
from dataclasses import replace

import pytest

from cutgate.protocol import records
from cutgate.runtime.session import prover
from cutgate.runtime.session.messages import (
    ANSWER_BYTES_MAX,
    Broken,
    Claim,
    Frames,
    Guided,
    framed,
    parse_answer,
)
from cutgate.runtime.session.prover import answers, serve
from tests.runtime.session.pair import INADMISSIBLE_MM, STANDS, request_of

PATIENCE_S = 60.0


def test_an_admissible_path_is_claimed_for_exactly_what_was_asked(tmp_path_factory):
    asked = request_of(tmp_path_factory)
    (claim,) = answers(asked)
    assert isinstance(claim, Claim)
    assert (claim.request, claim.admissible) == (5, True)
    assert (claim.path, claim.limits, claim.calibration, claim.tool) == tuple(
        records.digest(data).hex() for data in (asked.path, asked.limits, asked.calibration, asked.tool)
    )
    assert claim.start_joints_u == STANDS
    assert (claim.approach.entry_um, claim.approach.exit_um) == (10_670, 10_000)
    assert claim.approach.speed_percent == asked.speed_percent == 25


def test_an_inadmissible_path_is_said_at_once_and_guidance_comes_after_it(tmp_path_factory, monkeypatch):
    looked = []
    guide = prover.guide
    monkeypatch.setattr(prover, "guide", lambda *given: looked.append(given) or guide(*given))
    said = answers(request_of(tmp_path_factory, INADMISSIBLE_MM))
    claim = next(said)
    assert (claim.admissible, claim.approach, looked) == (False, None, [])
    (guided,) = said
    assert guided.request == claim.request
    assert guided.guidance.value.verified is True
    assert guided.guidance.value.translation_mm is not None


def test_an_approach_that_is_not_admissible_is_claimed_to_bind_nothing(tmp_path_factory):
    """The arm stands 2.05 mm above its lower limit."""
    low = (*STANDS[:2], 52_050_000, *STANDS[3:])
    (claim,) = answers(replace(request_of(tmp_path_factory), start_joints_u=low))
    assert (claim.admissible, claim.approach) == (True, None)


def test_the_start_tolerance_and_the_clearance_are_the_sites(tmp_path_factory):
    asked = request_of(tmp_path_factory)
    (claim,) = answers(replace(asked, clearance_um=20_000))
    assert (claim.approach.entry_um, claim.approach.exit_um) == (20_670, 20_000)
    (claim,) = answers(replace(asked, start_tolerance_mm=500.0))
    assert claim.approach is None


# ---------------------------------------------------------------- the process


class Talk:
    """A runtime that speaks with the program in a thread of the test."""

    def __init__(self, path: bytes):
        self.ours, theirs = socket.socketpair()
        self.ours.settimeout(PATIENCE_S)
        self.thread = threading.Thread(target=self._serve, args=(theirs, path), daemon=True)
        self.thread.start()

    @staticmethod
    def _serve(theirs, path):
        with theirs:
            serve(theirs, path)

    def hear(self):
        frames = Frames(ANSWER_BYTES_MAX)
        while True:
            body = frames.add(self.ours.recv(frames.missing))
            if body is not None:
                return parse_answer(body)

    def end(self):
        self.ours.close()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


def test_it_answers_one_request_after_the_other_about_the_path_it_has_and_ends_with_its_socket(
    tmp_path_factory,
):
    asked = request_of(tmp_path_factory)
    talk = Talk(asked.path)
    for number in (5, 6):
        talk.ours.sendall(framed(replace(asked, number=number, path=b"not this").body()))
        assert [talk.hear()] == list(answers(replace(asked, number=number)))
    talk.end()


def test_guidance_is_a_message_of_its_own(tmp_path_factory):
    asked = request_of(tmp_path_factory, INADMISSIBLE_MM)
    talk = Talk(asked.path)
    talk.ours.sendall(framed(asked.body()))
    assert talk.hear().admissible is False
    assert isinstance(talk.hear(), Guided)
    talk.end()


@pytest.mark.parametrize(
    ("body", "number", "said"),
    [
        (b"[", 0, "JSONDecodeError:"),
        (b"{}", 0, "KeyError: 'limits'"),
    ],
)
def test_what_is_no_request_is_answered_with_what_is_wrong(body, number, said):
    talk = Talk(b"")
    talk.ours.sendall(framed(body))
    answer = talk.hear()
    assert isinstance(answer, Broken)
    assert answer.request == number
    assert answer.reason.startswith(said)
    talk.end()


def test_whatever_goes_wrong_is_told_in_characters_that_can_be_shown(tmp_path_factory, monkeypatch):
    asked = request_of(tmp_path_factory)

    def fail(*_given):
        raise ValueError("first line\n\x1b[2Jsecond" + "x" * 5000)

    monkeypatch.setattr(prover, "answers", fail)
    talk = Talk(b"no path")
    talk.ours.sendall(framed(asked.body()))
    answer = talk.hear()
    assert answer.request == 5
    assert answer.reason.startswith("ValueError: first line\\n\\x1b[2Jsecond")
    assert len(answer.reason) == 2000
    talk.end()


def test_a_path_that_is_none_is_told(tmp_path_factory):
    talk = Talk(b"no path")
    talk.ours.sendall(framed(request_of(tmp_path_factory).body()))
    answer = talk.hear()
    assert (answer.request, answer.reason[:12]) == (5, "RecordError:")
    talk.end()


def test_it_ends_when_nobody_listens(tmp_path_factory):
    asked = request_of(tmp_path_factory)
    ours, theirs = socket.socketpair()
    ours.sendall(framed(asked.body()))
    ours.shutdown(socket.SHUT_RD)
    with theirs:
        serve(theirs, asked.path)
    ours.close()


def test_the_program_reads_the_path_from_its_input_and_speaks_over_its_output(monkeypatch):
    """What a library prints goes to the standard error, and is no message."""
    ours, theirs = socket.socketpair()
    done = []
    monkeypatch.setattr(prover, "open", lambda *_given, **_options: io.BytesIO(b"the path"), raising=False)
    monkeypatch.setattr(os, "dup", lambda descriptor: theirs.detach() if descriptor == 1 else None)
    monkeypatch.setattr(os, "dup2", lambda *descriptors: done.append(descriptors))
    monkeypatch.setattr(prover, "serve", lambda line, path: done.append((line.sendall(b"x"), path)))
    prover.main()
    assert done == [(2, 1), (None, b"the path")]
    assert ours.recv(2) == b"x"
    assert ours.recv(1) == b""
    ours.close()
