"""Writes ``docs/screens.md``: ``python -m docs.make_screens``.

What ``run`` shows at its end, at 80 and 120 columns: a refusal, an admission, a stop for each cause. The sessions are run against the
simulated controller in virtual time; the same page comes out on every machine.
"""
# ruff: noqa: INP001, SLF001

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import can
from rich.console import Console, Group, RenderableType

from cutgate.firmware_sim.plant import Leg
from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import BULK_IDS, DATA_IDS, ControllerHeartbeat, RuntimeHeartbeat
from cutgate.protocol.states import ControllerState
from cutgate.runtime.audit.log import Paths
from cutgate.runtime.commands.session_view import approach_line, outcome_lines, stopped, verdict_lines
from cutgate.runtime.commands.verdict_view import guidance_lines
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.show import stop_lines
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, KEY, Pair, answers, job_of, pair_of
from tests.runtime.session.wire import RUNTIME, Rule, flip, lose, nth, of

PAGE: Final = Path(__file__).parent / "screens.md"
WIDTHS: Final = (80, 120)
LOG: Final = Path("cutgate-logs/20260901T120000Z-00112233")
PATHS: Final = Paths(LOG.with_suffix(".mcap"), LOG.with_suffix(".candump.log"), closed=True, reason="")
LONG_S: Final = 120.0
SAME: Final = ("simulation:", "audit log:", "raw frames:")
"""How the last lines begin that are the same of each stop."""


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
    pair.controller_runs = False


def stalled(pair: Pair) -> None:
    """The runtime's computer has other things to do."""
    pair.clock.now_s += 1.0


def left_alone(_pair: Pair) -> None:
    """Nobody does anything."""


def on_the_way(can_id: int, which: range, change: Rule) -> Callable[[Pair], object]:
    """Something happens to the next frames of an identifier."""
    return lambda pair: pair.wire.rules.append(nth(can_id, which, change))


def second_node(pair: Pair) -> None:
    """Another node sends what only the runtime may send."""
    pair.wire.nodes[RUNTIME].put(of(RuntimeHeartbeat), bytes(8))


def other_tool(pair: Pair) -> None:
    """Somebody changes the tool at the controller, which says so unasked."""
    tool = records.Tool.parse(pair.job.tool)
    pair.process._send(records.Tool.quantised(length_mm=tool.length_mm + 1.0))


def other_state(pair: Pair) -> None:
    """The controller is in a state that does not follow."""
    pair.process.controller = replace(pair.controller, state=ControllerState.OPEN)


def stranger(pair: Pair) -> None:
    """Somebody without the key makes a heartbeat of the controller that is sound in everything but its tag."""
    assert pair.state.session is not None  # noqa: S101 - it is cutting
    tag = pair.state.session.tag

    def forged(message: can.Message) -> list[can.Message]:
        can_id, data = message.arbitration_id, bytes(message.data)
        sound = protect(bytes([data[3] ^ 1]) + data[4:], data[2], DATA_IDS[can_id], tag)
        return [can.Message(arbitration_id=can_id, data=sound, is_extended_id=False)]

    on_the_way(of(ControllerHeartbeat), range(1), forged)(pair)


def knocked(pair: Pair) -> None:
    """A joint is faster in one cycle than its limit allows."""
    q0, *others = pair.process.arm.measured
    pair.process.arm.measured = (q0 + 0.1, *others)


def broken_controller(pair: Pair) -> None:
    """The controller's program fails; it says so with its last frame."""

    def fail() -> None:
        raise RuntimeError

    pair.process._inject = fail
    with suppress(RuntimeError):
        pair.run_cycle()
    pair.controller_runs = False


def broken_bus(pair: Pair) -> None:
    """The runtime's interface to the bus is gone."""
    pair.wire.nodes[RUNTIME].broken = True


class Stop(NamedTuple):
    """How a session is stopped.

    Attributes:
        title: the heading.
        act: what is done.
        fault: of the simulated controller.
        phase: where it is done.
        leg: where the arm is then, if it moves.
    """

    title: str
    act: Callable[[Pair], object]
    fault: str | None = None
    phase: Phase = Phase.CUTTING
    leg: Leg = Leg.CUT


