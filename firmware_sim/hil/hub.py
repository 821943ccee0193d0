"""The local virtual bus as a process of its own, for as long as a test wants it."""

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from cutgate.config.interpreter import program

END_TIMEOUT_S: Final = 10.0


@contextmanager
def hub_process(path: Path, *arguments: str, log: Path | None = None) -> Iterator[subprocess.Popen[str]]:
    """A hub in a process of its own, serving on `path` when the block is entered and ended after it.

    Args:
        path: of its socket.
        arguments: more of `cutgate bus serve`, as `--bitrate 1M`.
        log: a new file for the frames.

    It ends by itself when this process dies. The block may end or kill it.

    Raises:
        RuntimeError: it did not come up; the message holds what it said.
    """
    command = program("cutgate.firmware_sim", "bus", "serve", "--socket", str(path), "--until-stdin-closes")
    command += arguments
    if log is not None:
        command += ["--log", str(log)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as hub:  # noqa: S603
        assert hub.stdout is not None  # noqa: S101 - a pipe was asked for
        line = hub.stdout.readline()
        if not line.startswith("serving on "):
            raise RuntimeError(f"the hub on {path} did not come up; it said {line!r}")
        try:
            yield hub
        finally:
            hub.terminate()
            hub.wait(END_TIMEOUT_S)


@pytest.fixture
def virtual_bus() -> Iterator[Path]:
    """The socket of a hub in a process of its own: the channel of `can.Bus(interface="cutgate")`."""
    # Not pytest's tmp_path: a socket's path has at most 107 bytes.
    with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
        path = Path(directory) / "bus.sock"
        with hub_process(path):
            yield path
