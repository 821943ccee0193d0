"""Signed notes: published ones, the rules of the specification one by one, and that every byte counts."""

from base64 import b64decode, b64encode
from dataclasses import FrozenInstanceError

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.signing.note import (
    NOTE_MAX,
    SIGNATURES_MAX,
    Note,
    NoteError,
    SignatureType,
    VerifierKey,
    alone,
    parse,
    sign,
    verify,
)

EXAMPLE_KEY = "example.com/foo+530d903a+AekyeRrm56hApGFkyQR4ZCbV54Id2LKaANYcrnKv3U2k"
EXAMPLE = """\
This is an example message.

— example.com/foo Uw2QOkn8srV1yJGh2VYRlL1Tnagv1YEq6TfXppzi2ONncAlTgK7Ztg1ERYNZXsYjOBH3mFXmRKuwHjG1Yu72IneyaQM=
"""
"""Key and note of https://c2sp.org/signed-note, "Verifier keys"."""

POEM = """\
Ognuno sta solo sul cuor della terra
trafitto da un raggio di sole:

ed è subito sera.

— quasimodo.example/salvatore NnugSzTjtVAewIS+Z/iJhUPeFDkO/5QQ2i5ddnGITLlC+EhfLW9oJKONrMouFSQU0xMcXxj99ihAQwaqP3ZekRwNtIc=
"""
"""The first example of the same page; its key is not published."""

PETER = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"
PETER_SECRET = b64decode("AYEKFALVFGyNhPJEMzD1QIDr+Y7hfZx09iUvxdXHKDFz")[1:]
ENOCH = "EnochRoot+af0cfe78+ATtqJ7zOtqQtYqOo0CpvDXNlMhV3HeJDpjrASKGLWdop"
WISDOM = """\
If you think cryptography is the answer to your problem,
then you don't know what your problem is.
"""
SIGNED_ONCE = f"""\
{WISDOM}
— PeterNeumann x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdngotpRZb6KE6RyyBwJnAM=
"""
SIGNED_TWICE = f"""\
{SIGNED_ONCE}— EnochRoot rwz+eBzmZa0SO3NbfRGzPCpDckykFXSdeX+MNtCOXm2/5n2tiOHp+vAF1aGrQ5ovTG01oOTGwnWLox33WWd1RvMc+QQ=
"""
"""Keys and notes of golang.org/x/mod/sumdb/note: its documentation and tests."""

ARCHE = "arche2025h1.staging.ct.transparency.dev+ba2f06c0+AU0vHmlGCS/PdN8b2OaGmKprLI8HKM+dJ472xgFYh15f"
REMORA = "remora.n621.de+da77ade7+BOvN63jn/bLvkieywe8R6UYAtVtNbZpXh34x7onlmtw2"
COSIGNED = """\
arche2025h1.staging.ct.transparency.dev
1432088532
U7WM79jrzyhGZ5/GUBTpM7NzwdyfFx61t3RovgcC4Ro=

— arche2025h1.staging.ct.transparency.dev zTM8sQAAAZ5W0WdjBAMARjBEAiBjW5IQf9pvsYLfQFX6hoGREPMHbdQ3urbllzalApkptQIgIpwtEroeW2BXaHAI4kJXFbon5Ch9MNL5zRNZ55lvGt0=
— arche2025h1.staging.ct.transparency.dev ui8GwCF1+kWqZrxGdhj4aX3gcw7XUlXQQabg/27lefwhUkzbC3NygNI75MdhL1bfTW9g8Ei59RA23oHP7Ry1k3ZFWwQ=
— remora.n621.de 2net5wAAAABqEiEgPlfF3V06o0Y+fHM+J5J9s27wgxxcOVSpZ/2g/KSiXCg9DEZI+aVCIobWX9sXTynk5XeU/zZ0WBxtqB0DrAWfBw==
"""
"""A checkpoint of a public log with its Ed25519 signature, one of a kind that is not ours, and a witness's cosignature."""

PUBLISHED = {
    "example": (EXAMPLE, EXAMPLE_KEY),
    "once": (SIGNED_ONCE, PETER),
    "twice, the first": (SIGNED_TWICE, PETER),
    "twice, the second": (SIGNED_TWICE, ENOCH),
    "checkpoint": (COSIGNED, ARCHE),
    "cosignature": (COSIGNED, REMORA),
}
SECRET = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
NAME = "cutgate/0123"
KEY = VerifierKey(NAME, SECRET.public_key().public_bytes_raw())
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), min_size=1).map(
    lambda text: f"{text}\n"
)


