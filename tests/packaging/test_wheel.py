"""The wheel is the product too: in an empty environment, from an empty folder, beside modules that are planted."""

import json
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest

from cutgate import __version__
from tests.packaging.machine import ROOT, checkout, environment, plant, run

pytestmark = [pytest.mark.slow, pytest.mark.processes, pytest.mark.timeout(600)]

PLACED = ["--robot", "example", "--registration", "registration-second"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    source, folder = checkout(tmp_path_factory.mktemp("clone")), tmp_path_factory.mktemp("dist")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder]
    run([sys.executable, "-m", "pip", "wheel", *options, "."], cwd=source)
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module")
def programs(wheel, tmp_path_factory):
    """An environment with what runs beside a controller, and nothing for pictures or development."""
    programs = environment(tmp_path_factory.mktemp("venv"))
    pip = [programs / "python", "-m", "pip", "install", "--quiet", "--no-deps"]
    run([*pip, "--only-binary", ":all:", "--require-hashes", "-r", ROOT / "requirements.txt"])
    run([*pip, "--no-index", wheel])
    run([programs / "python", "-m", "pip", "check"])
    return programs


@pytest.fixture
def folder(tmp_path):
    """Where planted modules lie; the test fails if one of them was run, whatever else it says."""
    marker = plant(tmp_path)
    yield tmp_path
    assert not marker.exists(), f"a planted module was run: {marker.read_text(encoding='utf-8')}"


def test_it_holds_the_package_and_its_data_alone(wheel):
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
    assert {name.split("/")[0] for name in names} == {"cutgate", f"cutgate-{__version__}.dist-info"}
    data = {name for name in names if name.startswith("cutgate/") and not name.endswith(".py")}
    report = ROOT / "runtime" / "commands" / "report"
    drawn = {
        path.relative_to(report).as_posix()
        for path in report.rglob("*")
        if path.is_file() and path.suffix not in {".py", ".pyc"}
    }
    examples = {
        path.name
        for pattern in ("*.json", "*.toml", "*.service")
        for path in (ROOT / "examples").glob(pattern)
    }
    project = {path.name for path in (ROOT / "examples" / "hil").iterdir() if path.is_file()}
    presets = {path.name for path in (ROOT / "config" / "presets").iterdir()}
    assert data >= {"cutgate/py.typed", "cutgate/protocol/cutgate.dbc"}
    assert data >= {f"cutgate/runtime/commands/reach_page.{kind}" for kind in ("js", "css")}
    assert drawn >= {"page.js", "page.css", "view3d.js", "vendor/drawing.js", "vendor/LICENSE.three"}
    assert data >= {f"cutgate/runtime/commands/report/{name}" for name in drawn}
    assert data >= {f"cutgate/examples/{name}" for name in examples}
    assert data >= {f"cutgate/config/presets/{name}" for name in presets}
    assert set(names) >= {f"cutgate/examples/hil/{name}" for name in project}
    assert "README.txt" in project


MEMORY = Path("/dev/shm")
"""A file system that no disk stands behind."""


@pytest.fixture
def waits_for_no_disk(tmp_path):
    """A folder in memory where there is one: packages are installed meanwhile, and a permit waits a second for its record."""
    if not os.access(MEMORY, os.W_OK):
        yield tmp_path / "demo"
        return
    with tempfile.TemporaryDirectory(dir=MEMORY) as own:
        yield Path(own) / "demo"


def test_the_demo_runs_to_its_end(programs, folder, waits_for_no_disk):
    done = run([programs / "cutgate", "demo", "--json", "--out", waits_for_no_disk], cwd=folder)
    assert json.loads(done.stdout)["as_told"] is True


def test_a_shipped_example_is_verified_by_name(programs, folder):
    assert run([programs / "cutgate", "--version"], cwd=folder).stdout == f"cutgate {__version__}\n"
    done = run([programs / "cutgate", "verify", "hip-stem", *PLACED, "--json"], cwd=folder)
    assert json.loads(done.stdout)["verdict"] == "admissible"


def test_the_example_files_are_a_place_to_start_from(programs, folder):
    run([programs / "cutgate", "example", "start"], cwd=folder)
    files = ["hip-stem.plan.json", "--robot", "robot.toml", "--registration", "registration-second.json"]
    run([programs / "cutgate", "verify", *files], cwd=folder / "start")


