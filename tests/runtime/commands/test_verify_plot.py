"""``cutgate verify --plot``: what is drawn, that the page is safe, and that files are whole or not there."""

import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import load_robot
from cutgate.runtime.commands import app as cli
from cutgate.runtime.commands import verify_plot
from cutgate.runtime.commands.verify_page import BAD, NONE, page, shades, steps
from cutgate.runtime.commands.verify_picture import picture
from cutgate.runtime.commands.verify_scene import (
    VERTICES_MAX,
    Drawn,
    Scene,
    deadband_lines,
    scene,
    thinned,
)
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import Prepared, prepare
from cutgate.runtime.verification import certified, stocco
from cutgate.runtime.verification.bounds.geometry import canonical_arm
from cutgate.runtime.verification.placing.guidance import guide, moved
from cutgate.runtime.verification.problem import ArmCalibration, Problem
from cutgate.runtime.verification.recorded import off_line_problem
from cutgate.runtime.workspace.distance import signed_distance
from tests.runtime.commands.page_policy import holds_to_its_own

EXAMPLES = Path(__file__).parents[3] / "examples"
ROBOT = EXAMPLES / "robot.toml"
CASES = {
    "first": ("hip-stem", "registration-first"),
    "second": ("hip-stem", "registration-second"),
    "femoral": ("femoral", "registration-femoral"),
    "tibial": ("tibial", "registration-tibial"),
}


def prepared(plan: str, registration: str) -> Prepared:
    placed = load_registration(EXAMPLES / f"{registration}.json")
    loaded = load_plan(EXAMPLES / f"{plan}.plan.json")
    robot = load_robot(ROBOT).value
    return prepare(loaded, placed, robot, now=datetime.now(UTC), clock_skew_s=0.0)


def problem_of(plan: str, registration: str) -> Problem:
    return off_line_problem(prepared(plan, registration).path, load_robot(ROBOT).value)


@pytest.fixture(scope="module")
def scenes() -> dict[str, Scene]:
    """The shipped plans, with guidance where they are inadmissible."""
    out = {}
    for name, (plan, registration) in CASES.items():
        given_ = prepared(plan, registration)
        problem = off_line_problem(given_.path, load_robot(ROBOT).value)
        verdict = certified.verify(problem)
        guidance = None if verdict.admissible else guide(problem, verdict, given_.quantise)
        out[name] = scene(problem, verdict, guidance, f"{plan} <b>& {registration}")
    return out


@pytest.fixture
def cutgate(capsys):
    """Runs ``verify`` of the tibial example in this process: exit code, standard output, standard error."""

    def call(*arguments, plan="tibial", registration="registration-tibial"):
        named = ["verify", plan, "--robot", ROBOT, "--registration", registration, *arguments]
        code = cli.execute([str(argument) for argument in named])
        told = capsys.readouterr()
        assert "Traceback" not in told.err
        return code, told.out, told.err

    return call


# ------------------------------------------------------------ what is drawn


@pytest.mark.parametrize("name", CASES)
def test_the_colours_are_of_the_clearances_that_the_verifier_attains(scenes, name):
    problem = problem_of(*CASES[name])
    verdict = certified.verify(problem)
    shown = scenes[name]
    least = dict(zip(shown.names, shown.values.min(axis=1), strict=True))
    for boundary, value in least.items():
        found = verdict.boundaries[boundary]
        assert found.certified - 1e-6 <= value
        assert value == pytest.approx(found.clearance, abs=0.05)
    assert {"inner", "outer", "left", "right", "top", "bottom", "pitch_min", "pitch_max"} <= set(least)
    assert ("roll_min" in least) == (verdict.boundaries["roll_min"].clearance is not None)


@pytest.mark.parametrize("name", CASES)
def test_what_is_violated_is_drawn_so_and_nothing_else(scenes, name):
    numbers = shades(scenes[name])
    assert (numbers == BAD).any() == (name == "first")
    assert not (numbers == NONE).any()
    assert np.array_equal(numbers == BAD, scenes[name].ratios < 1.0)
    edges = np.array(steps(scenes[name]))
    kept = numbers[numbers >= 0]
    assert np.all(edges[kept] <= scenes[name].ratios[numbers >= 0])


@pytest.mark.parametrize("name", CASES)
def test_worst_places_are_the_wrist_centres_of_the_verdicts_segments(scenes, name):
    problem = problem_of(*CASES[name])
    verdict = certified.verify(problem)
    for one in scenes[name].worst:
        found = verdict.boundaries[one.name]
        assert (one.clearance, one.required, one.violated) == (
            found.certified,
            found.deadband,
            found.violated,
        )
        if found.segment is None:
            assert one.above is None
            continue
        i = found.segment
        wrist = problem.tips_mm[i : i + 2] + problem.tool_length_mm * problem.axes[i : i + 2]
        low, high = wrist.min(axis=0) - 0.01, wrist.max(axis=0) + 0.01
        assert np.all(low[:2] <= one.above)
        assert np.all(one.above <= high[:2])
        assert low[2] <= one.side[1] <= high[2]
        assert one.side[0] == pytest.approx(math.hypot(*one.above))


