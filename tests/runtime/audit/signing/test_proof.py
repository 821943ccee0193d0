"""The proof of one record: its one form, what makes it true, and that every bit of it counts."""

import json
import re
import struct
from base64 import b64decode, b64encode
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing import proof as module
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import LogKey, PublicLogKey
from cutgate.runtime.audit.signing.note import sign
from cutgate.runtime.audit.signing.proof import (
    CERTIFICATES_MAX,
    PROOF_MAX,
    RECORD_MAX,
    ProofError,
    RecordProof,
    why_false,
)
from cutgate.runtime.audit.tree import leaf_hash, root_of
from tests.runtime.audit.signing.builders import LOG_ID, SERIES, checkpoint, keys, proof_of, record
from tests.runtime.audit.signing.vectors import generate

ALONE = proof_of(3, 7)
CHAINED = proof_of(3, 7, epochs=4, first=5)
PROOFS = {
    "alone": ALONE,
    "chained": CHAINED,
    "only record": proof_of(0, 1),
    "last": proof_of(12, 13, epochs=2),
}
EPOCHS = {key.epoch: key.public for key in keys(4, 5)}
TEXTS = {name: proof.encode() for name, proof in PROOFS.items()}


def lines(proof):
    return proof.encode().decode().split("\n")


def with_extra(proof, change):
    """The text of a proof whose extra is changed by a function of its bytes."""
    first, extra, *rest = lines(proof)
    data = change(b64decode(extra.removeprefix("extra ")))
    return "\n".join((first, f"extra {b64encode(data).decode()}", *rest)).encode()


def outcome(data, pinned=None):
    """True, false or unreadable."""
    try:
        return why_false(RecordProof.parse(data), pinned) == ""
    except ProofError:
        return None


# ---------------------------------------------------------------- the form


@pytest.mark.parametrize("name", PROOFS)
def test_what_is_written_is_read_and_true(name):
    proof = PROOFS[name]
    read = RecordProof.parse(proof.encode())
    assert read == proof
    assert why_false(read, None) == ""
    assert (read.log_id, read.named.size, read.record.sequence) == (LOG_ID, proof.named.size, proof.index)


def test_the_lines_are_those_of_the_specification():
    first, extra, index, *rest = lines(ALONE)
    assert (first, index) == ("c2sp.org/tlog-proof@v1", "index 3")
    assert re.fullmatch(r"extra [A-Za-z0-9+/]+=*", extra)
    hashes, (empty, *note) = rest[:3], rest[3:]
    assert tuple(map(b64decode, hashes)) == ALONE.beside
    assert empty == ""
    assert "\n".join(note) == ALONE.checkpoint


def test_extra_holds_the_keys_and_the_record():
    extra = b64decode(lines(CHAINED)[1].removeprefix("extra "))
    expected = b"cutgate/proof/1" + struct.pack("<I", 3) + SERIES + struct.pack("<I", 5) + EPOCHS[5].public
    for epoch in (6, 7, 8):
        expected += EPOCHS[epoch].public + EPOCHS[epoch].certificate
    assert extra == expected + record(3)
    alone = b64decode(lines(ALONE)[1].removeprefix("extra "))
    assert alone == b"cutgate/proof/1" + bytes(4) + keys(1)[0].public.public + record(3)


@given(
    st.integers(1, 60).flatmap(lambda size: st.tuples(st.integers(0, size - 1), st.just(size))),
    st.integers(1, 4),
    st.text(st.characters(codec="utf-8"), max_size=20),
)
def test_every_true_proof_is_read_and_true(place, epochs, text):
    index, size = place
    proof = proof_of(index, size, epochs=epochs, text=text)
    assert RecordProof.parse(proof.encode()) == proof
    assert outcome(proof.encode(), keys(epochs)[0].public) is True


def flipped(data, place, bit):
    return data[:place] + bytes((data[place] ^ 1 << bit,)) + data[place + 1 :]


@pytest.mark.no_cover
@pytest.mark.parametrize("name", PROOFS)
def test_no_other_bit_is_true(name):
    data = TEXTS[name]
    bits = ((place, bit) for place in range(len(data)) for bit in range(8))
    assert [place for place in bits if outcome(flipped(data, *place))] == []


