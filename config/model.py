"""What a site's configuration files hold: the robot (``robot.toml``) and the site (``site.toml``).

Fields, units and frames: ``docs/files.md``. Every value is bounded, unknown keys are refused, nothing is
converted silently, and non-finite numbers do not exist here.
"""

from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from cutgate.config.constants import (
    CLOCK_SKEW_MAX_S,
    CONSTANTS,
    EARLIER_TIMEOUT_HEARTBEATS,
    TIMEOUT_HEARTBEATS,
)
from cutgate.protocol.parameters import LENGTH_MM_MAX, ROTATION_DEG_MAX, SLIDE_MM_MAX, SLIDE_TILT_MRAD_MAX

FOLD_DEG: Final = 180.0

WRIST_DEG_MIN: Final = 0.001
"""A thousand counts of a reported joint: below, no controller tells a kept deadband from a missed one."""

RECORDED: Final = "recorded"
"""Validation context of a site that stands in a log: what its version allowed is read."""

REMOVED: Final = MappingProxyType(
    {
        "link.counter_step": "0.2.0",
        "link.crc_failures": "0.2.0",
        "link.crc_window_ms": "0.2.0",
        "timing.announce_ms": "0.2.0",
    }
)
"""Settings of ``site.toml`` that older versions read, none of which ever had an effect, with the version without them."""

Real = Annotated[float, Strict(), AllowInfNan(False)]
Integer = Annotated[int, Strict()]
Boolean = Annotated[bool, Strict()]
Text = Annotated[str, Strict(), Field(min_length=1, max_length=200)]
Name = Annotated[str, Strict(), Field(min_length=1, max_length=64, pattern=r"^[ -~]+$")]


RULE: Final = "rule"
"""Type of the errors that this program's own validators raise."""


def broken(bound: str, remedy: str, *, key: str = "", found: object = None) -> PydanticCustomError:
    """The error of a rule over several fields; ``cutgate.config.load`` turns it into the user's line.

    Args:
        bound: what must hold, to be read after "must be".
        remedy: what to do.
        key: dotted key, where the rule is about more than the validated field itself.
        found: the offending value, where it is not the validated field itself.
    """
    return PydanticCustomError(
        RULE, "{bound}", {"bound": bound, "remedy": remedy, "key": key, "found": found}
    )


class Strictly(BaseModel):
    """Frozen, and refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Length = Annotated[Real, Field(gt=0, le=LENGTH_MM_MAX)]
LinkError = Annotated[Real, Field(ge=-100, le=100)]
Speed = Annotated[Real, Field(gt=0, le=1e6)]


class ArmSettings(Strictly):
    """Link lengths: ``upper_link_mm`` a0 (shoulder to elbow), ``forearm_link_mm`` a1 (elbow to wrist)."""

    upper_link_mm: Length
    forearm_link_mm: Length


class MountedTool(Strictly):
    """The mounted tool: ``length_mm`` from the wrist centre to the cutter's tip."""

    length_mm: Annotated[Real, Field(ge=0, le=2_000)]


Angle = Annotated[Real, Field(ge=-ROTATION_DEG_MAX, le=ROTATION_DEG_MAX)]
Angles = tuple[Angle, Angle]
Fold = Annotated[Real, Field(ge=-FOLD_DEG, le=FOLD_DEG)]
Folds = tuple[Fold, Fold]
Pitch = Annotated[Real, Field(ge=0, le=FOLD_DEG)]
Pitches = tuple[Pitch, Pitch]
Height = Annotated[Real, Field(ge=-SLIDE_MM_MAX, le=SLIDE_MM_MAX)]
Heights = tuple[Height, Height]


