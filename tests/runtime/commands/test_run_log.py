"""What ``cutgate run`` does about its log: whom it tells what, and that a log that was not closed is no success."""

from types import SimpleNamespace

import pytest

from cutgate.runtime.audit.directory import Previous
from cutgate.runtime.audit.log import Paths
from cutgate.runtime.audit.log_keys import HeldKey
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.commands import run as command
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase


class Screen(list):
    """A view that keeps its notes."""

    note = list.append


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("phase", sorted(ENDED))
def test_a_session_whose_log_was_not_closed_exits_3_however_it_ended(
    tmp_path, tmp_path_factory, monkeypatch, phase, closed
):
    from tests.runtime.session.pair import job_of  # noqa: PLC0415 - it imports both sides of the bus

    files, job = job_of(tmp_path_factory)
    session = SimpleNamespace(
        state=SimpleNamespace(phase=phase, reason="", controller=None), answer=None, stopped_in=None
    )
    paths = Paths(tmp_path / "a.mcap", tmp_path / "a.candump.log", closed, "" if closed else "it was deleted")
    for name, value in {
        "read_files": lambda *_, **__: files,
        "_key": lambda *_: bytes(32),
        "make_job": lambda *_, **__: job,
        "Check": lambda *_: None,
        "_bus": lambda *_, **__: (SimpleNamespace(shutdown=lambda: None), "test/x"),
        "conduct": lambda *_, **__: (session, paths),
    }.items():
        monkeypatch.setattr(command, name, value)
    words = ["run", "plan.csv", "--robot", "r", "--registration", "g", "--log-dir", str(tmp_path / "logs")]
    expected = {Phase.DONE: 0, Phase.REFUSED: 1, Phase.STOPPED: 3}[phase] if closed else 3
    assert execute(words) == expected


@pytest.mark.parametrize(
    ("previous", "told"),
    [
        (Previous(), []),
        (Previous("a.mcap", "ab"), []),
        (
            Previous("a.mcap", "ab", crashed=True),
            ["the session before this one (a.mcap) did not end in order"],
        ),
        (
            Previous(None, None, crashed=True, note="HEAD could not be read: why"),
            [
                "the session before this one (its log is unknown) did not end in order",
                "the log directory: HEAD could not be read: why",
            ],
        ),
        (Previous("a.mcap", "ab", note="a.mcap is gone"), ["the log directory: a.mcap is gone"]),
    ],
)
def test_the_operator_is_told_what_is_wrong_with_the_session_before(previous, told):
    screen = Screen()
    command._tell(SimpleNamespace(previous=previous, held=SimpleNamespace(enrolled=None)), screen)
    assert screen == told


@pytest.mark.parametrize("made", [True, False])
def test_the_operator_is_told_of_a_key_that_was_enrolled_and_where_its_public_half_is(tmp_path, made):
    key = LogKey(bytes(16), 1, bytes(32))
    held = HeldKey(key, tmp_path / "a.key", "enrolled here", made=made)
    screen = Screen()
    command._tell(SimpleNamespace(previous=Previous(), held=held), screen)
    where = f"; its public half is in {tmp_path / 'a.key.pub'}: keep a copy elsewhere" if made else ""
    assert screen == [f"log key {key.public.fingerprint} enrolled here{where}"]
