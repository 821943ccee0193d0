"""The benchmark scripts still run, and what they count is what the paper and the optimum say."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[3] / "tools" / "benchmarks"


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark script as its own directory's Python would."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_table_1_beside_bisection_and_the_fewest_evaluations_possible(script):
    head, *rows = script("verification").table_1()
    columns = dict(zip(head, zip(*rows, strict=True), strict=True))
    assert columns["paper"] == columns["`stocco`"] == ("97", "83", "47", "65")
    assert columns["bound, eq. (15)"] == ("352",) * 4
    assert columns["adaptive bisection"] == ("83", "69", "31", "35")
    assert columns["fewest at 2 deadbands"] == ("73", "56", "25", "25")
    assert columns["fewest at the deadband"] == ("56", "42", "25", "25")


def test_table_2_is_one_more_than_printed(script):
    _, *rows = script("verification").table_2()
    assert [row[1:4] for row in rows] == [
        ("500", "501", "hip-stem"),
        ("700", "701", "femoral"),
        ("300", "301", "tibial"),
    ]
    assert all(int(march) <= int(bound) for *_, bound, march in rows)


def test_the_answer_alone_is_timed_on_paths_that_one_look_decides_beside_their_inverse_kinematics(script):
    head, *rows = script("verification").answer_alone()
    assert [dict(zip(head, row, strict=True))["open segments"] for row in rows] == ["0", "0"]
    problem = script("paths").hip_stem()
    margin = script("rivals").dense(problem, 1e6)
    q0, q1, z, q3, q4 = script("rivals").inverse_kinematics(problem)
    for joint, q in enumerate((q0, q1, z, q3, q4)):
        least = min((q - problem.lower[joint]).min(), (problem.upper[joint] - q).min())
        assert least == pytest.approx(margin[joint], abs=1e-9)


def test_no_cover_is_found_where_the_path_does_not_keep_the_distance(script):
    paths, rivals = script("paths"), script("rivals")
    with pytest.raises(ValueError, match="does not keep"):
        rivals.optimal_cover(rivals.AlongThePath(paths.zigzag(765.299, 90.0)), 56.0)


def test_the_paths_that_are_timed_are_admissible_and_as_long_as_said(script):
    certified, paths = script("verification").certified, script("paths")
    for problem in (paths.hip_stem(), paths.level_pocket()):
        assert len(problem.tips_mm) == 2000
        assert certified.verify(problem).admissible
    heights = paths.level_pocket().tips_mm[:, 2]
    assert heights.min() == heights.max()


def test_the_sampling_rival_agrees_with_the_gate_where_both_look(script):
    """Slide margins are the same thing for both; the rival's come from its samples alone."""
    certified, paths, rivals = script("verification").certified, script("paths"), script("rivals")
    problem = paths.hip_stem()
    found, margin = certified.verify(problem).boundaries, rivals.dense(problem, 0.1)
    assert margin[2] == pytest.approx(min(found["top"].clearance, found["bottom"].clearance), abs=1e-3)


@pytest.mark.parametrize(
    ("data", "is_fd", "nominal", "fast"),
    [
        (b"\x55" * 64, True, 29, 5 + 512 + 25 + 7 + 1),  # no five equal bits: 25 of count and CRC, 7 fixed
        (b"\x55" * 16, True, 29, 5 + 128 + 21 + 6 + 1),
        (bytes(8), True, 29, 5 + 64 + 21 + 6 + 1 + 13),  # 67 zeros in a row
        (b"\x55" * 7 + b"\xe0", True, 29, 5 + 64 + 21 + 6 + 1),  # five at the end: the fixed one serves
    ],
)
def test_bits_of_an_fd_frame_are_those_counted_by_hand(script, data, is_fd, nominal, fast):
    """Identifier 0x555: 17 bits alternate up to the bit rate switch, 12 follow at the nominal rate after the CRC."""
    frame = script("bits").Sent(0x555, data, is_fd)
    assert frame.bits == nominal + fast
    assert frame.seconds == pytest.approx(nominal * 1e-6 + fast * 0.2e-6)


def test_bits_of_a_classic_frame_lie_between_none_and_all_stuffed(script):
    """Identifier 0 without data has 19 zeros, the CRC of which is 0 as well: 34 zeros, a stuff bit after every five."""
    sent = script("bits").Sent
    assert sent(0, b"").bits == 34 + 6 + 13
    for value in range(256):
        assert 111 <= sent(0x640, bytes([value] * 8)).bits <= script("bits").WORST_BITS


def test_no_upload_is_nearer_to_the_bit_rate_than_full_frames_can_be(script):
    _, *rows = script("wire").pose_and_upload()
    classic, fd = ({name: row[column] for name, *row in rows} for column in (0, 1))
    assert classic["bytes of the path"] == fd["bytes of the path"] == str(40 + 20 * 2000)
    for mode in (classic, fd):
        names = (
            "full frames without stuff bits / limit of the coded path",
            "upload / limit of the coded path",
        )
        lowest, found = (float(mode[name]) for name in names)
        assert 1.0 < lowest < found < 1.35 * lowest


def test_every_shipped_path_is_coded_in_no_more_than_nine_bytes_a_pose(script):
    head, *rows = script("wire").coded_paths()
    assert len(rows) == 3
    for row in rows:
        shown = dict(zip(head, row, strict=True))
        assert float(shown["bytes a pose, coded"]) <= 9.0
        assert int(shown["blocks"]) == -(-(40 + 20 * int(shown["poses"])) // 4000)


def test_a_session_on_the_wire_is_counted_to_its_end(script):
    _, *rows = script("wire").session_bytes()
    counted = {name: row for name, *row in rows}
    assert int(counted["RuntimeStop"][0]) == 1
    assert int(counted["bulk records of the runtime"][0]) > 1900
    assert int(counted["bulk records of the runtime"][4]) < 400


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize("side", ["controller", "runtime"])
def test_every_reaction_that_is_timed_is_the_expected_one(script, side, monkeypatch):
    """An arm that has stopped is not shown to move after the fault frame: its joints are compared, not their tag."""
    reaction = script("reaction")
    monkeypatch.setattr(reaction, "TRIALS_CUTTING", 4)
    monkeypatch.setattr(reaction, "TRIALS_RUNTIME", 2)
    head, *rows = getattr(reaction, f"{side}_cutting")()
    assert len(rows) == {"controller": len(reaction.WRONGS), "runtime": 6}[side]
    for row in rows:
        shown = dict(zip(head, row, strict=True))
        if side == "controller" and shown["bound"] == reaction.CYCLE:
            moved, stopped = (float(shown[name].split()[0]) for name in ("last movement shown, max", "max"))
            assert moved <= stopped