def test_a_clearance_is_never_shown_as_more_than_is_proved(scenes):
    for shown in scenes.values():
        for one in shown.worst:
            if one.clearance is not None:
                assert one.clearance - 0.01 - 1e-6 < float(one.value.split()[0]) <= one.clearance + 1e-6


def test_the_proposed_path_is_the_path_moved(scenes):
    given_ = prepared(*CASES["first"])
    problem = problem_of(*CASES["first"])
    guidance = guide(problem, certified.verify(problem), given_.quantise)
    after = moved(problem, guidance.yaw_deg, guidance.pivot_mm, guidance.translation_mm)
    wrist = after.tips_mm + after.tool_length_mm * after.axes
    drawn, words = scenes["first"].proposed
    assert np.allclose(drawn.above[[0, -1]], wrist[[0, -1], :2])
    assert np.allclose(drawn.side[[0, -1], 1], wrist[[0, -1], 2])
    assert f"x {guidance.translation_mm[0]:+g}" in words
    assert scenes["second"].proposed is None
    verdict = certified.verify(problem)
    assert scene(problem, verdict, replace(guidance, verified=False), "").proposed is None


@pytest.mark.parametrize("elbow", ["right", "left"])
@pytest.mark.parametrize("span_deg", [60.0, 160.0, 300.0, 400.0])
def test_the_deadband_line_is_the_deadband_away_from_the_boundary(elbow, span_deg):
    problem = problem_of(*CASES["tibial"])
    half = math.radians(span_deg / 2.0)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[0], upper[0] = -half, half
    if elbow == "left":
        lower[1], upper[1] = -problem.upper[1], -problem.lower[1]
    geometry = canonical_arm(
        replace(
            problem,
            lower=lower,
            upper=upper,
            arm=replace(problem.arm, elbow=elbow),
            deadband=replace(problem.deadband, arm_mm=60.0),
        )
    )
    arcs = geometry.arcs[:2] if geometry.workspace.full_revolution else geometry.arcs
    lines = deadband_lines(geometry, arcs)
    assert len(lines) >= 2
    for line in lines:
        assert np.allclose(signed_distance(line, geometry.workspace), geometry.arm_mm, atol=1e-5)
    # Wherever a point is that far from the boundary, there is a line.
    points = np.random.default_rng(1).uniform(-950.0, 950.0, (40_000, 2))
    near = points[np.abs(signed_distance(points, geometry.workspace) - geometry.arm_mm) < 2.0]
    drawn = np.concatenate(lines)
    gaps = np.array([np.linalg.norm(drawn - point, axis=1).min() for point in near])
    assert len(near) > 50
    assert gaps.max() < 11.0


def test_a_left_elbow_is_the_mirror_image(scenes):
    problem = problem_of(*CASES["tibial"])
    mirror, signs = np.array((1.0, -1.0, 1.0)), np.array((-1.0, -1.0, 1.0, -1.0, 1.0))
    lower, upper = (
        np.minimum(problem.lower * signs, problem.upper * signs),
        np.maximum(problem.lower * signs, problem.upper * signs),
    )
    left = replace(
        problem, tips_mm=problem.tips_mm * mirror, axes=problem.axes * mirror, lower=lower, upper=upper,
        arm=replace(problem.arm, elbow="left"),
    )  # fmt: skip
    shown, other = scene(left, certified.verify(left), None, ""), scenes["tibial"]
    assert np.allclose(shown.path.above, other.path.above * (1.0, -1.0))
    assert np.allclose(shown.path.side, other.path.side)
    swapped = {"left": "right", "right": "left", "roll_min": "roll_max", "roll_max": "roll_min"}
    for name, values in zip(shown.names, shown.values, strict=True):
        assert np.allclose(values, other.values[other.names.index(swapped.get(name, name))])
    arcs = dict(other.arcs)
    for name, points in shown.arcs:
        assert np.allclose(points, arcs[swapped.get(name, name)] * (1.0, -1.0))


