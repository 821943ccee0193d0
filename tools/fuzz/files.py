"""Files that people write: robot, site, plan, tool path, registration, and the path that is made of them."""

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cutgate.config.load import InputError, Loaded, robot_from_bytes, site_from_bytes
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records as wire
from cutgate.runtime.plan.load import plan_from_bytes, plans_from_bytes, registration_from_bytes
from cutgate.runtime.plan.model import Plan
from cutgate.runtime.plan.prepare import prepare
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.plan.registrations.declared import CtFrame, Declared, TransformDirection
from cutgate.runtime.plan.registrations.foreign import converted
from cutgate.runtime.plan.registrations.from_landmarks import registered, registration_of
from cutgate.runtime.plan.registrations.landmarks_csv import read_landmarks
from cutgate.runtime.plan.toolpath.gcode import read_gcode
from cutgate.runtime.plan.toolpath.model import Reading
from tests.runtime.audit.build import inputs
from tools.fuzz.harness import Family, attempt, choose, expect

NOW = datetime(2026, 9, 1, tzinfo=UTC)
POSE_LIMIT = 5000
EXPANDED_LIMIT = 1000
"""Poses of a language in which a line may stand for many."""
PROGRAM_LIMIT = 200
"""Poses of a program, in which a few lines may make many, and so what may be executed of it."""


def check(data: bytes) -> None:
    """The first byte chooses which file the rest is."""
    (name, read), rest = choose(data, FILES)
    try:
        read(rest)
    except InputError as error:
        expect(name in str(error), f"{error} names its file")
        expect(all(str(problem).isprintable() for problem in error.problems), "a message can be shown")


def _robot(data: bytes) -> None:
    robot = robot_from_bytes("robot.toml", data)
    for record in (limits_record(robot), calibration_record(robot), tool_record(robot)):
        expect(type(record).parse(record.body()) == record, f"{record} can be sent")
    again = type(robot).model_validate_json(robot.model_dump_json(by_alias=True))
    expect(again == robot, "a robot survives being written")


def _site(data: bytes) -> None:
    site = site_from_bytes("site.toml", data)
    expect(type(site).model_validate_json(site.model_dump_json(by_alias=True)) == site, "a site survives")


def _plan(data: bytes) -> None:
    _prepared("plan.json", data)


def _csv(data: bytes) -> None:
    _prepared("path.csv", data)


