"""Robot and site files: what is read, what is refused and how it is said."""

import hashlib
import math
import os
import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import (
    SETTINGS_LIMIT,
    InputError,
    _readable,
    load_robot,
    load_site,
    parse_json,
    parse_toml,
    read_bytes,
    read_settings,
    robot_from_bytes,
    site_from_bytes,
    validate,
)
from cutgate.config.model import Robot, Site, TimingSettings
from cutgate.config.records import calibration_record, limits_record, tool_record

ROOT = Path(__file__).parents[2]
PRESETS = ROOT / "config" / "presets"
EXAMPLE = (PRESETS / "example.toml").read_text(encoding="utf-8")


def refusal(data: str, kind=robot_from_bytes) -> InputError:
    with pytest.raises(InputError) as caught:
        kind("some.toml", data.encode())
    return caught.value


@pytest.mark.parametrize("path", sorted(PRESETS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_preset_is_read(path):
    assert load_robot(path).value.name == path.stem


@pytest.mark.parametrize("path", sorted(PRESETS.glob("*.toml")), ids=lambda path: path.stem)
def test_a_preset_can_be_named_where_no_such_file_is(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    loaded = load_robot(path.stem)
    assert (loaded.value.name, loaded.data) == (path.stem, path.read_bytes())
    assert loaded.path.samefile(path)
    (tmp_path / path.stem).write_text(EXAMPLE.replace('name = "example"', 'name = "mine"'), encoding="utf-8")
    assert load_robot(path.stem).value.name == "mine"


@pytest.mark.parametrize("name", ["figure3", "presets/figure2", "figure2.toml", "", "fig\0ure2", "*"])
def test_what_is_neither_file_nor_preset_is_refused_with_the_presets_names(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="name a preset: example, figure2"):
        load_robot(name)


def test_a_folder_of_a_presets_name_does_not_hide_the_preset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "example").mkdir()
    (tmp_path / "another").mkdir()
    assert load_robot("example").value.name == "example"
    with pytest.raises(InputError, match="another: cannot be read"):
        load_robot("another")


def test_a_broken_link_of_a_presets_name_hides_the_preset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "example").symlink_to("nowhere")
    with pytest.raises(InputError, match="example: no such file"):
        load_robot("example")


def test_the_example_robot_is_the_preset():
    assert (ROOT / "examples" / "robot.toml").read_text(encoding="utf-8") == EXAMPLE


def test_a_loaded_file_keeps_its_bytes_and_their_digest():
    loaded = load_robot(PRESETS / "example.toml")
    assert loaded.data == EXAMPLE.encode()
    assert loaded.sha256 == hashlib.sha256(EXAMPLE.encode()).digest()
    assert loaded.path == PRESETS / "example.toml"


def test_what_the_file_says_is_what_the_robot_has():
    robot, file = robot_from_bytes("r", EXAMPLE.encode()), tomllib.loads(EXAMPLE)
    assert robot.model_dump(by_alias=True, exclude_defaults=True, exclude={"schema_"}) | {
        "schema": file["schema"]
    } == {
        key: {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
        if isinstance(value, dict)
        else value
        for key, value in file.items()
    }


def test_the_example_site_is_read_also_with_every_commented_key():
    text = (ROOT / "examples" / "site.toml").read_text(encoding="utf-8")
    site = site_from_bytes("site.toml", text.encode())
    assert site == Site(timing=TimingSettings(heartbeat_ms=100, timeout_ms=1000))
    everything = re.sub(r"^# (?=\[|\w+ = )", "", text, flags=re.MULTILINE)
    site = site_from_bytes("site.toml", everything.encode())
    assert site.model_fields_set >= {"key_file", "registration_max_age_s", "timing", "bus", "log"}


CALIBRATION = """
[calibration]
upper_link_error_mm = 0.25
forearm_link_error_mm = -0.125
joint_offset_deg = [0.5, -0.5, 1.5, 0.25, -0.25]
slide_tilt_mrad = [20.0, -20.0]
residual_mm = 0.0000001
residual_deg = 0.1
[wrist]
hold_roll_when_vertical = true
hold_roll_deg = 90.0
"""


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("arm_mm = 5.0", 'arm_mm = "5.0"', 'deadband.arm_mm is "5.0", must be a valid number; write the number without quotes'),
        ("arm_mm = 5.0", "arm_mm = true", "deadband.arm_mm is True, must be a valid number; correct deadband.arm_mm"),
        ("[50.0, 450.0]", '[50.0, "450"]', 'limits.q2_mm.1 is "450", must be a valid number; write the number without quotes'),
        ('name = "example"', "name = 20", "name is 20, must be a valid string; write it in quotes"),
    ],
)  # fmt: skip
def test_text_where_a_number_is_asked_is_shown_as_text_with_the_right_remedy(old, new, line):
    assert str(refusal(EXAMPLE.replace(old, new))) == f"some.toml: {line}"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[timing]\nheartbeat_ms = "20"', 'timing.heartbeat_ms is "20", must be a valid integer; write the number without quotes'),
        ("[timing]\nheartbeat_ms = 20.0", "timing.heartbeat_ms is 20.0, must be a valid integer; write a whole number, without a decimal point"),
        ('[bus]\nfd = "true"', 'bus.fd is "true", must be a valid boolean; write true or false, without quotes'),
        ("[bus]\nfd = 1", "bus.fd is 1, must be a valid boolean; write true or false"),
    ],
)  # fmt: skip
def test_a_setting_of_another_type_is_shown_as_it_is_with_the_right_remedy(text, line):
    assert str(refusal(f'schema = "cutgate.site/1"\n{text}', site_from_bytes)) == f"some.toml: {line}"


