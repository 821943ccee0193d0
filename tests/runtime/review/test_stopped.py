"""What is told after a stop: for every cause, and by the running session as by its log."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward
from cutgate.protocol.frames import FRACTION_MAX
from cutgate.protocol.states import StopCause
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.show import stop_lines
from cutgate.runtime.review.stopped import NEXT, WORDS, Stopped, Way, stop_document
from tests.runtime.interlock.builders import CALIBRATION, PATH, START_JOINTS, TOOL

WAY = Way(PATH.body(), CALIBRATION.body(), TOOL.body(), 30_000)
CUTTING = Stopped(
    StopCause.OPERATOR_STOP,
    "the operator said stop",
    Phase.CUTTING,
    at_rest=True,
    latched=False,
    standing=StopCause.OPERATOR_STOP,
    progress=(0, 0),
    joints_u=START_JOINTS,
)


def told(way=WAY, **changes):
    return stop_document(replace(CUTTING, **changes), way)


def shown(document, width=80):
    console = Console(width=width, no_color=True, highlight=False, markup=False)
    with console.capture() as capture:
        console.print(*stop_lines(document), sep="\n")
    return capture.get()


@pytest.mark.parametrize("cause", StopCause)
def test_every_cause_has_its_words_and_every_block_a_next_step(cause):
    document = told(cause=cause)
    assert document["text"].endswith(".")
    assert document["next"]
    assert json.loads(json.dumps(document)) == document
    for width in (80, 120):
        assert max(map(len, shown(document, width).splitlines())) <= width
    assert WORDS.keys() == NEXT.keys() == {*StopCause}


def test_a_stop_nobody_confirmed_says_first_how_to_make_sure_of_it():
    document = told(at_rest=False)
    assert document["confirmed"] is False
    assert document["next"][:2] == [
        "Release the enabling device.",
        "Press the emergency stop: nobody has confirmed that the arm stands.",
    ]
    assert "NO: nobody has confirmed" in shown(document)
    assert "emergency stop" not in " ".join(told()["next"])


def test_a_stop_before_any_motion_says_that_none_was_started():
    document = told(at_rest=False, phase=Phase.PERMITTED, progress=None, joints_u=None)
    assert "no motion was started in this session" in shown(document)
    assert "has confirmed that the arm stands" not in shown(document)


@pytest.mark.parametrize(
    ("standing", "latched", "asks"),
    [
        (StopCause.NONE, False, "Start a new session; it cuts the path from its beginning."),
        (StopCause.NONE, True, "Start a new session and say reset; it cuts"),
        (StopCause.BONE_MOVED, False, "Start a new session and say acknowledge; it cuts"),
        (StopCause.AUDIT_FAILED, True, "Start a new session and say acknowledge, then reset; it cuts"),
    ],
)
def test_the_last_step_is_what_the_controller_asks_for(standing, latched, asks):
    assert told(standing=standing, latched=latched)["next"][-1].startswith(asks)


def test_who_has_not_heard_the_controller_does_not_know_what_it_will_ask_for():
    unheard = told(standing=StopCause.NONE, at_rest=False)["next"][-1]
    assert unheard.endswith("beginning; say acknowledge, and reset, when it asks for them.")


@pytest.mark.parametrize("phase", sorted({*Phase} - {Phase.STARTING, Phase.CUTTING, Phase.FINISHING}))
def test_an_arm_that_was_not_started_is_nowhere_on_the_path(phase):
    document = told(phase=phase)
    assert (document["moving"], document["where"]) == (False, None)
    assert "the arm had not been started" in shown(document)
    assert "path from its beginning" not in document["next"][-1]


@pytest.mark.parametrize(("segment", "part"), [(0, 0.0), (0, 0.25), (1, 0.5), (len(PATH) - 2, 1.0)])
def test_what_is_cut_and_what_is_left_make_the_whole_path(segment, part):
    where = told(progress=(segment, round(part * FRACTION_MAX)))["where"]
    done = sum(
        math.dist(one, other) * (1.0 if place < segment else part if place == segment else 0.0)
        for place, (one, other) in enumerate(zip(PATH.tips_mm, PATH.tips_mm[1:], strict=False))
    )
    whole = sum(math.dist(one, other) for one, other in zip(PATH.tips_mm, PATH.tips_mm[1:], strict=False))
    assert where["to_go_mm"] == pytest.approx(whole - done, abs=1e-3)
    assert where["percent"] == pytest.approx(100.0 * done / whole, abs=0.01)
    assert (where["segment"], where["segments"]) == (segment, len(PATH) - 1)


@pytest.mark.parametrize("progress", [None, (len(PATH) - 1, 0), (-1, 0)])
def test_progress_that_is_none_is_not_made_up(progress):
    where = told(progress=progress)["where"]
    assert (where["segment"], where["percent"], where["to_go_mm"]) == (None, None, None)
    assert "no progress was reported" in shown(told(progress=progress))


@pytest.mark.parametrize("seed", range(20))
def test_the_tip_is_where_the_controllers_kinematics_say_and_the_depth_is_along_the_first_tool(seed):
    """The oracle: the simulated controller's own kinematics, which share nothing with the runtime's."""
    random = np.random.default_rng(seed)
    joints_u = tuple(int(value) for value in random.uniform(-60e6, 60e6, 5))
    where = told(joints_u=joints_u)["where"]
    arm = calibrated_arm(CALIBRATION, tool_mm=TOOL.length_mm, elbow=PATH.elbow)
    degrees = np.array(joints_u) / 1e6
    pose = forward(
        arm, as_joints([degree if k == 2 else math.radians(degree) for k, degree in enumerate(degrees)])
    )
    assert where["tip_mm"] == pytest.approx(pose.tip, abs=1e-9)
    first, axis = PATH.tips_mm[0], PATH.axes[0]
    inside = tuple(first[k] - axis[k] * where["depth_mm"] + 30.0 * axis[k] for k in range(3))
    # a tip as deep on the first pose's own axis lies in one plane across it with this one
    assert sum((inside[k] - pose.tip[k]) * axis[k] for k in range(3)) == pytest.approx(0.0, abs=1e-6)


def test_a_tip_below_the_entry_plane_is_to_be_withdrawn_first_and_one_above_is_not():
    deep = told(way=Way(WAY.path, WAY.calibration, WAY.tool, 10_000_000), progress=(0, 1))
    assert deep["where"]["depth_mm"] > 0.0
    assert "the tool is in the bone, withdraw it along its axis" in deep["next"][0]
    assert "if the tool" not in deep["next"][0]
    assert "below the entry plane" in shown(deep)
    high = told(way=Way(WAY.path, WAY.calibration, WAY.tool, 0), joints_u=(0, 0, 450_000_000, 0, 0))
    assert high["where"]["depth_mm"] < 0.0
    assert not any("withdraw" in step for step in high["next"])
    assert "above the entry plane" in shown(high)


END = (len(PATH) - 2, FRACTION_MAX)
LEGS = {
    "before any progress": (Phase.STARTING, None, "approach", "on the approach, before the cut"),
    "at the first point": (Phase.CUTTING, (0, 0), "approach", "on the approach, before the cut"),
    "just begun": (Phase.CUTTING, (0, 1), "cut", "segment 0 of"),
    "nearly done": (Phase.CUTTING, (END[0], FRACTION_MAX - 1), "cut", "0.0 mm to go"),
    "at the last point": (Phase.CUTTING, END, "retract", "on the retract: the whole path is cut"),
    "awaiting the end": (Phase.FINISHING, END, "retract", "on the retract: the whole path is cut"),
    "not known": (Phase.CUTTING, None, None, "no progress was reported"),
    "of no such segment": (Phase.CUTTING, (len(PATH), 0), None, "no progress was reported"),
}
ADVICE = {
    "approach": "The arm was on its approach: if the tool is in the bone, withdraw it",
    "cut": "the tool is in the bone, withdraw it along its axis",
    "retract": "The path is cut and the arm was on its retract: if the tool is in the bone, withdraw it",
    None: "It is not known how far the arm came: if the tool is in the bone, withdraw it",
}


@pytest.mark.parametrize(("phase", "progress", "leg", "text"), LEGS.values(), ids=LEGS)
def test_the_leg_decides_what_is_said_of_the_bone(phase, progress, leg, text):
    """On a joint line the arm may stand beside the bone, however deep it is below the plane."""
    deep = told(way=Way(WAY.path, WAY.calibration, WAY.tool, 10_000_000), phase=phase, progress=progress)
    assert deep["where"]["leg"] == leg
    assert deep["where"]["depth_mm"] > 0.0
    assert ADVICE[leg] in deep["next"][0]
    assert text in shown(deep)


def test_a_place_that_nobody_has_confirmed_is_the_last_that_was_heard():
    assert shown(told(at_rest=False)).count("as last heard") == 2
    assert "as last heard" not in shown(told())


@pytest.mark.parametrize(
    "way", [None, Way(b"", WAY.calibration, WAY.tool, 0), Way(WAY.path, b"x", WAY.tool, 0)]
)
def test_without_its_records_the_place_is_not_known(way):
    assert told(way=way)["where"] is None
    assert "not known" in shown(told(way=way))
    assert told(joints_u=None)["where"]["tip_mm"] is None


def test_what_is_shown_is_data():
    text = shown(told(reason="\x1b[2J[bold]x[/]"))
    assert "\x1b" not in text
    assert "\\x1b[2J[bold]x[/]" in text
