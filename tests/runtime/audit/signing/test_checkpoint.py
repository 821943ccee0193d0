"""Checkpoints: three lines in one form, and of the origin that was asked for."""

from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing.checkpoint import HASH_BYTES, Checkpoint, origin_of
from cutgate.runtime.audit.signing.note import NoteError

SOFA = "example.com/behind-the-sofa"
EXAMPLE = f"{SOFA}\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n"
"""The text of the example of https://c2sp.org/tlog-checkpoint."""
ORIGINS = st.text(st.characters(codec="utf-8", exclude_characters="\n"), min_size=1, max_size=20)
SIZES = st.integers(0, 10**19 - 1)
HASHES = st.binary(min_size=32, max_size=32)


def test_the_published_example():
    named = Checkpoint.parse(EXAMPLE, SOFA)
    assert (named.origin, named.size, named.hash.hex()[:8]) == (SOFA, 20852163, "0ac5186a")
    assert named.text == EXAMPLE


def test_the_origin_of_a_log():
    assert origin_of("0123") == "cutgate/0123"


@given(ORIGINS, SIZES, HASHES)
def test_what_is_written_is_read(origin, size, digest):
    named = Checkpoint(origin, size, digest)
    assert Checkpoint.parse(named.text, origin) == named


@given(st.builds(Checkpoint, ORIGINS, SIZES, HASHES), st.builds(Checkpoint, ORIGINS, SIZES, HASHES))
def test_two_checkpoints_have_two_texts(one, other):
    assert (one.text == other.text) == (one == other)


@pytest.mark.parametrize(
    "text",
    [
        "",
        EXAMPLE[:-1],
        EXAMPLE + "\n",
        EXAMPLE + "extension\n",
        EXAMPLE.replace(SOFA, ""),
        EXAMPLE.replace("20852163", ""),
        EXAMPLE.replace("20852163", "020852163"),
        EXAMPLE.replace("20852163", "-1"),
        EXAMPLE.replace("20852163", "+1"),
        EXAMPLE.replace("20852163", "1.0"),
        EXAMPLE.replace("20852163", "٣"),
        EXAMPLE.replace("20852163", "1" + 19 * "0"),
        EXAMPLE.replace("CsUY", "CsU"),
        EXAMPLE.replace("q2I=", "q2IA"),
        EXAMPLE.replace("CsUY", "Cs-Y"),
        EXAMPLE.replace("\n", "\r\n"),
    ],
)
def test_what_is_no_checkpoint_is_refused(text):
    with pytest.raises(NoteError, match="a checkpoint is three lines"):
        Checkpoint.parse(text, SOFA)


def test_a_hash_has_one_form():
    with pytest.raises(NoteError, match="not in its one form"):
        Checkpoint.parse(EXAMPLE.replace("q2I=", "q2J="), SOFA)


@pytest.mark.parametrize("origin", ["", "example.com", f"{SOFA}/file", SOFA.upper()])
def test_another_origin_is_refused(origin):
    with pytest.raises(NoteError, match=f"its origin is '{SOFA}', must be '{origin}'"):
        Checkpoint.parse(EXAMPLE, origin)


def test_the_least_and_the_largest_size():
    for size in (0, 10**19 - 1):
        assert Checkpoint.parse(Checkpoint("o", size, bytes(32)).text, "o").size == size


def test_a_checkpoint_does_not_change():
    named = Checkpoint.parse(EXAMPLE, SOFA)
    with pytest.raises(FrozenInstanceError):
        named.size = 1
    assert not hasattr(named, "__dict__")
    assert len(named.hash) == HASH_BYTES == 32