@given(st.sampled_from(sorted(TEXTS)), st.data())
def test_nothing_that_is_cut_out_or_put_in_leaves_it_true(name, draws):
    data = TEXTS[name]
    start = draws.draw(st.integers(0, len(data)))
    end = draws.draw(st.integers(start, min(len(data), start + 60)))
    put = draws.draw(st.binary(max_size=4) | st.sampled_from([b"\n", b"\r\n", b" ", b"=", b"A"]))
    changed = data[:start] + put + data[end:]
    assert outcome(changed) is True if changed == data else not outcome(changed)


@given(
    st.binary(max_size=300)
    | st.sampled_from(sorted(TEXTS.values())).flatmap(
        lambda data: st.integers(0, len(data)).map(lambda end: data[:end])
    )
)
def test_whatever_it_is_it_is_refused_or_written_again_as_it_stands(data):
    try:
        proof = RecordProof.parse(data)
    except ProofError:
        return
    assert proof.encode() == data


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("@v1", "@v2"),
        ("c2sp", "C2SP"),
        ("extra ", ""),
        ("extra ", "extra  "),
        ("extra ", "Extra "),
        ("index 3", "index 03"),
        ("index 3", "index +3"),
        ("index 3", "index -3"),
        ("index 3", "index ٣"),
        ("index 3", "index"),
        ("index 3", "index 3 "),
        ("index 3", "index 3" + 19 * "0"),
        ("index 3\n", ""),
        ("index 3\n", "index 3\nindex 3\n"),
        ("index 3\n", "index 3\n\n"),
        ("\n", "\r\n"),
        ("c2sp", "\ufeffc2sp"),
        ("\n\ncutgate", "\ncutgate"),
    ],
)
def test_another_form_is_refused(old, new):
    text = ALONE.encode().decode()
    assert old in text
    with pytest.raises(ProofError):
        RecordProof.parse(text.replace(old, new).encode())


def test_the_parts_of_two_lines_do_not_change_places():
    first, extra, index, *rest = lines(ALONE)
    for other in ((first, index, extra, *rest), (extra, first, index, *rest), (first, index, *rest)):
        with pytest.raises(ProofError, match="it begins otherwise than a proof"):
            RecordProof.parse("\n".join(other).encode())


def test_what_is_no_utf_8_is_refused():
    with pytest.raises(ProofError, match="byte 4 is no UTF-8"):
        RecordProof.parse(b"c2sp\xff")


def test_base64_has_one_form():
    """Where it ends in padding, the last character has bits that say nothing."""
    padded = next(
        proof for proof in (proof_of(3, 7, text="x" * size) for size in (1, 2)) if lines(proof)[1][-1] == "="
    )
    for place, what in ((1, "extra"), (3, "hash 0"), (4, "hash 1")):
        text = lines(padded)
        encoded = text[place].removeprefix("extra ")
        end = encoded.rstrip("=")
        other = end[:-1] + chr(ord(end[-1]) + 1) + encoded[len(end) :]
        assert b64decode(other) == b64decode(encoded)
        text[place] = text[place].replace(encoded, other)
        with pytest.raises(ProofError, match=f"its {what} is no base64 in its one form"):
            RecordProof.parse("\n".join(text).encode())
    for extra in ("AAA", "A", "AA=", "AAAA="):
        first, _, *rest = lines(ALONE)
        with pytest.raises(ProofError, match="its extra is no base64"):
            RecordProof.parse("\n".join((first, f"extra {extra}", *rest)).encode())


def test_so_many_hashes_and_no_more():
    deep = replace(ALONE, beside=(bytes(32),) * 64)
    assert RecordProof.parse(deep.encode()) == deep
    with pytest.raises(ProofError, match="it begins otherwise"):
        RecordProof.parse(replace(ALONE, beside=(bytes(32),) * 65).encode())


def counted(number):
    return lambda data: data[:15] + struct.pack("<I", number) + data[19:]


def epoch(number):
    return lambda data: data[:35] + struct.pack("<I", number) + data[39:]


@pytest.mark.parametrize(
    ("proof", "change", "told"),
    [
        (ALONE, lambda data: b"x" + data[1:], "does not begin with cutgate/proof/1"),
        (ALONE, lambda data: data[:14], "ends early"),
        (ALONE, lambda data: data[:18], "ends early"),
        (ALONE, lambda data: data[:50], "ends early"),
        (ALONE, lambda data: data[:51], "its record is none: it ends early"),
        (ALONE, lambda data: data[:-1], "its record is none"),
        (ALONE, lambda data: data + b"x", "its record is none"),
        (ALONE, counted(CERTIFICATES_MAX + 1), f"names {CERTIFICATES_MAX + 1} certificates"),
        (CHAINED, lambda data: data[:38], "ends early"),
        (CHAINED, lambda data: data[:70], "ends early"),
        (CHAINED, lambda data: data[:166], "ends early"),
        (CHAINED, epoch(0), "its first epoch is 0, must be 1 to 4294967292"),
        (CHAINED, epoch(4294967293), "its first epoch is 4294967293, must be 1 to 4294967292"),
    ],
)
def test_another_extra_is_refused(proof, change, told):
    with pytest.raises(ProofError, match=re.escape(told)):
        RecordProof.parse(with_extra(proof, change))


