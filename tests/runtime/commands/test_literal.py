"""Ids, names of files and what a log says are data: shown as they stand, never as markup, controls or further lines."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from cutgate.config.interpreter import program
from cutgate.config.load import EXAMPLES
from cutgate.runtime.audit import records
from cutgate.runtime.commands.app import execute
from tests.runtime.audit.build import forge, session_log
from tests.runtime.audit.test_replay import changed

ROBOT = ["--robot", str(EXAMPLES / "robot.toml")]
PLAN = json.loads((EXAMPLES / "tibial.plan.json").read_text(encoding="utf-8"))
PLACED = json.loads((EXAMPLES / "registration-tibial.json").read_text(encoding="utf-8"))
HOSTILE = {
    "closing tag": "[/]",
    "style": "x [bold red]b[/bold red]",
    "side": "reg [left knee]",
    "emoji": ":warning: :skull:",
    "escape": "a\x1b[2J\x1b[1;1Hb",
    "line of its own": "x\nADMISSIBLE: the whole path keeps every deadband",
    "overwritten line": "x\rADMISSIBLE",
    "direction": "a\u202egnp.exe",
    "other controls": "\x00\x07\x08\x9b31m\u2028\u2029\u200f",
    "formula": "$x$ ${a}_b$ \\frac{1}{2}",
}
hostile = pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)


def as_shown(text: str) -> str:
    """Oracle, without `printable`: each character that a terminal would not just show, as Python writes it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@pytest.fixture
