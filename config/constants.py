"""Every constant of the program in one table: default, bounds, unit and meaning.

A site may change a constant within its bounds (``site.toml``); nothing else may. Constants marked
``exchanged`` travel in the OPEN record, and the controller refuses one outside its own bounds.
``python -m cutgate.config.constants`` prints the table as Markdown.
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

CLOCK_SKEW_MAX_S: Final = 3600
"""So far apart, at most, are the clocks of who registers and of the runtime (`clock_skew_s`)."""


@dataclass(frozen=True, slots=True)
class Constant:
    """One constant: its value lies in ``low <= value <= high``, in ``unit``."""

    name: str
    unit: str
    default: float
    low: float
    high: float
    exchanged: bool
    meaning: str

    def holds(self, value: float) -> bool:
        """Whether the value lies inside the bounds; NaN does not."""
        return self.low <= value <= self.high

    @property
    def bound(self) -> str:
        """The bounds in words, with the unit."""
        return f"{grouped(self.low)} to {grouped(self.high)} {self.unit}".rstrip()


TIMEOUT_HEARTBEATS: Final = 4
"""The heartbeat time-out is at least this many heartbeat periods: it runs from the sending of what is echoed."""
EARLIER_TIMEOUT_HEARTBEATS: Final = 3
"""What it was in version 0.1.0: sites of recorded logs are read."""

CHECK_POINTS_MAX: Final = 100
"""Of one registration."""

REGISTRATIONS_MAX: Final = 1000
"""So many withdrawn registrations a controller remembers, by their places; where no further one fits it opens no session."""

TABLE: Final[tuple[Constant, ...]] = (
    # name, unit, default, low, high, exchanged, meaning
    Constant("heartbeat_ms", "ms", 20, 5, 100, True, "period of both sides' heartbeats"),
    Constant(
        "timeout_ms", "ms", 100, 15, 1000, True,
        "without a fresh heartbeat for this long the gate closes; at least 4 heartbeat periods",
    ),
    Constant("permit_lifetime_s", "s", 120, 10, 600, True, "from the permit's nonce to START, on the controller's clock"),
    Constant("start_lifetime_ms", "ms", 2000, 500, 5000, True, "from the start's nonce to START, on the controller's clock"),
    Constant("start_tolerance_mm", "mm", 0.5, 0.05, 2, True, "wrist centre off the bound start joints, at PERMIT and START; widens the joint lines' deadband"),
    Constant("start_tolerance_deg", "deg", 0.2, 0.02, 1, True, "rotary joints off the bound start joints, at PERMIT and START; widens the joint lines' deadband"),
    Constant(
        "approach_clearance_mm", "mm", 10, 0, 200, True,
        "entry and exit pose beyond everything that is cut, along the tool axis there",
    ),
    Constant("approach_speed_percent", "%", 25, 1, 100, True, "of the joint speed limits, on the joint lines of approach and retract"),
    Constant("tracking_tolerance_mm", "mm", 0.5, 0.05, 5, False, "wrist centre off the verified path while the arm moves"),
    Constant("tracking_tolerance_deg", "deg", 0.25, 0.02, 2, False, "turning joints off the verified path while the arm moves"),
    Constant("transfer_timeout_s", "s", 20, 1, 120, False, "one whole bulk transfer (limits, calibration, tool, path)"),
    Constant("reply_timeout_ms", "ms", 2000, 200, 10_000, False, "the controller's answer to one control request"),
    Constant("announce_wait_s", "s", 30, 1, 600, False, "how long the runtime waits for a controller to announce itself"),
    Constant("verify_timeout_s", "s", 60, 1, 3600, False, "one verification in the verification process"),
    Constant("operator_wait_s", "s", 300, 1, 3600, False, "how long the runtime waits for the operator's next command"),
    Constant("stop_confirm_ms", "ms", 1000, 100, 5000, False, "a stop's confirmation by the controller"),
    Constant("commit_deadline_ms", "ms", 1000, 100, 5000, False, "durable record of an enabling decision; later is an audit failure"),
    Constant(
        "checkpoint_deadline_ms", "ms", 5000, 1000, 30_000, False,
        "durable record while cutting; longer, because a slow disk must not stop a half-cut bone",
    ),
    Constant("chunk_period_ms", "ms", 1000, 100, 1000, False, "oldest unwritten record of the log"),
    Constant(
        "check_point_tolerance_mm", "mm", 2.0, 0.01, 20, False,
        "a check point of the registration off where the registration puts it",
    ),
    Constant("check_points_min", "points", 0, 0, CHECK_POINTS_MAX, False, "check points that a registration must have"),
    Constant("file_size_limit_mb", "MB", 64, 1, 1024, False, "largest input file that is read (1 MB = 1 000 000 bytes)"),
    Constant("pose_limit", "poses", 1_048_576, 2, 1_048_576, False, "longest path that is read; the wire carries no longer one"),
)  # fmt: skip

CONSTANTS: Final = MappingProxyType({constant.name: constant for constant in TABLE})
"""The table by name."""


def grouped(value: float) -> str:
    """A number for people: without a needless decimal point, digits in groups of three."""
    return f"{value:,.0f}".replace(",", " ") if float(value).is_integer() else f"{value:g}"


def markdown() -> str:
    """The table as a Markdown page (docs/constants.md)."""
    lines = [
        "# Constants",
        "",
        "Generated from `config/constants.py` by `python -m cutgate.config.constants`; change it there.",
        "A site sets them in `site.toml` ([files.md](files.md)). *Exchanged* ones are sent to the controller,",
        "which refuses a value outside its own bounds.",
        "",
        "| constant | unit | default | bounds | exchanged | meaning |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{c.name}` | {c.unit} | {grouped(c.default)} | {grouped(c.low)} to {grouped(c.high)} "
        f"| {'yes' if c.exchanged else 'no'} | {c.meaning} |"
        for c in TABLE
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")  # noqa: T201 - printing is what this entry is for
