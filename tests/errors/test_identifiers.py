"""The whole 11-bit identifier space, in every shape a frame can have: ignored, discarded or faulted, never acted on.

What is whose stands here by hand, after docs/protocol.md, and is not asked of the code under test.
"""

from dataclasses import dataclass, replace
from typing import Any

import can
import pytest

from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import FRAMES, RuntimeStop, encode_frame
from cutgate.protocol.link import Accepted, Discarded, Violation
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, StopCause, StopCode
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.phases import ENDED
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import Pair

RUNTIME, CONTROLLER = Side.RUNTIME, Side.CONTROLLER
STOP = 0x011
SINGLE = {RUNTIME: {STOP, 0x080}, CONTROLLER: {0x010, 0x081, 0x300, 0x301, 0x302, 0x303}}
TRANSFERS = {RUNTIME: {0x600, 0x640}, CONTROLLER: {0x601, 0x641}}
BULK = {0x640, 0x641}
SENT = {side: SINGLE[side] | TRANSFERS[side] for side in Side}
STANDARD = range(1 << 11)
PHASES = ["no session", "collecting", "permitted", "cutting"]


@dataclass(frozen=True)
class Shape:
    """How a frame comes, whatever its identifier."""

    name: str
    size: int = 8
    is_extended: bool = False
    is_remote: bool = False
    is_fd: bool = False

    def message(self, can_id: int, data: bytes | None = None) -> can.Message:
        return can.Message(
            arbitration_id=can_id,
            data=None if self.is_remote else bytes(self.size) if data is None else data,
            dlc=self.size,
            is_extended_id=self.is_extended,
            is_remote_frame=self.is_remote,
            is_fd=self.is_fd,
        )

    @property
    def flags(self) -> dict[str, bool]:
        return {"is_extended": self.is_extended, "is_remote": self.is_remote, "is_fd": self.is_fd}

    @property
    def is_classic(self) -> bool:
        return self.size == 8 and not self.is_remote and not self.is_fd

    def carries(self, can_id: int, fd: object) -> bool:
        """Whether a transfer takes it: FD where bulk records travel so, classic everywhere else."""
        return self.is_fd if fd and can_id in BULK else self.is_classic


SHAPES = [
    *(Shape(f"{size} bytes", size) for size in range(9)),
    Shape("remote", 0, is_remote=True),
    Shape("remote of 8", 8, is_remote=True),
    Shape("extended", is_extended=True),
    Shape("extended remote", 0, is_extended=True, is_remote=True),
    Shape("FD of 8", 8, is_fd=True),
    Shape("FD of 12", 12, is_fd=True),
    Shape("FD of 64", 64, is_fd=True),
    Shape("extended FD", 64, is_extended=True, is_fd=True),
]


def at(pair: Pair, phase: str) -> Pair:
    """A pair that stays in this phase for as long as nobody says anything."""
    pair.power_up(time_scale=0.05)
    pair.begin()
    pair.prover.answer = (lambda _request: None) if phase == "collecting" else pair.prover.answer
    match phase:
        case "no session":
            pair.controller_runs = False
            pair.run(0.02)
            pair.controller_runs = True
            pair.process._next_announce_s = pair.clock() + 10.0
        case "collecting":
            pair.to(Phase.COLLECTING)
        case "permitted":
            pair.to(Phase.PERMITTED).run(0.05)
        case "cutting":
            pair.to(Phase.CUTTING).run(0.1)
    return pair


def endpoint_of(pair: Pair, side: Side) -> Endpoint:
    assert pair.session is not None
    return (pair.session._port if side is RUNTIME else pair.process.port).endpoint


def enabling(endpoint: Endpoint) -> tuple[Any, ...]:
    """Everything in an endpoint that could enable something: session, age, counters, samples, records."""
    link = endpoint.link
    return (
        endpoint.session,
        link.tag,
        link.is_open,
        link._opened_s,
        link._refreshed_s,
        link._heard,
        link._peer,
        tuple(link._proved),
        link.sample,
        {can_id: sequence.last for can_id, sequence in link._sequences.items() if sequence.last},
        link._parts,
        link.statistics.accepted,
        endpoint._seen,
        endpoint._sent,
    )


