"""``cutgate example DIR``, and what ``demo --out DIR`` shares with it."""

import errno
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from cutgate.config.load import EXAMPLES, load_robot, load_site
from cutgate.runtime.commands import app as cli
from cutgate.runtime.commands.example import README
from cutgate.runtime.plan.load import load_plan, load_registration

DATA = {path.name for pattern in ("*.json", "*.toml", "*.service") for path in EXAMPLES.glob(pattern)}
MAKES_A_FOLDER = [["example"], ["demo", "--out"]]


@pytest.fixture
def refusal(capsys):
    """Runs a command that must be refused in one line; returns it."""

    def call(*arguments):
        assert cli.execute([str(argument) for argument in arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        (line,) = said.err.splitlines()
        return line

    return call


def commands(verb):
    """The command lines of this verb in README.txt, as arguments."""
    lines = README.replace("\\\n", " ").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith(f"  cutgate {verb} ")]


def test_what_to_look_at_first_is_told_with_options_that_there_are():
    (words,) = commands("doctor")
    named = cli.load("doctor").make_context("doctor", words[1:]).params
    assert [str(named[option]) for option in ("site", "key", "log_dir")] == ["site.toml", "site.key", "logs"]


def test_a_project_of_tests_is_written_with_all_that_it_needs(tmp_path, capsys):
    folder = tmp_path / "hil"
    assert cli.execute(["example", "hil", str(folder)]) == 0
    written = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert written.keys() == {
        "README.txt",
        "pyproject.toml",
        "pretended.py",
        "test_own_controller.py",
        "test_simulated_controller.py",
    }
    assert capsys.readouterr().out == f"{folder}: 5 files written; {folder}/README.txt says how to start\n"
    project = tomllib.loads(written["pyproject.toml"].decode())["project"]
    assert "cutgate" in project["dependencies"]
    lines = written["README.txt"].decode().splitlines()
    assert len(lines) <= 10
    for name in written.keys() - {"README.txt", "pyproject.toml"}:
        compile(written[name], name, "exec")
        assert name.encode() in written["README.txt"]


def test_a_folder_may_be_called_hil(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["example", "hil"]) == 0
    assert (tmp_path / "hil" / "robot.toml").exists()


def test_two_names_are_refused_where_the_first_is_not_hil(tmp_path, refusal):
    line = refusal("example", "start", tmp_path / "x")
    assert "a folder, or hil and a folder" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", [False, True])
def test_all_files_are_written_and_can_be_read(there, tmp_path, capsys):
    folder = tmp_path / "a" / "b"
    if there:
        folder.mkdir(parents=True)
    assert cli.execute(["example", str(folder)]) == 0
    assert (
        capsys.readouterr().out
        == f"{folder}: {len(DATA) + 1} files written; {folder}/README.txt says how to start\n"
    )
    assert {path.name for path in folder.iterdir()} == DATA | {"README.txt"}
    for name in DATA:
        assert (folder / name).read_bytes() == (EXAMPLES / name).read_bytes()
    load_robot(folder / "robot.toml")
    load_site(folder / "site.toml")
    for path in folder.glob("*.json"):
        (load_plan if path.name.endswith(".plan.json") else load_registration)(path)


def test_the_readme_names_every_file_and_fits_a_terminal():
    assert set(re.findall(r"[\w.-]+", README)) >= DATA
    assert max(map(len, README.splitlines())) <= 80
    assert README.isascii()


def test_the_readmes_verifications_say_what_it_says(tmp_path, monkeypatch, capsys):
    assert cli.execute(["example", str(tmp_path / "x")]) == 0
    monkeypatch.chdir(tmp_path / "x")
    assert [cli.execute(arguments) for arguments in commands("verify")] == [1, 0]
    out = capsys.readouterr().out
    assert "\nINADMISSIBLE: outer" in out
    assert "\nADMISSIBLE: " in out


@pytest.mark.parametrize("command", MAKES_A_FOLDER, ids=" ".join)
def test_a_folder_with_files_is_refused_and_untouched(command, tmp_path, refusal):
    for name in ("b", "a", ".hidden"):
        (tmp_path / name).write_text("mine", encoding="utf-8")
    line = refusal(*command, tmp_path)
    assert line.startswith(f"{tmp_path}: ")
    assert "is a folder with .hidden and 2 more in it, must be new or empty; name another folder" in line
    assert {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()} == dict.fromkeys(
        ("b", "a", ".hidden"), "mine"
    )


@pytest.mark.parametrize("command", MAKES_A_FOLDER, ids=" ".join)
def test_a_file_a_way_through_a_file_and_a_broken_link_are_refused(command, tmp_path, refusal):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    (tmp_path / "link").symlink_to("nowhere")
    assert "is a file, must be a folder, new or empty" in refusal(*command, tmp_path / "file")
    assert "cannot be made (Not a directory)" in refusal(*command, tmp_path / "file" / "x")
    assert "cannot be read (No such file or directory)" in refusal(*command, tmp_path / "link")
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / "nowhere").exists()


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def before(monkeypatch):
    """Does something, or raises an error, when the file of that name is about to be written."""
    original = Path.open

    def call(name, act):
        def opened(path, *how, **more):
            if (path.name, how) == (name, ("xb",)):
                if isinstance(act, BaseException):
                    raise act
                act(path)
            return original(path, *how, **more)

        monkeypatch.setattr(Path, "open", opened)

    return call


@pytest.mark.parametrize("command", MAKES_A_FOLDER, ids=" ".join)
@pytest.mark.parametrize("there", [False, True])
def test_a_full_disk_is_said_in_one_line_and_nothing_is_left(command, there, tmp_path, refusal, before):
    folder = tmp_path / "x"
    if there:
        folder.mkdir()
    before("robot.toml", FULL)
    line = refusal(*command, folder)
    assert line.startswith(f"{folder}/robot.toml: cannot be written (No space left on device); make room or ")
    assert line.endswith("; nothing of it is left there")
    assert list(tmp_path.rglob("*")) == ([folder] if there else [])


def test_what_cannot_be_removed_again_is_named(tmp_path, refusal, before, monkeypatch):
    def stuck(_path):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(Path, "unlink", stuck)
    before("hip-stem.plan.json", FULL)
    assert refusal("example", tmp_path / "x").endswith(
        "; cutgate-run.service, femoral.plan.json could not be removed again"
    )


@pytest.mark.parametrize("linked", [False, True])
def test_what_appears_meanwhile_is_neither_overwritten_nor_followed(linked, tmp_path, refusal, before):
    (tmp_path / "victim").write_text("mine", encoding="utf-8")

    def plant(path):
        if linked:
            path.symlink_to(tmp_path / "victim")
        else:
            path.write_text("mine", encoding="utf-8")

    before("robot.toml", plant)
    assert "robot.toml: cannot be written (File exists)" in refusal("example", tmp_path / "x")
    assert [path.name for path in (tmp_path / "x").iterdir()] == ["robot.toml"]
    assert (tmp_path / "x" / "robot.toml").read_text(encoding="utf-8") == "mine"
    assert (tmp_path / "victim").read_text(encoding="utf-8") == "mine"


def test_ctrl_c_leaves_nothing_behind(tmp_path, before):
    before("robot.toml", KeyboardInterrupt())
    assert cli.execute(["example", str(tmp_path / "x")]) == 130
    assert list(tmp_path.iterdir()) == []


def test_without_a_folder_the_usage_is_shown(capsys):
    assert cli.execute(["example"]) == 2
    assert "DIR" in capsys.readouterr().err
