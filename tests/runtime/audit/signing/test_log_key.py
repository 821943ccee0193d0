"""Keys of epochs: what each certifies, and their files."""

import json
import struct
from dataclasses import FrozenInstanceError, replace
from hashlib import sha256

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from hypothesis import assume, example, given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing.log_key import (
    EPOCH_MAX,
    FILE_MAX,
    LogKey,
    PublicLogKey,
    chained,
    fingerprint_of,
)

SERIES = bytes(range(16))
ENROLLED = LogKey(SERIES, 1, b"\1" * 32)


def sessions(count, first=ENROLLED):
    keys = [first]
    for number in range(count - 1):
        keys.append(keys[-1].following(bytes((number + 2,)) * 32))
    return keys


KEYS = sessions(5)
PUBLIC = [key.public for key in KEYS]


def test_each_key_certifies_the_next_and_no_other():
    for one in PUBLIC:
        for other in PUBLIC:
            assert one.certifies(other) == (other.epoch == one.epoch + 1)


def test_a_certificate_is_a_signature_over_series_epoch_and_key():
    before, after = PUBLIC[1], PUBLIC[2]
    signed = b"cutgate/log-key/1" + SERIES + struct.pack("<I", 3) + after.public
    assert after.certified == signed
    Ed25519PublicKey.from_public_bytes(before.public).verify(after.certificate, signed)


@pytest.mark.parametrize(
    "changes",
    [
        {"series": bytes(16)},
        {"epoch": 3},
        {"epoch": 1},
        {"public": PUBLIC[3].public},
        {"certificate": PUBLIC[2].certificate},
        {"certificate": PUBLIC[1].certificate[:-1]},
        {"certificate": None},
    ],
)
def test_a_key_that_is_altered_in_anything_is_not_certified(changes):
    assert not PUBLIC[0].certifies(replace(PUBLIC[1], **changes))


@given(st.integers(0, 8 * 64 - 1))
def test_no_other_bit_of_a_certificate_counts(number):
    data = bytearray(PUBLIC[1].certificate)
    data[number // 8] ^= 1 << number % 8
    assert not PUBLIC[0].certifies(replace(PUBLIC[1], certificate=bytes(data)))


def test_a_key_of_another_series_certifies_nothing_here():
    assert not replace(PUBLIC[0], series=bytes(16)).certifies(PUBLIC[1])
    assert not replace(PUBLIC[0], epoch=2).certifies(PUBLIC[1])


def test_the_chain_from_a_pinned_key():
    assert chained(PUBLIC[0], PUBLIC[1:]) == PUBLIC[-1]
    assert chained(PUBLIC[2], PUBLIC[3:]) == PUBLIC[-1]
    assert chained(PUBLIC[2], []) == PUBLIC[2]
    assert chained(PUBLIC[0], PUBLIC[2:]) is None
    assert chained(PUBLIC[0], [PUBLIC[1], PUBLIC[3]]) is None
    assert chained(PUBLIC[1], PUBLIC[1:]) is None
    other = LogKey(SERIES, 2, b"\7" * 32).following(b"\3" * 32)
    assert chained(PUBLIC[0], [PUBLIC[1], other.public]) is None


def test_the_last_epoch_has_none_behind_it():
    last = LogKey(SERIES, EPOCH_MAX - 1, b"\1" * 32).following(b"\2" * 32)
    assert last.epoch == EPOCH_MAX
    with pytest.raises(ValueError, match=f"epoch {EPOCH_MAX} is the last one"):
        last.following(b"\3" * 32)


def test_the_fingerprint():
    digits = sha256(PUBLIC[0].public).hexdigest()[:16]
    assert (
        PUBLIC[0].fingerprint
        == fingerprint_of(PUBLIC[0].public)
        == f"{digits[:4]} {digits[4:8]} {digits[8:12]} {digits[12:]}"
    )


@given(
    st.builds(
        LogKey,
        st.binary(min_size=16, max_size=16),
        st.integers(1, EPOCH_MAX),
        st.binary(min_size=32, max_size=32),
        st.none() | st.binary(min_size=64, max_size=64),
    )
)
@example(LogKey(SERIES, EPOCH_MAX, b"\1" * 32))
def test_what_is_written_is_read(key):
    assert LogKey.parse(key.encode()) == key
    assert PublicLogKey.parse(key.public.encode()) == key.public
    assert max(len(key.encode()), len(key.public.encode())) <= FILE_MAX


def test_the_files_are_told_apart_and_the_public_one_holds_no_secret():
    for kind, other in ((LogKey, KEYS[1].public.encode()), (PublicLogKey, KEYS[1].encode())):
        with pytest.raises(ValueError, match="its schema is"):
            kind.parse(other)
    assert KEYS[1].secret.hex() not in KEYS[1].public.encode().decode()
    assert KEYS[1].secret.hex() not in repr(KEYS[1].public)


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"1", b"null", b"\xff\xfe", b"[" * 100_000, b"1" * 5000])
def test_what_is_no_file_of_a_key_is_refused(data):
    for kind in (LogKey, PublicLogKey):
        with pytest.raises(ValueError, match=r"it is not JSON|its schema is None"):
            kind.parse(data)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("series", value) for value in (None, 1, "", "00", "0" * 33, "G" * 32, "A" * 32, " " * 32)),
        *(("epoch", value) for value in (None, "1", 0, -1, True, 1.0, EPOCH_MAX + 1)),
        *(("certificate", value) for value in (1, "", "0" * 126, "0" * 127 + "g", [])),
    ],
)
def test_every_field_is_held_to_its_form(name, value):
    for key in (KEYS[1], KEYS[1].public):
        content = json.loads(key.encode()) | {name: value}
        with pytest.raises(ValueError, match=f"its {name} must be"):
            type(key).parse(json.dumps(content).encode())
        del content[name]
        if name != "certificate":
            with pytest.raises(ValueError, match=f"its {name} must be"):
                type(key).parse(json.dumps(content).encode())


