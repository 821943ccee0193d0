"""A start is found by the log's index as by reading all of it, in what does not grow with the log."""

import io
import random
import shutil

import pytest

from cutgate.runtime.audit import records, signed_start, witness
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.signed_start import CUT_OFF, SoughtStart
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.signer import Signer, sidecar_of
from cutgate.runtime.audit.witness import WitnessFound, look_up
from tests.logs import create, key_of
from tests.runtime.audit.attacks import changed, edit, rewritten
from tests.runtime.audit.build import LOG_ID, OPENED, PATIENCE_S, Ticking, decision, enable

ID = bytes.fromhex(LOG_ID)


def a_log(directory, before=0, behind=0):
    """A closed log with permit and start, and so many records of two kilobytes before and behind; the start's tree."""
    log = create(directory, log_id=LOG_ID, opened=OPENED, clock=Ticking().clock())
    for count in (before, behind):
        for number in range(count):
            log.write(records.AuditOperator(word="x" * 2000, accepted=True))
            if number % 50 == 0:
                log.commit(None)
        if count is before:
            _, start = enable(log, "permit", "start")
    for number in range(3):
        log.write(decision(9 + number))
    return log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).log, start


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path, start = a_log(tmp_path_factory.mktemp("session") / "logs")
    return path, path.read_bytes(), start


def looked(data, start, **changes):
    """What the look by index says of these bytes."""
    asked = {"size": start.size, "root": start.root, "key": key_of(data).public} | changes
    return SoughtStart(asked["key"], LOG_ID, asked["size"], asked["root"]).look(io.BytesIO(data))


def scanned(data, start):
    """What reading all of it says."""
    return witness._missing(io.BytesIO(data), start.size, start.root)


def test_the_start_is_found_by_index_and_without_one(session):
    _, data, start = session
    assert looked(data, start) == looked(data[:-40], start) == ""


def test_wherever_a_log_is_cut_the_look_says_what_reading_all_of_it_says(session):
    _, data, start = session
    draws = random.Random(17)
    for at in draws.sample(range(12_000, len(data)), 300):
        for left in (data[:at], data[:at] + bytes(4096)):
            found = looked(left, start)
            assert found in ("", CUT_OFF) or scanned(left, start) not in ("", CUT_OFF), at
            assert found not in ("", CUT_OFF) or scanned(left, start) == found, at


def test_a_changed_byte_never_makes_a_start_that_is_not_there(session):
    """Another tree than that of the start is not found, whatever byte of the log is changed."""
    _, data, start = session
    draws = random.Random(18)
    for at in draws.sample(range(12_000, len(data)), 300):
        changed = data[:at] + bytes((data[at] ^ 1 << at % 8,)) + data[at + 1 :]
        assert looked(changed, start, root=bytes(32), key=key_of(data).public) not in ("", CUT_OFF)


@pytest.mark.parametrize("change", [{"size": 3}, {"root": bytes(32)}, {"size": 0}])
def test_another_tree_is_not_found_and_why(session, change):
    _, data, start = session
    told = looked(data, start, **change)
    assert told.startswith(("its tree has the root", "no checkpoint of", "it holds no start"))


def test_a_checkpoint_of_another_key_is_none(session):
    _, data, start = session
    other = LogKey(bytes(16), 7, bytes(range(32)))
    assert "is not signed by its key" in looked(data, start, key=other.public)


def test_a_start_behind_which_no_checkpoint_stands_is_not_covered(session):
    _, data, start = session
    sent = next(
        message.sequence
        for message in scan(data).messages
        if message.topic == records.AuditPermit.TOPIC
        and b'"stage":"sent"' in message.data
        and message.sequence > start.size
    )
    left = rewritten(data, lambda links: links[: sent + 1], chain=False)
    assert (
        looked(left, start)
        == "the record that the start was sent is not signed: it ends in no checkpoint of all before it"
    )
    assert looked(rewritten(data, lambda links: links[:-1], chain=False), start) == ""


def test_a_start_that_never_left_is_none(session):
    _, data, start = session

    left = rewritten(
        data, lambda links: [link for link in links if b'"stage":"sent"' not in link.data], chain=False
    )
    assert looked(left, start) == f"it holds no start that was sent with its tree of size {start.size}"


@pytest.mark.parametrize("fields", [{"log_size": 5}, {"log_root": "ab" * 32}, {"kind": "permit"}])
def test_a_start_that_names_another_tree_is_another_one(session, fields):
    _, data, start = session

    def change(links):
        for number, link in enumerate(links):
            sent = number > start.size and b'"stage":"sent"' in link.data
            yield changed(link, **fields) if sent else link

    left = rewritten(data, lambda links: list(change(links))[:-1], chain=False)
    assert looked(left, start) == f"it holds no start that was sent with its tree of size {start.size}"


def test_an_index_that_leaves_a_chunk_out_hides_nothing(session):
    """What the summary says is anybody's: the records of the file are looked at as well."""
    _, data, start = session
    summary = data.rindex(b"\x0e" + (17).to_bytes(8, "little") + b"\x08")  # the offset of the chunks' indexes
    emptied = data[: summary + 9] + b"\x09" + data[summary + 10 :]
    assert looked(emptied, start) == ""


