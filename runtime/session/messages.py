"""What runtime and verification process say to each other: a length, then JSON; nothing in it is ever executed.

The runtime believes nothing of what it reads here. A message is bounded before it is read, every field has its type
and its bounds, no number is NaN, no text holds anything that would act on a terminal; what is otherwise is no message.
The path, up to 20 MB, is no part of a message: the process has it from its start.
"""

import json
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)

from cutgate.config.model import Robot
from cutgate.config.screen import printable
from cutgate.protocol import records
from cutgate.runtime.verification import advice as guiding
from cutgate.runtime.verification.approach.model import StartJoints

LENGTH_BYTES: Final = 4
REQUEST_BYTES_MAX: Final = 1 << 18
ANSWER_BYTES_MAX: Final = 1 << 14
"""Ours take under 4 kB. One so long that is wrong in every place is refused within 5 ms."""
TEXT_MAX: Final = 2000
SHOWN_MAX: Final = 200
"""Characters of foreign text in a sentence of ours."""


class MessageError(ValueError):
    """Bytes that are no message."""


# ---------------------------------------------------------------- frames


def framed(body: bytes) -> bytes:
    """A message with its length before it."""
    return len(body).to_bytes(LENGTH_BYTES, "big") + body


class Frames:
    """Puts messages together again from what a pipe brings; holds at most one.

    Args:
        most: no message is longer, bytes.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._came = bytearray()

    @property
    def missing(self) -> int:
        """Bytes that are still to come, of the length or else of the message; none more may be added."""
        return self._end - len(self._came)

    def add(self, came: bytes) -> bytes | None:
        """Take what came; the message, once it is whole.

        Raises:
            MessageError: a length that no message has.
        """
        self._came += came
        if len(self._came) == LENGTH_BYTES and not LENGTH_BYTES < self._end <= LENGTH_BYTES + self._most:
            length = self._end - LENGTH_BYTES
            raise MessageError(f"a message of {length} bytes is announced, must have 1..{self._most}")
        if self.missing:
            return None
        body = bytes(self._came[LENGTH_BYTES:])
        self._came.clear()
        return body

    @property
    def _end(self) -> int:
        head = self._came[:LENGTH_BYTES]
        return LENGTH_BYTES + (int.from_bytes(head, "big") if len(head) == LENGTH_BYTES else 0)


# ---------------------------------------------------------------- the question


@dataclass(frozen=True)
class Request:
    """What is to be verified: the bytes the controller stored and reported, and how the arm comes and goes."""

    number: int
    path: bytes
    """Not part of the message."""
    limits: bytes
    calibration: bytes
    tool: bytes
    robot: Robot
    start_joints_u: tuple[int, ...]
    clearance_um: int
    start_tolerance_mm: float
    start_tolerance_deg: float
    speed_percent: int

    @property
    def start(self) -> StartJoints:
        """Where approach and retract begin and end."""
        return StartJoints.of(
            self.start_joints_u,
            clearance_um=self.clearance_um,
            tolerance_mm=self.start_tolerance_mm,
            tolerance_deg=self.start_tolerance_deg,
        )

    def body(self) -> bytes:
        """As JSON, without the path.

        Raises:
            ValueError: a number is not finite.
        """
        plain = dict(vars(self), robot=self.robot.model_dump(by_alias=True))
        del plain["path"]
        plain |= {name: plain[name].hex() for name in _RECORDS}
        return json.dumps(plain, allow_nan=False).encode()

    @classmethod
    def parse(cls, body: bytes, path: bytes) -> Self:
        """The request again, in the verification process, which believes the runtime.

        Raises:
            ValueError, KeyError, TypeError: these bytes are none.
        """
        plain = json.loads(body)
        plain |= {name: bytes.fromhex(plain[name]) for name in _RECORDS}
        plain["robot"] = Robot.model_validate_json(json.dumps(plain["robot"]))
        plain["start_joints_u"] = tuple(plain["start_joints_u"])
        return cls(path=path, **plain)


_RECORDS: Final = ("limits", "calibration", "tool")


# ---------------------------------------------------------------- the answers


def shown(text: str, most: int) -> str:
    """Text of whatever origin as it may be shown: whatever acts on a terminal escaped, and not longer than that."""
    return printable(text[:most])[:most]


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must have printable characters alone")
    return text


Number = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Digest = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{64}\z")]
Joints = Annotated[tuple[Number, ...], Field(min_length=5, max_length=5, fail_fast=True)]
Text = Annotated[str, StringConstraints(max_length=TEXT_MAX), AfterValidator(_printable)]
Vector = tuple[float, float, float]


class _Plain(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Bound(_Plain):
    """What a permit would bind of approach and retract."""

    entry_um: Number
    exit_um: Number
    entry_joints_u: Joints
    exit_joints_u: Joints
    speed_percent: Number

    @classmethod
    def of(cls, bound: records.Approach | None) -> Self | None:
        """From what a permit binds; None where nothing is admissible."""
        return None if bound is None else cls(**asdict(bound))


class Claim(_Plain):
    """What the verification process says of cut, approach and retract, and what it says it of."""

    kind: Literal["claim"] = "claim"
    request: Number
    admissible: bool
    path: Digest
    limits: Digest
    calibration: Digest
    tool: Digest
    start_joints_u: Joints
    approach: Bound | None
    """None unless approach and retract are admissible."""


class ToldMove(_Plain):
    """As in `advice.Move`."""

    boundary: Annotated[Text, StringConstraints(max_length=40)]
    kind: Literal["move", "turn"]
    direction: Vector
    distance_mm: float | None
    angle_deg: float | None


class ToldGuidance(_Plain):
    """As `advice.Guidance`: for people, who see whether it holds when the bone is verified where it stands then."""

    translation_mm: Vector | None
    yaw_deg: float
    pivot_mm: Vector
    moves: Annotated[tuple[ToldMove, ...], Field(max_length=20, fail_fast=True)]
    predicted_clearance_mm: float | None
    verified: bool
    text: Text
    none_possible: bool | None
    at_least_mm: float | None
    reserve_mm: float | None
    reserve_deg: float | None

    @property
    def value(self) -> guiding.Guidance:
        """The same as the rest of the program knows it."""
        fields = dict(self)
        return guiding.Guidance(**{**fields, "moves": tuple(guiding.Move(**dict(m)) for m in self.moves)})


class Guided(_Plain):
    """Where to move the bone; after a claim that the cut is inadmissible."""

    kind: Literal["guided"] = "guided"
    request: Number
    guidance: ToldGuidance | None

    @classmethod
    def of(cls, request: int, found: guiding.Guidance | None) -> Self:
        """The guidance that was found."""
        return cls.model_validate({"request": request, "guidance": None if found is None else asdict(found)})


class Broken(_Plain):
    """The verification process failed, or what it says cannot be read: nothing was verified."""

    kind: Literal["broken"] = "broken"
    request: Number = 0
    reason: Text


Answer = Claim | Guided | Broken
_ANSWER: Final[TypeAdapter[Any]] = TypeAdapter(Annotated[Answer, Field(discriminator="kind")])


def parse_answer(body: bytes) -> Answer:
    """Read one answer.

    Raises:
        MessageError: it is none, with the first thing that is wrong.
    """
    try:
        answer: Answer = _ANSWER.validate_json(body)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise MessageError(shown(f"{place}: {first['msg']}" if place else first["msg"], SHOWN_MAX)) from None
    return answer
