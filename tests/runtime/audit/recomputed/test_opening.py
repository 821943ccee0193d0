"""OPEN and OPENED as a log holds them are read strictly, and give the session's keys to who holds the pre-shared one."""

import json

import pytest

from cutgate.config.load import InputError
from cutgate.protocol import records as wire
from cutgate.protocol.codes import PresharedKey, fingerprint
from cutgate.protocol.conversation import session_digest
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit.recomputed.opening import Opening, judge_opening, session_keys
from cutgate.runtime.audit.records import AuditSession
from tests.protocol.sessions import KEY, OPEN

OTHER_KEY = KEY[::-1]
PRESHARED = PresharedKey(KEY)
DIGEST = session_digest(OPEN)
CODES = PRESHARED.session(DIGEST)
OPENED = CODES.sign(wire.Opened(3, ControllerState.OPEN, StopCause.NONE), 7)
LOG_ID = "ab" * 16
BAD = "its code is none that a holder of the key made"


def opening(request=None, answer=OPENED, tag=CODES.tag, **changes):
    request = PRESHARED.sign_open(OPEN) if request is None else request
    values = {
        "session": DIGEST.hex(),
        "open": wire.pack(request, 0, 1).hex(),
        "opened": wire.pack(answer, tag, 7).hex(),
        "key_fingerprint": fingerprint(KEY),
    }
    return Opening.parse(AuditSession(**values | changes).encode())


def test_a_session_is_judged_by_the_key_that_it_was_opened_with():
    judged = judge_opening(opening(), KEY)
    assert (judged.opens, judged.answers, judged.wrong) == (True, True, ())
    assert judged.codes.digest == DIGEST


def test_its_keys_judge_it_as_well_and_are_made_with_that_key_alone():
    keys = session_keys(LOG_ID, opening(), KEY)
    assert (keys.log_id, keys.open_code, keys.codes.digest) == (LOG_ID, opening().request.code, DIGEST)
    assert judge_opening(opening(), keys)[1:] == (True, True, ())
    assert session_keys(LOG_ID, opening(), OTHER_KEY) is None
    assert session_keys(LOG_ID, opening(OPEN.with_mac(bytes(16))), KEY) is None


@pytest.mark.parametrize("keys", [False, True], ids=["pre-shared key", "session keys"])
@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"request": OPEN.with_mac(bytes(16))}, f"OPEN: {BAD}"),
        ({"answer": OPENED.with_mac(bytes(16))}, f"OPENED: {BAD}"),
        ({"answer": CODES.sign(OPENED, 8)}, f"OPENED: {BAD}"),
        ({"tag": CODES.tag ^ 1}, f"OPENED: {BAD}"),
        ({"session": bytes(32).hex()}, "it names another session than its OPEN opens"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_named(keys, changes, wrong):
    judged = judge_opening(opening(**changes), session_keys(LOG_ID, opening(), KEY) if keys else KEY)
    assert judged.wrong == (f"/audit/session: {wrong}",)
    assert judged.codes is not None


def test_another_key_is_refused_by_its_fingerprint_unless_something_fits():
    with pytest.raises(
        InputError, match=f"fingerprint is {fingerprint(OTHER_KEY)}, must be {fingerprint(KEY)}"
    ):
        judge_opening(opening(), OTHER_KEY)
    judged = judge_opening(opening(key_fingerprint="0" * 8), KEY)
    assert judged.wrong == ("/audit/session: it names another key by its fingerprint",)


def test_where_nothing_fits_the_keys_are_not_known():
    judged = judge_opening(opening(key_fingerprint=None), OTHER_KEY)
    assert (judged.codes, judged.wrong) == (
        None,
        (f"/audit/session: OPEN: {BAD}", f"/audit/session: OPENED: {BAD}"),
    )


@pytest.mark.parametrize("key", ["session", "open", "opened", "key_fingerprint"])
@pytest.mark.parametrize("value", ["zz", "0", "00", "ab" * 40, None, 7, ["ab"]])
def test_what_cannot_be_read_is_refused(key, value):
    values = json.loads(
        AuditSession(
            session=DIGEST.hex(),
            open=wire.pack(PRESHARED.sign_open(OPEN), 0, 1).hex(),
            opened=wire.pack(OPENED, CODES.tag, 7).hex(),
        ).encode()
    )
    if (key, value) in (("session", "ab" * 40), ("session", "00"), ("key_fingerprint", None)):
        return  # another session than that of its OPEN; a fingerprint that is not named
    with pytest.raises(ValueError):
        Opening.parse(json.dumps(values | {key: value}).encode())


@pytest.mark.parametrize(
    ("record", "tag"),
    [(wire.Collect(), 7), (wire.Acknowledge(0, StopCause.OPERATOR_STOP), 7)],
)
def test_other_records_are_refused(record, tag):
    with pytest.raises(ValueError, match="it holds other records than OPEN and OPENED"):
        opening(open=wire.pack(record, tag, 1).hex())


def test_each_record_is_the_right_sides():
    with pytest.raises(ValueError, match="never sent by"):
        opening(open=wire.pack(OPENED, CODES.tag, 7).hex())
