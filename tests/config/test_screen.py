"""A person's screen: nothing that is handed over to it waits, and everything it drops is counted."""

import contextlib
import fcntl
import logging
import os
import re
import select
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config import screen as screen_module
from cutgate.config.screen import (
    LINE_MAX,
    SHOWN_MAX,
    WAITING_MAX,
    Screen,
    diverted,
    last_words,
    printable,
    screens,
)

WAIT_S = 20.0


def eventually(condition):
    """Wait for what another thread does."""
    for _ in range(int(WAIT_S * 1000)):
        if condition():
            return
        select.poll().poll(1.0)
    pytest.fail("it did not happen")


class Reader:
    """A screen and whoever reads it; the pipe between them is small."""

    def __init__(self):
        self.reading, self.writing = os.pipe2(os.O_CLOEXEC)
        fcntl.fcntl(self.writing, fcntl.F_SETPIPE_SZ, 4096)
        self.screen = Screen(self.writing)

    def stop_reading(self):
        """From now on every line waits: the pipe is full. Returns how much is in it."""
        again, filled = os.open(f"/proc/self/fd/{self.writing}", os.O_WRONLY | os.O_NONBLOCK), 0
        with contextlib.suppress(BlockingIOError):
            while True:
                filled += os.write(again, b"." * 4096)
        os.close(again)
        self.screen.say("waits for the reader")
        eventually(lambda: self.screen._waiting.qsize() == 0)  # its thread has it in hand
        return filled

    def read(self):
        """Everything until the screen has ended and its pipe is closed."""
        self.screen.end()
        closing = threading.Thread(target=self._close)
        closing.start()
        with os.fdopen(self.reading, "rb") as stream:
            told = stream.read()
        closing.join(WAIT_S)
        return told.decode()

    def _close(self):
        assert self.screen.wait(WAIT_S)
        os.close(self.writing)


@pytest.fixture
def reader():
    return Reader()


def test_lines_come_in_the_order_in_which_they_are_handed_over(reader):
    for number in range(100):
        reader.screen.say(f"line {number}")
        reader.screen.show(lambda number=number: f"answer {number}\nof two lines\n")
    expected = [f"line {number}\nanswer {number}\nof two lines\n" for number in range(100)]
    assert reader.read() == "".join(expected)


@pytest.mark.parametrize("more", [0, 1, 7, 3 * WAITING_MAX])
def test_a_screen_that_nobody_reads_holds_up_nobody_and_says_what_it_dropped(reader, more):
    filled = reader.stop_reading()
    for number in range(WAITING_MAX + more):
        reader.screen.say(f"{number}")
        assert reader.screen._waiting.qsize() <= WAITING_MAX
    assert not reader.screen.wait(0.0)
    first, *rest = reader.read()[filled:].splitlines()
    assert first == "waits for the reader"
    if more:
        assert rest.pop(0) == f"({more} lines dropped here: the screen did not keep up)"
    assert rest == [f"{number}" for number in range(more, WAITING_MAX + more)]


@given(st.lists(st.integers(0, 12), min_size=1, max_size=12))
def test_what_is_shown_and_what_is_said_to_be_dropped_is_all_there_was(bursts):
    """A reader that comes and goes, with a queue of four."""
    before, screen_module.WAITING_MAX = screen_module.WAITING_MAX, 4
    try:
        reader, said, told, at_once = Reader(), 0, [], threading.Semaphore(0)
        for burst in bursts:
            reader.screen.show(lambda: at_once.acquire(timeout=WAIT_S) and "")  # holds its thread up
            for _ in range(burst):
                reader.screen.say(f"{said}")
                said += 1
            at_once.release()
        for _ in bursts:  # those that hold up may have been dropped
            at_once.release()
        told = reader.read().splitlines()
    finally:
        screen_module.WAITING_MAX = before
    numbers = [int(line) for line in told if line.isdigit()]
    dropped = sum(int(line.split()[0][1:]) for line in told if not line.isdigit())
    assert numbers == sorted(numbers)
    assert said <= len(numbers) + dropped <= said + len(bursts)


def test_a_reader_that_has_gone_leaves_it_silent(reader):
    os.close(reader.reading)
    for _ in range(3 * WAITING_MAX):
        reader.screen.say("nobody hears this")
    reader.screen.end()
    assert reader.screen.wait(WAIT_S)
    os.close(reader.writing)


