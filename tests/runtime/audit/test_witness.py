"""What the controller saw last, looked up: found in the log of that id, or why not; and nothing in a folder raises."""

import os
import shutil
import struct
import threading
import tracemalloc
from dataclasses import FrozenInstanceError

import pytest
from mcap.opcode import Opcode

from cutgate.runtime.audit import records, witness
from cutgate.runtime.audit.container.raw import MAGIC
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.tree import EMPTY, Tree
from cutgate.runtime.audit.witness import CUT_OFF, WitnessFound, look_up
from cutgate.runtime.audit.writer import LogWriter
from tests.logs import create
from tests.runtime.audit.build import (
    LOG_ID,
    OPENED,
    PATIENCE_S,
    Ticking,
    decision,
    enable,
    forge,
    small_log,
)

ID = bytes.fromhex(LOG_ID)
NAME = "20260921T141321Z-01234567.mcap"


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The bytes of a log with permit and start, closed in order; and the trees that they name."""
    directory = tmp_path_factory.mktemp("session")
    log = create(directory, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock())
    trees = enable(log, "permit", "start")
    for number in range(3):
        log.write(decision(9 + number))
    paths = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert paths.log.name == NAME
    return paths.log.read_bytes(), trees


@pytest.fixture
def data(session):
    return session[0]


@pytest.fixture
def start(session):
    """The tree that the start named."""
    return session[1][1]


@pytest.fixture
def asked(tmp_path, start):
    """Looks up what the start named, in a folder of its own."""

    def look(content=None, name=NAME, *, size=start.size, root=start.root, log_id=ID):
        if content is not None:
            (tmp_path / name).write_bytes(content)
            (tmp_path / name).chmod(0o600)
        return look_up(tmp_path, log_id, size, root)

    return look


def chunks(data):
    """Where each chunk begins, read from the bytes."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found += [at] * (opcode == Opcode.CHUNK)
        at += 9 + size
    return found


def cut(data, count):
    """What is on the disk when so many records are, and the next chunk is torn."""
    for begin in chunks(data):
        if len(scan(data[: begin + 12]).messages) == count:
            return data[: begin + 12]
    raise AssertionError("no chunk begins there")


def changed(edit):
    def each(record):
        return edit(record) if isinstance(record, records.AuditPermit) else record

    return each


# ---------------------------------------------------------------- found


def test_the_log_in_which_the_start_was_sent_is_found(asked, data):
    assert asked(data) == WitnessFound(NAME, "")


def test_any_name_does(asked, data):
    assert asked(data, "kept.mcap") == WitnessFound("kept.mcap", "")


def test_a_session_that_crashed_after_its_start_is_found(asked, data, start):
    """Its file ends in a torn chunk, behind the record that the start was sent."""
    crashed = cut(data, start.size + 4)
    assert not scan(crashed).finished
    assert asked(crashed) == WitnessFound(NAME, "")


def test_the_finalised_copy_of_a_crashed_log_is_found(asked, data):
    """And so it is where the original has lost more than the copy."""
    assert asked(data[:100]).log is None
    assert asked(data, "20260921T141321Z-01234567.recovered.mcap").log.endswith(".recovered.mcap")
    assert asked(data) == WitnessFound(NAME, ""), "both whole: the session's own"


def test_a_log_cut_off_before_it_says_that_the_start_left_is_found_and_that_is_said(asked, data, start):
    assert asked(cut(data, start.size + 1)) == WitnessFound(NAME, CUT_OFF)


def test_only_a_start_counts_and_only_the_one_that_names_exactly_these(asked, data, session):
    permit, start = session[1]
    told = f"{NAME}: it holds no start that was sent with its tree of size {permit.size}"
    assert asked(data, size=permit.size, root=permit.root) == WitnessFound(None, told)
    tree = Tree()
    for message in scan(data).messages[: start.size - 1]:
        tree.append(message.covered)
    told = f"{NAME}: it holds no start that was sent with its tree of size {start.size - 1}"
    assert asked(data, size=start.size - 1, root=tree.root) == WitnessFound(None, told)


