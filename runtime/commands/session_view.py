"""A session for people as it goes: one line per step that matters, what to do next, and the outcome."""

import time
from contextlib import ExitStack
from typing import Any, Final, Self

from rich.console import Group, RenderableType
from rich.text import Text

from cutgate.config.exits import OK
from cutgate.config.screen import LINE_MAX, STDERR, STDOUT, diverted, printable, screens
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit.log import Paths
from cutgate.runtime.commands.screen import LiveConsole
from cutgate.runtime.commands.travel_view import travel_lines
from cutgate.runtime.commands.verdict_view import (
    BAD,
    GOOD,
    boundaries_table,
    caution_line,
    check_point_line,
    facts_table,
    guidance_lines,
    headline,
    where_facts,
)
from cutgate.runtime.interlock.permissives import (
    FOR_PERMIT,
    FOR_START,
    failing,
    heartbeat_fresh,
    no_stop_cause,
)
from cutgate.runtime.interlock.phases import ENDINGS, PHASES
from cutgate.runtime.interlock.state import (
    Announced,
    CommandGiven,
    Effect,
    Event,
    Interlock,
    OperatorCommand,
    Phase,
    Refused,
)
from cutgate.runtime.kinematics.landmarks import CheckPoints
from cutgate.runtime.review.show import stop_lines
from cutgate.runtime.review.stopped import Stopped, Way, stop_document
from cutgate.runtime.session.check import Answer
from cutgate.runtime.session.journal import simulation
from cutgate.runtime.session.loop import Session
from cutgate.runtime.verification.advice import Guidance
from cutgate.runtime.verification.approach.model import ApproachVerdict
from cutgate.runtime.verification.approach.report import summary
from cutgate.runtime.verification.plausibility import cautions_of_move

SCHEMA: Final = "cutgate.run/1"
PERCENT_STEP: Final = 10
AT_REST: Final = (ControllerState.INHIBITED, ControllerState.FAULT)


