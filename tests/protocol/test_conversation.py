"""Records of the conversation: sessions, branches, what is signed."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import conversation
from cutgate.protocol.conversation import (
    NO_MAC,
    Announce,
    Approach,
    Branch,
    Permit,
    Reset,
    SignedRecord,
    Start,
    nonce_serves,
    session_digest,
    session_tag,
)
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.protocol.wire import RecordError, digest
from tests.protocol.strategies import blocks


@given(st.binary(min_size=16, max_size=16), st.binary(min_size=16, max_size=16))
def test_session_tag_depends_on_both_nonces(boot: bytes, runtime: bytes):
    assert session_tag(boot, runtime) == int.from_bytes(session_digest(boot, runtime)[:4], "little")
    assert session_digest(boot, runtime) != session_digest(boot, bytes([runtime[0] ^ 1]) + runtime[1:])
    assert session_digest(boot, runtime) != session_digest(bytes([boot[0] ^ 1]) + boot[1:], runtime)


@pytest.mark.parametrize("lengths", [(15, 16), (16, 17), (32, 0)])
def test_nonces_of_another_length_are_refused(lengths: tuple[int, int]):
    with pytest.raises(RecordError, match="must be 16"):
        session_digest(bytes(lengths[0]), bytes(lengths[1]))


def test_nonce_that_gives_tag_zero_does_not_serve(monkeypatch: pytest.MonkeyPatch):
    assert nonce_serves(bytes(16), bytes(16))
    monkeypatch.setattr(conversation, "digest", lambda _data: bytes(4) + b"\x01" * 28)
    assert not nonce_serves(bytes(16), bytes(16))


@pytest.mark.parametrize("turns", [(101, 0), (0, -101)])
def test_turns_no_joint_has_are_refused(turns: tuple[int, int]):
    with pytest.raises(RecordError, match="must be within"):
        Branch("right", *turns)


def _announce(permille: int) -> Announce:
    return Announce(3, "firmware", "CG-1", bytes(16), permille, ControllerState.INHIBITED, StopCause.NONE)


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


@pytest.mark.parametrize("kind", [Permit, Start, Reset])
@given(data=st.data())
def test_everything_but_the_code_is_signed(kind: type[SignedRecord], data: st.DataObject):
    record = data.draw(blocks(kind))
    assert isinstance(record, SignedRecord)
    assert record.canonical() == kind.DOMAIN + b"\0" + record.with_mac(NO_MAC).body()[:-16]
    assert record.with_mac(b"m" * 16).code == b"m" * 16
    assert record.with_mac(b"m" * 16).canonical() == record.canonical()


def test_domains_differ():
    assert len({kind.DOMAIN for kind in (Permit, Start, Reset)}) == 3


@given(blocks(Permit))
def test_permit_digest_covers_all_that_is_signed_and_not_the_code(permit):
    other = replace(permit, mac=bytes([permit.mac[0] ^ 1]) + permit.mac[1:])
    assert other.digest == permit.digest == digest(permit.canonical())
    assert replace(permit, lifetime_s=permit.lifetime_s ^ 1).digest != permit.digest
