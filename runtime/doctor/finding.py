"""What a check found."""

from dataclasses import dataclass
from enum import StrEnum


class Condition(StrEnum):
    """How something stands; ``unknown`` is never good."""

    OK = "ok"
    UNKNOWN = "unknown"
    WARNING = "warning"
    FAIL = "FAIL"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the table.

    Attributes:
        name: of what was looked at.
        state: how it stands.
        found: the value.
        bound: what it must be.
        remedy: what to do about it; empty where nothing is to be done.
    """

    name: str
    state: Condition
    found: str
    bound: str
    remedy: str = ""


def within(holds: bool, otherwise: Condition) -> Condition:
    """``ok`` where it holds."""
    return Condition.OK if holds else otherwise
