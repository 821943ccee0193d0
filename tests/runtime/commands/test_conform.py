"""``cutgate conform``: refusals of its inputs, and one run with real processes."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from cutgate.config.key import new_key_file
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.runtime.commands.app import execute

ROBOT = Path(__file__).parents[3] / "examples" / "robot.toml"


@pytest.fixture
def place() -> Iterator[Path]:
    """A directory short enough for a socket's path, with a key."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
        path = Path(directory)
        new_key_file(path / "key", bytes(range(32)))
        yield path


def arguments(place: Path, *more: str) -> list[str]:
    bus = ["--interface", "cutgate", "--channel", str(place / "bus.sock")]
    return ["conform", *bus, "--key", str(place / "key"), *more]


def test_nothing_is_done_until_the_plant_is_said_to_be_disconnected(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(arguments(place)) == 2
    said = capsys.readouterr().err
    assert "--plant-disconnected" in said
    assert "cutter may spin up" in said


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--only", "no such case"], "no such case"),
        (["--robot", "missing.toml"], "missing.toml"),
        (["--site", "missing.toml"], "missing.toml"),
        (["--out", "/dev/null"], "/dev/null"),
        ([], "bus"),
    ],
)
def test_what_cannot_be_used_is_refused_with_exit_code_2(
    place: Path, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert execute(arguments(place, "--plant-disconnected", *more)) == 2
    assert words in capsys.readouterr().err


def test_a_key_open_to_others_is_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "key").chmod(0o644)
    assert execute(arguments(place, "--plant-disconnected")) == 2
    assert "0644" in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.parametrize("fd", [[], pytest.param(["--fd"], marks=pytest.mark.slow)], ids=["classic", "FD"])
def test_a_simulated_controller_in_its_own_process_passes(
    place: Path, capsys: pytest.CaptureFixture[str], fd: list[str]
) -> None:
    """50 and 500 ms: the machine may be slow. The whole suite runs in virtual time elsewhere."""
    site = place / "site.toml"
    site.write_text('schema = "cutgate.site/1"\n[timing]\nheartbeat_ms = 50\ntimeout_ms = 500\n')
    command = [
        sys.executable,
        "-m",
        "cutgate.firmware_sim",
        "sim",
        "--robot",
        str(ROBOT),
        "--key",
        str(place / "key"),
    ]
    command += ["--interface", "cutgate", "--channel", str(place / "bus.sock"), *fd]
    only = ("permit: right", "permit: wrong path digest", "start: enabling device released", "second node")
    more = ["--plant-disconnected", "--json", "--site", str(site), "--out", str(place / "report.json"), *fd]
    with hub_process(place / "bus.sock"):
        assert execute(arguments(place, "--plant-disconnected")) == 2, "nobody announces himself"
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as controller:
            try:
                assert controller.stdout is not None
                controller.stdout.readline()
                capsys.readouterr()
                names = [word for name in (*only, "nothing moved") for word in ("--only", name)]
                code = execute(arguments(place, *more, *names))
            finally:
                controller.terminate()
    report = json.loads(capsys.readouterr().out)
    assert [
        (case["name"], case["verdict"], case["came"]) for case in report["cases"] if case["verdict"] != "PASS"
    ] == []
    assert code == 0
    assert len(report["cases"]) == 5
    assert not report["conforms"], "a selection says nothing about the rest"
    assert not report["needs_reset"]
    assert json.loads((place / "report.json").read_text()) == report
