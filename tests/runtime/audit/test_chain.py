"""The hash chain: every part of every message counts."""

import hashlib
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.chain import (
    GENESIS,
    ChainLink,
    advance,
    covered,
    covered_in,
    follow,
    of_channel,
    parts_of,
)

TIMES = st.integers(0, 2**64 - 1)
LINKS = st.builds(
    ChainLink,
    topic=st.text(max_size=8),
    encoding=st.text(max_size=8),
    schema_name=st.text(max_size=8),
    schema=st.binary(max_size=8),
    log_time=TIMES,
    publish_time=TIMES,
    sequence=st.integers(0, 2**32 - 1),
    data=st.binary(max_size=16),
)


def independent(head: bytes, link: ChainLink) -> bytes:
    """The formula of the module's docstring, written again."""
    hasher = hashlib.sha256(head)
    for text in (link.topic.encode(), link.encoding.encode(), link.schema_name.encode()):
        hasher.update(len(text).to_bytes(8, "little"))
        hasher.update(text)
    hasher.update(hashlib.sha256(link.schema).digest())
    hasher.update(link.log_time.to_bytes(8, "little"))
    hasher.update(link.publish_time.to_bytes(8, "little"))
    hasher.update(link.sequence.to_bytes(4, "little"))
    hasher.update(len(link.data).to_bytes(8, "little"))
    hasher.update(link.data)
    return hasher.digest()


@given(LINKS)
def test_the_formula(link):
    assert advance(GENESIS, link) == independent(GENESIS, link)


def test_the_chain_begins_at_32_zeros():
    assert bytes(32) == GENESIS


@given(LINKS)
def test_a_link_is_what_it_was_made_as(link):
    with pytest.raises(FrozenInstanceError):
        link.sequence += 1
    assert len({link, replace(link)}) == 1


@given(LINKS, LINKS)
def test_different_messages_give_different_heads(one, other):
    assert (advance(GENESIS, one) == advance(GENESIS, other)) == (one == other)


@given(LINKS, st.sampled_from(list(ChainLink.__slots__)), LINKS)
def test_every_field_counts(link, name, other):
    changed = replace(link, **{name: getattr(other, name)})
    assert (advance(GENESIS, changed) == advance(GENESIS, link)) == (changed == link)


@given(LINKS, st.binary(min_size=32, max_size=32))
def test_everything_before_counts(link, head):
    assert (advance(head, link) == advance(GENESIS, link)) == (head == GENESIS)


@given(LINKS, st.binary(min_size=32, max_size=32))
def test_chain_and_tree_cover_the_same_bytes(link, head):
    """What the formula puts behind the head, and what a reader makes of a message whose channel is known."""
    body = covered(link)
    assert hashlib.sha256(head + body).digest() == independent(head, link) == follow(head, body)
    channel = of_channel(link.topic, link.encoding, link.schema_name, link.schema)
    assert covered_in(channel, link.log_time, link.publish_time, link.sequence, link.data) == body


@given(LINKS, LINKS)
def test_different_messages_give_different_leaves(one, other):
    assert (covered(one) == covered(other)) == (one == other)


def bytes_of(parts):
    """The bytes of these parts, by the formula written again."""
    texts = [text.encode() for text in (parts.topic, parts.encoding, parts.schema_name)]
    return b"".join(
        (
            *(len(text).to_bytes(8, "little") + text for text in texts),
            parts.schema_sha256,
            *(time.to_bytes(8, "little") for time in (parts.log_time, parts.publish_time)),
            parts.sequence.to_bytes(4, "little"),
            len(parts.data).to_bytes(8, "little") + parts.data,
        )
    )


@given(LINKS)
def test_the_parts_are_those_that_were_covered(link):
    parts = parts_of(covered(link))
    assert parts.schema_sha256 == hashlib.sha256(link.schema).digest()
    for name in ("topic", "encoding", "schema_name", "log_time", "publish_time", "sequence", "data"):
        assert getattr(parts, name) == getattr(link, name)
    assert bytes_of(parts) == covered(link)


@given(st.binary(max_size=120) | LINKS.map(covered), st.integers(0, 120), st.binary(max_size=9))
def test_only_whole_bytes_have_parts_and_they_give_these_bytes(data, place, other):
    changed = data[:place] + other + data[place + len(other) :]
    try:
        parts = parts_of(changed)
    except ValueError:
        return
    assert bytes_of(parts) == changed


@given(LINKS, st.data())
def test_bytes_that_end_early_or_late_have_no_parts(link, draws):
    whole = covered(link)
    end = draws.draw(st.integers(0, len(whole) - 1))
    for data in (whole[:end], whole + b"x"):
        with pytest.raises(ValueError, match=r"it ends early|bytes of data follow"):
            parts_of(data)


def test_a_text_that_is_no_utf_8_has_no_parts():
    whole = covered(ChainLink("topic", "json", "name", b"{}", 1, 2, 3, b"data"))
    for name in (b"topic", b"json", b"name"):
        with pytest.raises(ValueError, match=r"is no UTF-8"):
            parts_of(whole.replace(name, b"\xff" + name[1:]))
