"""Sessions of a pair under faults, with everything around them: who leads, what people do afterwards, how long it lasts."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import can

from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.protocol.states import StopCause
from cutgate.runtime.interlock.permissives import awaiting_confirmation
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import OperatorCommand, Phase
from cutgate.runtime.session.job import make_job, read_files
from tests.fault_injection.injection import ACTS, Injection, reboot
from tests.fault_injection.middle import ATTACKS, FRAME_ATTACKS
from tests.fault_injection.oracle import Oracle
from tests.runtime.audit.build import inputs
from tests.runtime.session.pair import ADMISSIBLE_MM, PLACED, SKEW_S

PATIENCE_S = 12.0
"""Longer than any deadline of these sessions but the permit's lifetime, which no run waits for."""
SHORT = {"transfer_timeout_s": 3.0, "announce_wait_s": 3.0, "operator_wait_s": 3.0, "verify_timeout_s": 5.0}
SHOCK_S = 0.5


class Play:
    """Sessions one after the other; in each the faults begin somewhere and lasts a while."""

    def __init__(self, pair, seed, only):
        self.pair, self.oracle = pair, Oracle(pair)
        self.injection = Injection(pair, seed, FRAME_ATTACKS, ACTS | ATTACKS, only)
        self.job = replace(pair.job, deadlines=replace(pair.job.deadlines, **SHORT))
        self.oracle.controller_powered()
        self.process = pair.process
        self.registrations = 1

    def run_cycle(self):
        """One cycle of everybody; a controller whose bus has failed is switched off and on."""
        pair = self.pair
        self.injection.strike()
        self._new_controller()
        try:
            pair.run_cycle()
        except can.CanError:
            self.injection.note("the controller's process ended")
            reboot(self.injection)
        self._new_controller()
        self.oracle.look()
        assert not self.oracle.wrong, "\n".join([*self.injection.fell, *self.oracle.wrong])

    def _new_controller(self):
        if self.pair.process is not self.process:
            self.process = self.pair.process
            self.oracle.controller_powered()

    def lead(self):
        """What a patient operator does next."""
        pair, view = self.pair, self.pair.state.controller
        pair._lead()
        if pair.phase is Phase.HELD and view is not None:
            self.pair.terminal.type(
                OperatorCommand.RESET if view.cause is StopCause.NONE else OperatorCommand.ACKNOWLEDGE
            )
        if pair.phase is Phase.ADMITTED:
            for warning in awaiting_confirmation(pair.state):
                pair.terminal.type(f"{OperatorCommand.CONFIRM} {warning}")

    def _wait_s(self):
        """Until the faults begin: in most sessions somewhere before the cut."""
        return self.injection.draw.expovariate(self.injection.draw.choice((2.0, 10.0, 50.0)))

    def session(self, injection_s=0.0):
        """One session; how it ended, or None if the process was killed."""
        pair, injection = self.pair, self.injection
        injection.crashed = False
        pair.begin(self.job)
        self.oracle.session_begins()
        begin_s = pair.clock() + (self._wait_s() if injection_s else PATIENCE_S)
        end_s, patience_s = begin_s + injection_s, pair.clock() + injection_s + PATIENCE_S
        while pair.phase not in ENDED and not injection.crashed:
            assert pair.clock() < patience_s, "\n".join([*injection.fell, f"{pair.phase} {pair.said}"])
            if begin_s <= pair.clock() < end_s and not injection.blowing:
                injection.note(f"faults begin, {pair.phase}")
                injection.blowing = True
            if pair.clock() >= end_s and injection.blowing:
                injection.clear()
            self.lead()
            self.run_cycle()
        injection.note(f"session {'killed' if injection.crashed else pair.phase}: {pair.state.reason}")
        phase = pair.phase
        self.oracle.session_ends(crashed=injection.crashed)
        return None if injection.crashed else phase

    def recover(self):
        """What people do afterwards: release everything, switch the controller on anew where its limits were changed.

        What had begun goes on for a while after the runtime is gone.
        """
        pair, ended = self.pair, self.pair.state
        pair.session = None
        for _ in range(round(SHOCK_S / pair.cycle_s)):  # whatever happened, nobody stirs at first
            self.run_cycle()
        self.injection.clear()
        self.oracle.at_rest()
        self.run_cycle()  # what somebody has said while the controller stood still is heard first
        if pair.controller.holdings.limits != self.job.limits:
            reboot(self.injection)
        if not pair.controller.inputs.emergency_stop_clear:
            pair.controller_terminal.type(ConsoleCommand.ESTOP)
        pair.controller_terminal.type(ConsoleCommand.RELEASE)
        for _ in range(round(1.0 / pair.cycle_s)):
            self.run_cycle()
        memory = pair.controller.memory
        if (
            ended.registration_withdrawn
            or memory.withdrawal_due
            or memory.barrier_us >= self.job.registration_time_us
        ):
            self.registrations += 1
            pair.files, job = registered_anew(pair, self.registrations)
            self.job = replace(job, deadlines=self.job.deadlines)


def registered_anew(pair, number):
    """The bone where it stands now, registered once it can be told that this was later."""
    folder = pair.directory / f"registration {number}"
    folder.mkdir()
    moved = inputs(ADMISSIBLE_MM + 0.1 * number)
    pair.clock.now_s += SKEW_S + 2.0
    at = datetime.fromtimestamp(pair.clock.utc_ns() / 1e9, UTC)
    registration = json.loads(moved.registration) | {"created_utc": at.strftime("%Y-%m-%dT%H:%M:%SZ")}
    for name, data in (
        ("plan.csv", moved.plan),
        ("robot.toml", moved.robot.data),
        ("registration.json", json.dumps(registration).encode()),
    ):
        (folder / name).write_bytes(data)
    files = read_files(
        *(folder / name for name in ("plan.csv", "robot.toml", "registration.json")),
        None,
        None,
        allow_simulated=True,
    )
    job = make_job(files, now=at)
    PLACED[job.registration] = files.placed
    return files, job
