"""From files to a job: everything that is read, parsed and digested before the session opens."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cutgate import __version__
from cutgate.config.load import BYTES_PER_MB, Loaded, load_robot, load_site
from cutgate.config.model import Robot, Site
from cutgate.config.records import calibration_record, limits_record, timing_record, tool_record
from cutgate.protocol import records
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.audit.configuration import ALLOW_SIMULATED, configuration_digest
from cutgate.runtime.interlock.state import Deadlines, Job
from cutgate.runtime.interlock.tracking import TrackingTolerance
from cutgate.runtime.kinematics.landmarks import CheckPoints
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import Prepared, prepare, with_branch
from cutgate.runtime.plan.registration import Registration, checked
from cutgate.runtime.plan.registrations.declared import NOTHING, Declared
from cutgate.runtime.plan.toolpath.model import PLAIN, Reading
from cutgate.runtime.verification.asked import BEST, AskedTurns, in_branch
from cutgate.runtime.verification.decide import decide
from cutgate.runtime.verification.plausibility import Placed
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import problem_from_records

VERIFIER = f"cutgate {__version__}"
"""Named in every record 0 and every permit; at most 16 characters."""


@dataclass(frozen=True)
class InputFiles:
    """What was read, each file once; parsing, digests and attachments use the same bytes."""

    robot: Loaded[Robot]
    site: Loaded[Site] | None
    prepared: Prepared
    reading: Reading = PLAIN
    """What was declared of a tool path."""
    allow_simulated: bool = False
    """The option of the command line; the site's own word stands in its settings."""

    @property
    def simulation_allowed_by(self) -> str:
        """Who said that the controller may be a simulation; empty where nobody did."""
        allowed_by = {ALLOW_SIMULATED: self.allow_simulated, "site.toml": self.settings.controller.simulated}
        return " and ".join(name for name, allowed in allowed_by.items() if allowed)

    @property
    def registration(self) -> Registration | None:
        """What the registration file says; None for a path in robot coordinates."""
        return None if self.prepared.registration is None else self.prepared.registration.value

    @property
    def placed(self) -> Placed | None:
        """How the bone was registered, and what the site allows of it."""
        registration = self.registration
        if registration is None:
            return None
        return Placed(
            registration.matrix,
            registration.residual_rms_mm,
            self.settings.registration_max_residual_mm,
            self.check_points,
        )

    @property
    def check_points(self) -> CheckPoints:
        """How far each check point of the registration is off, and what the site asks of them."""
        return checked(self.registration, self.settings)

    @property
    def settings(self) -> Site:
        """The site's settings, or the defaults."""
        return self.site.value if self.site else Site()


def read_files(
    plan: Path,
    robot: Path,
    registration: Path,
    site: Path | None,
    feed_mm_s: float | None,
    *,
    reading: Reading = PLAIN,
    allow_simulated: bool = False,
    declared: Declared = NOTHING,
) -> InputFiles:
    """Read and check every input file.

    Raises:
        InputError: anything about a file is not as it must be.
    """
    arm = load_robot(robot)
    settings = load_site(site) if site else None
    placed = load_registration(registration, declared)
    chosen = settings.value if settings else Site()
    size_limit = chosen.files.file_size_limit_mb * BYTES_PER_MB
    limit = chosen.files.pose_limit
    wanted = load_plan(plan, size_limit=size_limit, pose_limit=limit, reading=reading)
    prepared = prepare(
        wanted,
        placed,
        arm.value,
        now=datetime.now(UTC),
        clock_skew_s=chosen.clock_skew_s,
        feed_mm_s=feed_mm_s,
    )
    return InputFiles(arm, settings, prepared, reading, allow_simulated)


def make_job(files: InputFiles, *, now: datetime, asked: AskedTurns = BEST, key_fingerprint: str = "") -> Job:
    """The job of these files: approved records, the path on its joint branch, digests and deadlines.

    Args:
        files: what was read.
        now: aware.
        asked: the turns of the joint branch, where not the best are to be taken.
        key_fingerprint: of the key, for people.

    Raises:
        InputError: the path does not fit in the turns asked for.
    """
    robot, settings = files.prepared.robot, files.settings
    limits, calibration = limits_record(robot).body(), calibration_record(robot).body()
    tool = tool_record(robot).body()
    path = files.prepared.path
    problem = problem_from_records(path.body(), limits, calibration, tool, robot, any_branch=True)
    path = _on_branch(path, problem, asked)
    registration = files.registration
    # one that lies ahead was made by a clock that does: it is of now
    age_s = max(0.0, (now - registration.created).total_seconds()) if registration else 0.0
    return Job(
        limits=limits,
        calibration=calibration,
        tool=tool,
        path=path.body(),
        registration=files.prepared.registration_digest,
        configuration=configuration(files),
        verifier=VERIFIER,
        branch=records.Branch(path.elbow, path.q0_turns, path.roll_turns),
        timing=timing_record(settings),
        deadlines=_deadlines(settings),
        tracking=TrackingTolerance(
            settings.tracking.tracking_tolerance_mm, settings.tracking.tracking_tolerance_deg
        ),
        serial=settings.controller.serial,
        place=registration.place if registration else records.NO_PLACE,
        registration_time_us=since_1970_us(registration.created) if registration else records.NO_TIME,
        registration_age_s=age_s,
        prepared_us=since_1970_us(now),
        registration_max_age_s=settings.registration_max_age_s,
        registration_residual_mm=registration.residual_rms_mm if registration else None,
        registration_max_residual_mm=settings.registration_max_residual_mm,
        check_points=files.check_points,
        simulation_allowed_by=files.simulation_allowed_by,
        key_fingerprint=key_fingerprint,
    )


def _on_branch(path: records.Path, problem: Problem, asked: AskedTurns) -> records.Path:
    """The branch asked for, else that with the largest worst margin; where none is feasible (0, 0), refused later."""
    chosen = in_branch(problem, asked).branch
    if chosen is None:
        chosen = decide(problem).branch
    return with_branch(path, *chosen) if chosen else path


def configuration(files: InputFiles) -> bytes:
    """The digest that a permit binds of the site's files and options."""
    site = files.site.sha256 if files.site else None
    return configuration_digest(files.robot.sha256, site, allow_simulated=files.allow_simulated)


def _deadlines(site: Site) -> Deadlines:
    timing = site.timing
    return Deadlines(
        announce_wait_s=float(timing.announce_wait_s),
        reply_timeout_s=timing.reply_timeout_ms / 1000,
        transfer_timeout_s=float(timing.transfer_timeout_s),
        verify_timeout_s=float(timing.verify_timeout_s),
        operator_wait_s=float(timing.operator_wait_s),
        commit_deadline_s=site.log.commit_deadline_ms / 1000,
        stop_confirm_s=timing.stop_confirm_ms / 1000,
    )


def utc_now() -> datetime:
    """The time of day, aware."""
    return datetime.now(UTC)
