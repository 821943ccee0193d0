"""Every setting of ``site.toml`` acts: a row for each, with two values of it and what is seen of either.

What is looked at is what the setting is for, never the digest that a permit binds: a setting that changes nothing is a
lie in that digest.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from pydantic import BaseModel

from cutgate.config.load import InputError, Loaded, site_from_bytes
from cutgate.config.model import Site
from cutgate.firmware_sim import table as controller_table
from cutgate.firmware_sim.reports import announcement
from cutgate.firmware_sim.state import Controller, Holdings, Identity, Memory, OpenReceived
from cutgate.protocol import records
from cutgate.protocol.frames import RuntimeHeartbeat
from cutgate.runtime.commands import run as command
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock import permissives as p
from cutgate.runtime.interlock.state import Announced, Interlock, Phase, Tick
from cutgate.runtime.interlock.state import Job as SessionJob
from cutgate.runtime.interlock.tracking import TrackingMonitor
from cutgate.runtime.kinematics.landmarks import PointResidual
from cutgate.runtime.session import conduct, new_log
from cutgate.runtime.session.check import Answer
from cutgate.runtime.session.job import InputFiles, make_job, read_files
from cutgate.runtime.verification.steps import finished
from tests.altering import altered
from tests.runtime.interlock.builders import (
    ANNOUNCE,
    FRESH,
    NOW,
    READY,
    RUNTIME_NONCE,
    START_JOINTS,
    TRAJECTORY,
    in_phase,
    sent,
    step,
)
from tests.runtime.session.pair import NOW as TODAY
from tests.runtime.session.pair import STANDS, check_of, job_of, pair_of
from tests.runtime.session.wire import of


@dataclass
class Trial:
    """A site of one setting, and what is made of it."""

    setting: str
    value: str
    base: InputFiles
    folder: Path
    monkeypatch: pytest.MonkeyPatch

    @property
    def text(self) -> str:
        """The file."""
        table, _, key = self.setting.rpartition(".")
        head = "" if self.setting == "schema" else 'schema = "cutgate.site/1"\n'
        return f"{head}{f'[{table}]' if table else ''}\n{key} = {self.value}\n"

    @cached_property
    def files(self) -> InputFiles:
        data = self.text.encode()
        site = Loaded(site_from_bytes("site.toml", data), data, Path("site.toml"))
        return replace(self.base, site=site, allow_simulated=False)

    @cached_property
    def job(self) -> SessionJob:
        return make_job(self.files, now=TODAY)

    @cached_property
    def state(self) -> Interlock:
        """Ready to start, but for what this job asks for."""
        return replace(READY, job=self.job)

    def run(self) -> SimpleNamespace:
        """What the command ``run`` makes of it, up to where the session would begin."""
        made = SimpleNamespace(key=None)

        def bus(interface: str, channel: str, **options: Any) -> can.BusABC:
            made.bus = {"interface": interface, "channel": channel, **options}
            return SimpleNamespace(shutdown=lambda: None)  # type: ignore[return-value]

        def log(directory: Path, **options: Any) -> None:
            made.log = {"directory": str(directory), **options}
            return SimpleNamespace(
                attach=lambda *_: None,
                previous=SimpleNamespace(crashed=False, note=""),
                held=SimpleNamespace(enrolled=None),
                path=Path(),
            )

        def session(*_: Any, **options: Any) -> None:
            made.session = options
            raise InputError("session", "", None, "is not to begin")

        stubs: dict[str, Any] = {
            "read_files": lambda *_, **__: self.files,
            "make_job": lambda *_, **__: self.job,
            "Check": lambda *_: None,
            "load_key": lambda path: setattr(made, "key", str(path)) or bytes(32),
            "open_bus": bus,
            "Session": session,
            "Journal": lambda *_: SimpleNamespace(close=lambda *_, **__: None, frame=None),
            "Worker": SimpleNamespace(start=lambda _: SimpleNamespace(close=lambda: None)),
            "listed_before": lambda _log: (),
            "refusal": lambda _listed, _file, _said, skew_s: setattr(made, "skew_s", skew_s) or "",
            "typed": lambda _: None,
        }
        with self.monkeypatch.context() as patched:
            for name, stub in stubs.items():
                for module in (command, conduct):
                    patched.setattr(module, name, stub, raising=False)
            patched.setattr(new_log.AuditLog, "create", log)
            key = [] if self.setting == "key_file" else ["--key", str(self.folder / "site.key")]
            where = [] if self.setting.startswith("bus.") else ["--interface", "test", "--channel", "x"]
            execute(["run", "plan.csv", "--robot", "r", "--registration", "g", *key, *where])
        return made

    def answer(self) -> Answer:
        """This side's own verification."""
        return finished(check_of(self.job, self.files.robot.value).steps(1, STANDS))

    def reads(self) -> bool:
        """Whether the plan is read."""
        site = self.folder / "site.toml"
        site.write_text(self.text, encoding="utf-8")
        try:
            read_files(
                self.folder / "plan.csv",
                self.folder / "robot.toml",
                self.folder / "registration.json",
                site,
                None,
            )
        except InputError:
            return False
        return True


