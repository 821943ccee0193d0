"""What the page says between its pictures and tables."""

from typing import Final

INTRODUCTION: Final = """# State machines

Generated from the code by `make docs`; change it there. Every arrow and every row was taken by the real `step` of
`runtime/interlock/table.py` or `firmware_sim/table.py`, from a state that is reached from power-up. Events, effects and
handlers bear the names they have in the code. After the slash stands what leaves.
"""
RUNTIME_WAY: Final = """What enables (permit, start) leaves only from the two phases AUTHORISING, when its record is durable and every
permissive has held once more at that moment. The controller's word for the end leads to FINISHING, where the heartbeat
says INHIBIT again: the joints measured next must show the arm back. Stops are left out here; they stand below.
"""
RUNTIME_HELD: Final = """A controller that carries a stop cause or a latched fault is acknowledged and reset by the operator; the reset passes
the audit log like a permit.
"""
RUNTIME_ENDS: Final = """Phases with the same ends share a box; a star marks an event that ends only some of them (the
rows below say which, and in which cases). REFUSED: nothing was enabled. STOPPING: a stop has left and its confirmation is awaited; permit,
nonce and pending record are void. A stop before there is a session ends at STOPPED at once.
"""
PHASES_TEXT: Final = """Defaults in seconds; a site sets them in `site.toml` ([constants.md](constants.md)). A heartbeat that reports anything
else than the controller may report in that phase stops. *Not judged*: the phase has a rule of its own, see its row
below.
"""
OWN: Final = """Where one case has several rows the permissives decide, or what was collected before. *Stays* with nothing that leaves:
at most something is remembered. An ended session (DONE, REFUSED, STOPPED) answers to nothing.
"""
PERMISSIVES: Final = """All of a list are judged each time, in this order, so that a person sees every reason at once. `IDENTITY` is judged when
a controller announces itself, `COLLECTED` when its records are complete, `FOR_RESET`, `FOR_PERMIT` and `FOR_START` when
the word or the nonce is due and again when the record is durable, `AT_START` once more when the controller reports the
end. What fails of `FINAL` can no longer come true, and ends the session at once.
"""
TRACKING: Final = """From the start on the table asks the tracking monitor (`runtime/interlock/tracking.py`) in every step with joints,
progress, DONE or the time. It begins with the reference trajectory of the very verdict that was permitted, and
remembers where the arm was at the earliest at the last sample and the last progress, and how far it can have come. A
sample is dated by when it was measured, whenever it came. What deviates stops in that step, and the decision in the
log holds the rules below with value and bound. What is tolerated, and why a sound arm never deviates:
[protocol.md](protocol.md#tracking). The path of the examples has two segments and takes 0.12 s.
"""
CONTROLLER_WAY: Final = """Requests that are refused change nothing and are not drawn. A start moves nothing yet: the arm moves while the last
fresh heartbeat says CUT with this epoch.
"""
CONTROLLER_STOPS: Final = """States with the same ends share a box; a star marks an event that stops only some of them: the rows below name them. A
stop voids permit, nonce, session, path and transfers and starts a new epoch; causes that latch, and every stop of a
latched controller, end at FAULT. INHIBITED and FAULT stop as well, and stay what they are.
"""
RULES: Final = """The first rule that does not hold answers with its refusal code. The state is the controller's own; `request` is the
record that arrived. A wrong authentication code is a masquerade and latches. An Open or Reset that passes waits for the
memory, and is refused with MEMORY_FAILED if that cannot be written.
"""