def test_the_end_waits_for_a_bounded_time(reader, monkeypatch):
    monkeypatch.setattr(screen_module, "FLUSH_S", 0.05)
    reader.stop_reading()
    with screens(reader.writing) as (one,):
        one.say("never seen")
    assert not one.wait(0.0)
    os.close(reader.reading)
    for screen in (one, reader.screen):
        screen.end()
        assert screen.wait(WAIT_S)
    os.close(reader.writing)


def test_a_descriptor_that_others_have_made_fail_instead_of_wait_is_waited_for(reader):
    os.set_blocking(reader.writing, False)
    reader.stop_reading()
    for number in range(400):
        reader.screen.say(f"{number} {'x' * 100}")
    told = reader.read().splitlines()
    assert [line.split()[0] for line in told[-400:]] == [f"{number}" for number in range(400)]


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("a\x1b[2Jb", r"a\x1b[2Jb"),
        ("a\r\nb\tc", r"a\r\nb\tc"),
        ("\x9b31m", r"\x9b31m"),
        ("right\u202eto left", r"right\u202eto left"),
        ("no\udcff byte", r"no\udcff byte"),
        ("[bold]x[/]", "[bold]x[/]"),
        ("Hüftschaft 5 µm", "Hüftschaft 5 µm"),
        ("x" * (LINE_MAX + 1), "x" * LINE_MAX + "..."),
    ],
)
def test_what_is_said_is_data_on_one_line_of_a_bounded_length(reader, line, shown):
    reader.screen.say(line)
    assert reader.read() == f"{shown}\n"


@given(st.text())
def test_nothing_that_moves_a_cursor_is_printable(text):
    made = printable(text)
    assert made.isprintable() or not made
    assert not re.search(r"[\x00-\x1f\x7f-\x9f]", made)
    assert text != made or text.isprintable() or not text


def test_an_answer_has_a_bounded_length(reader):
    reader.screen.show(lambda: "x" * 10 * SHOWN_MAX)
    told = threading.Thread(target=reader.screen.end)
    told.start()
    text = reader.read()
    assert text == "x" * SHOWN_MAX + "\n(and more than a screen holds)\n"
    told.join(WAIT_S)


def test_an_answer_that_cannot_be_made_is_told_and_the_next_one_shown(reader):
    def fail():
        raise ValueError("two\nlines")

    reader.screen.show(fail)
    reader.screen.say("next")
    assert reader.read() == "(cannot be shown: ValueError: two\\nlines)\nnext\n"


def test_only_the_screens_own_thread_writes(reader, monkeypatch):
    written, write = [], os.write
    monkeypatch.setattr(
        os, "write", lambda *what: written.append(threading.current_thread().name) or write(*what)
    )
    reader.screen.say("a line")
    reader.screen.show(lambda: "an answer\n")
    reader.read()
    assert set(written) == {f"screen-{reader.writing}"}


def test_two_that_lead_to_the_same_place_are_one_screen():
    reading, writing = os.pipe2(os.O_CLOEXEC)
    again, nowhere = os.dup(writing), os.open(os.devnull, os.O_WRONLY)
    with screens(writing, again, nowhere) as (one, same, other):
        assert one is same
        assert other is not one
        one.say("1")
        same.say("2")
    for descriptor in (writing, again, nowhere):
        os.close(descriptor)
    assert os.read(reading, 100) == b"1\n2\n"
    os.close(reading)


def test_whatever_prints_in_the_meantime_prints_through_the_screen(reader):
    before = sys.stdout, sys.stderr
    with diverted(reader.screen):
        print("printed", flush=True)  # noqa: T201
        print("in two ", end="")  # noqa: T201
        print("parts", file=sys.stdout)  # noqa: T201
        sys.stderr.write("\x1b[31mred\nleft over")
        logging.lastResort.handle(logging.makeLogRecord({"msg": "logged", "levelno": logging.WARNING}))
        assert sys.stdout.writable()
    assert (sys.stdout, sys.stderr) == before
    told = reader.read().splitlines()
    assert told == ["printed", "in two parts", "\\x1b[31mred", "left overlogged"]


def test_last_words_are_lines_on_standard_error(capfd):
    last_words("cutgate sim: two\nproblems")
    said = capfd.readouterr()
    assert said.err == "cutgate sim: two\nproblems\n"
    assert said.out == ""
