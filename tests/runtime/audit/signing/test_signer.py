"""What stands beside a closed log: two notes over what there is, and nothing else is read as one."""

import json
from dataclasses import FrozenInstanceError
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.checkpoint import FILE, Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.note import VerifierKey
from cutgate.runtime.audit.signing.signer import SCHEMA, SIDECAR_MAX, Sidecar, Signer, sidecar_of

KEY = LogKey(bytes(16), 1, bytes(range(32)))
LOG_ID = "ab" * 16
ORIGIN = origin_of(LOG_ID)
VERIFIER = VerifierKey(ORIGIN, KEY.public.public)
ROOT, DIGEST = sha256(b"root").digest(), sha256(b"file").digest()


def test_it_signs_the_tree_and_the_file_each_under_its_own_origin():
    signer = Signer(KEY, LOG_ID)
    sidecar = Sidecar.parse(signer.sidecar(7, ROOT, 1234, DIGEST))
    tree = Checkpoint.parse(note.verify(sidecar.checkpoint, VERIFIER), ORIGIN)
    file = Checkpoint.parse(note.verify(sidecar.file, VERIFIER), ORIGIN + FILE)
    assert (tree.size, tree.hash) == (7, ROOT)
    assert (file.size, file.hash) == (1234, DIGEST)
    assert sidecar.checkpoint == signer.checkpoint(7, ROOT)
    assert signer.key == KEY.public
    assert Sidecar.parse(sidecar.encode()) == sidecar
    assert "\u2014 cutgate/" in sidecar.encode().decode(), "read by people too"
    assert sidecar.encode().decode().splitlines()[1].startswith(' "schema"')
    assert not hasattr(sidecar, "__dict__")
    with pytest.raises(FrozenInstanceError):
        sidecar.file = ""


def test_it_stands_beside_the_log():
    assert sidecar_of(Path("logs/a.mcap")) == Path("logs/a.signature.json")


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\xff", b"7", b"[]", b"{}", b"[" * 100_000,
        json.dumps({"schema": SCHEMA, "checkpoint": "a"}).encode(),
        json.dumps({"schema": SCHEMA, "checkpoint": "a", "file": 7}).encode(),
        json.dumps({"schema": SCHEMA, "checkpoint": None, "file": "a"}).encode(),
        json.dumps({"schema": "other", "checkpoint": "a", "file": "b"}).encode(),
        b" " * SIDECAR_MAX + b"{}",
    ],
    ids=lambda data: repr(data[:20] + data[-20:]),
)  # fmt: skip
def test_anything_else_is_refused(data):
    with pytest.raises(ValueError, match="it"):
        Sidecar.parse(data)


def test_its_length_is_bounded():
    data = Sidecar("a", "b").encode()
    assert Sidecar.parse(data.ljust(SIDECAR_MAX)) == Sidecar("a", "b")
    assert SIDECAR_MAX == 131_072
    with pytest.raises(ValueError, match="at most"):
        Sidecar.parse(data.ljust(SIDECAR_MAX + 1))


@given(st.binary(max_size=200))
def test_any_bytes_are_two_notes_or_refused(data):
    try:
        sidecar = Sidecar.parse(data)
    except ValueError:
        return
    assert isinstance(sidecar.checkpoint, str)
    assert isinstance(sidecar.file, str)
