"""``cutgate config``: settings shown and files checked, as people and programs read them."""

import json

import pytest

from cutgate.config.load import EXAMPLES
from cutgate.config.model import Site
from cutgate.config.settings import settings
from cutgate.runtime.commands import app as cli

ROBOT, SITE = str(EXAMPLES / "robot.toml"), str(EXAMPLES / "site.toml")


def show(*words):
    return cli.execute(["config", "show", *words])


def test_every_setting_is_shown_with_its_source(capsys):
    assert show("--site", SITE) == 0
    out = capsys.readouterr().out
    assert f"Settings of {SITE}\n" in out
    for one in settings(Site()):
        assert one.name in out
    lines = [line.split() for line in out.splitlines()]
    assert ["timeout_ms", "=", "1000", "ms", "site.toml", "15", "to", "1", "000", "ms"] in lines
    assert ["commit_deadline_ms", "=", "1000", "ms", "default", "100", "to", "5", "000", "ms"] in lines


def test_the_document_says_the_same(capsys):
    assert show("--site", SITE, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["schema"], document["site"]) == ("cutgate.settings/1", SITE)
    found = {one["key"]: one for one in document["settings"]}
    assert list(found) == [one.key for one in settings(Site())]
    assert found["timing.heartbeat_ms"] == {
        "key": "timing.heartbeat_ms",
        "value": 100,
        "source": "site.toml",
        "bounds": "5 to 100",
        "unit": "ms",
        "effect": "period of both sides' heartbeats",
    }
    assert found["key_file"]["value"] is None


def test_without_a_file_they_are_the_defaults(capsys):
    assert show("--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["site"] is None
    assert {one["source"] for one in document["settings"]} == {"default"}


@pytest.mark.parametrize("columns", [20, 80, 200])
def test_no_line_is_wider_than_the_terminal_and_none_ends_in_spaces(monkeypatch, capsys, tmp_path, columns):
    monkeypatch.setattr("cutgate.runtime.commands.screen.PLAIN_WIDTH", columns)
    site = tmp_path / "s.toml"
    site.write_text(f'schema = "cutgate.site/1"\n[log]\ndirectory = "{"d" * 200}"\n', encoding="utf-8")
    assert show("--site", str(site)) == 0
    lines = capsys.readouterr().out.splitlines()
    shown = [line for line in lines if "s.toml" not in line]
    assert max(map(len, shown)) <= columns
    assert "ddd" in "".join(shown)


def test_a_value_is_data(capsys, tmp_path):
    site = tmp_path / "s.toml"
    site.write_text(
        'schema = "cutgate.site/1"\nkey_file = "[bold]\\u001b[31m\\n[timing]"\n', encoding="utf-8"
    )
    assert show("--site", str(site)) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert 'key_file = "[bold]\\u001b[31m\\n[timing]"' in out


def test_a_refused_site_shows_nothing(capsys, tmp_path):
    (tmp_path / "s.toml").write_text('schema = "cutgate.site/1"\nx = 1\n', encoding="utf-8")
    assert show("--site", str(tmp_path / "s.toml")) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "known keys" in shown.err


def test_each_file_is_accepted_or_refused_and_the_worst_decides(capsys, tmp_path):
    missing = str(tmp_path / "none.json")
    assert cli.execute(["config", "check", ROBOT, missing, SITE]) == 2
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [
        f"{ROBOT}: ok (robot example, right elbow)",
        f"{SITE}: ok (site, heartbeat 100 ms)",
    ]
    assert shown.err == f"{missing}: no such file; check the name\n"
    assert cli.execute(["config", "check", ROBOT, SITE]) == 0


def test_the_limits_of_a_site_hold(capsys, tmp_path):
    (tmp_path / "s.toml").write_text(
        'schema = "cutgate.site/1"\n[files]\npose_limit = 10\n', encoding="utf-8"
    )
    plan = str(EXAMPLES / "tibial.plan.json")
    assert cli.execute(["config", "check", plan, "--site", str(tmp_path / "s.toml")]) == 2
    assert "pose_limit" in capsys.readouterr().err


def test_a_name_of_a_file_is_data(capsys, tmp_path):
    file = tmp_path / "a\n\x1b[31mb: ok.toml"
    file.write_bytes((EXAMPLES / "site.toml").read_bytes())
    assert cli.execute(["config", "check", str(file)]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    assert "\x1b" not in out
