"""``cutgate audit prove`` and ``check-proof``: exit codes, what is written, and what is shown."""

import json
import shutil

import pytest

from cutgate.runtime.audit.chain import ChainLink, covered
from cutgate.runtime.audit.log_keys import new_log_key, public_path
from cutgate.runtime.audit.signing.log_key import LogKey, PublicLogKey
from cutgate.runtime.audit.signing.proof import PROOF_MAX, RecordProof
from cutgate.runtime.audit.tree import ProvingTree
from cutgate.runtime.commands.app import execute
from tests.oracle.tlog_proof import verified
from tests.runtime.audit.signing.builders import LOG_ID, checkpoint
from tests.runtime.audit.test_proving import key_in, log_id, session, stored


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three logs of one directory, and the public key of the first."""
    key = tmp_path_factory.mktemp("key") / "log.key"
    new_log_key(key)
    directory = tmp_path_factory.mktemp("logs")
    return [session(directory, number, key) for number in range(1, 4)], public_path(key)


def cutgate(capsys, *arguments):
    code = execute(["audit", *map(str, arguments)])
    found = capsys.readouterr()
    return code, found.out, found.err


def test_a_record_is_proven_and_checked_without_its_log(capsys, folder, tmp_path):
    (*_, log), public_key = folder
    file = tmp_path / "record.tlog-proof"
    code, out, err = cutgate(capsys, "prove", log, "--record", 4, "-o", file, "--public-key", public_key)
    fingerprint = key_in(log).fingerprint
    size = file.stat().st_size
    assert (code, out) == (0, "")
    assert err == (
        f"{file}: proof of record 4 (/audit/operator), {size} bytes, by a checkpoint of 6 records; "
        f"signed by the key {fingerprint} of epoch 3, certified from epoch 1 on\n"
    )
    assert verified(file.read_bytes(), public_key.read_bytes()) == stored(log)[4].covered

    code, out, err = cutgate(capsys, "check-proof", file, "--public-key", public_key)
    assert (code, err) == (0, "")
    pinned = PublicLogKey.parse(public_key.read_bytes())
    root = RecordProof.parse(file.read_bytes()).named.hash.hex()
    told = out.splitlines()
    assert told[0] == f"PROVEN: {file}: record 4 is in the log {log_id(3)}"
    assert told[1].startswith("  /audit/operator, 2026-09-21 14:16:21.")
    assert told[1].endswith(" UTC")
    assert told[2] == f"  {stored(log)[4].data.decode()}"
    assert told[3:7] == [
        f"  checkpoint of 6 records, root {root}",
        f"  signed by the key {fingerprint} of epoch 3, certified from epoch 1 on",
        f"  the pinned key {pinned.fingerprint} (epoch 1) vouches for it",
        "not checked:",
    ]
    assert len(told) == 10
    assert "the rest of the log" in told[7]


def test_without_a_pinned_key_it_is_said_whose_key_it_is(capsys, folder, tmp_path):
    (log, *_), _ = folder
    file = tmp_path / "record.tlog-proof"
    assert cutgate(capsys, "prove", log, "--record", 0, "--out", file)[0] == 0
    code, out, _ = cutgate(capsys, "check-proof", file)
    assert code == 0
    assert "vouches" not in out
    assert "not checked:\n  whose key it is: no key was pinned (--public-key)" in out
    assert f"  signed by the key {key_in(log).fingerprint}\n" in out


def test_one_document(capsys, folder, tmp_path):
    (*_, log), public_key = folder
    file = tmp_path / "record.tlog-proof"
    cutgate(capsys, "prove", log, "--record", 4, "-o", file, "--public-key", public_key)
    code, out, _ = cutgate(capsys, "check-proof", file, "--public-key", public_key, "--json")
    document = json.loads(out)
    record = document["record"]
    assert code == 0
    assert (document["schema"], document["outcome"], document["reason"]) == (
        "cutgate.proof-check/1",
        "PROVEN",
        "",
    )
    assert (document["log_id"], record["index"], record["topic"]) == (log_id(3), 4, "/audit/operator")
    assert record["data"].encode() == stored(log)[4].data
    assert (document["checkpoint"]["size"], document["key"]["epoch"], document["pinned"]["epoch"]) == (
        6,
        3,
        1,
    )
    assert len(document["not_checked"]) == 3


def test_what_is_not_proven_says_why_and_shows_no_record(capsys, folder, tmp_path):
    (log, *_), public_key = folder
    file = tmp_path / "record.tlog-proof"
    cutgate(capsys, "prove", log, "--record", 4, "-o", file)
    proof = RecordProof.parse(file.read_bytes())
    later = tmp_path / "later.pub"
    later.write_bytes(key_in(folder[0][1]).encode())
    file.write_bytes(file.read_bytes().replace(b"index 4", b"index 5"))
    code, out, err = cutgate(capsys, "check-proof", file, "--public-key", public_key)
    assert (code, err) == (2, "")
    assert out == f"NOT PROVEN: {file}: the record says that its number is 4, the proof that it is 5\n"
    file.write_bytes(proof.encode())
    code, out, err = cutgate(capsys, "check-proof", file, "--public-key", later)
    assert (code, err) == (2, "")
    assert "the pinned key (epoch 2) is not the one that signed the log" in out
    code, out, _ = cutgate(capsys, "check-proof", file, "--public-key", later, "--json")
    assert code == 2
    assert set(json.loads(out)) == {"schema", "file", "outcome", "reason"}
    assert json.loads(out)["outcome"] == "NOT_PROVEN"


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--nothing"],
        ["missing.tlog-proof"],
        ["."],
        ["pyproject.toml"],
        ["{file}", "--public-key", "missing.pub"],
        ["{file}", "--public-key", "pyproject.toml"],
        ["{file}", "other"],
    ],
)
def test_what_cannot_be_read_is_unreadable(capsys, folder, tmp_path, arguments):
    file = tmp_path / "record.tlog-proof"
    cutgate(capsys, "prove", folder[0][0], "--record", 4, "-o", file)
    code, out, err = cutgate(capsys, "check-proof", *(one.format(file=file) for one in arguments))
    assert (code, out) == (3, "")
    assert err


def test_what_is_unreadable_is_one_document_too(capsys):
    code, out, err = cutgate(capsys, "check-proof", "pyproject.toml", "--json")
    assert code == 3
    assert json.loads(out)["outcome"] == "UNREADABLE"
    assert json.loads(out)["reason"] == err.rstrip("\n")
    assert "make it anew with `cutgate audit prove`" in err


def test_a_huge_file_is_not_read(capsys, tmp_path):
    file = tmp_path / "huge.tlog-proof"
    with file.open("wb") as sparse:
        sparse.truncate(PROOF_MAX + 1)
    code, _, err = cutgate(capsys, "check-proof", file)
    assert code == 3
    assert f"must be <= {PROOF_MAX} bytes" in err


def test_it_never_overwrites(capsys, folder, tmp_path):
    file = tmp_path / "record.tlog-proof"
    file.write_bytes(b"something")
    code, out, err = cutgate(capsys, "prove", folder[0][0], "--record", 4, "-o", file)
    assert (code, out) == (2, "")
    assert err == f"{file}: --out: exists already; name another file\n"
    assert file.read_bytes() == b"something"
    code, _, err = cutgate(capsys, "prove", folder[0][0], "--record", 4, "-o", tmp_path / "no" / "file")
    assert (code, "cannot be written: No such file or directory" in err) == (2, True)


@pytest.mark.parametrize(
    "arguments",
    [[], ["--record", "4"], ["-o", "x"], ["--record", "-1", "-o", "x"], ["--record", "a", "-o", "x"]],
)
def test_a_usage_error_of_prove_is_refused(capsys, folder, arguments):
    assert cutgate(capsys, "prove", folder[0][0], *arguments)[0] == 2


def test_nothing_is_written_where_there_is_no_proof(capsys, folder, tmp_path):
    (first, _, last), public_key = folder
    alone, file = tmp_path / "alone", tmp_path / "record.tlog-proof"
    alone.mkdir()
    copy = shutil.copy(last, alone)
    later = tmp_path / "later.pub"
    later.write_bytes(key_in(last).encode())
    for log, key, told in (
        (copy, public_key, "the certificate of epoch 2 is missing"),
        (first, later, "a key certifies later ones only; pin an earlier one"),
        (first, first, "must be <= 1024 bytes"),
    ):
        code, out, err = cutgate(capsys, "prove", log, "--record", 4, "-o", file, "--public-key", key)
        assert (code, out) == (2, "")
        assert told in err
    code, _, err = cutgate(capsys, "prove", first, "--record", 4000, "-o", file)
    assert code == 2
    assert f"{first}: record 4000: there is no such record" in err
    assert not file.exists()


def test_a_record_that_is_too_large_is_refused(capsys, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.audit.signing.proof.RECORD_MAX", 100)
    file = tmp_path / "record.tlog-proof"
    code, _, err = cutgate(capsys, "prove", folder[0][0], "--record", 4, "-o", file)
    assert code == 2
    assert "record 4: a record of" in err
    assert not file.exists()


def test_what_a_record_says_is_data(capsys, tmp_path):
    """Control characters, markup and bytes that are no text reach the terminal as escapes, on one line."""
    evil = b'{"word":"\x1b[2J [bold]x[/bold] \n PROVEN \xe2\x80\xae \xff"}'
    key = LogKey(bytes(16), 1, b"\1" * 32)
    whole = covered(ChainLink("/audit/\x1b[31m\n", "json", "x", b"", 2**64 - 1, 0, 0, evil))
    tree = ProvingTree(0)
    tree.append(whole)
    proof = RecordProof(whole, 0, (), checkpoint(key, 1, tree.root), key.public.public)
    file = tmp_path / "record.tlog-proof"
    file.write_bytes(proof.encode())
    code, out, _ = cutgate(capsys, "check-proof", file)
    lines = out.splitlines()
    assert code == 0
    assert lines[0].endswith(f"record 0 is in the log {LOG_ID}")
    assert lines[1] == "  /audit/\\x1b[31m\\n, 2554-07-21 23:34:33.709551615 UTC"
    assert lines[2] == '  {"word":"\\x1b[2J [bold]x[/bold] \\n PROVEN \\u202e \\xff"}'
    assert lines[3].startswith("  checkpoint of 1 records")
    code, out, _ = cutgate(capsys, "check-proof", file, "--json")
    assert code == 0
    assert json.loads(out)["record"]["data"] == evil.decode("utf-8", "backslashreplace")