def judged(endpoint: Endpoint, shape: Shape, can_id: int, now_s: float) -> list[Any]:
    data = b"" if shape.is_remote else bytes(shape.size)
    return endpoint.receive(can_id, data, **shape.flags, now_s=now_s)


# ---------------------------------------------------------------- the endpoints, every identifier


@pytest.mark.parametrize(
    "pair", [(), pytest.param(tuple(Side), marks=pytest.mark.slow)], ids=["classic", "FD"], indirect=True
)
@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("phase", PHASES)
def test_every_identifier_in_every_shape_is_judged_as_documented_and_enables_nothing(pair, phase, side):
    endpoint = endpoint_of(at(pair, phase), side)
    own, others, inside = SENT[side], SENT[side.peer], phase != "no session"
    before, now_s = enabling(endpoint), pair.clock()
    for shape in SHAPES:
        for can_id in STANDARD:
            now_s += 1.0  # so that no number of corrupted frames in a second is reached
            items = judged(endpoint, shape, can_id, now_s)
            if shape.is_extended or can_id not in own | others:
                assert items == [], (can_id, shape)
            elif can_id in own:
                assert [(type(i), i.cause) for i in items] == [(Violation, StopCause.SECOND_NODE)], (
                    can_id,
                    shape,
                )
            elif can_id in TRANSFERS[side.peer] and shape.carries(can_id, pair.fd):
                assert items == [], "an empty single frame carries nothing"
            elif inside and can_id == STOP:
                (item,) = items
                assert isinstance(item, Accepted)
                assert item.frame == RuntimeStop(StopCode.STOP, StopCause.CORRUPTION)
            else:
                (item,) = items
                assert isinstance(item, Discarded), (can_id, shape, item)
            assert enabling(endpoint) == before, (can_id, shape)


@pytest.mark.parametrize("pair", [(), tuple(Side)], ids=["classic", "FD"], indirect=True)
@pytest.mark.parametrize("side", Side)
def test_three_unsound_frames_within_a_second_fault_whatever_their_identifier_and_shape(pair, side):
    endpoint = endpoint_of(at(pair, "cutting"), side)
    now_s = pair.clock()
    for can_id in SINGLE[side.peer] - {STOP}:
        for shape in (shape for shape in SHAPES if not shape.is_extended):
            now_s += 2.0
            kinds = [type(judged(endpoint, shape, can_id, now_s)[0]) for _ in range(3)]
            assert kinds == [Discarded, Discarded, Violation], (can_id, shape)


def test_the_table_by_hand_is_the_dbc():
    assert {can_id: kind.SENDER for can_id, kind in FRAMES.items()} == {
        can_id: side for side in Side for can_id in SINGLE[side]
    }


# ---------------------------------------------------------------- the loops, one frame of each class


@dataclass(frozen=True)
class Class:
    """A class of frames that is treated alike; ``can_id`` for each receiving side."""

    name: str
    shape: Shape
    can_id: dict[Side, int]
    stops: StopCause | None = None


def both(can_id: int) -> dict[Side, int]:
    return dict.fromkeys(Side, can_id)


BY = {shape.name: shape for shape in SHAPES}
OWN_BEAT, PEER_BEAT = {RUNTIME: 0x080, CONTROLLER: 0x081}, {RUNTIME: 0x081, CONTROLLER: 0x080}
OWN_BULK, PEER_BULK = {RUNTIME: 0x640, CONTROLLER: 0x641}, {RUNTIME: 0x641, CONTROLLER: 0x640}
HEARTBEAT_SHAPES = ["8 bytes", "7 bytes", "remote", "FD of 64", "extended"]
OTHER_SHAPES = ["8 bytes", "remote", "FD of 64"]
CLASSES = [
    *(Class(f"the peer's heartbeat, {name}", BY[name], PEER_BEAT) for name in HEARTBEAT_SHAPES),
    *(Class(f"the peer's transfer, {name}", BY[name], PEER_BULK) for name in [*OTHER_SHAPES, "FD of 12"]),
    *(Class(f"unlisted, {name}", BY[name], both(0x123)) for name in OTHER_SHAPES),
    Class("extended with its own low bits", BY["extended"], OWN_BEAT),
    *(
        Class(f"its own heartbeat, {name}", BY[name], OWN_BEAT, StopCause.SECOND_NODE)
        for name in OTHER_SHAPES
    ),
    Class("its own transfer", BY["8 bytes"], OWN_BULK, StopCause.SECOND_NODE),
]


