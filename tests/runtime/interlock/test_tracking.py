"""The tracking monitor alone: random trajectories, random arms on them, and a brute-force oracle for what is off."""

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cutgate.protocol.frames import FRACTION_MAX, ROTATION_DEG, SLIDE_MM
from cutgate.runtime.interlock.tracking import (
    Bounds,
    FrameSeen,
    ReferenceTrajectory,
    TrackingMonitor,
    _nearest,
)
from tests.runtime.interlock.builders import TIMING, TRACKING

LINKS = (450.0, 400.0)
RESOLUTION = np.radians([ROTATION_DEG] * 5)
RESOLUTION[2] = SLIDE_MM
LATENCY_S = TIMING.timeout_s
PERIOD_S = TIMING.heartbeat_s


def trajectory_from(seed: int, segments: int = 7) -> ReferenceTrajectory:
    """Joint line, entry, segments, exit, joint line; knots within the segments as well, one without a duration."""
    draw = np.random.default_rng(seed)
    knots = 2 * segments + 5
    steps = draw.uniform(0.01, 0.4, knots - 1)
    steps[int(draw.integers(4, knots - 4))] = 0.0
    moves = draw.uniform(-1.0, 1.0, (knots - 1, 5)) * steps[:, None] * [0.05, 0.05, 10.0, 0.3, 0.3]
    joints = np.concatenate(([[0.4, 1.2, 250.0, -0.7, 0.6]], moves)).cumsum(axis=0)
    joints[-1] = joints[0]
    steps[-1] = 2.0
    times = np.concatenate(([0.0], steps.cumsum()))
    return ReferenceTrajectory(times, joints, times[np.arange(segments + 1) * 2 + 2], LINKS)


def rounded(joints):
    return np.rint(joints / RESOLUTION) * RESOLUTION


def place_of(trajectory: ReferenceTrajectory, time_s: float) -> tuple[int, int]:
    """Progress of an arm at that place, by a search from the front."""
    if time_s <= trajectory.time_of(0, 0.0):
        return 0, 0
    for segment in range(trajectory.segments):
        start_s, end_s = trajectory.time_of(segment, 0.0), trajectory.time_of(segment, 1.0)
        if time_s < end_s:
            return segment, round((time_s - start_s) / (end_s - start_s) * FRACTION_MAX)
    return trajectory.segments - 1, FRACTION_MAX


def off(trajectory: ReferenceTrajectory, bounds: Bounds, joints, between_s) -> float:
    """How far from the nearest of many places between two times, over the tolerance there; 1 is the bound."""
    times = np.union1d(np.linspace(*between_s, 4001), trajectory.times_s)
    times = times[(times >= between_s[0]) & (times <= between_s[1])]
    places = np.stack(
        [np.interp(times, trajectory.times_s, trajectory.joints[:, j]) for j in range(5)], axis=1
    )
    d0, d1, d2, d3, d4 = (joints - places).T
    early = times < trajectory.times_s[1]
    mm = np.hypot(LINKS[0] * np.abs(d0) + LINKS[1] * np.abs(d0 + d1), d2) / (
        bounds.near_mm + early * bounds.start_mm
    )
    rad = np.max(np.abs([d0, d1, d3, d4]), axis=0) / (bounds.near_rad + early * bounds.start_rad)
    return float(np.maximum(mm, rad).min())


def sample(monitor: TrackingMonitor, joints, now_s: float, measured_s: float | None = None):
    """The next monitor and what deviates in words; measured as they come unless it is said when."""
    after, found = monitor.sample(joints, now_s if measured_s is None else measured_s, now_s)
    return _consistent(monitor, after, found)


def report(monitor: TrackingMonitor, segment: int, fraction: int, now_s: float):
    """The same for progress."""
    return _consistent(monitor, *monitor.report(segment, fraction, now_s))


def _consistent(before, after, found):
    if found is not None:
        assert after is before, "what deviates is not believed"
        assert not all(rule.holds for rule in found.judged)
        assert all((rule.value is None) is not (rule.text is None) for rule in found.judged)
    return after, reason(found)


