"""Whatever is cut off a log, what was whole in it comes back, in a file that every reader opens and none calls whole."""

import errno

import pytest

from cutgate.runtime.audit.commit import InTurn
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.recovered import RECOVERED, Recovered
from cutgate.runtime.audit.recovery import agrees
from cutgate.runtime.audit.signing.log_key import LogKey
from tests.logs import create
from tests.runtime.audit.build import (
    LOG_ID,
    OPENED,
    PATIENCE_S,
    Ticking,
    WatchedDisk,
    decision,
    session_log,
)
from tests.runtime.audit.cuts import (
    MAGIC,
    TOLD,
    Whole,
    by_index,
    cut_off,
    each,
    recovered,
    smallest_log_with_a_start,
    zeros_behind,
)
from tests.runtime.audit.test_recovery import NOTHING


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A session that was permitted, started and closed."""
    return Whole(session_log(tmp_path_factory.mktemp("session")).log.read_bytes())


def check(whole, cut, left):
    """The copy holds what was whole, says so, and is INCOMPLETE; where not even record 0 was whole there is none."""
    messages, attachments = whole.kept(left)
    found = recovered(left)
    if not messages:
        assert found == ("this is not an audit log of cutgate" if cut < len(MAGIC) else NOTHING), cut
        return
    assert not isinstance(found, str), (cut, found)
    copy, told, original = found
    own = ("cutgate", {"log_id": LOG_ID, "software": OPENED.software})
    assert by_index(copy) == (messages, attachments, [own, (RECOVERED, told.metadata().metadata)]), cut
    assert told == Recovered(*TOLD[:2], len(left), original.report.dropped_bytes, len(messages), TOLD[2])
    read = read_log(copy, b"")
    assert (read.report.status, read.report.messages) == (Status.INCOMPLETE, len(messages)), (
        cut,
        read.report,
    )
    assert read.report.reasons[0] == f"it is a recovered copy of cut.mcap, {told.dropped} bytes dropped"
    assert agrees(read, original, told)


@pytest.mark.no_cover
@pytest.mark.parametrize("part", ["boundaries", "seeded"])
def test_wherever_a_log_is_cut_what_is_whole_comes_back(whole, part):
    for cut, left in each(whole, getattr(whole, part)(), cut_off):
        check(whole, cut, left)


@pytest.mark.no_cover
def test_zeros_behind_the_cut_change_nothing(whole):
    """A loss of power leaves them, also between the close record and the sync of the file's end."""
    for cut, left in each(whole, whole.seeded(), zeros_behind):
        check(whole, cut, left)


@pytest.mark.long
def test_at_every_byte_of_the_smallest_log_with_a_start(tmp_path):
    """27 kB, so as many cuts: the attachments and records that every session has are in it."""
    whole = Whole(smallest_log_with_a_start(tmp_path))
    assert 20_000 < len(whole.data) < 30_000
    topics = [said.topic for _, several in whole.messages for said in several]
    assert topics.count("/audit/permit") == 4
    for cut, left in each(whole, list(range(len(whole.data))), cut_off):
        check(whole, cut, left)


@pytest.mark.parametrize("number", range(9, 46, 5))
def test_what_a_full_disk_has_left_is_recovered(tmp_path, number):
    def full(operation, count):
        if (operation, count) == ("write", number):
            raise OSError(errno.ENOSPC, "full")

    def written(folder, **disk):
        folder.mkdir()
        key = folder.with_suffix(".key")
        key.write_bytes(LogKey(bytes(16), 1, bytes(32)).encode())
        key.chmod(0o600)
        opened = {"clock": Ticking().clock(), "disk": WatchedDisk(short=500, **disk), "key_file": key}
        # In turn: when a commit is reported must be the same in both, for the clock is asked then.
        log = create(folder, log_id=LOG_ID, opened=OPENED, committer=InTurn, **opened)
        log.attach("plan.csv", "text/csv", b"x,y,z\n" * 900)
        for step in range(9):
            log.write(decision(step))
        return log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)

    whole = Whole(written(tmp_path / "roomy").log.read_bytes())
    paths = written(tmp_path / "full", trouble=full)
    left = paths.log.read_bytes()
    assert not paths.closed
    assert whole.data.startswith(left)
    check(whole, len(left), left)
