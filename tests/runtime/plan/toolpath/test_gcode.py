"""G-code: what each word does, what is refused and where, and two real programs."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath.gcode import CODES, NAMED, ORDER, TOLD_MAX, WORK_PER_POSE, read_gcode
from cutgate.runtime.plan.toolpath.languages import LANGUAGES
from cutgate.runtime.plan.toolpath.model import PLAIN, Reading
from tests.runtime.plan.toolpath.reading import HEAD, LIMIT, XYZAC, after_head, cut_of, path_of, refused, tips
from tests.tool_paths import tool_path

ORIGIN = (0.0, 0.0, 0.0)


# ------------------------------------------------------------------ the table


def test_every_group_has_a_place_in_the_order():
    assert {row.group for row in CODES.values()} <= set(ORDER)
    assert set(NAMED.values()) <= set(CODES)


@pytest.mark.parametrize("code", sorted(code for code, row in CODES.items() if row.meaning == "refused"))
def test_what_only_the_machine_knows_is_refused(code: str):
    text = refused(f"{HEAD}G1 X1\n{code} X1\nM2\n", 4, f"is {code}, must be")
    assert "; " in text, "a remedy"


MOVES_COORDINATES = "G10 G50 G51 G52 G53 G55 G56 G57 G58 G59 G59.1 G59.2 G59.3 G68 G68.2 G69 G92 G92.1 G92.2 G92.3 G43.2 G43.5"
NEEDS_THE_MACHINE = "G7 G28.1 G30.1 G33 G33.1 G38.2 G38.3 G38.4 G38.5 G96 M50 M51 M52 M53 M60 M61 M62 M63 M64 M65 M66 M67 M68 M430"


@pytest.mark.parametrize(
    ("codes", "reason"),
    [
        (MOVES_COORDINATES, "moves the coordinates"),
        (NEEDS_THE_MACHINE, "depends on the machine"),
        ("G41 G41.1 G42 G42.1", "the tool's radius"),
        ("G76 G84 G85 G86 G87 G88 G89", "one of the cycles"),
        ("M98 M99", "another program"),
    ],
)
def test_the_reason_of_a_refusal_is_that_of_the_word(codes: str, reason: str):
    for code in codes.split():
        refused(f"{HEAD}{code}\nM2\n", 3, f"is {code}, must be", reason)


@given(st.integers(0, 9999), st.sampled_from("GM"))
def test_every_word_without_a_row_is_refused(tenths: int, letter: str):
    code = f"{letter}{tenths // 10}" + (f".{tenths % 10}" if tenths % 10 else "")
    if code not in CODES:
        refused(f"{HEAD}{code}\nM2\n", 3, code)


def test_one_word_of_each_group():
    groups = {}
    for code, row in CODES.items():
        groups.setdefault(row.group, []).append(code)
    for codes in groups.values():
        for other in codes[1:]:
            refused(f"{HEAD}{codes[0]} {other}\nM2\n", 3, "one word of the group")


# ----------------------------------------------------------- straight moves


def test_positioning_and_feed():
    cut = after_head("G1 X1\nX2 Y2\nG0 Z5\ng1 z 0 F120")
    assert cut.tips_mm.tolist() == [[0, 0, 0], [1, 0, 0], [2, 2, 0], [2, 2, 5], [2, 2, 0]]
    assert cut.positioning.tolist() == [True, False, False, True, False]
    assert np.isnan(cut.feeds_mm_s[[0, 3]]).all()
    assert cut.feeds_mm_s[[1, 2, 4]].tolist() == [1, 1, 2]
    assert cut.lines.tolist() == [2, 3, 4, 5, 6]
    assert (cut.axes == [0, 0, 1]).all()
    assert (cut.tolerance_mm, cut.tolerance_deg, cut.tool, cut.tool_length_mm) == (0, 0, "", None)


def test_differences_and_inches():
    assert tips("G91 G1 X1\nX1 Y-1\nG90 X5\nG20\nF9 X1\nG91 X1") == [
        *((1, 0, 0), (2, -1, 0), (5, -1, 0), (25.4, -1, 0), (50.8, -1, 0))
    ]
    assert after_head("G20\nG1 X1 F60").feeds_mm_s[-1] == pytest.approx(25.4)


def test_without_a_unit_lengths_are_mm_and_that_is_told():
    remarks = []
    path_of("G0 X0 Y0 Z0\nG1 X1 F60\nM2", told=lambda line, text: remarks.append((line, text)))
    assert remarks[0][0] == 1
    assert "read as mm" in remarks[0][1]
    assert "read as mm" not in remarks[1][1]
    assert "X1" in remarks[1][1]
    assert cut_of("G0 X0 Y0 Z0\nG21 G1 X1 F60\nM2").tips_mm[-1].tolist() == [1, 0, 0]
    refused("G0 X0 Y0 Z0\nG20\nG1 X1 F60\nM2", 2, "G20", "before the first length")


def test_a_motion_that_goes_on_is_told():
    remarks = {}
    path_of(f"{HEAD}G1 X1\nY2\nM2", told=lambda line, text: remarks.update({line: text}))
    assert remarks[3].startswith("G1 straight at the feed; tip X1 Y0 Z0")
    assert remarks[4].startswith("G1 straight at the feed; tip X1 Y2 Z0")
    assert remarks[5].startswith("M2 end")


def test_what_is_told_is_bounded(monkeypatch):
    monkeypatch.setattr("cutgate.runtime.plan.toolpath.gcode.TOLD_MAX", 5)
    remarks = []
    program = f"{HEAD}o1 repeat [9]\nG91 G1 X1\no1 endrepeat\nM2"
    path_of(program, told=lambda line, text: remarks.append(text))
    assert TOLD_MAX > 5
    assert len(remarks) == 6
    assert "nothing more is told" in remarks[-1]


def test_feeds():
    assert after_head("G94 F30 G1 X1").feeds_mm_s[-1] == 0.5
    assert after_head("G93 G1 X3 Y4 F2").feeds_mm_s[-1] == pytest.approx(5 * 2 / 60)
    assert after_head("G95 S120 F.5 G1 X1").feeds_mm_s[-1] == 1
    for lines, part in (
        ("G93 G1 X1", "in every line"),
        ("G93\nG1 X1 F1\nX2", "in every line"),
        ("G93\nG94\nG1 X1", "anew after"),
        ("G95 F1\nG1 X1", "S over 0"),
        ("F0\nG1 X1", "F over 0"),
        ("G20\nG1 X1", "anew after"),
    ):
        refused(f"{HEAD}{lines}\nM2", 2 + lines.count("\n") + 1, part)
    refused("G21\nG0 X0 Y0 Z0\nG1 X1\nM2", 3, "no feed")
    for lines in ("F-1", "S-1", "T-1", "T1.5", "G20 F1", "G4 P-1", "G4", "G64 P-1", "Q1", "H1", "X1 D1 G1"):
        refused(f"{HEAD}{lines}\nM2", 3)


def test_a_move_needs_a_place_to_start_from():
    assert cut_of("G21 F60\nG1 X0 Y0 Z0\nG1 X1\nM2").positioning.tolist() == [True, False]
    assert len(cut_of("G21 F60\nG0 X0\nY0\nZ0\nG1 X1\nM2").tips_mm) == 2
    refused("G21 F60\nG1 X0 Y0\nM2", 2, "while X Y Z is not known")
    refused("G21 F60\nG0 X0 Y0\nG1 Z1\nM2", 3, "while Z is not known")
    refused("G21 F60\nG0 X0 Y0\nG1 X1 Y1 Z1\nM2", 3, "while Z is not known")
    refused("G21 F60\nG91 G0 X1\nM2", 2, "X in G91")
    refused("G21 F60\nX1\nM2", 2, "without a motion")
    refused("G21 F60\nG0 X1 Y1\nG2 X2 I1\nM2", 3, "Z is not known")
    refused(f"{HEAD}G80\nX1\nM2", 4, "without a motion")
    refused(f"{HEAD}G80 X1\nM2", 3, "axis words with G80")


def test_a_program_ends():
    refused(f"{HEAD}G1 X1\n", 4, "cut off")
    assert len(cut_of(f"%\n{HEAD}G1 X1\n%\nrest").tips_mm) == 2
    assert len(cut_of(f"{HEAD}G1 X1\nM30\nrest is never read (").tips_mm) == 2
    refused("G21\nM2", 0, "it moves no tool")


def test_a_lone_word_moves_nothing():
    assert (
        len(
            after_head(
                "G1\nG0\nM3 S1 M8\nG4 P1\nM0\nM48\nG17 G40 G49 G54 G61\nG64\nG64 P.1 Q.1\nG1 X1"
            ).tips_mm
        )
        == 2
    )


# --------------------------------------------------------------------- arcs


@pytest.mark.parametrize(
    ("plane", "axes", "centre"), [("G17", "XYZ", "IJ"), ("G18", "ZXY", "KI"), ("G19", "YZX", "JK")]
)
@given(
    radius=st.floats(0.5, 50),
    start=st.floats(0, 6.28),
    sweep=st.floats(0.01, 6.27),
    rise=st.floats(-5, 5),
    clockwise=st.booleans(),
    turns=st.integers(1, 3),
    kind=st.sampled_from(["centre", "absolute", "radius"]),
)
def test_arcs_are_true_circles(plane, axes, centre, radius, start, sweep, rise, clockwise, turns, kind):
    way = -1.0 if clockwise else 1.0
    a, b = (math.cos(start), math.sin(start)), (math.cos(start + way * sweep), math.sin(start + way * sweep))
    at = dict(zip(axes, (radius * a[0], radius * a[1], 0.0), strict=True))
    to = dict(zip(axes, (radius * b[0], radius * b[1], rise), strict=True))
    turns = 1 if kind == "radius" else turns
    if kind == "radius":
        if abs(sweep - math.pi) < 1e-2 or sweep < 0.1 or sweep > 6.2:
            return  # R says little of the centre there
        shape = f"R{'-' if sweep > math.pi else ''}{radius:.12f}"
    elif kind == "absolute":
        shape = f"G90.1 {centre[0]}0 {centre[1]}0 P{turns}"
    else:
        shape = f"{centre[0]}{-at[axes[0]]:.12f} {centre[1]}{-at[axes[1]]:.12f} P{turns}"
    code = "G2" if clockwise else "G3"
    first = " ".join(f"{letter}{value:.12f}" for letter, value in at.items())
    last = " ".join(f"{letter}{value:.12f}" for letter, value in to.items())
    cut = cut_of(f"G21 {plane} F60\nG0 {first}\n{code} {last} {shape}\nM2", Reading(arc_tolerance_mm=0.01))
    order = ["XYZ".index(letter) for letter in axes]
    u, v, w = cut.tips_mm[:, order].T
    angle = np.unwrap(np.arctan2(v, u))
    whole = way * (sweep + math.tau * (turns - 1))
    loose = 1e-4 if kind == "radius" else 1e-6
    assert np.abs(np.hypot(u, v) - radius).max() <= loose
    assert angle[-1] - angle[0] == pytest.approx(whole, abs=loose)
    assert np.abs(w - rise * (angle - angle[0]) / whole).max() <= loose * 100
    assert radius * (1 - math.cos(np.abs(np.diff(angle)).max() / 2)) <= 0.01 + 1e-9
    assert 0.01 <= cut.tolerance_mm <= 0.011


def test_a_whole_circle_and_its_turns():
    one, three = (after_head(f"G2 I5 P{n}") for n in (1, 3))
    length = [np.linalg.norm(np.diff(cut.tips_mm, axis=0), axis=1).sum() for cut in (one, three)]
    assert length[0] == pytest.approx(10 * math.pi, rel=1e-3)
    assert length[1] == pytest.approx(3 * length[0], rel=1e-3)
    assert one.feeds_mm_s[-1] == 1
    assert after_head("G93 G2 I5 F1").feeds_mm_s[-1] == pytest.approx(10 * math.pi / 60, rel=1e-3)


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        ("G2 X1", "an arc without I J"),
        ("G90.1 G2 X1 I1", "an arc without J"),
        ("G2 X2 K1", "K of an arc"),
        ("G2 X2 I1 K1", "K of an arc"),
        ("G2 X2 I1 P0", "P0"),
        ("G2 X2 I1 P1.5", "1.5"),
        ("G2 R1", "back to its start"),
        ("G2 X2 R.99", ">= 1 mm"),
        ("G2 X2 I1.5", "the same within"),
        ("G2 X1 E1", "E word"),
        ("G2 X2 I1 P9999999", "left of the pose limit"),
        ("G2 X0 Y0.0000005 I1", "millionth"),
        ("G2 X0 Y0.000005 I10", "millionth"),
        ("G2 I0", "radius"),
        ("G2 X2 I1 A1", "--rotary"),
        ("G2 G4 X2 I1 P1", "P with"),
    ],
)
def test_arcs_that_are_none(lines: str, part: str):
    refused(f"{HEAD}{lines}\nM2", 3, part)


def test_half_a_turn_may_be_rounded():
    assert after_head("G2 X2 R.9999").tips_mm[-1].tolist() == [2, 0, 0]


# ------------------------------------------------------------------- cycles


def test_cycles_as_linuxcnc_executes_them():
    high = "G0 Z10\n"
    first = [(0, 0, 10), (1, 1, 10), (1, 1, 2), (1, 1, -5)]
    assert tips(f"{high}G99 G81 X1 Y1 R2 Z-5\nX3") == [*first, (1, 1, 2), (3, 1, 2), (3, 1, -5), (3, 1, 2)]
    assert tips(f"{high}G98 G81 X1 Y1 R2 Z-5\nX3") == [
        *(*first, (1, 1, 10), (3, 1, 10), (3, 1, 2), (3, 1, -5), (3, 1, 10))
    ]
    # a series remembers where it began, whatever cycles it consists of
    for following in ("G98 X4", "G98 G82 P1 X4 R2 Z-5", "G98 G83 X4 R2 Z-5 Q9"):
        assert tips(f"{high}G99 G81 X1 Y1 R2 Z-5\n{following}") == [
            *(*first, (1, 1, 2), (4, 1, 10), (4, 1, 2), (4, 1, -5), (4, 1, 10))
        ]
    # above R it stays as high as it stands
    assert tips(f"{high}G99 G81 X1 Y1 R2 Z-5\nG98 X4 R1")[4:7] == [(1, 1, 2), (4, 1, 2), (4, 1, 1)]
    # below R it rises on its way; where the series began below R, it comes to R before
    assert tips(f"{high}G99 G81 X1 Y1 R2 Z-5\nX4 R6")[4:] == [(1, 1, 2), (4, 1, 6), (4, 1, -5), (4, 1, 6)]
    assert tips(f"{high}G99 G81 X1 Y1 R2 Z-5\nG98 X4 R6")[5:7] == [(4, 1, 10), (4, 1, 6)]
    assert tips("G99 G81 X1 R8 Z-5\nX2 R4")[3:] == [(1, 0, 8), (1, 0, 4), (2, 0, 4), (2, 0, -5), (2, 0, 4)]
    assert tips(f"{high}G91 G99 G82 P1 X1 R-2 Z-5 L2") == [
        *((0, 0, 10), (1, 0, 10), (1, 0, 8), (1, 0, 3), (1, 0, 8), (2, 0, 8), (2, 0, 3), (2, 0, 8))
    ]
    # below R it rises first
    assert tips("G98 G81 X1 R2 Z-5") == [(0, 0, 2), (1, 0, 2), (1, 0, -5), (1, 0, 2)]
    assert tips("G18 G81 Z1 R2 Y-1") == [(0, 2, 0), (0, 2, 1), (0, -1, 1), (0, 2, 1)]
    assert tips("G83 R0 Z-3 Q2") == [(0, 0, -2), (0, 0, 0), (0, 0, -1.746), (0, 0, -3), (0, 0, 0)]
    cut = after_head("G73 X1 R0 Z-3 Q2")
    assert cut.tips_mm[2:, 2].tolist() == pytest.approx([-2, -1.746, -3, 0])
    assert cut.positioning[2:].tolist() == [False, True, False, True]


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        ("G81 X1 R1", "G81 without Z"),
        ("G81 X1 Z-1", "G81 without R"),
        ("G83 X1 Z-1 R1", "G83 without Q"),
        ("G83 X1 Z-1 R1 Q0", "Q0"),
        ("G81 X1 Z2 R1", ">= the bottom"),
        ("G81 X1 Z-1 R1 L0", "L0"),
        ("G81 X1 Z-1 R1 L10001", "L10001"),
        ("G93 F1 G81 X1 Z-1 R1", "G81 in G93"),
        ("G81 X1 Z-1 R1 A1", "--rotary"),
        ("G83 Z-1000 R0 Q0.000001", "pose limit"),
    ],
)
def test_cycles_that_are_none(lines: str, part: str):
    refused(f"{HEAD}{lines}\nM2", 3, part)


def test_where_a_cycle_ends_is_not_guessed():
    refused("G21 G90 F60\nG0 X0 Y0 Z0\nG81 X1 Z-1 R1\nM2", 3, "behind G98 or G99")


def test_a_tool_of_its_own_length_or_of_none_may_follow_one_that_had_a_length():
    for word in ("G43", "G43.1 Z80", "G49"):
        program = f"T1 M6 G43\n{HEAD}G1 X1\nT2 M6\n{word}\nG0 X0 Y0 Z0\nG1 X2\nM2"
        assert len(path_of(program).cuts) == 2


def test_a_cycle_is_over_with_another_plane_unit_or_motion():
    for between in ("G18\nX1", "G20\nF1 G81 X1", "G80\nX1", "G0 X9\nG81 X1"):
        refused(f"{HEAD}G81 X1 Z-1 R1\n{between}\nM2", 5)
    refused(f"{HEAD}G81 X1 Z-1 R1\nG20 F1\nX1\nM2", 4, "G20 and F")
    refused(f"{HEAD}G81 X1 Z-1 R1\nG20\nX1\nM2", 5, "without a motion")
    refused(f"{HEAD}G20\nG81 X1 Z-1 R1\nM2", 4, "no feed")


# -------------------------------------------------------------------- tools


def test_tools_part_the_path():
    first, second = path_of(f"{HEAD}G1 X1\nT2\nM6 T3\nG43.1 Z100\nG0 X0 Y0 Z0\nG1 X1\nM2").cuts
    assert (first.tool, second.tool) == ("", "3")
    assert (first.tool_length_mm, second.tool_length_mm) == (None, 100)
    assert second.positioning.tolist() == [True, False]


@pytest.mark.parametrize(
    ("program", "line", "part"),
    [
        (f"{HEAD}M6\nM2", 3, "M6 without T"),
        (f"{HEAD}T1 M6\nG1 X1\nM2", 4, "X Y Z is not known"),
        ("G21 T1 M6\nG43 H2\nM2", 2, "H1, the length of the mounted tool"),
        ("G43\nM2", 1, "G43 without H"),
        (f"T1 M6 G43\n{HEAD}G1 X1\nT2 M6\nG0 X0 Y0 Z0\nM2", 6, "its own tool length word"),
        (f"T1 M6 G43\n{HEAD}G1 X1\nT2 M6\nT3 M6\nG0 X0 Y0 Z0\nM2", 7, "a move of tool 3"),
        ("G43 H1.5\nM2", 1, "1.5"),
        ("G43 H1\nG43.1 Z1\nM2", 2, "a tool has one length"),
        ("G43.1 Z1\nG43.1 Z2\nM2", 2, "Z1, as above"),
        ("G43.1 Z-1\nM2", 1, "with Z >= 0"),
        ("G43.1\nM2", 1, "without a length"),
        ("G43.1 X1 Z1\nM2", 1, "along Z alone"),
        (f"{HEAD}G43 H1\nM2", 3, "before the tool's first position"),
        (f"{HEAD}G0 G43.1 Z1\nM2", 3, "one word that uses X Y Z"),
        (f"G43 H1\n{HEAD}G49\nG1 X1\nM2", 5, "after its return home"[6:17]),
        (f"{HEAD}G28 Z1\nG1 X1 Y1 Z1\nM2", 4, "return home"),
        (f"{HEAD}G30\nG0 X1 Y1 Z1\nG1 X2\nM2", 5, "return home"),
        (f"{HEAD}G28\nG0 X1 Y1 Z1\nG2 X2 I1\nM2", 5, "return home"),
    ],
)
def test_tool_words_that_do_not_fit(program: str, line: int, part: str):
    refused(program, line, part)


def test_a_length_named_before_the_first_position_is_taken():
    cut = cut_of(f"T1 M6\nG43\nG43 H1 G0 G90\n{HEAD}G1 X1\nG49\nM2")
    assert (cut.tool, cut.tool_length_mm, len(cut.tips_mm)) == ("1", None, 2)
    cut = cut_of("T1 M6\nG21 G0 X3 Y4\nG43 Z5 H1\nG1 X1 F1\nM2")
    assert cut.tips_mm.tolist() == [[3, 4, 5], [1, 4, 5]]
    refused("T1 M6\nG21 G0 X3 Y4\nG43 H1\nG1 X1 F1\nM2", 4, "Z is not known")
    refused("T1 M6\nG21 G0 Z5\nG43 H1\nG0 X1 Y1\nG1 X1 F1\nM2", 5, "Z is not known")


def test_a_return_home_ends_the_part_of_a_tool():
    cut = cut_of(f"G28 G91 Z0\n{HEAD}G1 X1\nG91 G28 Z0\nG90 G0 X5 Y5 Z5\nM2")
    assert cut.tips_mm.tolist() == [[0, 0, 0], [1, 0, 0]]
    by_the_way = cut_of(f"{HEAD}G1 X1\nG91 G28 Z5\nM2")
    assert by_the_way.tips_mm.tolist() == [[0, 0, 0], [1, 0, 0], [1, 0, 5]]
    assert by_the_way.positioning.tolist() == [True, False, True]
    assert cut_of(f"{HEAD}G1 X1\nG90 G28 X7 Z5\nM2").tips_mm[-1].tolist() == [7, 0, 5]
    assert len(path_of(f"{HEAD}G1 X1\nG28\nT1 M6\nG0 X0 Y0 Z0\nG1 X1\nM2").cuts) == 2


# ------------------------------------------------------------- rotary words


def test_with_tool_centre_point_control_the_axis_follows_the_angles():
    for on in ("M428", "TRAORI", "traori (all)", "G43.4 H1"):
        cut = cut_of(f"{on}\nG21 F60\nG0 X0 Y0 Z0 A-30 C0\nG1 X10 C90\nM2", XYZAC)
        s, c = math.sin(math.radians(-30)), math.cos(math.radians(30))
        assert cut.axes[0].tolist() == pytest.approx([0, s, c])
        assert cut.axes[-1].tolist() == pytest.approx([s, 0, c])
        along = cut.tips_mm[:, 0] / 10
        expected = np.stack([s * np.sin(along * math.pi / 2), s * np.cos(along * math.pi / 2)], axis=1)
        assert np.abs(cut.axes[:, :2] - expected).max() < 1e-9
        assert 0 < cut.tolerance_deg <= 0.01
        assert len(cut.tips_mm) > 10
        assert cut.feeds_mm_s[-1] == 1
        assert not cut.positioning[1:].any()


def test_a_turn_on_the_spot_has_no_feed_of_the_tip():
    cut = cut_of("M428\nG21 G93\nG0 X0 Y0 Z0 A-30 C0\nG1 C1 F9\nG91 G0 C2\nM2", XYZAC)
    assert np.isnan(cut.feeds_mm_s).all()
    assert cut.positioning.tolist()[-1]


def test_upright_axes_need_no_control():
    cut = cut_of("G21 F60\nG0 X0 Y0 Z0 A0 C0\nG1 X1 A0\nM428\nX2\nA-1\nX3 A0\nM429\nX4\nM2", XYZAC)
    assert cut.axes[[0, 1, -1]].tolist() == [[0, 0, 1]] * 3
    assert cut.tips_mm[-1, 0] == 4


@pytest.mark.parametrize(
    ("program", "line", "part"),
    [
        (f"{HEAD}G1 X1 A1\nM2", 3, "the first rotary word after moves"),
        ("G21 F60\nG0 X0 Y0 Z0 A0 C0\nG1 X1 C1\nM2", 3, "pivot"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A1 C0\nM429\nG0 A0\nM2", 5, "pivot"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A1\nM2", 3, "C not known"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A1 B1\nM2", 3, "B word"),
        ("M428\nG21 F60\nG91 G0 A1\nM2", 3, "A in G91"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A1 C0\nG2 X2 I1 A2\nM2", 4, "a constant tool axis"),
        ("M428\nG21 G99 F60\nG0 X0 Y0 Z0 A1 C0\nG81 X2 Z-1 R1 A2\nM2", 4, "a constant tool axis"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A1 C0\nT1 M6\nG0 X0 Y0 Z0\nM2", 5, "A and C not known"),
        ("M428\nG21 F60\nG0 X0 Y0 Z0 A45 C0\nG1 X1 C99999999\nM2", 4, "pieces"),
    ],
)
def test_rotary_words_that_are_not_understood(program: str, line: int, part: str):
    refused(program, line, part, reading=XYZAC)


def test_arcs_and_cycles_keep_a_tilted_axis():
    cut = cut_of("M428\nG21 G99 F60\nG0 X0 Y0 Z0 A-30 C0\nG2 X2 I1 A-30\nG81 X3 Z-1 R1\nM2", XYZAC)
    assert np.ptp(cut.axes, axis=0).max() == 0


def test_without_a_convention_rotary_words_are_refused_and_all_are_listed():
    refused("G21\nG0 X0 Y0 Z0 A1\nM2", 2, "A word", "xyzac, xyzbc", "--rotary")
    refused("G21\nM2", 0, "--rotary abc", "xyzac, xyzbc", reading=Reading(rotary="abc"))


# ------------------------------------------------------------- work and limits


def test_work_is_bounded_whatever_stands_in_the_file():
    start = time.process_time()
    deep = "[" * 10_000 + "1" + "]" * 10_000
    tower = "**".join(["9"] * 80)
    for line in (
        "X" + deep,
        f"#1=[{tower}]",
        "G1 X" + "1" * 100_000,
        "(" * 100_000,
        "o1 if " + deep,
        "-" * 99_999,
    ):
        refused(f"{HEAD}{line}\nM2", 3)
    loop = refused(f"{HEAD}o1 while [1]\no1 endwhile\nM2", 4, "does a loop end?", limit=10_000)
    assert f"<= {10_000 * WORK_PER_POSE + len(HEAD) + 27}" in loop
    refused(f"{HEAD}o1 while [1]\nG91 G1 X1\no1 endwhile\nM2", 4, "poses", limit=500)
    refused(f"{HEAD}o1 while [1]\nG91 G1 X100\no1 endwhile\nM2", 4, "check its units")
    refused(HEAD + "".join(f"o{n} if [1]\n" for n in range(50_000)), 13, "over 10 levels")
    assert time.process_time() - start < 60.0


def test_not_text():
    with pytest.raises(InputError, match="UTF-8"):
        read_gcode("p.ngc", b"G21\n\xff", PLAIN, LIMIT, None)


# --------------------------------------------------------------- real programs


def test_the_impeller():
    data = tool_path("impeller-7bl-xyzac.ngc").read_bytes()
    (cut,) = read_gcode("impeller", data, XYZAC, 1_000_000, None).cuts
    feeds = ~cut.positioning
    steps = np.linalg.norm(np.diff(cut.tips_mm, axis=0), axis=1)
    ends = np.append(cut.lines[1:] != cut.lines[:-1], True) & feeds
    assert ends.sum() == 4306
    assert steps[feeds[1:]].sum() == pytest.approx(3457.5, abs=0.05)
    assert np.round(cut.tips_mm[feeds].min(axis=0), 2).tolist() == [-45.38, -45.0, -2.65]
    assert np.round(cut.tips_mm[feeds].max(axis=0), 2).tolist() == [42.87, 44.22, 31.73]
    tilt = -np.degrees(np.arccos(cut.axes[feeds][:, 2]))
    assert np.round([tilt.min(), tilt.max()], 2).tolist() == [-74.49, -43.02]
    assert len(cut.tips_mm) < 5500
    first = np.loadtxt(tool_path("impeller-op1.csv"), delimiter=",", skiprows=1)
    of_first = np.flatnonzero(ends)[: len(first)]
    assert cut.lines[of_first[-1]] == 3398
    assert np.abs(cut.tips_mm[of_first] - first[:, :3]).max() <= 1e-6
    assert np.abs(cut.axes[of_first] - first[:, 3:]).max() <= 1e-6
    # what the formula gives; the other sense of the rotations would give 6352, 11054, 15954
    for length, expected in ((100, 6121), (200, 10890), (300, 15808)):
        wrist = cut.tips_mm + length * cut.axes
        walked = np.linalg.norm(np.diff(wrist, axis=0), axis=1)[feeds[1:]].sum()
        assert walked == pytest.approx(expected, rel=1e-3)


def test_the_impeller_needs_a_convention():
    data = tool_path("impeller-7bl-xyzac.ngc").read_bytes()
    with pytest.raises(InputError, match="line 8 is A word"):
        read_gcode("impeller", data, PLAIN, 1_000_000, None)


def test_cutter_compensation_of_a_real_program_is_refused():
    data = tool_path("cam-nisley.ngc").read_bytes()
    with pytest.raises(InputError, match=r"line 74 is G42, .* G40"):
        read_gcode("cam", data, PLAIN, 1_000_000, None)


def test_the_extensions_are_g_code():
    (language,) = (language for language in LANGUAGES if language.name == "G-code")
    assert language.extensions == (".ngc", ".nc", ".gcode", ".tap")
    assert language.declared == {"rotary", "arc_tolerance_mm", "axis_tolerance_deg"}
    assert language.read is read_gcode
