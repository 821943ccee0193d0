"""``cutgate register`` as people call it: what is written, what is told, what is refused."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest

from cutgate.config.model import Site
from cutgate.runtime.commands import app as cli
from cutgate.runtime.plan.load import load_registration
from cutgate.runtime.plan.registration import checked
from tests.runtime.plan.registrations.itk_files import rotation

HEADER = "id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z,use"
CT = np.array(
    [[40.0, -30, 10], [-35.0, -28, 5], [2.0, 45, -12], [5.0, 3, 60], [-20.0, 10, 33], [11.0, -40, -25]]
)
USES = ("fit", "fit", "fit", "fit", "check", "check")
TURN, SHIFT = rotation(0.3, -0.5, 2.1), np.array([520.0, -60.0, 210.0])
ROBOT = CT @ TURN.T + SHIFT


@pytest.fixture
def register(tmp_path, monkeypatch, capsys):
    """Runs ``cutgate register`` on these landmarks in a folder of its own: exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*options, ct=CT, robot=ROBOT, uses=USES, names=None, out="reg.json"):
        names = names or [f"P{number}" for number in range(len(ct))]
        rows = [
            ",".join((name, *map(repr, (*map(float, a), *map(float, b))), use))
            for name, a, b, use in zip(names, ct, robot, uses, strict=True)
        ]
        (tmp_path / "knee.csv").write_text("\n".join((HEADER, *rows)) + "\n", encoding="utf-8")
        code = cli.execute(["register", "knee.csv", "-o", out, *options])
        told = capsys.readouterr()
        assert "Traceback" not in told.err
        return code, told.out, " ".join(told.err.split())

    return call


def test_what_is_written_is_the_fit_with_the_held_out_as_check_points(register, tmp_path):
    before = datetime.now(UTC)
    code, out, said = register("--id", "left knee", "--ct-id", "femur-ct")
    after = datetime.now(UTC)
    found = load_registration(tmp_path / "reg.json").value
    assert code == 0
    np.testing.assert_allclose(found.matrix[:3, :3], TURN, atol=1e-12)
    np.testing.assert_allclose(found.matrix[:3, 3], SHIFT, atol=1e-9)
    assert (found.id, found.ct_id) == ("left knee", "femur-ct")
    assert found.residual_rms_mm < 1e-9
    assert before <= found.created <= after
    assert [(one.id, *one.ct_mm) for one in found.check_points] == [("P4", *CT[4]), ("P5", *CT[5])]
    assert checked(found, Site(check_points_min=2)).outside == ()
    assert "4 landmarks fitted, residual 0.000 mm rms; 2 held out" in out
    assert "written: reg.json, taken at" in said


def test_every_residual_is_shown_and_the_rms_is_that_of_the_fitted(register, tmp_path):
    noise = np.random.default_rng(3).normal(0.0, 0.5, CT.shape)
    noise[5] = (0.0, 0.0, 4.0)
    code, out, _ = register(robot=ROBOT + noise)
    assert code == 0
    found = load_registration(tmp_path / "reg.json").value
    off = np.linalg.norm(CT @ found.matrix[:3, :3].T + found.matrix[:3, 3] - ROBOT - noise, axis=1)
    lines = out.splitlines()
    for number, (use, residual) in enumerate(zip(USES, off, strict=True)):
        assert lines[1 + number].split() == [f"P{number}", use, f"{residual:.3f}"]
    rms = float(np.sqrt((off[:4] ** 2).mean()))
    assert found.residual_rms_mm == pytest.approx(rms)
    assert f"residual {rms:.3f} mm rms" in out
    assert "off by more than the 2 mm that a site allows if it says nothing: P5" in out


def test_nothing_is_overwritten_unless_it_is_said(register, tmp_path):
    file = tmp_path / "reg.json"
    file.write_text("precious")
    code, out, said = register()
    assert (code, out, file.read_text()) == (2, "", "precious")
    assert "reg.json: exists already; name another file, or say --force" in said
    assert register("--force")[0] == 0
    assert load_registration(file).value.id == "knee"
    link = tmp_path / "link.json"
    link.symlink_to(tmp_path / "elsewhere.json")
    assert register(out="link.json")[0] == 2
    assert not (tmp_path / "elsewhere.json").exists()


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("reg.tfm", "reg.tfm: extension is .tfm, must be .json for a registration"),
        ("knee.csv", "knee.csv: extension is .csv, must be .json"),
        ("no/such/reg.json", "no/such/reg.json: cannot be written: No such file or directory"),
    ],
)
def test_where_it_cannot_be_written_is_refused(register, out, said):
    code, told, error = register(out=out)
    assert (code, told) == (2, "")
    assert said in error