def reason(found) -> str:
    return found.reason if found else ""


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1.0, 4.0, 60.0]),
    data=st.data(),
)
def test_a_sound_arm_never_deviates(seed, scale, data):
    """Any speed up to the full one, standing still included; frames lost.

    Progress comes up to the latency late, joints as late as they like: what is proved of their age is true, no more.
    """
    trajectory, draw = trajectory_from(seed), np.random.default_rng(seed + 1)
    late_s = {
        kind: data.draw(st.sampled_from([0.0, 0.02, LATENCY_S, *more]))
        for kind, more in (("joints", [3 * LATENCY_S]), ("progress", []))
    }
    proved_s, losses = data.draw(st.sampled_from([0.0, 0.04])), data.draw(st.sampled_from([0.0, 0.3]))
    now_s, at_s = 100.0, 0.0
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, scale, now_s)
    frames, last_s = [], dict.fromkeys(late_s, 0.0)
    while at_s < trajectory.end_s:
        now_s += PERIOD_S
        at_s = min(
            trajectory.end_s, at_s + scale * PERIOD_S * draw.choice([0.0, draw.uniform(), 1.0, 1.0, 1.0])
        )
        for kind, most_s in late_s.items():
            last_s[kind] = max(last_s[kind], now_s + draw.uniform(0.0, most_s))
            frames.append((last_s[kind], now_s, kind, at_s))
    for arrived_s, measured_s, kind, place_s in sorted(frames):
        if draw.uniform() < losses:
            continue
        if kind == "joints":
            joints = rounded(trajectory.joints_at(place_s))
            monitor, why = sample(monitor, joints, arrived_s, measured_s - draw.uniform(0.0, proved_s))
        else:
            monitor, why = report(monitor, *place_of(trajectory, place_s), arrived_s)
        assert why == ""
    assert monitor.finished(max(last_s.values())) is None


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    part=st.floats(0.0, 0.95),
    direction=st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=5),
    size=st.floats(0.0, 3.0),
)
def test_joints_off_every_place_they_can_be_at_are_seen_at_once_and_joints_on_one_never(
    seed, part, direction, size
):
    trajectory = trajectory_from(seed)
    at_s, now_s = part * trajectory.end_s, 100.0
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, now_s)
    while now_s < 100.0 + at_s:  # the arm went there at full speed
        now_s += PERIOD_S
        monitor, why = sample(monitor, trajectory.joints_at(min(now_s - 100.0, at_s)), now_s)
        assert why == ""
    now_s += PERIOD_S
    bounds = monitor.bounds
    unit = np.array(direction) * [0.001, 0.001, bounds.near_mm, bounds.near_rad, bounds.near_rad]
    joints = trajectory.joints_at(at_s) + size * unit
    distance = off(trajectory, bounds, joints, (monitor.sampled.earliest_s, monitor.reach_s(now_s)))
    assume(abs(distance - 1.0) > 1e-3)
    _, why = sample(monitor, joints, now_s)
    if distance > 1.0:
        assert "off the verified path near" in why
    elif (
        distance < 0.4
    ):  # in between the nearest place by squares may be another than the nearest by the bound
        assert why == ""


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("side", [-1, 1])
def test_each_joint_is_held_to_its_bound_and_not_to_less(joint, side):
    """An arm that may not yet have moved, on a trajectory along another joint."""
    trajectory = replace_line(along=2 if joint != 2 else 4)
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, 10.0)
    monitor = replace(monitor, bounds=replace(monitor.bounds, start_mm=0.0, start_rad=0.0))
    lever_mm = {0: LINKS[0] + LINKS[1], 1: LINKS[1], 2: 1.0}.get(joint)
    bound = monitor.bounds.near_rad if lever_mm is None else monitor.bounds.near_mm / lever_mm
    for part, seen in ((0.999, False), (1.001, True)):
        joints = trajectory.joints[0].copy()
        joints[joint] += side * part * bound
        assert bool(sample(monitor, joints, 10.02)[1]) is seen


