"""What broke an earlier version of the protocol, or might have: played by real processes without the key, and of no avail.

Attackers may stop the arm and keep a session from opening; that they can do no more is what each test looks at: on the
bus, in the controller's memory, in the log.
"""

import json
import re
import signal
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.state import Memory
from cutgate.protocol import records
from cutgate.protocol.frames import (
    CONTROL_IDS,
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.records import Side
from cutgate.protocol.states import (
    WITHDRAWING,
    ControllerState,
    FaultCode,
    Refusal,
    RuntimeCode,
    StopCause,
    StopCode,
)
from cutgate.runtime.audit.inspect import Status
from tests.system.attackers import (
    Middle,
    Stranger,
    guessed,
    raw,
    remembered,
    saying,
    sealed,
    withdrawn_anywhere,
)
from tests.system.harness import FAST, IN_TIME, SITE, Rig, decoded, is_kind, moved_after

pytestmark = pytest.mark.processes

ROUND = 256
"""Heartbeats until a counter of eight bits comes again."""
FORGED_OPENS = 10
STOCK = 8
"""CUT heartbeats that are held back: less than half a time-out of them."""


@pytest.fixture
def stranger(rig):
    """One more node on the bus."""
    made = Stranger(rig)
    yield made
    made.close()


@pytest.fixture
def middle(rig, tmp_path):
    """A node between controller and runtime, each on a bus of its own."""
    (tmp_path / "far").mkdir()
    with Rig(tmp_path / "far") as far:
        made = Middle(rig, far)
        yield made
        made.close()


def at(rig, message) -> int:
    """Where on the bus a frame was seen first, by its bytes."""
    sent = (message.arbitration_id, bytes(message.data))
    return next(n for n, m in enumerate(list(rig.bus.frames)) if (m.arbitration_id, bytes(m.data)) == sent)


def again(rig, start, *, cause: StopCause, latched: bool) -> None:
    """The next session with the same registration is permitted, once a person has seen the cause."""
    run = start()
    run.line(f"its cause is {cause.name}")
    run.say("acknowledge")
    if latched:
        run.line("say reset")
        run.say("reset")
    run.line("permitted:")
    run.say("quit")
    assert run.exit() == 3


# ---------------------------------------------------------------- whoever opens the session


def test_a_node_in_between_that_puts_every_record_together_anew_is_not_noticed(middle):
    """What it rewrites in the other tests is therefore what they fail by."""
    rig = middle.controller
    middle.rewrite = lambda envelope: [envelope.record]
    sim, run = rig.cutting(scale=FAST, **middle.there)
    assert run.exit() == 0
    assert rig.at_rest(sim) == "INHIBITED"


@pytest.mark.parametrize("what", ["timing", "registration", "registration's time"])
def test_an_open_that_was_rewritten_on_its_way_opens_nothing(middle, what):
    rig = middle.controller
    (rig.folder / "site.toml").write_text(SITE.replace("timeout_ms = 1000", "timeout_ms = 400"))

    def otherwise(envelope):
        request = envelope.record
        if not isinstance(request, records.Open):
            return [request]
        changes = {
            "timing": {"timing": replace(request.timing, timeout_ms=1000)},
            "registration": {"registration_digest": bytes(32), "place_digest": bytes(32)},
            "registration's time": {"registration_time_us": 1 << 60},
        }
        return [replace(request, **changes[what])]

    middle.rewrite = otherwise
    run, sim = middle.run(), rig.sim()
    assert run.exit() == 1
    assert "MAC_INVALID" in run.told
    sim.line("refused: MAC_INVALID")
    assert rig.at_rest(sim) == "INHIBITED"
    (asked,) = {
        e.record
        for e in middle.runtime.bus.records(CONTROL_IDS[Side.RUNTIME])
        if isinstance(e.record, records.Open)
    }
    (heard,) = {
        e.record for e in rig.bus.records(CONTROL_IDS[Side.RUNTIME]) if isinstance(e.record, records.Open)
    }
    assert (asked != heard, asked.mac == heard.mac, asked.timing.timeout_ms) == (True, True, 400)
    assert not rig.bus.all(ControllerHeartbeat)  # no session
    assert remembered(rig) == Memory()


def test_an_open_of_the_past_opens_nothing(rig, stranger):
    """The last one to the bit, one before it, and both after a loss of power."""
    sim = rig.sim()
    for _ in range(2):
        run = rig.run()
        run.line("permitted:")
        run.say("quit")
        assert run.exit() == 3
        assert rig.at_rest(sim) == "INHIBITED"
    first, last = stranger.read(records.Open)
    sim.listen()
    sessions, mark = sim.told.count("state OPEN"), len(rig.bus.frames)
    stranger.say(last)
    assert stranger.ask(first) is Refusal.ANNOUNCE_NONCE
    assert rig.at_rest(sim) == "INHIBITED"
    assert sim.told.count("state OPEN") == sessions
    sim.signal(signal.SIGINT)
    assert sim.exit() == 0
    sim = rig.sim()
    rig.at_rest(sim)
    for request in (last, first):
        assert stranger.ask(request) is Refusal.ANNOUNCE_NONCE
    assert rig.at_rest(sim) == "INHIBITED"
    assert "state OPEN" not in sim.told
    assert not any(is_kind(m, ControllerHeartbeat) for m in rig.bus.frames[mark:])


def test_forged_opens_leave_nothing_behind_in_a_memory_that_is_nearly_full(rig, stranger):
    """Each names another place; there is room for three, and the one that the runtime names needs one of it."""
    kept = memory.beside(rig.folder / "site.key")
    places = frozenset(number.to_bytes(32, "big") for number in range(REGISTRATIONS_MAX - 3))
    memory.save(kept, Memory(withdrawn=places))
    before = kept.read_bytes()
    run, sim = rig.run(), rig.sim()
    run.line("permitted:")
    run.say("quit")
    assert run.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED"
    (request,) = stranger.read(records.Open)
    announced = stranger.announcement().announce_nonce
    for number in range(FORGED_OPENS):
        place = (1 << 200 | number).to_bytes(32, "big")
        forged = replace(
            request,
            announce_nonce=announced,
            runtime_nonce=place[-16:],
            place_digest=place,
            registration_digest=place,
        )
        assert stranger.ask(forged) is Refusal.MAC_INVALID
    assert rig.at_rest(sim) == "INHIBITED"
    assert sim.told.count("state OPEN") == 1
    assert kept.read_bytes() == before
    last = rig.run()
    last.line("permitted:")
    last.say("quit")
    assert last.exit() == 3


# ---------------------------------------------------------------- keeping the arm in motion


def made_up(rig, stranger, last, seen):
    """In sequence, and in answer to the controller's last one: nothing but the tag is guessed."""
    beat = decoded(last)
    forged = replace(beat, echo=seen.data[2], tag=guessed(beat))
    return sealed(forged, last.data[2] + 1, stranger.tag)


def said_again(rig, stranger, last, seen):
    """The runtime's last word, as it was."""
    return raw(last.arbitration_id, bytes(last.data))


def of_a_round_before(rig, stranger, last, seen):
    """What the runtime itself said under the counter that comes next."""
    beats = [m for m in list(rig.bus.frames) if is_kind(m, RuntimeHeartbeat)]
    old = beats[beats.index(last) + 1 - ROUND]
    assert (old.data[2] - last.data[2]) % ROUND == 1
    return raw(old.arbitration_id, bytes(old.data))


@pytest.mark.parametrize(
    ("forge", "ends"),
    [
        (made_up, "FAULT (AUTHENTICATION_FAILED)"),
        (said_again, "INHIBITED (HEARTBEAT_LOST)"),
        (of_a_round_before, "FAULT (AUTHENTICATION_FAILED)"),
    ],
)
def test_nobody_carries_on_for_a_runtime_that_hangs(rig, stranger, forge, ends):
    """He speaks for it once in every turn of the controller, while the arm moves."""
    in_time = IN_TIME
    if forge is of_a_round_before:
        (rig.folder / "site.toml").write_text(SITE.replace("heartbeat_ms = 50", "heartbeat_ms = 10"))
        in_time = 102
    sim, run = rig.cutting()
    if forge is of_a_round_before:
        rig.until(lambda: sum(is_kind(m, RuntimeHeartbeat) for m in list(rig.bus.frames)) > ROUND)
    run.signal(signal.SIGSTOP)
    rig.until(lambda: run.stopped)
    rig.bus.single(ControllerHeartbeat, after=len(rig.bus.frames))  # the runtime's last one has been seen
    last = [m for m in list(rig.bus.frames) if is_kind(m, RuntimeHeartbeat)][-1]
    assert decoded(last).code is RuntimeCode.CUT
    stopped, said = None, 0
    while stopped is None and said < 2 * in_time:
        seen = rig.bus.frame(
            lambda m: is_kind(m, ControllerHeartbeat) or is_kind(m, ControllerFault),
            after=len(rig.bus.frames),
        )
        stopped = next((m for m in list(rig.bus.frames) if is_kind(m, ControllerFault)), None)
        if stopped is None:
            stranger.send(forge(rig, stranger, last, seen))
            said += 1
    assert stopped is not None, "the arm moves although the runtime stands still"
    assert said > 0
    assert rig.bus.beats(ControllerHeartbeat, after=at(rig, last), before=stopped) <= in_time
    assert rig.at_rest(sim) == ends
    assert not moved_after(rig, stopped.timestamp)
    assert "state DONE" not in sim.told


def swallowed(middle, message):
    return []


def turned_into_cut(middle, message):
    """What says INHIBIT says CUT, under its own tag."""
    return [saying(message, middle.tag, code=RuntimeCode.CUT, cause=StopCause.NONE)]


@pytest.mark.parametrize(
    ("instead", "ends"),
    [
        (swallowed, "INHIBITED (HEARTBEAT_LOST)"),
        (turned_into_cut, "FAULT (AUTHENTICATION_FAILED)"),
    ],
)
def test_an_operators_stop_that_is_swallowed_stops_within_the_time_out(middle, instead, ends):
    """The node in between takes the stop off the bus, and every heartbeat that says the same."""
    rig, kept = middle.controller, []

    def down(message):
        if is_kind(message, RuntimeStop):
            kept.append(message)
            return []
        if is_kind(message, RuntimeHeartbeat) and decoded(message).code is not RuntimeCode.CUT:
            kept.append(message)
            return instead(middle, message)
        return [message]

    sim, run = rig.cutting(**middle.there)
    middle.down = down
    run.say("stop")
    stopped = rig.bus.single(ControllerFault)
    assert rig.bus.beats(ControllerHeartbeat, after=at(rig, middle.genuine), before=stopped) <= IN_TIME
    assert run.exit() == 3
    assert {m.arbitration_id for m in kept} == {IDS[RuntimeStop], IDS[RuntimeHeartbeat]}
    assert rig.at_rest(sim) == ends
    assert not moved_after(rig, stopped.timestamp)
    assert rig.log().of("/audit/decision")[-1]["first_out"] == "OPERATOR_STOP"
    assert not rig.bus.all(RuntimeStop)


def test_heartbeats_that_were_held_back_gain_no_second_time_out(middle):
    """CUT, made by the runtime itself, kept in stock, and handed out one by one after the operator has said stop."""
    rig, stock, given, turns = middle.controller, [], [], []

    def hold(message):
        if not is_kind(message, RuntimeHeartbeat) and not is_kind(message, RuntimeStop):
            return [message]
        if is_kind(message, RuntimeHeartbeat) and decoded(message).code is RuntimeCode.CUT:
            stock.append(message)
        return []

    def hand_out(message):
        if stock and is_kind(message, ControllerHeartbeat):
            turns.append(message)
            number = len(given)
            if number < STOCK and len(turns) >= STOCK + 2 * (number + 1):
                given.append(stock[number])
                middle.say_down(stock[number])
        return [message]

    sim, run = rig.cutting(**middle.there)
    middle.up, middle.down = hand_out, hold
    rig.until(lambda: len(stock) >= STOCK)
    run.say("stop")
    stopped = rig.bus.single(ControllerFault)
    assert run.exit() == 3
    assert decoded(stopped).cause is StopCause.HEARTBEAT_LOST
    frames = list(rig.bus.frames)[: at(rig, stopped)]
    heard = [decoded(m).echo for m in frames if bytes(m.data) in {bytes(held.data) for held in given}]
    assert heard, "none arrived in time, and nothing was shown"
    youngest = heard[-1]
    sent = max(n for n, m in enumerate(frames) if is_kind(m, ControllerHeartbeat) and m.data[2] == youngest)
    assert rig.bus.beats(ControllerHeartbeat, after=sent, before=stopped) <= IN_TIME
    assert rig.at_rest(sim) == "INHIBITED (HEARTBEAT_LOST)"
    assert not moved_after(rig, stopped.timestamp)


def test_a_start_that_is_held_back_until_the_operator_has_said_stop_moves_nothing(middle):
    """The runtime made it, and the controller accepts it while the last heartbeat is young; but nobody has said CUT."""
    rig, kept, held = middle.controller, [], []

    def hold(envelope):
        if isinstance(envelope.record, records.Start):
            held.append(envelope)
            return []
        return [envelope.record]

    def swallow(message):
        stops = is_kind(message, RuntimeHeartbeat) and decoded(message).code is RuntimeCode.INHIBIT
        if stops or is_kind(message, RuntimeStop):
            kept.append(message)
            return []
        return [message]

    sim, run = rig.permitted(**middle.there)
    middle.rewrite, middle.down = hold, swallow
    sim.say("hold")
    run.line("enabling device is held")
    run.say("start")
    rig.until(lambda: held)
    run.say("stop")
    rig.until(lambda: kept)
    middle.hand_down(held[0])
    stopped = rig.bus.single(ControllerFault)
    assert decoded(stopped).cause is StopCause.HEARTBEAT_LOST
    assert rig.bus.beats(ControllerHeartbeat, after=at(rig, middle.genuine), before=stopped) <= IN_TIME
    assert run.exit() == 3
    assert any(isinstance(e.record, records.Start) for e in rig.bus.records(CONTROL_IDS[Side.RUNTIME]))
    assert rig.at_rest(sim) == "INHIBITED (HEARTBEAT_LOST)"
    assert not moved_after(rig, 0.0)


# ---------------------------------------------------------------- withdrawing and restoring


def test_a_forged_stop_stops_and_withdraws_nothing_on_either_side(rig, stranger):
    """Both sides hear it: to the runtime it is a second node as well."""
    sim, run = rig.cutting()
    stranger.send(sealed(RuntimeStop(StopCode.STOP, StopCause.REGISTRATION_WITHDRAWN), 0, stranger.tag))
    assert run.exit() == 3
    stopped = rig.bus.single(ControllerFault)
    assert decoded(stopped).cause is StopCause.PROTOCOL_VIOLATION
    state = rig.at_rest(sim)
    assert re.match(r"(INHIBITED|FAULT) ", state)
    assert not withdrawn_anywhere(rig)
    assert not moved_after(rig, stopped.timestamp)
    named = StopCause[state.split("(")[1].rstrip(")")]
    again(rig, rig.run, cause=named, latched=state.startswith("FAULT"))


@pytest.mark.parametrize("cause", sorted(WITHDRAWING))
def test_a_stop_that_only_the_controller_hears_withdraws_nothing_on_either_side(middle, cause):
    rig = middle.controller
    sim, run = rig.cutting(**middle.there)
    middle.say_down(sealed(RuntimeStop(StopCode.STOP, cause), 0, middle.tag))
    assert run.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED (PROTOCOL_VIOLATION)"
    assert not any(beat.cause in WITHDRAWING for _, beat in rig.bus.all(ControllerHeartbeat))
    assert not withdrawn_anywhere(rig)
    again(rig, middle.run, cause=StopCause.PROTOCOL_VIOLATION, latched=False)


def test_a_forged_fault_frame_stops_and_withdraws_nothing(middle):
    rig = middle.controller
    sim, run = rig.cutting(**middle.there)
    middle.say_up(sealed(ControllerFault(FaultCode.STOPPED, StopCause.BONE_MOVED), 0, middle.tag))
    assert run.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED (PROTOCOL_VIOLATION)"
    beats = middle.runtime.bus.all(RuntimeHeartbeat)
    assert not any(beat.cause in WITHDRAWING for _, beat in beats)
    assert not withdrawn_anywhere(rig)
    assert rig.log().report.status is Status.OK
    again(rig, middle.run, cause=StopCause.PROTOCOL_VIOLATION, latched=False)


def test_a_withdrawn_registration_does_not_come_back_in_another_spelling(rig):
    """To a runtime that knows of nothing: the controller refuses the place, with one more newline, and under a new time."""
    sim, run = rig.permitted()
    run.say("withdraw")
    assert run.exit() == 3
    assert rig.at_rest(sim).startswith("INHIBITED")
    written = json.loads((rig.folder / "registration.json").read_text())
    later = {**written, "created_utc": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S.%fZ}"}
    sim.signal(signal.SIGINT)
    assert sim.exit() == 0
    sim = rig.sim()
    for number, text in enumerate((json.dumps(written) + "\n", json.dumps(later))):
        (rig.folder / "spelled.json").write_text(text)
        other = rig.run(registration="spelled.json", logs=f"elsewhere-{number}")
        assert other.exit() == 1
        assert "withdrawn at the controller" in other.told
    assert "state PERMITTED" not in sim.told


# ---------------------------------------------------------------- speaking for the controller


@pytest.mark.parametrize(
    ("request_kind", "state", "believed"),
    [
        (records.Permit, ControllerState.PERMITTED, "permitted:"),
        (records.Start, ControllerState.CUTTING, " cutting$"),
    ],
)
def test_a_heartbeat_of_the_controller_that_says_more_than_it_did_is_not_believed(
    middle, request_kind, state, believed
):
    """The request is kept from the controller, and its next heartbeats say that it was accepted."""
    rig, taken = middle.controller, []

    def keep(envelope):
        if isinstance(envelope.record, request_kind):
            taken.append(envelope.record)
            return []
        return [envelope.record]

    def claim(message):
        if taken and is_kind(message, ControllerHeartbeat):
            return [saying(message, middle.tag, state=state, cutting_mode=True)]
        return [message]

    middle.rewrite, middle.up = keep, claim
    run, sim = middle.run(), rig.sim()
    if request_kind is records.Start:
        run.line("permitted:")
        sim.say("hold")
        run.line("enabling device is held")
        run.say("start")
    assert run.exit() == 3
    assert taken
    assert not any(re.search(believed, line) for line in run.told.splitlines())
    assert rig.log().of("/audit/decision")[-1]["first_out"] == "AUTHENTICATION_FAILED"
    assert not any(beat.state is ControllerState.CUTTING for _, beat in rig.bus.all(ControllerHeartbeat))
    assert rig.at_rest(sim).startswith("FAULT (AUTHENTICATION_FAILED)")
