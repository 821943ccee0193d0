"""Makes the vectors of keys, notes and proofs from docs/audit.md alone: it must not import the package that they test.

Plain struct, hashlib, base64, and Ed25519 from ``cryptography``. Run it to write the files beside it; ``cases.json`` says
what is to come out of each proof with each public key. The secrets are numbers counted up, and good for nothing else.
"""

import json
import struct
from base64 import b64encode
from hashlib import sha256
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

HERE = Path(__file__).parent
LOG_ID = "00112233445566778899aabbccddeeff"
ORIGIN = f"cutgate/{LOG_ID}"
SERIES = bytes.fromhex("a0a1a2a3a4a5a6a7a8a9aaabacadaeaf")
FIRST, LAST = 3, 6
"""Epochs: of the first key that is certified here, and of the log."""
SIZE = 11
INDEX = 6
UTC_NS = 1_790_000_000_123_456_789


def secret(epoch: int) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(bytes((epoch + at) % 256 for at in range(32)))


def public(epoch: int) -> bytes:
    return secret(epoch).public_key().public_bytes_raw()


def certificate(epoch: int) -> bytes:
    return secret(epoch - 1).sign(b"cutgate/log-key/1" + SERIES + struct.pack("<I", epoch) + public(epoch))


def public_key_file(epoch: int, key: bytes | None = None, series: bytes = SERIES) -> bytes:
    content = {
        "schema": "cutgate.log-public-key/1",
        "series": series.hex(),
        "epoch": epoch,
        "public_key": (key or public(epoch)).hex(),
    }
    if epoch > FIRST:
        content["certificate"] = certificate(epoch).hex()
    return json.dumps(content).encode() + b"\n"


def record(number: int) -> bytes:
    """What is covered of a record."""
    texts = (b"/audit/operator", b"json", b"cutgate.Operator")
    data = json.dumps({"prev": "00" * 32, "word": f"record {number}"}).encode()
    counted = b"".join(struct.pack("<Q", len(text)) + text for text in texts)
    stamps = struct.pack("<QQIQ", UTC_NS + number, UTC_NS + number, number, len(data))
    return counted + sha256(b'{"type":"object"}').digest() + stamps + data


def tree(leaves: list[bytes]) -> bytes:
    if len(leaves) == 1:
        return sha256(b"\x00" + leaves[0]).digest()
    half = largest_power_below(len(leaves))
    return sha256(b"\x01" + tree(leaves[:half]) + tree(leaves[half:])).digest()


def path(index: int, leaves: list[bytes]) -> list[bytes]:
    if len(leaves) == 1:
        return []
    half = largest_power_below(len(leaves))
    if index < half:
        return [*path(index, leaves[:half]), tree(leaves[half:])]
    return [*path(index - half, leaves[half:]), tree(leaves[:half])]


def largest_power_below(size: int) -> int:
    return 1 << (size - 1).bit_length() - 1


def note(size: int, root: bytes, epoch: int = LAST, origin: str = ORIGIN) -> str:
    text = f"{origin}\n{size}\n{b64encode(root).decode()}\n"
    key_id = sha256(origin.encode() + b"\n\x01" + public(epoch)).digest()[:4]
    return f"{text}\n\u2014 {origin} {b64encode(key_id + secret(epoch).sign(text.encode())).decode()}\n"


def extra(first: int, covered: bytes) -> bytes:
    """From the key of this epoch to that of the log."""
    count = LAST - first
    head = struct.pack("<I", count) + (SERIES + struct.pack("<I", first) if count else b"") + public(first)
    rest = b"".join(public(epoch) + certificate(epoch) for epoch in range(first + 1, LAST + 1))
    return b"cutgate/proof/1" + head + rest + covered


def proof(
    first: int = LAST,
    index: int = INDEX,
    size: int = SIZE,
    *,
    covered: bytes | None = None,
    hashes: list[bytes] | None = None,
    checkpoint: str | None = None,
    made: bytes | None = None,
) -> bytes:
    leaves = [record(number) for number in range(size)]
    lines = [
        "c2sp.org/tlog-proof@v1",
        f"extra {b64encode(made or extra(first, covered or leaves[index])).decode()}",
        f"index {index}",
        *(b64encode(one).decode() for one in (path(index, leaves) if hashes is None else hashes)),
        "",
        note(size, tree(leaves)) if checkpoint is None else checkpoint,
    ]
    return "\n".join(lines).encode()