def reached(pair: Pair) -> tuple[Any, ...]:
    """What a frame may not change."""
    controller = pair.controller
    return (
        pair.phase,
        pair.state.cause,
        controller.state,
        controller.cause,
        controller.epoch,
        controller.permit,
        controller.cut_ordered,
        controller.cutting_mode,
    )


@pytest.mark.parametrize(
    "pair",
    [pytest.param((), id="classic"), pytest.param(tuple(Side), id="FD", marks=pytest.mark.slow)],
    indirect=True,
)
@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.name)
@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("phase", PHASES)
def test_one_frame_of_each_class_is_ignored_or_stops_the_loop_and_never_begins_anything(
    pair, phase, side, kind
):
    at(pair, phase)
    if phase == "collecting":  # as far as it gets without a verdict
        pair.wire.nodes[side].inbox.append(kind.shape.message(kind.can_id[side]))
        pair.run(0.3)
        expected = (
            None if kind.stops else (Phase.VERIFYING, StopCause.NONE, ControllerState.LOADED, StopCause.NONE)
        )
        assert expected is None or reached(pair)[:4] == expected
    else:
        before = reached(pair)
        pair.wire.nodes[side].inbox.append(kind.shape.message(kind.can_id[side]))
        pair.run(0.06)
        assert kind.stops or reached(pair) == before
    moved = pair.process.arm.state.joints
    if kind.stops:
        pair.run(0.1)
        causes = {RUNTIME: pair.state.cause, CONTROLLER: pair.controller.cause}
        assert causes[side] is kind.stops
        assert side is CONTROLLER or pair.phase in ENDED
        assert side is RUNTIME or pair.controller.state is ControllerState.FAULT
        assert not pair.controller.may_move
        assert not pair.controller.cutting_mode
    if kind.stops or phase != "cutting":
        pair.run(0.05)
        assert pair.process.arm.state.joints == moved
    if pair.phase not in ENDED:
        pair.say("quit").end()
    pair.run(0.02)
    assert pair.close().closed
    assert pair.read().report.status is Status.OK


@pytest.mark.parametrize("name", ["0 bytes", "7 bytes", "remote", "FD of 8", "FD of 64", "extended"])
def test_a_misshapen_frame_on_the_stop_identifier_stops_unless_it_is_extended(pair, name):
    at(pair, "cutting")
    pair.wire.nodes[CONTROLLER].inbox.append(BY[name].message(STOP))
    pair.run(2 * pair.cycle_s)
    stopped = name != "extended"
    assert pair.controller.may_move is not stopped
    assert (pair.controller.cause is StopCause.CORRUPTION) is stopped


def test_a_sound_stop_of_another_session_stops(pair):
    """Its CRC is wrong here: a stop is never discarded."""
    at(pair, "cutting")
    frame = encode_frame(RuntimeStop(StopCode.END, StopCause.NONE), 0, pair.state.session.tag ^ 1)
    pair.wire.nodes[CONTROLLER].put(*frame)
    pair.run(2 * pair.cycle_s)
    assert not pair.controller.may_move
    assert pair.controller.cause is StopCause.CORRUPTION


def test_no_frame_of_any_class_keeps_a_gate_open_that_has_lost_its_peer(pair):
    """A bus full of everything but heartbeats refreshes nothing."""
    at(pair, "cutting")
    pair.runtime_runs = False
    began_s = pair.clock()

    def noise() -> None:
        for shape in SHAPES:
            pair.wire.nodes[CONTROLLER].inbox.append(replace(shape).message(0x123))
        pair.wire.nodes[CONTROLLER].inbox.append(BY["8 bytes"].message(0x640))

    pair.until(lambda: not pair.controller.may_move, act=noise)
    assert pair.clock() - began_s <= 0.100 + 2 * pair.cycle_s
    assert pair.controller.cause is StopCause.HEARTBEAT_LOST
