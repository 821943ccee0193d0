"""Whole sessions whose own thread must not write to anybody's screen, told by the view that people see."""

import os
import sys
import threading
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from unittest import mock

import pytest

from cutgate.runtime.commands.session_view import SessionView
from cutgate.runtime.interlock.state import Phase


class Guarded:
    """Standard output or error, which this thread must not touch."""

    encoding = "utf-8"

    def __init__(self, loop):
        self._loop = loop

    def write(self, text):
        assert threading.get_ident() != self._loop, f"the loop's thread prints {text!r}"
        return len(text)

    def flush(self):
        self.write("")


@contextmanager
def guarded():
    """In this block this thread fails where it writes to a screen; what others write is kept."""
    loop, written, write = threading.get_ident(), [], os.write

    def watched(descriptor, data):
        if descriptor in (1, 2):
            assert threading.get_ident() != loop, f"the loop's thread writes {bytes(data)!r}"
            written.append(bytes(data))
            return len(data)
        return write(descriptor, data)

    with mock.patch("os.write", watched), redirect_stdout(Guarded(loop)), redirect_stderr(Guarded(loop)):
        yield written


def test_a_loop_that_prints_is_noticed():
    """The guard itself."""
    for act in (lambda: print("x"), lambda: os.write(2, b"x"), lambda: sys.stderr.write("x")):  # noqa: T201
        with guarded(), pytest.raises(AssertionError, match="loop's thread"):
            act()


@pytest.mark.parametrize("quiet", [True, False])
def test_a_session_cuts_to_its_end_without_writing_to_a_screen_itself(pair, quiet):
    pair.begin()
    with guarded() as written, SessionView(quiet_output=quiet) as view:
        pair.session._view = view
        pair.terminal.type("nonsense\x1b[2J")
        assert pair.end() is Phase.DONE
        view.outcome(pair.state, pair.close())
    told = b"".join(written).decode()
    for line in (
        "ADMISSIBLE",
        "where it lies",
        "entry tip",
        "tip pitch_min at",
        "approach and retract",
        "moving: approach",
        "cutting: ",
        "CUT COMPLETED",
    ):
        assert line in told
    assert "is no command here" in told
    assert "\x1b" not in told


def test_a_session_that_is_refused_does_not_write_to_a_screen_itself(outside):
    outside.begin()
    with guarded() as written, SessionView(quiet_output=False) as view:
        outside.session._view = view
        assert outside.end() is Phase.REFUSED
        view.outcome(outside.state, outside.close())
    told = b"".join(written).decode()
    assert "INADMISSIBLE" in told
    assert "NOT ADMITTED" in told
