"""A path on its way in: whole or not at all, checked in parts, and void with its session."""

from dataclasses import replace

import pytest

from cutgate.firmware_sim import upload
from cutgate.firmware_sim.approach import own_ends
from cutgate.firmware_sim.kinematics import calibrated_arm
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.state import Holdings, PathChecked
from cutgate.firmware_sim.upload import CHECK_POSES_PER_CYCLE, MALFORMED, Upload
from cutgate.protocol import records
from cutgate.protocol.states import Refusal
from tests.firmware_sim.arms import (
    CALIBRATED,
    LEFT_LIMITS,
    LIMITS,
    NOMINAL,
    PATH,
    TOOL,
    TOOL_MM,
    line_path,
    pocket,
)

HOLDINGS = Holdings(LIMITS.body(), CALIBRATED.body(), TOOL.body())
LONG = pocket(poses=1500, length_mm=3000.0)
HIGH = line_path((500.0, 0.0, 200.0), (500.0, 20.0, 200.0), polar=(30, 30), azimuth=(0, 0))
"""200 mm further along the tool the slide is beyond its upper limit."""
VERTICAL = line_path((500.0, 0.0, 100.0), (500.0, 20.0, 100.0), polar=(0, 0), azimuth=(0, 0))
CLEARANCE_UM = 10_000


def sent(upload_, path):
    """The path that the last block completes; before it there is none."""
    *blocks, last = records.split(path.body())
    for block in blocks:
        assert upload_.add(block) is None
    return upload_.add(last)


def verdict(path, holdings=HOLDINGS, *, clearance_um=CLEARANCE_UM, **options):
    """What comes of a path, checked to its end."""
    one = Upload(**options)
    one.begin_check(sent(one, path), holdings)
    while one.check is not None:
        checked = one.continue_check(holdings, clearance_um)
    return checked


def ends_of(path, limits=LIMITS, *, clearance_um=CLEARANCE_UM):
    check = PathCheck(records.PathCodes.parse(path.body()), limits, CALIBRATED, TOOL)
    check.run()
    arm = calibrated_arm(CALIBRATED, tool_mm=TOOL_MM, elbow="right")
    return own_ends(check.path, arm, limits, check.first_joints, check.last_joints, clearance_um=clearance_um)


@pytest.mark.parametrize("path", [PATH, LONG])
def test_a_path_is_there_with_its_last_block(path):
    found = sent(Upload(), path)
    assert len(found) == len(path)
    assert Upload().check is None


def test_the_first_block_of_a_path_begins_anew():
    one = Upload()
    one.add(records.split(LONG.body())[0])
    assert len(sent(one, LONG)) == len(LONG)
    assert len(sent(one, PATH)) == len(PATH)


def test_a_block_out_of_its_order_is_refused():
    _, second, third, *_ = records.split(LONG.body())
    one = Upload()
    with pytest.raises(records.RecordError, match="PathBlock 1 came where 0 was due"):
        one.add(second)
    one.add(records.split(LONG.body())[0])
    with pytest.raises(records.RecordError, match="PathBlock 2 came where 1 was due"):
        one.add(third)


def test_a_whole_that_is_no_path_is_refused():
    (bad,) = records.split(b"\xff" * len(PATH.body()))
    with pytest.raises(records.RecordError, match="PathHeader"):
        Upload().add(bad)
    assert PathChecked(b"", Refusal.PATH_MALFORMED, 0, None) == MALFORMED


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda block: {"data": block.data + b"\0"}, "are followed by others"),
        (lambda block: {"data": block.data[:-1]}, "PathBlock 0: coded poses end inside component 4"),
        (
            lambda block: {"block_crc32": block.block_crc32 ^ 1},
            "PathBlock 0: CRC-32 does not match its poses",
        ),
    ],
    ids=["longer", "shorter", "of other poses"],
)
def test_a_block_that_is_not_the_coding_of_its_poses_is_refused_and_kept_nowhere(change, why):
    first, second, *_ = records.split(LONG.body())
    one = Upload()
    with pytest.raises(records.RecordError, match=why):
        one.add(replace(first, **change(first)))
    with pytest.raises(records.RecordError, match="PathBlock 1 came where 0 was due"):
        one.add(second)
    assert len(sent(one, LONG)) == len(LONG)


def test_what_was_begun_before_everything_was_void_is_not_completed_after_it():
    one = Upload()
    *blocks, last = records.split(LONG.body())
    for block in blocks:
        one.add(block)
    one.void()
    with pytest.raises(records.RecordError, match=f"PathBlock {last.index} came where 0 was due"):
        one.add(last)


def test_what_is_void_is_not_checked_any_further():
    one = Upload()
    one.begin_check(sent(one, PATH), HOLDINGS)
    one.void()
    assert one.check is None
    assert one.continue_check(HOLDINGS, CLEARANCE_UM) is None


