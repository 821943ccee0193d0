"""One named precondition or rule with its value, its bound and what to do: what a person reads of a decision."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Permissive:
    """One named precondition as it stands now."""

    name: str
    holds: bool
    value: float | None
    text: str | None
    bound: str
    remedy: str

    def __str__(self) -> str:
        """Name, value, bound and, if it fails, the remedy, on one line."""
        shown = self.text if self.value is None else f"{self.value:g}"
        tail = "" if self.holds else f": {self.remedy}"
        return f"{self.name}: {shown} (required: {self.bound}){tail}"
