"""Records of the conversation: sessions, branches, what is signed."""

import hashlib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import conversation
from cutgate.protocol.conversation import (
    AGE_UNKNOWN,
    NO_MAC,
    NO_PLACE,
    NO_TIME,
    NO_TREE_HEAD,
    PROTOCOL_VERSION,
    Acknowledge,
    Announce,
    Approach,
    BlockStored,
    Branch,
    Collect,
    Nonce,
    NonceRequest,
    Open,
    Opened,
    OtherVersion,
    PathStored,
    Permit,
    Reply,
    Reset,
    SignedRecord,
    Start,
    Timing,
    Withdraw,
    opens,
    session_digest,
    session_tag,
)
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from cutgate.protocol.wire import Integer, RecordError, digest, layout
from tests.protocol.strategies import blocks, values

OUTSIDE, INSIDE = "outside a session", "inside"


@pytest.mark.parametrize(
    ("kind", "number", "where"),
    [
        (OtherVersion, 0x00, {INSIDE}),
        (Announce, 0x01, {OUTSIDE}),
        (Open, 0x02, {OUTSIDE}),
        (Opened, 0x03, {INSIDE}),
        (Collect, 0x04, {INSIDE}),
        (NonceRequest, 0x05, {INSIDE}),
        (Nonce, 0x06, {INSIDE}),
        (Permit, 0x07, {INSIDE}),
        (Start, 0x08, {INSIDE}),
        (Reset, 0x09, {INSIDE}),
        (Acknowledge, 0x0A, {INSIDE}),
        (Withdraw, 0x0B, {INSIDE}),
        (Reply, 0x0C, {OUTSIDE, INSIDE}),
        (BlockStored, 0x21, {INSIDE}),
        (PathStored, 0x22, {INSIDE}),
    ],
)
def test_every_record_keeps_its_number_and_says_whether_it_needs_a_session(kind, number, where):
    told = {name for name, may in ((OUTSIDE, kind.OUTSIDE_SESSION), (INSIDE, kind.INSIDE_SESSION)) if may}
    assert (kind.TYPE, told) == (number, where)


def test_what_stands_for_nothing_is_all_zeros_and_an_unknown_age_all_ones():
    assert PROTOCOL_VERSION == 4
    assert NO_TREE_HEAD.body() == bytes(16 + 8 + 32)
    assert (bytes(16), bytes(32), 0) == (NO_MAC, NO_PLACE, NO_TIME)
    assert Integer(4).pack(AGE_UNKNOWN) == b"\xff" * 4


def test_a_session_that_is_opened_over_nothing_remembered_says_so():
    opened = Opened(3, ControllerState.OPEN, StopCause.NONE)
    told = (opened.log, opened.withdrawal_due, opened.motion_age_s, opened.registration, opened.barrier_us)
    assert told == (NO_TREE_HEAD, 0, AGE_UNKNOWN, Refusal.ACCEPTED, NO_TIME)


@given(blocks(Open), st.data())
def test_a_session_is_named_by_all_that_its_open_says_but_the_code(request: Open, data: st.DataObject):
    named = session_digest(request)
    assert named == hashlib.sha256(b"cutgate/session/2" + request.body()[:-16]).digest()
    assert session_tag(named) == int.from_bytes(named[:4], "little")
    assert session_digest(request.with_mac(b"m" * 16)) == named
    name, codec = data.draw(st.sampled_from(layout(Open)[:-1]))
    other = data.draw(values(codec).filter(lambda value: value != getattr(request, name)))
    assert session_digest(replace(request, **{name: other})) != named


@given(blocks(Open))
def test_an_open_whose_tag_is_zero_opens_nothing(request: Open):
    assert opens(request)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(conversation, "digest", lambda _data: bytes(4) + b"\x01" * 28)
        assert not opens(request)


@given(blocks(Announce), st.data())
def test_open_names_whatever_an_announcement_says_that_lasts(announce: Announce, data: st.DataObject):
    """Else a node in between could tell of another controller, or of a plant that runs at another speed."""
    lasting = {"protocol_version", "firmware_version", "serial", "plant_speed_permille"}
    name, codec = data.draw(st.sampled_from(layout(Announce)))
    drawn = st.integers(1, 1_000_000) if name == "plant_speed_permille" else values(codec)
    other = data.draw(drawn.filter(lambda value: value != getattr(announce, name)))
    changed = replace(announce, **{name: other}).identity_digest != announce.identity_digest
    assert changed is (name in lasting)


@pytest.mark.parametrize("turns", [(101, 0), (0, -101)])
def test_turns_no_joint_has_are_refused(turns: tuple[int, int]):
    with pytest.raises(RecordError, match="must be within"):
        Branch("right", *turns)


def _announce(permille: int) -> Announce:
    return Announce(
        PROTOCOL_VERSION, "firmware", "CG-1", bytes(16), permille, ControllerState.INHIBITED, StopCause.NONE
    )


@pytest.mark.parametrize(("permille", "scale"), [(1, 0.001), (1000, 1.0), (1_000_000, 1000.0)])
def test_an_announcement_says_how_fast_its_plant_runs(permille: int, scale: float):
    assert _announce(permille).time_scale == scale


@pytest.mark.parametrize("permille", [0, 1_000_001, 2**32 - 1])
def test_a_plant_that_stands_still_or_runs_faster_than_any_simulation_is_refused(permille: int):
    with pytest.raises(RecordError, match=rf"plant_speed_permille is {permille}, must be in 1..1000000"):
        _announce(permille)


@pytest.mark.parametrize("percent", [0, 101])
def test_an_approach_faster_than_the_limits_or_not_at_all_is_refused(percent: int):
    with pytest.raises(RecordError, match="speed_percent"):
        Approach(1, 1, (0, 0, 0, 0, 0), (0, 0, 0, 0, 0), percent)


def test_timing_is_read_in_seconds_mm_and_degrees():
    timing = Timing(20, 100, 120, 2500, 500, 200, 12_000, 25)
    assert (timing.heartbeat_s, timing.timeout_s, timing.start_lifetime_s) == (0.02, 0.1, 2.5)
    assert (timing.start_tolerance_mm, timing.start_tolerance_deg) == (0.5, 0.2)
    assert timing.approach_clearance_mm == 12.0


SIGNED = [Open, Opened, Permit, Start, Reset, Acknowledge, Withdraw]


@pytest.mark.parametrize("kind", SIGNED)
@given(data=st.data())
def test_everything_but_the_code_is_signed(kind: type[SignedRecord], data: st.DataObject):
    record = data.draw(blocks(kind))
    assert isinstance(record, SignedRecord)
    body = record.with_mac(NO_MAC).body()[:-16]
    assert record.canonical() == kind.DOMAIN + b"\0" + body
    assert record.canonical(b"s" * 32, 258) == kind.DOMAIN + b"\0" + b"s" * 32 + b"\x02\x01\0\0" + body
    assert record.with_mac(b"m" * 16).code == b"m" * 16
    assert record.with_mac(b"m" * 16).canonical() == record.canonical()


def test_domains_differ():
    assert len({kind.DOMAIN for kind in SIGNED}) == len(SIGNED)


@given(blocks(Permit))
def test_permit_digest_covers_all_that_is_signed_and_not_the_code(permit):
    other = replace(permit, mac=bytes([permit.mac[0] ^ 1]) + permit.mac[1:])
    assert other.digest == permit.digest == digest(permit.canonical())
    assert replace(permit, lifetime_s=permit.lifetime_s ^ 1).digest != permit.digest