@given(st.sampled_from([KEYS[0], KEYS[1], PUBLIC[0], PUBLIC[1]]), st.text(), st.none() | st.text())
def test_a_file_that_says_more_than_a_key_does_is_refused_with_what_it_says(key, name, value):
    content = json.loads(key.encode())
    assume(name not in content and name != "certificate")
    with pytest.raises(ValueError, match="is none that such a file has") as told:
        type(key).parse(json.dumps(content | {name: value}).encode())
    assert repr(name[:40]) in str(told.value)
    assert str(told.value).isprintable()
    assert type(key).parse(json.dumps(content).encode()) == key


@pytest.mark.parametrize(("key", "half"), [(KEYS[1], "public_key"), (KEYS[1].public, "secret")])
def test_the_other_half_of_a_key_is_none_of_its_own(key, half):
    with pytest.raises(ValueError, match=f"its key '{half}' is none that such a file has"):
        type(key).parse(json.dumps(json.loads(key.encode()) | {half: "00" * 32}).encode())


@pytest.mark.parametrize("key", [KEYS[1], KEYS[1].public])
def test_a_key_of_the_json_that_is_given_twice_is_refused(key):
    """Of two that differ one program reads the first, another one the last."""
    for name, value in json.loads(key.encode()).items():
        for other in (value, None):
            data = key.encode().replace(b"{", f"{{{json.dumps(name)}: {json.dumps(other)}, ".encode(), 1)
            with pytest.raises(ValueError, match=f"its key '{name}' is given twice"):
                type(key).parse(data)


@pytest.mark.parametrize(("key", "name"), [(KEYS[0], "secret"), (KEYS[0].public, "public_key")])
def test_a_key_that_is_too_short_is_refused(key, name):
    content = json.loads(key.encode())
    with pytest.raises(ValueError, match=f"its {name} must be 64 hexadecimal digits"):
        type(key).parse(json.dumps(content | {name: content[name][:-2]}).encode())


def test_the_bounds_are_those_of_the_form():
    assert (EPOCH_MAX, FILE_MAX) == (2**32 - 1, 1024)


@pytest.mark.parametrize("key", [KEYS[1], KEYS[1].public])
def test_a_key_does_not_change(key):
    with pytest.raises(FrozenInstanceError):
        key.epoch = 9
    assert hash(key) == hash(replace(key))


def test_a_public_key_holds_nothing_else():
    assert not hasattr(PUBLIC[0], "__dict__")
