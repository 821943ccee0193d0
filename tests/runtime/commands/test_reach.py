"""``cutgate reach`` as people and programs call it."""

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import pytest
from plotly.offline import get_plotlyjs
from pydantic import Field
from rich.console import Console

from cutgate.runtime.commands import app as cli
from cutgate.runtime.commands import reach as command
from cutgate.runtime.commands.reach_page import page
from cutgate.runtime.commands.reach_picture import KINDS, kind_of, layers, picture
from cutgate.runtime.verification import reach
from cutgate.runtime.verification.verdict import BOUNDARIES
from tests.runtime.commands.contract import Hex, Name, Part, Real, Vector
from tests.runtime.verification.test_search import strokes

ROOT = Path(__file__).parents[3]
ROBOT = ROOT / "examples" / "robot.toml"
POSES = "x,y,z,i,j,k\n" + "".join(
    f"{x},{y},130,0.6,0,0.8\n" for x, y in ((500, 0), (510, 0), (510, 8), (500, 9))
)

Limit = Name | Annotated[str, Field(pattern="^(speed|acceleration)_q[0-4]$")]


class PositionPart(Part):
    x_mm: Real
    y_mm: Real
    yaw_deg: Annotated[Real, Field(ge=-180, le=180)]
    lift_mm: Real
    admissible: bool
    checked: Literal["certified", "pose"]
    limiting: Limit
    unit: Literal["mm", "deg", "mm/s", "rad/s"]
    clearance: Real | None
    bound: Annotated[Real, Field(gt=0)]
    ratio: Real | None


class GridPart(Part):
    step_mm: Annotated[Real, Field(gt=0)]
    x_mm: list[Real]
    y_mm: list[Real]
    yaw_deg: list[Real]
    lift_mm: list[Real]


class CountsPart(Part):
    positions: int
    admissible: int
    certified: int
    excluded_by_a_pose: int


class ReachDocument(Part):
    schema_: Annotated[Literal["cutgate.reach/1"], Field(alias="schema")]
    plan: str
    robot: str
    elbow: Literal["right", "left"]
    registration: str | None
    path_sha256: Hex
    registration_sha256: Hex
    pivot_mm: Vector
    grid: GridPart
    counts: CountsPart
    positions: list[PositionPart]


@pytest.fixture
def path(tmp_path):
    (tmp_path / "cut.csv").write_text(POSES, encoding="utf-8")
    return tmp_path / "cut.csv"


@pytest.fixture
def cutgate(capsys, path):
    """Runs ``reach`` in this process, on one core: exit code, standard output, standard error."""

    def call(*arguments, plan=path, cores=1):
        named = ["reach", plan, "--robot", ROBOT, "--step-mm", 250, "--cores", cores, *arguments]
        code = cli.execute([str(argument) for argument in named])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, said.out, said.err

    return call


@pytest.fixture(scope="module")
def mapped():
    """A map of two turns, made without files."""
    path = strokes(600.0, 0.0)
    grid = reach.grid_of(path, 250.0, (0.0, 45.0), (0.0,))
    positions = command.survey(command.Work(path, 10.0, 160.0), grid, 1, lambda _: None)
    made_for = {"plan": "p<script>", "robot": "r", "elbow": "right", "registration": None}
    return reach.reach_document(path, grid, positions, made_for), positions, list(reach.outline(path))


def test_the_document_is_complete_and_every_position_of_the_grid_stands_in_it(cutgate):
    code, out, _ = cutgate("--json", "--yaw-deg", "0,90")
    found = ReachDocument.model_validate_json(out)
    assert code == 0
    grid, counts = found.grid, found.counts
    size = len(grid.x_mm) * len(grid.y_mm) * len(grid.yaw_deg) * len(grid.lift_mm)
    assert len(found.positions) == size == counts.positions == counts.certified + counts.excluded_by_a_pose
    assert counts.admissible == sum(p.admissible for p in found.positions) > 0
    places = {(p.x_mm, p.y_mm, p.yaw_deg, p.lift_mm) for p in found.positions}
    assert len(places) == size
    assert (0.0, 0.0, 0.0, 0.0) in places


@pytest.mark.processes
def test_two_processes_find_exactly_what_one_finds(cutgate):
    one, two = (cutgate("--json", "--step-mm", 150, cores=cores)[1] for cores in (1, 2))
    assert one == two