def altered(text, number):
    """The text with one bit of one byte changed."""
    data = bytearray(text.encode())
    data[number // 8] ^= 1 << number % 8
    return data.decode("utf-8", "surrogateescape")


@pytest.mark.parametrize(("note", "key"), PUBLISHED.values(), ids=PUBLISHED)
def test_what_others_signed_is_verified(note, key):
    assert verify(note, VerifierKey.parse(key)) == note.rpartition("\n\n")[0] + "\n"


@pytest.mark.parametrize("key", sorted({key for _, key in PUBLISHED.values()}))
def test_the_keys_of_others_are_read_and_written(key):
    assert str(VerifierKey.parse(key)) == key


def test_what_we_sign_is_what_others_sign():
    assert sign(WISDOM, "PeterNeumann", Ed25519PrivateKey.from_private_bytes(PETER_SECRET)) == SIGNED_ONCE


def test_the_types_of_the_keys():
    assert VerifierKey.parse(ARCHE).type is SignatureType.ED25519
    assert VerifierKey.parse(REMORA).type is SignatureType.COSIGNATURE


def test_the_text_ends_at_the_last_empty_line():
    note = parse(POEM)
    assert note.text.count("\n\n") == 1
    assert note.text.endswith("ed è subito sera.\n")
    ((name, key_id, signature),) = note.signatures
    assert (name, key_id.hex(), len(signature)) == ("quasimodo.example/salvatore", "367ba04b", 64)


@given(TEXTS)
def test_a_signed_text_is_verified(text):
    assert verify(sign(text, NAME, SECRET), KEY) == text


@given(st.integers(0, 8 * len(EXAMPLE.encode()) - 1))
def test_no_other_bit_is_verified(number):
    with pytest.raises(NoteError):
        verify(altered(EXAMPLE, number), VerifierKey.parse(EXAMPLE_KEY))


def test_a_signature_has_one_form():
    """The last character of base64 before the padding has bits that say nothing: 'M' and 'N' are the same bytes here."""
    other = EXAMPLE.replace("aQM=", "aQN=")
    assert b64decode("aQM=") == b64decode("aQN=")
    with pytest.raises(NoteError, match="a signature line is"):
        parse(other)


@pytest.mark.parametrize(
    "note",
    [
        "",
        "\n\n",
        "text\n",
        "text\n\n",
        "\n\n— name AAAAAAA=\n",
        "text\n\n— name AAAAAAA=",
        "text\n\n- name AAAAAAA=\n",
        "text\n\n— name AAAAAA==\n",
        "text\n\n— name AAAA\n",
        "text\n\n— name\n",
        "text\n\n—  AAAAAAA=\n",
        "text\n\n— na+me AAAAAAA=\n",
        "text\n\n— na\u00a0me AAAAAAA=\n",
        "text\n\n— name AAAAAAA= \n",
        "text\n\n— name AAAA!AAA=\n",
        "text\n\n— name AAAAAAA=\n\n",
        "te\rxt\n\n— name AAAAAAA=\n",
        "te\0xt\n\n— name AAAAAAA=\n",
        "te\ud800xt\n\n— name AAAAAAA=\n",
        "text\n\n— name AAAAAAA=\n" + NOTE_MAX * "x",
    ],
)
def test_what_is_no_note_is_refused(note):
    with pytest.raises(NoteError):
        parse(note)


def test_the_least_note():
    assert parse("text\n\n— name AAAAAAA=\n") == Note("text\n", (("name", bytes(4), bytes(1)),))


def test_so_many_signatures_and_no_more():
    """The specification asks for sixteen at least."""
    line = "— name AAAAAAA=\n"
    assert SIGNATURES_MAX >= 16
    assert len(parse("text\n\n" + SIGNATURES_MAX * line).signatures) == SIGNATURES_MAX
    with pytest.raises(
        NoteError, match=f"at most {SIGNATURES_MAX} signatures, this one {SIGNATURES_MAX + 1}"
    ):
        parse("text\n\n" + (SIGNATURES_MAX + 1) * line)


def test_so_many_characters_and_no_more():
    note = sign("x" * (NOTE_MAX - len(sign("", NAME, SECRET)) - 1) + "\n", NAME, SECRET)
    assert len(note) == NOTE_MAX
    assert verify(note, KEY)
    with pytest.raises(NoteError, match=f"at most {NOTE_MAX} characters, this one {NOTE_MAX + 1}"):
        parse("x" + note)


def line_of(name, key_id, signature):
    return f"— {name} {b64encode(key_id + signature).decode()}\n"


def test_a_signature_of_the_same_name_or_id_alone_is_anothers():
    text, good = "text\n", SECRET.sign(b"text\n")
    other = bytes(4)
    for line in (line_of(NAME, other, good), line_of("other", KEY.id, good)):
        with pytest.raises(NoteError, match="it has no signature of the key"):
            verify(f"{text}\n{line}", KEY)
        assert verify(f"{text}\n{line}{line_of(NAME, KEY.id, good)}", KEY) == text


def test_one_wrong_signature_that_claims_to_be_the_keys_is_enough():
    good, bad = (line_of(NAME, KEY.id, SECRET.sign(text)) for text in (b"text\n", b"other\n"))
    for lines in (bad, good + bad, bad + good):
        with pytest.raises(NoteError, match="its signature is not of the key"):
            verify(f"text\n\n{lines}", KEY)


def test_a_cosignature_signs_its_time():
    key = VerifierKey(NAME, KEY.public, SignatureType.COSIGNATURE)
    time_s, text = 1_790_000_000, "text\n"
    signed = SECRET.sign(f"cosignature/v1\ntime {time_s}\n{text}".encode())

    def note(time_s):
        return f"{text}\n{line_of(NAME, key.id, time_s.to_bytes(8, 'big') + signed)}"

    assert verify(note(time_s), key) == text
    with pytest.raises(NoteError, match="its signature is not"):
        verify(note(time_s + 1), key)
    with pytest.raises(NoteError, match="it has no signature"):
        verify(note(time_s), KEY)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "NAME"),
        ("example.com/foo", "NAME"),
        ("example.com/foo+530d903a", "NAME"),
        ("a+00000000+", "NAME"),
        (EXAMPLE_KEY + "!", "NAME"),
        (EXAMPLE_KEY.replace("+Ae", "+Ce"), "NAME"),
        (EXAMPLE_KEY.replace("example", "ex\ud800mple"), "NAME"),
        (EXAMPLE_KEY.replace("example", "exam ple"), "without spaces"),
        (EXAMPLE_KEY.replace("example.com/foo", ""), "without spaces"),
        (EXAMPLE_KEY[:-4], "32 bytes"),
        (EXAMPLE_KEY.replace("530d903a", "530d903b"), "its key ID is 530d903b, the key's is 530d903a"),
        (EXAMPLE_KEY.replace("530d903a", "530D903A"), "its key ID is 530D903A"),
        (EXAMPLE_KEY.replace("example", "exemple"), "its key ID"),
    ],
)
def test_what_is_no_key_is_refused(text, told):
    with pytest.raises(NoteError, match=told):
        VerifierKey.parse(text)


