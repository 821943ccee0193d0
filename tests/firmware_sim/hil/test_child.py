"""A process under test: what it says is heard, however much it is, and every wait has an end."""

import os
import sys

import pytest

from cutgate.firmware_sim.hil import child
from cutgate.firmware_sim.hil.child import HilProcess, HilTimeoutError, environment

pytestmark = pytest.mark.processes

ECHO = (
    "import sys\nprint('ready', flush=True)\nfor line in sys.stdin: print('heard', line.strip(), flush=True)"
)


@pytest.fixture
def started(tmp_path):
    """Starts Python with this code; ended after the test."""
    processes = []

    def start(code, **how):
        process = HilProcess("program", [sys.executable, "-c", code], environment(tmp_path / "state"), **how)
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.end()


def test_it_is_typed_at_and_its_next_line_that_matches_is_waited_for(started):
    process = started(ECHO)
    assert process.expect("ready") == "ready"
    process.type("one")
    process.type("two")
    assert process.expect("tw.$") == "heard two"
    with pytest.raises(
        HilTimeoutError, match="program did not say 'one'; it said\nready\nheard one\nheard two"
    ):
        process.expect("one", timeout_s=0.01)
    assert process.running
    assert process.end() == -15
    assert not process.running
    process.type("three")


def test_one_that_ends_is_not_waited_for_to_the_end_of_time(started):
    process = started("print('a'); raise SystemExit(3)")
    with pytest.raises(HilTimeoutError, match="it said\na"):
        process.expect("b", timeout_s=600)
    assert process.exit_code() == 3


def test_one_that_goes_on_is_told_so_and_one_that_ignores_its_end_is_killed(started):
    process = started(
        "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('deaf', flush=True)\nsignal.pause()"
    )
    process.expect("deaf")
    with pytest.raises(HilTimeoutError, match="did not end; it said\ndeaf"):
        process.exit_code(0.01)
    assert process.end(timeout_s=0.01) == -9


def test_a_document_is_kept_apart_from_the_lines(started):
    process = started("import sys; print('{}'); print('line', file=sys.stderr)", document=True)
    assert process.exit_code() == 0
    assert (process.document, process.lines) == ("{}\n", ("line",))


def test_what_is_said_is_data_and_bounded(started, monkeypatch):
    monkeypatch.setattr(child, "LINES_MAX", 3)
    monkeypatch.setattr(child, "DOCUMENT_MAX", 1)
    code = "import sys, os; os.write(1, b'z' * 200000)\nos.write(2, b'\\x1b[31m\\xff\\n' + b'x' * 3000 + b'\\n1\\n2\\n')"
    process = started(code, document=True)
    assert process.exit_code() == 0
    assert process.lines == ("\\x1b[31m\ufffd", "x" * child.LINE_MAX, "x" * (3000 - child.LINE_MAX))
    assert len(process.document) == 65536


def test_the_users_own_state_is_left_alone(tmp_path):
    assert environment(tmp_path) == {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