def replace_line(along: int) -> ReferenceTrajectory:
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (5, 1))
    joints[1:4, along] += [1.0, 2.0, 3.0]
    return ReferenceTrajectory(np.arange(5.0), joints, np.array([2.0, 3.0]), LINKS)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", range(5))
def test_a_joint_that_is_no_number_deviates(joint, value):
    trajectory = trajectory_from(1)
    joints = trajectory.joints[0].copy()
    joints[joint] = value
    with np.errstate(invalid="ignore"):
        assert sample(TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, 10.0), joints, 10.0)[1]


@pytest.mark.parametrize("now_s", [math.nan, -math.inf])
def test_a_time_that_is_no_time_deviates(now_s):
    monitor = TrackingMonitor.begin(trajectory_from(1), TIMING, TRACKING, 1.0, 10.0)
    assert monitor.overdue(now_s, None) or now_s < 0
    assert monitor.finished(now_s)
    assert report(monitor, 1, 1, now_s)[1]


@pytest.mark.parametrize("gain", [1.5, 3.0, 10.0])
@pytest.mark.parametrize("kind", ["joints", "progress"])
def test_an_arm_that_is_too_fast_is_seen_once_it_has_gained_the_latency(kind, gain):
    """However small each step is; nothing accumulates but what was gained."""
    trajectory = trajectory_from(3, segments=40)
    start_s = trajectory.time_of(0, 0.0)
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, -start_s)
    monitor, why = report(monitor, *place_of(trajectory, start_s), 0.0)
    monitor, why = sample(monitor, trajectory.joints_at(start_s), 0.0)
    assert why == ""
    now_s = 0.0
    while not why:
        now_s += PERIOD_S
        at_s = start_s + gain * now_s
        if kind == "joints":
            monitor, why = sample(monitor, trajectory.joints_at(at_s), now_s)
        else:
            monitor, why = report(monitor, *place_of(trajectory, at_s), now_s)
        tolerated_s = (
            0.1 if kind == "progress" else 0.3
        )  # the bound's width on the trajectory comes on top for joints
        assert (gain - 1.0) * (now_s - PERIOD_S) <= tolerated_s + 0.01, why


def test_progress_never_goes_back_by_a_single_count():
    monitor = TrackingMonitor.begin(trajectory_from(2), TIMING, TRACKING, 60.0, 0.0)
    monitor, why = report(monitor, 1, 100, 0.2)
    assert why == ""
    assert report(monitor, 1, 100, 0.2)[1] == ""
    for segment, fraction in ((1, 99), (0, 200)):
        assert "it never goes back" in report(monitor, segment, fraction, 0.3)[1]


@pytest.mark.parametrize("segment", [-1, 7, 1 << 24])
def test_a_segment_that_the_path_does_not_have_deviates(segment):
    monitor = TrackingMonitor.begin(trajectory_from(2), TIMING, TRACKING, 60.0, 0.0)
    assert "the path has segments 0 to 6" in report(monitor, segment, 0, 9.0)[1]


