"""The log that the controller saw last is looked up beside the loop; the session shows and records what comes of it."""

import threading
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from cutgate.runtime.audit.witness import WitnessFound
from cutgate.runtime.interlock.state import Phase, SeekWitness
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from cutgate.runtime.session.witness import WitnessSearch
from tests.runtime.audit.build import PATIENCE_S
from tests.runtime.interlock.builders import SEEN_LOG

FOUND = WitnessFound("a.mcap", "")


def heard(search):
    """Its answer, waited for."""
    waited = threading.Event()
    for _ in range(1000):
        if (answer := search.answer()) is not None:
            return answer
        waited.wait(PATIENCE_S / 1000)
    return None


def test_what_is_sought_is_what_the_controller_saw(tmp_path):
    asked = []
    search = WitnessSearch(tmp_path, lambda *what: asked.append(what) or FOUND)
    search.begin(SEEN_LOG)
    assert heard(search) == FOUND
    assert asked == [(tmp_path, SEEN_LOG.log_id, SEEN_LOG.size, SEEN_LOG.root)]
    assert search.answer() is None, "once"


def test_a_disk_that_never_answers_holds_up_neither_the_loop_nor_the_end_of_the_program():
    never = threading.Event()
    search = WitnessSearch(Path(), lambda *_: never.wait(PATIENCE_S) and FOUND)
    before = set(threading.enumerate())
    search.begin(SEEN_LOG)
    (thread,) = set(threading.enumerate()) - before
    search.begin(SEEN_LOG)
    assert set(threading.enumerate()) - before == {thread}, "one at a time"
    assert (thread.name, thread.daemon) == ("witness", True)
    assert search.answer() is None
    never.set()
    assert heard(search) == FOUND


def test_a_look_up_that_fails_has_found_nothing_and_says_why(tmp_path):
    def fail(*_):
        raise RuntimeError("why")

    search = WitnessSearch(tmp_path, fail)
    search.begin(SEEN_LOG)
    assert heard(search) == WitnessFound(None, "it cannot be looked up: RuntimeError: why")


# ---------------------------------------------------------------- in a session


def completed(pair):
    """One session to its end, its log closed, and the next one about to begin."""
    assert pair.end() is Phase.DONE
    pair.close()
    return pair.run(0.1)


def permissive(pair):
    """What the log shows of the witness where the permit left."""
    decisions = pair.read().of("/audit/decision")
    (sent,) = [one for one in decisions if "send Permit" in one["effects"]]
    return next(one for one in sent["permissives"] if one["name"] == "controller's witness")


def shown(pair):
    """The log's story on a terminal."""
    console = Console(file=StringIO(), width=200)
    print_story(console, story(pair.read(), pair.paths.log, None))
    return console.file.getvalue()


def test_a_controller_that_saw_no_log_has_none_looked_up(pair):
    assert completed(pair).read().of("/audit/witness") == []
    assert not [effect for effect in pair.notes.effects if isinstance(effect, SeekWitness)]
    assert permissive(pair)["text"] == "it has seen no start yet"


def test_the_log_of_the_last_start_is_found_by_the_next_session(pair):
    before = completed(pair).paths.log
    (start,) = [
        one for one in pair.read().of("/audit/permit") if (one["kind"], one["stage"]) == ("start", "sent")
    ]
    assert pair.begin().end() is Phase.DONE
    pair.close()
    (witness,) = pair.read().of("/audit/witness")
    assert (witness["found"], witness["log"]) == (True, before.name)
    assert (witness["log_size"], witness["log_root"]) == (start["log_size"], start["log_root"])
    assert permissive(pair)["text"] == before.name
    assert not [note for note in pair.notes.notes if "not found" in note]
    assert f"the log that the controller saw last: {before.name}\n" in shown(pair)


def impatient(pair):
    """The next session's job: nobody waits long for its operator."""
    return replace(pair.job, deadlines=replace(pair.job.deadlines, operator_wait_s=1.0))


def gone(pair, job=None):
    """The next session, and nobody finds the log of the last one."""
    completed(pair).paths.log.unlink()
    (pair.directory / "logs" / "HEAD").unlink()
    return pair.begin(job)


def test_a_log_that_is_gone_keeps_from_the_permit_until_that_is_confirmed(pair):
    gone(pair).to(Phase.ADMITTED).run(0.5)
    assert pair.phase is Phase.ADMITTED
    (note,) = [note for note in pair.notes.notes if "the log that the controller saw last" in note]
    assert "is not found: no log " in note
    pair.say("confirm witness")
    assert pair.end() is Phase.DONE
    pair.close()
    (witness,) = pair.read().of("/audit/witness")
    assert (witness["found"], witness["reason"].startswith("no log ")) == (False, True)
    assert permissive(pair)["text"].startswith("confirmed: no log ")
    assert "the log that the controller saw last: NOT FOUND: no log " in shown(pair)


def test_a_log_that_is_gone_and_confirmed_by_nobody_ends_the_session(pair):
    gone(pair, impatient(pair))
    assert pair.end() is Phase.REFUSED
    assert "controller's witness: no log " in pair.state.reason
    assert "say confirm WITNESS" in pair.state.reason


def test_what_was_confirmed_in_one_session_is_to_be_confirmed_in_the_next_one_again(pair):
    gone(pair).to(Phase.ADMITTED).say("confirm witness").to(Phase.PERMITTED).say("stop").end()
    pair.close()
    pair.run(0.1).begin()
    pair.to(Phase.HELD).run(0.05).say("acknowledge")
    pair.to(Phase.ADMITTED).run(0.5)
    assert pair.phase is Phase.ADMITTED


@pytest.mark.parametrize("answers", [True, False])
def test_no_permit_leaves_before_the_look_up_has_answered(pair, answers):
    completed(pair).begin(impatient(pair))
    pair.session._witness = search = WitnessSearch(pair.directory, lambda *_: FOUND)
    search.begin = lambda _log: None
    pair.to(Phase.ADMITTED).run(0.5)
    assert pair.phase is Phase.ADMITTED
    if answers:
        search._answers.put(FOUND)
        pair.to(Phase.PERMITTED)
    else:
        assert pair.end() is Phase.REFUSED
        assert "controller's witness: being looked up" in pair.state.reason