@given(
    st.integers(2, 400),
    st.integers(2, 40),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["walk", "line", "one"]),
)
def test_a_thinned_path_stays_as_near_as_it_says_and_keeps_the_least_of_its_values(n, most, seed, kind):
    draws = np.random.default_rng(seed)
    above = {
        "walk": np.cumsum(draws.normal(size=(n, 2)), axis=0),
        "line": np.arange(2.0 * n).reshape(n, 2),
        "one": np.zeros((n, 2)),
    }[kind]
    whole = Drawn(above, above[:, ::-1].copy(), np.arange(float(n)), 0.0)
    lines = draws.uniform(size=(2, n - 1))
    few, least = thinned(whole, lines, most)
    assert len(few.pose) == min(n, most)
    kept = few.pose.astype(int)
    assert (kept[0], kept[-1]) == (0, n - 1)
    for k, (i, j) in enumerate(pairwise(kept)):
        assert np.array_equal(least[:, k], lines[:, i:j].min(axis=1))
    # Every point left out is near the drawn line, in both views.
    chord = np.diff(few.above, axis=0)
    for point in above:
        along = np.einsum("ij,ij->i", point - few.above[:-1], chord) / np.maximum(
            np.einsum("ij,ij->i", chord, chord), 1e-300
        )
        foot = few.above[:-1] + np.clip(along, 0.0, 1.0)[:, None] * chord
        assert np.linalg.norm(point - foot, axis=1).min() <= few.off_mm + 1e-9


def test_a_path_of_one_long_segment_is_a_curve_from_the_side(tmp_path):
    problem = problem_of(*CASES["tibial"])
    short = replace(
        problem, tips_mm=np.array([[500.0, -200.0, 100.0], [500.0, 200.0, 100.0]]), axes=np.array([[0.0, 0.6, 0.8]] * 2)
    )  # fmt: skip
    shown = scene(short, certified.verify(short), None, "")
    middle = len(shown.path.side) // 2
    assert len(shown.path.pose) > 300
    assert shown.path.side[:, 0].min() == pytest.approx(500.0, abs=0.01)
    assert shown.path.pose[middle] == pytest.approx(0.5, abs=0.01)


SHOULDER, ELBOW = np.eye(5)[:2]
EXTREMES = {
    "nowhere": lambda p: replace(p, calibration=ArmCalibration(joint_offset=np.radians([0.0, -180.0, 0.0, 0.0, 0.0]))),
    "no elbow": lambda p: replace(p, lower=p.lower + 9.0 * ELBOW),
    "far away": lambda p: replace(p, tips_mm=p.tips_mm + 9000.0),
    "any turn": lambda p: replace(p, lower=p.lower - 9.0 * SHOULDER, upper=p.upper + 9.0 * SHOULDER),
    "leaning": lambda p: replace(p, calibration=ArmCalibration(slide_tilt=np.array((0.02, -0.01)))),
    "upright": lambda p: replace(p, axes=np.tile((0.0, 0.0, 1.0), (len(p.axes), 1)), hold_roll=0.1),
    "vertical": lambda p: replace(p, axes=np.tile((0.0, 0.0, 1.0), (len(p.axes), 1))),
    "one place": lambda p: replace(p, tips_mm=p.tips_mm[[0, 0]], axes=p.axes[[0, 0]]),
}  # fmt: skip


@pytest.mark.parametrize("changed", EXTREMES.values(), ids=EXTREMES)
@pytest.mark.parametrize("verify", [certified.verify, stocco.verify], ids=["certified", "stocco"])
def test_whatever_the_arm_and_the_path_a_page_is_drawn(changed, verify):
    problem = changed(problem_of(*CASES["tibial"]))
    verdict = verify(problem)
    text = page(scene(problem, verdict, None, ""))
    assert ("INADMISSIBLE" in text) == (not verdict.admissible)
    assert "nan" not in re.sub(r"<script.*?</script>", "", text.lower(), flags=re.DOTALL)


@pytest.mark.parametrize("changed", ["nowhere", "any turn"])
def test_a_picture_is_drawn_of_extremes_as_well(changed):
    problem = EXTREMES[changed](problem_of(*CASES["tibial"]))
    assert picture(scene(problem, certified.verify(problem), None, "a$b_c^")).startswith(b"\x89PNG")


# ------------------------------------------------------------ the page


def test_the_page_of_2000_poses_is_small(scenes):
    for shown in scenes.values():
        assert len(shown.path.pose) <= VERTICES_MAX
        assert len(page(shown).encode()) < 300_000


def test_the_page_allows_its_own_script_and_style_by_their_hashes_and_nothing_else(scenes):
    text = page(scenes["first"])
    holds_to_its_own(text, {"#above", "#side"})
    assert str(EXAMPLES.parent) not in text


