"""``cutgate doctor``: what people and programs are told, and by which exit code."""

import json
import os
import sys

import pytest

from cutgate.config.key import new_key_file
from cutgate.config.load import EXAMPLES
from cutgate.runtime.commands import app as cli
from cutgate.runtime.doctor import installation, machine
from cutgate.runtime.doctor.checks import Probed
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Delays, Unknown
from cutgate.runtime.doctor.finding import Condition, Finding

SITE = str(EXAMPLES / "site.toml")
GOOD = Finding("good", Condition.OK, "as it is", "that")
WARNED = Finding("warned", Condition.WARNING, "rather long", "short", "shorten it")
FAILED = Finding("failed", Condition.FAIL, "broken", "whole", "mend it")
UNSEEN = Unknown("asleep", "wake it")


def check(*found):
    return Probed("made up", "that", lambda examined: examined, lambda _facts, _examined: found)


@pytest.fixture
def made_up(monkeypatch):
    """Replaces both tables, and keeps what the machine's was asked about."""
    asked = []

    def replaced(*found, unknown=False):
        checks = [Probed("made up", "that", lambda _: UNSEEN, lambda *_: ())] if unknown else [check(*found)]
        kept = Probed("", "", lambda examined: asked.append(examined) or examined, lambda *_: ())
        monkeypatch.setattr(installation, "INSTALLATION", ())
        monkeypatch.setattr(machine, "MACHINE", (kept, *checks))
        return asked

    return replaced


def doctor(*words):
    return cli.execute(["doctor", *words])


@pytest.mark.parametrize(
    ("found", "code"), [((GOOD,), 0), ((GOOD, WARNED), 0), ((GOOD, FAILED, WARNED), 1), ((), 0)]
)
def test_only_a_failure_fails(made_up, capsys, found, code):
    made_up(*found)
    assert doctor() == code
    capsys.readouterr()
    assert doctor("--json") == code
    assert json.loads(capsys.readouterr().out)["ok"] is (code == 0)


def test_unknown_is_no_failure_and_is_told(made_up, capsys):
    made_up(unknown=True)
    assert doctor() == 0
    out = capsys.readouterr().out
    assert "unknown  made up" in out
    assert "1 checks: 1 unknown" in out
    assert "wake it" in out


def test_the_document_holds_every_check(made_up, capsys):
    made_up(GOOD, FAILED)
    assert doctor("--json") == 1
    assert json.loads(capsys.readouterr().out) == {
        "schema": "cutgate.doctor/1",
        "ok": False,
        "checks": [
            {"name": "good", "state": "ok", "found": "as it is", "bound": "that", "remedy": ""},
            {"name": "failed", "state": "FAIL", "found": "broken", "bound": "whole", "remedy": "mend it"},
        ],
    }


def test_the_table_names_everything_and_what_to_do(made_up, capsys):
    made_up(GOOD, WARNED, FAILED)
    doctor()
    out = capsys.readouterr().out
    for word in ("good", "as it is", "rather long", "short", "broken", "whole"):
        assert word in out
    assert "What to do\nFAIL    failed: mend it\nwarning warned: shorten it\n" in out
    assert "3 checks: 1 ok, 1 warning, 1 FAIL" in out


@pytest.mark.parametrize("columns", [20, 40, 71, 72, 80, 200])
def test_long_values_break_no_table(made_up, monkeypatch, capsys, columns):
    monkeypatch.setattr("cutgate.runtime.commands.screen.PLAIN_WIDTH", columns)
    made_up(Finding("X" * 40, Condition.OK, "Q" * 500, "Z" * 300))
    doctor()
    out = capsys.readouterr().out
    assert max(len(line) for line in out.splitlines()) <= columns
    assert (out.count("X"), out.count("Q"), out.count("Z")) == (40, 500, 300)


def test_what_is_found_is_data(made_up, capsys):
    made_up(Finding("[bold]a", Condition.FAIL, "b\x1b[31m\nok  c", "[/]", "rm \x07"))
    doctor()
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "\x07" not in out
    assert "[bold]a" in out
    assert "rm \\x07" in out


