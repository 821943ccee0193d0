"""What the demo says to its processes, each thing once, and that nobody is waited for without a word."""

import os
from types import SimpleNamespace

import pytest

from cutgate.runtime.demo import processes
from cutgate.runtime.demo.script import CUES


def stream(descriptor):
    """As much of a pipe's stream as is asked for."""
    return SimpleNamespace(fileno=lambda: descriptor)


def conversation(*lines):
    """What the demo answers to these lines of the runtime; its input may be closed."""
    reading, writing = os.pipe()
    cues = list(CUES)
    children = {name: SimpleNamespace(stdin=stream(writing)) for name in ("runtime", "controller")}
    for line in lines:
        processes.answer(cues, line, children, lambda *_: None)
    os.close(writing)
    heard = os.read(reading, 4096)
    os.close(reading)
    return heard.decode().split()


def test_a_stop_that_came_late_to_the_session_before_is_acknowledged_once():
    held = "its cause is HEARTBEAT_LOST: say acknowledge"
    assert conversation(held, held, "permitted: cutting mode is on.") == ["acknowledge", "hold"]


def test_a_runtime_that_has_just_ended_is_not_spoken_to_and_nothing_breaks():
    reading, writing = os.pipe()
    os.close(reading)
    runtime = SimpleNamespace(stdin=stream(writing))
    processes.answer(list(CUES), "say acknowledge", {"runtime": runtime}, lambda *_: None)
    os.close(writing)


def test_no_session_is_waited_for_without_saying_what_it_said_last(monkeypatch):
    reading, writing = os.pipe()
    os.write(writing, b"what it waits for\n")
    monkeypatch.setattr(processes, "DEADLINE_S", 0.05)
    children = {"runtime": SimpleNamespace(stderr=stream(reading), stdin=None)}
    with pytest.raises(
        processes.DemoError, match=r"did not end within 0.05 s; the runtime last said: what it waits for"
    ):
        processes.converse(children, lambda *_: None)
    os.close(writing)
    os.close(reading)
