"""Inputs that once were answered wrongly, from a folder beside the repository; skipped where it is not there.

What is done to a session, a disk or a terminal stands in the tests of its own kind.
"""

from pathlib import Path

import pytest

from cutgate.runtime.commands.app import execute

CASES = Path(__file__).parents[3] / "shared" / "cases"

EDGES = {
    # arguments in the folder, exit code, words that are told, words that must not be
    "an id that closes a tag": (["id-closing-tag.plan.json"], 0, ["[/]"], []),
    "an id like a tag": (
        ["id-swallowed.plan.json"],
        0,
        ["[bold red]x[/bold red] [link=http://a]b[/link]"],
        [],
    ),
    "a registration like a tag": (
        ["base.csv", "--registration", "id-left-knee.registration.json"],
        0,
        ["[left knee]"],
        [],
    ),
    "an id that escapes": (["id-escape.plan.json"], 0, ["\\x1b"], ["\x1b"]),
    "a number of 10 000 digits": (["digits-10000.csv"], 2, ["line 2"], []),
    "a byte-order mark": (["bom.csv"], 0, ["ADMISSIBLE"], []),
    "a number no double holds": (["1e400.plan.json"], 2, ["line 1 column", "1e400", "finite"], []),
    "dotted keys": (["base.csv", "--robot", "dotted-20kB.robot.toml"], 2, ["dotted-20kB.robot.toml"], []),
    "unlimited roll": (["base.csv", "--robot", "unlimited-roll.robot.toml"], 0, ["ADMISSIBLE"], []),
}
ADMISSIBLE_STEM = ["stem.plan.json", "--registration", "registration-right.json"]
GEOMETRY = {
    "the roll with a residual, arm stretched": (
        ["residual-extension.csv", "--robot", "residual-extension.robot.toml"],
        1,
        ["INADMISSIBLE", "roll_max"],
        [],
    ),
    "the roll with a residual, arm folded": (
        ["residual-fold.csv", "--robot", "residual-fold.robot.toml"],
        1,
        ["INADMISSIBLE"],
        [],
    ),
    "a deadband below what arithmetic tells": (
        ["vertical-1e-6.csv", "--robot", "vertical-1e-6.robot.toml", "--feed-mm-s", "1"],
        2,
        ["wrist_deg"],
        [],
    ),
    "guidance without an end": (["circle.csv", "--robot", "circle.robot.toml"], 1, ["INADMISSIBLE"], []),
    **{
        f"a claim that was too wide, {number}": (
            [f"claim-{number}.csv", "--robot", f"claim-{number}.robot.toml"],
            1,
            ["keeps 0.2 mm beyond the deadband of arm and slide and 0.1 deg beyond that of the roll"],
            [],
        )
        for number in (1, 3, 4)
    },
    "the right registration": (ADMISSIBLE_STEM, 0, ["ADMISSIBLE"], ["WARNING"]),
    "a registration in metres": (
        ["stem.plan.json", "--registration", "registration-metres.json"],
        1,
        ["WARNING CT_TRANSLATION_SMALL", "WARNING REGISTRATION_IN_METRES"],
        [],
    ),
    "a registration transposed": (
        ["stem.plan.json", "--registration", "registration-transposed.json"],
        1,
        ["WARNING REGISTRATION_"],
        [],
    ),
    "a hold that is declared": (
        [
            *("vertical.csv", "--robot", "hold.robot.toml"),
            *("--registration", "tilt-1urad.registration.json"),
        ],
        1,
        ["vertical"],
        ["declare hold_roll_when_vertical"],
    ),
    "a rotation of five decimals": (
        ["stem.plan.json", "--registration", "registration-rounded.json"],
        2,
        ["5 decimals", "7 or more"],
        ["scaling"],
    ),
    "a time of another zone": (
        ["stem.plan.json", "--registration", "registration-plus-one-hour.json"],
        2,
        ["convert", "Z"],
        [],
    ),
}


def rows(table, folder):
    return [
        pytest.param(folder, *row, id=f"{folder}-{name.replace(' ', '-')}") for name, row in table.items()
    ]


@pytest.mark.parametrize(
    ("folder", "arguments", "code", "words", "never"), [*rows(EDGES, "edges"), *rows(GEOMETRY, "geometry")]
)
def test_an_input_that_once_was_answered_wrongly_is_answered_right(
    monkeypatch, capfd, folder, arguments, code, words, never
):
    if not (CASES / folder).is_dir():
        pytest.skip("the cases are not beside this repository")
    monkeypatch.chdir(CASES / folder)
    robot = [] if "--robot" in arguments else ["--robot", "robot.toml"]
    found = execute(["verify", *arguments, *robot])
    out, err = capfd.readouterr()
    told = " ".join((out + err).split())
    assert found == code, told
    for word in words:
        assert word in told
    for word in never:
        assert word not in out + err
