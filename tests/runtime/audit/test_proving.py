"""Proofs out of real logs: of every record, by the right checkpoint, and refused with words where there is none."""

import errno
import os
import re
import shutil
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit import proving, records
from cutgate.runtime.audit.chain import of_channel
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.container.stored import ChannelInfo
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.log_keys import new_log_key
from cutgate.runtime.audit.proving import Proving, prove
from cutgate.runtime.audit.signing.log_key import LogKey, PublicLogKey
from cutgate.runtime.audit.signing.proof import RecordProof, why_false
from cutgate.runtime.audit.signing.signatures import key_of
from cutgate.runtime.audit.signing.signer import Sidecar, Signer, sidecar_of
from cutgate.runtime.audit.trust import NOBODY, Trust
from cutgate.runtime.audit.writer import LogWriter
from tests.oracle.tlog_proof import verified
from tests.runtime.audit.build import OPENED, PATIENCE_S, Ticking, decision

COMPAT = Path(__file__).parents[2] / "compat" / "0.1.0"
SESSIONS = 4


def log_id(number):
    return f"{number:08x}" * 4


def session(directory, number, key):
    """A log of some chunks, of a session that follows the last one there."""
    ticking = Ticking()
    ticking.now_ns += 60_000_000_000 * number
    log = AuditLog.create(
        directory, log_id=log_id(number), opened=OPENED, clock=ticking.clock(), key_file=key
    )
    log.attach("plan.csv", "text/csv", b"x,y,z\n")
    for step in range(5):
        log.write(records.AuditOperator(word="start", accepted=True))
        log.write(decision(step))
    paths = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
    assert paths.closed, paths.reason
    return paths.log


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four sessions of one log directory, in their order."""
    key = tmp_path_factory.mktemp("key") / "log.key"
    new_log_key(key)
    directory = tmp_path_factory.mktemp("logs")
    return [session(directory, number, key) for number in range(1, SESSIONS + 1)]


@pytest.fixture(scope="module")
def log(folder):
    return folder[0]


def stored(log):
    return scan(log.read_bytes()).messages


def key_in(log):
    return key_of(parse_object(stored(log)[0].data))


def trust(pinned, *logs):
    return Trust(pinned, {key.epoch: key for key in map(key_in, logs)})


def copied(log, folder):
    shutil.copy(sidecar_of(log), folder)
    return Path(shutil.copy(log, folder))


# ---------------------------------------------------------------- what is proven


def test_every_record_of_a_closed_log_is_proven_by_the_first_checkpoint_that_covers_it(log):
    messages = stored(log)
    sizes = [number for number, one in enumerate(messages) if one.topic == "/audit/checkpoint"]
    assert len(sizes) > 3
    for index, message in enumerate(messages):
        proof = prove(log, index)
        assert (proof.index, proof.covered, proof.keys) == (index, message.covered, ())
        assert proof.named.size == next((size for size in sizes if size > index), len(messages))
        assert why_false(proof, key_in(log)) == ""
        assert verified(proof.encode()) == message.covered
        assert RecordProof.parse(proof.encode()) == proof


def test_the_latest_checkpoint_is_that_beside_the_log(log):
    messages = stored(log)
    for index in (0, 5, len(messages) - 1):
        proof = prove(log, index, latest=True)
        assert proof.named.size == len(messages)
        assert why_false(proof, key_in(log)) == ""


def test_of_a_crashed_log_the_latest_checkpoint_is_its_last(log, tmp_path):
    data = log.read_bytes()
    cut = tmp_path / log.name
    cut.write_bytes(data[: data.index(b'"final_state"') - 200])
    messages = stored(cut)
    last = max(number for number, one in enumerate(messages) if one.topic == "/audit/checkpoint")
    proof = prove(cut, 0, latest=True)
    assert proof.named.size == last
    assert why_false(proof, key_in(log)) == ""


def test_nothing_behind_the_checkpoint_is_read(log, tmp_path):
    data = log.read_bytes()
    broken = tmp_path / log.name
    broken.write_bytes(data[: len(data) // 2] + b"\xff" * (len(data) - len(data) // 2))
    assert prove(broken, 1) == prove(log, 1)
    with pytest.raises(InputError, match=r"audit verify"):
        prove(broken, 1, latest=True)


@pytest.mark.no_cover
def test_memory_goes_by_a_chunk_and_not_by_the_log(tmp_path):
    """A log of 12 000 records, 2 MB, whose hashes alone would take more than is allowed here."""
    key = LogKey(bytes(16), 1, b"\1" * 32)
    writer = LogWriter(log_id(7), {}, Signer(key, log_id(7)))
    opened = records.AuditOpen(
        log_id=log_id(7), software="", verifier="", numpy="", cpu_dispatch=(), candump="", previous_crashed=False,
        series=key.series.hex(), epoch=1, public_key=key.public.public.hex(), enrolled="here",
    )  # fmt: skip
    writer.add(opened, log_time_ns=1, monotonic_ns=1)
    writer.close_chunk(signed=False)
    for number in range(12_000):
        writer.add(records.AuditOperator(word="start", accepted=True), log_time_ns=1, monotonic_ns=1)
        if number % 250 == 0:
            writer.close_chunk()
    writer.close_chunk()
    file = tmp_path / "large.mcap"
    file.write_bytes(writer.take())
    tracemalloc.start()
    proof = prove(file, 100, latest=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert proof.named.size > 12_000
    assert why_false(proof, key.public) == ""
    assert peak < file.stat().st_size / 3


# ---------------------------------------------------------------- the keys


@pytest.mark.parametrize("epoch", range(1, SESSIONS + 1))
def test_certificates_lead_from_any_earlier_key(folder, epoch):
    pinned = key_in(folder[epoch - 1])
    for number, log in enumerate(folder[epoch - 1 :]):
        proof = prove(log, 3, trust(pinned, *folder))
        assert len(proof.keys) == (number + 1 if number else 0)
        read = RecordProof.parse(proof.encode())
        assert read == proof
        for key in (pinned, key_in(log)):
            assert why_false(read, key) == ""
            assert verified(proof.encode(), key.encode()) == proof.covered


def test_the_key_of_the_session_before_needs_no_other_log(folder):
    proof = prove(folder[1], 3, Trust(key_in(folder[0])))
    assert [key.epoch for key in proof.keys] == [1, 2]


def other(epoch, series):
    return PublicLogKey(series, epoch, b"\7" * 32)


@pytest.mark.parametrize("number", range(SESSIONS - 1))
def test_a_missing_certificate_is_named(folder, number):
    left = [log for place, log in enumerate(folder) if place != number]
    pinned = key_in(folder[0])
    if number == 0:
        assert prove(folder[-1], 3, trust(pinned, *left)).keys[0].epoch == 1
        return
    with pytest.raises(InputError, match=f"the certificate of epoch {number + 1} is missing"):
        prove(folder[-1], 3, trust(pinned, *left))


def test_another_key_leads_nowhere(folder):
    series = key_in(folder[0]).series
    for pinned, told in (
        (key_in(folder[2]), "a key certifies later ones only"),
        (other(2, series), "another key of the same epoch"),
        (other(1, series), "missing or of another key"),
        (other(1, bytes(16)), "of the series"),
    ):
        with pytest.raises(InputError, match=told):
            prove(folder[1], 3, trust(pinned, *folder))


# ---------------------------------------------------------------- what is refused


def test_a_record_that_does_not_exist(log, tmp_path):
    count = len(stored(log))
    for index in (count, count + 1, 1 << 70):
        told = f"record {index}: there is no such record: its last record is {count - 1}; name another one"
        with pytest.raises(InputError, match=re.escape(told)):
            prove(log, index)
    (tmp_path / "log.mcap").write_bytes(log.read_bytes()[:200])
    with pytest.raises(InputError, match="there is no such record: it has no record; the log ends early"):
        prove(tmp_path / "log.mcap", 0)


def test_the_tail_of_a_crashed_log_is_not_proven(log, tmp_path):
    """Cut behind the last chunk's content: its records stand, and no checkpoint covers them."""
    messages, data = stored(log), log.read_bytes()
    cut = copied(log, tmp_path)
    cut.write_bytes(data[: messages[-1].offset + len(messages[-1].data)])
    assert len(stored(cut)) == len(messages)
    last = len(messages) - 2
    assert prove(cut, last - 1).named.size == last
    for index in (last, last + 1):
        told = (
            f"record {index}: no checkpoint covers it: the last one covers {last} records; the log ends early; "
            "what stands behind is not signed, and nobody can prove it"
        )
        with pytest.raises(InputError, match=re.escape(told)):
            prove(cut, index)


