"""Logs of sessions, and what is told of them."""

from pathlib import Path

import pytest

from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.story import story
from tests.runtime.audit.build import session_log

OLD = Path(__file__).parents[3] / "compat" / "0.1.0" / "sessions"
NAMES = {
    "finished": "eea20e88",
    "refused": "aafdf719",
    "stopped": "0cac3de8",
    "crashed": "0fbca8e4",
    "withdrawn": "c0838631",
    "latched": "31522be0",
    "reset": "b7809ef8",
}


@pytest.fixture(scope="session")
def old_logs():
    """The bytes of a log of each kind, as 0.1.0 wrote them."""
    return {name: next(OLD.glob(f"*-{end}.mcap")).read_bytes() for name, end in NAMES.items()}


@pytest.fixture(scope="session")
def told(old_logs):
    """The story of each."""
    return {name: story(read_log(data), Path(f"{name}.mcap"), None) for name, data in old_logs.items()}


@pytest.fixture(scope="session")
def admitted(tmp_path_factory):
    """A log of this version, admitted and cut."""
    return session_log(tmp_path_factory.mktemp("admitted")).log.read_bytes()
