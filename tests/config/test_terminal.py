"""Words from a terminal: whole lines of one vocabulary, read without waiting."""

import errno
import fcntl
import os
import select
import subprocess
import sys
import threading
from contextlib import suppress
from enum import StrEnum

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config import terminal
from cutgate.config.interpreter import program
from cutgate.config.terminal import LINE_BYTES_MAX, PASSED_ON_BYTES, READ_BYTES, CommandReader, typed

WAIT_S = 20.0


class Word(StrEnum):
    START = "start"
    STOP = "stop"


class Typing:
    """A pipe and the reader at its end."""

    def __init__(self):
        reading, self.writing = os.pipe2(os.O_NONBLOCK)
        self.descriptor = reading
        self.reader = CommandReader(reading, Word)

    def words(self, data):
        os.write(self.writing, data)
        return all_words(self.reader)

    def close(self):
        for descriptor in (self.descriptor, self.writing):
            os.close(descriptor)


def all_words(reader):
    """Everything that has arrived, turn by turn, as a loop reads it."""
    found = []
    while reader.descriptor is not None and select.select([reader.descriptor], [], [], 0)[0]:
        found += reader.read()
    return found


@pytest.fixture
def typing():
    made = Typing()
    yield made
    made.close()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"start\n", [Word.START]),
        (b"start\nstop\n", [Word.START, Word.STOP]),
        (b"  STOP \r\n", [Word.STOP]),
        (b"\n \n\t\n", []),
        (b"starts\n", ["starts"]),
        (b"\xff\xfestop\n", ["��stop"]),
        (b"stop", []),
        (b"stop\0\n", ["stop\0"]),
    ],
)
def test_a_line_is_a_word_or_comes_back_to_be_refused(typing, data, words):
    found = typing.words(data)
    assert found == words
    assert [type(one) for one in found] == [type(one) for one in words]


def test_a_word_in_pieces_is_read_once_it_is_whole(typing):
    assert typing.words(b"st") == []
    assert typing.words(b"art\nsto") == [Word.START]
    assert typing.words(b"p\n") == [Word.STOP]


def test_nothing_typed_is_no_word_and_does_not_wait(typing):
    assert typing.reader.read() == []
    assert typing.reader.descriptor is not None


def test_the_end_of_the_file_ends_the_reading(typing):
    os.close(typing.writing)
    assert typing.reader.read() == []
    assert typing.reader.descriptor is None
    assert typing.reader.read() == []
    typing.writing = os.open(os.devnull, os.O_WRONLY)


@pytest.mark.parametrize(
    ("left", "words"),
    [(b"stop", [Word.STOP]), (b"stop\n", []), (b"sto", ["sto"]), (b"start" + b" " * 300, None)],
)
def test_the_end_of_the_file_ends_its_last_line(typing, left, words):
    typing.words(left)
    os.close(typing.writing)
    found = all_words(typing.reader)
    assert found == words if words is not None else not isinstance(found[0], Word)
    assert typing.reader.descriptor is None
    assert typing.reader.read() == []
    typing.writing = os.open(os.devnull, os.O_WRONLY)


def test_a_descriptor_that_fails_ends_the_reading():
    reading, writing = os.pipe()
    reader = CommandReader(writing, Word)  # cannot be read
    assert reader.read() == []
    assert reader.descriptor is None
    os.close(reading)
    os.close(writing)


@pytest.mark.parametrize("junk", [b"x" * LINE_BYTES_MAX, b" " * (2 * PASSED_ON_BYTES), b"start" + b" " * 300])
def test_the_tail_of_a_line_that_is_too_long_makes_no_word(typing, junk):
    """Blanks before or behind must not turn a pasted line into an order."""
    assert typing.words(junk) == []
    (word,) = typing.words(b" start\n")
    assert not isinstance(word, Word)
    assert len(word) <= LINE_BYTES_MAX
    assert typing.words(b"stop\n") == [Word.STOP]


def test_what_is_kept_of_a_line_does_not_grow(typing):
    for _ in range(20):
        typing.words(b"y" * READ_BYTES)
    assert len(typing.reader._rest) <= LINE_BYTES_MAX + 3


