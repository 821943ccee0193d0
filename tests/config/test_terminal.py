"""Words from a terminal: whole lines of one vocabulary, read without waiting."""

import os
from enum import StrEnum

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.terminal import LINE_BYTES_MAX, READ_BYTES, WordReader


class Word(StrEnum):
    START = "start"
    STOP = "stop"


class Typing:
    """A pipe and the reader at its end."""

    def __init__(self):
        reading, self.writing = os.pipe2(os.O_NONBLOCK)
        self.descriptor = reading
        self.reader = WordReader(reading, Word)

    def words(self, data):
        os.write(self.writing, data)
        return self.reader.read()

    def close(self):
        for descriptor in (self.descriptor, self.writing):
            os.close(descriptor)


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
    found = typing.reader.read()
    assert found == words if words is not None else not isinstance(found[0], Word)
    assert typing.reader.descriptor is None
    assert typing.reader.read() == []
    typing.writing = os.open(os.devnull, os.O_WRONLY)


def test_a_descriptor_that_fails_ends_the_reading():
    reading, writing = os.pipe()
    reader = WordReader(writing, Word)  # cannot be read
    assert reader.read() == []
    assert reader.descriptor is None
    os.close(reading)
    os.close(writing)


@pytest.mark.parametrize("junk", [b"x" * LINE_BYTES_MAX, b" " * (2 * READ_BYTES), b"start" + b" " * 300])
def test_the_tail_of_a_line_that_is_too_long_makes_no_word(typing, junk):
    """Blanks before or behind must not turn a pasted line into an order."""
    os.write(typing.writing, junk)
    while len(junk) > 0:
        assert typing.reader.read() == []
        junk = junk[READ_BYTES:]
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
    found += typing.reader.read()
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