def test_the_end_of_a_closed_log_needs_what_stands_beside_it(log, tmp_path):
    count = len(stored(log))
    copy = Path(shutil.copy(log, tmp_path))
    with pytest.raises(
        InputError,
        match=rf"record {count - 1}: no checkpoint covers it.*restore {sidecar_of(log).name} beside it",
    ):
        prove(copy, count - 1)
    assert prove(copy, 3) == prove(log, 3)
    assert prove(copy, 3, latest=True).named.size == count - 2


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"{", b'{"schema":"cutgate.signature/1","checkpoint":1,"file":""}']
)
def test_what_is_no_signature_beside_it_is_refused(log, tmp_path, content):
    copy = copied(log, tmp_path)
    sidecar_of(copy).write_bytes(content)
    with pytest.raises(InputError, match=r"signature\.json.*restore it from a copy"):
        prove(copy, len(stored(log)) - 1)


def test_a_signature_of_another_log_or_tree_beside_it_is_refused(folder, tmp_path):
    copy = copied(folder[0], tmp_path)
    count = len(stored(copy))
    shutil.copy(sidecar_of(folder[1]), sidecar_of(copy))
    with pytest.raises(InputError, match="it is not this log's: it has no signature of the key"):
        prove(copy, count - 1)
    shutil.copy(sidecar_of(folder[0]), sidecar_of(copy))
    earlier = parse_object(stored(copy)[-2].data)["note"]
    sidecar = Sidecar.parse(sidecar_of(copy).read_bytes())
    sidecar_of(copy).write_bytes(replace(sidecar, checkpoint=earlier).encode())
    with pytest.raises(
        InputError,
        match=f"it signs a tree of {count - 2} records with the root [0-9a-f]{{64}}, the log's has {count} and",
    ):
        prove(copy, count - 1)


