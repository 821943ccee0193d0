"""What the controller's refusals mean: a sentence for each, with what to do."""

from cutgate.protocol.states import Refusal
from cutgate.runtime.interlock.refusals import MEANING, told


def test_every_refusal_says_what_it_means_after_its_code():
    assert set(MEANING) == set(Refusal)
    for refusal in Refusal:
        assert told(refusal) == f"{refusal.name}: {MEANING[refusal]}"
        assert len(MEANING[refusal].split()) >= 5


def test_what_is_still_pressed_or_released_is_named_with_what_to_do():
    assert told(Refusal.EMERGENCY_STOP).endswith("still pressed: release it, then try again")
    assert "release the enabling device, then hold it" in told(Refusal.DEVICE_NOT_RELEASED_AND_PRESSED)


def test_a_wrong_key_is_called_so_and_the_keys_are_to_be_compared():
    assert "the two key files differ" in told(Refusal.MAC_INVALID)
    assert "`cutgate key fingerprint FILE`" in told(Refusal.MAC_INVALID)


def test_what_is_to_be_done_about_a_registration_is_told_apart_from_what_a_new_session_cures():
    for refusal in (Refusal.REGISTRATION_WITHDRAWN, Refusal.REGISTRATION_TOO_EARLY):
        assert told(refusal).endswith("register the bone anew")
    for refusal in (Refusal.WITHDRAWAL_DUE, Refusal.ANNOUNCE_NONCE, Refusal.LOG_NOT_CONTINUED):
        assert "start a new session" in told(refusal)
    assert "leave one controller on the bus" in told(Refusal.IDENTITY_DIGEST)