def test_a_schema_is_shown_as_the_text_it_is():
    assert 'schema is "cutgate.robot/2", must be "cutgate.robot/1"' in str(
        refusal(EXAMPLE.replace("cutgate.robot/1", "cutgate.robot/2"))
    )


def test_records_are_quantised_limits_inward_residuals_outward():
    text = EXAMPLE.replace("[-80.0, 80.0]", "[-80.00000049, 80.00000049]") + CALIBRATION
    robot = robot_from_bytes("r", text.encode())
    limits, calibration = limits_record(robot), calibration_record(robot)
    assert limits.q_min_u == (-80_000_000, 0, 50_000_000, -170_000_000, 0)
    assert limits.q_max_u == (80_000_000, 145_000_000, 450_000_000, 170_000_000, 110_000_000)
    assert limits.speed_u == (57_295_779, 57_295_779, 200_000_000, 114_591_559, 114_591_559)
    assert limits.acceleration_u == (286_478_897, 286_478_897, 1_000_000_000, 572_957_795, 572_957_795)
    assert (calibration.upper_link_u, calibration.forearm_link_u) == (450_000_000, 450_000_000)
    assert (calibration.upper_link_error_u, calibration.forearm_link_error_u) == (250_000, -125_000)
    assert calibration.joint_offset_u == (500_000, -500_000, 1_500_000, 250_000, -250_000)
    assert calibration.slide_tilt_u == (20_000_000, -20_000_000)
    assert (calibration.residual_mm_u, calibration.residual_deg_u) == (1, 100_000)
    assert tool_record(robot).length_mm == 160.0
    assert tool_record(robot, 12.5).length_mm == 12.5


def test_a_robot_without_accelerations_reports_none():
    text = "\n".join(line for line in EXAMPLE.splitlines() if not line.startswith("acceleration"))
    assert limits_record(robot_from_bytes("r", text.encode())).acceleration is None


