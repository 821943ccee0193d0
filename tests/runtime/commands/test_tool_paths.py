"""``verify`` of tool path files: what is cut and what is only positioned, several tools, and what a person declares."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cutgate.config.load import PRESETS
from cutgate.runtime.commands import app
from cutgate.runtime.plan.load import plans_from_bytes
from cutgate.runtime.plan.toolpath.csv_writer import write_csv
from cutgate.runtime.plan.toolpath.model import Reading
from tests.runtime.commands.contract import VerifyDocument
from tests.tool_paths import tool_path

ROBOT = ["--robot", str(PRESETS.names["example"])]
ARM_MM = 5.0
"""Its deadband."""
LEAN = "0.5,0.,0.8660254"
"""A tool axis the robot can hold."""


def program(*parts, unit="MM"):
    """A cutter location file of these tools' statements."""
    lines = [f"UNITS/{unit}"]
    for tool, statements in enumerate(parts, start=1):
        lines += [f"LOADTL/{tool}", *statements]
    return "\n".join([*lines, "FINI", ""])


def goto(x, y, z):
    return f"GOTO/{x:.6f},{y:.6f},{z:.6f},{LEAN}"


FEED = "FEDRAT/600.,MMPM"
GOOD = ["RAPID", goto(600, 0, 220), "RAPID", goto(600, 0, 210), FEED, goto(600, 0, 200), goto(630, 0, 200)]
"""10 mm positioned, 40 mm cut."""
OUT = ["RAPID", goto(5000, 0, 200), FEED, goto(5030, 0, 200)]


@pytest.fixture
def verify(capsys, tmp_path):
    """Writes a file and runs ``verify`` in this process: exit code, standard output, standard error."""

    def call(text, *options, name="part.apt"):
        path = tmp_path / name
        path.write_text(text)
        code = app.execute(["verify", str(path), *ROBOT, *options])
        told = capsys.readouterr()
        return code, told.out, told.err

    return call


def test_the_path_is_what_is_cut_and_positioning_is_verified_as_well(verify):
    code, out, _ = verify(program(GOOD), "--json")
    document = VerifyDocument.model_validate_json(out)
    assert code == 0
    assert document.path.poses == 4
    assert document.path.tip_length_mm == pytest.approx(40.0)
    assert document.path.wrist_length_mm == pytest.approx(40.0)  # the axis is constant
    found = document.tool_path
    assert (found.tool, found.lines) == ("1", (4, 9))
    assert (found.cutting.segments, found.positioning.segments) == (2, 1)
    assert found.positioning.tip_length_mm == pytest.approx(10.0)
    high = [*GOOD[:2], "RAPID", goto(600, 0, 1200), *GOOD[2:]]
    code, out, _ = verify(program(high), "--json")
    document = VerifyDocument.model_validate_json(out)
    assert code == 1
    assert document.path.tip_length_mm == pytest.approx(40.0)
    assert document.boundaries["top"].violated
    assert document.boundaries["top"].line == 6


def test_what_chords_leave_out_of_an_arc_widens_the_deadbands(verify):
    arc = [*GOOD, "CIRCLE/630.,10.,200.,0.,0.,1.", goto(640, 10, 200)]
    plain = json.loads(verify(program(GOOD), "--json")[1])
    for tolerance in (0.01, 0.5):
        bent = json.loads(verify(program(arc), "--arc-tolerance-mm", str(tolerance), "--json")[1])
        wider = bent["deadband"]["arm_mm"] - plain["deadband"]["arm_mm"]
        assert wider == pytest.approx(tolerance, abs=1e-6)
        assert bent["tool_path"]["tolerance_mm"] == pytest.approx(tolerance, abs=1e-6)
        assert bent["path"]["tip_length_mm"] == pytest.approx(40 + 5 * math.pi, rel=0.02)
    assert plain["deadband"]["arm_mm"] == ARM_MM


def test_each_tool_has_a_verdict_of_its_own_and_the_worst_decides(verify):
    code, out, _ = verify(program(GOOD, OUT), "--json")
    document = json.loads(out)
    assert (code, document["verdict"]) == (1, "inadmissible")
    parts = [VerifyDocument.model_validate(part, strict=False) for part in document["tools"]]
    assert [part.verdict for part in parts] == ["admissible", "inadmissible"]
    assert [part.tool_path.tool for part in parts] == ["1", "2"]
    assert document["path"]["tip_length_mm"] == pytest.approx(70.0)
    assert document["path"]["poses"] == 6
    for name, worst in document["boundaries"].items():
        values = [part.boundaries[name].certified for part in parts]
        assert worst["certified"] == (None if None in values else min(values))
        assert values[worst["part"]] == worst["certified"]
    assert document["deadband"] == json.loads(verify(program(GOOD), "--json")[1])["deadband"]
    for joint, line in enumerate(document["speed"]):
        peaks = [part.speed[joint].peak for part in parts]
        assert line["peak"] == (None if None in peaks else max(peaks))
        assert peaks[line["part"]] == line["peak"]
    code, out, _ = verify(program(GOOD, GOOD), "--json")
    assert (code, json.loads(out)["verdict"]) == (0, "admissible")
    code, out, _ = verify(program(GOOD, OUT))
    assert code == 1
    assert "Part 1 of 2: tool 1, lines 4 to 9" in out
    assert "Part 2 of 2: tool 2, lines 12 to 14" in out
    assert "1 of 2 tools' paths are admissible" in out


