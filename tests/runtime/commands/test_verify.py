"""``cutgate verify`` as people and programs call it."""

import json
import math
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from cutgate.runtime.commands import app as cli
from cutgate.runtime.commands import screen
from cutgate.runtime.commands import verify as command
from cutgate.runtime.verification.placing import guidance
from cutgate.runtime.verification.placing.guidance import guide
from tests.runtime.commands.contract import VerifyDocument
from tests.tool_paths import tool_path

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples"
ROBOT = EXAMPLES / "robot.toml"
PLAN = EXAMPLES / "hip-stem.plan.json"
SHORT = EXAMPLES / "tibial.plan.json"
FIRST, SECOND = EXAMPLES / "registration-first.json", EXAMPLES / "registration-second.json"

MOUNTED = ["--robot", str(ROBOT)]


@pytest.fixture
def cutgate(capsys):
    """Runs a command in this process: exit code, standard output, standard error."""

    def call(*arguments):
        code = cli.execute([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, said.out, said.err

    return call


@pytest.fixture
def verdict(cutgate):
    """Runs ``verify --json``: exit code and the document, checked against the contract."""

    def call(*arguments):
        code, out, _ = cutgate("verify", *arguments, "--json")
        return code, VerifyDocument.model_validate_json(out)

    return call


def placed(folder, translation, name="placed.json"):
    """A registration that only shifts."""
    rows = [[1, 0, 0, translation[0]], [0, 1, 0, translation[1]], [0, 0, 1, translation[2]], [0, 0, 0, 1]]
    document = {
        "schema": "cutgate.registration/1",
        "id": "placed",
        "R_T_CT": rows,
        "residual_rms_mm": 0.1,
        "created_utc": "2026-01-01T00:00:00Z",
    }
    (folder / name).write_text(json.dumps(document), encoding="utf-8")
    return folder / name


def test_the_first_registration_is_inadmissible_with_a_verified_way_out(verdict):
    code, found = verdict(PLAN, *MOUNTED, "--registration", FIRST)
    assert (code, found.verdict, found.method) == (1, "inadmissible", "certified")
    violated = {name for name, boundary in found.boundaries.items() if boundary.violated}
    assert {"outer", "top"} <= violated
    assert found.guidance.verified
    assert 10 <= sum(x * x for x in found.guidance.translation_mm) ** 0.5 <= 60
    assert {"outer", "top"} <= {move.boundary for move in found.guidance.moves}


def test_an_admitted_path_says_what_error_of_its_registration_it_tolerates(cutgate, verdict):
    """On the screen the sentence, in JSON the numbers; a refusal says nothing of it."""
    _, found = verdict(PLAN, *MOUNTED, "--registration", SECOND)
    error = found.registration_error
    assert error.ball_mm == pytest.approx(17.89, abs=0.02)
    assert 0.0 < error.both_ball_mm < error.ball_mm
    _, told, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND)
    told = " ".join(told.split())
    assert f"alone up to {error.ball_mm:.2f} mm, or {error.yaw_deg:.2f} deg (proved)." in told
    assert verdict(PLAN, *MOUNTED, "--registration", FIRST)[1].registration_error is None
    assert "Still admissible" not in cutgate("verify", PLAN, *MOUNTED, "--registration", FIRST)[1]


def test_check_points_are_shown_and_one_that_is_off_is_warned_of(cutgate, verdict, tmp_path):
    site = tmp_path / "site.toml"
    site.write_text('schema = "cutgate.site/1"\ncheck_points_min = 3\n', encoding="utf-8")
    document = json.loads(SECOND.read_text(encoding="utf-8"))
    to_robot = np.array(document["R_T_CT"])
    landmarks = {"epicondyle": (12.0, -31.0, 40.0), "notch [red]\x1b[2J": (-38.0, 5.0, 22.0)}
    document["check_points"] = [
        {"id": name, "ct_mm": ct, "robot_mm": (to_robot @ (*ct, 1.0))[:3].tolist()}
        for name, ct in landmarks.items()
    ]
    document["check_points"][1]["robot_mm"][2] += 2.25
    file = tmp_path / "checked.json"
    file.write_text(json.dumps(document), encoding="utf-8")
    code, found = verdict(PLAN, *MOUNTED, "--registration", file)
    assert code == 0, "it is an admissible path, wherever it is"
    assert [one.id for one in found.check_points] == list(landmarks)
    assert [one.residual_mm for one in found.check_points] == pytest.approx([0.0, 2.25])
    assert [one.code for one in found.warnings] == ["CHECK_POINT_OFF"]
    _, told, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", file, "--site", site)
    assert "\x1b" not in told
    told = " ".join(told.split())
    assert "epicondyle 0.000 mm off; notch [red]\\x1b[2J 2.250 mm off, TOO FAR" in told
    assert "(required: at least 3, each within 2 mm)" in told
    assert "WARNING CHECK_POINTS_MISSING: the registration has 2 check points" in told
    assert "WARNING CHECK_POINT_OFF: check point notch [red]\\x1b[2J is 2.25 mm off, more than 2 mm" in told
    _, told, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND)
    assert "check points" not in told
    assert verdict(PLAN, *MOUNTED, "--registration", SECOND)[1].check_points == []
    assert verdict(PLAN, *MOUNTED)[1].check_points == []


