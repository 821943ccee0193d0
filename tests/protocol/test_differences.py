"""Differing parameters are told with name, both values and unit."""

from dataclasses import fields, replace

import pytest

from cutgate.protocol.differences import differences
from cutgate.protocol.records import Calibration, Limits, Tool

LIMITS = Limits.quantised(
    q_min_deg=(-80, 0, 50, -170, 0), q_max_deg=(80, 145, 450, 170, 110), speed_deg_s=(57, 57, 200, 114, 114)
)
CALIBRATION = Calibration.quantised(upper_link_mm=450, forearm_link_mm=449.5)
RECORDS = (LIMITS, CALIBRATION, Tool.quantised(length_mm=160))


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_equal_records_do_not_differ_and_every_count_of_every_field_is_told(record):
    assert differences(record, record) == ()
    for field in fields(record):
        value = getattr(record, field.name)
        several = value if isinstance(value, tuple) else (value,)
        for place in range(len(several)):
            other = tuple(count + (number == place) for number, count in enumerate(several))
            changed = replace(record, **{field.name: other if isinstance(value, tuple) else other[0]})
            told = differences(changed, record)
            assert len(told) == 1
            assert differences(record, changed) != told


@pytest.mark.parametrize(
    ("received", "approved", "told"),
    [
        (replace(LIMITS, q_max_u=(80_000_000, 140_500_000, 450_000_000, 170_000_000, 110_000_000)), LIMITS,
         "q1 upper limit is 140.5 deg, approved: 145 deg"),
        (replace(LIMITS, q_min_u=(-80_000_000, 0, 50_000_001, -170_000_000, 0)), LIMITS,
         "q2 lower limit is 50.000001 mm, approved: 50 mm"),
        (replace(LIMITS, speed_u=(57_000_000, 57_000_000, 200_000_000, 114_000_000, 0)), LIMITS,
         "q4 speed limit is 0 rad/s, approved: 1.989675 rad/s"),
        (replace(LIMITS, speed_u=(57_000_000, 57_000_000, 200_000_000, 114_000_001, 114_000_000)), LIMITS,
         "q3 speed limit is 1.989675365 rad/s, approved: 1.989675347 rad/s"),
        (replace(CALIBRATION, slide_tilt_u=(0, -250_000)), CALIBRATION,
         "slide tilt along y is -0.25 mrad, approved: 0 mrad"),
        (replace(CALIBRATION, forearm_link_u=450_000_000), CALIBRATION,
         "forearm link is 450 mm, approved: 449.5 mm"),
        (Tool.quantised(length_mm=100), Tool.quantised(length_mm=160), "tool length is 100 mm, approved: 160 mm"),
    ],
)  # fmt: skip
def test_name_both_values_and_unit_are_told(received, approved, told):
    assert differences(received, approved) == (told,)


def test_limits_that_are_not_given_are_told_as_such():
    given = replace(LIMITS, acceleration_u=(1_000_000,) * 5)
    assert differences(LIMITS, given)[2] == "q2 acceleration limit is not given, approved: 1 mm/s2"
    assert differences(given, LIMITS)[4] == "q4 acceleration limit is 0.017453 rad/s2, approved: not given"
