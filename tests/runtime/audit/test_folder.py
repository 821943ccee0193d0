"""What a log says of itself, whatever it holds: nothing of it is believed to be what it should be."""

from dataclasses import replace
from io import BytesIO

import pytest
from mcap.records import Metadata

from cutgate.runtime.audit import records
from cutgate.runtime.audit.archive import _proven
from cutgate.runtime.audit.folder import TREES_MAX, WITNESSES_MAX, count, nanoseconds, session_of, text
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.recovered import RECOVERED, Recovered
from cutgate.runtime.audit.writer import LogWriter
from tests.runtime.audit.build import decision
from tests.runtime.audit.folders import folder_of

OPENED = {
    "log_id": "ab" * 16, "software": "s", "verifier": "v", "numpy": "2", "cpu_dispatch": (), "candump": "c",
    "previous_crashed": False,
}  # fmt: skip


def log_of(*written: records.LogRecord):
    """The session of a log of these records behind record 0; it is signed by nobody."""
    writer = LogWriter("ab" * 16, {})
    for record in (records.AuditOpen(**OPENED), *written):
        writer.add(record, log_time_ns=1, monotonic_ns=1)
    writer.finish()
    return session_of("a.mcap", read_log(BytesIO(writer.take())))


@pytest.mark.parametrize(
    ("value", "found"),
    [(3, 3), (0, 0), (-1, None), (True, None), (1.0, None), ("3", None), (None, None), (1 << 70, None)],
)
def test_a_count_is_a_whole_number_that_fits(value, found):
    assert count({"n": value}, "n") == found


def test_a_text_is_cut_to_what_a_session_writes():
    assert text({"a": "x" * 10_000}, "a") == "x" * 300
    assert text({"a": 3}, "a") is None
    assert text({}, "a") is None


@pytest.mark.parametrize(
    "time", [None, 3, {}, {"sec": 1}, {"sec": 1, "nsec": -1}, {"sec": 1 << 62, "nsec": 0}]
)
def test_what_is_no_time_is_none(time):
    assert nanoseconds(time) == 0
    assert nanoseconds({"sec": 2, "nsec": 3}) == 2_000_000_003


def test_of_starts_and_witnesses_no_more_is_kept_than_a_session_has():
    starts = [
        records.AuditPermit(kind="start", stage="sent", token=n, log_size=n, log_root="ab" * 32)
        for n in range(TREES_MAX + 9)
    ]
    seen = [records.AuditWitness(log_id="cd" * 16, log_size=1, log_root="ab" * 32, found=True)] * (
        WITNESSES_MAX + 9
    )
    session = log_of(*starts, *seen)
    assert len(session.trees) == TREES_MAX
    assert len(session.witnesses) == WITNESSES_MAX


def test_a_start_of_which_the_authorising_record_alone_is_left_counts_by_the_checkpoint_behind_it():
    authorised = records.AuditPermit(kind="start", stage="authorised", token=1)
    checkpoint = records.AuditCheckpoint(size=2, root="ef" * 32, note="n")
    for written, trees, starts in (
        ((authorised, checkpoint), {(2, "ef" * 32)}, True),
        ((authorised, checkpoint, checkpoint.model_copy(update={"size": 3})), {(2, "ef" * 32)}, True),
        ((checkpoint,), set(), False),
        ((records.AuditPermit(kind="permit", stage="authorised", token=1), checkpoint), set(), False),
        ((records.AuditPermit(kind="start", stage="sent", token=1),), set(), False),
    ):
        session = log_of(*written)
        assert (session.trees, session.starts) == (trees, starts)


def test_a_log_that_ends_before_record_0_says_nothing():
    session = session_of("a.mcap", read_log(b""))
    assert (session.log_id, session.size, session.opened_ns, session.last_ns) == ("", 0, 0, 0)
    assert not session.closed


def test_the_last_time_is_that_of_the_last_record_that_has_one():
    frame = records.CanTransfer(
        stamp=records.ZERO, direction="sent", channel="control", record="x", length=1, sha256="ab" * 32
    )
    assert log_of(decision(1), frame).last_ns == 1
    assert log_of(decision(1).model_copy(update={"utc": records.Time(sec=1, nsec=0)}), frame).last_ns >= 0


def test_a_session_that_was_cut_before_its_first_checkpoint_has_no_proof(tmp_path):
    path = folder_of(tmp_path / "logs", 1)[0]
    session = session_of(path.name, read_log(path.read_bytes()))
    proof, record = _proven(path, session)
    assert (proof is not None, record) == (True, None)
    proof, record = _proven(path, replace(session, signed=0))
    assert (proof, record is not None) == (None, True)


def test_a_copy_is_of_the_log_that_its_recovery_names_and_of_none_where_no_recovery_wrote_that():
    told = Recovered("crashed.mcap", "ab" * 32, 9, 1, 2, "s").metadata().metadata
    for content, found in ((told, "crashed.mcap"), (told | {"records": "many"}, None)):
        log = read_log(b"")
        log.scan.metadata.append(Metadata(RECOVERED, content))
        assert session_of("a.mcap", log).recovered_from == found