def test_a_registration_of_another_program_is_read_as_it_is_declared_and_that_is_shown(
    cutgate, verdict, tmp_path
):
    matrix = np.array(json.loads(SECOND.read_text(encoding="utf-8"))["R_T_CT"])
    file = tmp_path / "slicer.tfm"
    inverse = np.linalg.inv(matrix @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    numbers = " ".join(map(repr, [*inverse[:3, :3].ravel().tolist(), *inverse[:3, 3].tolist()]))
    file.write_text(
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {numbers}\nFixedParameters: 0 0 0\n",
        encoding="utf-8",
    )
    options = ["--registration-frame", "ras", "--registration-direction", "robot-to-ct"]
    options += ["--taken-at", "2026-01-15T08:02:11Z", "--registration-residual-mm", "0.31"]
    given = [PLAN, *MOUNTED, "--registration", file]
    code, found = verdict(*given, *options)
    _, same = verdict(PLAN, *MOUNTED, "--registration", SECOND)
    assert (code, found.verdict) == (0, "admissible")
    for name, boundary in found.boundaries.items():
        assert boundary.clearance == pytest.approx(same.boundaries[name].clearance, abs=1e-4)
    _, told, _ = cutgate("verify", *given, *options)
    told = " ".join(told.split())
    assert "inverted, for it takes robot to CT; x and y of the CT reversed (plan RAS, file LPS)" in told
    assert "registration residual 0.31 mm rms" in told
    proof = tmp_path / "proof"
    assert cutgate("verify", *given, *options, "--certificate", proof)[0] == 0
    assert cutgate("recheck", proof, *given, *options)[0] == 0
    code, out, said = cutgate("verify", *given)
    said = " ".join(said.split())
    assert (code, out) == (2, "")
    for option in options[::2]:
        assert f"{option}: is needed with" in said
    code, _, said = cutgate(
        "verify", PLAN, *MOUNTED, "--registration", SECOND, "--taken-at", "2026-01-15T08:02:11Z"
    )
    assert code == 2
    assert "must be left out" in " ".join(said.split())
    code, _, said = cutgate("reach", *given)
    assert code == 2
    assert "--registration-frame: is needed with" in " ".join(said.split())


def test_a_refusal_says_what_the_other_elbow_would_before_any_move_is_proposed(cutgate, verdict, tmp_path):
    """A shoulder that stops at 0 deg cannot cut this path with its right elbow, and could with its left one."""
    robot, path = tmp_path / "robot.toml", tmp_path / "path.csv"
    text = ROBOT.read_text(encoding="utf-8").replace("q0_deg = [-80.0", "q0_deg = [0.0")
    robot.write_text(text, encoding="utf-8")
    path.write_text("x,y,z,i,j,k\n500,0,100,0.5,0,0.8660254\n520,10,110,0.5,0,0.8660254\n", encoding="utf-8")
    code, found = verdict(path, "--robot", robot)
    assert (code, found.other_elbow.elbow, found.other_elbow.admissible) == (1, "left", True)
    assert found.other_elbow.q1_deg == (-145.0, 0.0)
    _, out, _ = cutgate("verify", path, "--robot", robot)
    told = " ".join(out.split())
    assert f"Other elbow: {found.other_elbow.text}" in told
    assert told.index("Other elbow: ") < told.index("How to move the bone")
    _, admitted = verdict(path, *MOUNTED)
    assert admitted.other_elbow is None


def test_the_joint_branch_can_be_asked_for_and_one_that_does_not_fit_is_refused(cutgate, verdict, tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("x,y,z,i,j,k\n500,0,100,0.5,0,0.8660254\n520,10,110,0.5,0,0.8660254\n", encoding="utf-8")
    wide = ["--robot", "figure2"]
    code, found = verdict(path, *wide, "--roll-turns", 2, "--q0-turns", -1)
    assert (code, found.branch.q0_turns, found.branch.roll_turns) == (0, -1, 2)
    code, out, said = cutgate("verify", path, *wide, "--roll-turns", 8)
    assert (code, out) == (2, "")
    assert "--roll-turns is 8, must be -" in said
    assert "+-2261 deg, what a joints frame carries with one revolution to spare" in " ".join(said.split())
    assert "turns that fit: -" in said


def test_the_second_registration_is_admissible_with_room_to_spare(verdict):
    code, found = verdict(PLAN, *MOUNTED, "--registration", SECOND)
    assert (code, found.verdict, found.guidance) == (0, "admissible", None)
    assert found.path.poses == 2000
    assert found.path.tip_length_mm == pytest.approx(5000, abs=10)
    assert min(boundary.certified for boundary in found.boundaries.values() if boundary.unit == "mm") >= 20
    assert max(line.peak / line.limit for line in found.speed) <= 0.5
    assert all(0 <= boundary.segment < 1999 for boundary in found.boundaries.values())


def test_verdicts_are_reproducible_but_for_the_time_they_took(verdict):
    first, again = (verdict(PLAN, *MOUNTED, "--registration", SECOND)[1] for _ in range(2))
    assert first.model_copy(update={"elapsed_ms": 0}) == again.model_copy(update={"elapsed_ms": 0})


def test_only_the_registration_digest_and_the_path_digest_change_with_the_registration(verdict):
    first, second = (verdict(PLAN, *MOUNTED, "--registration", r)[1].digests for r in (FIRST, SECOND))
    assert (first.limits, first.calibration) == (second.limits, second.calibration)
    assert first.path != second.path
    assert first.registration != second.registration


def test_the_papers_method_is_offered_beside_the_gates(verdict):
    code, found = verdict(PLAN, *MOUNTED, "--registration", SECOND, "--method", "stocco")
    assert code == (0 if found.verdict == "admissible" else 1)
    assert (found.method, found.guidance) == ("stocco", None)
    assert found.evaluations.best_case == 2 <= found.evaluations.arm <= found.evaluations.worst_case


def test_for_people_the_answer_comes_first_and_the_way_out_is_shown(cutgate):
    code, out, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", FIRST)
    lines = out.splitlines()
    assert code == 1
    assert lines[0].startswith("INADMISSIBLE: outer short by")
    assert any("How to move the bone" in line for line in lines)
    assert any("verified" in line and "mm" in line for line in lines)
    assert any("needs a new registration" in line for line in lines)
    assert max(map(len, lines)) <= 100
    assert "\x1b" not in out


def test_for_people_the_whole_verdict_is_there_before_the_way_out_is_looked_for(cutgate, monkeypatch, capsys):
    before = []

    def late(*given):
        before.append(capsys.readouterr().out)
        return guide(*given)

    monkeypatch.setattr(command, "guide", late)
    code, after, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", FIRST)
    assert code == 1
    assert before[0].startswith("INADMISSIBLE: outer short by")
    assert all(word in before[0] for word in ("wrist_singularity", "Reasons", "elapsed", "registration "))
    assert after.strip().startswith("How to move the bone")
    *_, again, rest, move = after.splitlines()
    assert [again, rest] == before[0].splitlines()[:2], "the answer is said last as well"
    assert re.match(r"  Move it x .* mm \(.* mm\): verified", move), "and with it what to do"


def test_a_way_out_that_is_looked_for_long_is_announced_beside_the_verdict(cutgate, monkeypatch, capsys):
    heard = []

    def slow(*given):
        for _ in range(5000):
            heard.append(capsys.readouterr().err)
            if "looking for the smallest move of the bone" in "".join(heard):
                return guide(*given)
            threading.Event().wait(0.002)
        raise AssertionError("not announced")

    monkeypatch.setattr(command, "guide", slow)
    monkeypatch.setattr(screen, "PATIENCE_S", 0.0)
    assert cutgate("verify", PLAN, *MOUNTED, "--registration", FIRST)[0] == 1


def test_for_programs_it_is_one_document_and_what_is_not_proved_is_null_with_a_note(verdict, monkeypatch):
    monkeypatch.setattr(guidance, "WORK", 1000)
    code, found = verdict(PLAN, *MOUNTED, "--registration", FIRST)
    assert (code, found.guidance) == (1, None)
    assert "that there is none is not proved" in found.guidance_note


def test_a_path_once_searched_without_end_is_answered_in_ten_seconds_of_processor_time(cutgate, tmp_path):
    """It goes once around the column, for a shoulder of 361 deg."""
    turn = [2 * math.pi * k / 24 for k in range(25)]
    rows = [
        f"{620 * math.cos(t)},{620 * math.sin(t)},100,{math.cos(t) / 2},{math.sin(t) / 2},{0.75**0.5}"
        for t in turn
    ]
    (tmp_path / "circle.csv").write_text("\n".join(("x,y,z,i,j,k", *rows, "")), encoding="utf-8")
    robot = ROBOT.read_text(encoding="utf-8").replace("q0_deg = [-80.0, 80.0]", "q0_deg = [-180.0, 181.0]")
    (tmp_path / "robot.toml").write_text(robot, encoding="utf-8")
    began = time.process_time()
    code, out, _ = cutgate("verify", tmp_path / "circle.csv", "--robot", tmp_path / "robot.toml")
    assert time.process_time() - began < 10.0
    assert code == 1
    assert "No translation of the bone cures this path: proved." in out


def test_digests_are_shown_on_demand(cutgate):
    assert "SHA-256" not in cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND)[1]


def test_for_people_every_boundary_speed_and_digest_is_listed(cutgate):
    code, out, _ = cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND, "-v")
    assert code == 0
    assert out.startswith("ADMISSIBLE: the whole path keeps every deadband; tightest is top")
    names = "inner outer left right top bottom roll_min roll_max pitch_min pitch_max wrist_singularity q0 q1 q2 q3 q4"
    starts = {line.split()[0] for line in out.splitlines() if line.strip()}
    assert set(names.split()) <= starts
    assert "CT                    linked" in out
    for name in ("path", "limits", "calibration", "registration"):
        assert f"{name} SHA-256" in out


