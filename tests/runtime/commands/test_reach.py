"""``cutgate reach`` as people and programs call it."""

import base64
import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import zlib
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from pydantic import Field
from rich.console import Console

from cutgate.runtime.commands import app as cli
from cutgate.runtime.commands import reach as command
from cutgate.runtime.commands.reach_page import CIVIDIS, page
from cutgate.runtime.commands.reach_picture import COLOUR_MAP, KINDS, kind_of, layers, picture
from cutgate.runtime.verification.placing import reach
from cutgate.runtime.verification.placing.survey import Work
from cutgate.runtime.verification.verdict import BOUNDARIES
from tests.runtime.commands.contract import Hex, Name, Part, Real, Vector
from tests.runtime.commands.page_policy import holds_to_its_own
from tests.runtime.verification.placing.surveyed import survey
from tests.runtime.verification.placing.test_search import strokes

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
    checked: Literal["certified", "pose", "proved"]
    limiting: Limit
    unit: Literal["mm", "deg", "mm/s", "rad/s"]
    clearance: Real | None
    bound: Annotated[Real, Field(gt=0)]
    ratio: Real | None
    cell: Literal["admissible", "inadmissible", "unknown", "parted"]


class CellsPart(Part):
    yaw_deg: Real
    lift_mm: Real
    admissible_mm2: Real
    inadmissible_mm2: Real
    unknown_mm2: Real
    unknown_share: Real
    admissible: list[Vector]
    unknown: list[Vector]


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
    proved: int


class MovePart(Part):
    translation_mm: Vector
    yaw_deg: Real


class ReachDocument(Part):
    schema_: Annotated[Literal["cutgate.reach/1"], Field(alias="schema")]
    plan: str
    robot: str
    elbow: Literal["right", "left"]
    registration: str | None
    path_sha256: Hex
    registration_sha256: Hex
    pivot_mm: Vector
    lift_chosen_by: Literal["asked", "present", "guidance", "slide"]
    guidance: MovePart | None
    grid: GridPart
    counts: CountsPart
    cells: list[CellsPart]
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
    found = survey(Work(path, 10.0, 160.0), grid, 1, lambda _: None)
    made_for = {"plan": "p<script>", "robot": "r", "elbow": "right", "registration": None}
    return reach.reach_document(path, grid, found, made_for), found, list(reach.outline(path))


def test_the_document_is_complete_and_every_position_of_the_grid_stands_in_it(cutgate):
    code, out, _ = cutgate("--json", "--yaw-deg", "0,90")
    found = ReachDocument.model_validate_json(out)
    assert code == 0
    grid, counts = found.grid, found.counts
    size = len(grid.x_mm) * len(grid.y_mm) * len(grid.yaw_deg) * len(grid.lift_mm)
    assert len(found.positions) == size == counts.positions
    assert size == counts.certified + counts.excluded_by_a_pose + counts.proved
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
    assert "positions are admissible, each of them proved" in out
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


def test_the_page_allows_its_own_script_and_style_by_their_hashes_and_nothing_else(mapped):
    holds_to_its_own(page(*mapped))


def test_what_a_file_says_turns_no_reading_direction_and_is_no_control_character(mapped):
    document, *rest = mapped
    text = page(document | {"plan": "stem \u202eELBISSIMDA\u202c\x1b[2J\r"}, *rest)
    assert not set("\u202e\u202c\x1b\r") & set(text)
    assert r"stem \u202eELBISSIMDA\u202c\x1b[2J\r" in text


def test_what_a_file_says_is_no_markup_of_the_page(mapped):
    text = page(*mapped)
    assert "p<script>" not in text
    assert "p&lt;script&gt;" in text


def data_of(text):
    """What the page's script reads."""
    packed = re.search(r'id="data">([^<]*)<', text).group(1)
    return json.loads(zlib.decompress(base64.b64decode(packed, validate=True)))