BAD_ROBOTS = [
    (
        'schema = "cutgate.robot/1"',
        'schema = "cutgate.robot/2"',
        "schema",
        "cutgate.robot/2",
        "cutgate.robot/1",
    ),
    ('schema = "cutgate.robot/1"', "", "schema", "missing", "cutgate.robot/1"),
    ('name = "example"', "", "name", "missing", "given"),
    ('name = "example"', "name = 4", "name", "4", "string"),
    ('name = "example"', 'name = ""', "name", '""', "at least 1"),
    ('elbow = "right"', 'elbow = "up"', "elbow", "up", "'right' or 'left'"),
    ('elbow = "right"', 'elbow = "left"', "limits.q1_deg", "[0.0, 145.0]", "<= 0"),
    ("q1_deg = [0.0, 145.0]", "q1_deg = [-1.0, 145.0]", "limits.q1_deg", "[-1.0, 145.0]", ">= 0"),
    ("q1_deg = [0.0, 145.0]", "q1_deg = [0.0, 180.1]", "limits.q1_deg.1", "180.1", "<= 180"),
    ("upper_link_mm = 450.0", "upper_link_mm = 0.0", "arm.upper_link_mm", "0.0", "> 0"),
    ("upper_link_mm = 450.0", "upper_link_mm = nan", "arm.upper_link_mm", "nan", "finite"),
    ("upper_link_mm = 450.0", "upper_link_mm = inf", "arm.upper_link_mm", "inf", "finite"),
    ("upper_link_mm = 450.0", "upper_link_mm = true", "arm.upper_link_mm", "True", "number"),
    ("upper_link_mm = 450.0", 'upper_link_mm = "450"', "arm.upper_link_mm", "450", "number"),
    ("upper_link_mm = 450.0", "upper_link_mm = 1" + "0" * 400, "arm.upper_link_mm", "1000", "number"),
    ("upper_link_mm = 450.0", "upper_link = 450.0", "arm.upper_link", "450.0", "upper_link_mm"),
    ("length_mm = 160.0", "length_mm = -0.001", "tool.length_mm", "-0.001", ">= 0"),
    ("[tool]", "[tol]", "tol", "160.0", "one of the known keys"),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = [80.0, -80.0]", "limits.q0_deg", "[80.0, -80.0]", "lower < upper"),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = [80.0, 80.0]", "limits.q0_deg", "[80.0, 80.0]", "lower < upper"),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = [-80.0]", "limits.q0_deg.1", "missing", "given"),
    (
        "q0_deg = [-80.0, 80.0]",
        "q0_deg = [-80.0, 0.0, 80.0]",
        "limits.q0_deg",
        "[-80.0, 0.0, 80.0]",
        "at most 2",
    ),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = 80.0", "limits.q0_deg", "80.0", "list"),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = [-36001.0, 80.0]", "limits.q0_deg.0", "-36001.0", ">= -36000"),
    ("q0_deg = [-80.0, 80.0]", "q0_deg = [0.0, 0.0000001]", "limits", "lower limit", "1e-6"),
    ("q2_mm = [50.0, 450.0]", "q2_mm = [50.0, 5243.0]", "limits.q2_mm.1", "5243.0", "<= 5242"),
    ("q4_deg = [0.0, 110.0]", "q4_deg = [-1.0, 110.0]", "limits.q4_deg.0", "-1.0", ">= 0"),
    ("speed = [1.0,", "speed = [0.0,", "limits.speed.0", "0.0", "> 0"),
    ("speed = [1.0,", "speed = [1e-12,", "limits", "speed limit 0.0", "1e-6"),
    ("acceleration = [5.0,", "acceleration = [-5.0,", "limits.acceleration.0", "-5.0", "> 0"),
    ("arm_mm = 5.0", "arm_mm = 0.0", "deadband.arm_mm", "0.0", "> 0"),
    ("wrist_deg = 2.0", "", "deadband.wrist_deg", "missing", "given"),
    ("wrist_deg = 2.0", "wrist_deg = 0.000001", "deadband.wrist_deg", "1e-06", ">= 0.001"),
    (
        "wrist_deg = 2.0",
        "wrist_deg = 2.0\npath_tolerance_mm = -1.0",
        "deadband.path_tolerance_mm",
        "-1.0",
        ">= 0",
    ),
    (
        "[deadband]",
        "[calibration]\nslide_tilt_mrad = [0.0, 20.1]\n[deadband]",
        "slide_tilt_mrad.1",
        "20.1",
        "<= 20",
    ),
    (
        "[deadband]",
        "[calibration]\nupper_link_error_mm = -101.0\n[deadband]",
        "upper_link_error_mm",
        "-101",
        ">= -100",
    ),
    (
        "[deadband]",
        "[calibration]\nresidual_mm = nan\n[deadband]",
        "calibration.residual_mm",
        "nan",
        "finite",
    ),
    (
        "[deadband]",
        "[wrist]\nhold_roll_when_vertical = 1\n[deadband]",
        "hold_roll_when_vertical",
        "1",
        "boolean",
    ),
    ("[deadband]", "[deadband", "some.toml", "line", "valid TOML"),
    ("[tool]", "[arm]", "some.toml", "line", "valid TOML"),
    ("upper_link_mm = 450.0", "upper_link_mm = 5.0\nforearm_link_mm = 4", "some.toml", "line", "valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "key", "value", "bound"), BAD_ROBOTS)
def test_a_bad_robot_is_refused_naming_file_key_value_and_bound(old, new, key, value, bound):
    assert old in EXAMPLE
    message = str(refusal(EXAMPLE.replace(old, new, 1)))
    assert message.startswith("some.toml")
    for part in (key, value, bound):
        assert part in message


def test_a_link_eaten_by_its_error_is_refused():
    text = (
        EXAMPLE.replace("upper_link_mm = 450.0", "upper_link_mm = 50.0")
        + "[calibration]\nupper_link_error_mm = -50.0\n"
    )
    assert "arm.upper_link_mm is 50.0 + -50.0" in str(refusal(text))


def test_all_problems_of_a_file_are_listed():
    text = EXAMPLE.replace("length_mm = 160.0", "length_mm = -1").replace("arm_mm = 5.0", "arm_mm = -5.0")
    error = refusal(text.replace("wrist_deg", "wrist"))
    assert [problem.key for problem in error.problems] == [
        "tool.length_mm",
        "deadband.arm_mm",
        "deadband.wrist_deg",
        "deadband.wrist",
    ]
    assert len(str(error).splitlines()) == 4


def test_the_unlimited_joint_and_both_elbows_are_accepted():
    text = EXAMPLE.replace("[-80.0, 80.0]", "[-36000.0, 36000.0]").replace('"right"', '"left"')
    assert robot_from_bytes("r", text.replace("[0.0, 145.0]", "[-145.0, 0.0]").encode()).elbow == "left"


def site(text: str) -> Site:
    return site_from_bytes("site.toml", ('schema = "cutgate.site/1"\n' + text).encode())


def test_settings_as_windows_writes_them_are_the_same():
    for text in ("\ufeff" + EXAMPLE, EXAMPLE.replace("\n", "\r\n"), "\ufeff" + EXAMPLE.replace("\n", "\r\n")):
        assert robot_from_bytes("r", text.encode()) == robot_from_bytes("r", EXAMPLE.encode())


def test_an_almost_empty_site_file_is_the_default_site():
    assert site("") == Site()


OLD_SETTINGS = [
    ("[link]\ncounter_step = 4", ["link.counter_step"]),
    ("[link]\ncrc_failures = 1\ncrc_window_ms = 2000", ["link.crc_failures", "link.crc_window_ms"]),
    ("[timing]\nannounce_ms = 250", ["timing.announce_ms"]),
    ("[timing]\nannounce_ms = true\n[link]\ncounter_step = 'x'", ["link.counter_step", "timing.announce_ms"]),
]


@pytest.mark.parametrize(("text", "keys"), OLD_SETTINGS)
def test_a_setting_that_never_had_an_effect_is_refused_with_the_line_to_delete(text, keys):
    with pytest.raises(InputError) as caught:
        site(text)
    assert [problem.key for problem in caught.value.problems] == keys
    for line in str(caught.value).splitlines():
        assert (
            "must be left out: 0.2.0 has no such setting, and it never had an effect; delete this line"
            in line
        )


def test_other_names_in_a_table_of_old_settings_are_unknown_as_anywhere():
    with pytest.raises(InputError, match=r"link .*one of the known keys"):
        site("[link]\ncounter_steps = 4")
    with pytest.raises(InputError, match=r"link .*one of the known keys"):
        site("link = 4")


@pytest.mark.parametrize(("text", "_keys"), OLD_SETTINGS)
def test_a_site_in_a_log_is_read_as_its_version_read_it(text, _keys):
    data = f'schema = "cutgate.site/1"\n{text}'.encode()
    assert site_from_bytes("site.toml", data, recorded=True) == Site()


def test_a_log_may_hold_a_time_out_of_three_heartbeats_and_no_shorter_one():
    text = 'schema = "cutgate.site/1"\n[timing]\nheartbeat_ms = 100\ntimeout_ms = '
    assert site_from_bytes("s", f"{text}300".encode(), recorded=True).timing.timeout_ms == 300
    with pytest.raises(InputError, match="3 heartbeats of 100 ms"):
        site_from_bytes("s", f"{text}299".encode(), recorded=True)
    assert site_from_bytes("s", f"{text}400".encode()).timing.timeout_ms == 400


def test_a_site_sets_what_it_names_and_keeps_the_rest(tmp_path):
    (tmp_path / "site.toml").write_text(
        'schema = "cutgate.site/1"\nkey_file = "k"\nregistration_max_age_s = 900\n[timing]\nheartbeat_ms = 50\n'
        'timeout_ms = 500\n[permit]\npermit_lifetime_s = 60\n[bus]\ninterface = "socketcan"\nchannel = "can0"\nfd = true\n'
        '[controller]\nserial = "CG-1"\n[log]\ndirectory = "logs"\n',
        encoding="utf-8",
    )
    found = load_site(tmp_path / "site.toml").value
    assert (found.timing.heartbeat_ms, found.timing.timeout_ms, found.permit.permit_lifetime_s) == (
        50,
        500,
        60,
    )
    assert (found.bus.channel, found.bus.fd, found.controller.serial, found.log.directory) == (
        "can0",
        True,
        "CG-1",
        "logs",
    )
    assert found.start == Site().start


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[timing]\nheartbeat_ms = 4", ("timing.heartbeat_ms", "4", ">= 5")),
        ("[timing]\nheartbeat_ms = 20.0", ("timing.heartbeat_ms", "20.0", "integer")),
        (
            "[timing]\nheartbeat_ms = 100\ntimeout_ms = 399",
            ("timing.timeout_ms", "399", "4 heartbeats of 100 ms"),
        ),
        ("[timing]\ntimeout_ms = 1001", ("timing.timeout_ms", "1001", "<= 1000")),
        ("[permit]\npermit_lifetime_s = 601", ("permit.permit_lifetime_s", "601", "<= 600")),
        ("[permit]\nlifetime_s = 60", ("permit.lifetime_s", "60", "permit_lifetime_s")),
        ("[start]\nstart_tolerance_mm = nan", ("start.start_tolerance_mm", "nan", "finite")),
        ("[start]\nstart_tolerance_mm = 0.5004", ("start.start_tolerance_mm", "0.5004", "thousandths")),
        ("[start]\nstart_tolerance_deg = 0.12345", ("start.start_tolerance_deg", "0.12345", "thousandths")),
        ("[approach]\napproach_clearance_mm = 1e-4", ("approach_clearance_mm", "0.0001", "thousandths")),
        ("registration_max_age_s = 0", ("registration_max_age_s", "0", "> 0")),
        ('[bus]\ninterface = ""', ("bus.interface", '""', "at least 1")),
        ("[bus]\nfd = 1", ("bus.fd", "1", "boolean")),
        ("bus = 3", ("bus", "3", "table")),
    ],
)
def test_a_bad_site_is_refused_naming_key_value_and_bound(text, parts):
    message = str(refusal('schema = "cutgate.site/1"\n' + text, site_from_bytes))
    assert all(part in message for part in parts), message


