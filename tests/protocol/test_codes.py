"""Only a holder of the key makes codes, and each means one thing in one session."""

import hashlib
import hmac
import struct

import pytest
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.codes import (
    COUNTER_MAX,
    KEY_NAMES,
    NO_ECHO,
    CodeKeys,
    PresharedKey,
    SessionCodes,
    fingerprint,
)
from cutgate.protocol.conversation import (
    Acknowledge,
    Open,
    Opened,
    Permit,
    Reset,
    SignedRecord,
    Start,
    Withdraw,
)
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.protocol.wire import Side, layout
from tests.protocol.sessions import CODES, DIGEST, KEY, OPEN, OTHER_DIGEST
from tests.protocol.strategies import blocks, values

IN_SESSION = [Opened, Permit, Start, Reset, Acknowledge, Withdraw]
keys = st.binary(min_size=32, max_size=32)
digests = st.binary(min_size=32, max_size=32)
sequences = st.integers(0, 2**32 - 1)
counters = st.integers(0, COUNTER_MAX)


def derived(key: bytes, salt: bytes, info: bytes) -> bytes:
    """HKDF of RFC 5869 from HMAC alone, 16 bytes."""
    return hmac.digest(hmac.digest(salt, key, hashlib.sha256), info + b"\x01", hashlib.sha256)[:16]


def cmac(key: bytes, data: bytes) -> bytes:
    """RFC 4493 over a key that is made for this call alone."""
    code = CMAC(AES(key))
    code.update(data)
    return code.finalize()


def altered(key: bytes) -> bytes:
    return bytes([key[0] ^ 1]) + key[1:]


@pytest.mark.parametrize("kind", IN_SESSION)
@given(key=keys, named=digests, sequence=sequences, data=st.data())
def test_a_record_is_authentic_with_its_key_session_and_sequence_alone(kind, key, named, sequence, data):
    record = data.draw(blocks(kind))
    ours = PresharedKey(key).session(named)
    signed = ours.sign(record, sequence)
    assert PresharedKey(key).session(named).authentic(signed, sequence)
    assert not ours.authentic(signed, sequence ^ 1)
    assert not PresharedKey(altered(key)).session(named).authentic(signed, sequence)
    assert not PresharedKey(key).session(altered(named)).authentic(signed, sequence)
    assert signed.with_mac(record.code) == record


@given(keys, blocks(Open))
def test_an_open_is_authentic_with_its_key_alone(key: bytes, record: Open):
    signed = PresharedKey(key).sign_open(record)
    assert PresharedKey(key).open_authentic(signed)
    assert not PresharedKey(altered(key)).open_authentic(signed)
    assert signed.with_mac(record.code) == record


@pytest.mark.parametrize("kind", [Open, *IN_SESSION])
@given(data=st.data())
def test_record_altered_in_any_one_field_is_refused(kind: type[SignedRecord], data: st.DataObject):
    record = data.draw(blocks(kind))
    key = PresharedKey(KEY)
    signed = key.sign_open(record) if isinstance(record, Open) else CODES.sign(record, 7)
    name, codec = data.draw(st.sampled_from(layout(kind)))
    values_of = st.integers(-100, 100) if name.endswith("_turns") else values(codec)
    other = data.draw(values_of.filter(lambda value: value != getattr(signed, name)))
    changed = kind(**(vars(signed) | {name: other}))
    assert not (key.open_authentic(changed) if isinstance(changed, Open) else CODES.authentic(changed, 7))


@pytest.mark.parametrize(
    ("side", "direction", "record"),
    [
        (Side.RUNTIME, b"runtime to controller", Acknowledge(3, StopCause.OPERATOR_STOP)),
        (Side.CONTROLLER, b"controller to runtime", None),
    ],
)
def test_every_code_is_made_with_the_key_of_its_direction_and_purpose(side, direction, record):
    """The keys from HMAC alone, the codes from a CMAC that was never prepared: the layout moved itself."""
    if record is not None:
        covered = record.DOMAIN + b"\0" + DIGEST + struct.pack("<I", 258) + record.body()[:-16]
        wanted = cmac(derived(KEY, DIGEST, direction + b": record"), covered)
        assert CODES.sign(record, 258).code == wanted
    counted = struct.pack("<II", 70_000, 65_537) + b"\x05\x0a"
    wanted = cmac(derived(KEY, DIGEST, direction + b": heartbeat"), counted)
    assert CODES.heartbeat_tag(side, 70_000, 65_537, b"\x05\x0a") == wanted[0] | wanted[1] << 8


def test_the_code_of_opened_is_the_controllers():

    record = Opened(3, ControllerState.OPEN, StopCause.NONE)
    covered = b"cutgate/opened/1\0" + DIGEST + struct.pack("<I", 1) + record.body()[:-16]
    assert CODES.sign(record, 1).code == cmac(derived(KEY, DIGEST, b"controller to runtime: record"), covered)