Look = Callable[[Trial], Any]


def still(phase: Phase, seconds: float) -> Look:
    """Whether this phase still waits after so long."""
    waits = lambda trial: replace(in_phase(phase, job=trial.job), since_s=NOW)  # noqa: E731
    return lambda trial: step(waits(trial), Tick(), NOW + seconds)[0].phase is phase


def holds(permissive: p.Evaluate, **changes: Any) -> Look:
    """Whether a permissive holds in this state."""
    return lambda trial: permissive(replace(trial.state, **changes), NOW).holds


def holds_with(*off_mm: float) -> Look:
    """Whether check points that are so far off are good enough."""

    def look(trial: Trial) -> bool:
        points = tuple(PointResidual(str(number), residual) for number, residual in enumerate(off_mm))
        return p.check_points(altered(trial.state, "job.check_points.points", points), NOW).holds

    return look


def off_start(joint: int, by: float) -> tuple[int, ...]:
    """The start joints with one of them so many mm or deg off."""
    return tuple(u + round(by * records.UNIT) * (j == joint) for j, u in enumerate(START_JOINTS))


def followed(joint: int, by: float) -> Look:
    """Whether an arm that is so many mm or deg off where it begins may go on."""

    def look(trial: Trial) -> bool:
        monitor = TrackingMonitor.begin(TRAJECTORY, trial.job.timing, trial.job.tracking, 1.0, NOW)
        joints = records.joints_to_memory(off_start(joint, by))
        return monitor.sample(joints, NOW, NOW)[1] is None

    return look


def opened(trial: Trial) -> Any:
    """The session that a controller makes of the OPEN it is sent."""
    _, effects = step(
        replace(FRESH, job=replace(trial.job, serial=None)), Announced(ANNOUNCE, RUNTIME_NONCE), NOW
    )
    (request,) = (record for record in sent(effects) if isinstance(record, records.Open))
    held = Holdings(trial.job.limits, trial.job.calibration, trial.job.tool)
    controller = Controller.powered_up(Identity("SIM-1", ""), held, Memory(), ANNOUNCE.announce_nonce)
    named = replace(request, identity_digest=announcement(controller).identity_digest)
    asked = OpenReceived(named, 1, authentic=True, fresh=bytes(16))
    return controller_table.step(controller, asked, NOW)[0].session


def heartbeats(trial: Trial) -> int:
    """How many leave in two seconds of a session, in tens."""
    job = replace(trial.job, simulation_allowed_by="test")
    with pair_of(trial.folder, trial.files, job) as pair:
        pair.to(Phase.COLLECTING)
        before = len(pair.wire.seen)
        pair.run(2.0)
        return round(sum(seen.can_id == of(RuntimeHeartbeat) for seen in pair.wire.seen[before:]) / 10)


def reads_much(trial: Trial) -> bool:
    """Whether a plan of more than a megabyte is read; most of it is nothing."""
    plan = trial.folder / "plan.csv"
    header, *rows = plan.read_text(encoding="ascii").splitlines()
    plan.write_text("\n".join((header, " " * 1_000_000 + rows[0], *rows[1:])), encoding="ascii")
    return trial.reads()