def test_a_picture_is_refused_with_how_to_get_what_draws_it_and_page_and_data_are_made(programs, folder):
    few = ["--step-mm", "200", "--cores", "2"]
    done = run([programs / "cutgate", "reach", "hip-stem", *PLACED, *few], cwd=folder, code=2)
    assert "pip install 'cutgate[pictures]'" in done.stderr
    run([programs / "cutgate", "reach", "hip-stem", *PLACED, *few, "--out", "map.csv"], cwd=folder)
    assert (folder / "map.csv").read_text(encoding="utf-8").startswith("x_mm,")
    run([programs / "cutgate", "reach", "hip-stem", *PLACED, *few, "--out", "map.html"], cwd=folder)
    assert "Content-Security-Policy" in (folder / "map.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "command", ["verify", "recheck", "reach", "run", "sim", "bus", "conform", "key", "audit"]
)
def test_no_command_takes_code_from_pythonpath(command, programs, folder):
    run([programs / "cutgate", command, "--help"], cwd=folder, env={"PYTHONPATH": f"{folder}{os.pathsep}"})


def test_the_bus_can_be_joined_from_a_folder_with_modules_of_these_names(programs, tmp_path):
    for name in ("config", "protocol", "runtime", "firmware_sim"):
        (tmp_path / f"{name}.py").write_text("MINE = True\n", encoding="utf-8")
    (tmp_path / "script.py").write_text(
        "import can, config, runtime\nassert config.MINE and runtime.MINE\n"
        "try:\n    can.Bus(interface='cutgate', channel='./none.sock', ignore_config=True)\n"
        "except can.CanInitializationError as error:\n    print(error)\n",
        encoding="utf-8",
    )
    done = run([programs / "python", "script.py"], cwd=tmp_path)
    assert "cutgate bus serve" in done.stdout


def test_a_session_from_a_hostile_folder_takes_nothing_from_it(programs, folder):
    """Hub, controller and runtime with its verifying process and the map's, each started here."""
    serve = [programs / "cutgate", "bus", "serve", "--socket", "./bus.sock", "--until-stdin-closes"]
    hub = subprocess.Popen(
        list(map(str, serve)), cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with hub:
        assert "serving on" in hub.stdout.readline()
        run([programs / "cutgate", "key", "new", "site.key"], cwd=folder)
        where = ["--interface", "cutgate", "--channel", "./bus.sock", "--key", "site.key"]
        sim = [programs / "cutgate", "sim", "--robot", "example", *where, "--time-scale", "60"]
        with subprocess.Popen(
            list(map(str, sim)), cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as controller:
            assert any("enabling device released" in line for line in controller.stdout)
            placed = ["--robot", "example", "--registration", "registration-first"]
            run(
                [programs / "cutgate", "run", "hip-stem", *placed, *where, "--allow-simulated"],
                cwd=folder,
                code=1,
            )
            controller.terminate()
        hub.stdin.close()


@pytest.fixture(scope="module")
def with_pytest(programs, tmp_path_factory):
    """The same environment with pytest and pytest-xdist as locked, and nothing else: after all that must do without."""
    lock = (ROOT / "requirements-dev.txt").read_text(encoding="utf-8")
    wanted = ("execnet", "iniconfig", "packaging", "pluggy", "pygments", "pytest", "pytest-xdist")
    blocks = [block for block in re.split(r"\n(?=\S)", lock) if re.split("[=; ]", block)[0] in wanted]
    assert len(blocks) == len(wanted)
    chosen = tmp_path_factory.mktemp("lock") / "requirements.txt"
    chosen.write_text("\n".join(blocks) + "\n", encoding="utf-8")
    pip = [programs / "python", "-m", "pip", "install", "--quiet", "--no-deps", "--only-binary", ":all:"]
    run([*pip, "--require-hashes", "-r", chosen])
    return programs


@pytest.mark.parametrize("workers", ["0", "2"])
def test_the_project_of_tests_passes_as_it_is_written(workers, with_pytest, tmp_path):
    run([with_pytest / "cutgate", "example", "hil", "project"], cwd=tmp_path)
    command = [with_pytest / "python", "-m", "pytest", "-n", workers, "--cutgate-matrix", "matrix.md"]
    done = run(command, cwd=tmp_path / "project")
    assert "5 passed" in done.stdout
    matrix = (tmp_path / "project" / "matrix.md").read_text(encoding="utf-8")
    assert "5 tests with sessions, 2 different faults, 0 tests failed." in matrix