def test_a_proof_is_of_one_tools_path(verify, tmp_path, capsys):
    proof = tmp_path / "proof.bin"
    code, _, err = verify(program(GOOD, GOOD), "--certificate", str(proof))
    assert code == 2
    assert "tool 1 from line 4, tool 2 from line 12, must be one tool" in err
    assert not proof.exists()
    assert verify(program(GOOD), "--certificate", str(proof))[0] == 0
    assert app.execute(["recheck", str(proof), str(tmp_path / "part.apt"), *ROBOT]) == 0
    assert "PROVEN" in capsys.readouterr().out


def test_it_is_explained_line_by_line_before_the_verdict_and_before_a_refusal(verify):
    code, out, _ = verify(program(GOOD), "--explain")
    lines = out.splitlines()
    assert code == 0
    assert lines[0].startswith("line 1: ")
    assert [line.split(":")[0] for line in lines[:10]] == [f"line {n}" for n in range(1, 11)]
    assert lines[10].startswith("ADMISSIBLE")
    code, out, err = verify(program([*GOOD, "CUTCOM/LEFT"]), "--explain")
    assert (code, len(out.splitlines())) == (2, 9)
    assert "line 10 is CUTCOM/LEFT" in err
    assert verify(program(GOOD), "--explain", "--json")[0] == 2
    code, _, err = verify("{}", "--explain", name="part.plan.json")
    assert code == 2
    assert "--explain: left out" in err


def test_one_feed_holds_for_the_whole_path_and_it_is_the_slowest(verify):
    two = [*GOOD, "FEDRAT/1200.,MMPM", goto(600, 0, 200)]
    assert "feed 10 mm/s" in verify(program(two))[1]
    assert "the file has 10 to 20 mm/s" in verify(program(two))[1]
    assert "feed 15 mm/s" in verify(program(two), "--feed-mm-s", "15")[1]
    for outside in ("9.9", "20.1"):
        code, _, err = verify(program(two), "--feed-mm-s", outside)
        assert code == 2
        assert f"--feed-mm-s is {outside}, must be one between the feeds" in err
    code, _, err = verify(program(GOOD), "--feed-mm-s", "15")
    assert code == 2
    assert "drop the option" in err


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (["--cutcom-is-tool-centre"], "part.csv"),
        (["--arc-tolerance-mm", "0.5"], "part.csv"),
        (["--rotary", "xyzac"], "part.apt"),
        (["--axis-tolerance-deg", "0.5"], "part.apt"),
    ],
)
def test_what_means_nothing_for_a_file_may_not_be_declared_of_it(verify, options, name):
    code, _, err = verify(program(GOOD), *options, name=name)
    assert code == 2
    assert f"{options[0]}: left out: it means nothing for" in err


BENT = program([*GOOD, "CIRCLE/630.,10.,200.,0.,0.,1.", goto(640, 10, 200)])
TURNING = "M428\nG21 F600\nG0 X600 Y0 Z200 A-30 C0\nG1 X630 C90\nG2 X640 Y10 I10 J0\nM2\n"


@pytest.mark.parametrize(
    ("name", "text", "reading"),
    [
        ("part.apt", BENT, Reading()),
        ("part.ngc", TURNING, Reading(rotary="xyzac")),
        ("part.csv", "X [in];nx;Y [in];ny;Z [in];nz\n23,5;0,6;0;0;8;0,8\n24;0,6;0;0;8;0,8\n", Reading()),
    ],
)
def test_a_file_written_as_csv_is_the_same_path(name, text, reading):
    (plan,) = plans_from_bytes(Path(name), text.encode(), reading=reading)
    (again,) = plans_from_bytes(Path("again.csv"), write_csv(plan.cut))
    assert np.array_equal(again.tips_mm, plan.tips_mm)
    assert np.array_equal(again.axes, plan.axes)


@pytest.mark.parametrize("tool_mm", [100.0, 200.0, 300.0])
def test_a_real_file_of_236_m_is_verified_tool_by_tool(capsys, tool_mm):
    path = tool_path("boss.apt")
    options = ["--cutcom-is-tool-centre", "--tool-length-mm", str(tool_mm), "--json"]
    assert app.execute(["verify", str(path), *ROBOT, *options]) == 1
    document = json.loads(capsys.readouterr().out)
    assert len(document["tools"]) == 4
    plans = plans_from_bytes(path, path.read_bytes(), reading=Reading(cutcom_is_tool_centre=True))
    ends = 0.0  # from the end of each line's move to that of the next: the way the file's length was stated
    for plan in plans:
        last = np.flatnonzero(np.append(plan.cut.lines[1:] != plan.cut.lines[:-1], True))
        steps = np.linalg.norm(np.diff(plan.tips_mm[last], axis=0), axis=1)
        ends += steps[~plan.cut.positioning[last][1:]].sum()
    assert ends == pytest.approx(236_135.0, rel=1e-3)
    assert (
        ends < document["path"]["tip_length_mm"] < 1.02 * ends
    )  # whole circles come back to where they begin
