"""Randomised fault injection: whatever fails, nothing moves that must not, every log tells the truth, and afterwards a cut succeeds.

CUTGATE_FAULT_RUNS and CUTGATE_SEED change how many and which; ``make test-long`` plays many.
"""

import json
import os
import shutil
from collections import Counter
from dataclasses import replace

import can
import pytest

from cutgate.firmware_sim import table as controller
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.state import HeartbeatLost, InputsChanged
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.interlock import table as interlock
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import OperatorCommand, Phase, RecordDurable
from cutgate.runtime.session.job import make_job, read_files
from tests.fault_injection.injection import Injection, reboot
from tests.fault_injection.oracle import Oracle
from tests.runtime.session.pair import NOW, job_of, pair_of
from tests.seeds import seeds

SESSIONS = 3
PATIENCE_S = 12.0
"""Longer than any deadline of these sessions but the permit's lifetime, which no run waits for."""
SHORT = {"transfer_timeout_s": 3.0, "announce_wait_s": 3.0, "operator_wait_s": 3.0, "verify_timeout_s": 5.0}
SHOCK_S = 0.5
FIRST = int(os.environ.get("CUTGATE_SEED", "1"))
MANY = int(os.environ.get("CUTGATE_FAULT_RUNS", "2000"))


class Play:
    """Sessions one after the other; in each the faults begin somewhere and lasts a while."""

    def __init__(self, pair, seed, only):
        self.pair, self.injection, self.oracle = pair, Injection(pair, seed, only), Oracle(pair)
        self.job = replace(pair.job, deadlines=replace(pair.job.deadlines, **SHORT))
        self.oracle.controller_powered()
        self.process = pair.process
        self.registrations = 1

    def run_cycle(self):
        """One turn of everybody; a controller whose bus has failed is switched off and on."""
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

    def session(self, injection_s=0.0):
        """One session; how it ended, or None if the process was killed."""
        pair, injection = self.pair, self.injection
        injection.crashed = False
        pair.begin(self.job)
        self.oracle.session_begins()
        begin_s = pair.clock() + (injection.draw.expovariate(2.0) if injection_s else PATIENCE_S)
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
        injection.clear()
        injection.note(f"session {'killed' if injection.crashed else pair.phase}: {pair.state.reason}")
        phase = pair.phase
        self.oracle.session_ends(crashed=injection.crashed)
        return None if injection.crashed else phase

    def recover(self):
        """What people do afterwards: release everything, switch the controller on anew where its limits were changed."""
        pair = self.pair
        pair.session = None
        for _ in range(round(SHOCK_S / pair.cycle_s)):  # whatever happened, nobody stirs at first
            self.run_cycle()
        if pair.controller.holdings.limits != self.job.limits:
            reboot(self.injection)
        if not pair.controller.inputs.emergency_stop_clear:
            pair.controller_terminal.type(ConsoleCommand.ESTOP)
        pair.controller_terminal.type(ConsoleCommand.RELEASE)
        for _ in range(round(1.0 / pair.cycle_s)):
            self.run_cycle()
        if self.job.registration in pair.controller.memory.withdrawn:
            self.registrations += 1
            pair.files, job = registered_anew(pair, self.registrations)
            self.job = replace(job, timing=self.job.timing)


def registered_anew(pair, number):
    """The same bone at the same place, registered once more."""
    folder = pair.directory / f"registration {number}"
    folder.mkdir()
    registration = json.loads(pair.files.prepared.registration.data) | {"id": f"again {number}"}
    for name, data in (
        ("plan.csv", pair.files.prepared.plan.data),
        ("robot.toml", pair.files.robot.data),
        ("registration.json", json.dumps(registration).encode()),
    ):
        (folder / name).write_bytes(data)
    files = read_files(
        *(folder / name for name in ("plan.csv", "robot.toml", "registration.json")),
        None,
        None,
        allow_simulated=True,
    )
    return files, make_job(files, now=NOW)


def play(tmp_path, tmp_path_factory, seed, only=None):
    """One run over several sessions, and the cut after it."""
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as pair:
        scene = Play(pair, seed, only)
        for _ in range(SESSIONS):
            scene.session(injection_s=scene.injection.draw.uniform(0.02, 1.5))
            scene.recover()
        assert scene.session() is Phase.DONE, "\n".join([*scene.injection.fell, *pair.said[-20:]])
        pair.run(0.2)
        assert pair.controller.state is ControllerState.INHIBITED
        return scene


@pytest.mark.parametrize("number", seeds(12, 12))
def test_under_faults_nothing_moves_that_must_not_and_afterwards_a_cut_succeeds(
    tmp_path, tmp_path_factory, number
):
    play(tmp_path, tmp_path_factory, FIRST + number)


@pytest.mark.long
def test_many_runs(tmp_path_factory):
    ends = Counter()
    for seed in range(FIRST, FIRST + MANY):
        folder = tmp_path_factory.mktemp("run")
        ends.update(play(folder, tmp_path_factory, seed).oracle.ends)
        shutil.rmtree(folder)
    print(f"{MANY} runs from seed {FIRST} on; how their sessions ended: {dict(ends.most_common())}")  # noqa: T201 - long work says what it did
    assert ends[Phase.STOPPED] > MANY / 2, "most sessions have something to stop for"


# ---------------------------------------------------------------- the oracle sees


def _no_time_out(patch):
    patch.setitem(controller.EVERYWHERE, HeartbeatLost, lambda state, _event, _now_s: (state, ()))


def _device_not_looked_at(patch):
    def changed(state, event, _now_s):
        return replace(
            state, inputs=event.inputs, device=controller._cycle(state.device, event.inputs.device_pressed)
        ), ()

    patch.setitem(controller.EVERYWHERE, InputsChanged, changed)


def _bone_motion_not_listed(patch):
    patch.setattr(controller, "WITHDRAWING", frozenset())


def _opening_clears_a_latch(patch):
    opened = controller.open_session

    def clears(state, event):
        after, effects = opened(state, event)
        return replace(after, state=ControllerState.OPEN, cause=StopCause.NONE), effects

    patch.setattr(controller, "open_session", clears)


def _nothing_waits_for_the_disk(patch):
    authorise = interlock._authorise

    def leaves_at_once(state, phase, purpose, record, now_s, **changes):
        pending, committed = authorise(state, phase, purpose, record, now_s, **changes)
        after, sent = interlock.step(pending, RecordDurable(pending.token), now_s)
        return after, (*committed, *sent)

    patch.setattr(interlock, "_authorise", leaves_at_once)


SEEDED = {
    "the arm moved 0.": (_no_time_out, "the runtime is killed"),
    "the device released": (_device_not_looked_at, "somebody does something at the controller"),
    "the registration of a bone that had moved": (
        _bone_motion_not_listed,
        "somebody does something at the controller",
    ),
    "a latch was left": (_opening_clears_a_latch, "misaddressed"),
    "left before its record was durable": (_nothing_waits_for_the_disk, "the disk is slow"),
}
"""What the oracle says, the guard taken out for it, and the injection that needs the guard."""
TRIES = 30


@pytest.mark.parametrize("said", SEEDED)
def test_the_witness_sees_what_a_missing_guard_lets_happen(tmp_path, tmp_path_factory, monkeypatch, said):
    take_out, needed = SEEDED[said]
    take_out(monkeypatch)
    for seed in range(TRIES):
        folder = tmp_path / f"{seed}"
        folder.mkdir()
        try:
            play(folder, tmp_path_factory, seed, only=needed)
        except AssertionError as found:
            if said in str(found):
                return
    raise AssertionError(f"not seen in {TRIES} runs: {said}")
