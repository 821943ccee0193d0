"""Plan, registration and robot to the path that the controller executes."""

import hashlib
import math
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError, Loaded, robot_from_bytes
from cutgate.protocol.records import Path as PathRecord
from cutgate.runtime.plan.model import Plan
from cutgate.runtime.plan.prepare import DEFAULT_FEED_MM_S, IDENTITY_REGISTRATION, with_branch
from cutgate.runtime.plan.prepare import prepare as prepared
from cutgate.runtime.plan.registration import Registration

PRESET = Path(__file__).parents[3] / "config" / "presets" / "example.toml"
ROBOT = robot_from_bytes("example.toml", PRESET.read_bytes())
NOW = datetime(2026, 6, 1, tzinfo=UTC)
SKEW_S = 60.0
prepare = partial(prepared, now=NOW, clock_skew_s=SKEW_S)
UP = [0.0, 0.0, 1.0]


def rotation(axis, angle):
    """Rodrigues' formula: an oracle that shares nothing with the code."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def rigid(axis, angle, translation):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(axis, angle)
    matrix[:3, 3] = translation
    return matrix


def plan(tips=((0, 0, 0), (1, 0, 0)), axes=(UP, UP), placement=None, **fields) -> Loaded[Plan]:
    values = {
        "id": "p",
        "implant": None,
        "side": None,
        "tool_length_mm": None,
        "feed_mm_s": 20.0,
        "ct_id": None,
    }
    value = Plan(
        **(values | fields),
        ct_T_implant=np.eye(4) if placement is None else placement,
        tips_mm=np.array(tips, float),
        axes=np.array(axes, float),
    )
    return Loaded(value, b"plan bytes", Path("p.json"))


def registration(matrix=None, created="2026-01-01T00:00:00Z", ct_id=None) -> Loaded[Registration]:
    rows = tuple(map(tuple, (np.eye(4) if matrix is None else matrix).tolist()))
    value = Registration.model_construct(
        schema_="cutgate.registration/1",
        id="r",
        R_T_CT=rows,
        residual_rms_mm=0.1,
        created_utc=created,
        ct_id=ct_id,
    )
    return Loaded(value, b"registration bytes", Path("r.json"))


def refusal(*arguments, **options) -> str:
    with pytest.raises(InputError) as caught:
        prepare(*arguments, **options)
    return str(caught.value)


vectors = st.tuples(*[st.floats(-300, 300)] * 3)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 1)


@given(axes, st.floats(-3, 3), vectors, axes, st.floats(-3, 3), vectors, vectors, axes)
def test_a_pose_goes_through_implant_ct_and_robot_frame_in_this_order(a1, w1, t1, a2, w2, t2, tip, axis):
    ct_from_implant, robot_from_ct = rigid(a1, w1, t1), rigid(a2, w2, t2)
    unit = np.asarray(axis) / np.linalg.norm(axis)
    ready = prepare(plan([tip, tip], [unit, unit], ct_from_implant), registration(robot_from_ct), ROBOT)
    in_ct = rotation(a1, w1) @ tip + t1
    expected = rotation(a2, w2) @ in_ct + t2
    assert np.abs(ready.path.tips_mm - expected).max() <= 0.5e-3 + 1e-9
    assert np.abs(ready.path.axes - rotation(a2, w2) @ rotation(a1, w1) @ unit).max() <= 1e-6


def test_without_a_registration_poses_stay_where_they_are_and_the_digest_says_identity():
    ready = prepare(plan([(1.25, 2.5, 3.0), (4, 5, 6)]), None, ROBOT)
    assert ready.path.tips_mm.tolist() == [[1.25, 2.5, 3.0], [4, 5, 6]]
    assert ready.registration_digest == hashlib.sha256(IDENTITY_REGISTRATION).digest()
    assert ready.digests == {ready.registration_digest}
    assert ready.ct_link == "not linked"


def test_the_registration_digest_is_that_of_its_content_and_its_file_is_known_as_well():
    placed = registration()
    ready = prepare(plan(), placed, ROBOT)
    assert ready.registration_digest == placed.value.digest
    assert ready.digests == {placed.value.digest, hashlib.sha256(b"registration bytes").digest()}


def test_elbow_feed_and_tool_stand_in_the_path():
    path = prepare(plan(), None, ROBOT).path
    assert (path.elbow, path.feed_mm_s, path.tool_length_mm) == ("right", 20.0, 160.0)
    assert (path.q0_turns, path.roll_turns) == (0, 0)
    assert PathRecord.parse(with_branch(path, 1, -2).body()) == with_branch(path, 1, -2)
    assert (with_branch(path, 1, -2).q0_turns, with_branch(path, 1, -2).roll_turns) == (1, -2)


@pytest.mark.parametrize(
    ("planned", "registered", "link"),
    [("a", "a", "linked"), (None, "a", "not linked"), ("a", None, "not linked"), (None, None, "not linked")],
)
def test_a_ct_named_on_one_side_only_is_not_linked(planned, registered, link):
    assert prepare(plan(ct_id=planned), registration(ct_id=registered), ROBOT).ct_link == link


def test_another_ct_is_refused():
    message = refusal(plan(ct_id="a"), registration(ct_id="b"), ROBOT)
    assert "r.json: ct_id is 'b'" in message
    assert "'a'" in message


@pytest.mark.parametrize("planned", [159.99, 160.0, 160.01])
def test_a_tool_within_a_hundredth_is_accepted(planned):
    assert prepare(plan(tool_length_mm=planned), None, ROBOT).path.tool_length_mm == 160.0


@pytest.mark.parametrize("planned", [159.989999, 160.010001, 100.0, math.nan])
def test_another_tool_is_refused(planned):
    if math.isnan(planned):
        with pytest.raises(ValueError):  # NaN cannot come from a file; it must not pass all the same
            prepare(plan(tool_length_mm=planned), None, ROBOT)
        return
    message = refusal(plan(tool_length_mm=planned), None, ROBOT)
    assert "tool_length_mm" in message
    assert "mounted tool's 160 mm" in message


def test_the_tool_option_replaces_the_robots_tool():
    ready = prepare(plan(tool_length_mm=100.0), None, ROBOT, tool_length_mm=100.0)
    assert ready.path.tool_length_mm == 100.0
    assert "mounted tool's 100 mm" in refusal(plan(tool_length_mm=160.0), None, ROBOT, tool_length_mm=100.0)


def test_a_registration_from_the_future_is_refused_and_one_of_now_is_not():
    """The clock of who registers may be ahead by as much as the site says."""
    latest, later = (NOW + timedelta(seconds=s) for s in (SKEW_S, SKEW_S + 1e-6))
    assert prepare(plan(), registration(created=latest.isoformat()), ROBOT)
    message = refusal(plan(), registration(created=later.isoformat()), ROBOT)
    assert "created_utc is 2026-06-01T00:01:00.000001" in message
    assert "not later than now (2026-06-01T00:00:00Z) and clock_skew_s (60 s)" in message


def test_the_feed_is_the_files_else_the_options_else_ten():
    assert prepare(plan(), None, ROBOT).path.feed_mm_s == 20.0
    assert prepare(plan(), None, ROBOT, feed_mm_s=20.0).path.feed_mm_s == 20.0
    assert prepare(plan(feed_mm_s=None), None, ROBOT, feed_mm_s=5.0).path.feed_mm_s == 5.0
    assert prepare(plan(feed_mm_s=None), None, ROBOT).path.feed_mm_s == DEFAULT_FEED_MM_S == 10.0
    assert "feed_mm_s is 20" in refusal(plan(), None, ROBOT, feed_mm_s=5.0)


def leaning(degrees):
    return [math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))]


def test_a_segment_that_turns_the_axis_by_more_than_179_deg_is_refused_by_number():
    assert prepare(plan(axes=(UP, leaning(178.999))), None, ROBOT)
    for degrees in (179.001, 180.0):
        tips = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
        message = refusal(plan(tips, (UP, UP, leaning(degrees))), None, ROBOT)
        assert "segment 1" in message
        assert "179 deg" in message


def test_a_turn_that_only_quantising_brings_over_179_deg_is_refused():
    refused = []
    for start in range(1, 90):
        pair = (leaning(start), leaning(start + 179.0 - 1e-10))
        try:
            prepare(plan(axes=pair), None, ROBOT)
        except InputError as error:
            refused.append(str(error))
    assert 0 < len(refused) < 89
    assert all("pose 0" in message and "179" in message for message in refused)


def test_guidance_quantises_as_the_wire_does():
    ready = prepare(plan(), None, ROBOT)
    tips, directions = ready.quantise(
        np.array([[0.00049, 1, 2], [3, 4, 5.00051]]), np.array([UP, leaning(30)])
    )
    assert tips.tolist() == [[0, 1, 2], [3, 4, 5.001]]
    again = ready.quantise(tips, directions)
    assert np.array_equal(again[0], tips)
    assert np.abs(again[1] - directions).max() <= 1e-9
