"""What is declared of a tool path, as a log keeps it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath.apt import read_apt
from cutgate.runtime.plan.toolpath.gcode import read_gcode
from cutgate.runtime.plan.toolpath.model import PLAIN, Reading, as_words, of_words

TOLERANCE = st.floats(0.0001, 1.0)
READINGS = st.builds(
    Reading, st.booleans(), st.none() | st.sampled_from(["xyzac", "xyzbc"]), TOLERANCE, TOLERANCE
)
EVERY = ("cutcom_is_tool_centre", "rotary", "arc_tolerance_mm", "axis_tolerance_deg")


@given(READINGS)
def test_what_a_log_keeps_is_the_same_reading_to_the_last_bit(reading):
    assert of_words(as_words(reading, EVERY)) == reading


def test_only_what_a_language_leaves_open_is_kept():
    words = as_words(Reading(rotary="xyzac"), {"rotary", "axis_tolerance_deg"})
    assert words == 'rotary="xyzac" axis_tolerance_deg=0.01'
    assert of_words("") == PLAIN


@pytest.mark.parametrize(
    "words",
    [
        "rotary",
        "rotary=",
        "rotary=xyzac",
        "rotary=1",
        "unknown=1",
        "arc_tolerance_mm=0",
        "arc_tolerance_mm=1",
        "arc_tolerance_mm=0.0",
        "arc_tolerance_mm=1.5",
        "arc_tolerance_mm=NaN",
        "arc_tolerance_mm=true",
        pytest.param("rotary=" + 100_000 * "[", id="nested"),
        "arc_tolerance_mm=0.1 arc_tolerance_mm=0.2",
        "cutcom_is_tool_centre=1",
        "axis_tolerance_deg=-1.0",
        "axis_tolerance_deg=1e999",
    ],
)
def test_what_no_session_wrote_is_refused(words):
    with pytest.raises(ValueError, match=r"."):
        of_words(words)


@pytest.mark.parametrize("value", [0.0, 0.00009, 1.0001, float("nan"), float("inf")])
def test_a_tolerance_that_cuts_a_path_without_end_or_straightens_all_is_none(value):
    with pytest.raises(ValueError, match="arc_tolerance_mm"):
        Reading(arc_tolerance_mm=value)
    with pytest.raises(ValueError, match="axis_tolerance_deg"):
        Reading(axis_tolerance_deg=value)


@pytest.mark.parametrize(
    ("read", "line"), [(read_gcode, b"G0\n"), (read_apt, b"COOLNT/ON\n"), (read_apt, b"\n")]
)
def test_a_file_of_far_more_lines_than_poses_is_refused_before_it_is_looked_at(read, line):
    with pytest.raises(InputError, match="10041 lines, must be <= 10040 lines for 10 poses"):
        read("many", line * 10_041, PLAIN, 10, None)
