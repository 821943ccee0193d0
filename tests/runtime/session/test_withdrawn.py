"""The runtime's own list of withdrawn registrations: what was added stays, and a list that cannot be read stops."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.runtime.audit.log import AuditLog, OpenInfo
from cutgate.runtime.session import withdrawn
from tests.runtime.audit.build import LOG_ID, small_log

DIGESTS = st.binary(min_size=32, max_size=32)


@given(st.lists(st.tuples(DIGESTS, st.from_regex(r"[0-9a-zA-Z.-]{1,40}", fullmatch=True)), max_size=5))
def test_what_was_added_is_read_in_every_later_session(tmp_path_factory, entries):
    directory = tmp_path_factory.mktemp("logs")
    for digest, log in entries:
        withdrawn.add(directory, digest, log)
    assert withdrawn.load(directory) == dict(entries)


@pytest.mark.parametrize("directory", ["", "never made"])
def test_nothing_is_listed_where_nothing_was_withdrawn(tmp_path, directory):
    assert withdrawn.load(tmp_path / directory) == {}


@pytest.mark.parametrize(
    "line", ["", "beef a.mcap", "x" * 64 + " a.mcap", "ab" * 31 + " a.mcap", "ab" * 33 + " a.mcap", " " * 70]
)
def test_a_line_that_is_no_entry_is_named(tmp_path, line):
    withdrawn.add(tmp_path, bytes(32), "a.mcap")
    with (tmp_path / withdrawn.WITHDRAWN).open("a", encoding="ascii") as file:
        file.write(line + "\n")
    with pytest.raises(InputError, match=r"line 2.*restore the list"):
        withdrawn.load(tmp_path)


def test_a_list_that_cannot_be_read_stops(tmp_path):
    (tmp_path / withdrawn.WITHDRAWN).mkdir()
    with pytest.raises(InputError, match="not a regular file"):
        withdrawn.load(tmp_path)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / withdrawn.WITHDRAWN).write_bytes(b"\xff\n")
    with pytest.raises(InputError, match="cannot be read"):
        withdrawn.load(tmp_path / "b")


def test_a_list_that_has_lost_a_line_stops(tmp_path):
    small_log(tmp_path)
    for number in range(2):
        withdrawn.add(tmp_path, bytes([number]) * 32, "a.mcap")
    file = tmp_path / withdrawn.WITHDRAWN
    file.write_bytes(file.read_bytes().splitlines(keepends=True)[0])
    with pytest.raises(InputError, match="at least the 2 lines"):
        withdrawn.load(tmp_path)


@pytest.mark.parametrize("lost", [("WITHDRAWN",), ("HEAD", "WITHDRAWN")])
def test_a_list_that_is_lost_while_a_session_runs_is_missed_by_the_next_one(tmp_path, lost):
    """Also where this session adds to it, and nothing on the disk tells any more what stood there."""
    small_log(tmp_path)
    withdrawn.add(tmp_path, bytes(32), "a.mcap")
    log = AuditLog.create(tmp_path, log_id=LOG_ID, opened=OpenInfo("cutgate", "cutgate"))
    for name in lost:
        (tmp_path / name).unlink()
    log.listed = withdrawn.add(tmp_path, bytes([1]) * 32, log.path.name, log.listed)
    assert log.close(final_state="stopped", clean=True).closed
    with pytest.raises(InputError, match="at least the 1 lines"):
        withdrawn.load(tmp_path)


def test_a_list_that_others_can_write_stops(tmp_path):
    withdrawn.add(tmp_path, bytes(32), "a.mcap")
    (tmp_path / withdrawn.WITHDRAWN).chmod(0o666)
    with pytest.raises(InputError, match="mode is 0666"):
        withdrawn.load(tmp_path)
    with pytest.raises(InputError, match="mode is 0666"):
        withdrawn.add(tmp_path, bytes(32), "b.mcap")
