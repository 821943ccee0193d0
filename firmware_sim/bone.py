"""The bone, and the sensor that tells the controller of its motion."""

import math
from dataclasses import dataclass
from typing import Final, Self

SENSOR_MM: Final = 0.2
"""The sensor tells of a motion of so much, and of no less."""


@dataclass(frozen=True)
class BoneMotion:
    """The bone moves by itself, once.

    Attributes:
        after_s: so long after a cut was started, on the clock.
        by_mm: so far.
    """

    after_s: float
    by_mm: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """``SECONDS,MM``.

        Raises:
            ValueError: it is not two numbers, finite and not negative; naming what is allowed.
        """
        try:
            after_s, by_mm = map(float, text.split(","))
        except ValueError:
            after_s = by_mm = math.nan
        if not (0.0 <= after_s < math.inf and 0.0 <= by_mm < math.inf):
            raise ValueError(f"{text!r} must be SECONDS,MM, both finite and >= 0, for example 2.5,1")
        return cls(after_s, by_mm)

    @property
    def is_seen(self) -> bool:
        """Whether the sensor tells of it."""
        return self.by_mm >= SENSOR_MM

    def told(self) -> str:
        """What has happened, in words."""
        seen = "" if self.is_seen else f", less than the {SENSOR_MM:g} mm of which its sensor tells"
        return f"the bone has moved by {self.by_mm:g} mm{seen}"
