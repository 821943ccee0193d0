"""What holds for all tests: order, who may start a process, and that neither a parent nor a disk decides the outcome."""

import gc
import multiprocessing.util
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

STARTS = frozenset({"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system"})
"""Audit events of a new process."""

DEAREST = (
    "exploration",
    "errors",
    "runtime/verification/test_certified_against_dense.py",
    "docs",
    "fault_injection",
    "runtime/conform",
    "system/test_stops.py",
    "runtime/commands/test_conform.py",
    "system",
)
"""What takes longest, in folders and files: it begins first, so that at the end no core is left without work."""

_running: pytest.Item | None = None


def pytest_configure() -> None:
    # Where whoever starts the tests ignores Ctrl-C or a hang-up (nohup, a job in the background), every program inherits
    # that, and the tests of it would wait in vain. A handler is not inherited: children have the default again.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_DFL)
    sys.addaudithook(_audit)
    # multiprocessing starts its helpers without an audit event of their own.
    start = multiprocessing.util.spawnv_passfds

    def spawnv_passfds(*words: Any) -> int:
        _must_be_marked()
        return start(*words)

    multiprocessing.util.spawnv_passfds = spawnv_passfds


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: _rank(item.path))


def _rank(path: Path) -> int:
    name = path.relative_to(Path(__file__).parent)
    return next((rank for rank, first in enumerate(DEAREST) if name.is_relative_to(first)), len(DEAREST))


def pytest_collection_finish() -> None:
    # Thousands of tests and all that they import live to the end: to look through them again and again for something
    # to collect takes a tenth of the time.
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    global _running  # noqa: PLW0603 - an audit hook is told nothing of pytest
    fsync = os.fsync
    if not _marked(item):
        # That bytes are on the disk nobody can see from within one process, and a busy disk lets it wait for seconds.
        os.fsync = os.fstat  # type: ignore[assignment]
    _running = item
    try:
        return (yield)
    finally:
        _running, os.fsync = None, fsync


def _audit(event: str, _arguments: tuple[Any, ...]) -> None:
    if event in STARTS:
        _must_be_marked()


def _must_be_marked() -> None:
    """A test that starts a process is marked, so that it runs when nothing else needs the processor."""
    if _running is not None and not _marked(_running):
        pytest.fail("this test starts a process: mark it with pytest.mark.processes")


def _marked(item: pytest.Item) -> bool:
    # make test-long runs its tests one after the other, with nothing beside them.
    return any(item.get_closest_marker(name) is not None for name in ("processes", "long"))


@pytest.fixture(autouse=True, scope="session")
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keys that sign logs are not put among those of whoever starts the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