def test_the_page_holds_every_position_with_its_limit_and_never_more_clearance_than_is_proved(mapped):
    document, (positions, *_), _ = mapped
    data = data_of(page(*mapped))
    size = len(data["x"]) * len(data["y"])
    codes = [code for layer in data["codes"] for code in layer[:size]]
    clearances = [value for layer in data["clearances"] for value in layer[:size]]
    assert len(data["codes"]) == 2
    assert len(codes) == len(clearances) == len(positions) == document["counts"]["positions"]
    for code, clearance, p in zip(codes, clearances, positions, strict=True):
        limit = data["limits"][code // 4]
        assert ("pose", "certified", "certified", "proved")[code % 4] == p.checked
        assert (code % 4 >= 2) is p.admissible
        assert (limit["name"], limit["unit"], limit["bound"]) == (p.limiting, p.unit, p.bound)
        assert 0.0 <= p.clearance - clearance / 100 < 0.0101
    at = [(x, y) for _ in data["codes"] for y in data["y"] for x in data["x"]]
    assert at == [(p.x_mm, p.y_mm) for p in positions]


def test_a_rate_is_never_shown_as_less_than_it_is_and_the_undefined_as_nothing(mapped):
    document, found, arcs = mapped
    odd = [
        replace(found.positions[0], limiting="speed_q0", clearance=1.2301),
        replace(found.positions[1], clearance=None, ratio=None),
        *found.positions[2:],
    ]
    assert data_of(page(document, found._replace(positions=odd), arcs))["clearances"][0][:2] == [124, None]


def test_a_page_takes_few_bytes_a_position(mapped):
    document, found, arcs = mapped
    many = [
        replace(p, clearance=(p.clearance or 0.0) * (1.0 + k / 100))
        for k in range(40)
        for p in found.positions
    ]
    grid = document["grid"] | {"lift_mm": [float(k) for k in range(40)]}
    alone = len(page(*mapped))
    assert alone < 64_000
    middles = sum(len(one) for one in found.middles)
    more = reach.Surveyed(many, found.squares * 40, found.middles * 40)
    assert len(page({**document, "grid": grid}, more, arcs)) - alone < 5 * (len(many) + 40 * middles)


def test_the_scale_of_the_page_is_that_of_the_picture():
    colours = [to_hex(colormaps[COLOUR_MAP](k / (len(CIVIDIS) - 1))) for k in range(len(CIVIDIS))]
    assert list(CIVIDIS) == colours


HIGH = "x,y,z,i,j,k\n500,0,480,0.6,0,0.8\n510,0,480,0.6,0,0.8\n"


def test_a_map_of_a_bone_too_high_begins_at_the_height_of_guidance_and_says_so(cutgate, tmp_path, path):
    path.write_text(HIGH, encoding="utf-8")
    moved = json.loads(cutgate_verify(path))["guidance"]["translation_mm"]
    _, out, _ = cutgate("--out", tmp_path / "map")
    document = json.loads((tmp_path / "map" / "reach.json").read_text(encoding="utf-8"))
    assert document["grid"]["lift_mm"] == [moved[2]]
    assert document["lift_chosen_by"] == "guidance"
    assert document["guidance"]["translation_mm"] == moved
    assert document["counts"]["admissible"] > 0
    assert f"Map at lift {moved[2]:g} mm: bone lowered, the height that guidance chooses." in out
    assert "guidance moves it: x" in out
    text = (tmp_path / "map" / "reach.html").read_text(encoding="utf-8")
    assert re.search(rf"<h1>[^\n]*lift {moved[2]:g} mm</span></h1>", text)
    assert data_of(text)["move"] == {"by": moved, "yaw": 0.0}


def test_where_guidance_finds_a_turn_between_the_places_of_the_grid_the_turn_is_shown_and_that_is_said(
    cutgate, tmp_path, path
):
    path.write_text("x,y,z,i,j,k\n780,300,600,0.28,0,0.96\n880,300,600,0.28,0,0.96\n", encoding="utf-8")
    text = ROBOT.read_text(encoding="utf-8")
    for joint, limits in (("q0", "[-20, 20]"), ("q1", "[34, 52]")):
        text = re.sub(rf"{joint}_deg = .*", f"{joint}_deg = {limits}", text)
    (tmp_path / "thin.toml").write_text(text, encoding="utf-8")
    _, out, _ = cutgate("--robot", tmp_path / "thin.toml", "--out", tmp_path / "map.html")
    assert re.search(r"guidance moves it: yaw -[0-9.]+ deg, x", out)
    assert "None is admissible" in out
    assert "guidance chooses lies between them: take a shorter --step-mm" in out
    data = data_of((tmp_path / "map.html").read_text(encoding="utf-8"))
    assert data["yaw"] == [data["move"]["yaw"], 0.0]
    assert data["first"] == 0


def cutgate_verify(path):
    out = io.StringIO()
    with redirect_stdout(out):
        cli.execute(["verify", str(path), "--robot", str(ROBOT), "--json"])
    return out.getvalue()


@pytest.mark.parametrize("lifts", [(-30.0,), (-30.0, 0.0)])
def test_the_picture_names_the_lift_in_heading_panels_and_axes(monkeypatch, lifts):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    path = strokes(600.0, 0.0)
    grid = reach.Grid(100.0, (-100.0, 0.0), (0.0, 100.0), (0.0,), lifts)
    found = survey(Work(path, 10.0, 160.0), grid, 1, lambda _: None)
    made_for = {"plan": "p", "robot": "r", "elbow": "right", "registration": None}
    move = reach.GridStart(0.0, -30.0, "guidance", (10.0, 20.0, -30.0))
    document = reach.reach_document(path, grid, found, made_for, move)
    picture(document, found, list(reach.outline(path)))
    (figure,) = figures
    assert ("lift -30 mm (bone lowered" in figure.get_suptitle()) is (len(lifts) == 1)
    panels = [axis for axis in figure.axes if axis.get_xlabel()]
    assert [axis.get_xlabel() for axis in panels] == [
        f"x of the reference point, mm, at lift {lift:g} mm" for lift in lifts
    ]
    assert all(f"lift {lift:g} mm" in axis.get_title() for axis, lift in zip(panels, lifts, strict=True))
    (legend,) = figure.legends
    assert "the move that guidance chooses" in [text.get_text() for text in legend.get_texts()]


def test_the_picture_is_the_same_for_the_same_map(mapped):
    assert picture(*mapped) == picture(*mapped)


def test_the_picture_of_many_turns_shows_the_first_ones():
    path = strokes(600.0, 0.0)
    grid = reach.Grid(100.0, (-100.0, 0.0), (0.0, 100.0), tuple(float(k) for k in range(13)), (0.0,))
    found = survey(Work(path, 10.0, 160.0), grid, 1, lambda _: None)
    made_for = {"plan": "p", "robot": "r", "elbow": "right", "registration": None}
    assert picture(reach.reach_document(path, grid, found, made_for), found, list(reach.outline(path)))


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
    document, found, _ = mapped
    lost = [replace(p, ratio=None, clearance=None) if not p.admissible else p for p in found.positions]
    assert [one.kind.shape for one in layers(document, found._replace(positions=lost))] == [
        one.kind.shape for one in layers(document, found)
    ]


def workers(pid):
    """How many child processes there are."""
    return sum(len(task.read_text().split()) for task in Path(f"/proc/{pid}/task").glob("*/children"))


@pytest.mark.processes
@pytest.mark.parametrize("wanted", [0, 2])
def test_an_interrupt_ends_the_command_at_once_and_leaves_no_file(path, tmp_path, wanted):
    """Before there are workers, and while they start or work: all processes of the terminal get it."""
    arguments = [
        "reach",
        path,
        "--robot",
        ROBOT,
        "--step-mm",
        12,
        "--cores",
        2,
        "--lift-mm",
        0,
        "--out",
        tmp_path / "map",
    ]
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
