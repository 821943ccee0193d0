"""Whose key a log is signed with, and what a reviewer has from elsewhere."""

from dataclasses import FrozenInstanceError, replace

import pytest

from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.note import SignatureType, VerifierKey
from cutgate.runtime.audit.signing.signer import Signer
from cutgate.runtime.audit.trust import (
    KEY_CHAIN,
    NOBODY,
    NOT_FOUND,
    STEPS,
    WITNESS,
    Trust,
    TrustAnswer,
    TrustStep,
    key_chain,
    witnessed,
)


def chain(count, series=bytes(16)):
    keys = [LogKey(series, 1, bytes(32))]
    for number in range(1, count):
        keys.append(keys[-1].following(bytes([number]) * 32))
    return [key.public for key in keys]


KEYS = chain(6)
BY_EPOCH = {key.epoch: key for key in KEYS}


def answered(key, trust):
    step = key_chain(key, trust)
    assert step.name == KEY_CHAIN
    return step.answer, step.text


def test_without_a_pinned_key_nothing_is_said_of_the_logs_own():
    for key in (None, KEYS[0]):
        answer, text = answered(key, NOBODY)
        assert answer is TrustAnswer.NOT_CHECKED
        assert "--public-key" in text


@pytest.mark.parametrize("pinned", range(6))
@pytest.mark.parametrize("own", range(6))
def test_a_pinned_key_vouches_for_itself_and_those_behind_it(pinned, own):
    answer, text = answered(KEYS[own], Trust(KEYS[pinned], BY_EPOCH))
    assert (answer is TrustAnswer.YES) == (own >= pinned)
    if own < pinned:
        assert "a key certifies later ones only; pin an earlier one" in text


@pytest.mark.parametrize("missing", [2, 3, 4])
def test_a_certificate_that_is_missing_or_anothers_breaks_the_chain(missing):
    rest = {epoch: key for epoch, key in BY_EPOCH.items() if epoch != missing}
    answer, text = answered(KEYS[4], Trust(KEYS[0], rest))
    assert (answer, f"the certificate of epoch {missing} is missing (1 in all)" in text) == (
        TrustAnswer.NO,
        True,
    )
    forged = rest | {missing: replace(BY_EPOCH[missing], certificate=bytes(64))}
    answer, text = answered(KEYS[4], Trust(KEYS[0], forged))
    assert (answer, "of another key" in text) == (TrustAnswer.NO, True)
    enrolled = rest | {missing: replace(BY_EPOCH[missing], certificate=None)}
    assert answered(KEYS[4], Trust(KEYS[0], enrolled))[0] is TrustAnswer.NO


def test_no_certificates_beside_it_are_none():
    assert answered(KEYS[1], Trust(KEYS[0]))[0] is TrustAnswer.YES
    assert answered(KEYS[2], Trust(KEYS[0]))[0] is TrustAnswer.NO


def test_another_key_of_the_same_epoch_or_another_series_is_told():
    other = chain(2, bytes([1]) * 16)
    assert "of the series" in answered(other[0], Trust(KEYS[0]))[1]
    same = replace(KEYS[1], public=KEYS[3].public)
    assert "another key of the same epoch" in answered(same, Trust(KEYS[1]))[1]


def test_a_log_that_is_not_signed_is_not_the_pinned_keys():
    answer, text = answered(None, Trust(KEYS[0]))
    assert answer is TrustAnswer.NO
    assert "record 0 is the first without" in text


def test_anchors_and_cosignatures_are_all_of_this_log():
    key = LogKey(bytes(16), 1, bytes(32))
    checkpoint = Signer(key, "ab" * 16).checkpoint(7, bytes(32))
    stranger = VerifierKey("witness", bytes(32), SignatureType.COSIGNATURE)
    own = VerifierKey(f"cutgate/{'ab' * 16}", key.public.public)
    assert witnessed(NOBODY, {}, checkpoint).answer is TrustAnswer.NOT_CHECKED
    step = witnessed(Trust(anchors=(b"a" * 32,), cosigners=(own,)), {b"a" * 32: 5}, checkpoint)
    assert step == TrustStep(
        WITNESS, TrustAnswer.YES, f"anchor {'61' * 32} at record 5, cosigned by {own.name}"
    )
    assert witnessed(Trust(anchors=(b"b" * 32,)), {b"a" * 32: 5}, checkpoint).answer is TrustAnswer.NO
    assert witnessed(Trust(cosigners=(own, stranger)), {}, checkpoint).answer is TrustAnswer.NO
    assert witnessed(Trust(cosigners=(own,)), {}, None).answer is TrustAnswer.NO
    assert note.verify(checkpoint, own)


def test_what_a_reviewer_trusts_may_not_change():
    for made, name in ((NOBODY, "pinned"), (TrustStep("tree", TrustAnswer.YES, ""), "answer")):
        assert not hasattr(made, "__dict__")
        with pytest.raises(FrozenInstanceError):
            setattr(made, name, None)


def test_a_step_is_said_in_one_line():
    assert str(TrustStep("tree", TrustAnswer.YES, "root 00")) == "tree: yes, root 00"
    assert str(TrustStep("tree", TrustAnswer.NO, "")) == "tree: no"
    assert STEPS == ("structure", "chain", "tree", "signatures", "key chain", "witness", "replay")
    assert NOT_FOUND.count("\n- ") == 4


# ---------------------------------------------------------------- two keys of one epoch


@pytest.mark.parametrize("twice", range(1, 7))
def test_of_two_keys_of_one_epoch_between_none_is_believed_and_both_logs_are_named(twice):
    certified = {epoch: key for epoch, key in BY_EPOCH.items() if epoch != twice}
    trust = Trust(pinned=KEYS[1], certified=certified, doubled={twice: "a.mcap and b.mcap"})
    answer, text = answered(KEYS[4], trust)
    between = KEYS[1].epoch < twice < KEYS[4].epoch
    assert answer is (TrustAnswer.NO if between else TrustAnswer.YES)
    assert (f"epoch {twice} has two keys, of the logs a.mcap and b.mcap" in text) == between


def test_the_first_of_several_epochs_with_two_keys_is_named():
    trust = Trust(pinned=KEYS[0], certified={}, doubled={4: "c and d", 3: "a and b"})
    assert "epoch 3 has two keys, of the logs a and b: see" in answered(KEYS[5], trust)[1]


def test_a_key_of_another_series_is_that_whatever_is_doubled():
    other = chain(5, bytes(15) + b"x")[4]
    assert "it is of the series" in answered(other, Trust(pinned=KEYS[0], doubled={3: "a and b"}))[1]