def test_the_id_depends_on_name_type_and_key():
    keys = {KEY, VerifierKey("other", KEY.public), VerifierKey(NAME, bytes(32))}
    keys.add(VerifierKey(NAME, KEY.public, SignatureType.COSIGNATURE))
    assert len({key.id for key in keys}) == len(keys)


def test_the_bounds():
    assert (NOTE_MAX, SIGNATURES_MAX) == (65536, 64)


@pytest.mark.parametrize(("one", "name"), [(KEY, "name"), (parse(EXAMPLE), "text")])
def test_neither_keys_nor_notes_change(one, name):
    with pytest.raises(FrozenInstanceError):
        setattr(one, name, "x")
    assert not hasattr(one, "__dict__")


def test_a_note_without_what_others_signed():
    for note in (SIGNED_ONCE, SIGNED_TWICE):
        assert alone(note, VerifierKey.parse(PETER)) == SIGNED_ONCE
    lines = COSIGNED.splitlines(keepends=True)
    for key, place in ((ARCHE, 5), (REMORA, 6)):
        assert alone(COSIGNED, VerifierKey.parse(key)) == "".join((*lines[:4], lines[place]))
    with pytest.raises(NoteError, match="it has no signature of the key"):
        alone(SIGNED_ONCE, VerifierKey.parse(ENOCH))


def test_no_note_is_signed_by_a_key_whose_name_cannot_be_written():
    with pytest.raises(NoteError, match="not UTF-8"):
        verify(SIGNED_ONCE, VerifierKey("cutgate/\ud800", bytes(32)))
