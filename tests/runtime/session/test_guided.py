"""Where to move the bone: it holds up neither the verdict nor the end of the session, and is told when it comes."""

import json
import os

import pytest

from cutgate.protocol.frames import RuntimeStop
from cutgate.protocol.states import StopCause, StopCode
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.commands.session_view import run_document
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.story import story
from cutgate.runtime.session.messages import Broken
from tests.runtime.session.pair import answers

NO_WAIT_S = 0.01


def ended(outside):
    """A session that was refused with the verdict alone: no guidance has come."""
    outside.begin().prover.answer = lambda request: answers(request)[:1]
    assert outside.end() is Phase.REFUSED
    return outside


def guidance_of(outside):
    return answers(outside.prover.asked[0])[1]


def told(outside):
    """What log, its story and the JSON document say."""
    outside.close()
    assert outside.read().report.status is Status.OK
    assert outside.replayed().outcome is ReplayOutcome.IDENTICAL
    (entry,) = outside.read().of("/audit/guidance")
    (verdict,) = story(outside.read(), outside.paths.log, outside.paths.candump)["verdicts"]
    document = run_document(outside.state, outside.session.answer, outside.paths, None)["verdict"]
    return entry, verdict, document


def test_an_inadmissible_cut_is_refused_shown_and_recorded_before_guidance_is_looked_for(outside):
    ended(outside)
    assert [shown.verdict.admissible for shown in outside.notes.verdicts] == [False]
    assert outside.notes.guided == []
    (_, stop), *_ = outside.wire.frames(RuntimeStop)
    assert (stop.code, stop.cause) == (StopCode.END, StopCause.NOT_ADMITTED)
    outside.close()
    log = outside.read()
    assert [entry["verdict"] for entry in log.of("/audit/verdict")] == ["inadmissible"]
    assert log.of("/audit/guidance") == []
    assert outside.replayed().outcome is ReplayOutcome.IDENTICAL, "a log that ends there is whole"


def test_guidance_that_comes_in_time_is_shown_recorded_and_part_of_the_document(outside):
    ended(outside)
    outside.prover.give(guidance_of(outside))
    outside.session.guidance(outside.wake[0])
    assert outside.notes.notes[-1] == "looking for the smallest move of the bone"
    found = guidance_of(outside).guidance.value
    assert outside.notes.guided == [(found, outside.notes.guided[0][1])]
    entry, verdict, document = told(outside)
    moved = list(found.translation_mm)
    assert json.loads(entry["document"])["translation_mm"] == moved
    assert "note" not in entry
    assert verdict["guidance"]["translation_mm"] == document["guidance"]["translation_mm"] == moved
    assert "guidance_note" not in document
    assert "guidance_note" not in verdict


@pytest.mark.parametrize(
    ("said", "note"),
    [
        (lambda _outside: [], f"not found within {NO_WAIT_S:g} s, or not waited for"),
        (lambda _outside: [Broken(request=1, reason="MemoryError: ")], "MemoryError: "),
        (
            lambda outside: answers(outside.prover.asked[0])[:1],
            "the verification process says what it was not asked",
        ),
        (
            lambda outside: [guidance_of(outside).model_copy(update={"request": 9})],
            "the verification process says what it was not asked",
        ),
        (
            lambda outside: [guidance_of(outside).model_copy(update={"guidance": None})],
            "nothing is known that could be said",
        ),
        (lambda _outside: [b"\xff" * 10], "the verification process's answer is none: a message of"),
    ],
    ids=["nothing", "failure", "claim", "another request", "none", "noise"],
)
def test_without_guidance_log_and_document_say_why(outside, said, note):
    ended(outside)
    outside.prover.give(*said(outside))
    outside.session.guidance(outside.wake[0], NO_WAIT_S)
    assert outside.notes.guided[0][0] is None
    assert outside.notes.guided[0][1].startswith(note)
    entry, verdict, document = told(outside)
    assert "document" not in entry
    assert entry["note"].startswith(note)
    assert verdict["guidance"] is document["guidance"] is None
    assert verdict["guidance_note"] == document["guidance_note"] == entry["note"]


def test_who_leaves_while_it_is_looked_for_is_not_kept(outside):
    ended(outside)
    os.write(outside.wake[1], b"\0")
    outside.session.guidance(outside.wake[0], 60.0)
    assert outside.notes.guided[0][0] is None


def test_an_admissible_cut_has_nothing_to_be_said(pair):
    assert pair.end() is Phase.DONE
    pair.session.guidance(pair.wake[0])
    assert pair.notes.guided == []
    pair.close()
    assert pair.read().of("/audit/guidance") == []


def test_a_session_without_a_verdict_has_nothing_to_be_said(outside):
    outside.begin().prover.answer = lambda _request: None
    outside.to(Phase.VERIFYING).say("stop")
    outside.end()
    outside.session.guidance(outside.wake[0])
    assert outside.notes.guided == []
