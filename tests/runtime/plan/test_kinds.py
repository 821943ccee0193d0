"""Which kind a file is, by extension and schema, and that it is read as a session reads it."""

import json
from types import SimpleNamespace

import pytest

from cutgate.config.load import EXAMPLES, SETTINGS_LIMIT, InputError
from cutgate.config.model import FilesSettings
from cutgate.runtime.plan import kinds
from cutgate.runtime.plan.kinds import described

LIMITS = FilesSettings()
POSES = [[0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 1]]
PLAN = {
    "schema": "cutgate.plan/1",
    "id": "short",
    "implant": "cup",
    "side": "left",
    "units": "mm",
    "tool_length_mm": 160.0,
    "feed_mm_s": 20.0,
    "ct_T_implant": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    "poses": POSES,
}


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("robot.toml", "robot example, right elbow"),
        ("site.toml", "site, heartbeat 100 ms"),
        ("registration-first.json", "registration example-first"),
        ("hip-stem.plan.json", "plan hip-stem-example, 2000 poses"),
    ],
)
def test_each_kind_is_known(name, told):
    assert described(EXAMPLES / name, LIMITS) == told


def test_a_small_plan_and_a_tool_path_are_known(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(PLAN), encoding="utf-8")
    (tmp_path / "b.CSV").write_text("x,y,z,i,j,k\n0,0,0,0,0,1\n1,0,0,0,0,1\n", encoding="utf-8")
    assert described(tmp_path / "a.json", LIMITS) == "plan short, 2 poses"
    assert described(tmp_path / "b.CSV", LIMITS) == "tool path b, 2 poses"


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.md", "", "extension is .md, must be one of .toml, .json, .csv"),
        ("a", "", "extension is missing"),
        ("a.toml", "schema = 3", 'schema is 3, must be "cutgate.robot/1" or "cutgate.site/1"'),
        ("a.toml", "", 'schema is missing, must be "cutgate.robot/1" or "cutgate.site/1"'),
        ("a.toml", 'schema = "cutgate.plan/1"', 'schema is "cutgate.plan/1", must be "cutgate.robot/1"'),
        ("a.json", '{"schema": "cutgate.site/1"}', 'must be "cutgate.registration/1" or "cutgate.plan/1"'),
        ("a.json", '{"schema": ["cutgate.plan/1"]}', "schema is ['cutgate.plan/1'], must be"),
        ("a.json", "[]", "a.json is list, must be an object with keys"),
        ("a.json", "{", "not valid JSON"),
        ("a.json", '{"schema": "cutgate.plan/1", "id": NaN}', "must be a finite number"),
        ("a.json", json.dumps({**PLAN, "poses": POSES[:1]}), "poses is 1 poses, must be >= 2 poses"),
        ("a.toml", "=", "not valid TOML"),
        ("a.csv", "x,y\n", "line 1"),
    ],
)
def test_what_is_none_is_refused_in_words(tmp_path, name, text, told):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        described(tmp_path / name, LIMITS)
    assert told in str(refused.value)
    assert str(tmp_path / name) in str(refused.value)


def test_a_registration_time_is_judged_as_a_session_judges_it(tmp_path):
    text = (EXAMPLES / "registration-first.json").read_text(encoding="utf-8")
    document = {**json.loads(text), "created_utc": "2026-01-15T08:02:11.1234567Z"}
    (tmp_path / "r.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match="at most six digits"):
        described(tmp_path / "r.json", LIMITS)


def test_limits_are_those_of_the_site_and_the_remedy_names_it(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(PLAN) + " " * 1_000_000, encoding="utf-8")
    with pytest.raises(InputError, match="name it with --site"):
        described(tmp_path / "a.json", FilesSettings(file_size_limit_mb=1))
    with pytest.raises(InputError, match="raise pose_limit"):
        described(EXAMPLES / "hip-stem.plan.json", FilesSettings(pose_limit=100))


@pytest.mark.parametrize("name", ["r.toml", "r.json"])
def test_a_settings_file_that_is_too_large_is_not_taken_for_one(tmp_path, name):
    document = {"schema": "cutgate.registration/1"}
    (tmp_path / name).write_text(json.dumps(document) + " " * SETTINGS_LIMIT, encoding="utf-8")
    with pytest.raises(InputError, match=r"size is|schema is \"cutgate\.registration/1\", must be"):
        described(tmp_path / name, LIMITS)


@pytest.mark.parametrize("more", [0, 1])
def test_up_to_its_limit_a_registration_is_one(tmp_path, more):
    data = (EXAMPLES / "registration-first.json").read_bytes()
    (tmp_path / "r.json").write_bytes(data + b" " * (SETTINGS_LIMIT - len(data) + more))
    if not more:
        assert described(tmp_path / "r.json", LIMITS) == "registration example-first"
        return
    with pytest.raises(InputError):
        described(tmp_path / "r.json", LIMITS)


def test_the_tools_of_a_tool_path_are_counted(monkeypatch, tmp_path):
    (tmp_path / "a.csv").write_text("", encoding="utf-8")
    parts = tuple(SimpleNamespace(id="a", tips_mm=[0] * count) for count in (3, 4))
    monkeypatch.setattr(kinds, "plans_from_bytes", lambda *_: parts)
    assert described(tmp_path / "a.csv", LIMITS) == "tool path a, 7 poses, 2 tools"
