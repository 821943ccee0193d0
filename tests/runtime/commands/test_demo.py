"""``cutgate demo`` where a session does not end as it was to: words, an exit code, and nobody is waited for."""

import json
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
import typer

from cutgate.config.load import InputError
from cutgate.runtime.commands import demo
from cutgate.runtime.commands.app import execute
from cutgate.runtime.demo.processes import DemoError
from cutgate.runtime.demo.script import STORY, TOO_BUSY

FIRST, SECOND = STORY
LOST = "no fresh controller heartbeat within 500 ms; this computer stood still for 640 ms"


def ran(registration, **changes):
    """What ``run --json`` says of a session that ended as it was to, but for these changes."""
    verdict, outcome = STORY[registration]
    log = {"mcap": f"logs/{registration}.mcap", "candump": ""}
    told = {
        "outcome": outcome,
        "cause": "NOT_ADMITTED",
        "reason": "why",
        "verdict": {"verdict": verdict},
        "log": log,
    }
    return told | changes


@pytest.fixture
def hang_up():
    """A hang-up that was acted on is ignored from then on; not in the tests that follow."""
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hang_up")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1])
def test_a_signal_that_ends_the_demo_ends_its_processes_first_and_a_second_one_changes_nothing(number):
    said, ended = [], []

    def processes():
        with demo._ended_in_order(lambda *line: said.append(line)):
            try:
                signal.raise_signal(number)
            finally:  # as each process of the demo is ended
                signal.raise_signal(signal.SIGTERM)
                ended.append("runtime")

    with pytest.raises(typer.Exit) as left:
        processes()
    assert left.value.exit_code == 128 + number
    assert ended == ["runtime"]
    assert said == [("demo", f"{number.name}: ending runtime, controller and bus")]


LATE = {"outcome": "stopped", "cause": "HEARTBEAT_LOST", "reason": LOST, "verdict": None}


@pytest.fixture
def played(tmp_path, monkeypatch, capsys):
    """Play the demo with these sessions in place of processes: exit code, document, what was said, what was begun."""

    def play(*sessions, stalled=(), as_json=True, report=lambda _logs, _page: 1):
        begun, left = [], list(sessions)

        @contextmanager
        def part(*_):
            yield ["--interface", "test"]

        def run(_folder, registration, _where, _controller, say):
            begun.append(registration)
            for line in stalled:
                say("controller", line)
            told = left.pop(0)
            if isinstance(told, Exception):
                raise told
            return told

        for name, stub in {
            "serve_bus": part,
            "run_controller": part,
            "run_session": run,
            "reviewed": lambda log: {"log": str(log), "verify": "OK", "replay": "IDENTICAL"},
            "write_report": report,
        }.items():
            monkeypatch.setattr(demo, name, stub)
        monkeypatch.setattr(demo, "_summary", lambda *_: None)
        code = execute(["demo", "--out", str(tmp_path / "demo"), *["--json"] * as_json])
        said = capsys.readouterr()
        return code, json.loads(said.out) if as_json else said.out, said.err, begun

    return play


def test_two_sessions_as_told_are_a_success(played):
    code, document, said, begun = played(ran(FIRST), ran(SECOND))
    assert (code, document["as_told"], document["why"], begun) == (0, True, [], [FIRST, SECOND])
    assert "Left behind" not in said


def test_each_session_has_a_report_beside_its_log_that_is_named(played):
    written = []
    _, document, _, _ = played(ran(FIRST), ran(SECOND), report=lambda *given: written.append(given))
    pages = [Path(f"logs/{name}").with_suffix(".html") for name in (f"{FIRST}.mcap", f"{SECOND}.mcap")]
    assert written == [([page.with_suffix(".mcap")], page) for page in pages]
    assert document["reports"] == [str(page) for page in pages]


def test_a_session_that_ends_otherwise_has_a_report_as_well(played):
    _, _, said, _ = played(ran(FIRST, **LATE))
    assert f"Why, as a page for a browser: logs/{Path(FIRST).stem}.json.html" in said


def test_a_report_that_cannot_be_written_is_said_with_what_to_do(played):
    def full(_logs, page):
        raise InputError(page, "--out", None, "cannot be written (No space left on device)", "name another")

    code, document, said, _ = played(ran(FIRST), ran(SECOND), report=full)
    assert (code, document["reports"], len(document["why"])) == (3, [], 2)
    assert "cannot be written (No space left on device)" in said


@pytest.mark.parametrize("late", [0, 1])
def test_a_demo_that_is_late_says_which_side_by_how_much_what_to_do_and_what_is_left(played, late, tmp_path):
    sessions = [ran(FIRST), ran(SECOND)]
    sessions[late] |= LATE
    stalled = "this computer stood still for 612 ms; 9 frames discarded"
    code, document, said, begun = played(*sessions, stalled=[stalled])
    assert code == 3
    assert begun == [FIRST, SECOND][: late + 1], "nothing is begun that nobody would acknowledge"
    assert document["as_told"] is False
    assert len(document["sessions"]) == late + 1
    assert (
        "became no verdict, stopped: no fresh controller heartbeat within 500 ms; this computer stood still for 640 ms"
        in said
    )
    assert f"controller: {stalled}" in said
    assert "chrt --rr 10 cutgate demo" in said
    assert f"Left behind: {tmp_path / 'demo'} with key, inputs and logs" in said
    assert f"Next: cutgate audit show logs/{begun[-1]}.mcap" in said
    assert document["why"][0] in said


@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": None, "reason": "no controller announced itself within 30 s"},
        {"outcome": "stopped", "cause": "TRANSFER_FAILED"},
    ],
)
def test_a_session_that_ends_otherwise_for_another_reason_is_not_called_late(played, changes):
    code, _, said, begun = played(ran(FIRST, **changes))
    assert (code, begun) == (3, [FIRST])
    assert "was to be inadmissible, not admitted, and became" in said
    assert TOO_BUSY not in said


def test_a_part_that_fails_leaves_a_document_and_words_as_well(played):
    code, document, said, _ = played(ran(FIRST), DemoError("the controller ended"))
    assert (code, document["as_told"], document["why"]) == (3, False, ["the controller ended"])
    assert "demo: the controller ended" in said
    assert "Left behind: " in said


def test_words_of_a_late_demo_are_data(played):
    _, out, said, _ = played(ran(FIRST, **LATE | {"reason": "\x1b[2J[/]"}), as_json=False)
    assert out == ""
    assert r"\x1b[2J[/]" in said