def test_a_plan_without_a_registration_is_said_to_stand_as_it_is(cutgate, tmp_path):
    (tmp_path / "p.csv").write_text(
        "x,y,z,i,j,k\n600,0,200,0.6,0,0.8\n610,0,200,0.6,0,0.8\n", encoding="utf-8"
    )
    code, out, _ = cutgate("verify", tmp_path / "p.csv", *MOUNTED)
    assert code == 0
    assert "none given: identity" in out
    assert "feed 10 mm/s" in out


def test_feed_and_tool_options_reach_the_verdict(verdict, tmp_path):
    (tmp_path / "p.csv").write_text(
        "x,y,z,i,j,k\n600,0,200,0.6,0,0.8\n610,0,200,0.6,0,0.8\n", encoding="utf-8"
    )
    slow = verdict(tmp_path / "p.csv", *MOUNTED, "--feed-mm-s", 5)[1]
    fast = verdict(tmp_path / "p.csv", *MOUNTED, "--feed-mm-s", 500)[1]
    assert fast.speed[0].peak == pytest.approx(100 * slow.speed[0].peak, rel=0.1)
    longer = verdict(tmp_path / "p.csv", *MOUNTED, "--tool-length-mm", 260)[1]
    assert longer.boundaries["top"].certified == pytest.approx(
        slow.boundaries["top"].certified - 80, abs=1e-2
    )