def test_a_name_of_this_id_is_read_first(asked, data, monkeypatch):
    """A folder of thousands of logs is not searched for one that has the name it was given."""
    for name in ("00000000T000000Z-00000000.mcap", "a.mcap", "zzz.mcap"):
        asked(data, name)
    read = []
    monkeypatch.setattr(
        witness, "open_ours", lambda path: read.append(path.name) or os.open(path, os.O_RDONLY)
    )
    assert asked(data) == WitnessFound(NAME, "")
    assert read == [NAME]


# ---------------------------------------------------------------- not found


def test_no_log_of_this_id(asked, data, tmp_path):
    told = f"no log {LOG_ID} is in {tmp_path}"
    assert asked() == WitnessFound(None, told)
    other = "01234567" + "f" * 24
    assert asked(data, log_id=bytes.fromhex(other)) == WitnessFound(None, f"no log {other} is in {tmp_path}")


def test_a_folder_that_is_not_there_holds_no_log(tmp_path, start):
    assert look_up(tmp_path / "gone", ID, start.size, start.root).log is None


def test_the_root_of_another_log_is_not_that_of_this_one(asked, data, start):
    def edit(record):
        return (
            record.model_copy(update={"operator": "x"}) if isinstance(record, records.AuditOpen) else record
        )

    found = asked(forge(data, edit))
    assert found.log is None
    assert found.reason.startswith(f"{NAME}: its tree has the root ")
    assert found.reason.endswith(f" at size {start.size}, not {start.root.hex()}")


def test_a_forged_log_that_says_that_its_start_named_these_is_not_found(asked, data):
    """All of it chained anew, with what the controller saw written into it."""

    def edit(record):
        return (
            record.model_copy(update={"operator": "x"}) if isinstance(record, records.AuditOpen) else record
        )

    found = asked(forge(data, edit), root=bytes(32))
    assert found.log is None
    assert "its tree has the root" in found.reason


@pytest.mark.parametrize(
    "changes",
    [{"log_size": 5}, {"log_root": "ab" * 32}, {"log_size": None}, {"kind": "permit"}, {"stage": "withheld"}],
)
def test_a_start_that_names_other_ones_is_not_the_one(asked, data, start, changes):
    def edit(record):
        sent = (record.kind, record.stage) == ("start", "sent")
        return record.model_copy(update=changes) if sent else record

    told = f"{NAME}: it holds no start that was sent with its tree of size {start.size}"
    assert asked(forge(data, changed(edit))) == WitnessFound(None, told)


def test_a_closed_log_without_the_start_is_not_cut_off(asked, data, start):
    def edit(record):
        return None if (record.kind, record.stage) == ("start", "sent") else record

    assert asked(forge(data, changed(edit))).reason.endswith(f"with its tree of size {start.size}")


def test_a_start_that_was_withheld_is_not_cut_off(asked, data, start):
    def edit(record):
        sent = (record.kind, record.stage) == ("start", "sent")
        return record.model_copy(update={"stage": "withheld"}) if sent else record

    crashed = forge(data, changed(edit))[:-10]
    assert len(scan(crashed).messages) > start.size
    assert (scan(crashed).finished, scan(crashed).problems) == (False, [])
    assert asked(crashed).log is None


def test_a_crashed_log_cut_behind_its_permit_is_shorter(asked, data, session):
    permit, start = session[1]
    told = f"{NAME}: it has {permit.size + 1} records, the controller saw {start.size}"
    assert asked(cut(data, permit.size + 1)) == WitnessFound(None, told)


def test_a_cut_off_permit_is_no_cut_off_start(asked, data, session):
    permit = session[1][0]
    assert asked(cut(data, permit.size + 1), size=permit.size, root=permit.root).log is None