@pytest.mark.parametrize("text", ["{}.", "[1, {}-]", '{{"a": {}_}}', '{{"{}": {}x}}'])
def test_a_number_too_large_that_runs_into_what_follows_is_refused_in_words(text):
    digits = "9" * 400
    with pytest.raises(InputError) as caught:
        parse_json("plan.json", text.format(digits, digits).encode())
    message = str(caught.value)
    assert "must be a finite number" in message
    assert "line 1 column" in message


def test_a_missing_file_a_folder_and_a_pipe_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, words in {
        "missing": "no such file",
        "": "cannot be read",
        "pipe": "not a regular file",
    }.items():
        with pytest.raises(InputError, match=words):
            read_bytes(tmp_path / name)


def test_an_unreadable_name_is_refused(tmp_path):
    for name in ("a\0b", "x" * 5000):
        with pytest.raises(InputError, match="cannot be read"):
            read_bytes(tmp_path / name)


def test_a_file_is_read_up_to_its_limit_and_not_beyond(tmp_path):
    (tmp_path / "f").write_bytes(b"x" * 100)
    assert len(read_bytes(tmp_path / "f", 100)) == 100
    with pytest.raises(InputError, match="<= 99 bytes"):
        read_bytes(tmp_path / "f", 99)


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(
        InputError, match=f"size is {1 << 40} bytes, must be <= 64000000 bytes; raise file_size"
    ):
        read_bytes(tmp_path / "sparse")