class SessionView:
    """Writes to standard error; verdict and outcome go to standard output unless that is kept for JSON.

    The loop calls it, and never waits for whoever looks on: lines are handed over to a screen. Leaving the block waits
    for the screens, for a bounded time.

    Args:
        quiet_output: keep standard output free.

    Attributes:
        interrupted_by: the signal that interrupts the session, for its reason to be told.
    """

    def __init__(self, *, quiet_output: bool) -> None:
        self._stack = ExitStack()
        output, messages = self._stack.enter_context(screens(STDOUT, STDERR))
        self._stack.enter_context(diverted(messages))
        self._messages = LiveConsole(messages)
        self._output = self._messages if quiet_output else LiveConsole(output)
        self.interrupted_by = ""
        self._began_s = time.monotonic()
        self._percent = 0
        self._prompt = ""
        self._hold = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def interrupted(self, by: str) -> None:
        """A signal interrupts the session; ``by`` is told when it ends, unless it is empty."""
        self.interrupted_by = by

    def close(self) -> None:
        """Nothing more is shown; waits for the screens, for a bounded time."""
        self._stack.close()

    def note(self, text: str, style: str = "") -> None:
        """One line with the time since the beginning."""
        elapsed = f"{time.monotonic() - self._began_s:8.2f} s  "
        text = text[:LINE_MAX]
        self._messages.print(
            lambda: Text.assemble((elapsed, "dim"), (printable(text), style)), soft_wrap=True
        )

    def check_points(self, asked: CheckPoints) -> None:
        """How far each check point of the registration is off."""
        for one in asked.points:
            self.note(f"check point {check_point_line(asked, one)}", "" if asked.within(one) else BAD)

    def step(
        self, before: Interlock, event: Event, after: Interlock, effects: tuple[Effect, ...], now_s: float
    ) -> None:
        """One step of the interlock."""
        if self.interrupted_by and isinstance(event, CommandGiven) and event.command is OperatorCommand.QUIT:
            self.note(f"{self.interrupted_by}: the session ends")
        for effect in effects:
            if isinstance(effect, Refused):
                self.note(f"{effect.command} refused: {effect.reason}", "yellow")
        if isinstance(event, Announced) and after.session is not None and before.session is None:
            announce = event.announce
            self.note(
                f"controller {announce.serial}, firmware {announce.firmware_version}{simulation(announce)}"
            )
        if after.phase is not before.phase:
            self._entered(after, now_s)
        self._tell_what_is_carried(after, now_s)
        self._tell_the_device(after, now_s)

    def _entered(self, state: Interlock, now_s: float) -> None:
        announced = PHASES[state.phase].announced
        if state.phase is Phase.STOPPING:
            self.note(f"{announced}: {state.reason}", BAD)
        elif state.phase is Phase.ADMITTED:
            self.note(announced, GOOD)
            for permissive in failing(FOR_PERMIT, state, now_s):
                if permissive.name == heartbeat_fresh(state, now_s).name:
                    continue  # the next one makes it so, or is missed
                self.note(f"  {permissive}", "yellow")
        elif announced:
            self.note(announced)

    def _tell_what_is_carried(self, state: Interlock, now_s: float) -> None:
        """Tell the operator what holds the controller and which command is next: once each."""
        if state.phase is not Phase.HELD or state.controller is None:
            return
        prompt = self._hold
        if state.controller.cause is not StopCause.NONE:
            prompt = f"its cause is {state.controller.cause.name}: {no_stop_cause(state, now_s).remedy}"
        elif state.heartbeat_fresh:
            prompt = "acknowledged; the fault is latched: say reset"
        if prompt != self._hold:
            self._hold = prompt
            self.note(prompt)

    def _tell_the_device(self, state: Interlock, now_s: float) -> None:
        """Tell the operator when start may be given: once per press of the enabling device."""
        pressed = state.controller is not None and state.controller.device_pressed
        if not pressed or state.phase is not Phase.PERMITTED:
            self._prompt = ""
            return
        missing = "; ".join(map(str, failing(FOR_START, state, now_s)))
        prompt = f"not ready to start: {missing}" if missing else "enabling device is held: say start"
        if prompt != self._prompt:
            self._prompt = prompt
            self.note(prompt, "yellow" if missing else GOOD)

    def verdict(self, answer: Answer) -> None:
        """The verdict, with every boundary, and what looks wrong."""
        self._output.print(lambda: verdict_lines(answer))
        if (approach := answer.approach) is not None:
            self._output.print(lambda: approach_line(approach), soft_wrap=True)
            for line in travel_lines(approach, answer.verdict.start_joints_u, answer.proved):
                self._output.print(lambda line=line: line, soft_wrap=True)  # type: ignore[misc]

    def guidance(self, found: Guidance | None, note: str) -> None:
        """Where to move the bone; else why nothing is said of it."""
        if found is None:
            self.note(f"no move of the bone is shown: {note}", "yellow")
            return
        large = [caution_line(caution) for caution in cautions_of_move(found)]
        self._output.print(lambda: Group(*large, "", guidance_lines(found)))

    def progress(self, segment: int, segments: int) -> None:
        """A line every ten percent."""
        percent = 100 * segment // max(1, segments)
        if percent >= self._percent + PERCENT_STEP:
            self._percent = percent - percent % PERCENT_STEP
            self.note(f"cutting: {self._percent} %, segment {segment} of {segments}")

    def outcome(self, state: Interlock, paths: Paths, stop: dict[str, Any] | None = None) -> None:
        """The last lines: what came of it, why, and where the log is; after a stop also what is to be known and done."""
        if stop is not None:
            first, *rest = stop_lines(stop)
            self._output.print(lambda: Group("", first), soft_wrap=True)
            self._output.print(lambda: Group(*rest))
        self._output.print(lambda: outcome_lines(state, paths, told=stop is not None), soft_wrap=True)


def verdict_lines(answer: Answer) -> Group:
    """The verdict, every boundary, where the cut lies by the document that is recorded, and what looks wrong."""
    document = answer.document
    tips = {name: entry["tip_mm"] for name, entry in document["boundaries"].items()}
    facts = facts_table(where_facts(document["extent"], answer.proved, tips))
    more = [caution_line(caution) for caution in answer.cautions]
    if (elbow := document.get("other_elbow")) is not None:
        more.append(Text(f"Other elbow: {printable(elbow['text'])}"))
    apart = [part for line in more for part in ("", line)]
    return Group(headline(answer.proved), "", boundaries_table(answer.proved), "", facts, *apart, "")