class JointLimits(Strictly):
    """Position limits (lower, upper) and speed limits of joints 0 to 4.

    Rotary joints in degrees, the slide in mm; speeds in rad/s and mm/s, accelerations in rad/s2 and mm/s2.
    """

    q0_deg: Angles
    q1_deg: Folds
    q2_mm: Heights
    q3_deg: Angles
    q4_deg: Pitches
    speed: tuple[Speed, Speed, Speed, Speed, Speed]
    acceleration: tuple[Speed, Speed, Speed, Speed, Speed] | None = None

    @field_validator("q0_deg", "q1_deg", "q2_mm", "q3_deg", "q4_deg")
    @classmethod
    def _ordered(cls, pair: tuple[float, float]) -> tuple[float, float]:
        if not (pair[0] < pair[1]):
            raise broken("[lower, upper] with lower < upper", "write the smaller limit first")
        return pair


class CalibrationErrors(Strictly):
    """What calibration found: true = nominal + error (links), true = reported + offset (joints).

    ``joint_offset_deg`` has the slide's entry in mm; ``slide_tilt_mrad`` leans toward +x and +y.
    The residuals are what calibration left unexplained; they widen the deadbands.
    """

    upper_link_error_mm: LinkError = 0.0
    forearm_link_error_mm: LinkError = 0.0
    joint_offset_deg: tuple[
        Annotated[Real, Field(ge=-180, le=180)],
        Annotated[Real, Field(ge=-180, le=180)],
        Annotated[Real, Field(ge=-1000, le=1000)],
        Annotated[Real, Field(ge=-180, le=180)],
        Annotated[Real, Field(ge=-180, le=180)],
    ] = (0.0, 0.0, 0.0, 0.0, 0.0)
    slide_tilt_mrad: tuple[
        Annotated[Real, Field(ge=-SLIDE_TILT_MRAD_MAX, le=SLIDE_TILT_MRAD_MAX)],
        Annotated[Real, Field(ge=-SLIDE_TILT_MRAD_MAX, le=SLIDE_TILT_MRAD_MAX)],
    ] = (
        0.0,
        0.0,
    )
    residual_mm: Annotated[Real, Field(ge=0, le=100)] = 0.0
    residual_deg: Annotated[Real, Field(ge=0, le=45)] = 0.0


class Wrist(Strictly):
    """What the wrist does while the tool is exactly vertical."""

    hold_roll_when_vertical: Annotated[bool, Strict()] = False
    hold_roll_deg: Annotated[Real, Field(ge=-ROTATION_DEG_MAX, le=ROTATION_DEG_MAX)] = 0.0


class DeadbandSettings(Strictly):
    """How far every boundary is kept away from; the path tolerances widen it."""

    arm_mm: Annotated[Real, Field(gt=0, le=1000)]
    wrist_deg: Annotated[Real, Field(ge=WRIST_DEG_MIN, le=90)]
    path_tolerance_mm: Annotated[Real, Field(ge=0, le=100)] = 0.0
    path_tolerance_deg: Annotated[Real, Field(ge=0, le=45)] = 0.0


class Robot(Strictly):
    """``robot.toml``: geometry, limits and deadband of one robot, as the site approved them."""

    schema_: Annotated[Literal["cutgate.robot/1"], Field(alias="schema")] = "cutgate.robot/1"
    name: Text
    elbow: Literal["right", "left"]
    arm: ArmSettings
    tool: MountedTool
    limits: JointLimits
    calibration: CalibrationErrors = CalibrationErrors()
    wrist: Wrist = Wrist()
    deadband: DeadbandSettings

    @model_validator(mode="after")
    def _elbow_agrees(self) -> Self:
        low, high = self.limits.q1_deg
        if not (low >= 0 if self.elbow == "right" else high <= 0):
            bound = f"{'>= 0' if self.elbow == 'right' else '<= 0'} throughout for the {self.elbow} elbow"
            raise broken(bound, "change elbow or the limits", key="limits.q1_deg", found=[low, high])
        return self

    @model_validator(mode="after")
    def _links_stay_positive(self) -> Self:
        pairs = {
            "upper_link": (self.arm.upper_link_mm, self.calibration.upper_link_error_mm),
            "forearm_link": (self.arm.forearm_link_mm, self.calibration.forearm_link_error_mm),
        }
        for name, (nominal, error) in pairs.items():
            if not (nominal + error > 0):
                raise broken(
                    f"longer than 0 mm together with calibration.{name}_error_mm",
                    "correct one of the two",
                    key=f"arm.{name}_mm",
                    found=f"{nominal} + {error}",
                )
        return self


