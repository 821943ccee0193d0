"""The second verifier of proofs beside ours, on the same files."""

import ast
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.proof import ProofError, RecordProof, why_false
from tests.oracle import tlog_proof
from tests.oracle.tlog_proof import verified
from tests.runtime.audit.signing.builders import keys, proof_of
from tests.runtime.audit.signing.vectors import generate

VECTORS = Path(generate.__file__).parent
CASES = json.loads((VECTORS / "cases.json").read_bytes())["cases"]


def ours(data, public_key=None):
    """The record if the proof is true by our verifier, else None."""
    try:
        proof = RecordProof.parse(data)
    except ProofError:
        return None
    key = PublicLogKey.parse(public_key) if public_key else None
    return None if why_false(proof, key) else proof.covered


def theirs(data, public_key=None):
    try:
        return verified(data, public_key)
    except Exception:  # noqa: BLE001 - it says of what is no proof whatever its libraries say
        return None


@pytest.mark.parametrize("module", [tlog_proof, generate])
def test_it_imports_nothing_of_ours(module):
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {
        name for name in names if name.split(".")[0] in ("cutgate", "runtime", "tests", "config", "protocol")
    }


@pytest.mark.parametrize("case", [case for case in CASES if case["outcome"] != "unreadable"], ids=str)
def test_both_say_what_the_vectors_say(case):
    data = (VECTORS / case["proof"]).read_bytes()
    key = case["public_key"] and (VECTORS / case["public_key"]).read_bytes()
    found = ours(data, key)
    assert found == theirs(data, key)
    assert (found is not None) == (case["outcome"] == "true")


@given(
    st.integers(1, 130).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))),
    st.integers(1, 4),
    st.integers(1, 5),
)
def test_both_agree_on_what_we_make(place, epochs, pinned):
    proof = proof_of(*place, epochs=epochs)
    key = keys(5)[pinned - 1].public.encode()
    assert (
        ours(proof.encode(), key)
        == theirs(proof.encode(), key)
        == (proof.covered if pinned <= epochs else None)
    )


@given(st.integers(0, 8 * 1600), st.integers(1, 3))
def test_what_is_altered_is_true_by_neither(bit, epochs):
    data = bytearray(proof_of(6, 11, epochs=epochs).encode())
    data[bit // 8 % len(data)] ^= 1 << bit % 8
    assert ours(bytes(data)) is None
    # The second one is not strict about the form: what it takes for true must be the very record.
    assert theirs(bytes(data)) in (None, proof_of(6, 11).covered)