ROWS: dict[str, tuple[tuple[str, Any], tuple[str, Any], Look]] = {
    # setting: a value and what is seen then, another value and what is seen then, where it is seen
    "schema": (('"cutgate.site/1"', True), ('"cutgate.site/2"', False), Trial.reads),
    "bus.interface": (('"a"\nchannel = "x"', "a"), ('"b"\nchannel = "x"', "b"), lambda t: t.run().bus["interface"]),
    "bus.channel": (('"a"\ninterface = "i"', "a"), ('"b"\ninterface = "i"', "b"), lambda t: t.run().bus["channel"]),
    "bus.bitrate_bit_s": (("250_000", 250_000), ("500_000", 500_000), lambda t: t.run().bus["bitrate_bit_s"]),
    "bus.fd": (("true", True), ("false", False), lambda t: t.run().bus["fd"]),
    "timing.heartbeat_ms": (("10", 20), ("20", 10), heartbeats),
    "timing.timeout_ms": (("100", False), ("200", True), holds(p.joints_age, measured_s=NOW - 0.15)),
    "timing.transfer_timeout_s": (("5", False), ("50", True), still(Phase.UPLOADING, 20.0)),
    "timing.reply_timeout_ms": (("500", False), ("5000", True), still(Phase.OPENING, 2.0)),
    "timing.announce_wait_s": (("5", False), ("50", True), still(Phase.WAITING, 20.0)),
    "timing.verify_timeout_s": (("5", False), ("50", True), still(Phase.VERIFYING, 20.0)),
    "timing.operator_wait_s": (("5", False), ("50", True), still(Phase.HELD, 20.0)),
    "timing.stop_confirm_ms": (("500", False), ("5000", True), still(Phase.STOPPING, 2.0)),
    "permit.permit_lifetime_s": (("10", False), ("50", True), still(Phase.PERMITTED, 20.0)),
    "start.start_lifetime_ms": (("1000", 1.0), ("3000", 3.0), lambda t: opened(t).start_lifetime_s),
    "start.start_tolerance_mm": (("0.2", False), ("0.5", True), holds(p.start_distance, joints_u=off_start(2, 0.3))),
    "start.start_tolerance_deg": (("0.1", False), ("0.5", True), holds(p.start_angle, joints_u=off_start(3, 0.3))),
    "approach.approach_clearance_mm": (("5", 5_000), ("15", 15_000), lambda t: t.answer().verdict.approach.exit_um),
    "approach.approach_speed_percent": (("20", 20), ("40", 40), lambda t: t.answer().verdict.approach.speed_percent),
    "tracking.tracking_tolerance_mm": (("0.2", False), ("2.0", True), followed(2, 1.2)),
    "tracking.tracking_tolerance_deg": (("0.2", False), ("1.5", True), followed(3, 0.9)),
    "log.directory": (('"here"', "here"), ('"there"', "there"), lambda t: t.run().log["directory"]),
    "log.key_file": (('"a.key"', Path("a.key")), ('"b.key"', Path("b.key")), lambda t: t.run().log["key_file"]),
    "log.commit_deadline_ms": (("500", False), ("5000", True), still(Phase.AUTHORISING_PERMIT, 2.0)),
    "log.checkpoint_deadline_ms": (("2000", 2.0), ("9000", 9.0), lambda t: t.run().session["checkpoint_deadline_s"]),
    "log.chunk_period_ms": (("200", 0.2), ("900", 0.9), lambda t: t.run().log["chunk_period_s"]),
    "files.file_size_limit_mb": (("1", False), ("2", True), reads_much),
    "files.pose_limit": (("5", False), ("6", True), Trial.reads),
    "controller.serial": (('"SIM-1"', True), ('"SIM-2"', False), holds(p.serial_number)),
    "controller.simulated": (
        ("true", True),
        ("false", False),
        holds(p.plant_speed, session=replace(READY.session, time_scale=50.0)),
    ),
    "key_file": (('"a.key"', "a.key"), ('"b.key"', "b.key"), lambda t: t.run().key),
    "registration_max_age_s": (("60", False), ("31_536_000", True), holds(p.registration_age)),
    "registration_max_residual_mm": (("0.1", False), ("1", True), holds(p.registration_residual)),
    "check_point_tolerance_mm": (("0.3", False), ("0.5", True), holds_with(0.4)),
    "check_points_min": (("2", False), ("1", True), holds_with(0.4)),
    "clock_skew_s": (("0", 0.0), ("90.5", 90.5), lambda t: t.run().skew_s),
}  # fmt: skip


def settings_of(model: type[BaseModel], place: str = "") -> Iterator[str]:
    """Every setting there is."""
    for name, field in model.model_fields.items():
        key = f"{place}{field.alias or name}"
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from settings_of(inner, f"{key}.")
        else:
            yield key


def test_every_setting_has_a_row():
    assert sorted(ROWS) == sorted(settings_of(Site))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[InputFiles, Path]:
    """What a session needs besides its site; the plan has six poses."""
    files, _ = job_of(tmp_path_factory)
    folder = tmp_path_factory.mktemp("settings")
    registration = files.prepared.registration
    assert registration is not None
    (folder / "plan.csv").write_bytes(files.prepared.plan.data)
    (folder / "robot.toml").write_bytes(files.robot.data)
    (folder / "registration.json").write_bytes(registration.data)
    return files, folder


@pytest.mark.parametrize("setting", ROWS)
def test_a_setting_that_is_changed_changes_what_is_done(setting, inputs, tmp_path, monkeypatch):
    files, folder = inputs
    *values, look = ROWS[setting]
    for number, (value, seen) in enumerate(values):
        (tmp_path / str(number)).mkdir()
        for source in folder.iterdir():
            (tmp_path / str(number) / source.name).write_bytes(source.read_bytes())
        assert look(Trial(setting, value, files, tmp_path / str(number), monkeypatch)) == seen
