"""A second verifier of the proofs of records, after docs/audit.md, out of libraries: ``pymerkle`` for the tree, ``cryptography``
for signatures. It imports nothing of the packages under test."""

import json
import struct
from base64 import b64decode
from hashlib import sha256
from itertools import pairwise

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pymerkle import InmemoryTree, InvalidProof, verify_inclusion
from pymerkle.proof import InclusionProof

SIZE_MAX = 10_000
"""pymerkle is asked for the shape of a proof by a tree of this size."""


def verified(text, public_key=None):
    """The record's bytes if the proof is true, else None.

    Args:
        text: the proof's file.
        public_key: the file of the pinned key.
    """
    head, _, checkpoint = text.partition(b"\n\n")
    version, extra, index, *hashes = head.split(b"\n")
    if version != b"c2sp.org/tlog-proof@v1" or extra[:6] != b"extra " or index[:6] != b"index ":
        return None
    keys, record = parted(b64decode(extra[6:], validate=True))
    origin, size, root = tree_head(checkpoint, keys[-1][1])
    trusted = not public_key or pinned(json.loads(public_key), keys)
    beside = [b64decode(one, validate=True) for one in hashes]
    if None in (origin, trusted or None) or not certified(keys):
        return None
    return record if included(record, int(index[6:]), size, beside, root) else None


def parted(extra):
    """Epoch, public key, series and certificate of each key; and the record."""
    assert extra[:15] == b"cutgate/proof/1"
    (count,), at = struct.unpack_from("<I", extra, 15), 19
    assert count <= 65_536
    series, first = None, None
    if count:
        series, first = struct.unpack_from("<16sI", extra, at)
        at += 20
    keys = [(first, extra[at : at + 32], series, None)]
    at += 32
    for number in range(count):
        keys.append((first + 1 + number, extra[at : at + 32], series, extra[at + 32 : at + 96]))
        at += 96
    return keys, extra[at:]


def tree_head(note, public):
    """Origin, size and root that the key has signed; None thrice if it has not."""
    text, _, signature = note.rpartition(b"\n\n")
    dash, name, encoded = signature.split(b" ")
    origin, size, root = text.split(b"\n")
    data = b64decode(encoded.removesuffix(b"\n"), validate=True)
    if (
        dash != "\u2014".encode()
        or name != origin
        or data[:4] != sha256(name + b"\n\x01" + public).digest()[:4]
    ):
        return None, None, None
    if not signed(public, data[4:], text + b"\n"):
        return None, None, None
    return origin, int(size), b64decode(root, validate=True)


def certified(keys):
    """Whether each key but the first carries the signature of the one before it."""
    for (_, before, _, _), (epoch, public, series, certificate) in pairwise(keys):
        if not signed(before, certificate, b"cutgate/log-key/1" + series + struct.pack("<I", epoch) + public):
            return False
    return True


def pinned(trusted, keys):
    """Whether the pinned key is one of these."""
    public = bytes.fromhex(trusted["public_key"])
    if len(keys) == 1:
        return public == keys[0][1]
    return (trusted["epoch"], public, bytes.fromhex(trusted["series"])) in [key[:3] for key in keys]


def included(record, index, size, beside, root):
    """Whether the record is in the tree, by pymerkle's verifier."""
    if not 0 <= index < size <= SIZE_MAX:
        return False
    same_size = InmemoryTree(algorithm="sha256")
    for _ in range(size):
        same_size.append_entry(b"")
    rule = same_size.prove_inclusion(index + 1, size).rule
    leaf = sha256(b"\x00" + record).digest()
    proof = InclusionProof("sha256", True, size, index + 1, rule, [leaf, *beside])
    try:
        verify_inclusion(leaf, root, proof, index=index + 1, size=size, algorithm="sha256")
    except InvalidProof:
        return False
    return True


def signed(public, signature, text):
    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, text)
    except InvalidSignature:
        return False
    return True
