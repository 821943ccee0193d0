"""How far the moving arm was from where it was verified to be: the worst of what the log's `/tracking` says. Pure."""

import math
from dataclasses import dataclass

from pydantic import ValidationError

from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import TrackingSample


@dataclass(frozen=True, slots=True)
class Measured:
    """The worst of all samples.

    Attributes:
        samples: how many there are.
        wrist_mm: the largest distance of the wrist centre from the reference that a sample does not exclude.
        tolerance_mm: what was allowed of it, at that sample.
        tip_mm: the largest distance of the tip.
        segment: where on the path the wrist's was; None beside the cut.
    """

    samples: int
    wrist_mm: float
    tolerance_mm: float
    tip_mm: float
    segment: int | None

    @property
    def words(self) -> str:
        """In a sentence."""
        where = "beside the cut" if self.segment is None else f"at segment {self.segment}"
        return (
            f"While it moved ({self.samples} samples), the wrist centre was at most {_up(self.wrist_mm)} mm from the "
            f"verified way ({where}; allowed: {self.tolerance_mm:g} mm), the tip at most {_up(self.tip_mm)} mm."
        )


def _up(value_mm: float) -> str:
    """Rounded up: a distance is never told as less than it was."""
    return f"{math.ceil(round(value_mm * 1000.0, 6)) / 1000.0:.3f}"


def measured_of(log: Log) -> Measured | None:
    """The worst sample of a log; None where it has none. Records that are none are passed over: they are data."""
    samples, tip_mm = 0, 0.0
    worst: TrackingSample | None = None
    for _, data in log.each(TrackingSample.TOPIC):
        try:
            sample = TrackingSample.model_validate_json(data)
        except ValidationError:
            continue
        samples += 1
        tip_mm = max(tip_mm, sample.tip_distance_mm)
        if worst is None or sample.wrist_deviation_mm > worst.wrist_deviation_mm:
            worst = sample
    if worst is None:
        return None
    return Measured(samples, worst.wrist_deviation_mm, worst.wrist_tolerance_mm, tip_mm, worst.segment)
