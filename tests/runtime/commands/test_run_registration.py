"""``cutgate run`` and a registration of another program: declared in full before anything is begun, and told."""

from types import SimpleNamespace

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.commands import run as command
from cutgate.runtime.commands.app import execute
from tests.runtime.audit.build import inputs

DECLARED = ["--registration-frame", "lps", "--registration-direction", "ct-to-robot"]
DECLARED += ["--taken-at", "2026-01-01T00:00:00Z", "--registration-residual-mm", "0.2"]


@pytest.fixture
def run(tmp_path, monkeypatch, capfd):
    """Runs the command up to where the bus would be opened: exit code and standard error on one line."""
    (tmp_path / "plan.csv").write_bytes(inputs().plan)
    (tmp_path / "robot.toml").write_bytes(inputs().robot.data)
    (tmp_path / "navigated.txt").write_text("1 0 0 500\n0 1 0 50\n0 0 1 120\n0 0 0 1\n")

    def no_bus(*_, **__):
        raise InputError("bus", "", None, "is not to be opened")

    for name, value in {
        "load_key": lambda _: bytes(32),
        "Check": lambda *_: SimpleNamespace(),
        "open_bus": no_bus,
    }.items():
        monkeypatch.setattr(command, name, value)
    monkeypatch.chdir(tmp_path)

    def call(*options):
        words = ["run", "plan.csv", "--robot", "robot.toml", "--registration", "navigated.txt", "--key", "k"]
        code = execute([*words, "--interface", "test", "--channel", "x", *options])
        return code, " ".join(capfd.readouterr().err.split())

    return call


def test_what_is_declared_is_told_before_the_bus_is_opened(run):
    code, told = run(*DECLARED)
    assert code == 2
    assert "registration read as it stands, from CT to robot; CT axes as they stand (LPS)" in told
    assert "bus: is not to be opened" in told


@pytest.mark.parametrize("missing", range(0, 8, 2), ids=lambda at: DECLARED[at])
def test_what_is_not_declared_is_asked_for_before_the_bus_is_opened(run, missing):
    code, told = run(*DECLARED[:missing], *DECLARED[missing + 2 :])
    assert code == 2
    assert f"{DECLARED[missing]}: is needed with navigated.txt" in told
    assert "bus" not in told


def test_a_time_that_is_still_to_come_is_refused_by_the_name_of_its_option(run):
    later = [word.replace("2026-01-01", "2999-01-01") for word in DECLARED]
    code, told = run(*later)
    assert code == 2
    assert "--taken-at is 2999-01-01T00:00:00Z, must be not later than now" in told
