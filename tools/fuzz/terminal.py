"""Words on a terminal: the same words however the bytes are cut up, and nothing that was not typed as a line."""

import os
from collections.abc import Iterator

from cutgate.config.terminal import LINE_BYTES_MAX, READ_BYTES, CommandReader
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.runtime.interlock.state import OperatorCommand
from tools.fuzz.harness import Family, expect

VOCABULARIES = (OperatorCommand, ConsoleCommand)


def check(data: bytes) -> None:
    """The first byte chooses the vocabulary, the second where the rest is cut up."""
    words = VOCABULARIES[(data[0] if data else 0) % 2]
    size, typed = 1 + (data[1] if len(data) > 1 else 0), data[2 : 2 + READ_BYTES]
    reading, writing = os.pipe2(os.O_NONBLOCK)
    heard: list[str] = []
    try:
        reader = CommandReader(reading, words)
        for at in range(0, len(typed), size):
            os.write(writing, typed[at : at + size])
            heard += reader.read()
            expect(len(reader._rest) <= LINE_BYTES_MAX + 3, "what waits is bounded")  # noqa: SLF001
        expect(reader.read() == [], "nothing typed, nothing heard")
    finally:
        os.close(writing)
        os.close(reading)
    _compare(words, typed, heard)


def _compare(words: type[OperatorCommand] | type[ConsoleCommand], typed: bytes, heard: list[str]) -> None:
    """A line that is too long may be refused for its blanks; any other is a word or is not."""
    *lines, _ = typed.split(b"\n")
    texts = [(line.decode("ascii", "replace").strip().lower(), len(line)) for line in lines]
    said = [text for text, _ in texts if text in set(words)]
    if all(length <= LINE_BYTES_MAX for text, length in texts if text in set(words)):
        expect([word for word in heard if isinstance(word, words)] == said, "a word is a whole line")
    expect(all(len(word) <= LINE_BYTES_MAX for word in heard), "what is refused is short")


def _seeds() -> Iterator[bytes]:
    for number, words in enumerate(VOCABULARIES):
        for size in (0, 2, 255):
            text = "\n".join(words).encode() + b"\n  START \r\nstart stop\n\xff\xfe\n"
            yield bytes([number, size]) + text
            yield bytes([number, size]) + b"x" * 300 + b"stop\nstop\n" + b" " * 300 + b"stop\n"


FAMILY = Family(check, tuple(_seeds()))