@pytest.mark.parametrize(
    ("name", "poses", "length_mm"), [("blade-channel.csv", 561, 427.4), ("impeller-blade.csv", 484, 330.8)]
)
def test_a_five_axis_path_is_admitted(verdict, tmp_path, name, poses, length_mm):
    code, found = verdict(tool_path(name), *MOUNTED, "--registration", placed(tmp_path, (600, 0, 200)))
    assert (code, found.verdict, found.path.poses) == (0, "admissible", poses)
    assert found.path.tip_length_mm == pytest.approx(length_mm, abs=0.1)


@pytest.mark.parametrize("name", ["whole-wheel.csv", "impeller-op1.csv"])
def test_a_path_that_goes_round_is_refused_naming_roll(verdict, cutgate, tmp_path, name):
    arguments = (tool_path(name), *MOUNTED, "--registration", placed(tmp_path, (600, 0, 200)))
    code, found = verdict(*arguments)
    assert (code, found.verdict) == (1, "inadmissible")
    violated = {name for name, boundary in found.boundaries.items() if boundary.violated}
    assert violated
    assert violated <= {"roll_min", "roll_max"}
    assert "roll_m" in cutgate("verify", *arguments)[1].splitlines()[0]


BAD = {
    "missing plan": (["nowhere.json", *MOUNTED], ["nowhere.json", "no such file"]),
    "missing robot": ([PLAN, "--robot", "nowhere.toml"], ["nowhere.toml", "no such file"]),
    "missing registration": (
        [PLAN, *MOUNTED, "--registration", "nowhere.json"],
        ["nowhere.json", "no such file"],
    ),
    "folder as plan": ([EXAMPLES.with_suffix(".json"), *MOUNTED], ["no such file"]),
    "robot as plan": ([ROBOT, *MOUNTED], ["robot.toml", ".toml", ".json or .csv"]),
    "plan as robot": ([PLAN, "--robot", SHORT], ["tibial.plan.json", "TOML"]),
    "plan as registration": ([PLAN, *MOUNTED, "--registration", SHORT], ["schema", "cutgate.plan/1"]),
    "long plan as robot": ([PLAN, "--robot", PLAN], ["hip-stem.plan.json", "size", "<= 100000 bytes"]),
    "registration as plan": ([FIRST, *MOUNTED], ["schema", "cutgate.registration/1", "cutgate.plan/1"]),
    "G-code": (["path.ngc", *MOUNTED], ["path.ngc", "no such file"]),
    "APT": (["path.apt", *MOUNTED], ["path.apt", ".apt"]),
    "another extension": ([PLAN, *MOUNTED, "--registration", "r.xfm"], ["r.xfm", ".xfm", ".json"]),
    "another tool": ([PLAN, *MOUNTED, "--tool-length-mm", "150"], ["tool_length_mm", "160", "150"]),
    "another feed": ([PLAN, *MOUNTED, "--feed-mm-s", "5"], ["feed_mm_s", "20", "5 mm/s"]),
    "no robot": ([PLAN], ["--robot"]),
    "no path": ([*MOUNTED], ["PATH"]),
    "unknown option": ([PLAN, *MOUNTED, "--force"], ["--force"]),
    "unknown method": ([PLAN, *MOUNTED, "--method", "guess"], ["guess", "certified"]),
    "tool out of bounds": ([PLAN, *MOUNTED, "--tool-length-mm", "-1"], ["--tool-length-mm", "0"]),
    "tool not a number": ([PLAN, *MOUNTED, "--tool-length-mm", "nan"], ["--tool-length-mm"]),
    "feed not finite": ([PLAN, *MOUNTED, "--feed-mm-s", "inf"], ["--feed-mm-s", "10000"]),
    "null character": (["a\0b.json", *MOUNTED], ["PATH", "null"]),
}


