"""The bone that moves by itself, and what its sensor tells of it."""

import pytest

from cutgate.firmware_sim.bone import SENSOR_MM, BoneMotion


def test_a_motion_is_a_time_and_a_way():
    assert BoneMotion.parse("2.5,1") == BoneMotion(2.5, 1.0)
    assert BoneMotion.parse("0,0") == BoneMotion(0.0, 0.0)


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "-1,2", "1,-2", "nan,1", "1,inf", "inf,1", "1,x"])
def test_anything_else_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match="must be SECONDS,MM, both finite and >= 0") as refused:
        BoneMotion.parse(text)
    assert repr(text) in str(refused.value)


def test_the_sensor_tells_of_what_is_no_less_than_its_threshold():
    assert BoneMotion(1.0, SENSOR_MM).is_seen
    assert BoneMotion(1.0, SENSOR_MM).told() == "the bone has moved by 0.2 mm"
    assert not BoneMotion(1.0, 0.199).is_seen
    told = BoneMotion(1.0, 0.199).told()
    assert told == "the bone has moved by 0.199 mm, less than the 0.2 mm of which its sensor tells"


def test_a_motion_that_was_asked_for_stays_the_same():
    assert BoneMotion.__dataclass_params__.frozen