@pytest.mark.parametrize("load", [load_robot, load_site, read_settings])
def test_a_settings_file_has_a_bound_of_its_own(load, tmp_path):
    comment = ("#" * 99 + "\n").encode()
    (tmp_path / "f").write_bytes(EXAMPLE.encode() + comment * 1000)
    size = len(EXAMPLE) + 100_000
    with pytest.raises(
        InputError, match=f"f: size is {size} bytes, must be <= 100000 bytes; it holds something"
    ):
        load(tmp_path / "f")
    data = EXAMPLE.encode().ljust(SETTINGS_LIMIT, b"\n")
    assert robot_from_bytes("f", data) == robot_from_bytes("f", EXAMPLE.encode())
    with pytest.raises(InputError, match="size is 100001 bytes"):
        robot_from_bytes("f", data + b"\n")


def unparsed(monkeypatch):
    """From here on nothing may reach the parser."""
    monkeypatch.setattr(tomllib, "loads", lambda _text: pytest.fail("parsed"))


@pytest.mark.parametrize(
    "key", ["a" + ".a" * 101, "a . 'b' " * 102, '"".' * 101 + "a", "[" + "a." * 101 + "a]"]
)
def test_a_key_of_endless_parts_is_refused_before_it_is_parsed(key, monkeypatch):
    unparsed(monkeypatch)
    dots = key.count(".")
    with pytest.raises(InputError, match=f"f.toml: line 3 is a line of {dots} dots, must be <= 100 dots"):
        parse_toml("f.toml", f"a = 1\n# {'.' * 100}\n{key} = 1".encode())


