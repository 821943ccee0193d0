"""APT/CL files: what each statement does, by a writer and by oracles of their own; what is refused, and on which line."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cutgate.config.refusal import InputError
from cutgate.runtime.plan.toolpath import apt
from cutgate.runtime.plan.toolpath.languages import OPTIONS, check_declared, language_of
from cutgate.runtime.plan.toolpath.model import Reading
from tests.tool_paths import tool_path

DECLARED = Reading(cutcom_is_tool_centre=True)
LIMIT = 100_000
UP, SIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def read(text, *, reading=DECLARED, limit=LIMIT, told=None):
    data = text if isinstance(text, bytes) else text.encode()
    return apt.read_apt("path.apt", data, reading, limit, told)


def program(*lines, unit="UNITS/MM"):
    return "\n".join((*filter(None, [unit]), *lines, "FINI", ""))


def cut_of(*lines, **others):
    (cut,) = read(program(*lines), **others).cuts
    return cut


def tips(*lines, **others):
    return cut_of(*lines, **others).tips_mm.tolist()


def refused(text, **others):
    with pytest.raises(InputError) as caught:
        read(text, **others)
    (problem,) = caught.value.problems
    assert problem.file == "path.apt"
    assert problem.bound
    assert problem.remedy
    return problem


def same(one, other):
    """Two tool paths, but for the lines on which their poses stand."""
    assert len(one.cuts) == len(other.cuts)
    for a, b in zip(one.cuts, other.cuts, strict=True):
        assert (a.tool, a.tool_length_mm, a.tolerance_mm) == (b.tool, b.tool_length_mm, b.tolerance_mm)
        for field in ("tips_mm", "axes", "positioning", "feeds_mm_s"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


# ---------------------------------------------------------------- a writer of its own

AXES = st.sampled_from(
    [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (-0.36, 0.48, 0.8), (0.0, -1.0, 0.0)]
)
SPELLINGS = (
    lambda v: f"{v:.3f}",
    lambda v: f"{v:+.3f}",
    lambda v: f"{v:.3f}".rstrip("0"),  # 5. and -3.
    lambda v: f"{v:.3f}".replace("0.", ".", 1) if abs(v) < 1 else f"{v:.4f}",  # .9625
    lambda v: f"{round(v * 1000)}.E-3",
    lambda v: f" {round(v * 1000)}e-03\t",
)


@st.composite
def written(draw, reach=9_000):
    """A program, and what its poses must be: rows of tip, axis, positioning, feed for each tool."""
    lines, cuts, feed = [], [], math.nan
    decimals = st.integers(-1000 * reach, 1000 * reach).map(lambda n: n / 1000)

    def number(value):
        return draw(st.sampled_from(SPELLINGS))(value)

    for tool in range(draw(st.integers(1, 3))):
        lines.append(f"{draw(st.sampled_from(['LOADTL/', 'LOAD/TOOL,']))}{tool}")
        rows, axis = [], None
        for _ in range(draw(st.integers(2, 8))):
            if draw(st.booleans()):
                per_minute = draw(st.integers(1, 50_000)) / 10
                feed = per_minute / 60
                spelled = [f"{per_minute}", "MMPM"]
                lines.append(f"FEDRAT/{','.join(spelled[:: draw(st.sampled_from([1, -1]))])}")
            rapid = draw(st.booleans())
            if rapid:
                lines.append("RAPID")
            tip = draw(st.tuples(decimals, decimals, decimals))
            given_axis = draw(AXES) if axis is None or draw(st.booleans()) else None
            axis = given_axis or axis
            lines.append(f"GOTO/{','.join(map(number, (*tip, *(given_axis or ()))))}")
            if not rows or (tip, axis) != rows[-1][:2]:
                first = not rows
                rows.append((tip, axis, rapid or first, math.nan if rapid or first else feed))
        cuts.append(rows)
    return lines, cuts


@given(written())
@settings(deadline=None)
def test_what_another_program_writes_is_read_back(case):
    lines, cuts = case
    assume(all(len(rows) > 1 for rows in cuts))
    path = read(program(*lines))
    assert [cut.tool for cut in path.cuts] == [str(tool) for tool in range(len(cuts))]
    for cut, rows in zip(path.cuts, cuts, strict=True):
        np.testing.assert_allclose(cut.tips_mm, [row[0] for row in rows], rtol=1e-15)
        np.testing.assert_allclose(cut.axes, [row[1] for row in rows], atol=1e-15)
        assert cut.positioning.tolist() == [row[2] for row in rows]
        np.testing.assert_allclose(cut.feeds_mm_s, [row[3] for row in rows], rtol=1e-15)
        assert cut.tolerance_mm == cut.tolerance_deg == 0.0


@st.composite
def respelled(draw, lines):
    """The same statements, each spelled in another way."""
    out = []
    for line in lines:
        spelled = line
        if draw(st.booleans()):
            spelled = spelled.lower()
        if "," in spelled and draw(st.booleans()):
            spelled = spelled.replace(
                ",", draw(st.sampled_from([",$\n", ", $ $$ more\n\t", ",$\n\n$$ x\n $\n"]))
            )
        spelled = draw(st.sampled_from(["", "  ", "\t", "\n", "$$ RAPID\n", "$$$$\n"])) + spelled
        spelled += draw(st.sampled_from(["", "  ", "$$ GOTO/1,2,3", " $$ to be continued $"]))
        out.append(
            spelled.replace("/", draw(st.sampled_from(["/", " / "])), 1) if "$$ " not in spelled else spelled
        )
    text = draw(st.sampled_from(["", "\ufeff"])) + "\n".join(out) + draw(st.sampled_from(["", "\n", "\n\n"]))
    return text.replace("\n", draw(st.sampled_from(["\n", "\r\n"])) if text.endswith("\n") else "\n")


@given(st.data())
@settings(deadline=None, max_examples=60)
def test_spelling_changes_nothing(data):
    lines, cuts = data.draw(written())
    assume(any(len(rows) > 1 for rows in cuts))
    plain = ["UNITS/MM", *lines, "FINI"]
    same(read("\n".join(plain)), read(data.draw(respelled(plain))))


@given(written(reach=390))
@settings(deadline=None, max_examples=60)
def test_a_file_in_inches_is_that_of_mm_times_25_4(case):
    lines, cuts = case
    assume(all(len(rows) > 1 for rows in cuts))
    lines = [line.replace("MMPM", "PERMIN") for line in lines]
    in_mm, in_inches = read(program(*lines)), read(program(*lines, unit="UNIT/INCH"))
    for a, b in zip(in_mm.cuts, in_inches.cuts, strict=True):
        np.testing.assert_array_equal(a.tips_mm * 25.4, b.tips_mm)
        np.testing.assert_array_equal(a.axes, b.axes)
        np.testing.assert_allclose(a.feeds_mm_s * 25.4, b.feeds_mm_s, rtol=1e-14)


# ---------------------------------------------------------------- circles against the true circle


def turned(vector, axis, angle):
    """The vector turned about a unit axis, right-handed (Rodrigues)."""
    v, k = np.array(vector), np.array(axis)
    return v * math.cos(angle) + np.cross(k, v) * math.sin(angle) + k * (k @ v) * (1 - math.cos(angle))


def off_polyline(points, corners):
    """Distance of each point from the nearest of the lines between neighbouring corners."""
    a, b = corners[:-1, None], corners[1:, None]
    way = b - a
    share = np.clip(((points - a) * way).sum(-1) / (way * way).sum(-1), 0.0, 1.0)
    return np.linalg.norm(a + share[..., None] * way - points, axis=-1).min(axis=0)


@given(
    centre=st.tuples(*[st.floats(-100, 100)] * 3),
    radius=st.floats(0.1, 500),
    sweep=st.floats(0.1, math.tau - 0.1) | st.just(math.tau),
    axis=AXES,
    begin=st.floats(0, math.tau),
    tolerance=st.sampled_from([0.001, 0.01, 0.5]),
    given_radius=st.booleans(),
)
@settings(deadline=None, max_examples=60)
def test_the_chords_of_a_circle_are_within_the_tolerance_of_it(
    centre, radius, sweep, axis, begin, tolerance, given_radius
):
    other = (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0)
    arm = np.cross(axis, other)
    arm = turned(arm / np.linalg.norm(arm) * radius, axis, begin)
    start, end = np.array(centre) + arm, np.array(centre) + turned(arm, axis, sweep)
    end = start if sweep == math.tau else end

    def listed(*values):
        return ",".join(f"{value:.12f}" for value in values)

    extra = (radius,) if given_radius else ()
    cut = cut_of(
        f"GOTO/{listed(*start)}",
        f"CIRCLE/{listed(*centre, *axis, *extra)}",
        f"GOTO/{listed(*end)}",
        reading=Reading(arc_tolerance_mm=tolerance),
    )
    true = np.array([np.array(centre) + turned(arm, axis, sweep * t) for t in np.linspace(0, 1, 400)])
    assert tolerance <= cut.tolerance_mm <= tolerance + 1e-6
    assert off_polyline(true, cut.tips_mm).max() <= cut.tolerance_mm
    assert np.abs(np.linalg.norm(cut.tips_mm - centre, axis=1) - radius).max() <= 1e-6
    length = np.linalg.norm(np.diff(cut.tips_mm, axis=0), axis=1).sum()
    assert length == pytest.approx(radius * sweep, rel=2 * tolerance / radius, abs=1e-6)
    np.testing.assert_allclose(cut.tips_mm[-1], end, atol=1e-9)
    assert not cut.positioning[1:].any()
    assert set(cut.lines.tolist()) == {2, 4}


def test_a_circle_goes_round_its_axis_and_may_only_position():
    lines = [
        "GOTO/1,0,0",
        "RAPID",
        "CIRCLE/0,0,0,0,0,-1",
        "GOTO/0,1,0",
        "FEDRAT/60,MMPM",
        "CIRCLE/0,0,0,0,0,1",
        "GOTO/-1,0,0",
    ]
    cut = cut_of(*lines)
    rapid = cut.tips_mm[cut.lines == 5]
    assert rapid[:, 1].min() == pytest.approx(-1, abs=0.02)
    assert cut.positioning[cut.lines == 5].all()
    assert np.isnan(cut.feeds_mm_s[cut.lines == 5]).all()
    assert cut.tips_mm[cut.lines == 8][:, 1].min() > -1e-9
    assert (cut.feeds_mm_s[cut.lines == 8] == 1.0).all()


def test_a_circle_of_a_tilted_tool_keeps_its_axis():
    cut = cut_of("GOTO/5,1,0,1,0,0", "CIRCLE/5,0,0,1,0,0", "GOTO/5,-1,0,1,0,0")
    assert (cut.axes == SIDE).all()
    assert cut.tips_mm[:, 2].max() == pytest.approx(1, abs=0.01)


# ---------------------------------------------------------------- drilling


def drilled(*lines):
    cut = cut_of("FEDRAT/60,MMPM", *lines, "CYCLE/OFF")
    return [(*tip, bool(rapid)) for tip, rapid in zip(cut.tips_mm.tolist(), cut.positioning, strict=True)]


def test_depths_are_measured_from_the_point_and_the_tool_comes_back_between_holes_at_its_height():
    moves = drilled(
        "GOTO/0,0,25", "CYCLE/DRILL,FEDTO,10,RAPTO,2,RTRCTO,30,MMPM,120", "GOTO/1,0,-5", "GOTO/4,0,-6"
    )
    assert moves == [
        (0, 0, 25, True),
        (1, 0, 25, True),
        (1, 0, -3, True),
        (1, 0, -15, False),
        (1, 0, -3, True),
        (1, 0, 25, True),
        (4, 0, 25, True),
        (4, 0, -4, True),
        (4, 0, -16, False),
        (4, 0, -4, True),
        (4, 0, 24, True),
    ]


@pytest.mark.parametrize("name", ["DEEP", "DEEP2"])
@pytest.mark.parametrize(
    ("pecks", "depths"),
    [
        ("1STPECK,5,SUBPECK,2", [5, 7, 9, 9.5]),
        ("INCR,4", [4, 8, 9.5]),
        ("STEP,9.5", [9.5]),
        ("INCR,20", [9.5]),
    ],
)
def test_pecks_go_deeper_each_time_and_come_back_to_the_clearance(name, pecks, depths):
    moves = drilled("GOTO/0,0,9", f"CYCLE/{name},FEDTO,9.5,CLEAR,1,{pecks}", "GOTO/0,0,0")
    down = [-z for _, _, z, rapid in moves if not rapid]
    assert down == depths
    assert moves[:2] == [(0, 0, 9, True), (0, 0, 1, True)]
    for before, peck, after in zip(moves, moves[1:], moves[2:], strict=False):
        if not peck[3]:
            assert before[2] in (1, *[-depth for depth in depths])
            assert before[2] > peck[2]
            assert after == (0, 0, 1, True)


@given(
    axis=AXES,
    start=st.tuples(*[st.floats(-50, 50)] * 3),
    holes=st.lists(st.tuples(*[st.floats(-50, 50)] * 3), min_size=1, max_size=4),
    depth=st.floats(0.5, 40),
    clearance=st.floats(0, 10),
    more=st.floats(0, 10),
    peck=st.floats(0.3, 40),
)
@settings(deadline=None)
def test_a_drill_moves_across_only_above_the_clearances_and_cuts_only_along_its_axis(
    axis, start, holes, depth, clearance, more, peck
):
    def listed(*values):
        return ",".join(f"{value:.9f}" for value in values)

    lines = [f"GOTO/{listed(*point, *axis)}" for point in holes]
    setting = (
        f"CYCLE/DEEP,FEDTO,{depth:.9f},RAPTO,{clearance:.9f},RTRCTO,{clearance + more:.9f},INCR,{peck:.9f}"
    )
    cut = cut_of(f"GOTO/{listed(*start, *axis)}", "FEDRAT/600,MMPM", setting, *lines)
    bottoms = []
    for number, hole in enumerate(holes, start=5):
        of_hole = np.flatnonzero(cut.lines == number)
        along = (cut.tips_mm[of_hole] - hole) @ axis
        lateral = cut.tips_mm[of_hole] - hole - along[:, None] * axis
        on_axis = np.linalg.norm(lateral, axis=1) < 1e-6
        assert (along[~on_axis] >= clearance - 1e-6).all()
        before = ((cut.tips_mm[of_hole[0] - 1] - hole) @ axis) if not on_axis[0] else None
        assert before is None or along[0] == pytest.approx(max(before, clearance), abs=1e-6)
        assert on_axis[-1]
        assert along[-1] == pytest.approx(clearance + more, abs=1e-6)
        assert on_axis[~cut.positioning[of_hole]].all()
        assert not on_axis[: int(np.argmax(on_axis))].any(), "across first, then along"
        bottoms.append(along.min())
        advances = -np.diff(np.unique(along[~cut.positioning[of_hole]])[::-1])
        assert (np.abs(advances) <= peck + 1e-6).all()
    np.testing.assert_allclose(bottoms, -depth, atol=1e-6)
    assert (cut.axes == cut.axes[0]).all()


def test_the_first_position_of_a_tool_may_be_a_hole():
    cut = cut_of("CYCLE/DRILL,FEDTO,10,RAPTO,2", "GOTO/1,0,-5")
    assert cut.tips_mm.tolist() == [[1, 0, -3], [1, 0, -15], [1, 0, -3]]
    assert np.isnan(cut.feeds_mm_s).all()


def test_a_cycle_has_a_feed_of_its_own_or_that_of_fedrat():
    common = ["GOTO/0,0,9", "SPINDL/600,RPM,CLW", "FEDRAT/60,MMPM"]
    assert cut_of(*common, "CYCLE/DRILL,FEDTO,9,RAPTO,1", "GOTO/0,0,0").feed_range_mm_s == (1.0, 1.0)
    own = cut_of(*common, "CYCLE/DRILL,FEDTO,9,RAPTO,1,mmpr,.5", "GOTO/0,0,0", "cycle/off", "GOTO/0,0,50")
    assert own.feed_range_mm_s == (1.0, 5.0)
    assert own.tips_mm[-1].tolist() == [0, 0, 50]


def test_lengths_of_a_cycle_are_in_the_unit_of_the_file():
    text = program("GOTO/0,0,1", "CYCLE/DRILL,FEDTO,1,RAPTO,.5,IPM,6", "GOTO/0,0,0", unit="UNITS/INCHES")
    (cut,) = read(text).cuts
    assert cut.tips_mm[:, 2].tolist() == [25.4, 12.7, -25.4, 12.7]
    assert cut.feed_range_mm_s == pytest.approx((2.54, 2.54))


# ---------------------------------------------------------------- feeds


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["FEDRAT/600,MMPM"], 10.0),
        (["FEDRAT/MMPM,600"], 10.0),
        (["FEDRAT / ipm , 6."], 2.54),
        (["FEDRAT/600,PERMIN"], 10.0),
        (["SPINDL/300,RPM,CLW", "FEDRAT/.5,MMPR"], 2.5),
        (["FEDRAT/.5,PERREV", "SPINDL/RPM,300,CCLW"], 2.5),
        (["FEDRAT/IPR,.1", "SPINDL/600,ON"], 25.4),
        (["SPINDL/300", "FEDRAT/.5,MMPR", "SPINDL/600"], 5.0),
        (["FEDRAT/600,MMPM", "FEDRAT/300"], 5.0),
        (["SPINDL/300", "FEDRAT/1,MMPR", "FEDRAT/2"], 10.0),
        (["FEDRAT/600,MMPM", "SPINDL/OFF"], 10.0),
        (["SPINDL/300", "FEDRAT/.5,MMPR", "FEDRAT/600,MMPM", "SPINDL/SFM,200"], 10.0),
    ],
)
def test_a_feed_is_mm_per_second(lines, expected):
    cut = cut_of("GOTO/0,0,0", *lines, "GOTO/1,0,0")
    assert cut.feeds_mm_s[1] == pytest.approx(expected)


@pytest.mark.parametrize(
    "speed", ["OFF", "SFM,100", "100,SMM", "0,RPM", "100,200", "ON", "CLW", "1,RANGE,2", ""]
)
def test_a_feed_per_revolution_needs_a_speed_where_the_tool_cuts(speed):
    lines = ["GOTO/0,0,0", "SPINDL/300", "FEDRAT/.5,MMPR", f"SPINDL/{speed}"]
    assert tips(*lines, "RAPID", "GOTO/1,0,0") == [[0, 0, 0], [1, 0, 0]]
    problem = refused(program(*lines, "RAPID", "GOTO/1,0,0", "GOTO/2,0,0"))
    assert problem.key == "line 8"
    assert "SPINDL" in problem.remedy


# ---------------------------------------------------------------- motion, axes, tools


def test_rapid_holds_for_one_point():
    cut = cut_of("GOTO/0,0,0", "GOTO/1,0,0", "RAPID/", "GOTO/2,0,0", "GOTO/3,0,0")
    assert cut.positioning.tolist() == [True, False, True, False]


def test_a_rapid_does_not_outlive_its_tool():
    path = read(program("GOTO/0,0,0", "GOTO/1,0,0", "RAPID", "LOADTL/1", "GOTO/0,0,0", "GOTO/1,0,0"))
    assert path.cuts[1].positioning.tolist() == [True, False]


def test_godlta_moves_by_a_difference():
    assert tips("FROM/1,2,3", "GODLTA/0,0,-1", "GODLTA/.5,0,0") == [[1, 2, 3], [1, 2, 2], [1.5, 2, 2]]


def test_from_says_where_the_tool_stands_also_before_it_is_mounted():
    path = read(
        program(
            "FROM/0,0,100,1,0,0", "LOADTL/7", "GOTO/0,0,0,1,0,0", "FROM/0,0,0", "LOADTL/8", "GOTO/5,0,0,1,0,0"
        )
    )
    assert [cut.tool for cut in path.cuts] == ["7", "8"]
    assert path.cuts[0].tips_mm.tolist() == [[0, 0, 100], [0, 0, 0]]
    assert path.cuts[0].lines.tolist() == [2, 4]
    assert path.cuts[1].tips_mm.tolist() == [[0, 0, 0], [5, 0, 0]]


def test_from_is_not_carried_to_another_tool_once_something_has_moved():
    path = read(program("FROM/0,0,9", "LOADTL/7", "GOTO/0,0,0", "LOADTL/8", "GOTO/5,0,0", "GOTO/6,0,0"))
    assert path.cuts[1].tips_mm.tolist() == [[5, 0, 0], [6, 0, 0]]


def test_the_same_tool_mounted_again_is_another_cut():
    path = read(program("LOAD/TOOL,1", *POINTS, "LOAD/TOOL,2", *POINTS, "LOAD/TOOL,1", *POINTS))
    assert [cut.tool for cut in path.cuts] == ["1", "2", "1"]


@pytest.mark.parametrize(
    ("line", "tool", "length"),
    [
        ("LOADTL/12", "12", None),
        ("LOADTL/12,LENGTH,150.5", "12", 150.5),
        ("loadtl/Mill_D10,osetno,3,length,20,adjust,1", "Mill_D10", 20.0),
        ("LOAD/TOOL,3,ADJUST,4", "3", None),
    ],
)
def test_a_tool_has_a_name_and_perhaps_a_length(line, tool, length):
    cut = cut_of(line, *POINTS)
    assert (cut.tool, cut.tool_length_mm) == (tool, length)


def test_the_length_of_a_tool_is_in_the_unit_of_the_file():
    (cut,) = read(program("LOADTL/1,LENGTH,2", *POINTS, unit="UNITS/INCHES")).cuts
    assert cut.tool_length_mm == 50.8


def test_gohome_and_end_hold_for_what_follows():
    path = read(program("GOHOME", "LOADTL/1", *POINTS, "GOHOME", "LOADTL/2", *POINTS, "GOHOME", "END"))
    assert [len(cut.tips_mm) for cut in path.cuts] == [2, 2]
    assert tips("GOHOME", *POINTS) == [[0, 0, 0], [1, 0, 0]]


def test_an_operation_mounts_a_tool_only_where_its_tool_is_another():
    first, second = "TOOL PATH/A,TOOL,D10", "TOOL PATH/B,TOOL,D6"
    path = read(program(first, *POINTS, "END-OF-PATH", first, "GOTO/2,0,0", second, "LOAD/TOOL,5", *POINTS))
    assert [(cut.tool, len(cut.tips_mm)) for cut in path.cuts] == [("D10", 3), ("5", 2)]


def test_an_operation_behind_another_tool_mounts_its_own_again():
    first, second = "TOOL PATH/A,TOOL,D10", "TOOL PATH/B,TOOL,D10"
    path = read(program(first, "LOAD/TOOL,5", *POINTS, "LOAD/TOOL,6", *POINTS, second, *POINTS))
    assert [cut.tool for cut in path.cuts] == ["5", "6", "D10"]
    path = read(program(first, "LOAD/TOOL,5", *POINTS, second, "GOTO/2,0,0"))
    assert [(cut.tool, len(cut.tips_mm)) for cut in path.cuts] == [("5", 3)]


def test_an_operation_keeps_the_length_of_the_tool_loaded_for_it():
    operation = "TOOL PATH/A,TOOL,D10"
    assert cut_of("LOADTL/5,LENGTH,100", operation, *POINTS).tool_length_mm == 100
    path = read(program("LOADTL/5,LENGTH,100", *POINTS, operation, *POINTS))
    assert [cut.tool_length_mm for cut in path.cuts] == [100, None]


def test_toolno_describes_the_tool_that_is_mounted_before_or_after():
    assert cut_of("LOADTL/4", "TOOLNO/4,1", *POINTS).tool == "4"
    assert cut_of("TOOLNO/4", "LOADTL/4", *POINTS).tool == "4"
    assert cut_of("LOADTL/4", "TOOLNO/5", "TOOLNO/4", *POINTS).tool == "4"


@pytest.mark.parametrize(
    "section",
    ["LOADTL/1", "MULTAX/OFF", "MULTAX", "TRNTYP/WORLD", "TOOL PATH/A,TOOL,B", "MSYS/0,0,0,1,0,0,0,1,0"],
)
def test_three_numbers_keep_an_axis_until_a_section_could_mean_another(section):
    lines = ["GOTO/0,0,0,1,0,0", "GOTO/1,0,0"]
    assert (cut_of(*lines).axes == SIDE).all()
    problem = refused(program(*lines, section, "GOTO/2,0,0"))
    assert problem.key == "line 5"
    assert "1 0 0" in problem.value
    assert "0 0 1" in problem.bound
    assert (read(program(*lines, section, "GOTO/2,0,0,1,0,0", "GOTO/3,0,0")).cuts[-1].axes == SIDE).all()
    upright = ["GOTO/0,0,0,0,0,1", "GOTO/1,0,0", section, "GOTO/2,0,0", "GOTO/3,0,0"]
    assert (read(program(*upright)).cuts[-1].axes == UP).all()


TURNED_CSYS = "CSYS/0,0,1.,0,1.,0,0,0,0,1.,0,0"


def test_the_axis_of_a_section_is_the_third_column_of_its_coordinate_system():
    lines = ["TRNTYP/WORLD,0,0,0", TURNED_CSYS]
    assert (cut_of(*lines, "GOTO/0,0,0,1,0,0", TURNED_CSYS, "GOTO/1,0,0").axes == SIDE).all()
    assert refused(program(*lines, "GOTO/0,0,0")).key == "line 4"
    identity = "CSYS/1,0,0,0,0,1,0,0,0,0,1,0"
    assert refused(program(*lines, "GOTO/0,0,0,1,0,0", identity, "GOTO/1,0,0")).key == "line 6"
    assert tips(*lines, *[f"{point},1,0,0" for point in POINTS]) == [[0, 0, 0], [1, 0, 0]], "coordinates stay"


def test_an_axis_can_be_set_alone_and_is_normalised():
    cut = cut_of("GOTO/0,0,0", "TLAXIS/0,.6,.8005", "GOTO/1,0,0", "TLAXIS/0,0,1", "GODLTA/1,0,0")
    np.testing.assert_allclose(np.linalg.norm(cut.axes, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(cut.axes[1], np.array([0, 0.6, 0.8005]) / math.hypot(0.6, 0.8005))
    assert cut.axes[2].tolist() == [0, 0, 1]


def test_an_axis_is_read_anew_after_another():
    cut = cut_of("GOTO/0,0,0,1,0,0", "GOTO/1,0,0,0,1,0", "GOTO/2,0,0,1,0,0", "MULTAX", "GOTO/3,0,0,0,0,1")
    assert cut.axes.tolist() == [[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]


# ---------------------------------------------------------------- what is understood

POINTS = ("GOTO/0,0,0", "GOTO/1,0,0")
EXAMPLES = {
    "PARTNO": "PARTNO/1",
    "UNITS": "UNITS/MM",
    "UNIT": "unit / mm",
    "PPRINT": "PPRINT a/b $5 über GOTO/1,2,3",
    "REMARK": "REMARK",
    "INSERT": "insert\tG0 X100",
    "MACHIN": "MACHIN/FANUC,1",
    "SEQNO": "SEQNO/10,INCR,10",
    "PAINT": "PAINT/COLOR,31",
    "DISPLY": "DISPLY/ON",
    "CUTTER": "CUTTER/6.,0,3.,0,0,0,51.",
    "TLDATA": "TLDATA/MILL,10,0,75,0,0",
    "TPRINT": "TPRINT/Fräser 1/2",
    "CSI_SET_": "CSI_SET_FLUTE_LENGTH/19.",
    "COOLNT": "COOLNT/FLOOD",
    "STOP": "STOP",
    "OPSTOP": "OPSTOP",
    "DELAY": "DELAY/2",
    "INTOL": "INTOL/.01",
    "OUTTOL": "OUTTOL/.01",
    "TOLER": "TOLER/.01",
    "LOADTL": "LOADTL/2",
    "LOAD": "LOAD/TOOL,1",
    "TOOLNO": "TOOLNO/1",
    "TOOL PATH": "tool  path/A,TOOL,1",
    "SELECT": "SELECT/TOOL,5",
    "SPINDL": "SPINDL/12000,RPM,CLW",
    "MULTAX": "MULTAX/ON",
    "TLAXIS": "TLAXIS/0,0,1",
    "TRNTYP": "TRNTYP/WORLD,0,0,0",
    "CSYS": "CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0",
    "MSYS": "MSYS/0.,0,0,1,0,0,0,1,0",
    "ORIGIN": "ORIGIN/0,0,0.",
    "FROM": "FROM/0,0,50",
    "FEDRAT": "FEDRAT/411.48,MMPM",
    "RAPID": "RAPID/",
    "GODLTA": "GODLTA/0,0,-40",
    "GOTO": "GOTO/1,0,0",
    "CUTCOM": "CUTCOM/LEFT,1",
    "CIRCLE": "CIRCLE/0,0,0,0,0,1\nGOTO/-1,0,0",
    "CYCLE": "CYCLE/INIT\nCYCLE/DEEP2,FEDTO,15.261,1STPECK,5.,SUBPECK,2.,MMPM,228.69,RAPTO,3.,RTRCTO,31.7\n"
    "GOTO/5,0,0\nCYCLE/OFF\nCUTCOM/OFF",
    "GOHOME": "GOHOME",
    "END-OF-PATH": "END-OF-PATH",
    "END": "END",
    "FINI": "FINI",
}
REFUSED = apt.TRANSFORMING | apt.UNPROCESSED


def test_each_major_word_has_an_example_here_or_is_refused():
    assert set(EXAMPLES) | REFUSED == set(apt.MAJOR)
    assert not set(EXAMPLES) & REFUSED


def test_every_statement_is_told_and_telling_changes_nothing():
    lines = ["$$ a comment", *"\n".join(EXAMPLES.values()).split("\n")]
    text, heard = "\n".join(lines), []
    same(read(text), read(text, told=lambda line, what: heard.append((line, what))))
    assert [line for line, _ in heard] == list(range(2, len(lines) + 1))
    assert all(what and what.isprintable() for _, what in heard)


def test_what_is_told_says_what_will_be_done():
    heard = {}
    lines = [
        "FROM/0,0,1",
        "RAPID",
        "GOTO/1,0,0",
        "GOTO/2,0,0,1,0,0",
        "CIRCLE/2,1,0,1,0,0",
        "GOTO/2,2,0",
        "LOADTL/8,$",
        "LENGTH,5",
    ]
    lines += [
        "GOTO/0,0,0,0,0,1",
        "RAPID",
        "CIRCLE/0,1,0,0,0,1",
        "GOTO/0,2,0",
        "CYCLE/DRILL,FEDTO,2,RAPTO,1",
        "GOTO/0,2,0",
    ]
    read(program(*lines, unit="UNITS/INCHES"), told=heard.__setitem__)
    assert heard[1] == "lengths are inches"
    assert heard[2] == "stands at 0 0 25.4"
    assert heard[4] == "positions to 25.4 0 0"
    assert heard[5] == "cuts to 50.8 0 0 with the axis 1 0 0"
    assert heard[7].startswith("cuts along the circle to 50.8 50.8 0 with the axis 1 0 0, ")
    assert heard[8] == "mounts tool 8, 127 mm long"
    assert 9 not in heard
    assert heard[10] == "begins at 0 0 0"
    assert heard[13].startswith("positions along the circle to 0 50.8 0, ")
    assert heard[14].startswith("drills 50.8 mm below each point along the tool axis, from 25.4 mm above it")
    assert heard[15] == "drills at 0 50.8 0"


def test_a_unit_may_be_said_again_and_in_other_words():
    (cut,) = read(program("UNIT/INCH", *POINTS, unit="UNITS/INCHES")).cuts
    assert cut.tips_mm[1].tolist() == [25.4, 0, 0]


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("lines", "key", "found", "remedy"),
    [
        # units
        (["GOTO/0,0,0"], "line 1", "no unit of length", "UNITS/MM or UNITS/INCHES"),
        (["FROM/0,0,0"], "line 1", "no unit", "UNITS/MM"),
        (["CYCLE/DRILL,FEDTO,1,RAPTO,1"], "line 1", "no unit", "UNITS/MM"),
        (["FEDRAT/1,PERMIN"], "line 1", "no unit", "UNITS/MM"),
        (["LOADTL/1,LENGTH,5"], "line 1", "no unit", "UNITS/MM"),
        (["UNITS/CM"], "line 1", "unit CM", "the one that the file"),
        (["UNITS/MM", "UNIT/INCH"], "line 2", "unit INCH, must be MM", "part the file"),
        # numbers
        (["UNITS/MM", "GOTO/1,2"], "line 2", "GOTO/1,2", "2 of them: complete"),
        (["UNITS/MM", "GOTO/1,2,3,"], "line 2", "GOTO/1,2,3,", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,P1"], "line 2", "P1", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,1_0"], "line 2", "1_0", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,nan"], "line 2", "nan", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,1e400"], "line 2", "1e400", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,٣"], "line 2", "٣", "plain decimal"),
        (["UNITS/MM", f"GOTO/1,2,{'9' * 31}"], "line 2", "GOTO/1,2,999", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2,1e9"], "line 2", "within +-10000 mm", "check its units"),
        (["UNITS/MM", "GOTO/1,2,3,0,0,0"], "line 2", "a tool axis of length 0", "normalise"),
        (["UNITS/MM", "GOTO/1,2,3,0,.6,.9"], "line 2", "of length 1.08", "normalise"),
        (["UNITS/MM", "GOTO/0,0,0", "GODLTA/5"], "line 3", "GODLTA/5", "1 of them: complete"),
        (["UNITS/MM", "TLAXIS/NORMPS,1"], "line 2", "TLAXIS", "plain decimal"),
        # motion
        (["UNITS/MM", "GODLTA/0,0,5"], "line 2", "before the tool's first point", "FROM"),
        (["UNITS/MM", "CIRCLE/0,0,0,0,0,1"], "line 2", "CIRCLE before the tool's first point", "FROM"),
        (["UNITS/MM", "GOTO/0,0,0", "FROM/1,0,0"], "line 3", "where the tool stands, 0 0 0", "write GOTO"),
        (["UNITS/MM", "GOTO/0,0,0", "FROM/0,0,0,1,0,0"], "line 3", "where the tool stands", "write GOTO"),
        (["UNITS/MM", "RAPID/5"], "line 2", "RAPID/5", "correct"),
        (["UNITS/MM", *POINTS, "GOHOME", "GOTO/2,0,0"], "line 5", "behind GOHOME", "GOTO"),
        (["UNITS/MM", *POINTS, "GOHOME", "FROM/2,0,0"], "line 5", "behind GOHOME", "GOTO"),
        (["UNITS/MM", *POINTS, "END", "LOADTL/1", "GOTO/2,0,0"], "line 6", "behind END", "part the file"),
        (["UNITS/MM", *POINTS, "FINI", "PPRINT more"], "line 5", "PPRINT behind FINI", "each program"),
        (["UNITS/MM", *POINTS, "FINI", "FINI"], "line 5", "FINI behind FINI", "each program"),
        # circles
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "FEDRAT/1,MMPM"],
            "line 4",
            "FEDRAT behind CIRCLE",
            "anew",
        ),
        (["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "FINI"], "line 4", "FINI behind CIRCLE", "anew"),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,0"],
            "line 3",
            "a circle's axis of length 0",
            "normalise",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1,1,.06,.5,10,0"],
            "line 3",
            "CIRCLE/0,0",
            "without the others",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/-1,0,0,1,0,0"],
            "line 4",
            "ends with the tool axis",
            "as GOTO",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "TLAXIS/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/-1,0,0"],
            "line 5",
            "tool axis 1 0 0",
            "GOTO",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/-1,0,.1"],
            "line 4",
            "0.1 mm off its plane",
            "as GOTO",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1,1.1", "GOTO/-1,0,0"],
            "line 4",
            "radius 1.1 mm",
            "correct centre",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/-1.1,0,0"],
            "line 4",
            "1 mm from the centre at its start and 1.1",
            "correct centre",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/1,0,0,0,0,1", "GOTO/1,0,0"],
            "line 4",
            "radius 0 mm",
            "correct centre",
        ),
        (
            ["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/1,.001,0"],
            "line 4",
            "0.001 mm apart",
            "whole turn",
        ),
        # drilling
        (["UNITS/MM", "CYCLE/TAP,FEDTO,1,RAPTO,1"], "line 2", "CYCLE/TAP", "as GOTO"),
        (["UNITS/MM", "CYCLE/INIT,1"], "line 2", "CYCLE/INIT,1", "as GOTO"),
        (["UNITS/MM", "CYCLE/"], "line 2", "CYCLE/", "as GOTO"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO"], "line 2", "FEDTO alone at its end", "complete"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,DWELL,1"], "line 2", "DWELL", "as GOTO"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,CLEAR,1"], "line 2", "CLEAR again", "remove one"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,MMPM,1,IPM,1"], "line 2", "IPM again", "remove one"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,x,RAPTO,1"], "line 2", "FEDTO x", "correct"),
        (["UNITS/MM", "CYCLE/DRILL,RAPTO,1"], "line 2", "FEDTO", "add it"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1"], "line 2", "RAPTO", "add it"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,INCR,1"], "line 2", "without pecks", "as GOTO"),
        (["UNITS/MM", "CYCLE/DEEP,FEDTO,1,RAPTO,1"], "line 2", "1STPECK and SUBPECK", "as GOTO"),
        (["UNITS/MM", "CYCLE/DEEP2,FEDTO,1,RAPTO,1,1STPECK,1"], "line 2", "1STPECK and SUBPECK", "as GOTO"),
        (
            ["UNITS/MM", "CYCLE/DEEP2,FEDTO,1,RAPTO,1,1STPECK,1,SUBPECK,1,STEP,1"],
            "line 2",
            "with 1STPECK and SUBPECK and INCR and STEP",
            "as GOTO",
        ),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,-1,RAPTO,1"], "line 2", "FEDTO -1 mm", "positive"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,20001,RAPTO,1"], "line 2", "FEDTO 20001 mm", "below the point"),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,-.1"], "line 2", "RAPTO -0.1 mm", "above the point"),
        (
            ["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,2,RTRCTO,1"],
            "line 2",
            "RTRCTO 1 mm, must be 2 to",
            "no lower than RAPTO",
        ),
        (["UNITS/MM", "CYCLE/DEEP,FEDTO,1,RAPTO,2,INCR,.0001"], "line 2", "INCR 0.0001 mm", "each peck"),
        (
            ["UNITS/MM", "CYCLE/DEEP,FEDTO,1,RAPTO,2,1STPECK,1,SUBPECK,0"],
            "line 2",
            "SUBPECK 0 mm",
            "each further peck",
        ),
        (["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,MMPM,1E9", "GOTO/0,0,0"], "line 3", "mm/s", "correct"),
        (
            ["UNITS/MM", "CYCLE/DRILL,FEDTO,1,RAPTO,1,MMPR,1", "GOTO/0,0,0"],
            "line 3",
            "feed per revolution",
            "SPINDL",
        ),
        # feeds
        (["UNITS/MM", "FEDRAT/100"], "line 2", "FEDRAT/100", "add the unit"),
        (["UNITS/MM", "FEDRAT/100,INVERS"], "line 2", "FEDRAT/100,INVERS", "per minute"),
        (["UNITS/MM", "FEDRAT/100,MMPM,IPM"], "line 2", "FEDRAT/100,MMPM,IPM", "per minute"),
        (["UNITS/MM", "FEDRAT/MMPM"], "line 2", "FEDRAT/MMPM", "per minute"),
        (["UNITS/MM", "FEDRAT/0,MMPM"], "line 2", "a feed of 0 mm/s", "correct"),
        (["UNITS/MM", "FEDRAT/-5,MMPM"], "line 2", "a feed of -0.0833333 mm/s", "correct"),
        (["UNITS/MM", "FEDRAT/5,MMPR", "SPINDL/1E9", *POINTS], "line 4", "8.33333e+07 mm/s", "spindle"),
        # coordinates
        (["UNITS/MM", TURNED_CSYS], "line 2", "CSYS/0,0,1.", "TRNTYP/WORLD"),
        (["UNITS/MM", "TRNTYP/WORLD", "CSYS/1,0,0"], "line 3", "CSYS/1,0,0", "3 of them"),
        (
            ["UNITS/MM", "TRNTYP/WORLD", "CSYS/1,0,0,0,0,1,0,0,0,0,2,0"],
            "line 3",
            "a z axis of length 2",
            "normalise",
        ),
        (["UNITS/MM", "TRNTYP/LOCAL"], "line 2", "TRNTYP/LOCAL", "world coordinates"),
        (["UNITS/MM", "TRNTYP/WORLD,0,1,0"], "line 2", "without an offset", "world coordinates"),
        (["UNITS/MM", "TRNTYP/WORLD,X"], "line 2", "without an offset", "world coordinates"),
        (["UNITS/MM", "MSYS/0,0,5,1,0,0,0,1,0"], "line 2", "MSYS/0,0,5", "absolute"),
        (["UNITS/MM", "ORIGIN/0,0,5"], "line 2", "ORIGIN/0,0,5", "origin"),
        (["UNITS/MM", "MULTAX/5"], "line 2", "MULTAX/5", "correct"),
        (["UNITS/MM", "CUTCOM/ON"], "line 2", "CUTCOM/ON", "without compensation"),
        # tools
        (["UNITS/MM", "LOAD/5"], "line 2", "LOAD/5", "correct"),
        (["UNITS/MM", "SELECT/5"], "line 2", "SELECT/5", "correct"),
        (["UNITS/MM", "LOADTL/"], "line 2", "1 to 100 characters", "name the tool"),
        (["UNITS/MM", f"LOADTL/{'x' * 101}"], "line 2", "1 to 100 characters", "name the tool"),
        (["UNITS/MM", "LOADTL/1,LENGTH"], "line 2", "LOADTL/1,LENGTH", "drop"),
        (["UNITS/MM", "LOADTL/1,MANUAL,1"], "line 2", "LOADTL/1,MANUAL", "drop"),
        (["UNITS/MM", "LOADTL/1,LENGTH,5,LENGTH,6"], "line 2", "LENGTH,5,LENGTH,6", "drop"),
        (["UNITS/MM", "LOADTL/1,LENGTH,x"], "line 2", "LENGTH x", "correct"),
        (["UNITS/MM", "LOADTL/1,LENGTH,0"], "line 2", "of length 0 mm", "unit"),
        (["UNITS/MM", "LOADTL/1,LENGTH,2001"], "line 2", "of length 2001 mm", "unit"),
        (["UNITS/MM", "LOADTL/4", "TOOLNO/5", "GOTO/0,0,0"], "line 4", "behind TOOLNO/5", "add LOADTL/5"),
        (["UNITS/MM", "TOOL PATH/A,B"], "line 2", "TOOL PATH/A,B", "correct"),
        # statements
        (["UNITS/MM", "G0 X1"], "line 2", "G0 X1", "GOTO and CIRCLE"),
        (["UNITS/MM", "/GOTO/1,2,3"], "line 2", "/GOTO/1,2,3", "GOTO and CIRCLE"),
        (["UNITS/MM", "GOTO 1,2,3"], "line 2", "GOTO 1,2,3", "GOTO and CIRCLE"),
        (["UNITS/MM", "OPSKIP/ON"], "line 2", "OPSKIP/ON", "GOTO and CIRCLE"),
        (["UNITS/MM", "CSI_SET_A B/1"], "line 2", "CSI_SET_A B/1", "GOTO and CIRCLE"),
        (["UNITS/MM", "FıNI"], "line 2", "FıNI", "GOTO and CIRCLE"),
        (["UNITS/MM", "CUTTER/1,$", "GOTO/1,2,3"], "line 3", "in the middle", "complete line 2"),
        (["UNITS/MM", "GOTO/1.$", "5,2,3"], "line 2", "GOTO/1. 5,2,3", "plain decimal"),
        (["UNITS/MM", "GOTO/1,2 $ 3"], "line 2", "GOTO/1,2 $ 3", "plain decimal"),
        (["UNITS/MM", "INSERT M8 $", "GOTO 1"], "line 2", "INSERT with a $", "remove the $"),
        (["UNITS/MM", "PPRINT/a $ $$ b", "GOTO 1"], "line 2", "PPRINT with a $", "remove the $"),
        (["UNITS/MM", *POINTS, "$$ x", "", "FINI $"], "line 6", "to the end of the file", "add its rest"),
        (["UNITS/MM", f"PPRINT {'x' * 1994}"], "line 2", "over 2000 characters", "shorten"),
        (["UNITS/MM", "$"], "line 2", "to the end of the file", "add its rest"),
        (["UNITS/MM", "$", " ", "$", "5"], "line 2", "5", "GOTO and CIRCLE"),
        (["UNITS/MM", *POINTS], "line 3", "the last statement, GOTO", "cut off"),
        (["UNITS/MM", "GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1"], "line 3", "the last statement, CIRCLE", "cut off"),
        ([""], "line 1", "without a statement", "cut off"),
        (["$$ x", "$$ y", ""], "line 1", "without a statement", "cut off"),
        (["UNITS/MM", "PPRINT \x1b[2J"], "line 2", "0x1b", "plain text"),
        (["UNITS/MM", "PPRINT \x85"], "line 2", "0x85", "plain text"),
        (["UNITS/MM\rPPRINT"], "line 1", "0x0d", "plain text"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_line(lines, key, found, remedy):
    problem = refused("\n".join(lines))
    assert problem.key == key
    assert found in f"{problem.value}, must be {problem.bound}"
    assert remedy in problem.remedy


@pytest.mark.parametrize("major", sorted(REFUSED))
def test_what_changes_coordinates_or_is_no_cutter_location_is_refused(major):
    problem = refused(program(*POINTS, f"{major}/1"))
    assert (problem.key, problem.value) == ("line 4", f"{major}/1")
    assert "CAM" in problem.remedy


HOLE = "CYCLE/DRILL,FEDTO,1,RAPTO,1"


@pytest.mark.parametrize(
    "line",
    [
        "RAPID",
        "GODLTA/1,0,0",
        "FROM/0,0,0",
        "CIRCLE/0,0,0,0,0,1",
        "LOADTL/1",
        "LOAD/TOOL,1",
        HOLE,
        "CYCLE/INIT",
    ],
)
def test_while_a_cycle_is_on_nothing_but_points_is_read(line):
    problem = refused(program("GOTO/1,0,0", HOLE, line))
    assert problem.key == "line 4"
    assert "while a cycle is on" in problem.value
    assert "CYCLE/OFF" in problem.remedy
    off = ["GOTO/1,0,0", HOLE, "GOTO/0,0,0", "CYCLE/OFF", "GOTO/1,0,0", line.replace("FROM/0", "FROM/1")]
    assert len(read(program(*off, "GOTO/-1,0,0")).cuts[0].tips_mm) > 4


def test_a_hole_along_another_axis_is_not_reached_by_a_way_that_is_not_in_the_file():
    problem = refused(program("GOTO/1,0,0", HOLE, "GOTO/0,0,0,1,0,0"))
    assert problem.key == "line 4"
    assert "before CYCLE" in problem.remedy


@pytest.mark.parametrize("line", ["CUTCOM/LEFT", "CUTCOM/RIGHT,2", "cutcom / left"])
def test_compensation_is_refused_unless_it_is_declared(line):
    text = program("CUTCOM/OFF", "GOTO/0,0,0", line, "GOTO/1,0,0")
    problem = refused(text, reading=Reading())
    assert problem.key == "line 4"
    assert OPTIONS["cutcom_is_tool_centre"] in problem.remedy
    assert len(read(text).cuts[0].tips_mm) == 2


def test_bytes_that_are_no_utf_8_are_refused_with_their_line():
    problem = refused(b"UNITS/MM\nINSERT/Fr\xe4ser\nFINI\n")
    assert (problem.key, problem.value) == ("line 2", "byte 0xe4")


def test_the_limit_of_poses_holds_for_points_circles_and_pecks():
    assert len(tips(*POINTS, "GOTO/2,0,0", limit=3)) == 3
    problem = refused(program(*POINTS, "GOTO/2,0,0"), limit=2)
    assert (problem.key, problem.value) == ("line 4", "over 2 poses")
    problem = refused(program("GOTO/1,0,0", "CIRCLE/0,0,0,0,0,1", "GOTO/-1,0,0"), limit=5)
    assert problem.key == "line 4"
    assert OPTIONS["arc_tolerance_mm"] in problem.remedy
    problem = refused(program("CYCLE/DEEP,FEDTO,10000,RAPTO,1,INCR,.001", "GOTO/0,0,0"), limit=50)
    assert (problem.key, problem.value) == ("line 3", "over 50 poses")


@pytest.mark.parametrize("line", ["\n", "$\n", "$$$$\n", "\r\n"])
def test_lines_without_a_statement_take_no_memory(line):
    data = line.encode() * (200_000 // len(line))
    tracemalloc.start()
    try:
        refused(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 3 * len(data) + 100_000


def test_extensions_and_what_may_be_declared(tmp_path):
    for name in ("a.apt", "a.CLS", "a.ncl"):
        language = language_of(tmp_path / name)
        assert language.read is apt.read_apt
        check_declared(tmp_path / name, language, Reading(cutcom_is_tool_centre=True, arc_tolerance_mm=0.1))
        with pytest.raises(InputError, match="--rotary"):
            check_declared(tmp_path / name, language, Reading(rotary="xyzac"))


# ---------------------------------------------------------------- files as found


def located(data):
    """The points of a real file by a reading of its own: line to (x, y, z), and the lines behind CIRCLE and RAPID."""
    points, behind = {}, {"CIRCLE": set(), "RAPID": set()}
    before = ""
    for number, line in enumerate(data.decode().splitlines(), start=1):
        major, _, rest = line.partition("/")
        if major == "GOTO":
            points[number] = tuple(float(text) for text in rest.split(",")[:3])
            if before in behind:
                behind[before].add(number)
        before = major
    return points, behind


def test_boss_is_read_whole():
    data = tool_path("boss.apt").read_bytes()
    points, behind = located(data)
    heard = {}
    path = read(data, told=heard.__setitem__)
    assert len(heard) == data.count(b"\n")
    assert [cut.tool for cut in path.cuts] == ["1", "5", "1", "5"]
    lines = np.concatenate([cut.lines for cut in path.cuts])
    positioning = np.concatenate([cut.positioning for cut in path.cuts])
    at = np.concatenate([cut.tips_mm for cut in path.cuts])
    assert len(set(lines[~positioning].tolist())) == 9039
    assert positioning.sum() == 775
    assert sum("along the circle" in what for what in heard.values()) == len(behind["CIRCLE"]) == 1026
    last = {int(line): index for index, line in enumerate(lines)}
    assert last.keys() == points.keys()
    np.testing.assert_array_equal(at[[last[line] for line in points]], list(points.values()))
    chord = along = turns = 0.0
    for cut in path.cuts:
        ends = np.flatnonzero(np.diff(cut.lines, append=0))  # the last pose of each line
        between = np.linalg.norm(np.diff(cut.tips_mm[ends], axis=0), axis=1)
        chord += between[~cut.positioning[ends][1:]].sum()
        each = np.linalg.norm(np.diff(cut.tips_mm, axis=0), axis=1)
        along += each[~cut.positioning[1:]].sum()
        for end in np.flatnonzero(between == 0.0):
            turns += each[ends[end] : ends[end + 1]].sum()
    assert chord == pytest.approx(236_135, abs=0.5)
    assert along - turns == pytest.approx(chord, rel=0.01)
    assert turns > 0.0, "19 whole turns, whose chord is nothing"
    assert [cut.axes[0].tolist() for cut in path.cuts] == [[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]]
    assert all((cut.axes == cut.axes[0]).all() for cut in path.cuts)
    assert all(0.01 <= cut.tolerance_mm < 0.0101 for cut in path.cuts)


def test_boss_without_the_declaration_is_refused_where_it_compensates():
    problem = refused(tool_path("boss.apt").read_bytes(), reading=Reading())
    assert (problem.key, problem.value) == ("line 3735", "CUTCOM/LEFT")
    assert OPTIONS["cutcom_is_tool_centre"] in problem.remedy


def test_interface_glue_drills_six_holes_and_mills():
    data = tool_path("interface-glue.apt").read_bytes()
    _, behind = located(data)
    path = read(data)
    assert [cut.tool for cut in path.cuts] == ["16", "17", "8", "17"]
    cutting = set().union(*(cut.lines[~cut.positioning].tolist() for cut in path.cuts))
    assert len(cutting) == 6275
    assert len(behind["CIRCLE"]) == 50
    assert len(behind["RAPID"]) == 36
    milled = path.cuts[1:]
    assert sum(int(cut.positioning.sum()) for cut in milled) == 35, "the other one is the drill's"
    drill = path.cuts[0]
    heights = drill.tips_mm[:, 2]
    assert heights.max() == pytest.approx(25.0, abs=1e-9)
    assert heights.min() == pytest.approx(-6.761364 - 15.261, abs=1e-9)
    for line in range(18, 24):
        feeds = heights[(drill.lines == line) & ~drill.positioning]
        np.testing.assert_allclose(-6.761364 - feeds, [5, 7, 9, 11, 13, 15, 15.261], atol=1e-9)
    across = np.linalg.norm(np.diff(drill.tips_mm[:, :2], axis=0), axis=1) > 0
    np.testing.assert_allclose(heights[1:][across], 25.0, atol=1e-9)
    assert drill.feed_range_mm_s == pytest.approx((228.689794 / 60,) * 2)