def shown(capfd):
    """Runs a command; its exit code, and what it wrote on both streams, without the breaks of long lines."""

    def call(*arguments):
        code = execute([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert code != 70, err
        return code, out, err

    return call


def check(told: str, text: str | None = None):
    assert [c for c in told if not (c.isprintable() or c == "\n")] == []
    if text is not None:
        assert "".join(as_shown(text).split()) in "".join(told.split())


def written(folder: Path, text: str) -> tuple[Path, list[str]]:
    """A plan and a registration whose every id says so."""
    plan, registration = folder / "plan.json", folder / "registration.json"
    ids = {"id": text, "ct_id": text}
    plan.write_text(json.dumps({**PLAN, **ids, "implant": text}), encoding="utf-8")
    registration.write_text(json.dumps({**PLACED, **ids}), encoding="utf-8")
    return plan, [*ROBOT, "--registration", str(registration)]


@hostile
def test_ids_are_shown_as_they_stand(shown, tmp_path, text):
    plan, placed = written(tmp_path, text)
    plain = shown(
        "verify",
        EXAMPLES / "tibial.plan.json",
        *ROBOT,
        "--registration",
        EXAMPLES / "registration-tibial.json",
    )
    code, out, err = shown("verify", plan, *placed, "--certificate", tmp_path / "proof")
    assert (code, plain[0]) == (0, 0)
    check(out, text)
    check(err)
    for word in ("ADMISSIBLE", "INADMISSIBLE"):
        assert [line[:10] for line in out.splitlines()].count(word[:10]) == [
            line[:10] for line in plain[1].splitlines()
        ].count(word[:10])
    code, out, err = shown("recheck", tmp_path / "proof", plan, *placed)
    assert code == 0
    check(out + err)
    code, out, err = shown(
        "reach", plan, *placed, "--step-mm", 400, "--cores", 1, "--out", tmp_path / "r.csv"
    )
    assert code == 0, err
    check(out + err)


@hostile
def test_names_of_files_are_shown_as_they_stand(shown, tmp_path, text):
    name = text.replace("/", "|").replace("\x00", "")
    folder = tmp_path / name
    folder.mkdir()
    path = folder / f"{name}.plan.json"
    path.write_text(json.dumps(PLAN), encoding="utf-8")
    placed = [*ROBOT, "--registration", EXAMPLES / "registration-tibial.json"]
    proof = folder / "proof"
    for arguments, code in [
        (["verify", path, *placed, "--certificate", proof], 0),
        (["recheck", proof, path, *placed], 0),
        (["verify", folder / "absent.json", *placed], 2),
        (["verify", path, *placed, "--registration", folder / "absent.json"], 2),
        (["audit", "verify", folder / "absent.mcap"], 3),
        (["audit", "show", path], 2),
        (["audit", "replay", path], 2),
        (["key", "new", folder / "key"], 0),
        (["key", "new", folder / "key"], 2),
        (["example", folder / "example"], 0),
        (["example", folder / "example"], 2),
    ]:
        found, out, err = shown(*arguments)
        assert found == code, (arguments, err)
        check(out + err)
        if code and arguments[0] != "audit":
            check(err, name)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("log")).log


@hostile
def test_what_a_log_says_is_shown_as_it_stands(shown, log, tmp_path, text):
    forged = tmp_path / "forged.mcap"
    data = log.read_bytes()
    for record, field in (
        (records.AuditDecision, "reason"),
        (records.AuditVerdict, "reason"),
        (records.AuditOpen, "software"),
    ):
        data = forge(data, changed(record, **{field: text}))
    forged.write_bytes(data)
    shutil.copy(log.with_suffix(".candump.log"), forged.with_suffix(".candump.log"))
    code, out, err = shown("audit", "show", forged)
    assert code == 0
    check(out, text)
    for command in ("verify", "replay"):
        _, out, err = shown("audit", command, forged)
        check(out + err)


READS_NOTHING = {
    "verify": ["verify", "tibial", "--robot", "example", "--registration", "registration-tibial"],
    "verify --json": ["verify", "tibial", "--robot", "example", "--registration", "registration-tibial", "--json"],
    "an inadmissible path": ["verify", "hip-stem", "--robot", "example", "--registration", "registration-first"],
    "help": ["--help"],
    "help of a command": ["verify", "--help"],
    "help of the simulated controller": ["sim", "--help"],
    "help of the hub": ["bus", "serve", "--help"],
    "version": ["--version"],
    "example": ["example", "{}/example"],
    "show": ["audit", "show", "{log}"],
    "audit verify": ["audit", "verify", "{log}"],
    "audit verify --json": ["audit", "verify", "{log}", "--json"],
    "replay": ["audit", "replay", "{log}"],
    "reach": ["reach", "tibial", "--robot", "example", "--registration", "registration-tibial", "--step-mm", "400", "--cores", "1", "--out", "{}/r.csv"],
}  # fmt: skip


@pytest.mark.processes
@pytest.mark.parametrize("arguments", READS_NOTHING.values(), ids=READS_NOTHING)
def test_output_that_nobody_reads_is_no_verdict(arguments, log, tmp_path):
    command = program("cutgate.runtime.cli", *(one.format(tmp_path, log=log) for one in arguments))
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        said = process.stderr.read().decode()
    assert process.returncode == 141, said
    assert "Traceback" not in said
    assert "Exception ignored" not in said


@pytest.mark.processes
def test_a_verdict_whose_messages_nobody_reads_stays_one(tmp_path):
    missing = program("cutgate.runtime.cli", "verify", "absent.json", "--robot", "example")
    with subprocess.Popen(missing, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stderr.close()
        assert process.stdout.read() == b""
    assert process.returncode == 2


@pytest.mark.processes
@pytest.mark.parametrize(
    "arguments", [["--help"], ["sim", "--help"], ["verify", "tibial", "--robot", "example", "--json"]]
)
def test_output_that_finds_no_room_is_no_verdict_and_said_in_one_line(arguments):
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            program("cutgate.runtime.cli", *arguments),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 74
    assert done.stderr == "cutgate: what was to be written is not whole: No space left on device\n"


@pytest.mark.processes
def test_messages_that_find_no_room_change_no_code(tmp_path):
    with Path("/dev/full").open("wb") as full:
        for arguments, code in (
            (["key", "new", str(tmp_path / "key")], 0),
            (["verify", "absent.json", "--robot", "example"], 2),
            (["verify", "--nope"], 2),
            (["sim", "--nope"], 2),
            (["bus", "serve", "--nope"], 2),
            (["nope"], 2),
            ([], 2),
            (["key"], 2),
        ):
            done = subprocess.run(program("cutgate.runtime.cli", *arguments), stderr=full, check=False)
            assert done.returncode == code


@pytest.mark.processes
@pytest.mark.parametrize("name", ["FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TTY_COMPATIBLE"])
def test_help_in_a_pipe_has_no_sequences_whatever_is_forced(name):
    done = subprocess.run(
        program("cutgate.runtime.cli", "--help"),
        env={**os.environ, name: "1"},
        capture_output=True,
        check=True,
    )
    assert b"\x1b" not in done.stdout
