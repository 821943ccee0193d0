"""The tracking watch alone: random courses, random arms on them, and a brute-force oracle for what is off."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cutgate.protocol.frames import FRACTION_MAX, ROTATION_DEG, SLIDE_MM
from cutgate.runtime.interlock.tracking import Bounds, Course, Watch
from tests.runtime.interlock.builders import TIMING

LINKS = (450.0, 400.0)
RESOLUTION = np.radians([ROTATION_DEG] * 5)
RESOLUTION[2] = SLIDE_MM
LATENCY_S = TIMING.timeout_ms / 1000
PERIOD_S = TIMING.heartbeat_ms / 1000


def course_from(seed: int, segments: int = 7) -> Course:
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
    return Course(times, joints, times[np.arange(segments + 1) * 2 + 2], LINKS)


def rounded(joints):
    return np.rint(joints / RESOLUTION) * RESOLUTION


def place_of(course: Course, time_s: float) -> tuple[int, int]:
    """Progress of an arm at that place, by a search from the front."""
    if time_s <= course.time_of(0, 0.0):
        return 0, 0
    for segment in range(course.segments):
        start_s, end_s = course.time_of(segment, 0.0), course.time_of(segment, 1.0)
        if time_s < end_s:
            return segment, round((time_s - start_s) / (end_s - start_s) * FRACTION_MAX)
    return course.segments - 1, FRACTION_MAX


def off(course: Course, bounds: Bounds, joints, between_s) -> float:
    """How far from the nearest of many places between two times, over the tolerance there; 1 is the bound."""
    times = np.union1d(np.linspace(*between_s, 4001), course.times_s)
    times = times[(times >= between_s[0]) & (times <= between_s[1])]
    places = np.stack([np.interp(times, course.times_s, course.joints[:, j]) for j in range(5)], axis=1)
    d0, d1, d2, d3, d4 = (joints - places).T
    early = times < course.times_s[1]
    mm = np.hypot(LINKS[0] * np.abs(d0) + LINKS[1] * np.abs(d0 + d1), d2) / (
        bounds.near_mm + early * bounds.start_mm
    )
    rad = np.max(np.abs([d0, d1, d3, d4]), axis=0) / (bounds.near_rad + early * bounds.start_rad)
    return float(np.maximum(mm, rad).min())


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1.0, 4.0, 60.0]),
    data=st.data(),
)
def test_a_sound_arm_never_deviates(seed, scale, data):
    """Any speed up to the full one, standing still included; frames up to the latency late; frames lost."""
    course, draw = course_from(seed), np.random.default_rng(seed + 1)
    late_s = data.draw(st.sampled_from([0.0, 0.02, LATENCY_S]))
    losses = data.draw(st.sampled_from([0.0, 0.3]))
    now_s, at_s = 100.0, 0.0
    watch = Watch.begin(course, TIMING, scale, now_s)
    frames, arrived_s = [], 0.0
    while at_s < course.end_s:
        now_s += PERIOD_S
        at_s = min(course.end_s, at_s + scale * PERIOD_S * draw.choice([0.0, draw.uniform(), 1.0, 1.0, 1.0]))
        arrived_s = max(arrived_s, now_s + draw.uniform(0.0, late_s))
        frames.append((arrived_s, at_s))
    for arrived_s, at_s in frames:
        if draw.uniform() >= losses:
            watch, why = watch.sample(rounded(course.joints_at(at_s)), arrived_s)
            assert why == ""
        if draw.uniform() >= losses:
            watch, why = watch.report(*place_of(course, at_s), arrived_s)
            assert why == ""
    assert watch.finished(arrived_s) == ""


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
    course = course_from(seed)
    at_s, now_s = part * course.end_s, 100.0
    watch = Watch.begin(course, TIMING, 1.0, now_s)
    while now_s < 100.0 + at_s:  # the arm went there at full speed
        now_s += PERIOD_S
        watch, why = watch.sample(course.joints_at(min(now_s - 100.0, at_s)), now_s)
        assert why == ""
    now_s += PERIOD_S
    bounds = watch.bounds
    unit = np.array(direction) * [0.001, 0.001, bounds.near_mm, bounds.near_rad, bounds.near_rad]
    joints = course.joints_at(at_s) + size * unit
    distance = off(course, bounds, joints, (watch.sampled.earliest_s, watch.reach_s(now_s)))
    assume(abs(distance - 1.0) > 1e-3)
    _, why = watch.sample(joints, now_s)
    if distance > 1.0:
        assert "off the verified path near" in why
    elif (
        distance < 0.4
    ):  # in between the nearest place by squares may be another than the nearest by the bound
        assert why == ""


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("side", [-1, 1])
def test_each_joint_is_held_to_its_bound_and_not_to_less(joint, side):
    """An arm that may not yet have moved, on a course along another joint."""
    course = replace_line(along=2 if joint != 2 else 4)
    watch = Watch.begin(course, TIMING, 1.0, 10.0)
    watch = replace(watch, bounds=replace(watch.bounds, start_mm=0.0, start_rad=0.0))
    lever_mm = {0: LINKS[0] + LINKS[1], 1: LINKS[1], 2: 1.0}.get(joint)
    bound = watch.bounds.near_rad if lever_mm is None else watch.bounds.near_mm / lever_mm
    for part, seen in ((0.999, False), (1.001, True)):
        joints = course.joints[0].copy()
        joints[joint] += side * part * bound
        assert bool(watch.sample(joints, 10.02)[1]) is seen


def replace_line(along: int) -> Course:
    joints = np.tile([0.4, 1.2, 250.0, -0.7, 0.6], (5, 1))
    joints[1:4, along] += [1.0, 2.0, 3.0]
    return Course(np.arange(5.0), joints, np.array([2.0, 3.0]), LINKS)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", range(5))
def test_a_joint_that_is_no_number_deviates(joint, value):
    course = course_from(1)
    joints = course.joints[0].copy()
    joints[joint] = value
    with np.errstate(invalid="ignore"):
        assert Watch.begin(course, TIMING, 1.0, 10.0).sample(joints, 10.0)[1]


@pytest.mark.parametrize("now_s", [math.nan, -math.inf])
def test_a_time_that_is_no_time_deviates(now_s):
    watch = Watch.begin(course_from(1), TIMING, 1.0, 10.0)
    assert watch.overdue(now_s, None) or now_s < 0
    assert watch.finished(now_s)
    assert watch.report(1, 1, now_s)[1]


@pytest.mark.parametrize("gain", [1.5, 3.0, 10.0])
@pytest.mark.parametrize("kind", ["joints", "progress"])
def test_an_arm_that_is_too_fast_is_seen_once_it_has_gained_the_latency(kind, gain):
    """However small each step is; nothing accumulates but what was gained."""
    course = course_from(3, segments=40)
    start_s = course.time_of(0, 0.0)
    watch = Watch.begin(course, TIMING, 1.0, -start_s)
    watch, why = watch.report(*place_of(course, start_s), 0.0)
    watch, why = watch.sample(course.joints_at(start_s), 0.0)
    assert why == ""
    now_s = 0.0
    while not why:
        now_s += PERIOD_S
        at_s = start_s + gain * now_s
        if kind == "joints":
            watch, why = watch.sample(course.joints_at(at_s), now_s)
        else:
            watch, why = watch.report(*place_of(course, at_s), now_s)
        tolerated_s = (
            0.1 if kind == "progress" else 0.3
        )  # the bound's width on the course comes on top for joints
        assert (gain - 1.0) * (now_s - PERIOD_S) <= tolerated_s + 0.01, why


def test_progress_never_goes_back_by_a_single_count():
    watch = Watch.begin(course_from(2), TIMING, 60.0, 0.0)
    watch, why = watch.report(1, 100, 0.2)
    assert why == ""
    assert watch.report(1, 100, 0.2)[1] == ""
    for segment, fraction in ((1, 99), (0, 200)):
        assert "it never goes back" in watch.report(segment, fraction, 0.3)[1]


@pytest.mark.parametrize("segment", [-1, 7, 1 << 24])
def test_a_segment_that_the_path_does_not_have_deviates(segment):
    assert (
        "the path has segments 0 to 6"
        in Watch.begin(course_from(2), TIMING, 60.0, 0.0).report(segment, 0, 9.0)[1]
    )


def test_joints_behind_the_progress_and_progress_behind_the_joints_are_seen():
    course = replace_line(along=3)
    watch = Watch.begin(course, TIMING, 1.0, 0.0)
    cut, _ = watch.report(0, FRACTION_MAX // 2, 2.5)
    assert "off the verified path" in cut.sample(course.joints_at(1.0), 2.5)[1]
    at_cut, why = watch.sample(course.joints_at(2.8), 2.8)
    assert why == ""
    assert "but the measured joints were at" in at_cut.report(0, FRACTION_MAX // 4, 2.8)[1]


def test_the_end_is_not_believed_before_it_can_be_reached():
    watch = Watch.begin(replace_line(along=3), TIMING, 1.0, 0.0)
    assert "the controller reports the end" in watch.finished(3.8)
    assert watch.finished(3.95) == ""


def test_silence_is_seen_after_two_time_outs_and_names_what_is_missing():
    watch = Watch.begin(course_from(2), TIMING, 1.0, 10.0)
    assert watch.overdue(10.2, None) == ""
    assert "no measured joints for 201 ms near the approach, at most 200 ms" in watch.overdue(10.201, None)
    watch, _ = watch.sample(watch.course.joints[0], 10.1)
    assert watch.overdue(10.25, 10.1) == ""
    assert "no progress for 250 ms" in watch.overdue(10.25, 10.0)
