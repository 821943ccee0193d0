"""A check: a probe, and the judge of what it finds."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from cutgate.runtime.doctor.facts import Unknown
from cutgate.runtime.doctor.finding import Condition, Finding

E = TypeVar("E")
F = TypeVar("F")


@dataclass(frozen=True, slots=True)
class Probed(Generic[E, F]):
    """A row of the table of checks.

    Attributes:
        name: of the check.
        bound: what is asked for, shown where nothing could be found.
        probe: reads the system.
        judge: says what the facts mean; pure.
    """

    name: str
    bound: str
    probe: Callable[[E], F | Unknown]
    judge: Callable[[F, E], Iterable[Finding]]

    def findings(self, examined: E) -> Iterable[Finding]:
        """Look, and judge; what could not be found is unknown."""
        try:
            facts = self.probe(examined)
        except (OSError, ValueError) as error:  # ValueError: a null character in a name
            facts = Unknown(f"could not be looked at: {getattr(error, 'strerror', None) or error}")
        if isinstance(facts, Unknown):
            return (Finding(self.name, Condition.UNKNOWN, facts.why, self.bound, facts.remedy),)
        return self.judge(facts, examined)


def findings(checks: Iterable[Probed[E, F]], examined: E) -> Iterator[Finding]:
    """What all of them find, one after the other."""
    for check in checks:
        yield from check.findings(examined)