def test_what_is_looked_at_is_what_a_session_would_use(made_up, tmp_path):
    asked = made_up()
    site = tmp_path / "site.toml"
    site.write_text(
        'schema = "cutgate.site/1"\nkey_file = "of-site.key"\n[bus]\ninterface = "socketcan"\nchannel = "can1"\n'
        '[log]\ndirectory = "of-site"\n',
        encoding="utf-8",
    )
    assert doctor("--site", str(site)) == 0
    assert (
        doctor("--site", str(site), "--key", "k", "--interface", "pcan", "--channel", "0", "--log-dir", "l")
        == 0
    )
    named, other = asked
    assert (str(named.key), named.interface, named.channel, str(named.log_directory)) == (
        "of-site.key",
        "socketcan",
        "can1",
        "of-site",
    )
    assert (str(other.key), other.interface, other.channel, str(other.log_directory)) == (
        "k",
        "pcan",
        "0",
        "l",
    )


def test_without_a_bus_it_is_the_default(made_up, monkeypatch):
    asked = made_up()
    monkeypatch.setattr("cutgate.config.bus.has_socketcan", lambda *_: False)
    doctor()
    doctor("--channel", "mine")
    monkeypatch.setattr("cutgate.config.bus.has_socketcan", lambda *_: True)
    doctor()
    assert [(one.interface, one.channel) for one in asked] == [
        ("cutgate", "bus0"),
        ("cutgate", "mine"),
        ("socketcan", "vcan0"),
    ]


def test_bad_input_is_refused_before_anything_is_printed(made_up, capsys, tmp_path):
    made_up(GOOD)
    (tmp_path / "s.toml").write_text('schema = "cutgate.site/1"\nx = 1\n', encoding="utf-8")
    assert doctor("--site", str(tmp_path / "s.toml")) == 2
    assert doctor("--interface", "socketcan") == 2
    assert doctor("--interfaces", "x") == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "known keys" in shown.err
    assert "--channel: is needed with --interface" in shown.err


@pytest.mark.parametrize(
    ("module", "name"),
    [("cutgate.runtime.doctor.machine", "machine"), ("cutgate.runtime.doctor.installation", "packages")],
)
def test_a_package_that_cannot_be_imported_is_a_failure_with_a_remedy(
    made_up, monkeypatch, capsys, module, name
):
    made_up(GOOD)
    monkeypatch.setitem(sys.modules, module, None)
    assert doctor("--json") == 1
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["checks"]}
    assert found[name]["state"] == "FAIL"
    assert "not looked at: " in found[name]["found"]
    assert "requirements.txt" in found[name]["remedy"]


@pytest.mark.processes
def test_this_machine_is_looked_at_and_left_as_it_is(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("cutgate.runtime.doctor.probes.latency.CYCLES", 3)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    logs = tmp_path / "logs"
    logs.mkdir(mode=0o700)
    new_key_file(tmp_path / "k", bytes(32))
    code = doctor("--site", SITE, "--key", str(tmp_path / "k"), "--log-dir", str(logs), "--json")
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert code == (1 if any(one["state"] == "FAIL" for one in checks) else 0)
    names = [one["name"] for one in checks]
    assert len(names) == len(set(names)) > 20
    state = {one["name"]: one["state"] for one in checks}
    assert state["Python"] == state["key"] == state["log directory"] == "ok"
    assert all(one["remedy"] for one in checks if one["state"] in {"warning", "FAIL"})
    assert all(one["found"] and one["bound"] for one in checks)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["k", "logs"]
    assert os.listdir(logs) == []  # noqa: PTH208


def test_every_check_of_the_machine_may_fail_to_be_known():
    """A probe that cannot look leaves one line, and ends nothing."""

    def unreadable(_examined):
        raise OSError(5, "Input/output error")

    for table in (machine.MACHINE, installation.INSTALLATION):
        for one in table:
            (found,) = Probed(one.name, one.bound, unreadable, one.judge).findings(Examined)
            assert (found.name, found.state) == (one.name, Condition.UNKNOWN)
    assert Delays(1, 0.0, 0.0).count == 1