def _constant(name: str, *, step: float | None = None) -> Any:
    """The field of a constant: its default, bounds, unit and meaning from the one table."""
    constant = CONSTANTS[name]
    whole = all(float(value).is_integer() for value in (constant.default, constant.low, constant.high))
    default = int(constant.default) if whole else constant.default
    return _setting(default, constant.meaning, constant.unit, step, ge=constant.low, le=constant.high)


def _setting(
    default: Any,
    effect: str,
    unit: str = "",
    step: float | None = None,
    *,
    ge: float | None = None,
    le: float | None = None,
) -> Any:
    """The field of a setting, with what ``cutgate.config.settings`` tells of it: effect, unit, and step if it has one."""
    about: dict[str, Any] = {"unit": unit, "step": step}
    return Field(default=default, description=effect, json_schema_extra=about, ge=ge, le=le)


WIRE_STEP: Final = 0.001
"""Of tolerances that OPEN carries."""


def _on_the_wire(value: float, info: ValidationInfo) -> float:
    """A tolerance that OPEN carries in thousandths: one that is finer would be another on the other side."""
    if info.context != RECORDED and round(value * 1000) / 1000 != value:
        raise broken(
            "a whole number of thousandths, as the bus carries it", "leave out the digits after them"
        )
    return value


Exchanged = Annotated[Real, AfterValidator(_on_the_wire)]


class BusSettings(Strictly):
    """Which bus: a python-can interface and channel; ``None`` leaves the choice to the program."""

    interface: Name | None = _setting(
        None, "python-can's name; not set: vcan0 where the kernel has it, else the local virtual bus"
    )
    channel: Name | None = _setting(None, "which channel of the interface")
    bitrate_bit_s: Integer = _setting(
        1_000_000,
        "of an interface that python-can sets up; the kernel's are set with ip link",
        "bit/s",
        ge=10_000,
        le=1_000_000,
    )
    fd: Boolean = _setting(False, "bulk records in CAN FD frames; the controller must be set to the same")


class TimingSettings(Strictly):
    """Periods and time-outs; see ``cutgate.config.constants``."""

    heartbeat_ms: Integer = _constant("heartbeat_ms")
    timeout_ms: Integer = _constant("timeout_ms")
    transfer_timeout_s: Integer = _constant("transfer_timeout_s")
    reply_timeout_ms: Integer = _constant("reply_timeout_ms")
    announce_wait_s: Integer = _constant("announce_wait_s")
    verify_timeout_s: Integer = _constant("verify_timeout_s")
    operator_wait_s: Integer = _constant("operator_wait_s")
    stop_confirm_ms: Integer = _constant("stop_confirm_ms")

    @model_validator(mode="after")
    def _enough_heartbeats(self, info: ValidationInfo) -> Self:
        """A site that a log of an older version holds had to keep the protocol's rule alone."""
        least = EARLIER_TIMEOUT_HEARTBEATS if info.context == RECORDED else TIMEOUT_HEARTBEATS
        if not (self.timeout_ms >= least * self.heartbeat_ms):
            raise broken(
                f">= {least} heartbeats of {self.heartbeat_ms} ms",
                "raise it or shorten heartbeat_ms",
                key="timing.timeout_ms",
                found=self.timeout_ms,
            )
        return self


class PermitSettings(Strictly):
    """The permit's lifetime."""

    permit_lifetime_s: Integer = _constant("permit_lifetime_s")