class Outline(HTMLParser):
    """Elements in order, and whether all that are opened are closed."""

    VOID = frozenset({"meta", "input", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_text_of_files_is_no_markup_and_no_control_character(scenes):
    problem = problem_of(*CASES["tibial"])
    hostile = "a<script>alert(1)</script>&\u202e\x1b[2J\"'"
    text = page(scene(problem, certified.verify(problem), None, hostile))
    parsed = Outline()
    parsed.feed(text)
    assert parsed.open == []
    assert [tag for tag, _ in parsed.seen].count("script") == 2
    assert "a&lt;script&gt;" in text
    assert not set("\u202e\x1b") & set(text)
    assert "<b>" not in page(scenes["first"])


def test_the_page_says_verdict_worst_places_and_move_without_scripts(scenes):
    text = page(scenes["first"])
    bare = re.sub(r"<[^>]+>", "|", re.sub(r"<(script|style).*?</\1>", "", text, flags=re.DOTALL))
    assert "INADMISSIBLE: outer short by 27.832 mm; top short by" in bare
    assert "Proposed move: x -23.9  y -14.7  z -17.3 mm" in bare
    for one in scenes["first"].worst:
        assert re.search(rf"\|{one.name}\|+[^|]+\|+{re.escape(one.value)}\|", bare), one.name


def test_what_the_script_reads_is_the_path_with_its_nearest_limit(scenes):
    for shown in scenes.values():
        (text,) = re.findall(r'id="data">([^<]*)</script>', page(shown))
        data = json.loads(text)
        n = len(shown.path.pose)
        assert [len(data[key]) for key in ("x", "y", "z", "pose")] == [n] * 4
        assert len(data["value"]) == len(data["limiting"]) == n - 1
        for k in range(0, n - 1, 97):
            name = data["names"][data["limiting"][k]]["name"]
            values = shown.values[:, k] / shown.required
            assert shown.names[int(np.argmin(values))] == name
            assert 0.0 <= shown.values[shown.names.index(name), k] - data["value"][k] + 1e-8 < 0.011


# ------------------------------------------------------------ the command


def test_both_files_are_written_beside_the_verdict(cutgate, tmp_path):
    plain = cutgate()[1]
    code, out, err = cutgate("--plot", tmp_path / "a.html", "--plot", tmp_path / "B.PNG")
    assert code == 0
    assert [line for line in out.splitlines() if "elapsed" not in line] == [
        line for line in plain.splitlines() if "elapsed" not in line
    ]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["B.PNG", "a.html"]
    assert (tmp_path / "B.PNG").read_bytes().startswith(b"\x89PNG")
    assert "tibial-example, registration example-tibial" in (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "a.html: written" in err


def test_json_stays_one_document_and_shows_the_move(cutgate, tmp_path):
    code, out, _ = cutgate(
        "--plot", tmp_path / "a.html", "--json", plan="hip-stem", registration="registration-first"
    )
    assert code == 1
    x, y, z = json.loads(out)["guidance"]["translation_mm"]
    assert f"Proposed move: x {x:+g}  y {y:+g}  z {z:+g} mm" in (tmp_path / "a.html").read_text(
        encoding="utf-8"
    )


def test_what_could_not_be_drawn_or_written_is_refused_before_anything_is_verified(
    cutgate, tmp_path, monkeypatch
):
    a = tmp_path / "a.html"
    for arguments, words in (
        (("--plot", tmp_path / "a.pdf"), "--plot is .pdf, must be .html or .png; name another file"),
        (("--plot", tmp_path / "a"), "--plot is without extension, must be .html or .png"),
        (("--plot", a, "--plot", a), "named twice"),
        (("--plot", tmp_path / "none" / "a.html"), "no such folder; make it, or name another"),
    ):
        code, out, err = cutgate(*arguments)
        assert (code, out) == (2, "")
        assert words in err
    monkeypatch.setattr(verify_plot, "find_spec", lambda _: None)
    code, out, err = cutgate("--plot", tmp_path / "a.png")
    assert (code, out) == (2, "")
    assert "needs matplotlib, not installed here; pip install 'cutgate[pictures]', or ask for the page" in err
    assert cutgate("--plot", a)[0] == 0
    assert [p.name for p in tmp_path.iterdir()] == ["a.html"]


def test_a_file_that_cannot_be_written_is_refused_and_nothing_is_left(cutgate, tmp_path):
    (tmp_path / "a.html").mkdir()
    (tmp_path / "a.html" / "kept").touch()
    code, out, err = cutgate("--plot", tmp_path / "a.html")
    assert code == 2
    assert "ADMISSIBLE" in out
    assert "a.html: --plot: cannot be written" in err
    assert [p.name for p in tmp_path.iterdir()] == ["a.html"]
    assert [p.name for p in (tmp_path / "a.html").iterdir()] == ["kept"]


def test_a_file_of_before_stays_whole_where_drawing_fails(cutgate, tmp_path, monkeypatch):
    (tmp_path / "a.html").write_text("before", encoding="utf-8")

    def fails(_shown):
        raise RuntimeError("no")

    monkeypatch.setitem(verify_plot.MAKERS, ".html", fails)
    assert cutgate("--plot", tmp_path / "a.html")[0] not in (0, 1)
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == "before"
    assert len(list(tmp_path.iterdir())) == 1
