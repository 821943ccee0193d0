"""Only the holder of the key signs."""

import hashlib
import hmac

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.conversation import Permit, Reset, SignedRecord, Start
from cutgate.protocol.permit import fingerprint, sign, verify
from cutgate.protocol.wire import layout
from tests.protocol.strategies import blocks, values

KEY = bytes(range(32))
keys = st.binary(min_size=32, max_size=32)
signed_records = st.one_of(blocks(Permit), blocks(Start), blocks(Reset))


@given(keys, signed_records)
def test_signed_record_verifies_with_its_key_alone(key: bytes, record: SignedRecord):
    signed = sign(key, record)
    assert verify(key, signed)
    assert not verify(bytes([key[0] ^ 1]) + key[1:], signed)
    assert signed.with_mac(record.code) == record


@pytest.mark.parametrize("kind", [Permit, Start, Reset])
@given(data=st.data())
def test_record_altered_in_any_one_field_is_refused(kind: type[SignedRecord], data: st.DataObject):
    record = data.draw(blocks(kind))
    assert isinstance(record, SignedRecord)
    signed = sign(KEY, record)
    name, codec = data.draw(st.sampled_from(layout(kind)))
    values_of = st.integers(-100, 100) if name.endswith("_turns") else values(codec)
    other = data.draw(values_of.filter(lambda value: value != getattr(signed, name)))
    assert not verify(KEY, kind(**(vars(signed) | {name: other})))


@pytest.mark.parametrize("length", [0, 16, 31, 33])
def test_key_of_another_length_is_refused(length: int):
    record = Reset(bytes(16), 0, bytes(32), cause_of())
    with pytest.raises(ValueError, match="must be 32"):
        sign(bytes(length), record)
    with pytest.raises(ValueError, match="must be 32"):
        verify(bytes(length), record)
    with pytest.raises(ValueError, match="must be 32"):
        fingerprint(bytes(length))


def cause_of():
    codec = dict(layout(Reset))["cause"]
    return codec.parse(b"\x09")


def test_a_fingerprint_is_the_same_for_ever_and_no_part_of_the_key_or_of_any_code():
    """Anyone can compute it: the first bytes of HMAC-SHA256 under the key over a text that is used for nothing else."""
    wanted = hmac.new(KEY, b"cutgate key fingerprint", hashlib.sha256).hexdigest()[:8]
    assert fingerprint(KEY) == wanted == "73edde87"


@given(keys)
def test_keys_that_differ_have_other_fingerprints(key: bytes):
    assert fingerprint(key) != fingerprint(bytes([key[0] ^ 1]) + key[1:])