class StartSettings(Strictly):
    """The start's lifetime and how near to the bound start joints the arm must stand."""

    start_lifetime_ms: Integer = _constant("start_lifetime_ms")
    start_tolerance_mm: Exchanged = _constant("start_tolerance_mm", step=WIRE_STEP)
    start_tolerance_deg: Exchanged = _constant("start_tolerance_deg", step=WIRE_STEP)


class ApproachSettings(Strictly):
    """The way from where the arm stands to the path's first pose, and back from its last."""

    approach_clearance_mm: Exchanged = _constant("approach_clearance_mm", step=WIRE_STEP)
    approach_speed_percent: Integer = _constant("approach_speed_percent")


class TrackingSettings(Strictly):
    """How far the moving arm may be off the verified path."""

    tracking_tolerance_mm: Real = _constant("tracking_tolerance_mm")
    tracking_tolerance_deg: Real = _constant("tracking_tolerance_deg")


class LogSettings(Strictly):
    """Where session logs go and how late their records may be durable."""

    directory: Text = _setting("cutgate-logs", "where the logs of sessions go")
    key_file: Text | None = _setting(
        None,
        "the key that signs the logs of this directory, where --log-key names none; not set: the user's state directory",
    )
    commit_deadline_ms: Integer = _constant("commit_deadline_ms")
    checkpoint_deadline_ms: Integer = _constant("checkpoint_deadline_ms")
    chunk_period_ms: Integer = _constant("chunk_period_ms")


class FilesSettings(Strictly):
    """How large input files may be."""

    file_size_limit_mb: Integer = _constant("file_size_limit_mb")
    pose_limit: Integer = _constant("pose_limit")


class ExpectedController(Strictly):
    """The controller this site expects; without ``serial`` any."""

    serial: Name | None = _setting(None, "the controller's serial number; not set: any controller will do")
    simulated: Boolean = _setting(
        False,
        "the controller may be a simulation, whose plant runs at another speed than the clock; "
        "never where there is a robot or a bone",
    )


class Site(Strictly):
    """``site.toml``: bus, timing, lifetimes, log directory. ``Site()`` is the default site."""

    schema_: Annotated[Literal["cutgate.site/1"], Field(alias="schema")] = "cutgate.site/1"
    bus: BusSettings = BusSettings()
    timing: TimingSettings = TimingSettings()
    permit: PermitSettings = PermitSettings()
    start: StartSettings = StartSettings()
    approach: ApproachSettings = ApproachSettings()
    tracking: TrackingSettings = TrackingSettings()
    log: LogSettings = LogSettings()
    files: FilesSettings = FilesSettings()
    controller: ExpectedController = ExpectedController()
    key_file: Text | None = _setting(None, "the pre-shared key's file, where --key names none")
    registration_max_age_s: Annotated[Real, Field(gt=0, le=31_536_000)] | None = _setting(
        None, "an older registration is not permitted; not set: age does not matter", "s"
    )
    registration_max_residual_mm: Annotated[Real, Field(gt=0, le=100)] | None = _setting(
        None, "a registration with a larger residual is not permitted; not set: it is only shown", "mm"
    )
    check_point_tolerance_mm: Real = _constant("check_point_tolerance_mm")
    check_points_min: Integer = _constant("check_points_min")
    clock_skew_s: Real = _setting(
        60.0,
        "how far apart the clocks may be of who registers and of this computer: so long after a withdrawal no "
        "registration counts yet, so far ahead one may lie",
        "s",
        ge=0,
        le=CLOCK_SKEW_MAX_S,
    )

    def constants(self, *, exchanged_only: bool = False) -> dict[str, float]:
        """The value of every constant, or of those sent in OPEN, by name, in the table's order."""
        tables = (
            self.timing,
            self.permit,
            self.start,
            self.approach,
            self.tracking,
            self.log,
            self.files,
        )
        values = {name: value for table in tables for name, value in table.model_dump().items()}
        values |= self.model_dump(include={"check_point_tolerance_mm", "check_points_min"})
        return {name: values[name] for name, c in CONSTANTS.items() if c.exchanged or not exchanged_only}