def test_joints_behind_the_progress_and_progress_behind_the_joints_are_seen():
    trajectory = replace_line(along=3)
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, 0.0)
    cut, _ = report(monitor, 0, FRACTION_MAX // 2, 2.5)
    assert "off the verified path" in sample(cut, trajectory.joints_at(1.0), 2.5)[1]
    at_cut, why = sample(monitor, trajectory.joints_at(2.8), 2.8)
    assert why == ""
    assert "but the measured joints were at" in report(at_cut, 0, FRACTION_MAX // 4, 2.8)[1]


def test_the_end_is_not_believed_before_it_can_be_reached():
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    assert "the controller reports the end" in reason(monitor.finished(3.8))
    assert monitor.finished(3.95) is None


def test_silence_is_seen_after_two_time_outs_and_names_what_is_missing():
    monitor = TrackingMonitor.begin(trajectory_from(2), TIMING, TRACKING, 1.0, 10.0)
    assert monitor.overdue(10.2, None) is None
    assert "no measured joints for 201 ms near the approach, at most 200 ms" in reason(
        monitor.overdue(10.201, None)
    )
    monitor, _ = sample(monitor, monitor.trajectory.joints[0], 10.1)
    assert monitor.overdue(10.25, 10.1) is None
    assert "no progress for 250 ms" in reason(monitor.overdue(10.25, 10.0))


def test_a_sample_is_judged_by_when_it_was_measured_not_by_when_it_came():
    """The arm was there a second ago; since then the progress has gone on."""
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    monitor, why = report(monitor, 0, FRACTION_MAX // 2, 2.5)
    assert why == ""
    there = monitor.trajectory.joints_at(1.6)
    assert "off the verified path" in sample(monitor, there, 2.6)[1]
    assert sample(monitor, there, 2.6, measured_s=1.6)[1] == ""
    assert sample(monitor, there, 2.6, measured_s=-math.inf)[1] == ""


@pytest.mark.parametrize(("age_s", "counts"), [(0.0, True), (0.2, True), (0.2001, False), (math.inf, False)])
def test_a_sample_older_than_two_time_outs_does_not_break_the_silence(age_s, counts):
    """It is judged all the same: what is off the path at any time stops at once."""
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    there = monitor.trajectory.joints[0]
    monitor, why = sample(monitor, there, 1.0, measured_s=1.0 - age_s)
    assert why == ""
    assert ("no measured joints for 1199 ms" in reason(monitor.overdue(1.199, None))) is not counts
    assert "off the verified path" in sample(monitor, there + 0.1, 1.02, measured_s=1.02 - age_s)[1]


def test_joints_that_come_later_and_later_are_stopped_once_they_are_two_time_outs_old():
    """Each a little later than the one before, all on the path, nothing ever silent."""
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    found, now_s, late_s = None, 0.0, 0.0
    while found is None:
        now_s, late_s = now_s + PERIOD_S, late_s + 0.005
        monitor, why = sample(
            monitor, monitor.trajectory.joints_at(now_s - late_s), now_s, measured_s=now_s - late_s
        )
        assert why == ""
        found = monitor.overdue(now_s, None)
    assert "no measured joints" in found.reason
    assert late_s <= 0.2 + 0.2 * 0.25 + 0.005


def test_a_clock_that_goes_back_is_no_place_for_any_joints():
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    monitor, why = sample(monitor, monitor.trajectory.joints_at(2.8), 2.8)
    assert why == ""
    why = sample(monitor, monitor.trajectory.joints_at(2.8), 1.0)[1]
    assert "do not belong together: the joints were last at segment 0, fraction 0." in why
    assert "the progress is segment 0, fraction 0.000" in why


# ---------------------------------------------------------------- what is said of it


def rules(deviation) -> list[tuple[str, float | str | None, str]]:
    return [
        (rule.name, rule.text if rule.value is None else rule.value, rule.bound) for rule in deviation.judged
    ]


def test_joints_off_the_path_are_named_with_both_values_and_both_bounds():
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    joints = monitor.trajectory.joints_at(2.5)
    joints[[2, 4]] += [0.5, math.radians(1.0)]
    _, found = monitor.sample(joints, 2.5, 2.5)
    assert rules(found) == [
        (
            "measured wrist centre to the verified path",
            pytest.approx(0.5),
            "<= 0.610 mm near segment 0, fraction 0.500",
        ),
        (
            "measured joints to the verified path",
            pytest.approx(1.0),
            "<= 0.255 deg near segment 0, fraction 0.500",
        ),
    ]
    assert [rule.holds for rule in found.judged] == [True, False]
    assert found.reason == (
        "measured joints are 0.500 mm and 1.000 deg off the verified path near segment 0, fraction 0.500, "
        "at most 0.610 mm and 0.255 deg"
    )


def test_every_other_deviation_names_its_value_and_bound():
    monitor = TrackingMonitor.begin(replace_line(along=3), TIMING, TRACKING, 1.0, 0.0)
    cut, _ = monitor.report(0, FRACTION_MAX // 2, 2.5)
    ahead, _ = monitor.sample(monitor.trajectory.joints_at(2.8), 2.8, 2.8)
    found = [
        cut.report(1, 0, 2.6)[1],
        cut.report(0, 0, 2.6)[1],
        cut.report(0, FRACTION_MAX, 2.6)[1],
        ahead.report(0, FRACTION_MAX // 4, 2.8)[1],
        cut.finished(2.6),
        cut.overdue(2.71, 0.0),
        monitor.overdue(0.5, None),
    ]
    assert [rules(one) for one in found] == [
        [("segment of the progress", 1.0, "0 to 0")],
        [
            (
                "progress, beside the one before",
                "segment 0, fraction 0.000",
                "never before segment 0, fraction 0.500",
            )
        ],
        [("progress, beside the time", "segment 0, fraction 1.000", "at most segment 0, fraction 0.700")],
        [
            (
                "progress, beside the measured joints",
                "segment 0, fraction 0.250",
                "at most 100 ms behind segment 0, fraction 0.796",
            )
        ],
        [("end of the retract, beside the time", "reported", "at most segment 0, fraction 0.700")],
        [("silence of the measured joints", 2.71, "<= 0.2 s")],
        [("silence of the measured joints", 0.5, "<= 0.2 s")],
    ]


@pytest.mark.parametrize(
    ("time_s", "name"),
    [
        (0.0, "the approach"),
        (0.999, "the approach"),
        (1.0, "the entry"),
        (1.999, "the entry"),
        (2.0, "segment 0, fraction 0.000"),
        (2.25, "segment 0, fraction 0.250"),
        (3.0, "segment 0, fraction 1.000"),
        (3.001, "the exit"),
        (4.0, "the exit"),
        (4.001, "the retract"),
        (5.0, "the retract"),
    ],
)
def test_a_place_has_its_legs_name(time_s, name):
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (6, 1))
    assert ReferenceTrajectory(np.arange(6.0), joints, np.array([2.0, 3.0]), LINKS).name(time_s) == name


@pytest.mark.parametrize(
    ("time_s", "place"),
    [
        (0.5, ("approach", None, None)),
        (1.0, ("entry", None, None)),
        (2.25, ("cut", 0, 0.25)),
        (4.0, ("exit", None, None)),
        (4.5, ("retract", None, None)),
    ],
)
def test_a_place_is_a_leg_and_on_the_cut_a_part_of_a_segment(time_s, place):
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (6, 1))
    assert ReferenceTrajectory(np.arange(6.0), joints, np.array([2.0, 3.0]), LINKS).place(time_s) == place


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6), part=st.floats(0.0, 1.0), slip=st.floats(0.0, 3.0), joint=st.integers(0, 4)
)
def test_what_a_sample_was_held_against_is_kept_whether_it_deviates_or_not(seed, part, slip, joint):
    """The joints as measured, and a place of the trajectory that they are so far from as is said."""
    trajectory = trajectory_from(seed)
    monitor = TrackingMonitor.begin(trajectory, TIMING, TRACKING, 60.0, 0.0)
    assert monitor.nearest is None
    bounds, now_s = monitor.bounds, trajectory.end_s
    joints = trajectory.joints_at(part * trajectory.end_s)
    joints[joint] += slip * (bounds.near_mm if joint == 2 else bounds.near_rad)
    after, found = monitor.sample(joints, now_s, now_s)
    nearest = (found or after).nearest
    assert nearest.joints is joints
    assert (found is None) is (nearest.off <= 1.0)
    assert nearest.off == max(nearest.off_mm, nearest.off_rad)
    d0, d1, d2, d3, d4 = np.abs(joints - trajectory.joints_at(nearest.time_s))
    assert nearest.off_rad * nearest.near_rad == pytest.approx(max(d0, d1, d3, d4), abs=1e-9)
    assert nearest.off_mm * nearest.near_mm >= d2 - 1e-9
    if found is None:
        assert nearest.earliest_s <= nearest.time_s <= nearest.latest_s
    else:
        assert (nearest.earliest_s, nearest.latest_s) == (math.inf, -math.inf)


def test_two_states_are_the_same_whatever_the_last_sample_was_held_against():
    monitor = TrackingMonitor.begin(trajectory_from(1), TIMING, TRACKING, 1.0, 0.0)
    after, _ = monitor.sample(monitor.trajectory.joints_at(0.0), 0.0, 0.0)
    assert replace(after, nearest=None) == after


def test_a_segment_without_a_duration_has_a_name_and_a_place():
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (7, 1))
    joints[3:, 3] += 0.1
    times_s = np.array([0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 5.0])
    trajectory = ReferenceTrajectory(times_s, joints, np.array([2.0, 2.0, 3.0]), LINKS)
    assert trajectory.name(2.0) == "segment 1, fraction 0.000"
    assert (trajectory.time_of(0, 0.5), trajectory.time_of(1, 0.5)) == (2.0, 2.5)
    assert trajectory.joints_at(2.0)[3] == joints[3, 3]