def test_a_line_of_numbers_is_no_key():
    text = "a = [" + ", ".join(["1.5"] * 100) + "]\n"
    assert parse_toml("f.toml", text.encode()) == {"a": [1.5] * 100}


def test_an_error_that_quotes_thousands_of_characters_still_names_its_place():
    text = f"[{'k' * 10_000}]\n[{'k' * 10_000}]\n"
    with pytest.raises(
        InputError, match=r"Cannot declare \('kkk.* \.\.\. .*\(at line 2, column 10002\)"
    ) as caught:
        parse_toml("f.toml", text.encode())
    assert len(str(caught.value)) < 400


def test_a_document_of_endless_keys_is_refused_by_their_number():
    with pytest.raises(InputError, match=r"r\.toml: keys is 101 keys, must be <= 100 keys"):
        validate("r.toml", Robot, dict.fromkeys(map(str, range(101))), "cutgate.robot/1")


def test_a_limit_larger_than_the_memory_takes_none_of_it(tmp_path):
    (tmp_path / "f").write_bytes(b"x" * 100)
    assert len(read_bytes(tmp_path / "f", 1 << 62)) == 100


def test_text_that_is_not_utf8_names_its_line():
    with pytest.raises(InputError, match="line 3 is byte 0xff"):
        parse_toml("f", b"a = 1\nb = 2\nc = '\xff'")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "line 1 column"),
        ('{"a": NaN}', "finite"),
        ('{"a": -Infinity}', "finite"),
        ('{"a": 1e999}', "1e999"),
        ('{"b": 1.5, "a": 1, "a": 2}', "a is given twice"),
        ("[" * 100_000, "not usable JSON"),
        ('{"id": "9", "a":\n -' + "9" * 5000 + "}", "line 2 column 2 is -9999.*a double can hold"),
        ("[0, 1" + "0" * 309 + "]", "line 1 column 5 is 1000.*a double can hold"),
        ("9" * 309, "line 1 column 1 is 9999.*a double can hold"),
    ],
)
def test_json_beyond_the_standard_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        parse_json("f.json", text.encode())


