"""The keys of one session in a file: written once, read by their owner alone, and told apart from a pre-shared key."""

import json
import stat

import pytest

from cutgate.config.key import new_key_file
from cutgate.config.load import InputError
from cutgate.config.session_keys import (
    BYTES_MAX,
    SCHEMA,
    SessionKeys,
    load_review_key,
    new_session_key_file,
)
from cutgate.protocol.codes import PresharedKey

KEY = bytes(range(32))
KEYS = SessionKeys("ab" * 16, bytes(range(16)), PresharedKey(KEY).code_keys(bytes(32)))


@pytest.fixture
def path(tmp_path):
    made = tmp_path / "session.json"
    new_session_key_file(made, KEYS)
    return made


def altered(path, **changes):
    document = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({key: value for key, value in document.items() if value is not None}))


def test_the_keys_of_a_session_are_read_as_they_were_written_and_are_their_owners_alone(path):
    assert load_review_key(path) == KEYS
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.stat().st_size <= BYTES_MAX
    document = json.loads(path.read_text())
    assert (document["schema"], document["log_id"]) == (SCHEMA, KEYS.log_id)
    assert "they open no session and move no arm" in document["what"]


def test_the_file_holds_nothing_of_the_pre_shared_key(path):
    text = path.read_text()
    assert not any(part in text for part in (KEY.hex(), PresharedKey(KEY).fingerprint))


def test_a_pre_shared_key_is_told_by_its_content(tmp_path):
    new_key_file(tmp_path / "any name.json", KEY)
    assert load_review_key(tmp_path / "any name.json") == KEY


def test_nothing_is_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists and is never overwritten"):
        new_session_key_file(path, KEYS)
    assert path.read_bytes() == before


def test_a_folder_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        new_session_key_file(tmp_path / "no" / "keys", KEYS)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666])
def test_keys_that_others_may_read_are_refused(path, mode):
    path.chmod(mode)
    with pytest.raises(InputError, match="without access by others"):
        load_review_key(path)


def test_a_file_that_is_missing_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no such key file"):
        load_review_key(tmp_path / "no")


@pytest.mark.parametrize(
    "key", ["schema", "what", "log_id", "session", "open_code", "keys", "sha256", "more"]
)
@pytest.mark.parametrize("value", [None, 7, "", "zz", "ab" * 16, "ab" * 32, {}, ["ab"]])
def test_whatever_is_altered_is_refused(path, key, value):
    before = json.loads(path.read_text())
    if before.get(key) == value:
        return  # nothing is altered
    altered(path, **{key: value})
    with pytest.raises(InputError):
        load_review_key(path)


def test_a_damaged_key_accuses_no_log_and_is_not_shown(path):
    text = path.read_text()
    (some, *_) = json.loads(text)["keys"].values()
    path.write_text(text.replace(some, f"{some[:-1]}{'0' if some[-1] != '0' else '1'}"))
    with pytest.raises(InputError, match="of the rest of the file") as refused:
        load_review_key(path)
    path.write_text(text.replace(some, some[:-1]))
    with pytest.raises(InputError) as again:
        load_review_key(path)
    assert not any(some[:8] in str(error.value) for error in (refused, again))


def test_another_version_is_refused(path):
    altered(path, schema="cutgate.session-keys/2")
    with pytest.raises(InputError, match=r"another kind or version"):
        load_review_key(path)


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"{", b"ab", b"zz" * 32, b"ab" * 33, b"[]", b"{}", b"\xff", b"{" * 4000]
)
def test_what_is_neither_is_refused(path, data):
    path.write_bytes(data)
    with pytest.raises(InputError):
        load_review_key(path)


def test_what_is_larger_than_any_is_refused_unread(path):
    path.write_bytes(b" " * (BYTES_MAX + 1))
    with pytest.raises(InputError, match=f"<= {BYTES_MAX} bytes"):
        load_review_key(path)