def test_what_has_been_seen_is_equal_if_it_is_the_same_and_on_the_same_trajectory():
    one, other = trajectory_from(1), trajectory_from(1)
    begun = [TrackingMonitor.begin(on, TIMING, TRACKING, 1.0, 5.0) for on in (one, one, other)]
    assert begun[0] == begun[1] != begun[2]
    assert hash(begun[0]) == hash(begun[1])
    assert replace(begun[0], sampled=FrameSeen(1.0, 5.0)) != begun[0]


# ---------------------------------------------------------------- to the last bit


def at_any_tolerance(monitor: TrackingMonitor, **bounds: float) -> TrackingMonitor:
    """With other bounds; those of the start are none, and one second is one second."""
    none = {"start_mm": 0.0, "start_rad": 0.0, "rate": 1.0}
    return replace(monitor, bounds=replace(monitor.bounds, **(none | bounds)))


def along_the_slide(segments: int = 2) -> ReferenceTrajectory:
    """1 mm in each second, all the way: a time is a place in mm."""
    knots = segments + 5
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (knots, 1))
    joints[:, 2] += np.arange(knots)
    return ReferenceTrajectory(np.arange(float(knots)), joints, np.arange(2.0, segments + 3.0), LINKS)


def test_what_joints_frames_and_the_trajectory_are_rounded_by_is_tolerated_and_no_more():
    bounds = Bounds.of(TIMING, TRACKING, 1.0, LINKS)
    turned_mm = math.radians(ROTATION_DEG) * (LINKS[0] + 2.0 * LINKS[1])
    assert bounds.near_mm == pytest.approx(0.5 + math.hypot(turned_mm, SLIDE_MM), rel=1e-12)
    assert bounds.near_rad == pytest.approx(math.radians(0.25 + ROTATION_DEG), rel=1e-12)
    assert (bounds.start_mm, bounds.start_rad) == (0.5, math.radians(0.2))
    assert (bounds.latency_s, bounds.missing_s) == (0.1, 0.2)


