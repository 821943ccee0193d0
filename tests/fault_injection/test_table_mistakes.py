"""A mistake in a table is found in the log of a session that meets it: ``audit replay`` names the step that is none."""

import pytest

from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.phases import ENDED
from tests.fault_injection.table_mistakes import MISTAKES
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, job_of, pair_of

pytestmark = pytest.mark.no_cover
SAMPLE = (
    "a cause in the heartbeat does not stop",
    "a permit does not wait for its record",
    "the first cause is overwritten",
    "a withdrawal leaves before the stop",
    "an emergency stop does not stop the arm",
)
"""In every run; the others take their time."""
NAMED = ("the table has", "its table", "the table takes", "than the table", "had left", "said acknowledge")
"""How the steps' reader says what it found, and no other rule of the replay."""
CASES = [pytest.param(name, marks=() if name in SAMPLE else pytest.mark.long) for name in MISTAKES]


def played(tmp_path, tmp_path_factory, mistake):
    """The replay of the session that this leads to, whatever becomes of it."""
    job = job_of(tmp_path_factory, ADMISSIBLE_MM if mistake.admissible else INADMISSIBLE_MM)
    with pair_of(tmp_path, *job) as pair:
        mistake.scene(pair)
        pair.close(clean=pair.phase in ENDED)
        return pair.replayed()


def test_the_sample_is_of_them():
    assert set(SAMPLE) < MISTAKES.keys()
    assert len(MISTAKES) >= 30


@pytest.mark.parametrize("name", CASES)
def test_the_log_of_a_session_that_meets_a_mistake_is_refused(tmp_path, tmp_path_factory, monkeypatch, name):
    MISTAKES[name].seed(monkeypatch)
    found = played(tmp_path, tmp_path_factory, MISTAKES[name])
    assert found.outcome is ReplayOutcome.DIFFERS
    told = [line for line in found.differences if any(word in line for word in NAMED)]
    assert told, found.differences
    print(f"{name}: {told[0]}")  # noqa: T201 - long work says what it did


@pytest.mark.parametrize("name", CASES)
def test_the_same_session_is_accepted_where_the_table_is_right(tmp_path, tmp_path_factory, name):
    found = played(tmp_path, tmp_path_factory, MISTAKES[name])
    assert found.outcome is ReplayOutcome.IDENTICAL, found.differences