def _prepared(name: str, data: bytes) -> None:
    """The plan, and the path it becomes where the example's registration puts it."""
    plan = plan_from_bytes(Path(name), data, POSE_LIMIT)
    expect(bool(np.isfinite(plan.tips_mm).all() and np.isfinite(plan.axes).all()), "every pose is finite")
    expect(len(plan.tips_mm) <= data.count(b",") // 5, "no pose comes from nowhere")
    _quantised(plan, data, REGISTRATION)


def _quantised(plan: Plan, data: bytes, registration: Loaded[Registration]) -> None:
    loaded = Loaded(plan, data, Path("plan.json"))
    prepared = attempt(
        InputError, lambda: prepare(loaded, registration, inputs().robot.value, now=NOW, clock_skew_s=0.0)
    )
    if prepared is not None:
        expect(wire.Path.parse(prepared.path.body()) == prepared.path, "a path can be sent")


def _gcode(data: bytes) -> None:
    """Every pose of every tool, and what is told of the lines."""
    told: list[int] = []

    def hear(line: int, text: str) -> None:
        told.append(line)
        expect(0 < len(text) <= 240, "what is told is short, and something")

    path = read_gcode("path.ngc", data, Reading(rotary="xyzac"), PROGRAM_LIMIT, hear)
    expect(sum(len(cut.tips_mm) for cut in path.cuts) <= PROGRAM_LIMIT, "the limit of poses holds")
    for cut in path.cuts:
        expect(bool(np.isfinite(cut.tips_mm).all()), "every pose is finite")
        expect(bool((abs(np.linalg.norm(cut.axes, axis=1) - 1.0) < 1e-9).all()), "an axis is a unit vector")
        expect(set(cut.lines.tolist()) <= set(told), "a pose has a line that is told of")
        expect(bool((cut.feeds_mm_s[np.isfinite(cut.feeds_mm_s)] > 0.0).all()), "a feed moves")


def _apt(data: bytes) -> None:
    """Every pose of every tool, and what is told of the lines."""
    told: list[int] = []

    def hear(line: int, text: str) -> None:
        told.append(line)
        expect(bool(text), "something is told of each statement")

    reading = Reading(cutcom_is_tool_centre=True)
    plans = plans_from_bytes(Path("path.apt"), data, EXPANDED_LIMIT, reading, hear)
    expect(sum(len(plan.tips_mm) for plan in plans) <= EXPANDED_LIMIT, "the limit of poses holds")
    expect(told == sorted(set(told)) and told[-1] <= data.count(b"\n") + 1, "each statement is told once")
    for plan in plans:
        expect(bool(np.isfinite(plan.tips_mm).all()), "every pose is finite")
        expect(
            bool((abs(np.linalg.norm(plan.axes, axis=1) - 1.0) < 1e-9).all()), "every axis is a unit vector"
        )
        expect(plan.cut is not None and set(plan.cut.lines.tolist()) <= set(told), "a pose has its line")
    _quantised(plans[0], data, REGISTRATION)


def _registration(data: bytes) -> None:
    value = registration_from_bytes(Path("registration.json"), data)
    expect(value.created.utcoffset() is not None, "a registration's time is absolute")
    rotation = value.matrix[:3, :3]
    expect(bool(abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-5), "a registration is rigid")
    _quantised(PLAN, inputs().plan, Loaded(value, data, Path("registration.json")))


def _foreign(name: str) -> Callable[[bytes], None]:
    """A registration of another program; HDF5 is read by a library of its own, whose search this is not."""

    def read(data: bytes) -> None:
        _registration(converted(Path(name), data, DECLARED))

    return read


def _landmarks(data: bytes) -> None:
    found = registered("landmarks.csv", read_landmarks("landmarks.csv", data))
    expect(not found.fit.mirrored and found.fit.rms_mm <= 100.0, "a fit can be believed")
    value = registration_from_bytes(
        Path("landmarks.csv"), registration_of(found, "fuzz", None, "2026-01-01T00:00:00Z")
    )
    expect(len(value.check_points) < len(found.landmarks), "some landmarks are fitted")


DECLARED = Declared(CtFrame.RAS, TransformDirection.ROBOT_TO_CT, "2026-01-01T00:00:00Z", 0.2)
FILES: tuple[tuple[str, Callable[[bytes], None]], ...] = (
    ("robot.toml", _robot),
    ("site.toml", _site),
    ("plan.json", _plan),
    ("path.csv", _csv),
    ("registration.json", _registration),
    ("path.apt", _apt),
    ("path.ngc", _gcode),
    ("registration.tfm", _foreign("registration.tfm")),
    ("registration.txt", _foreign("registration.txt")),
    ("landmarks.csv", _landmarks),
)
PLAN = plan_from_bytes(Path("plan.csv"), inputs().plan)
REGISTRATION = Loaded(
    registration_from_bytes(Path("registration.json"), inputs().registration),
    inputs().registration,
    Path("registration.json"),
)
ROBOT_IN_FULL = b"""schema = "cutgate.robot/1"
name = "full"
elbow = "left"
[arm]
upper_link_mm = 450.0
forearm_link_mm = 450.0
[tool]
length_mm = 160.0
[limits]
q0_deg = [-80.0, 80.0]
q1_deg = [-145.0, 0.0]
q2_mm = [50.0, 450.0]
q3_deg = [-36000, 36000]
q4_deg = [0.0, 110.0]
speed = [1.0, 1.0, 200.0, 2.0, 2.0]
acceleration = [5.0, 5.0, 1000.0, 10.0, 10.0]
[calibration]
upper_link_error_mm = 0.125
joint_offset_deg = [0.1, 0.0, -0.5, 0.0, 0.0]
slide_tilt_mrad = [1.0, -2.0]
residual_mm = 0.05
residual_deg = 0.01
[wrist]
hold_roll_when_vertical = true
hold_roll_deg = 5.0
[deadband]
arm_mm = 5.0
wrist_deg = 2.0
path_tolerance_mm = 0.1
path_tolerance_deg = 0.1
"""
GCODE = b"""%
N10 G21 G90 G94 G17 (every kind of motion) F600
o<hole> sub
#3=[#1 + 2 * ABS[SIN[30] - #2]] #<_last>=#3
G99 G83 X#3 Y0 R2 Z-3 Q1.5 ; pecks
G80
o<hole> endsub [#3 / 2]
T1 M6
G43.1 Z160.
M428
G0 X0 Y0 Z10 A-30 C0
G1 X10 C5
#<n>=0
o1 while [#<n> LT 2]
o2 if [#<n> EQ 0]
G2 X12 Y0 R5
o2 else
G91 G3 X-2 I-1 J0 Z.5 P2
G90
o2 endif
#<n>=[#<n> + 1]
o1 endwhile
o<hole> call [1] [2]
G93 G1 X1 F20
G28
M30
%
"""
APT = b"""$$ every kind of motion
PARTNO/1
UNITS/MM
LOADTL/1,LENGTH,160.
TRNTYP/WORLD,0,0,0
CSYS/0,0,1.,0,1.,0,0,0,0,1.,0,0
FEDRAT/600.,MMPM
FROM/40.,0,0,1.,0,0
RAPID
GOTO/10.,.5,-2.E0,1.,0,0
GODLTA/-1.,0,0
CUTCOM/LEFT
CIRCLE/9.,5.5,-2.,1.,0,0,5.
GOTO/9.,10.5,$
-2.
CUTCOM/OFF
GOHOME
load / tool,2
CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0
SPINDL/1200,RPM,CLW
GOTO/0,0,20.,0,0,1.
CYCLE/DEEP2,FEDTO,9.,1STPECK,5.,SUBPECK,2.,MMPR,.05,RAPTO,3.,RTRCTO,20.
GOTO/5.,5.,0
CYCLE/OFF
FINI
"""
PLAN_JSON: dict[str, Any] = {
    "schema": "cutgate.plan/1",
    "id": "a",
    "implant": "stem",
    "side": "left",
    "units": "mm",
    "tool_length_mm": 160.0,
    "feed_mm_s": 5.5,
    "ct_T_implant": [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]],
    "ct_id": "ct",
    "poses": [[0, 0, 0, 0, 0, 1], [1, 0.5, -1e-3, 0, 0.6, 0.8], [2, 1, 0, 0, 0, 1]],
}


