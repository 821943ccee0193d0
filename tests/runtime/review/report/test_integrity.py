"""Whether a log can be believed: every step is told with its answer, in the order of trust, and what cannot be found."""

import pytest

from cutgate.runtime.audit.inspect import read_log, verify_log
from cutgate.runtime.audit.replay import Replay, ReplayOutcome
from cutgate.runtime.audit.trust import NOT_FOUND, REPLAY, STEPS, TrustAnswer
from cutgate.runtime.review.report import integrity
from cutgate.runtime.review.report.integrity import NOT_REPLAYED, SHAPES, steps_of
from tests.runtime.review.report.page import Page

IDENTICAL = Replay(ReplayOutcome.IDENTICAL, (), ())
DIFFERS = Replay(ReplayOutcome.DIFFERS, ("the verdict was <admissible>",), ("a note",))


def shown(report, replay):
    made = integrity.section(report, replay, steps_of(report, replay))
    return made, Page(made)


def test_the_steps_stand_in_the_order_of_trust(admitted):
    report = verify_log(admitted)
    assert [step.name for step in steps_of(report, IDENTICAL)] == list(STEPS)
    _, page = shown(report, IDENTICAL)
    places = [page.text.index(f"{step.name} {SHAPES[step.answer]}") for step in steps_of(report, IDENTICAL)]
    assert places == sorted(places)
    assert report.headline in page.text


@pytest.mark.parametrize(
    ("replay", "answer", "text"),
    [
        (IDENTICAL, TrustAnswer.YES, "IDENTICAL: decided again from the log alone: the same"),
        (DIFFERS, TrustAnswer.NO, "DIFFERS: the verdict was <admissible>"),
        (Replay(ReplayOutcome.BAD_INPUT, ("no robot.toml",), ()), TrustAnswer.NO, "BAD INPUT: no robot.toml"),
        (None, TrustAnswer.NOT_CHECKED, NOT_REPLAYED),
    ],
)
def test_what_deciding_again_has_shown_stands_in_the_place_of_the_last_step(admitted, replay, answer, text):
    step = steps_of(verify_log(admitted), replay)[-1]
    assert (step.name, step.answer, step.text) == (REPLAY, answer, text)


def test_a_tampered_log_says_so_first_and_in_red_with_its_reasons(admitted):
    report = read_log(admitted.replace(b"time scale", b"time skale")).report
    made, page = shown(report, DIFFERS)
    assert page.text.startswith("TAMPERED")
    assert made.startswith('<p class="bad">')
    assert all(reason in page.text for reason in report.reasons)
    assert "the verdict was <admissible>" in page.text
    assert "<admissible>" not in made


def test_bytes_that_are_no_record_are_counted(admitted):
    report = read_log(admitted[:-4000]).report
    assert f"{report.dropped_bytes} bytes at the end are no whole record." in shown(report, None)[1].text


def test_what_no_verification_can_find_is_said(admitted):
    text = shown(verify_log(admitted), None)[1].text
    assert " ".join(NOT_FOUND.replace("\n- ", " ").split()) in text


def test_every_answer_has_its_shape_and_word():
    assert set(SHAPES) == set(TrustAnswer)
    assert len({shape[0] for shape in SHAPES.values()}) == len(SHAPES)