@pytest.mark.parametrize("joint", [0, 1, 3, 4])
def test_each_turning_joint_has_its_own_bound_however_wide_that_of_the_wrist_is(joint):
    monitor = TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 10.0)
    monitor = at_any_tolerance(monitor, near_mm=1e6, near_rad=0.125)
    joints = monitor.trajectory.joints[0].copy()
    joints[joint] += 0.126
    assert "off the verified path" in sample(monitor, joints, 10.0)[1]


def test_what_is_just_within_its_tolerance_is_on_the_path_and_tells_where_the_arm_is():
    monitor = at_any_tolerance(
        TrackingMonitor.begin(replace_line(along=4), TIMING, TRACKING, 1.0, 10.0), near_mm=0.5
    )
    joints = monitor.trajectory.joints[0].copy()
    joints[2] += 0.5
    after, why = sample(monitor, joints, 10.0)
    assert why == ""
    assert after.sampled.earliest_s == 0.0
    joints[3] += 1.0
    _, found = monitor.sample(joints, 10.0, 10.0)
    assert [rule.holds for rule in found.judged] == [True, False]


def test_more_is_tolerated_on_the_way_to_the_entry_and_from_there_on_no_more():
    monitor = TrackingMonitor.begin(replace_line(along=4), TIMING, TRACKING, 1.0, 0.0)
    more = {2: monitor.bounds.near_mm + 0.9 * monitor.bounds.start_mm}
    more[3] = monitor.bounds.near_rad + 0.9 * monitor.bounds.start_rad
    for joint, by in more.items():
        for at_s, earliest_s, tolerated in ((0.5, 0.0, True), (1.5, 1.0, False)):
            there = replace(monitor, sampled=FrameSeen(earliest_s, at_s))
            joints = monitor.trajectory.joints_at(at_s)
            joints[joint] += by
            assert (sample(there, joints, at_s)[1] == "") is tolerated, (joint, at_s)


