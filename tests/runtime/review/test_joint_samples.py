"""Joints come once, whole, of one counter and of this session; and they are those that `LastSeen` tells, found another way."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.frames import IDS, FrameError, Joint4, Progress, encode_frame, joint_frames
from cutgate.protocol.records import joints_to_counts
from cutgate.runtime.review.joint_samples import JointSamples
from cutgate.runtime.review.last_seen import LastSeen

TAG = 0xC0FFEE
JOINTS = (0.1, 0.2, 250.0, -0.3, 0.4)


def listening(tag=TAG):
    made = JointSamples()
    made.tag = tag
    return made


def frames(joints, counter, tag=TAG):
    return [encode_frame(frame, counter, tag) for frame in joint_frames(joints)]


def test_three_parts_of_one_counter_are_a_sample_with_the_last():
    samples = listening()
    found = [samples.take(*frame) for frame in frames(JOINTS, 7)]
    assert found[:2] == [None, None]
    assert found[2] == pytest.approx(JOINTS, abs=0.006)


def test_progress_is_progress():
    assert listening().take(*encode_frame(Progress(7, 3), 0, TAG)) == Progress(7, 3)


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 4), st.floats(-1.0, 1.0), st.booleans()), max_size=60
    )
)
def test_what_comes_is_what_is_seen_last_whenever_the_last_part_completes_it(sent):
    """Parts of any counters in any order, some damaged: whenever there are joints, they are of that last part's counter."""
    samples, seen = listening(), LastSeen()
    for part, counter, angle, damaged in sent:
        can_id, data = frames((angle, 0.2, 250.0, -0.3, 0.4), counter)[part]
        data = data[:-1] + bytes([data[-1] ^ damaged])
        seen.frame(can_id, data)
        found = samples.take(can_id, data)
        if found is not None:
            assert can_id == IDS[Joint4]
            assert joints_to_counts(found) == seen.joints_u(TAG)


@pytest.mark.parametrize("tag", [0, TAG + 1])
def test_of_another_session_or_before_one_there_is_nothing(tag):
    samples = listening(tag)
    for frame in (*frames(JOINTS, 1), encode_frame(Progress(7, 3), 0, TAG)):
        assert samples.take(*frame) is None


def test_before_a_session_even_frames_outside_of_any_tell_nothing():
    samples = JointSamples()
    assert [samples.take(*frame) for frame in frames(JOINTS, 1, 0)] == [None] * 3


def test_what_has_no_meaning_or_no_such_identifier_tells_nothing(monkeypatch):
    samples = listening()
    assert samples.take(0x7FF, bytes(8)) is None
    assert samples.take(IDS[Joint4], b"") is None

    def refuse(*_frame):
        raise FrameError("a code that is not listed")

    monkeypatch.setattr("cutgate.runtime.review.joint_samples.decode_frame", refuse)
    assert [samples.take(*frame) for frame in frames(JOINTS, 1)] == [None] * 3