@given(st.lists(st.integers(-(2**19), 2**19 - 1), min_size=5, max_size=5), counters)
def test_a_sample_tag_is_the_first_20_bits_over_counter_and_joints(joints: list[int], counter: int):
    covered = b"".join(value.to_bytes(4, "little", signed=value < 0) for value in (counter, *joints))
    wanted = cmac(derived(KEY, DIGEST, b"controller to runtime: sample"), covered)
    assert CODES.sample_tag(counter, joints) == int.from_bytes(wanted, "little") % (1 << 20)


def test_open_is_signed_with_a_key_of_its_own():
    record = OPEN
    wanted = cmac(derived(KEY, bytes(32), b"cutgate/open/1"), b"cutgate/open/1\0" + record.body()[:-16])
    assert PresharedKey(KEY).sign_open(record).code == wanted


@given(counters, counters, st.binary(min_size=2, max_size=2), st.sampled_from(Side))
def test_what_is_covered_differently_has_another_code(counter: int, echo: int, covered: bytes, side: Side):
    """Not for all, there are but 65 536 tags: over many draws hardly any two are equal."""
    tag = CODES.heartbeat_tag(side, counter, echo, covered)
    others = [
        CODES.heartbeat_tag(side, counter ^ 256, echo, covered),
        CODES.heartbeat_tag(side, counter, echo ^ 256, covered),
        CODES.heartbeat_tag(side, counter, echo, altered(covered)),
        CODES.heartbeat_tag(side.peer, counter, echo, covered),
        PresharedKey(KEY).session(OTHER_DIGEST).heartbeat_tag(side, counter, echo, covered),
    ]
    assert others.count(tag) <= 1
    assert 0 <= tag < 1 << 16


def test_a_session_has_its_tag_from_its_digest():
    assert (CODES.digest, CODES.tag) == (DIGEST, int.from_bytes(DIGEST[:4], "little"))


def test_no_echo_is_no_counter():
    assert NO_ECHO == 0xFFFF_FFFF == COUNTER_MAX + 1


@pytest.mark.parametrize("length", [0, 16, 31, 33])
def test_key_of_another_length_is_refused(length: int):
    for made in (PresharedKey, fingerprint):
        with pytest.raises(ValueError, match=f"key is {length} bytes, must be 32"):
            made(bytes(length))


def test_a_fingerprint_is_the_same_for_ever_and_no_part_of_the_key_or_of_any_code():
    """Anyone can compute it: the first bytes of HMAC-SHA256 under the key over a text that is used for nothing else."""
    wanted = hmac.new(KEY, b"cutgate key fingerprint", hashlib.sha256).hexdigest()[:8]
    assert fingerprint(KEY) == PresharedKey(KEY).fingerprint == wanted == "73edde87"


@given(keys)
def test_keys_that_differ_have_other_fingerprints(key: bytes):
    assert fingerprint(key) != fingerprint(altered(key))


def test_the_codes_of_a_session_are_those_of_its_key():
    assert isinstance(PresharedKey(KEY).session(DIGEST), SessionCodes)


# ---------------------------------------------------------------- the keys of one session


def test_the_keys_of_a_session_have_the_names_of_what_they_are_derived_for():
    keys = PresharedKey(KEY).code_keys(DIGEST)
    assert keys.keys == {name: derived(KEY, DIGEST, name.encode()) for name in KEY_NAMES}
    assert set(KEY_NAMES) == {
        "runtime to controller: record", "controller to runtime: record", "runtime to controller: heartbeat",
        "controller to runtime: heartbeat", "controller to runtime: sample",
    }  # fmt: skip
    assert not any(key.hex() in repr(keys) or repr(key) in repr(keys) for key in keys.keys.values())


def test_the_keys_of_a_session_alone_make_its_codes():
    alone = SessionCodes(CodeKeys(DIGEST, PresharedKey(KEY).code_keys(DIGEST).keys))
    record = Acknowledge(3, StopCause.OPERATOR_STOP)
    assert alone.sign(record, 7) == CODES.sign(record, 7)
    assert (alone.digest, alone.tag) == (CODES.digest, CODES.tag)
    for side in Side:
        assert alone.heartbeat_tag(side, 5, 6, b"ab") == CODES.heartbeat_tag(side, 5, 6, b"ab")
    assert alone.sample_tag(5, (1, 2, 3, 4, 5)) == CODES.sample_tag(5, (1, 2, 3, 4, 5))


@pytest.mark.parametrize("name", KEY_NAMES)
@pytest.mark.parametrize("length", [None, 0, 15, 17])
def test_keys_of_a_session_that_are_not_all_there_are_refused(name, length):
    keys = dict(PresharedKey(KEY).code_keys(DIGEST).keys)
    key = keys.pop(name)
    with pytest.raises(ValueError, match="keys must be 16 bytes each") as refused:
        CodeKeys(DIGEST, keys if length is None else keys | {name: (key + key)[:length]})
    assert key.hex() not in str(refused.value)
    with pytest.raises(ValueError, match="keys must be"):
        CodeKeys(DIGEST, keys | {name: key, "another": key})