def test_a_start_authorised_behind_the_size_is_another_one(asked, data, start):
    """A tree in front of the authorising record is not the one that its start names."""
    tree = Tree()
    for message in scan(data).messages[: start.size - 2]:
        tree.append(message.covered)
    assert asked(cut(data, start.size + 1), size=tree.size, root=tree.root).log is None


def test_a_crashed_log_without_a_permit_is_not_cut_off(asked, data):
    tree = Tree()
    for message in scan(data).messages[:3]:
        tree.append(message.covered)
    told = f"{NAME}: it holds no start that was sent with its tree of size 3"
    assert asked(cut(data, 3), size=3, root=tree.root) == WitnessFound(None, told)


def test_damage_is_told_with_what_it_hides(asked, data, start):
    begin = next(b for b in chunks(data) if len(scan(data[: b + 12]).messages) == start.size + 1)
    broken = bytearray(data)
    broken[begin + 60] ^= 1
    found = asked(bytes(broken))
    assert found.log is None
    assert (
        f"sent with its tree of size {start.size}; chunk at offset {begin}: its checksum is wrong"
        in found.reason
    )
    broken = bytearray(data)
    broken[chunks(data)[1] + 60] ^= 1
    assert f"records, the controller saw {start.size}; chunk at offset" in asked(bytes(broken)).reason


def test_damage_behind_the_start_hides_nothing(asked, data):
    broken = bytearray(data)
    broken[-40] ^= 1
    assert scan(bytes(broken)).problems
    assert asked(bytes(broken)) == WitnessFound(NAME, "")


def test_an_empty_tree_was_never_seen(asked, data):
    """A start names at least the record that authorised it; one that says otherwise proves nothing."""

    def edit(record):
        return (
            record.model_copy(update={"log_size": 0, "log_root": EMPTY.hex()})
            if record.stage == "sent"
            else record
        )

    assert asked(forge(data, changed(edit)), size=0, root=EMPTY).log is None
    assert asked(cut(data, scan(data).messages[-1].sequence), size=0, root=EMPTY).log is None


def test_the_smallest_tree_is_that_of_record_0(asked, data):
    tree = Tree()
    tree.append(scan(data).messages[0].covered)

    def edit(record):
        named = {"log_size": 1, "log_root": tree.root.hex()}
        return record.model_copy(update=named) if record.stage == "sent" else record

    assert asked(forge(data, changed(edit)), size=1, root=tree.root) == WitnessFound(NAME, "")


def test_the_first_of_several_reasons_is_that_of_the_sessions_own_file(asked, data):
    asked(cut(data, 1 + 2), "20260921T141321Z-01234567.recovered.mcap")
    asked(cut(data, 1 + 2), "a.mcap")
    assert asked(data, root=bytes(32)).reason.startswith(f"{NAME}: its tree has the root ")


# ---------------------------------------------------------------- foreign, damaged, not ours


@pytest.mark.parametrize("name", [NAME, "other.mcap"])
@pytest.mark.parametrize(
    "content", [b"", b"x" * 5000, MAGIC, MAGIC + bytes(5000), MAGIC + b"\xff" * 50, b"\x89MCAP0\r\n\x01"]
)
def test_what_is_no_log_is_passed_over(asked, data, content, name, tmp_path):
    assert asked(content, name) == WitnessFound(None, f"no log {LOG_ID} is in {tmp_path}")
    assert asked(data, "whole.mcap").log == "whole.mcap"


@pytest.mark.parametrize("topic", [records.AuditOperator, records.AuditOpen])
def test_a_log_whose_record_0_does_not_open_it_has_no_id(asked, data, topic, tmp_path):
    def edit(record):
        if not isinstance(record, records.AuditOpen):
            return record
        return records.AuditOperator(word=LOG_ID, accepted=True) if topic is records.AuditOperator else None

    assert asked(forge(data, edit)) == WitnessFound(None, f"no log {LOG_ID} is in {tmp_path}")


class NoObject(records.LogRecord):
    """A record that is JSON and no object."""

    def encode(self):
        return b"7"