@given(st.binary(max_size=40).filter(lambda line: b"\n" not in line))
def test_only_the_words_themselves_are_words(line):
    typing = Typing()
    found = typing.words(line + b"\n")
    typing.close()
    meant = line.strip().lower()
    known = meant in (b"start", b"stop")
    assert [isinstance(word, Word) for word in found] == ([known] if found else [])
    assert known <= bool(found)


PIECES = st.sampled_from(
    [b"start", b"stop", b" ", b"\n", b"\r\n", b"x", b" " * 250, b" " * 257, b"\xff", b"y" * 300]
)


def _read(parts):
    """The words of what arrives in these parts, each with a read of its own; the end of the file ends it."""
    typing = Typing()
    found = [word for part in parts for word in typing.words(part)]
    os.close(typing.writing)
    found += all_words(typing.reader)
    os.close(typing.descriptor)
    return [(type(word), word) for word in found]


@given(st.lists(PIECES, max_size=8), st.data())
def test_how_reads_cut_a_line_does_not_change_what_it_says(pieces, data):
    typed = b"".join(pieces)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(typed)), max_size=6)))
    parts = [typed[a:b] for a, b in zip([0, *cuts], [*cuts, len(typed)], strict=True)]
    assert _read([part for part in parts if part]) == _read([typed] if typed else [])


@pytest.mark.parametrize(
    "padded", [LINE_BYTES_MAX - 1, LINE_BYTES_MAX, LINE_BYTES_MAX + 1, LINE_BYTES_MAX + 4]
)
@pytest.mark.parametrize("before", [True, False], ids=["blanks before", "blanks behind"])
def test_a_word_is_judged_alike_wherever_its_padded_line_is_cut(padded, before):
    blanks = b" " * (padded - len(b"start"))
    line = (blanks + b"start" if before else b"start" + blanks) + b"\nstop\n"
    found = _read([line])
    assert [kind for kind, _ in found] == [Word if padded <= LINE_BYTES_MAX else str, Word]
    for cut in range(1, len(line)):
        assert _read([line[:cut], line[cut:]]) == found, cut


def test_a_turn_reads_a_dozen_words_however_many_are_typed(typing):
    os.write(typing.writing, b"stop\n" * 800)
    assert 1 <= len(typing.reader.read()) <= 13
    assert len(all_words(typing.reader)) >= 787


# ---------------------------------------------------------------- a descriptor that others share


class Shared:
    """A pipe whose reading end others may hold as well, and the words that are read from it."""

    def __init__(self):
        self.source, self.writing = os.pipe2(os.O_CLOEXEC)
        self.reader = typed(Word, self.source)
        self._reading = self.reader.descriptor

    def word(self):
        """The next words; waits for them."""
        assert select.select([self.reader.descriptor], [], [], WAIT_S)[0]
        return self.reader.read()

    def end(self):
        """The last writer goes; what is left until the reader has noticed."""
        os.close(self.writing)
        found = []
        while self.reader.descriptor is not None:
            found += self.word()
        os.close(self._reading)
        os.close(self.source)
        return found


@pytest.fixture
def shared():
    return Shared()


def test_words_come_through_in_order_and_so_does_the_end_of_the_file(shared):
    os.write(shared.writing, b"start\n")
    assert shared.word() == [Word.START]
    os.write(shared.writing, b"stop\nsto")
    assert shared.end() == [Word.STOP, "sto"]


def test_a_loop_never_reads_what_others_may_take_away(shared):
    """Its descriptor is its own: nobody can empty it between a poll and a read, and a read of nothing returns."""
    assert shared.reader.descriptor != shared.source
    assert shared.reader.read() == []
    assert shared.reader.descriptor is not None
    assert not fcntl.fcntl(shared.source, fcntl.F_GETFL) & os.O_NONBLOCK  # the flag is everybody's
    assert shared.end() == []


