"""Writes ``docs/screens.md``: ``python -m docs.make_screens``.

What ``run`` shows at its end, at 80 and 120 columns: a refusal, an admission, each stop. The sessions are run against the
simulated controller in virtual time; the same page comes out on every machine.
"""
# ruff: noqa: INP001

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from rich.console import Console, RenderableType

from cutgate.runtime.audit.log import Paths
from cutgate.runtime.commands.session_view import approach_line, outcome_lines, stopped, verdict_lines
from cutgate.runtime.commands.verdict_view import guidance_lines
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.show import stop_lines
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, Pair, answers, job_of, pair_of

PAGE: Final = Path(__file__).parent / "screens.md"
WIDTHS: Final = (80, 120)
LOG: Final = Path("cutgate-logs/20260901T120000Z-00112233")
PATHS: Final = Paths(LOG.with_suffix(".mcap"), LOG.with_suffix(".candump.log"), closed=True, reason="")
LONG_S: Final = 120.0


def said(word: str) -> Callable[[Pair], object]:
    """The operator says a word."""
    return lambda pair: pair.say(word)


def done(word: str) -> Callable[[Pair], object]:
    """Somebody does something at the controller."""
    return lambda pair: pair.controller_terminal.type(word)


def silent_disk(pair: Pair) -> None:
    """The disk does not answer any more."""
    pair.disk.answers = False


def silent_controller(pair: Pair) -> None:
    """The controller has no power any more."""
    pair.controller_turns = False


def stalled(pair: Pair) -> None:
    """The runtime's computer has other things to do."""
    pair.clock.now_s += 1.0


def left_alone(_pair: Pair) -> None:
    """Nobody does anything."""


class Stop(NamedTuple):
    """How a session is stopped.

    Attributes:
        title: the heading.
        act: what is done.
        fault: of the simulated controller.
        phase: where it is done.
    """

    title: str
    act: Callable[[Pair], object]
    fault: str | None = None
    phase: Phase = Phase.CUTTING


STOPS: Final = (
    Stop("The operator says stop", said("stop")),
    Stop("The operator leaves", said("quit")),
    Stop("The operator leaves before the start", said("quit"), phase=Phase.PERMITTED),
    Stop("The enabling device is released", done("release")),
    Stop("The emergency stop is pressed", done("estop")),
    Stop("The bone moves", done("bone-motion")),
    Stop("The registration is withdrawn", said("withdraw")),
    Stop("A limit of the controller changes", done("limit")),
    Stop("The controller falls silent", silent_controller),
    Stop("The runtime's computer stands still", stalled),
    Stop("The disk of the log does not answer", silent_disk),
    Stop("The arm is not where the controller says", left_alone, fault="drift@cutting"),
    Stop("The controller starts anew", left_alone, fault="reboot@cutting"),
    Stop("Nobody starts", left_alone, phase=Phase.PERMITTED),
)


class _Place:
    """A folder, as the tests' fixtures give it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def getbasetemp(self) -> Path:
        """Where the input files go."""
        return self._folder


@contextmanager
def session(bone_x_mm: float) -> Iterator[Pair]:
    """A pair of its own."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        with pair_of(place, *job_of(_Place(place), bone_x_mm)) as pair:
            yield pair


def refusal() -> list[RenderableType]:
    """A path that does not fit where the bone stands."""
    with session(INADMISSIBLE_MM) as pair:
        pair.begin()
        pair.end()
        assert pair.session is not None and pair.session.answer is not None  # noqa: S101, PT018 - it was refused
        answer = pair.session.answer
        _, guided = answers(pair.prover.asked[0])
        found = guided.guidance.value  # type: ignore[union-attr]
        return [
            verdict_lines(answer),
            guidance_lines(found),
            outcome_lines(pair.state, PATHS),
        ]


def admission() -> list[RenderableType]:
    """A path that fits, cut to its end."""
    with session(ADMISSIBLE_MM) as pair:
        pair.end(LONG_S)
        assert pair.session is not None and pair.session.answer is not None  # noqa: S101, PT018 - it was admitted
        answer = pair.session.answer
        assert answer.approach is not None  # noqa: S101 - likewise
        return [
            verdict_lines(answer),
            approach_line(answer.approach),
            outcome_lines(pair.state, PATHS),
        ]


def stop(how: Stop) -> list[RenderableType]:
    """A session that is stopped half-way through the cut, or before it."""
    with session(ADMISSIBLE_MM) as pair:
        faults = () if how.fault is None else (how.fault,)
        pair.power_up(*faults, time_scale=0.2)
        pair.to(how.phase, *ENDED, limit_s=LONG_S)
        assert pair.session is not None  # noqa: S101 - it has begun
        if how.phase is Phase.CUTTING and how.fault is None:
            pair.until(lambda: (pair.session.last_seen[0] or (0, 0))[0] >= 2, LONG_S)  # type: ignore[union-attr]
        how.act(pair)
        pair.until(lambda: pair.phase in ENDED, 2 * LONG_S)
        told = stopped(pair.session)
        assert told is not None  # noqa: S101 - it was stopped
        return ["", *stop_lines(told), outcome_lines(pair.state, PATHS, told=True)]


def screen(parts: list[RenderableType], width: int) -> str:
    """The text that a terminal of this width shows."""
    console = Console(width=width, no_color=True, highlight=False, markup=False, legacy_windows=False)
    with console.capture() as capture:
        for part in parts:
            console.print(part)
    return "\n".join(line.rstrip() for line in capture.get().strip("\n").splitlines())


def page() -> str:
    """The whole page."""
    scenes = [("A path that is refused", refusal()), ("A path that is admitted and cut", admission())]
    scenes += [(how.title, stop(how)) for how in STOPS]
    lines = [
        "# Screens",
        "",
        "What `cutgate run` shows at its end, at 80 and 120 columns, without colours. Made by `python -m docs.make_screens`",
        "from sessions against the simulated controller in virtual time.",
    ]
    for title, parts in scenes:
        lines += ["", f"## {title}"]
        for width in WIDTHS:
            lines += ["", f"{width} columns:", "", "```text", screen(parts, width), "```"]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