CHECK_POINTS = b'"check_points": [{"id": "P1", "ct_mm": [1, 2, 3], "robot_mm": [501, 52, 123]}]'
TRANSFORMS = b"""#Insight Transform File V1.0
#Transform 0
Transform: CompositeTransform_double_3_3
#Transform 1
Transform: Euler3DTransform_double_3_3
Parameters: 0.1 0.2 0.3 1 2 3
FixedParameters: 4 5 6 1
#Transform 2
Transform: VersorRigid3DTransform_double_3_3
Parameters: 0 0 0.19866933079506122 500 50 120
FixedParameters: 1 2 3
"""
LANDMARKS = b"""id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z,use
P1,40,-30,10,640,-30,210,fit
P2,-35,-28,5,565,-28,205,fit
P3,2,45,-12,602,45,188,fit
P4,5,3,60,605,3,260,fit
P5,-20,10,33,580,10,233,check
"""


def _seeds() -> Iterator[bytes]:
    i = inputs()
    site = (
        b'schema = "cutgate.site/1"\npose_limit = 1000\n[timing]\nheartbeat_ms = 20\n'
        b'[start]\nstart_tolerance_mm = 0.5\n[bus]\ninterface = "cutgate"\n'
    )
    examples = (
        ("robot.toml", i.robot.data),
        ("robot.toml", ROBOT_IN_FULL),
        ("site.toml", b'schema = "cutgate.site/1"\n'),
        ("site.toml", site),
        ("plan.json", json.dumps(PLAN_JSON).encode()),
        ("path.csv", i.plan),
        ("path.csv", i.plan.replace(b"\n", b"\r\n")),
        ("path.apt", APT),
        ("path.apt", APT.replace(b"\n", b"\r\n").replace(b"UNITS/MM", b"UNIT/INCH").replace(b"160.", b"6.")),
        ("path.ngc", GCODE),
        ("path.ngc", GCODE.replace(b"\n", b"\r\n").replace(b"G21", b"G20").replace(b"G80", b"G80 #9=1/7")),
        ("path.ngc", b"G21 F9\nG0 X0 Y0 Z0\no1 do\nG91 G1 X1 (a)\no1 while [1]\nM2"),
        ("registration.json", i.registration),
        ("registration.json", i.registration.replace(b'"id"', b'"ct_id": "ct", "id"')),
        ("registration.json", i.registration.replace(b'"id"', CHECK_POINTS + b', "id"')),
        ("registration.tfm", TRANSFORMS),
        ("registration.txt", b"1 0 0 500\n0,1,0,50\n0 0 1 120\n0 0 0 1\n"),
        ("landmarks.csv", LANDMARKS),
    )
    names = [name for name, _ in FILES]
    for name, content in examples:
        yield bytes([names.index(name)]) + content
    yield bytes([4]) + i.registration.replace(b'"id"', b'"\\u001b[2J\\nid": 1, "id"')
    for nasty in (b'{"a":' * 5000, b"[" * 5000, b'{"schema":1e999}', b"a = " + b"[" * 5000, b"9" * 5000):
        for number in range(len(FILES)):
            yield bytes([number]) + nasty


FAMILY = Family(check, tuple(_seeds()))
