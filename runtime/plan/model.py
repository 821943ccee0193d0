"""What a plan holds: poses to cut, and what its file says about them."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, Strict

from cutgate.config.model import Real, Strictly, Text
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.toolpath.model import Cut
from cutgate.runtime.plan.transform import Transform


class PlanDocument(Strictly):
    """``plan.json`` but for its poses, which ``poses_of`` checks faster than a model could."""

    schema_: Annotated[Literal["cutgate.plan/1"], Field(alias="schema")]
    id: Text
    implant: Text
    side: Literal["left", "right"]
    units: Literal["mm"]
    tool_length_mm: Annotated[Real, Field(ge=0, le=2000)] | None = None
    feed_mm_s: Annotated[Real, Field(ge=0.001, le=10_000)]
    ct_T_implant: Transform  # noqa: N815 - the contract's name: frame CT from frame implant
    ct_id: Text | None = None
    poses: Annotated[list[Any], Strict()]


@dataclass(frozen=True, slots=True)
class Plan:
    """Poses to cut, in implant coordinates, with what the file says about them.

    Attributes:
        id: the plan's name; for a bare tool path the file's.
        implant, side: what is planned; None for a bare tool path.
        tool_length_mm: the tool the plan was made for, or None.
        feed_mm_s: planned feed at the tip, or None where the file has none.
        ct_T_implant: (4, 4), mm.
        ct_id: which CT, or None.
        tips_mm: (n, 3).
        axes: (n, 3), unit, from the tip toward the holder.
        cut: what a bare tool path's file says beyond the poses; None of a plan.
    """

    id: str
    implant: str | None
    side: Literal["left", "right"] | None
    tool_length_mm: float | None
    feed_mm_s: float | None
    ct_T_implant: Floats  # noqa: N815 - as above
    ct_id: str | None
    tips_mm: Floats
    axes: Floats
    cut: Cut | None = None
