"""Ways without faults to places from which seeded faults are looked for: moves by name."""

from dataclasses import replace

import cutgate.firmware_sim.table
from cutgate.firmware_sim.state import FaultArisen
from cutgate.protocol.states import StopCause
from tests.exploration.canonical import canonical_controller
from tests.exploration.names import EPOCH
from tests.exploration.world import POWERED_UP

LATCHED = replace(
    canonical_controller(
        cutgate.firmware_sim.table.step(POWERED_UP, FaultArisen(StopCause.SECOND_NODE), 0.0)[0]
    ),
    epoch=EPOCH,
)
LATCHED = replace(LATCHED, written=LATCHED.memory)

TO_VERIFYING = (
    "person: starts a session",
    "controller: announces itself",
    "controller: sends its heartbeat",
    "runtime: sends its heartbeat",
)
TO_PERMITTED = (
    *TO_VERIFYING,
    "worker: verdict admissible",
    "disk: record durable",
    "controller: sends its heartbeat",
    "person: device pressed",
    "controller: sends its heartbeat",
)
TO_MOVING = (
    *TO_PERMITTED,
    "operator: says start",
    "disk: record durable",
    "runtime: sends its heartbeat",
)
TO_RESET = (
    "person: starts a session",
    "controller: announces itself",
    "controller: sends its heartbeat",
    "runtime: sends its heartbeat",
    "operator: says acknowledge",
    "controller: sends its heartbeat",
    "operator: says reset",
)
