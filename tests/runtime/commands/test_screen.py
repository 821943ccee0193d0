"""Consoles: what a terminal gets and what a pipe gets, and a result whose reader has gone."""

import errno
import io
import os
import subprocess

import pytest
from rich.text import Text

from cutgate.config.interpreter import program
from cutgate.config.screen import Screen
from cutgate.runtime.commands import screen
from cutgate.runtime.commands.screen import LiveConsole, delivered, messages, output

WAIT_S = 20.0


def printed(writing, reading, *texts):
    """What comes out at the other end."""
    to = Screen(writing)
    console = LiveConsole(to)
    for text in texts:
        console.print(lambda text=text: text, soft_wrap=True)
    to.end()
    assert to.wait(WAIT_S)
    return os.read(reading, 1 << 16).decode()


@pytest.mark.parametrize("forced", [{}, {"FORCE_COLOR": "1"}, {"FORCE_COLOR": "1", "NO_COLOR": "1"}])
def test_a_pipe_gets_no_escape_sequences_whatever_is_forced(monkeypatch, forced):
    for name, value in forced.items():
        monkeypatch.setenv(name, value)
    reading, writing = os.pipe()
    assert printed(writing, reading, Text("bold", "bold red"), Text("x" * 300)) == f"bold\n{'x' * 300}\n"
    for descriptor in (reading, writing):
        os.close(descriptor)
    assert not output().is_terminal


def test_a_terminal_gets_colours(monkeypatch):
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    reading, writing = os.openpty()
    assert printed(writing, reading, Text("bold", "bold red")) == "\x1b[1;31mbold\x1b[0m\r\n"
    for descriptor in (reading, writing):
        os.close(descriptor)


def test_a_result_is_delivered(capfd):
    assert delivered("{}")
    assert delivered("told", err=True)
    assert capfd.readouterr() == ("{}\n", "told\n")


def failing(number):
    def echo(*_text, **_how):
        raise OSError(number, os.strerror(number))

    return echo


@pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO])
@pytest.mark.parametrize("err", [False, True])
def test_a_result_whose_reader_has_gone_is_not_and_nothing_is_said_any_more(monkeypatch, capfd, number, err):
    monkeypatch.setattr(screen.typer, "echo", failing(number))
    assert not delivered("{}", err=err)
    os.write(2 if err else 1, b"what the stream still held")
    assert capfd.readouterr() == ("", "")


def test_a_result_that_finds_no_space_is_an_error(monkeypatch):
    monkeypatch.setattr(screen.typer, "echo", failing(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left"):
        delivered("{}")


@pytest.mark.processes
def test_a_refusal_that_nobody_reads_is_a_refusal_and_no_verdict():
    reading, writing = os.pipe()
    os.close(reading)
    command = program("cutgate.runtime.cli", "verify", "missing.csv", "--robot", "example")
    done = subprocess.run(command, stderr=writing, stdin=subprocess.DEVNULL, timeout=WAIT_S, check=False)
    os.close(writing)
    assert done.returncode == 2


def test_messages_do_not_close_the_stream_that_they_are_written_to():
    """Collecting an io object closes it, and closing flushes a stream that whoever made it may have closed before."""
    assert not isinstance(messages().file, io.IOBase)