def test_no_place_is_beyond_what_can_have_been_reached_nor_before_what_was():
    """On the line, but further on it or further back than the arm can be: at either end of the part that is tried."""
    trajectory = along_the_slide()
    bounds = at_any_tolerance(
        TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, 0.0), near_mm=0.25
    ).bounds
    for at_s, off in ((3.0, 0.0), (3.5, 1.0), (2.5, 0.0), (2.0, 1.0), (4.5, 5.0)):
        found = _nearest(trajectory, bounds, trajectory.joints_at(at_s), (2.25, 3.25))
        assert (found.off, found.off_mm) == pytest.approx((off, off), abs=1e-9)


@pytest.mark.parametrize(
    ("at_s", "between_s", "earliest_s", "latest_s"),
    [
        (2.5, (0.0, 6.0), 2.25, 2.75),
        (2.5, (2.375, 2.625), 2.375, 2.625),
        (2.875, (0.0, 6.0), 2.625, 3.25),
        (2.125, (0.0, 6.0), 1.75, 2.375),
    ],
)
def test_a_sample_tells_between_which_places_the_arm_is(at_s, between_s, earliest_s, latest_s):
    """As far as the tolerance reaches along the path; over a knot by one tolerance at most."""
    trajectory = along_the_slide()
    bounds = at_any_tolerance(
        TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, 0.0), near_mm=0.25
    ).bounds
    found = _nearest(trajectory, bounds, trajectory.joints_at(at_s), between_s)
    assert (found.earliest_s, found.latest_s) == pytest.approx((earliest_s, latest_s), abs=1e-9)
    assert found.earliest_s <= at_s <= found.latest_s


@pytest.mark.parametrize("kind", ["joints", "progress"])
def test_an_arm_that_stood_and_then_is_too_fast_is_seen_as_soon_as_one_that_never_stood(kind):
    """What it might have gained while it stood is no credit: every frame says where it was at the latest."""
    trajectory = along_the_slide(segments=60)
    monitor = at_any_tolerance(
        TrackingMonitor.begin(trajectory, TIMING, TRACKING, 1.0, -2.0), near_mm=0.03125
    )
    now_s, place_s, why = 0.0, 2.0, ""
    while not why:
        now_s += PERIOD_S
        place_s += 0.0 if now_s < 5.0 else 2.0 * PERIOD_S
        assert now_s < 5.0 + 0.2 + PERIOD_S, "it has gained more than the latency and the tolerance"
        if kind == "joints":
            monitor, why = sample(monitor, trajectory.joints_at(place_s), now_s)
        else:
            monitor, why = report(monitor, *place_of(trajectory, place_s), now_s)
    assert now_s > 5.0


def test_a_place_that_can_just_be_reached_is_believed_to_the_last_bit():
    monitor = at_any_tolerance(TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 0.0))
    monitor = replace(monitor, lead_s=-1.0)
    assert monitor.reach_s(4.0) == 3.0
    assert report(monitor, 1, 0, 4.0)[1] == ""
    furthest = replace(monitor, sampled=FrameSeen(3.0, 4.0))
    assert sample(furthest, monitor.trajectory.joints_at(3.0), 4.0)[1] == ""
    behind = replace(monitor, sampled=FrameSeen(3.0, 0.0))
    assert report(behind, 0, FRACTION_MAX, 4.0)[1] == ""
    assert monitor.finished(7.0) is None
    assert monitor.finished(math.nextafter(7.0, 0.0)) is not None