def approach_line(approach: ApproachVerdict) -> Text:
    """Approach and retract: the answer in one line, and what decided it."""
    verdict_text, style = ("ADMISSIBLE", GOOD) if approach.admissible else ("INADMISSIBLE", BAD)
    lengths = f", entry {approach.entry_um / 1000:.3f} mm, exit {approach.exit_um / 1000:.3f} mm"
    return Text.assemble("approach and retract ", (verdict_text, style), f"{lengths}: {summary(approach)}")


def stopped(session: Session) -> dict[str, Any] | None:
    """What is told after a stop; None where the session did not end by one."""
    state, view, where = session.state, session.state.controller, session.stopped_in
    if state.phase is not Phase.STOPPED or where is None:
        return None
    collected, verdict = state.collected, state.verdict
    permitted = None
    if (
        collected.calibration is not None
        and collected.tool is not None
        and verdict is not None
        and verdict.approach
    ):
        permitted = Way(state.job.path, collected.calibration, collected.tool, verdict.approach.entry_um)
    progress, joints_u = session.last_seen
    return stop_document(
        Stopped(
            cause=state.cause,
            reason=state.reason,
            phase=where,
            at_rest=view is not None and view.state in AT_REST,
            latched=view is not None and view.state is ControllerState.FAULT,
            standing=view.cause if view is not None else StopCause.NONE,
            progress=progress,
            joints_u=joints_u,
        ),
        permitted,
    )


def outcome_lines(state: Interlock, paths: Paths, *, told: bool = False) -> Group:
    """What came of it and why, unless it is told already, and where the log is."""
    ending = ENDINGS[state.phase]
    reason = f": {printable(state.reason)}" if state.reason else ""
    lines: list[RenderableType] = (
        [""]
        if told
        else ["", Text.assemble((ending.headline, GOOD if ending.exit_code == OK else BAD), reason)]
    )
    if state.job.simulation_allowed_by:
        lines.append(Text(printable(_simulation(state)), BAD))
    if state.controller is not None:
        seen = _controller(state.controller.state, state.controller.cause)
        lines.append(Text(f"controller: last seen {seen}, before the session ended"))
    not_closed = "" if paths.closed else f"  NOT CLOSED: {paths.reason}"
    lines.append(Text(printable(f"audit log:  {paths.log}{not_closed}")))
    lines.append(Text(printable(f"raw frames: {paths.candump}")))
    return Group(*lines)


def _controller(state: ControllerState, cause: StopCause) -> str:
    return state.name if cause is StopCause.NONE else f"{state.name} ({cause.name}, to be acknowledged)"


def _simulation(state: Interlock) -> str:
    """Who allowed a simulation, and what the controller announced."""
    scale = state.session and state.session.time_scale
    speed = (
        "no controller announced itself"
        if scale is None
        else f"the plant runs {scale:g} times as fast as the clock"
    )
    return f"simulation: allowed by {state.job.simulation_allowed_by}; {speed}"


def run_document(
    state: Interlock, answer: Answer | None, paths: Paths, stop: dict[str, Any] | None
) -> dict[str, Any]:
    """What ``run --json`` prints."""
    view = state.controller
    return {
        "schema": SCHEMA,
        "outcome": ENDINGS[state.phase].document,
        "cause": state.cause.name,
        "reason": state.reason,
        "stop": stop,
        "controller": view and {"state": view.state.name, "cause": view.cause.name, "epoch": view.epoch},
        "session": state.session.digest.hex() if state.session else None,
        "simulation": None
        if not state.job.simulation_allowed_by
        else {
            "allowed_by": state.job.simulation_allowed_by,
            "time_scale": state.session.time_scale if state.session else None,
        },
        "check_points": [one._asdict() for one in state.job.check_points.points],
        "verdict": answer.document if answer else None,
        "approach": answer.approach_document if answer else None,
        "log": {
            "mcap": str(paths.log),
            "candump": str(paths.candump),
            "closed": paths.closed,
            "reason": paths.reason,
        },
    }
