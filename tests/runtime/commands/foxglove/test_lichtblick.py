"""The layout names nothing that an exported file does not have, and shows every panel once. No viewer is asked: none is here."""

import json
import re

import pytest

from cutgate.runtime.commands.foxglove.lichtblick import layout_bytes
from tests.runtime.commands.foxglove.sessions import by_topic, exported, finished_session
from tests.runtime.session.pair import job_of, pair_of

LAYOUT = json.loads(layout_bytes())
PANELS = LAYOUT["configById"]
PATH = re.compile(r"(/[a-z/_]+)((?:\.[A-Za-z0-9_]+)+)")


def values():
    for panel, config in PANELS.items():
        for path in config.get("paths", ()):
            yield panel, path["value"]


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session")
    with pair_of(folder, *job_of(tmp_path_factory)) as pair:
        return by_topic(exported(finished_session(pair), folder))


@pytest.mark.parametrize(("panel", "value"), list(values()))
def test_every_path_is_that_of_a_number_or_a_word_of_the_file(messages, panel, value):
    topic, names = PATH.fullmatch(value).groups()
    kinds = {type(_at(one.data, names[1:].split("."))) for one in messages[topic]} - {type(None)}
    assert kinds <= ({str} if panel.startswith("StateTransitions") else {int, float})
    assert kinds, "none of them has it"


def _at(data, names):
    for name in names:
        data = data.get(name) if isinstance(data, dict) else None
    return data


def test_every_topic_of_the_scene_and_of_the_log_panel_is_in_the_file(messages):
    schemas = {topic: found[0].schema for topic, found in messages.items()}
    assert {schemas[topic] for topic in PANELS["3D!scene"]["topics"]} == {
        "foxglove.SceneUpdate", "foxglove.PosesInFrame",
    }  # fmt: skip
    assert schemas[PANELS["RosOut!log"]["topicToRender"]] == "foxglove.Log"
    frames = {
        one["child_frame_id"]
        for topic in ("/transforms", "/transforms/bone")
        for one in messages[topic][0].data["transforms"]
    }
    used = {one["frame_id"] for topic in ("/scene", "/arm") for one in messages[topic][0].data["entities"]}
    assert used - {PANELS["3D!scene"]["followTf"]} <= frames


def test_every_panel_stands_once_in_the_window():
    assert sorted(_leaves(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.partition("!")[0] for name in PANELS} == {"3D", "Plot", "StateTransitions", "RosOut"}


def _leaves(part):
    if isinstance(part, str):
        return [part]
    assert part["direction"] in ("row", "column")
    assert 0 < part["splitPercentage"] < 100
    return _leaves(part["first"]) + _leaves(part["second"])


def test_the_plots_show_what_they_are_for():
    topics = {value.split(".")[0] for _, value in values()}
    assert topics == {"/clearance", "/joints", "/tracking", "/timing", "/state"}