def test_a_landmarks_file_of_another_kind_is_refused(register, capsys):
    assert cli.execute(["register", "knee.json", "-o", "reg.json"]) == 2
    assert "knee.json: extension is .json, must be .csv for landmarks" in capsys.readouterr().err
    assert cli.execute(["register", "none.csv", "-o", "reg.json"]) == 2
    assert "none.csv: no such file" in capsys.readouterr().err


LINE = np.outer(np.arange(6.0), (10.0, 20.0, -5.0))
REFUSED = {
    "two": ({"uses": ("fit", "fit", *["check"] * 4)}, "use is 2 landmarks to fit, must be >= 3 landmarks to fit"),
    "on a line": (
        {"ct": LINE, "robot": LINE @ TURN.T + SHIFT}, "least singular value of ct_x, ct_y, ct_z of the landmarks to fit is 0.000 mm rms off a line",
    ),
    "nearly on a line": (
        {"ct": LINE + 0.3 * CT / 60.0, "robot": (LINE + 0.3 * CT / 60.0) @ TURN.T + SHIFT}, "must be >= 1 mm: else nothing keeps the bone",
    ),
    "touched on a line": ({"robot": LINE}, "of robot_x, robot_y, robot_z of the landmarks to fit is"),
    "mirrored": ({"robot": ROBOT * (1, -1, 1)}, "mm rms off, 0.000 mm as a mirror image, must be landmarks of which one set is moved"),
    "CT in metres": ({"ct": CT / 1000.0}, "off a line"),
    "robot in centimetres": ({"robot": ROBOT / 10.0}, "robot coordinates that are 0.1 times those of the CT in size"),
    "in inches": ({"robot": ROBOT / 25.4 * 10.0}, "write both in mm"),
    "other landmarks": ({"robot": ROBOT[[1, 2, 3, 0, 4, 5]]}, "or a line is not the same landmark in both"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_landmarks_that_give_no_registration_are_refused_with_why_and_nothing_is_written(
    register, tmp_path, case
):
    changes, said = REFUSED[case]
    code, out, error = register(**changes)
    assert (code, out) == (2, "")
    assert said in error
    assert not (tmp_path / "reg.json").exists()


def test_lps_for_ras_is_no_mirror_image_and_fits(register):
    """Two axes are reversed: a rotation. The fit takes it up, and the plan must have the same axes as the landmarks."""
    assert register(ct=CT * (-1, -1, 1))[0] == 0


def test_what_the_landmarks_cannot_show_is_told(register):
    flat = CT * (1, 1, 0)
    code, _, said = register(ct=flat, robot=flat @ TURN.T + SHIFT, uses=["fit"] * 6)
    assert code == 0
    assert "no landmark is held out" in said
    assert "the fitted landmarks lie within" in said
    _, _, said = register("--force")
    assert "plane" not in said
    assert "no landmark is held out" not in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--id", ""], "--id is 0 characters, must be 1 to 200 characters; say --id"),
        (["--id", "x" * 201], "--id is 201 characters"),
        (["--ct-id", ""], "--ct-id is 0 characters, must be 1 to 200 characters; say the plan's ct_id"),
    ],
)
def test_an_id_has_its_bounds_and_its_option_is_named(register, options, said, tmp_path):
    code, _, error = register(*options)
    assert code == 2
    assert said in error
    assert not (tmp_path / "reg.json").exists()


def test_an_id_of_the_greatest_length_is_written(register, tmp_path):
    assert register("--id", "x" * 200, "--ct-id", "y" * 200)[0] == 0
    assert json.loads((tmp_path / "reg.json").read_text())["id"] == "x" * 200


def test_names_are_data(register, tmp_path):
    names = ["\x1b[2J", "[red]", "P2", "P3", "]0;x\x07", "P5"]
    code, out, _ = register(names=names, robot=ROBOT + np.array([0, 0, 9.0]) * (np.arange(6) == 4)[:, None])
    assert code == 0
    assert "\x1b" not in out
    assert "\x07" not in out
    assert "[red]" in out
    assert "\\x1b[2J" in out
    assert [one["id"] for one in json.loads((tmp_path / "reg.json").read_text())["check_points"]] == names[4:]
