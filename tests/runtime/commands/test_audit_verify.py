"""``cutgate audit verify``: by which key, which anchors, which witnesses; and what its exit code says."""

import json
import shutil
from base64 import b64encode
from hashlib import sha256

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cutgate.runtime.audit.signing.note import SignatureType, VerifierKey
from cutgate.runtime.audit.signing.signer import Sidecar, sidecar_of
from cutgate.runtime.commands.app import execute
from tests.logs import create, judged
from tests.runtime.audit.build import OPENED, PATIENCE_S, Ticking, decision


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three sessions of one folder, and their public keys."""
    folder, clock, keys = tmp_path_factory.mktemp("room") / "logs", Ticking(), []
    for number in range(3):
        log = create(folder, log_id=f"{number}a" * 16, opened=OPENED, clock=clock.clock())
        log.write(decision(number))
        log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
        clock.now_ns += 60_000_000_000
        keys.append(log.held.key.public)
    for epoch, key in enumerate(keys, start=1):
        (folder.parent / f"{epoch}.pub").write_bytes(key.encode())
    return folder


@pytest.fixture
def room(made, tmp_path):
    """A copy of them that may be changed."""
    shutil.copytree(made.parent, tmp_path / "room")
    return tmp_path / "room"


def logs(room):
    return sorted((room / "logs").glob("*.mcap"))


@pytest.fixture
def verify(capsys):
    def call(*words):
        code = execute(["audit", "verify", *map(str, words), "--json"])
        said = capsys.readouterr()
        return code, json.loads(said.out) if said.out else said.err

    return call


def answer(document, step):
    return next(entry["answer"] for entry in document["steps"] if entry["step"] == step)


@pytest.mark.parametrize("epoch", [1, 2, 3])
def test_a_log_is_held_against_the_key_that_is_pinned(room, verify, epoch):
    for number, log in enumerate(logs(room), start=1):
        code, document = verify(log, "--public-key", room / f"{epoch}.pub")
        vouched = number >= epoch
        assert (code, answer(document, "key chain")) == ((0, "yes") if vouched else (2, "no"))
        assert ("pinned" in document["headline"]) == vouched


def test_without_a_pinned_key_it_is_said_that_the_key_is_the_logs_own(room, verify):
    code, document = verify(logs(room)[1])
    assert (code, answer(document, "key chain"), answer(document, "witness")) == (
        0,
        "not checked",
        "not checked",
    )
    assert "from the log itself" in document["headline"]


def test_a_certificate_that_is_missing_is_named(room, verify):
    first, second, third = logs(room)
    second.unlink()
    code, document = verify(third, "--public-key", room / "1.pub")
    assert code == 2
    assert "the certificate of epoch 2 is missing" in document["reasons"][0]
    assert verify(third, "--public-key", room / "2.pub")[0] == 0
    assert verify(first, "--public-key", room / "1.pub")[0] == 0


def test_an_anchor_is_a_root_or_a_head_of_the_log(room, verify):
    report = judged(logs(room)[1]).report
    for anchor in (report.root, report.head):
        code, document = verify(logs(room)[1], "--anchor", anchor)
        assert (code, answer(document, "witness")) == (0, "yes")
        assert anchor in document["headline"]
    code, document = verify(logs(room)[1], "--anchor", report.root, "--anchor", "ab" * 32)
    assert (code, answer(document, "witness")) == (2, "no")
    assert "ab" * 32 in document["reasons"][0]


def cosigned(log, key, name="witness.example"):
    """The sidecar with one more signature, made without our own code."""
    sidecar = Sidecar.parse(sidecar_of(log).read_bytes())
    text = sidecar.checkpoint.rpartition("\n\n")[0] + "\n"
    public = key.public_key().public_bytes_raw()
    key_id = sha256(name.encode() + b"\n\x04" + public).digest()[:4]
    stamp = (1_790_000_000).to_bytes(8, "big")
    signature = key.sign(f"cosignature/v1\ntime {1_790_000_000}\n{text}".encode())
    line = b64encode(key_id + stamp + signature).decode()
    note = sidecar.checkpoint + f"\u2014 {name} {line}\n"
    sidecar_of(log).write_bytes(Sidecar(note, sidecar.file).encode())
    return VerifierKey(name, public, SignatureType.COSIGNATURE)


def test_a_cosignature_is_verified_where_its_key_is_given(room, verify):
    log, key = logs(room)[1], Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
    witness = cosigned(log, key)
    assert verify(log)[0] == 0, "a signature of a key that nobody gave is passed over"
    code, document = verify(log, "--cosigner", witness)
    assert (code, answer(document, "witness")) == (0, "yes")
    assert "cosigned by witness.example" in document["headline"]
    code, document = verify(logs(room)[0], "--cosigner", witness)
    assert (code, answer(document, "witness")) == (2, "no")
    other = VerifierKey(witness.name, bytes(32), SignatureType.COSIGNATURE)
    assert verify(log, "--cosigner", other)[0] == 2


@pytest.mark.parametrize(
    "words",
    [
        ["--anchor", "ab"],
        ["--anchor", "xy" * 32],
        ["--cosigner", "x"],
        ["--public-key", "missing.pub"],
        ["--key", "missing.key"],
    ],
)
def test_what_is_no_key_or_anchor_is_a_usage_error(room, verify, words):
    assert verify(logs(room)[0], *words)[0] == 3


def test_a_secret_key_is_no_public_one(room, verify, tmp_path):
    execute(["key", "new", "--log", str(tmp_path / "new.key")])
    code, told = verify(logs(room)[0], "--public-key", tmp_path / "new.key")
    assert code == 3
    assert "no public log key" in told
    assert verify(logs(room)[0], "--public-key", tmp_path / "new.key.pub")[0] == 2


def test_what_no_verification_can_find_is_told(room, capsys):
    assert execute(["audit", "verify", str(logs(room)[0]), "--explain"]) == 0
    assert "What no verification of a log can find" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["show", "replay"])
def test_a_folder_stands_for_its_logs(room, capsys, command):
    code = execute(["audit", command, str(room / "logs"), "--json"])
    assert [entry["log"] for entry in json.loads(capsys.readouterr().out)] == [str(log) for log in logs(room)]
    assert code == 0
    (room / "empty").mkdir()
    assert execute(["audit", command, str(room / "empty")]) == 2
