"""Messages that viewers of the Foxglove family draw by themselves, field by field as Foxglove publishes them; and plain numbers.

The schemas are those of ``@foxglove/schemas`` 2.1.0 (MIT). A test holds each model against the published schema. Every
field is always written: some viewers do not know what an absent one means. Lengths are in metres, angles in quaternions.
"""

import json
from enum import IntEnum
from typing import Final

from pydantic import ConfigDict

from cutgate.runtime.audit.records import Entry, LoopTiming, Time, TrackingSample
from cutgate.runtime.audit.schema import schema_bytes

PREFIX: Final = "Foxglove"


def _title_of(model: type) -> str:
    """What a model is called in the file."""
    return model.__name__.removeprefix(PREFIX)


class FoxgloveEntry(Entry):
    """A message, or part of one."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, strict=True, model_title_generator=_title_of
    )


class FoxgloveVector3(FoxgloveEntry):
    """A direction, a size, or a translation."""

    x: float
    y: float
    z: float


class FoxglovePoint3(FoxgloveEntry):
    """A place, m."""

    x: float
    y: float
    z: float


class FoxgloveQuaternion(FoxgloveEntry):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float


class FoxglovePose(FoxgloveEntry):
    """Place and orientation in a frame."""

    position: FoxgloveVector3
    orientation: FoxgloveQuaternion


class FoxgloveColor(FoxgloveEntry):
    """Red, green, blue and opacity, 0 to 1."""

    r: float
    g: float
    b: float
    a: float


class FoxgloveKeyValuePair(FoxgloveEntry):
    """What a viewer shows of a thing that is pointed at."""

    key: str
    value: str


class FoxgloveDeletionType(IntEnum):
    """What a deletion takes away."""

    MATCHING_ID = 0
    ALL = 1


class FoxgloveSceneEntityDeletion(FoxgloveEntry):
    """Takes things away that were sent before."""

    timestamp: Time
    type: FoxgloveDeletionType
    id: str


class FoxgloveArrow(FoxgloveEntry):
    """Not used, but every field of an entity is written."""

    pose: FoxglovePose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: FoxgloveColor


class FoxgloveCube(FoxgloveEntry):
    """Not used, as above."""

    pose: FoxglovePose
    size: FoxgloveVector3
    color: FoxgloveColor


class FoxgloveSphere(FoxgloveEntry):
    """A ball at the pose's place."""

    pose: FoxglovePose
    size: FoxgloveVector3
    color: FoxgloveColor


class FoxgloveCylinder(FoxgloveEntry):
    """A cylinder about the pose's z axis, its middle at the pose."""

    pose: FoxglovePose
    size: FoxgloveVector3
    bottom_scale: float
    top_scale: float
    color: FoxgloveColor


class FoxgloveLineType(IntEnum):
    """How points become lines."""

    LINE_STRIP = 0
    LINE_LOOP = 1
    LINE_LIST = 2


class FoxgloveLine(FoxgloveEntry):
    """Lines between points; of a list each two indices are one."""

    type: FoxgloveLineType
    pose: FoxglovePose
    thickness: float
    scale_invariant: bool
    points: tuple[FoxglovePoint3, ...]
    color: FoxgloveColor
    colors: tuple[FoxgloveColor, ...]
    indices: tuple[int, ...]


class FoxgloveTriangles(FoxgloveEntry):
    """Not used, as above."""

    pose: FoxglovePose
    points: tuple[FoxglovePoint3, ...]
    color: FoxgloveColor
    colors: tuple[FoxgloveColor, ...]
    indices: tuple[int, ...]


class FoxgloveText(FoxgloveEntry):
    """A label; a billboard faces whoever looks."""

    pose: FoxglovePose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: FoxgloveColor
    text: str


class FoxgloveModel(FoxgloveEntry):
    """Not used, as above."""

    pose: FoxglovePose
    scale: FoxgloveVector3
    color: FoxgloveColor
    override_color: bool
    url: str
    media_type: str
    data: str