def test_input_that_others_have_made_fail_instead_of_wait_is_asked_again(monkeypatch):
    monkeypatch.setattr(terminal, "AGAIN_S", 0.001)
    reading, writing = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
    refused, read = threading.Event(), os.read

    def watched(descriptor, size):
        try:
            return read(descriptor, size)
        except BlockingIOError:
            refused.set()
            raise

    monkeypatch.setattr(terminal.os, "read", watched)
    reader = typed(Word, reading)
    own = reader.descriptor
    assert refused.wait(WAIT_S)
    os.write(writing, b"stop\n")
    assert select.select([own], [], [], WAIT_S)[0]
    assert reader.read() == [Word.STOP]
    os.close(writing)
    assert select.select([own], [], [], WAIT_S)[0]
    assert reader.read() == []
    assert reader.descriptor is None
    os.close(own)
    os.close(reading)


@pytest.mark.parametrize("failures", [1, 2, terminal.TRIES - 1])
def test_a_terminal_that_is_ours_again_when_it_is_asked_is_read_on(monkeypatch, failures):
    """Reading failed while it belonged to another job, and by the time that is asked it no longer does."""
    monkeypatch.setattr(terminal, "AGAIN_S", 0.001)
    reading, writing = os.pipe2(os.O_CLOEXEC)
    os.write(writing, b"stop\n")
    read, left = os.read, [failures]

    def failing(descriptor, size):
        if descriptor == reading and left[0]:
            left[0] -= 1
            raise OSError(errno.EIO, "of another job")
        return read(descriptor, size)

    monkeypatch.setattr(terminal.os, "read", failing)
    assert terminal._read(reading) == b"stop\n"
    os.close(reading)
    os.close(writing)


def test_a_flood_of_input_waits_where_it_comes_from(shared):
    """What is read ahead is what two pipes hold, whatever is typed."""
    os.set_blocking(shared.writing, False)
    written = 0
    with suppress(BlockingIOError):
        while written < 1 << 20:
            written += os.write(shared.writing, b"stop\n" * (PASSED_ON_BYTES // 5))
    assert written < 1 << 20
    assert set(shared.end()[:-1]) == {Word.STOP}


def test_a_reader_that_goes_ends_the_reading(shared):
    (thread,) = (one for one in threading.enumerate() if one.name == "commands")
    os.close(shared.reader.descriptor)
    os.write(shared.writing, b"stop\n")
    thread.join(WAIT_S)
    assert not thread.is_alive()
    for descriptor in (shared.source, shared.writing):
        os.close(descriptor)


def test_input_that_cannot_be_read_is_at_its_end(monkeypatch):
    monkeypatch.setattr(terminal, "AGAIN_S", 0.001)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    reader = typed(Word, nowhere)
    own = reader.descriptor
    assert select.select([own], [], [], WAIT_S)[0]
    assert reader.read() == []
    assert reader.descriptor is None
    os.close(own)
    os.close(nowhere)


# ---------------------------------------------------------------- streams that are closed

TELL = """
import os, sys
from cutgate.config.terminal import open_standard_streams
open_standard_streams()
print("out")
print("err", file=sys.stderr)
sys.stdin.read()
made = os.open(os.devnull, os.O_RDONLY)
assert made > 2, made
assert all(os.get_inheritable(descriptor) for descriptor in range(3))
"""


@pytest.mark.processes
@pytest.mark.parametrize("closed", ["", "<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_file_never_takes_the_number_of_a_stream_that_was_closed(closed):
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-c", TELL],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ("" if ">&- " in f"{closed} ".replace("2>&-", "") else "out\n")
    assert done.stderr == ("" if "2>&-" in closed else "err\n")


@pytest.mark.processes
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
@pytest.mark.parametrize("module", ["cutgate.runtime.cli", "cutgate.firmware_sim"])
def test_a_program_works_whatever_is_closed_when_it_is_started(module, closed, tmp_path):
    """Refused for the file it is given, as with everything open."""
    words = {
        "cutgate.runtime.cli": ["verify"],
        "cutgate.firmware_sim": ["sim", "--robot", "example", "--key"],
    }
    command = program(module, *words[module], "missing.csv")
    if module == "cutgate.runtime.cli":
        command += ["--robot", "example"]
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", *command],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert ("missing.csv" in done.stderr) == (closed != "2>&-")