def test_what_witnesses_signed_is_no_part_of_a_proof(log, tmp_path):
    """A sidecar may hold their cosignatures; a proof has the log's own signature alone."""
    copy = copied(log, tmp_path)
    last = len(stored(log)) - 1
    sidecar = Sidecar.parse(sidecar_of(copy).read_bytes())
    cosigned = sidecar.checkpoint + "— witness.example AAAAAAA=\n"
    sidecar_of(copy).write_bytes(replace(sidecar, checkpoint=cosigned).encode())
    proof = prove(copy, last)
    assert proof == prove(log, last)
    assert RecordProof.parse(proof.encode()) == proof


def test_a_log_that_is_not_signed_is_refused():
    old = next(COMPAT.glob("**/*.mcap"))
    with pytest.raises(
        InputError,
        match="record 0 is without a key, must be the record 0 of a signed log; it was written before logs were signed",
    ):
        prove(old, 3)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89MCAP0\r\n" + bytes(100)])
def test_what_is_no_log_is_refused(tmp_path, content):
    file = tmp_path / "other.mcap"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"does not start as an MCAP file|it has no record|audit verify"):
        prove(file, 0)


def test_what_is_no_file_is_refused(tmp_path, monkeypatch, log):
    for path in (tmp_path / "missing.mcap", tmp_path):
        with pytest.raises(InputError, match=r"no such file|Is a directory"):
            prove(path, 0)
    huge = tmp_path / "huge.mcap"
    huge.write_bytes(b"")
    os.truncate(huge, 8 << 30)
    with pytest.raises(InputError, match="size is 8589934592 bytes"):
        prove(huge, 0)

    def fail(*_arguments):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(proving, "walk", fail)
    with pytest.raises(InputError, match=re.escape("cannot be read (Input/output error)")):
        prove(log, 0)