class FoxgloveSceneEntity(FoxgloveEntry):
    """One thing of the scene; a later one of the same id takes its place."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Time
    frame_locked: bool
    metadata: tuple[FoxgloveKeyValuePair, ...]
    arrows: tuple[FoxgloveArrow, ...] = ()
    cubes: tuple[FoxgloveCube, ...] = ()
    spheres: tuple[FoxgloveSphere, ...] = ()
    cylinders: tuple[FoxgloveCylinder, ...] = ()
    lines: tuple[FoxgloveLine, ...] = ()
    triangles: tuple[FoxgloveTriangles, ...] = ()
    texts: tuple[FoxgloveText, ...] = ()
    models: tuple[FoxgloveModel, ...] = ()


class FoxgloveSceneUpdate(FoxgloveEntry):
    """Things that appear in the scene, and things that are taken away."""

    deletions: tuple[FoxgloveSceneEntityDeletion, ...]
    entities: tuple[FoxgloveSceneEntity, ...]


class FoxgloveFrameTransform(FoxgloveEntry):
    """Where a frame lies in its parent."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: FoxgloveVector3
    rotation: FoxgloveQuaternion


class FoxgloveFrameTransforms(FoxgloveEntry):
    """Several of them."""

    transforms: tuple[FoxgloveFrameTransform, ...]


class FoxglovePosesInFrame(FoxgloveEntry):
    """Poses in one frame."""

    timestamp: Time
    frame_id: str
    poses: tuple[FoxglovePose, ...]


class FoxgloveLogLevel(IntEnum):
    """How much a line of a log matters."""

    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


class FoxgloveLog(FoxgloveEntry):
    """A line of a log."""

    timestamp: Time
    level: FoxgloveLogLevel
    message: str
    name: str
    file: str
    line: int


# ---------------------------------------------------------------- plain numbers


class JointValues(Entry):
    """Joints as the controller reports them, and the reference's; absent where there is none."""

    q0_measured_deg: float
    q1_measured_deg: float
    q2_measured_mm: float
    q3_measured_deg: float
    q4_measured_deg: float
    q0_reference_deg: float | None = None
    q1_reference_deg: float | None = None
    q2_reference_mm: float | None = None
    q3_reference_deg: float | None = None
    q4_reference_deg: float | None = None


class BoundaryClearances(Entry):
    """Clearance of each boundary where the controller says that it cuts, and its deadband; absent where undefined."""

    segment: int
    fraction: float
    least_in_deadbands: float | None = None
    inner_mm: float | None = None
    inner_deadband_mm: float | None = None
    outer_mm: float | None = None
    outer_deadband_mm: float | None = None
    left_mm: float | None = None
    left_deadband_mm: float | None = None
    right_mm: float | None = None
    right_deadband_mm: float | None = None
    top_mm: float | None = None
    top_deadband_mm: float | None = None
    bottom_mm: float | None = None
    bottom_deadband_mm: float | None = None
    roll_min_deg: float | None = None
    roll_min_deadband_deg: float | None = None
    roll_max_deg: float | None = None
    roll_max_deadband_deg: float | None = None
    pitch_min_deg: float | None = None
    pitch_min_deadband_deg: float | None = None
    pitch_max_deg: float | None = None
    pitch_max_deadband_deg: float | None = None
    wrist_singularity_deg: float | None = None
    wrist_singularity_deadband_deg: float | None = None


class SessionState(Entry):
    """Where the session stands, in words."""

    phase: str
    controller: str


VIEWED: Final[dict[str, type[Entry]]] = {
    "/scene": FoxgloveSceneUpdate,
    "/arm": FoxgloveSceneUpdate,
    "/transforms": FoxgloveFrameTransforms,
    "/transforms/bone": FoxgloveFrameTransforms,
    "/plan": FoxglovePosesInFrame,
    "/log": FoxgloveLog,
    "/state": SessionState,
    "/joints": JointValues,
    "/clearance": BoundaryClearances,
    TrackingSample.TOPIC: TrackingSample,
    LoopTiming.TOPIC: LoopTiming,
}
"""Every topic of the file."""


def viewed_schema(model: type[Entry]) -> tuple[str, bytes]:
    """Name and JSON Schema of a model in the file."""
    name = model.__name__
    package = "foxglove" if name.startswith(PREFIX) else "cutgate"
    return f"{package}.{name.removeprefix(PREFIX)}", schema_bytes(model)


def viewed_json(message: Entry) -> bytes:
    """A message as it is stored: what is undefined is absent, nothing is NaN.

    Raises:
        ValueError: a number is not finite.
    """
    content = message.model_dump(mode="json", exclude_none=True)
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