def test_the_last_epochs():
    """Nobody signs so often; the form holds it all the same."""
    read = RecordProof.parse(with_extra(CHAINED, epoch(4294967292)))
    assert [key.epoch for key in read.keys] == [4294967292, 4294967293, 4294967294, 4294967295]


OTHER_NOTE = sign("text\n", "name", keys(1)[0].private)


@pytest.mark.parametrize(
    ("note", "told"),
    [
        ("", "its checkpoint is none: a note is text"),
        (OTHER_NOTE, "its checkpoint is none: a checkpoint is three lines"),
        (
            checkpoint(keys(1)[0], 7, bytes(32), LOG_ID[:-1]),
            "its checkpoint is of 'cutgate/0123456789abcdef0123456789abcde', must be of",
        ),
        (checkpoint(keys(1)[0], 7, bytes(32), LOG_ID.upper()), "its checkpoint is of"),
        (checkpoint(keys(1)[0], 7, bytes(32), LOG_ID + "/file"), "its checkpoint is of"),
        (ALONE.checkpoint + "— other AAAAAAA=\n", "has 2 signatures, must have the log's alone"),
        (ALONE.checkpoint + ALONE.checkpoint.splitlines()[-1] + "\n", "has 2 signatures"),
        (ALONE.checkpoint + "\n", "its checkpoint is none"),
    ],
)
def test_another_checkpoint_is_refused(note, told):
    with pytest.raises(ProofError, match=re.escape(told)):
        RecordProof.parse(replace(ALONE, checkpoint=note).encode())


def test_sizes_are_bounded(monkeypatch):
    with pytest.raises(ProofError, match=f"at most {PROOF_MAX} bytes, this one {PROOF_MAX + 1}"):
        RecordProof.parse(bytes(PROOF_MAX + 1))
    with pytest.raises(
        ProofError, match=f"a record of {RECORD_MAX + 1} bytes, at most {RECORD_MAX} can be proven"
    ):
        replace(ALONE, covered=bytes(RECORD_MAX + 1)).encode()
    many = (keys(1)[0].public, *[keys(2)[1].public] * (CERTIFICATES_MAX + 1))
    with pytest.raises(ProofError, match=f"{CERTIFICATES_MAX + 1} certificates, a proof holds at most"):
        replace(ALONE, keys=many).encode()
    size = len(ALONE.covered)
    data = ALONE.encode()
    monkeypatch.setattr(module, "RECORD_MAX", size)
    assert RecordProof.parse(data).encode() == data
    monkeypatch.setattr(module, "RECORD_MAX", size - 1)
    with pytest.raises(ProofError, match=f"its record has {size} bytes, a proof's at most {size - 1}"):
        RecordProof.parse(data)