class Counting(io.BytesIO):
    """Counts the bytes that are read."""

    count = 0

    def read(self, size=-1):
        data = super().read(size)
        self.count += len(data)
        return data


def taken(directory, before, behind, cut=0):
    path, start = a_log(directory, before, behind)
    data = path.read_bytes()
    file = Counting(data[: len(data) - cut])
    key = key_of(data).public
    assert SoughtStart(key, LOG_ID, start.size, start.root).look(file) == ""
    return len(data), file.count


@pytest.mark.parametrize("cut", [0, 50], ids=["closed", "crashed"])
def test_what_is_read_does_not_grow_with_what_stands_before_and_behind(tmp_path, cut):
    small, of_small = taken(tmp_path / "small", 1, 1, cut)
    large, of_large = taken(tmp_path / "large", 1000, 1000, cut)
    assert large > 30 * small
    assert of_large - of_small < 300_000 < large / 10  # a chunk of each topic, and 150 bytes of index a chunk


# ---------------------------------------------------------------- whose key


def running(session, folder):
    """The folder in which the session runs that follows."""
    shutil.copytree(session[0].parent, folder)
    return create(folder, log_id="cd" * 16, opened=OPENED, clock=later())


def later():
    clock = Ticking()
    clock.now_ns += 3_600_000_000_000
    return clock.clock()


def asked(folder, start):
    return look_up(folder, ID, start.size, start.root)


def test_the_running_session_vouches_for_the_key_of_the_one_before_and_reads_no_more(
    session, tmp_path, monkeypatch
):
    path, _, start = session
    log = running(session, tmp_path / "logs")
    monkeypatch.setattr(witness, "_missing", lambda *_: pytest.fail("read whole"))
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, "")
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    following = create(tmp_path / "logs", log_id="ef" * 16, opened=OPENED, clock=far())
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, ""), "two sessions back"
    following.close(final_state="done", clean=True, timeout_s=PATIENCE_S)


def far():
    clock = Ticking()
    clock.now_ns += 7_200_000_000_000
    return clock.clock()


def test_a_log_put_in_its_place_with_a_key_of_its_own_is_read_whole_and_not_found(session, tmp_path):
    """It signs what the controller saw, and could not make its root."""
    path, data, start = session
    log = running(session, tmp_path / "logs")
    theirs = LogKey(key_of(data).series, key_of(data).epoch, bytes(range(32)))
    forged = tmp_path / "logs" / path.name

    def claimed(links):
        note = Signer(theirs, LOG_ID).checkpoint(start.size, start.root)
        for number, link in enumerate(edit("/audit/open", public_key=theirs.public.public.hex())(links)):
            yield changed(link, note=note) if number == start.size else link

    forged.write_bytes(rewritten(data, claimed))
    sidecar_of(forged).unlink()
    found = asked(tmp_path / "logs", start)
    assert found.log is None
    assert "its tree has the root" in found.reason
    log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)


def test_without_a_session_that_runs_nobody_vouches(session, tmp_path, monkeypatch):
    path, _, start = session
    shutil.copytree(path.parent, tmp_path / "logs")
    monkeypatch.setattr(SoughtStart, "look", lambda *_: pytest.fail("believed"))
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, "")


def test_a_key_that_is_none_or_that_the_running_session_does_not_reach_is_not_vouched_for(
    session, tmp_path, monkeypatch
):
    path, data, start = session
    log = running(session, tmp_path / "logs")
    monkeypatch.setattr(SoughtStart, "look", lambda *_: pytest.fail("believed"))
    (tmp_path / "logs" / path.name).write_bytes(rewritten(data, edit("/audit/open", public_key="00")))
    assert asked(tmp_path / "logs", start).log is None
    monkeypatch.setattr(witness, "BACK_MAX", 1)
    (tmp_path / "logs" / path.name).write_bytes(data)
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, "")
    monkeypatch.setattr(witness, "BACK_MAX", 256)
    log.path.write_bytes(rewritten(log.path.read_bytes(), edit("/audit/open", certificate="00" * 64)))
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, ""), "read whole"
    log.path.write_bytes(rewritten(log.path.read_bytes(), edit("/audit/open", previous_log="a/b")))
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, ""), "read whole"
    log.path.unlink()
    assert asked(tmp_path / "logs", start) == WitnessFound(path.name, ""), "read whole"
    assert witness.BACK_MAX == 256


def test_a_chunk_that_another_key_has_signed_covers_no_start(session):
    _, data, start = session
    other = Signer(LogKey(bytes(16), 1, bytes(range(32))), LOG_ID)

    def change(links):
        for number, link in enumerate(links):
            if number > start.size and link.topic == "/audit/checkpoint":
                yield changed(link, note=other.checkpoint(number, bytes(32)))
                return
            yield link

    told = looked(rewritten(data, change, chain=False), start)
    assert told.startswith("the record that the start was sent is not signed: it has no signature of the key")


def test_more_chunks_with_permits_than_any_session_writes_are_not_read(session, monkeypatch):
    _, data, start = session
    monkeypatch.setattr(signed_start, "READ_MAX", 2)
    assert looked(data, start).startswith("over 2 of its chunks hold permits")
    monkeypatch.setattr(signed_start, "READ_MAX", 256)
    assert looked(data, start) == ""