def proofs() -> dict[str, bytes]:
    leaves = [record(number) for number in range(SIZE)]
    root, beside = tree(leaves), path(INDEX, leaves)
    chained = extra(FIRST, leaves[INDEX])
    return {
        "alone": proof(),
        "chained": proof(FIRST),
        "first-of-one": proof(index=0, size=1),
        "last": proof(index=SIZE - 1),
        "other-record": proof(covered=record(INDEX).replace(b"record 6", b"record 9")),
        "other-number": proof(covered=record(INDEX + 1)),
        "too-short": proof(hashes=beside[:-1]),
        "too-long": proof(hashes=[*beside, root]),
        "not-covered": proof(hashes=beside, checkpoint=note(INDEX, tree(leaves[:INDEX]))),
        "other-key": proof(checkpoint=note(SIZE, root, LAST - 1)),
        "other-log": proof(checkpoint=note(SIZE, root).replace(LOG_ID, "f" * 32)),
        "other-certificate": proof(made=chained.replace(certificate(LAST), certificate(LAST)[:-1] + b"\0")),
        "crlf": proof().replace(b"\n", b"\r\n"),
        "version-2": proof().replace(b"@v1", b"@v2"),
        "spare-bits": proof(hashes=[bytes(32)]).replace(b"AAA=\n", b"AAB=\n"),
        "of-a-file": proof(checkpoint=note(SIZE, root, origin=f"{ORIGIN}/file")),
        "two-signatures": proof() + note(SIZE, root).split("\n")[-2].encode() + b"\n",
        "cut": proof()[:-1],
    }


def keys() -> dict[str, bytes]:
    other = Ed25519PrivateKey.from_private_bytes(b"\x77" * 32).public_key().public_bytes_raw()
    return {
        **{f"epoch-{epoch}": public_key_file(epoch) for epoch in range(FIRST, LAST + 2)},
        "epoch-3-other": public_key_file(FIRST, other),
        "epoch-6-other": public_key_file(LAST, other),
        "epoch-3-other-series": public_key_file(FIRST, series=bytes(16)),
    }


EXPECTED = (
    ("true", "alone", (None, "epoch-6")),
    ("false", "alone", ("epoch-3", "epoch-5", "epoch-7", "epoch-6-other")),
    ("true", "chained", (None, "epoch-3", "epoch-4", "epoch-5", "epoch-6")),
    ("false", "chained", ("epoch-7", "epoch-3-other", "epoch-6-other", "epoch-3-other-series")),
    ("true", "first-of-one", (None, "epoch-6")),
    ("true", "last", (None, "epoch-6")),
    *(
        ("false", name, (None,))
        for name in (
            "other-record", "other-number", "too-short", "too-long", "not-covered", "other-key", "other-log", "other-certificate",
        )
    ),
    *(
        ("unreadable", name, (None,))
        for name in ("crlf", "version-2", "spare-bits", "of-a-file", "two-signatures", "cut")
    ),
)  # fmt: skip


def files() -> dict[str, bytes]:
    """Every file's name and content."""
    cases = [
        {"proof": f"{name}.tlog-proof", "public_key": key and f"{key}.pub", "outcome": outcome}
        for outcome, name, trusted in EXPECTED
        for key in trusted
    ]
    parts = {
        "log_id": LOG_ID,
        "series": SERIES.hex(),
        "keys": [
            {
                "epoch": epoch,
                "secret": secret(epoch).private_bytes_raw().hex(),
                "public_key": public(epoch).hex(),
                "key_id": sha256(ORIGIN.encode() + b"\n\x01" + public(epoch)).digest()[:4].hex(),
                "certificate": certificate(epoch).hex(),
            }
            for epoch in range(FIRST + 1, LAST + 1)
        ],
        "covered": record(INDEX).hex(),
        "leaf": sha256(b"\x00" + record(INDEX)).hexdigest(),
        "root": tree([record(number) for number in range(SIZE)]).hex(),
        "note": note(SIZE, tree([record(number) for number in range(SIZE)])),
    }
    content = {"parts": parts, "cases": cases}
    return {
        **{f"{name}.pub": data for name, data in keys().items()},
        **{f"{name}.tlog-proof": data for name, data in proofs().items()},
        "cases.json": json.dumps(content, indent=1).encode() + b"\n",
    }


def main() -> None:
    for name, data in files().items():
        (HERE / name).write_bytes(data)


if __name__ == "__main__":
    main()