def altered(messages, number, **changes):
    """The messages with one of them changed: parts of its channel, or of itself."""
    one = messages[number]
    channel = {name: changes.pop(name) for name in ("topic", "encoding") if name in changes}
    if channel:
        link = replace(one.link, **channel)
        kind = (link.topic, link.encoding, link.schema_name, link.schema)
        changes["channel"] = ChannelInfo(*kind, of_channel(*kind))
    messages[number] = replace(one, **changes)
    return messages


def wrong(messages, index=3):
    """What a log of these messages is refused for."""
    log = Proving(index)
    for message in messages:
        size = log.size
        log.take(message)
        if log.wrong:
            assert log.size == size
            return log.wrong
    return ""


def test_a_log_that_is_wrong_up_to_the_checkpoint_is_refused(log):
    messages = stored(log)
    linked = next(
        number for number, one in enumerate(messages) if number > 3 and one.topic == "/audit/operator"
    )
    note = next(number for number, one in enumerate(messages) if one.topic == "/audit/checkpoint")
    assert wrong(list(messages)) == ""
    for number, changes, told in (
        (2, {"sequence": 7}, "its sequence is 7, its encoding json"),
        (2, {"encoding": "cbor"}, "its sequence is 2, its encoding cbor"),
        (0, {"topic": "/audit/other"}, "it must be /audit/open and name the log by 32 hexadecimal digits"),
        (0, {"data": messages[0].data.replace(b'"log_id":"', b'"log_id":"x')}, "it must be /audit/open and name the log"),
        (0, {"data": messages[0].data.replace(b'"log_id"', b'"other"')}, "it must be /audit/open and name the log"),
        (0, {"data": messages[0].data.replace(b'"epoch":1', b'"epoch":0')}, "its epoch is 0"),
        (linked, {"data": b"no JSON"}, "it does not follow from the records before it"),
        (note, {"data": messages[note].data.replace(b'"size":', b'"size":1')}, "its size and root are not those of its note"),
        (note, {"data": messages[note].data.replace(b"\xe2\x80\x94", b"-")}, "a signature line is an em dash"),
    ):  # fmt: skip
        found = wrong(altered(list(messages), number, **changes))
        assert re.match(rf"record {number}\b", found), (found, told)
        assert told in found
    # Who alters a record is found by the next record that names what came before.
    found = wrong(altered(list(messages), linked, data=messages[linked].data.replace(b"start", b"stxrt")))
    assert found.startswith(f"record {linked + 1} ")


def test_a_wrong_log_names_its_file_and_its_remedy(log, tmp_path):
    """Its checksums are those of the changed bytes: what tells is the chain."""
    data = log.read_bytes()
    changed = tmp_path / log.name
    changed.write_bytes(data.replace(b"cutgate 0.1.0", b"cutgate 0.1.9"))
    with pytest.raises(
        InputError,
        match=rf"{re.escape(str(changed))}: chunk at offset .* see what `cutgate audit verify` says of it",
    ):
        prove(changed, 3)


def test_nothing_is_signed_before_the_first_checkpoint(log):
    proving_one = Proving(0)
    for message in stored(log):
        proving_one.take(message)
        if proving_one.proof:
            break
        assert proving_one.signed == 0
    assert proving_one.signed == proving_one.size - 1


def test_who_pins_no_key_gets_no_certificates(folder):
    assert prove(folder[-1], 2, NOBODY).keys == ()
