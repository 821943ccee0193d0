"""What is told of the arm's place is what the controller sent last, whole and in this session."""

from dataclasses import replace

import pytest

from cutgate.protocol.frames import IDS, Joint4, Joints01, Progress, encode_frame, joint_frames
from cutgate.protocol.records import joints_to_counts
from cutgate.runtime.review.last_seen import KEPT, LastSeen

TAG = 0xC0FFEE
JOINTS = (0.1, 0.2, 250.0, -0.3, 0.4)


@pytest.fixture
def seen():
    return LastSeen()


def sample(seen, joints, counter, *, parts=(0, 1, 2), tag=TAG):
    frames = list(joint_frames(joints))
    for part in parts:
        seen.frame(*encode_frame(frames[part], counter, tag))


def about(joints):
    return pytest.approx(joints_to_counts(joints), abs=5000), "a joint frame's last digit is 0.005 deg"


def test_nothing_is_known_before_anything_was_heard(seen):
    assert (seen.progress(TAG), seen.joints_u(TAG)) == (None, None)


def test_the_last_progress_counts(seen):
    for counter, fraction in enumerate((1, 2, 3)):
        seen.frame(*encode_frame(Progress(7, fraction), counter, TAG))
    assert seen.progress(TAG) == (7, 3)


@pytest.mark.parametrize("parts", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_sample_counts_once_it_is_whole_in_whatever_order(seen, parts):
    sample(seen, JOINTS, 0, parts=parts)
    found, why = about(JOINTS)
    assert seen.joints_u(TAG) == found, why


@pytest.mark.parametrize("missing", range(3))
def test_one_that_is_not_whole_does_not(seen, missing):
    sample(seen, JOINTS, 0)
    later = tuple(value + 0.5 for value in JOINTS)
    sample(seen, later, 1, parts=[part for part in range(3) if part != missing])
    found, why = about(JOINTS)
    assert seen.joints_u(TAG) == found, why
    sample(seen, later, 1, parts=[missing])
    found, why = about(later)
    assert seen.joints_u(TAG) == found, why


def test_what_is_damaged_or_of_another_session_tells_nothing(seen):
    sample(seen, JOINTS, 0, tag=TAG + 2)
    can_id, data = encode_frame(Progress(7, 3), 0, TAG)
    seen.frame(can_id, data[:-1] + bytes([data[-1] ^ 1]))
    seen.frame(can_id, data[:-1])
    assert (seen.progress(TAG), seen.joints_u(TAG)) == (None, None)


def test_a_sound_frame_of_no_meaning_tells_nothing(seen, monkeypatch):
    def refuse(*_frame):
        raise ValueError("a code that is not listed")

    seen.frame(*encode_frame(Progress(7, 3), 0, TAG))
    monkeypatch.setattr("cutgate.runtime.review.last_seen.decode_frame", refuse)
    assert seen.progress(TAG) is None


def test_a_frame_under_another_name_tells_nothing(seen, monkeypatch):
    sample(seen, JOINTS, 0)
    seen.frame(*encode_frame(Progress(7, 3), 0, TAG))
    other = {IDS[Progress]: Joint4(0), IDS[Joints01]: Progress(0, 0)}
    monkeypatch.setattr(
        "cutgate.runtime.review.last_seen.decode_frame", lambda can_id, _data: other.get(can_id)
    )
    assert (seen.progress(TAG), seen.joints_u(TAG)) == (None, None)


def test_however_many_frames_come_so_many_are_kept(seen):
    for counter in range(1000):
        seen.frame(*encode_frame(Progress(counter, 0), counter % 256, TAG))
        seen.frame(0x123, bytes(8))
    assert sum(len(kept) for kept in seen._frames.values()) == KEPT
    assert replace(Progress(999, 0), fraction=0).segment == seen.progress(TAG)[0]