THREE: Final = range(0, 6, 2)
"""Every other frame, three in all: one more than is tolerated in a second."""

STOPS: Final = (
    Stop("The operator says stop", said("stop")),
    Stop("The operator says stop on the approach", said("stop"), leg=Leg.APPROACH),
    Stop("The operator says stop on the retract", said("stop"), leg=Leg.RETRACT),
    Stop("The operator leaves", said("quit")),
    Stop("The operator leaves before the start", said("quit"), phase=Phase.PERMITTED),
    Stop("The enabling device is released", done("release")),
    Stop("The emergency stop is pressed", done("estop")),
    Stop("The bone moves", done("bone-motion")),
    Stop("The registration is withdrawn", said("withdraw")),
    Stop("A limit of the controller changes", done("limit")),
    Stop("The controller's tool changes", other_tool),
    Stop("A bit of the stored path flips", left_alone, fault="flip-path-bit@cutting"),
    Stop("The controller falls silent", silent_controller),
    Stop("Frames are lost", on_the_way(of(ControllerHeartbeat), range(3), lose)),
    Stop("Frames are damaged", on_the_way(of(ControllerHeartbeat), THREE, flip)),
    Stop("A second node speaks", second_node),
    Stop(
        "A frame of the upload is lost", on_the_way(BULK_IDS[RUNTIME], range(1), lose), phase=Phase.UPLOADING
    ),
    Stop("The bus fails", broken_bus),
    Stop("The runtime's computer stands still", stalled),
    Stop("The disk of the log does not answer", silent_disk),
    Stop("The arm is not where the controller says", left_alone, fault="drift@cutting"),
    Stop("A joint is faster than its limit", knocked),
    Stop("The controller starts anew", left_alone, fault="reboot@cutting"),
    Stop("The controller's program fails", broken_controller),
    Stop("The controller leaves the order of its states", other_state),
    Stop("Somebody without the key speaks for the controller", stranger),
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
        files, job = job_of(_Place(place), bone_x_mm)
        with pair_of(place, files, replace(job, key_fingerprint=fingerprint(KEY))) as pair:
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


def half_way(pair: Pair, leg: Leg) -> bool:
    """The arm is in the middle of the leg; of the cut it has said so."""
    arm = pair.process.arm.state
    if leg is Leg.CUT:
        assert pair.session is not None  # noqa: S101 - it has begun
        return (pair.session.last_seen[0] or (0, 0))[0] >= 2
    return arm.leg is leg and arm.fraction >= 0.5


def stop(how: Stop) -> list[RenderableType]:
    """A session that is stopped half-way through the cut, or before it."""
    with session(ADMISSIBLE_MM) as pair:
        faults = () if how.fault is None else (how.fault,)
        pair.power_up(*faults, time_scale=0.2)
        pair.to(how.phase, *ENDED, limit_s=LONG_S)
        assert pair.session is not None  # noqa: S101 - it has begun
        if how.phase is Phase.CUTTING and how.fault is None:
            pair.until(lambda: half_way(pair, how.leg), LONG_S)
        how.act(pair)
        pair.until(lambda: pair.phase in ENDED, 2 * LONG_S)
        told = stopped(pair.session)
        assert told is not None  # noqa: S101 - it was stopped
        return ["", *stop_lines(told), outcome_lines(pair.state, PATHS, told=True)]


def without_the_same(parts: list[RenderableType]) -> list[RenderableType]:
    """A stop without the last lines that are the same of each; what the controller was last seen in is its own."""
    *parts, last = parts
    assert isinstance(last, Group)  # noqa: S101 - what came of it
    own = [line for line in last.renderables if not str(line).startswith(SAME)]
    return [*parts, Group(*own)]


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
    first, *others = STOPS
    scenes += [(first.title, stop(first)), *((how.title, without_the_same(stop(how))) for how in others)]
    lines = [
        "# Screens",
        "",
        "What `cutgate run` shows at its end, at 80 and 120 columns, without colours. Made by `python -m docs.make_screens`",
        "from sessions against the simulated controller in virtual time. From the second stop on the last lines are left out",
        "that are the same of each: `simulation`, `audit log`, `raw frames`.",
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