def test_the_largest_proof_is_read():
    """With as many certificates and the largest record, it has no more bytes than are read."""
    extra = len(b"cutgate/proof/1") + 4 + 20 + 32 + 96 * CERTIFICATES_MAX + RECORD_MAX
    rest = len(replace(ALONE, index=10**19 - 1, beside=(bytes(32),) * 64).encode()) - len(lines(ALONE)[1])
    assert 4 * -(-extra // 3) + rest < PROOF_MAX


def test_the_bounds():
    assert (RECORD_MAX, CERTIFICATES_MAX, PROOF_MAX) == (16 << 20, 65536, 32 << 20)


def test_what_is_as_large_as_it_may_be_is_written_and_read(monkeypatch):
    data = CHAINED.encode()
    monkeypatch.setattr(module, "PROOF_MAX", len(data))
    monkeypatch.setattr(module, "CERTIFICATES_MAX", 3)
    assert RecordProof.parse(data).encode() == data
    monkeypatch.setattr(module, "CERTIFICATES_MAX", 2)
    with pytest.raises(ProofError, match="it names 3 certificates, a proof holds at most 2"):
        RecordProof.parse(data)
    with pytest.raises(
        ProofError, match="3 certificates, a proof holds at most 2; pin a key of a later epoch"
    ):
        CHAINED.encode()
    monkeypatch.setattr(module, "PROOF_MAX", len(data) - 1)
    with pytest.raises(ProofError, match=f"at most {len(data) - 1} bytes, this one {len(data)}"):
        RecordProof.parse(data)


def test_a_proof_does_not_change():
    with pytest.raises(FrozenInstanceError):
        ALONE.index = 4
    assert not hasattr(ALONE, "__dict__")


def test_a_key_without_certificate_behind_others_is_not_written():
    with pytest.raises(ProofError, match="nobody certified"):
        replace(CHAINED, keys=(EPOCHS[5], replace(EPOCHS[6], certificate=None))).encode()


@pytest.mark.parametrize("depth", [0, 1, 10, 20])
@pytest.mark.parametrize("epochs", [1, 2, 40])
@pytest.mark.parametrize("length", [0, 1, 100, 5000])
def test_a_proof_is_small(depth, epochs, length):
    """1.5 kB beside 4/3 of the record, and 134 bytes an epoch; trees of up to 2^20 records."""
    size = 2**depth
    chain = keys(epochs)
    whole = record(size - 1, "x" * length)
    beside = tuple(bytes((number,)) * 32 for number in range(depth))
    root = root_of(leaf_hash(whole), size - 1, size, beside)
    public = tuple(key.public for key in chain)
    proof = RecordProof(
        whole,
        size - 1,
        beside,
        checkpoint(chain[-1], size, root),
        public[-1].public,
        public if epochs > 1 else (),
    )
    data = proof.encode()
    assert outcome(data, public[0]) is True
    assert len(data) <= 1500 + 4 / 3 * len(whole) + 134 * (epochs - 1)
    assert len(data) <= 1300 + 4 / 3 * len(whole) + 128 * (epochs - 1)


# ---------------------------------------------------------------- what makes it true


def test_another_place_in_the_tree_is_false():
    assert "says that its number is 3, the proof that it is 4" in why_false(replace(ALONE, index=4), None)


def test_a_record_that_the_checkpoint_does_not_cover_is_false():
    key = keys(1)[0]
    proof = replace(ALONE, checkpoint=checkpoint(key, 3, bytes(32)))
    assert why_false(proof, None) == "record 3 is not among the 3 that the checkpoint covers"


def test_a_proof_of_another_length_is_false():
    for beside in (ALONE.beside[:-1], (*ALONE.beside, bytes(32))):
        told = why_false(replace(ALONE, beside=beside), None)
        assert told.startswith(f"{len(beside)} hashes are not those beside record 3 in a tree of 7 records")


def test_another_record_or_hash_is_false():
    for changed in (
        replace(ALONE, covered=record(3, "other")),
        replace(ALONE, beside=(bytes(32), *ALONE.beside[1:])),
        replace(ALONE, beside=(*ALONE.beside[:-1], bytes(32))),
    ):
        assert re.match(
            r"with this record the tree's root is [0-9a-f]{64}, the checkpoint names",
            why_false(changed, None),
        )


def test_a_checkpoint_of_another_key_log_or_name_is_false():
    named = ALONE.named
    other = LogKey(SERIES, 1, b"\7" * 32)
    for note in (
        checkpoint(other, named.size, named.hash),
        sign(named.text, "other", keys(1)[0].private),
        ALONE.checkpoint.replace(LOG_ID, "f" * 32),
    ):
        told = why_false(replace(ALONE, checkpoint=note), None)
        assert told.startswith("the checkpoint is not signed by the key that the proof names: ")
    assert (
        why_false(replace(ALONE, checkpoint=checkpoint(keys(1)[0], named.size, named.hash, "f" * 32)), None)
        == ""
    )


def test_a_checkpoint_of_the_file_is_none_of_the_tree():
    origin = origin_of(LOG_ID)
    note = sign(Checkpoint(f"{origin}/file", 7, ALONE.named.hash).text, origin, keys(1)[0].private)
    with pytest.raises(ProofError, match="its checkpoint is of"):
        RecordProof.parse(replace(ALONE, checkpoint=note).encode())


@pytest.mark.parametrize("place", [1, 2, 3])
@pytest.mark.parametrize("change", ["certificate", "key", "series", "epoch"])
def test_a_chain_that_is_broken_anywhere_is_false(place, change):
    changed = list(CHAINED.keys)
    other = Ed25519PrivateKey.from_private_bytes(b"\7" * 32)
    changed[place] = {
        "certificate": replace(changed[place], certificate=other.sign(changed[place].certified)),
        "key": replace(changed[place], public=other.public_key().public_bytes_raw()),
        "series": replace(changed[place], series=bytes(16)),
        "epoch": replace(changed[place], epoch=changed[place].epoch + 1),
    }[change]
    # The key of epoch 5 signs nothing but the next: altered itself, it is the next that it did not certify.
    told = why_false(replace(CHAINED, keys=tuple(changed)), EPOCHS[5])
    assert told == f"the key of epoch {changed[place].epoch} is not certified by the one before it"


def test_a_first_key_that_certified_nothing_is_false():
    other = Ed25519PrivateKey.from_private_bytes(b"\7" * 32).public_key().public_bytes_raw()
    first = replace(CHAINED.keys[0], public=other)
    told = why_false(replace(CHAINED, keys=(first, *CHAINED.keys[1:])), None)
    assert told == "the key of epoch 6 is not certified by the one before it"


@pytest.mark.parametrize("epoch", [5, 6, 7, 8])
def test_any_key_on_the_way_may_be_pinned(epoch):
    assert why_false(CHAINED, EPOCHS[epoch]) == ""


def pinned(epoch, *, series=SERIES, public=None):
    return PublicLogKey(series, epoch, public or b"\7" * 32)


@pytest.mark.parametrize(
    ("proof", "key", "told"),
    [
        (CHAINED, pinned(4), "begin with the key of epoch 5, the pinned key is of epoch 4"),
        (CHAINED, pinned(5), "its key of epoch 5 is another one than the pinned key"),
        (CHAINED, pinned(8), "its key of epoch 8 is another one than the pinned key"),
        (CHAINED, pinned(6, public=EPOCHS[7].public), "its key of epoch 6 is another one"),
        (CHAINED, pinned(9), "of epoch 9, the log of epoch 8: keys certify later ones"),
        (CHAINED, pinned(5, series=bytes(16), public=EPOCHS[5].public), f"of the series {'00' * 16}, the log of {SERIES.hex()}"),
        (ALONE, pinned(1), "(epoch 1) is not the one that signed the log, and the proof holds no certificates"),
        (ALONE, keys(2)[1].public, "(epoch 2) is not the one that signed the log"),
    ],
)  # fmt: skip
def test_another_pinned_key_vouches_for_nothing(proof, key, told):
    assert told in why_false(proof, key)
    assert why_false(proof, None) == ""


def test_the_key_that_signed_may_be_pinned():
    assert why_false(ALONE, keys(1)[0].public) == ""


def test_the_order_of_what_is_asked():
    """Tree before signature, signature before certificates, these before the pinned key."""
    no_chain = (CHAINED.keys[0], replace(CHAINED.keys[1], certificate=bytes(64)), *CHAINED.keys[2:])
    unsigned = CHAINED.checkpoint.replace(LOG_ID, "f" * 32)
    wrong = replace(CHAINED, keys=no_chain, checkpoint=unsigned, covered=record(3, "other"))
    assert "the tree's root" in why_false(wrong, pinned(9))
    wrong = replace(wrong, covered=CHAINED.covered)
    assert "is not signed" in why_false(wrong, pinned(9))
    wrong = replace(wrong, checkpoint=CHAINED.checkpoint)
    assert "is not certified" in why_false(wrong, pinned(9))
    assert "pinned" in why_false(replace(wrong, keys=CHAINED.keys), pinned(9))


# ---------------------------------------------------------------- vectors


VECTORS = Path(generate.__file__).parent


def test_the_vectors_are_those_that_are_generated():
    for name, data in generate.files().items():
        assert (VECTORS / name).read_bytes() == data, name
    assert {path.name for path in VECTORS.iterdir() if path.is_file() and path.suffix != ".py"} == set(
        generate.files()
    )


def test_the_vectors_say_what_holds():
    for case in json.loads((VECTORS / "cases.json").read_bytes())["cases"]:
        key = case["public_key"]
        trusted = None if key is None else PublicLogKey.parse((VECTORS / key).read_bytes())
        assert (
            outcome((VECTORS / case["proof"]).read_bytes(), trusted)
            == {"true": True, "false": False, "unreadable": None}[case["outcome"]]
        ), case