def test_an_integer_that_a_double_can_hold_is_read():
    assert parse_json("f.json", b"[-1" + b"0" * 308 + b", 0, -0]") == [-(10**308), 0, 0]


def test_a_number_of_toml_that_no_double_holds_is_refused_as_it_is_written():
    with pytest.raises(InputError, match=r"line 2 column 5 is -1e400, must be a finite number"):
        parse_toml("f.toml", b"# 1\na = -1e400")
    assert parse_toml("f.toml", b"a = -inf")["a"] == -math.inf  # which the key's own bound refuses


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_text_of_utf16_is_named(encoding):
    for read in (parse_toml, parse_json):
        with pytest.raises(InputError, match="line 1 is a byte-order mark of UTF-16, must be UTF-8 text"):
            read("f", "\ufeff{}".encode(encoding))


def test_toml_of_endless_nesting_is_refused():
    with pytest.raises(InputError, match=r"usable TOML|valid TOML"):
        parse_toml("f.toml", b"a = " + b"[" * 90_000)


@pytest.mark.parametrize("digits", ["9" * 5000, "1_" * 4400 + "1"])
def test_toml_of_endless_digits_is_refused_with_its_place(digits):
    with pytest.raises(InputError, match=r"line 2 column 6 is [91_]*\.\.\., must be a finite number"):
        parse_toml("f.toml", b"# don't\na = -" + digits.encode())


def test_a_document_that_is_no_table_of_keys_is_refused():
    with pytest.raises(InputError, match="object with keys"):
        validate("r.json", Robot, [1, 2], "cutgate.robot/1")


def test_a_message_of_another_form_is_passed_on():
    assert _readable("Unable to read it") == "Unable to read it"


def test_an_integer_python_would_not_write_out_is_refused_as_any_other_value():
    text = EXAMPLE.replace("upper_link_mm = 450.0", "upper_link_mm = 0x1" + "0" * 50_000)
    assert "arm.upper_link_mm is an integer of 200001 bits" in str(refusal(text))


JSONISH = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")))
def test_any_bytes_are_read_or_refused(data):
    for kind in (robot_from_bytes, site_from_bytes):
        error = error_of(lambda kind=kind: kind("fuzz.toml", data))
        assert error is None or str(error).startswith("fuzz.toml")


@given(st.data())
def test_an_example_with_any_value_anywhere_is_read_or_refused(data):
    document = tomllib.loads(EXAMPLE)
    table = data.draw(
        st.sampled_from([document, *(value for value in document.values() if isinstance(value, dict))])
    )
    key = data.draw(st.sampled_from(sorted(table)) | st.text(max_size=4))
    table[key] = data.draw(JSONISH)
    error = error_of(lambda: validate("fuzz", Robot, document, "cutgate.robot/1"))
    assert error is None or all(problem.file == "fuzz" for problem in error.problems)


def error_of(act) -> InputError | None:
    """The refusal, if there is one; any other exception is the test's failure."""
    try:
        act()
    except InputError as error:
        return error
    return None


@given(st.integers(0, len(EXAMPLE.encode()) - 1), st.integers(0, 255))
def test_an_example_with_any_byte_changed_is_read_or_refused(place, byte):
    data = bytearray(EXAMPLE.encode())
    data[place] = byte
    error = error_of(lambda: robot_from_bytes("fuzz", bytes(data)))
    assert error is None or str(error).startswith("fuzz")


def test_plain_json_is_read():
    assert parse_json("f.json", b'{"a": [1, 2.5, null, true], "b": {"c": "d"}}') == {
        "a": [1, 2.5, None, True],
        "b": {"c": "d"},
    }
