"""A verdict in one line: what decided it."""

import math

from cutgate.runtime.verification.verdict import Boundary, Verdict


def summary(verdict: Verdict) -> str:
    """The smallest margin, or what is violated: known shortfalls first, worst first; else the reasons themselves."""
    known = [b for b in verdict.boundaries.values() if b.certified is not None]
    if verdict.admissible:
        if not known:
            return "the whole path keeps every deadband"
        (tightest,) = worst(verdict)
        return (
            f"the whole path keeps every deadband; tightest is {tightest.name}, "
            f"{_value(tightest.certified)} {tightest.unit} with {tightest.deadband:g} {tightest.unit} required"
        )
    parts = [
        f"{b.name} short by {_shortfall(b)} {b.unit}" for b in sorted(known, key=_relative) if b.violated
    ]
    parts += [f"q{line.joint} too fast" for line in verdict.speed if not line.ok and line.peak is not None]
    parts += [
        f"q{line.joint} accelerates too much"
        for line in verdict.acceleration
        if not line.ok and line.peak is not None
    ]
    undefined = [name for name, b in verdict.boundaries.items() if b.certified is None]
    for lines in (verdict.speed, verdict.acceleration):
        unbounded = [f"q{line.joint}" for line in lines if not line.ok and line.peak is None]
        undefined += [f"{lines[0].quantity} of {', '.join(unbounded)}"] if unbounded else []
    parts += [f"undefined: {', '.join(undefined)}"] if undefined else []
    return "; ".join(parts or verdict.reasons) or "see the reasons below"


def worst(verdict: Verdict) -> tuple[Boundary, ...]:
    """The boundaries that are violated, the worst first; of an admissible verdict the tightest."""
    known = sorted((b for b in verdict.boundaries.values() if b.certified is not None), key=_relative)
    return tuple(b for b in known if b.violated) or tuple(known[:1])


def _relative(boundary: Boundary) -> float:
    """Margin per deadband, to compare over units."""
    return (
        -math.inf
        if boundary.certified is None
        else (boundary.certified - boundary.deadband) / boundary.deadband
    )


def _shortfall(boundary: Boundary) -> str:
    """What is lacking at the worst place found; of an undecided boundary what could not be proved."""
    known = [v for v in (boundary.clearance, boundary.certified) if v is not None and v < boundary.deadband]
    return _value(boundary.deadband - known[0] if known else None)


def _value(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"
