"""What a recovered copy says of itself is read back as it was written, or refused."""

from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Metadata

from cutgate.runtime.audit.recovered import RECOVERED, TEXT_MAX, Recovered, is_copy, told_by

TOLD = Recovered("20260921T141321Z-01234567.mcap", "ab" * 32, 500, 20, 17, "cutgate 0.2.0")
CONTENT = TOLD.metadata().metadata
KEYS = ("original", "original_sha256", "original_bytes", "dropped_bytes", "records", "software")
COUNTS = st.integers(0, 10**18)
TEXTS = st.text(min_size=1, max_size=TEXT_MAX)


def test_every_field_has_its_key():
    assert TOLD.metadata().name == RECOVERED == "cutgate.recovered"
    assert tuple(CONTENT.items()) == tuple(
        zip(KEYS, (TOLD.original, "ab" * 32, "500", "20", "17", "cutgate 0.2.0"), strict=True)
    )


@settings(max_examples=40)
@given(TEXTS, st.binary(min_size=32, max_size=32), COUNTS, COUNTS, COUNTS, TEXTS)
def test_what_is_written_is_read_back(original, digest, one, other, kept, software):
    told = Recovered(original, digest.hex(), max(one, other), min(one, other), kept, software)
    assert Recovered.parse(told.metadata().metadata) == told


def test_what_is_told_does_not_change():
    with pytest.raises(FrozenInstanceError):
        TOLD.records = 18  # type: ignore[misc]
    assert not hasattr(TOLD, "__dict__")


def test_it_says_of_what_it_is_a_copy_and_how_much_is_missing():
    assert str(TOLD) == "it is a recovered copy of 20260921T141321Z-01234567.mcap, 20 bytes dropped"


@pytest.mark.parametrize("key", KEYS)
def test_a_key_that_is_missing_or_in_another_place_is_refused(key):
    rest = {name: value for name, value in CONTENT.items() if name != key}
    contents = [rest, rest | {"other": "7"}, CONTENT | {"other": "7"}]
    if key != "software":
        contents.append(rest | {key: CONTENT[key]})
    for content in contents:
        with pytest.raises(ValueError, match="its keys are not original, original_sha256, "):
            Recovered.parse(content)


@pytest.mark.parametrize("key", KEYS[2:5])
@pytest.mark.parametrize("value", ["", "-1", "01", "1.0", "1e3", "+1", " 1", "1\n", "1_0", "٣", "9" * 20])
def test_a_number_is_written_in_one_way(key, value):
    with pytest.raises(ValueError, match="a SHA-256 or a number is none"):
        Recovered.parse(CONTENT | {key: value})


@pytest.mark.parametrize("value", ["", "AB" * 32, "ab" * 31, "ab" * 33, "xy" * 32, "ab" * 32 + "\n"])
def test_a_digest_is_64_digits(value):
    with pytest.raises(ValueError, match="a SHA-256 or a number is none"):
        Recovered.parse(CONTENT | {"original_sha256": value})


@pytest.mark.parametrize("key", ["original", "software"])
@pytest.mark.parametrize("value", ["", "x" * (TEXT_MAX + 1)])
def test_a_name_is_there_and_of_bounded_length(key, value):
    with pytest.raises(ValueError, match="a name is empty or longer than any"):
        Recovered.parse(CONTENT | {key: value})
    assert Recovered.parse(CONTENT | {key: "x" * TEXT_MAX})
    assert TEXT_MAX == 2000


def test_no_more_is_dropped_than_there_was():
    with pytest.raises(ValueError, match="it drops 501 bytes of 500"):
        Recovered.parse(CONTENT | {"dropped_bytes": "501"})
    assert Recovered.parse(CONTENT | {"dropped_bytes": "500"}).dropped == 500


def test_a_file_is_a_copy_by_its_metadata_alone():
    own, bad = Metadata("cutgate", {"log_id": "ab"}), Metadata(RECOVERED, {})
    assert (is_copy([]), is_copy([own]), told_by([own])) == (False, False, None)
    assert is_copy([own, TOLD.metadata()])
    assert told_by([own, TOLD.metadata()]) == TOLD
    assert is_copy([bad])
    with pytest.raises(ValueError, match="its keys"):
        told_by([own, bad])
