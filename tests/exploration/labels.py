"""Moves in a few words, for charts."""

from typing import Any

from cutgate.firmware_sim import state as c
from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX
from cutgate.protocol.states import FaultCode, StopCause
from cutgate.runtime.interlock import state as r
from tests.exploration.names import TOKEN
from tests.firmware_sim.controllers import START_JOINTS

SAMPLE_OLD, PERMIT_OLD, COMMIT_OLD, NONCE_OLD, LATE = 0.2, 121.0, 1.5, 3.0, 1e6
"""How late something is looked at, s: each beyond the bound it is named after."""
ARRIVED = 0.05
"""So late that the arm can be back."""


def lateness(late_s: float, first: Any) -> str:
    """What was chosen about age and place."""
    late = {
        0.0: "",
        1.0: ", late",
        ARRIVED: ", in time",
        SAMPLE_OLD: ", joints too old",
        PERMIT_OLD: ", too late",
        COMMIT_OLD: ", too late",
        NONCE_OLD: ", too late",
        LATE: ", deadline passed",
    }[late_s]
    match first:
        case r.ProgressReported():
            return f"{late}, after {describe(first)}"
        case r.JointsMeasured() | c.JointsMeasured():
            return late + ("" if first.joints_u == START_JOINTS else ", the arm away from the start")
    return late


def describe(event: Any) -> str:  # noqa: C901 - one line for each kind
    """An event, record or frame in a few words."""
    name = type(event).__name__
    match event:
        case r.CommandGiven(command=command, what=what):
            return f"says {command} {what}".strip()
        case c.HeartbeatReceived(code=code, cause=cause, fresh=fresh):
            return f"heartbeat {code.name}{_named(cause)}{'' if fresh else ', stale'}"
        case r.HeartbeatReceived(view=view, fresh=fresh):
            pressed = "pressed" if view.device_pressed else "released"
            return f"heartbeat {view.state.name}{_named(view.cause)}, device {pressed}{'' if fresh else ', stale'}"
        case c.InputsChanged(inputs=inputs):
            pressed = "pressed" if inputs.device_pressed else "released"
            return f"device {pressed}{'' if inputs.emergency_stop_clear else ', emergency stop pressed'}"
        case r.FaultReceived(code=code, cause=cause) | c.StopReceived(code=code, cause=cause):
            return f"{'fault' if isinstance(code, FaultCode) else 'stop'} {code.name}{_named(cause)}"
        case c.FaultArisen(cause=cause) | r.Failed(cause=cause):
            return f"fault{_named(cause)}"
        case r.Gone(cause=cause):
            return f"gives up{_named(cause)}"
        case (
            r.ReplyReceived(request_type=kind, refusal=refusal)
            | records.Reply(request_type=kind, refusal=refusal)
        ):
            return f"reply to {records.RECORDS[kind].__name__}: {refusal.name}"
        case records.NonceRequest() | c.NonceRequested() | records.Nonce() | r.NonceReceived():
            return f"{name} {event.purpose.name}"
        case c.AcknowledgeReceived(acknowledge=asked):
            return f"{name}{_named(asked.cause)}"
        case r.VerdictReady(verdict=verdict):
            return f"verdict {'admissible' if verdict.admissible and verdict.approach else 'inadmissible'}"
        case r.JointsMeasured(joints_u=joints_u):
            return f"joints {'on' if joints_u == START_JOINTS else 'off'} the path"
        case r.ProgressReported(segment=segment, fraction=fraction):
            return f"progress segment {segment}, fraction {fraction / FRACTION_MAX:g}"
        case r.RecordDurable(token=token):
            return f"{'record' if token == TOKEN else 'older record'} durable"
    return name


def _named(cause: StopCause) -> str:
    return "" if cause is StopCause.NONE else f" ({cause.name})"
