"""The contract's ``verify --json`` document, written from the contract alone: an oracle for the tests."""

from typing import Annotated, Literal

from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, model_validator

Real = Annotated[float, AllowInfNan(False)]
Vector = tuple[Real, Real, Real]
Hex = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Literal[
    "inner", "outer", "left", "right", "top", "bottom",
    "roll_min", "roll_max", "pitch_min", "pitch_max", "wrist_singularity",
]  # fmt: skip


class Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class PathPart(Part):
    poses: Annotated[int, Field(ge=2)]
    tip_length_mm: Annotated[Real, Field(ge=0)]
    wrist_length_mm: Annotated[Real, Field(ge=0)]
    axis_angle_deg: Annotated[Real, Field(ge=0)]


class DeadbandPart(Part):
    arm_mm: Annotated[Real, Field(gt=0)]
    wrist_deg: Annotated[Real, Field(gt=0)]


class BranchPart(Part):
    elbow: Literal["right", "left"]
    q0_turns: int
    roll_turns: int


class EvaluationsPart(Part):
    arm: Annotated[int, Field(ge=0)]
    wrist: Annotated[int, Field(ge=0)]
    worst_case: Annotated[int, Field(ge=0)]
    best_case: Annotated[int, Field(ge=1)] | None = None  # added to the contract's document


class BoundaryPart(Part):
    unit: Literal["mm", "deg"]
    clearance: Real | None
    certified: Real | None
    segment: int | None
    fraction: Annotated[Real, Field(ge=0, le=1)] | None
    tip_length_mm: Annotated[Real, Field(ge=0)] | None
    tip_mm: Vector | None = None  # of verify --json
    line: Annotated[int, Field(ge=1)] | None = None  # of a tool path's file
    violated: bool


class WarningPart(Part):
    code: Annotated[str, Field(pattern=r"^[A-Z_]+$")]
    text: Annotated[str, Field(min_length=1)]
    value: Real
    bound: Real
    confirm: bool


class ExtentPart(Part):
    min_mm: Vector
    max_mm: Vector
    entry_tip_mm: Vector
    tilt_deg: tuple[Real, Real]


class SpeedPart(Part):
    joint: Annotated[int, Field(ge=0, le=4)]
    limit: Annotated[Real, Field(gt=0)]
    peak: Annotated[Real, Field(ge=0)] | None
    segment: int | None
    ok: bool


class MovePart(Part):
    boundary: Name
    kind: Literal["move", "turn"]
    direction: Vector
    distance_mm: Real | None = None
    angle_deg: Real | None = None

    @model_validator(mode="after")
    def _one_amount(self):
        given = self.model_fields_set & {"distance_mm", "angle_deg"}
        assert given == {"distance_mm" if self.kind == "move" else "angle_deg"}
        return self


class GuidancePart(Part):
    translation_mm: Vector | None
    yaw_deg: Real
    pivot_mm: Vector
    moves: list[MovePart]
    predicted_clearance_mm: Real | None
    verified: bool
    none_possible: bool = False
    at_least_mm: Annotated[Real, Field(ge=0)] = 0.0
    reserve_mm: Annotated[Real, Field(ge=0)] = 0.0
    reserve_deg: Annotated[Real, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _a_bound_comes_with_its_reserves(self):
        together = {"at_least_mm", "reserve_mm", "reserve_deg"}
        assert self.model_fields_set & together in (set(), together)
        return self


class OtherElbowPart(Part):
    elbow: Literal["right", "left"]
    q1_deg: tuple[Real, Real]
    admissible: bool | None
    text: Annotated[str, Field(min_length=1)]


class TravelledPart(Part):
    segments: Annotated[int, Field(ge=0)]
    tip_length_mm: Annotated[Real, Field(ge=0)]
    wrist_length_mm: Annotated[Real, Field(ge=0)]


class ToolPathPart(Part):
    tool: str
    lines: tuple[int, int]
    cutting: TravelledPart
    positioning: TravelledPart
    feeds_mm_s: tuple[Real, Real] | None
    tolerance_mm: Annotated[Real, Field(ge=0)]
    tolerance_deg: Annotated[Real, Field(ge=0)]


class DigestsPart(Part):
    path: Hex
    limits: Hex
    calibration: Hex
    registration: Hex


class VerdictDocument(Part):
    schema_: Annotated[Literal["cutgate.verdict/1"], Field(alias="schema")]
    verdict: Literal["admissible", "inadmissible"]
    method: Literal["certified", "stocco"]
    path: PathPart
    deadband: DeadbandPart
    branch: BranchPart | None
    evaluations: EvaluationsPart
    boundaries: dict[Name, BoundaryPart]
    speed: list[SpeedPart]
    acceleration: list[SpeedPart]  # beside the contract's keys; empty where no limits are given
    other_elbow: OtherElbowPart | None = None  # absent in what 0.1.0 wrote
    guidance: GuidancePart | None
    guidance_note: Annotated[str, Field(min_length=1)] | None = None
    digests: DigestsPart
    elapsed_ms: Annotated[Real, Field(ge=0)]

    @model_validator(mode="after")
    def _a_note_stands_in_place_of_guidance(self):
        assert self.guidance is None or self.guidance_note is None
        return self


class RegistrationErrorPart(Part):
    ball_mm: float
    yaw_deg: float
    both_ball_mm: float
    both_yaw_deg: float
    pivot_mm: tuple[float, float, float]


class CheckPointPart(Part):
    id: Annotated[str, Field(min_length=1)]
    residual_mm: Annotated[Real, Field(ge=0)]


class VerifyDocument(VerdictDocument):
    """What ``verify --json`` prints: the verdict, where it lies, and what error of the registration it tolerates."""

    warnings: list[WarningPart]
    extent: ExtentPart
    check_points: list[CheckPointPart]
    registration_error: RegistrationErrorPart | None
    tool_path: ToolPathPart | None = None  # of a plan there is none

    @model_validator(mode="after")
    def _each_worst_place_has_its_tip(self):
        for boundary in self.boundaries.values():
            assert (boundary.tip_mm is None) is (boundary.segment is None)
        return self