def test_files_go_to_a_folder_or_to_the_one_named(cutgate, tmp_path):
    code, out, _ = cutgate("--out", tmp_path / "map")
    assert code == 0
    files = sorted(p.name for p in (tmp_path / "map").iterdir())
    assert files == ["reach.csv", "reach.html", "reach.json", "reach.png"]
    assert all(str(tmp_path / "map" / name) in out for name in files)
    assert (tmp_path / "map" / "reach.png").read_bytes().startswith(b"\x89PNG")
    cutgate("--out", tmp_path / "one" / "only.csv")
    assert [p.name for p in (tmp_path / "one").iterdir()] == ["only.csv"]


def test_the_csv_says_what_the_document_says(cutgate, tmp_path):
    cutgate("--out", tmp_path)
    document = json.loads((tmp_path / "reach.json").read_text(encoding="utf-8"))
    with (tmp_path / "reach.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(document["positions"])
    for row, position in zip(rows, document["positions"], strict=True):
        assert list(row) == list(position)
        for name, value in position.items():
            said = row[name]
            assert (
                said == ""
                if value is None
                else said == value
                if isinstance(value, str)
                else float(said) == value
            )


def test_for_people_the_nearest_and_the_roomiest_place_are_said(cutgate, tmp_path):
    _, out, _ = cutgate("--out", tmp_path / "a.csv")
    assert "positions are admissible, each by the certified method" in out
    assert "Where the bone stands now it is" in out
    assert "Most room:" in out
    assert "Nearest:" in out
    assert "needs a new registration" in out


def test_where_no_position_helps_it_says_what_limits(cutgate, tmp_path):
    upside = tmp_path / "down.csv"
    upside.write_text("x,y,z,i,j,k\n600,0,300,0.6,0,-0.8\n610,0,300,0.6,0,-0.8\n", encoding="utf-8")
    code, out, _ = cutgate("--out", tmp_path / "a.csv", plan=upside)
    assert code == 0
    assert "None is admissible; what limits: pitch_max." in out


BAD = {
    "no number": ["--yaw-deg", "left"],
    "not finite": ["--yaw-deg", "nan"],
    "infinite": ["--lift-mm", "inf"],
    "too far round": ["--yaw-deg", "200"],
    "backward": ["--yaw-deg", "10:0:5"],
    "no step": ["--yaw-deg", "0:10:0"],
    "too many": ["--lift-mm", "0:2000:1"],
    "four parts": ["--yaw-deg", "0:1:2:3"],
    "empty": ["--yaw-deg", ""],
    "step too short": ["--step-mm", "0.1"],
    "too many positions": ["--step-mm", "0.5"],
    "no such robot": ["--robot", "nowhere.toml"],
    "no such registration": ["--registration", "nowhere.json"],
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_with_exit_code_2(cutgate, name):
    code, out, err = cutgate(*BAD[name])
    assert (code, out) == (2, "")
    assert err.strip()


def test_an_output_that_cannot_be_written_is_refused(cutgate, tmp_path):
    (tmp_path / "file").write_text("")
    assert cutgate("--out", tmp_path / "file" / "below")[0] == 2
    (tmp_path / "taken.csv").mkdir()
    code, _, err = cutgate("--out", tmp_path / "taken.csv")
    assert code == 2
    assert "cannot be written" in err
    assert not list(tmp_path.glob(".*"))


def test_a_robot_without_a_workspace_is_refused(cutgate, tmp_path):
    text = ROBOT.read_text(encoding="utf-8").replace(
        "[deadband]", "[calibration]\njoint_offset_deg = [0, -180, 0, 0, 0]\n[deadband]"
    )
    (tmp_path / "r.toml").write_text(text, encoding="utf-8")
    code, _, err = cutgate("--robot", tmp_path / "r.toml")
    assert code == 2
    assert "workspace" in err


def test_turns_and_lifts_are_read_as_list_and_as_range():
    assert command._values("-10:10:5", "", -180, 180) == (-10.0, -5.0, 0.0, 5.0, 10.0)
    assert command._values("3, -1,3", "", -180, 180) == (-1.0, 3.0)
    assert command._values("0:1:0.3", "", 0, 9) == (0.0, 0.3, 0.6, 0.9)


def test_the_page_loads_nothing_and_names_no_address(mapped):
    text = page(*mapped)
    own = text.replace(get_plotlyjs(), "")
    assert len(own) < len(text)
    assert not re.search(r"https?:|//[a-z]|src=|href=|@import|url\(", own)
    assert "default-src 'none'" in own
    assert "p<script>" not in own
    assert "p&lt;script&gt;" in own


def test_the_page_shows_every_position_with_its_limit(mapped):
    document, positions, _ = mapped
    figure = re.search(r"const \[data, layout\] = (.*);\nPlotly", page(*mapped)).group(1)
    data, layout = json.loads(figure)
    maps = [trace for trace in data if trace["type"] == "heatmap"]
    assert len(maps) == 4
    assert len(layout["sliders"][0]["steps"]) == 2
    said = [cell for trace in maps[::2] for row in trace["customdata"] for cell in row]
    assert len(said) == len(positions)
    for cell, p in zip(said, positions, strict=True):
        assert cell[:2] == [p.x_mm, p.y_mm]
        assert ("<b>admissible" in cell[3]) is p.admissible
        assert f"limit: {p.limiting}" in cell[3]
    drawn = sum(value is not None for trace in maps for row in trace["z"] for value in row)
    assert drawn == len(positions) == document["counts"]["positions"]


def test_the_slider_shows_one_turn_at_a_time(mapped):
    figure = re.search(r"const \[data, layout\] = (.*);\nPlotly", page(*mapped)).group(1)
    data, layout = json.loads(figure)
    for k, step in enumerate(layout["sliders"][0]["steps"]):
        shown = step["args"][0]["visible"]
        assert len(shown) == len(data)
        maps = [seen for seen, trace in zip(shown, data, strict=True) if trace["type"] == "heatmap"]
        assert maps == [k == 0, k == 0, k == 1, k == 1]


def test_the_picture_is_the_same_for_the_same_map(mapped):
    assert picture(*mapped) == picture(*mapped)


def test_the_picture_of_many_turns_shows_the_first_ones():
    path = strokes(600.0, 0.0)
    grid = reach.Grid(100.0, (-100.0, 0.0), (0.0, 100.0), tuple(float(k) for k in range(13)), (0.0,))
    positions = command.survey(command.Work(path, 10.0, 160.0), grid, 1, lambda _: None)
    made_for = {"plan": "p", "robot": "r", "elbow": "right", "registration": None}
    assert picture(
        reach.reach_document(path, grid, positions, made_for), positions, list(reach.outline(path))
    )


def test_on_a_terminal_a_bar_shows_how_far_it_is(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(command, "messages", lambda: Console(file=out, force_terminal=True, width=80))
    with command._progress(10, "judging") as done:
        done(7)
        done(3)
    assert "judging" in out.getvalue()
    assert "10/10" in out.getvalue()


def test_every_boundary_and_speed_has_its_kind_and_letter(mapped):
    assert {kind_of(name) for name in (*BOUNDARIES, "speed_q3", "acceleration_q0")} == set(KINDS)
    assert (
        len({kind.letter for kind in KINDS.values()})
        == len({kind.tint for kind in KINDS.values()})
        == len(KINDS)
    )
    document, positions, _ = mapped
    lost = [replace(p, ratio=None, clearance=None) if not p.admissible else p for p in positions]
    assert [one.kind.shape for one in layers(document, lost)] == [
        one.kind.shape for one in layers(document, positions)
    ]


def workers(pid):
    """How many child processes there are."""
    return sum(len(task.read_text().split()) for task in Path(f"/proc/{pid}/task").glob("*/children"))


@pytest.mark.processes
@pytest.mark.parametrize("wanted", [0, 2])
def test_an_interrupt_ends_the_command_at_once_and_leaves_no_file(path, tmp_path, wanted):
    """Before there are workers, and while they start or work: all processes of the terminal get it."""
    arguments = ["reach", path, "--robot", ROBOT, "--step-mm", 12, "--cores", 2, "--out", tmp_path / "map"]
    running = subprocess.Popen(
        [sys.executable, "-m", "cutgate.runtime.cli", *map(str, arguments)],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    try:
        assert "judging" in running.stderr.readline()
        while workers(running.pid) < wanted:
            assert running.poll() is None
            threading.Event().wait(0.01)
        os.killpg(running.pid, signal.SIGINT)
        _, err = running.communicate(timeout=60)
    finally:
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGKILL)
    assert (running.returncode, err) == (130, "")
    assert not list((tmp_path / "map").iterdir())