def test_progress_is_as_exact_as_its_counts_are():
    """The arm was half a count before or behind what was said, and a frame may be one time-out old."""
    monitor = at_any_tolerance(TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 0.0))
    after, _ = monitor.report(1, 1000, 4.0)
    assert after.progressed.earliest_s == pytest.approx(3.0 + 999.5 / FRACTION_MAX, abs=1e-9)
    assert after.reach_s(4.0) == pytest.approx(3.0 + 1000.5 / FRACTION_MAX + 0.1, abs=1e-9)


def test_silence_is_none_up_to_the_last_bit_and_its_bound_is_named_in_whole_milliseconds():
    monitor = at_any_tolerance(
        TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 10.0), latency_s=0.5
    )
    assert monitor.overdue(11.0, None) is None
    found = monitor.overdue(math.nextafter(11.0, 12.0), None)
    assert found.reason == "no measured joints for 1000 ms near the approach, at most 1000 ms"
    assert rules(found) == [("silence of the measured joints", pytest.approx(1.0), "<= 1 s")]
    heard, _ = sample(monitor, monitor.trajectory.joints[0], 11.5, measured_s=10.5)
    assert heard.heard_s == 11.5
    unheard, _ = sample(monitor, monitor.trajectory.joints[0], 11.5, measured_s=math.nextafter(10.5, 10.0))
    assert unheard.heard_s == 10.0


def test_a_clock_that_goes_back_is_named_with_its_bound():
    monitor = at_any_tolerance(
        TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 0.0), latency_s=1.0
    )
    seen = replace(monitor, sampled=FrameSeen(3.0, 4.0))
    _, found = seen.sample(monitor.trajectory.joints[0], 0.0, 0.0)
    assert rules(found) == [
        (
            "measured joints and progress",
            "joints at segment 1, fraction 0.000, progress segment 0, fraction 0.000",
            "at one place, at most 1000 ms apart",
        )
    ]


def test_places_of_several_segments_are_named_by_their_own():
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (8, 1))
    times_s = np.array([0.0, 1.0, 2.0, 4.0, 4.5, 4.5, 5.0, 6.0])
    trajectory = ReferenceTrajectory(times_s, joints, np.array([2.0, 4.0, 4.5, 4.5]), LINKS)
    named = {2.0: (0, 0.0), 2.5: (0, 0.25), 3.999: (0, 0.9995), 4.0: (1, 0.0), 4.25: (1, 0.5), 4.5: (2, 0.0)}
    for time_s, (segment, fraction) in named.items():
        assert trajectory.name(time_s) == f"segment {segment}, fraction {fraction:.3f}"
    assert trajectory.name(math.nan) == "segment 2, fraction 0.000"
    assert [trajectory.time_of(0, fraction) for fraction in (-0.5, 0.0, 0.5, 1.0, 1.5)] == [
        2.0,
        2.0,
        3.0,
        4.0,
        4.0,
    ]


def test_a_leg_that_takes_no_time_has_its_joints_from_before():
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (4, 1))
    joints[-1, 3] += 1.0
    trajectory = ReferenceTrajectory(np.array([0.0, 1.0, 2.0, 2.0]), joints, np.array([1.0, 2.0]), LINKS)
    assert trajectory.joints_at(2.0)[3] == joints[2, 3]


def test_what_was_seen_and_said_stays_as_it_was():
    monitor = TrackingMonitor.begin(along_the_slide(), TIMING, TRACKING, 1.0, 0.0)
    deviation = monitor.finished(0.0)
    for thing, field in (
        (monitor, "lead_s"),
        (monitor.trajectory, "links_mm"),
        (monitor.bounds, "near_mm"),
        (monitor.sampled, "at_s"),
        (deviation, "reason"),
    ):
        with pytest.raises(FrozenInstanceError):
            setattr(thing, field, getattr(thing, field))
    assert deviation == monitor.finished(0.0)


def test_a_sites_tolerance_is_not_changed_afterwards():
    with pytest.raises(FrozenInstanceError):
        TRACKING.wrist_mm = 5.0
