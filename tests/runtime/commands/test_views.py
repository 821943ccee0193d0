"""What people see of a verdict, and the sign of life while work is going on."""

import io
import threading
from dataclasses import replace

import pytest
from rich.console import Console

from cutgate.runtime.commands import screen
from cutgate.runtime.commands.verdict_view import boundaries_table, print_end, print_verdict, speed_table
from cutgate.runtime.verification.advice import Guidance, Move
from tests.runtime.verification.report.test_document import DIGESTS, GOOD, GUIDANCE, VERDICT


def printed(verdict=VERDICT, guidance=None) -> str:
    out = io.StringIO()
    console = Console(file=out, width=100, no_color=True)
    print_verdict(console, verdict, DIGESTS, {"plan": "p"})
    print_end(console, verdict, guidance)
    return out.getvalue()


def first_line(verdict) -> str:
    return printed(verdict).splitlines()[0]


def test_an_admissible_path_names_its_tightest_boundary_across_units():
    near = replace(GOOD, name="roll_max", unit="deg", certified=2.5, deadband=2.0)
    verdict = replace(
        VERDICT, admissible=True, boundaries={"outer": GOOD, "roll_max": near}, speed=(), reasons=()
    )
    assert first_line(verdict).startswith(
        "ADMISSIBLE: the whole path keeps every deadband; tightest is roll_max, 2.500 deg"
    )
    assert "Reasons" not in printed(verdict)


def test_an_admissible_verdict_without_any_boundary_is_still_said():
    assert (
        first_line(replace(VERDICT, admissible=True, boundaries={}))
        == "ADMISSIBLE: the whole path keeps every deadband"
    )


def test_an_inadmissible_path_names_known_shortfalls_before_what_is_undefined():
    short = replace(GOOD, certified=4.0, violated=True)
    fast = replace(VERDICT.speed[1], joint=1, peak=7.0)
    verdict = replace(
        VERDICT, boundaries={**VERDICT.boundaries, "outer": short}, speed=(*VERDICT.speed, fast)
    )
    said = "INADMISSIBLE: outer short by 1.000 mm; q3 too fast; q1 too fast; undefined: roll_min"
    assert printed(verdict).split("\n\n")[0].split() == said.split()


def test_a_path_refused_for_another_reason_says_it_at_once():
    """In a session these words are all that is said of why the verdict is what it is."""
    verdict = replace(VERDICT, boundaries={"outer": GOOD}, speed=())
    assert first_line(verdict) == "INADMISSIBLE: roll_min is undefined"


WIDE = replace(
    GOOD, certified=35957.1234, clearance=123456.7891, deadband=2.0, segment=1048574, tip_length_mm=98765.4
)


@pytest.mark.parametrize("width", [30, 40, 60, 80, 100, 120, 200])
@pytest.mark.parametrize("boundary", [GOOD, WIDE, replace(WIDE, certified=None, clearance=None)])
def test_no_width_costs_a_digit_or_a_head(width, boundary):
    verdict = replace(VERDICT, boundaries={"wrist_singularity": replace(boundary, name="wrist_singularity")})
    out = io.StringIO()
    console = Console(file=out, width=width, no_color=True)
    console.print(boundaries_table(verdict))
    console.print(speed_table(verdict))
    text = out.getvalue()
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert all(len(line.rstrip()) <= width for line in text.splitlines())
    values = [boundary.certified, boundary.deadband] + [line.limit for line in verdict.speed]
    for value in values:
        assert value is None or f"{value:.3f}" in text
    for head in ("certified", "deadband", "margin", "path mm", "peak"):
        assert head in " ".join(text.split())


def test_at_eighty_columns_a_table_of_usual_numbers_stays_one():
    out = io.StringIO()
    Console(file=out, width=80, no_color=True).print(boundaries_table(VERDICT))
    head, *rows = out.getvalue().splitlines()
    assert head.split() == ["boundary", "certified", "deadband", "margin", "at", "segment", "path", "mm"]
    assert len(rows) == len(VERDICT.boundaries)


def test_guidance_shows_the_combined_move_and_each_boundarys_own():
    text = printed(guidance=GUIDANCE)
    assert "x -3.5  y +0.2  z +0.0 mm (3.5 mm): verified, smallest clearance then 6.50 mm" in text
    assert "outer: move by 3.500 mm along (-1.00, +0.00, +0.00)" in text
    assert "roll_min: turn by 2.500 deg about the axis (+0.00, +0.00, +1.00)" in text


def test_an_unverified_move_is_never_shown_as_verified():
    text = printed(guidance=replace(GUIDANCE, verified=False, predicted_clearance_mm=None, moves=()))
    assert "(3.5 mm): not verified" in text
    assert "smallest clearance" not in text
    assert "hint" not in text


@pytest.mark.parametrize(("yaw", "sense"), [(6.5, "counter-clockwise"), (-6.5, "clockwise")])
def test_a_turn_is_shown_with_its_pivot_and_sense_before_the_move(yaw, sense):
    text = " ".join(printed(guidance=replace(GUIDANCE, yaw_deg=yaw)).split())
    turn = (
        f"First turn it by {yaw:+.1f} deg ({sense} seen from above) about the vertical through x 1.0 y 2.0 mm"
    )
    assert 0 < text.index(turn) < text.index("Then move it x -3.5 y +0.2 z +0.0 mm (3.5 mm): verified")


@pytest.mark.parametrize(("proved", "said"), [(True, "path: proved."), (None, "path, none was found.")])
def test_no_translation_helps_is_an_answer_and_says_whether_it_is_proved(proved, said):
    guidance = Guidance(
        None,
        0.0,
        (0.0, 0.0, 0.0),
        (Move("outer", "move", (1, 0, 0), distance_mm=1),),
        None,
        False,
        "no place fits; part the path",
        none_possible=proved,
    )
    text = printed(guidance=guidance)
    assert f"No translation of the bone cures this {said}" in text
    assert "No place fits." in text
    assert "Part the path." in text
    assert "verified" not in text.split("For each")[0]


def test_a_path_without_a_joint_branch_says_so():
    assert "joint branch" in printed(replace(VERDICT, branch=None))


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(screen, "PATIENCE_S", 0.0)


def wait_for(condition):
    for _ in range(5000):
        if condition():
            return
        threading.Event().wait(0.002)
    raise AssertionError("did not happen")


def test_long_work_is_announced_on_standard_error(impatient, capsys):
    heard = []
    with screen.working("doing it"):
        wait_for(lambda: heard.append(capsys.readouterr().err) or "doing it ..." in "".join(heard))


def test_short_work_is_silent(capsys):
    with screen.working("doing it"):
        pass
    assert capsys.readouterr().err == ""


def test_on_a_terminal_long_work_shows_a_spinner_that_goes_away(impatient, monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(screen, "messages", lambda: Console(file=out, force_terminal=True, width=80))
    with screen.working("doing it"):
        wait_for(lambda: "doing it" in out.getvalue())
    assert "\x1b[2K" in out.getvalue()


def test_colours_are_only_for_terminals(monkeypatch):
    for terminal in (True, False):
        monkeypatch.setattr("sys.stdout.isatty", lambda terminal=terminal: terminal)
        assert screen.output().no_color is not terminal