def written(*written_records):
    writer = LogWriter(LOG_ID, {})
    for record in written_records:
        writer.add(record, log_time_ns=1, monotonic_ns=1)
    writer.finish()
    return writer.take()


class NoOpen(NoObject):
    TOPIC = "/audit/open"


class NoPermit(NoObject):
    TOPIC = "/audit/permit"


def test_records_that_are_no_objects_name_nothing(asked, data, tmp_path):
    assert asked(written(NoOpen())) == WitnessFound(None, f"no log {LOG_ID} is in {tmp_path}")
    opened = records.AuditOpen.model_validate_json(scan(data).messages[0].data)
    found = asked(written(opened, NoPermit(), NoPermit()), size=5)
    assert found.log is None
    assert found.reason.startswith(f"{NAME}: it has 3 records, the controller saw 5")


def test_what_was_found_is_not_changed():
    found = WitnessFound("a.mcap", "")
    with pytest.raises(FrozenInstanceError):
        found.log = None
    assert not hasattr(found, "__dict__")


def test_a_file_that_cannot_be_read_is_told_where_its_name_is_the_one(asked, data, tmp_path):
    asked(data)
    (tmp_path / NAME).chmod(0o666)
    found = asked()
    assert found.log is None
    assert found.reason.startswith(f"{NAME}: cannot be read: ")
    assert "mode" in found.reason
    (tmp_path / NAME).rename(tmp_path / "a.mcap")
    assert asked().reason == f"no log {LOG_ID} is in {tmp_path}"
    assert asked(data).log == NAME


def test_links_pipes_and_folders_are_passed_over(asked, data, tmp_path):
    (tmp_path / "a.mcap").mkdir()
    os.mkfifo(tmp_path / "b.mcap")
    (tmp_path / "c.mcap").symlink_to(tmp_path / "gone")
    assert asked().log is None
    assert asked(data, "d.mcap").log == "d.mcap"


def test_an_error_of_the_disk_is_told(asked, data, monkeypatch):
    def trouble(_file, _found):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(witness, "_log_id", lambda _file: LOG_ID)
    monkeypatch.setattr(witness, "walk", trouble)
    assert asked(data).reason == f"{NAME}: cannot be read: [Errno 5] Input/output error"


def test_a_log_of_another_id_is_read_no_further_than_its_beginning(asked, data, monkeypatch):
    monkeypatch.setattr(witness, "_missing", lambda *_: pytest.fail("read whole"))
    asked(data, log_id=bytes(16))
    monkeypatch.setattr(witness, "BEGINNING", 64)
    assert asked(data).reason.startswith("no log"), "nor the whole of what comes before record 0"


def test_record_0_stands_well_within_the_beginning(data):
    assert chunks(data)[1] < 20_000 < witness.BEGINNING == 262_144


# ---------------------------------------------------------------- memory, and a thread


def test_memory_is_that_of_a_chunk(tmp_path):
    log = create(tmp_path, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock())
    for number in range(3000):
        log.write(records.AuditOperator(word="x" * 2000, accepted=True))
        if number % 300 == 0:
            log.commit(None)
    (start,) = enable(log, "start")
    size = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).log.stat().st_size
    tracemalloc.start()
    try:
        found = look_up(tmp_path, ID, start.size, start.root)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found == WitnessFound(NAME, "")
    assert peak < size / 2 < 4_000_000


def test_it_may_be_asked_in_a_thread_beside_a_session_that_writes(asked, data, tmp_path, start):
    folder = tmp_path / "logs"
    small_log(folder)
    shutil.copy(next(folder.glob("*.mcap")), tmp_path / "other.mcap")
    asked(data)
    found = []
    thread = threading.Thread(target=lambda: found.append(look_up(tmp_path, ID, start.size, start.root)))
    thread.start()
    thread.join(PATIENCE_S)
    assert found == [WitnessFound(NAME, "")]
