"""Randomised fault injection: whatever fails and whoever attacks, nothing moves that must not, every log tells the truth, and afterwards a cut succeeds.

CUTGATE_FAULT_RUNS and CUTGATE_SEED change how many and which; ``make test-long`` plays many.
"""

import os
import shutil
from collections import Counter
from dataclasses import replace

import pytest

from cutgate.firmware_sim import table as controller
from cutgate.firmware_sim.state import HeartbeatLost, InputsChanged, Memory, OpenReceived, StopReceived
from cutgate.protocol import link, records
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.states import WITHDRAWING, ControllerState, Refusal, StopCause
from cutgate.runtime.interlock import table as interlock
from cutgate.runtime.interlock.state import Phase, RecordDurable, ReplyReceived
from tests.fault_injection.play import Play
from tests.runtime.session.pair import job_of, pair_of
from tests.seeds import seeds

pytestmark = pytest.mark.no_cover  # whole sessions, one a fault: measured they take three times as long

SESSIONS = 3
FIRST = int(os.environ.get("CUTGATE_SEED", "1"))
MANY = int(os.environ.get("CUTGATE_FAULT_RUNS", "2000"))


def play(tmp_path, tmp_path_factory, seed, only=()):
    """One run over several sessions, and the cut after it."""
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as pair:
        scene = Play(pair, seed, only)
        for _ in range(SESSIONS):
            scene.session(injection_s=scene.injection.draw.uniform(0.02, 1.5))
            scene.recover()
        if (
            pair.controller.memory.withdrawal_due
        ):  # told with the next session, which has an earlier registration
            scene.session()
            scene.recover()
        assert scene.session() is Phase.DONE, "\n".join([*scene.injection.fell, *pair.said[-20:]])
        pair.run(0.2)
        scene.oracle.at_rest()
        assert not scene.oracle.wrong, scene.oracle.wrong
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
    patch.setattr(controller, "_with_motion", lambda state, _now_s: state)


def _opening_clears_a_latch(patch):
    def clears(state, event, now_s):
        after, effects = controller.open_received(state, event, now_s)
        if after is state:
            return after, effects
        return replace(after, state=ControllerState.OPEN, cause=StopCause.NONE), effects

    patch.setitem(controller.EVERYWHERE, OpenReceived, clears)


def _nothing_waits_for_the_disk(patch):
    authorise = interlock._authorise

    def leaves_at_once(state, phase, purpose, record, now_s, **changes):
        pending, committed = authorise(state, phase, purpose, record, now_s, **changes)
        tree = records.TreeHead(bytes([1]) * 16, pending.token + 1, bytes(32))
        durable = RecordDurable(pending.token, tree)
        after, sent = interlock.step(pending, durable, now_s)
        return after, (*committed, *sent)

    patch.setattr(interlock, "_authorise", leaves_at_once)


def _any_tag_fits(patch):
    patch.setattr(link, "_fits", lambda _made, _sent: True)


def _any_code_fits(kind):
    def take_out(patch):
        judged = Endpoint._authentic

        def fits(endpoint, record, sequence):
            return isinstance(record, kind) or judged(endpoint, record, sequence)

        patch.setattr(Endpoint, "_authentic", fits)

    return take_out


def _announce_nonce_stays(patch):
    def stays(state, event, now_s):
        after, effects = controller.open_received(state, event, now_s)
        return replace(after, announce_nonce=state.announce_nonce), effects

    patch.setitem(controller.EVERYWHERE, OpenReceived, stays)


def _time_out_from_arrival(patch):
    refresh = link.Link._refresh

    def refreshed(side, echo, now_s):
        fresh = refresh(side, echo, now_s)
        if fresh:
            side._refreshed_s = now_s
        return fresh

    patch.setattr(link.Link, "_refresh", refreshed)


def _stops_withdraw(patch):
    def withdraws(state, event, now_s):
        moved = event.cause in WITHDRAWING
        return controller.stop_received(
            controller._with_motion(state, now_s) if moved else state, event, now_s
        )

    patch.setitem(controller.EVERYWHERE, StopReceived, withdraws)


def _every_withdraw_settles(patch):
    with_barrier = Memory.with_barrier
    patch.setattr(
        Memory, "with_barrier", lambda memory, *told, settles: with_barrier(memory, *told, settles=True)
    )


def _replies_believed(patch):
    refused = interlock.TABLE[Phase.PERMITTING, ReplyReceived]

    def believed(state, event, now_s):
        if event.refusal is Refusal.ACCEPTED and event.request_type == records.Permit.TYPE:
            return interlock._enter(state, Phase.PERMITTED, now_s), ()
        return refused(state, event, now_s)

    patch.setitem(interlock.TABLE, (Phase.PERMITTING, ReplyReceived), believed)


PERSON = "somebody does something at the controller"
KILLED = "the runtime is killed"
SEEDED = {
    "no time-out": (_no_time_out, (KILLED,), "after the runtime last said CUT"),
    "the device is not looked at": (_device_not_looked_at, (PERSON,), "the device released"),
    "a motion is not listed": (_bone_motion_not_listed, (PERSON,), "of a bone that had moved"),
    "an OPEN clears a latch": (_opening_clears_a_latch, ("misaddress",), "a latch was left"),
    "nothing waits for the disk": (
        _nothing_waits_for_the_disk,
        ("the disk is slow",),
        "left before its record was durable",
    ),
    "any tag fits": (
        _any_tag_fits,
        ("he takes the runtime's place and says CUT",),
        "after the runtime last said CUT",
    ),
    "any code of an OPEN fits": (
        _any_code_fits(records.Open),
        ("he rewrites a record of the runtime",),
        "no holder of the key asked for",
    ),
    "any code of a permit fits": (
        _any_code_fits(records.Permit),
        ("he rewrites a code of the runtime",),
        "cutting mode without a permit",
    ),
    "any code of a withdrawal fits": (
        _any_code_fits(records.Withdraw),
        ("he withdraws",),
        "a barrier was raised without",
    ),
    "any code of an OPENED fits": (
        _any_code_fits(records.Opened),
        ("he rewrites a code of the controller",),
        "an OPENED that the controller did not say",
    ),
    "the announce nonce stays": (_announce_nonce_stays, ("he says an OPEN again",), "opened twice"),
    "the time-out runs from arrival": (
        _time_out_from_arrival,
        (KILLED, "he delays the runtime"),
        "after the runtime last said CUT",
    ),
    "a withdrawal of before settles": (
        _every_withdraw_settles,
        (PERSON,),
        "forgotten in its own session",
    ),
    "a stop withdraws": (_stops_withdraw, ("he stops",), "though neither a keyed word nor a wired input"),
    "a reply is believed": (_replies_believed, ("he accepts",), "which no heartbeat of the controller said"),
}
"""The guard taken out, what happens that needs the guard, and what the oracle says."""
TRIES = 60


@pytest.mark.parametrize("guard", SEEDED)
def test_the_oracle_sees_what_a_missing_guard_lets_happen(tmp_path, tmp_path_factory, monkeypatch, guard):
    take_out, needed, said = SEEDED[guard]
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
