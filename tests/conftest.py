"""What holds for every test: which may start a process, and that Ctrl-C reaches whatever they start."""

import multiprocessing.util
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest

STARTS = frozenset({"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system"})
"""Audit events of a new process."""

_running: pytest.Item | None = None


def pytest_configure() -> None:
    # Where the one who starts the tests ignores Ctrl-C (nohup, a job in the background), that is inherited by every
    # program, and those tests of it would wait in vain. A handler is not inherited: children begin with the default.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.addaudithook(_audit)
    # multiprocessing starts its helpers without an audit event of their own.
    start = multiprocessing.util.spawnv_passfds

    def spawnv_passfds(*words: Any) -> int:
        _must_be_marked()
        return start(*words)

    multiprocessing.util.spawnv_passfds = spawnv_passfds


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    global _running  # noqa: PLW0603 - an audit hook is told nothing of pytest
    _running = item
    try:
        return (yield)
    finally:
        _running = None


def _audit(event: str, _arguments: tuple[Any, ...]) -> None:
    if event in STARTS:
        _must_be_marked()


def _must_be_marked() -> None:
    """A test that starts a process is marked ``processes``, so that it runs when nothing else needs the processor."""
    if _running is not None and _running.get_closest_marker("processes") is None:
        pytest.fail("this test starts a process: mark it with pytest.mark.processes")
