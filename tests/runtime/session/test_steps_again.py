"""A session's log is held against the frozen tables: as it is, forged with a sound chain, and of another version's tables."""

from random import Random

import pytest

from cutgate.runtime.audit import records as audit
from cutgate.runtime.audit import replay as replaying
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.replay import STEPS_TOLD_MAX, ReplayOutcome, replay
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified
from tests.runtime.audit.build import forge
from tests.runtime.session.pair import job_of, pair_of

NOT_COMPARED = "the steps were not held against the tables of transitions: record 0 names"


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """The log of a cut, to its end."""
    with pair_of(tmp_path_factory.mktemp("cut"), *job_of(tmp_path_factory)) as pair:
        assert pair.to(Phase.DONE).phase is Phase.DONE
        return pair.close().log.read_bytes()


def again(data):
    log = read_log(data)
    assert log.report.status in (Status.OK, Status.INCOMPLETE), log.report.reasons
    return replay(log, certified.verify, verifier=VERIFIER)


def decisions(data):
    return [entry["sequence"] for entry in read_log(data).of("/audit/decision")]


def forged(data, sequence, change):
    """With this decision changed."""

    def edit(record):
        mine = isinstance(record, audit.AuditDecision) and record.sequence == sequence
        return record.model_copy(update=change(record)) if mine else record

    return forge(data, edit)


def test_a_cut_is_accepted_and_nothing_of_it_was_left_out(cut):
    result = again(cut)
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert not any(note.startswith(NOT_COMPARED) for note in result.notes)
    assert len(decisions(cut)) > 20


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "change",
    [
        lambda record: {"to_state": "refused" if record.to_state != "refused" else "done"},
        lambda record: {"from_state": "held"},
        lambda record: {"effects": (*record.effects, "send Collect")},
        lambda record: {"effects": record.effects[1:] if record.effects else ("Refused",)},
        lambda record: {"event": "joints measured" if record.event != "joints measured" else "path stored"},
        lambda record: {"first_out": "OPERATOR_STOP"},
        lambda record: {"sequence": record.sequence + 1},
    ],
    ids=["to", "from", "one effect more", "one effect less", "event", "first cause", "number"],
)
def test_a_decision_that_was_forged_is_named(cut, change, seed):
    draw = Random(seed)
    sequence = draw.choice(decisions(cut))
    result = again(forged(cut, sequence, change))
    assert result.outcome is ReplayOutcome.DIFFERS
    assert any(f"decision {number}" in result.differences[0] for number in (sequence, sequence + 1))


@pytest.mark.parametrize(("digest", "which"), [(None, "none"), ("00" * 32, "those of another version")])
def test_a_log_of_other_tables_is_told_as_not_compared(cut, digest, which):
    def edit(record):
        opens = isinstance(record, audit.AuditOpen)
        return record.model_copy(update={"transitions_sha256": digest}) if opens else record

    result = again(forge(cut, edit))
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert f"{NOT_COMPARED} {which}" in result.notes


def test_what_is_told_of_wrong_steps_is_bounded(cut, monkeypatch):
    """A log may hold a million of them."""
    monkeypatch.setattr(replaying, "STEPS_TOLD_MAX", 3)
    result = again(
        forge(
            cut,
            lambda record: (
                record.model_copy(update={"event": "no such event"})
                if isinstance(record, audit.AuditDecision)
                else record
            ),
        )
    )
    assert result.differences[3:] == ("the steps behind that were not held against the tables",)
    assert STEPS_TOLD_MAX == 50