@pytest.mark.parametrize(("arguments", "parts"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_refused_with_exit_2_and_nothing_on_standard_output(cutgate, arguments, parts):
    code, out, err = cutgate("verify", *arguments, "--json")
    assert (code, out) == (2, "")
    for part in parts:
        assert part in err


def test_an_internal_error_is_one_line_and_exit_70(cutgate, monkeypatch):
    def broken(problem):
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr("cutgate.runtime.verification.certified.verify", broken)
    code, out, err = cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND)
    assert (code, out) == (70, "")
    assert err.count("\n") == 1
    assert "internal error: RuntimeError: first line second line" in err


def test_an_interrupt_is_exit_130(cutgate, monkeypatch):
    def interrupted(problem):
        raise KeyboardInterrupt

    monkeypatch.setattr("cutgate.runtime.verification.certified.verify", interrupted)
    assert cutgate("verify", PLAN, *MOUNTED, "--registration", SECOND)[0] == 130


def test_usage_errors_and_help(cutgate):
    assert cutgate("nonsense")[0] == 2
    assert cutgate()[0] == 2
    code, out, _ = cutgate("verify", "--help")
    assert code == 0
    assert "--registration" in out


@pytest.mark.processes
def test_the_installed_program_does_the_same():
    result = subprocess.run(
        [
            sys.executable,
            "-m",
            "cutgate.runtime.cli",
            "verify",
            PLAN,
            *MOUNTED,
            "--registration",
            FIRST,
            "--json",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert result.returncode == 1
    assert VerifyDocument.model_validate_json(result.stdout).verdict == "inadmissible"