def test_an_accepted_path_has_its_entry_and_exit_and_nothing_to_say():
    event, lines = verdict(PATH)
    assert event == PathChecked(PATH.body(), Refusal.ACCEPTED, 0, ends_of(PATH))
    assert lines == ()


def test_entry_and_exit_are_as_far_beyond_the_path_as_the_session_has_agreed():
    event, _ = verdict(PATH, clearance_um=50_000)
    assert event.ends == ends_of(PATH, clearance_um=50_000) != ends_of(PATH)


def test_a_path_is_checked_in_parts():
    one = Upload()
    one.begin_check(sent(one, LONG), HOLDINGS)
    cycles = 1
    while one.continue_check(HOLDINGS, CLEARANCE_UM) is None:
        assert one.check is not None
        cycles += 1
    assert one.check is None
    assert CHECK_POSES_PER_CYCLE == 512
    assert cycles == -(-len(LONG) // CHECK_POSES_PER_CYCLE)
    assert one.continue_check(HOLDINGS, CLEARANCE_UM) is None, "a verdict is given once"


def test_so_many_poses_are_looked_at_in_a_part(monkeypatch):
    monkeypatch.setattr(upload, "CHECK_POSES_PER_CYCLE", 1)
    one = Upload()
    one.begin_check(sent(one, PATH), HOLDINGS)
    for _ in range(len(PATH) - 1):
        assert one.continue_check(HOLDINGS, CLEARANCE_UM) is None
    assert one.continue_check(HOLDINGS, CLEARANCE_UM) is not None


@pytest.mark.parametrize(
    ("holdings", "refusal", "line"),
    [
        (
            replace(HOLDINGS, limits=LEFT_LIMITS.body()),
            Refusal.WRONG_ELBOW,
            "path refused: WRONG_ELBOW at pose 0: path for the right elbow, q1 limits are [-145.0, 0.0] deg",
        ),
        (
            replace(HOLDINGS, tool=records.Tool.quantised(length_mm=161.0).body()),
            Refusal.TOOL_LENGTH,
            "path refused: TOOL_LENGTH at pose 0: path for a tool of 160.0 mm, mounted is one of 161.0 mm",
        ),
    ],
)
def test_a_path_that_does_not_fit_what_is_held_is_refused_and_says_why(holdings, refusal, line):
    event, lines = verdict(PATH, holdings)
    assert event == PathChecked(PATH.body(), refusal, 0, None)
    assert lines == (line,)


def test_a_refusal_names_the_pose():
    tips = line_path((500.0, 0.0, 100.0), (1200.0, 0.0, 100.0))
    event, lines = verdict(tips)
    assert event.refusal is Refusal.POSE_OUTSIDE_LIMITS
    assert event.pose > 0
    assert lines[0].startswith(f"path refused: POSE_OUTSIDE_LIMITS at pose {event.pose}: ")


def test_the_calibration_is_that_of_the_controller():
    """With another arm the same path is approached with other joints."""
    other = replace(HOLDINGS, calibration=NOMINAL.body())
    event, _ = verdict(PATH, other)
    assert event.refusal is Refusal.ACCEPTED
    assert event.ends.entry_joints_u != ends_of(PATH).entry_joints_u


def test_an_entry_that_the_arm_cannot_reach_leaves_the_path_accepted_and_says_so():
    event, lines = verdict(HIGH, clearance_um=200_000)
    assert event == PathChecked(HIGH.body(), Refusal.ACCEPTED, 0, None)
    (line,) = lines
    assert line.startswith("no approach: entry pose, 200.000 mm along the tool: q2")


def test_entry_and_exit_are_judged_by_the_limits_at_the_end_of_the_check():
    (low, *others) = LIMITS.q_max_u
    narrow = replace(LIMITS, q_max_u=(LIMITS.q_min_u[0] + 1, *others))
    assert low != LIMITS.q_min_u[0] + 1
    one = Upload()
    one.begin_check(sent(one, PATH), HOLDINGS)
    event, lines = one.continue_check(replace(HOLDINGS, limits=narrow.body()), CLEARANCE_UM)
    assert (event.refusal, event.ends) == (Refusal.ACCEPTED, None)
    assert lines[0].startswith("no approach: entry pose, ")


def test_a_held_roll_is_that_of_the_robot():
    """On a vertical axis nothing else says which way the wrist is turned."""
    refused, _ = verdict(VERTICAL)
    assert refused.refusal is Refusal.POSE_OUTSIDE_LIMITS
    event, lines = verdict(VERTICAL, hold_roll_rad=0.25)
    assert event.refusal is Refusal.ACCEPTED
    assert lines == ()
    assert event.ends.entry_joints_u[3] == pytest.approx(0.25 * 180e6 / 3.141592653589793, abs=1)
