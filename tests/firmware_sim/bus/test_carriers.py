"""What carries frames from one client to the others: at once, or at the pace of a wire."""

import time
from dataclasses import FrozenInstanceError

import pytest

from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.carriers import AtOnce, Credit, Delivery, Paced, Stamps
from cutgate.firmware_sim.bus.frame import BusFrame, Flag
from cutgate.firmware_sim.bus.medium.bits import Rates, frame_bits
from cutgate.firmware_sim.bus.medium.errors import Injection, WireFault
from cutgate.firmware_sim.bus.states import BUS_OFF, CONTROLLER, COUNTERS, RESTARTED, TRANSMIT_OVERFLOW

RATES = Rates(1_000_000, 5_000_000)


class Clock:
    def __init__(self):
        self.now_ns = 10**12

    def __call__(self):
        return self.now_ns


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def said():
    return []


@pytest.fixture
def paced(clock, said):
    return made(clock, said)


def made(clock, said, **options):
    carrier = Paced(RATES, report=said.append, clock_ns=clock, **options)
    for client in (11, 12, 13):
        carrier.join(client, f"client {client}")
    return carrier


def passed(carrier, clock, seconds):
    """What happens until then, at whatever time it is looked at."""
    clock.now_ns += round(seconds * 1e9)
    return list(carrier.go_on())


def frames(deliveries):
    return [
        record.frame
        for each in deliveries
        if isinstance(each, Delivery)
        for record in wire.parse_all(each.raw)
    ]


# ---------------------------------------------------------------- at once


def test_at_once_everybody_else_gets_it_and_its_sender_as_its_own():
    carrier = AtOnce()
    assert (carrier.depth, carrier.fd) == (0, True)
    for client in (1, 2, 3):
        carrier.join(client, "")
    raw = wire.of_frame(BusFrame(5)) + wire.of_frame(BusFrame(6, int(Flag.FD)))
    (delivery,) = carrier.take(2, raw)
    assert (delivery.frames, delivery.fd, delivery.receivers, delivery.own) == (2, 1, (1, 3), (2,))
    assert frames([delivery]) == [BusFrame(5), BusFrame(6, int(Flag.FD))]
    assert carrier.sent == {1: 0, 2: 2, 3: 0}
    assert carrier.wait_s() is None
    assert not list(carrier.go_on())
    carrier.leave(3)
    carrier.leave(3)
    assert carrier.sent == {1: 0, 2: 2}
    (delivery,) = carrier.take(2, raw)
    assert delivery.receivers == (1,)


def test_the_time_of_the_bus_never_goes_back():
    stamps = Stamps()
    assert [stamps.at(ns) for ns in (0, 5, 3, 8)] == [0, 5, 5, 8]


def test_a_credit_is_not_altered():
    with pytest.raises(FrozenInstanceError):
        Credit(1, 2).frames = 3
    assert not hasattr(Credit(1, 2), "__dict__")  # there are thousands a second


# ---------------------------------------------------------------- at the pace of a wire


def test_a_frame_arrives_when_its_bits_have_passed(paced, clock):
    frame = BusFrame(5, 0, 2, b"ab")
    assert not list(paced.take(11, wire.of_frame(frame)))
    assert paced.wait_s() == 0.0
    assert not list(paced.go_on())  # it is on the wire now
    duration_s = frame_bits(frame).nominal / 1e6
    assert paced.wait_s() == pytest.approx(duration_s)
    assert not passed(paced, clock, duration_s - 2e-6)
    delivery, credit = passed(paced, clock, 2e-6)
    assert delivery[1:] == (1, 0, (12, 13), (11,), True)
    assert credit == Credit(11, 1)
    assert paced.wait_s() is None


def test_bus_time_goes_on_from_the_time_of_day_by_the_monotonic_clock(clock, said, monkeypatch):
    began_ns = 1_800_000_000_000_000_000
    monkeypatch.setattr(time, "time_ns", lambda: began_ns)
    carrier = made(clock, said, queue_frames=1)
    (told,) = carrier.take(11, wire.of_frame(BusFrame(5)) * 2)
    (delivery, _) = passed(carrier, clock, 1.0)
    assert [
        record.time_ns - began_ns for each in (told, delivery) for record in wire.parse_all(each.raw)
    ] == [
        0,
        frame_bits(BusFrame(5)).nominal * 1000,
    ]


def test_fd_frames_are_counted_so_that_a_classic_client_is_spared_them(paced, clock):
    list(paced.take(11, wire.of_frame(BusFrame(5, int(Flag.FD), 64, bytes(64)))))
    assert passed(paced, clock, 1.0)[0].fd == 1
    assert paced.fd
    assert not Paced(Rates(1_000_000)).fd


def test_what_finds_no_room_is_told_to_its_sender(clock, said):
    carrier = made(clock, said, queue_frames=2)
    assert carrier.depth == 2
    (told,) = carrier.take(11, b"".join(wire.of_frame(BusFrame(number)) for number in range(5)))
    assert told[1:] == (1, 0, (11,), (), False)
    (frame,) = frames([told])
    assert (frame.number, frame.data[1], int.from_bytes(frame.data[4:], "big")) == (
        CONTROLLER,
        TRANSMIT_OVERFLOW,
        3,
    )


def test_a_datagram_with_nonsense_in_it_counts_for_nothing(paced, clock):
    with pytest.raises(wire.WireError, match="identifier 0x800"):
        list(paced.take(11, wire.of_frame(BusFrame(5)) + wire.of_frame(BusFrame(0x800))))
    assert not passed(paced, clock, 1.0)


def test_a_client_that_goes_off_is_told_at_each_step_and_may_send_nothing_more(clock, said):
    carrier = made(clock, said, restart_s=1e7)
    node = carrier.numbers()[11]
    carrier.medium.inject(Injection(WireFault.BIT, senders=frozenset({node}), count=32))
    list(carrier.take(11, wire.of_frame(BusFrame(5))))
    effects = passed(carrier, clock, 0.1)
    numbers = [frame.number for frame in frames(effects)]
    assert numbers == [CONTROLLER | COUNTERS, CONTROLLER | COUNTERS, BUS_OFF | COUNTERS]
    assert {each.receivers for each in effects if isinstance(each, Delivery)} == {(11,)}
    assert [each for each in effects if isinstance(each, Credit)] == [Credit(11, None)]
    flags_ns = 32 * (20 + 3 + frame_bits(BusFrame(5)).nominal) * 1000
    assert round(carrier.wait_s() * 1e9) == pytest.approx(10**16 + 1408 * 1000 - 10**8, abs=flags_ns)
    assert [line.split(",")[0] for line in said] == [
        "client 11: ERROR_ACTIVE -> ERROR_WARNING",
        "client 11: ERROR_WARNING -> ERROR_PASSIVE",
        "client 11: ERROR_PASSIVE -> BUS_OFF",
    ]
    effects = passed(carrier, clock, 1e7)
    assert [frame.number for frame in frames(effects)] == [RESTARTED | COUNTERS]
    assert Credit(11, 10) in effects


def test_what_a_client_had_queued_still_goes_when_it_has_left(paced, clock):
    list(paced.take(11, wire.of_frame(BusFrame(5))))
    node = paced.numbers()[11]
    paced.leave(11)
    paced.leave(11)
    delivery, *rest = passed(paced, clock, 1.0)
    assert (delivery.receivers, delivery.own, rest) == ((12, 13), (), [])
    assert paced.client_of(node) is None
    assert node not in paced.medium.nodes
    assert paced.client_of(paced.numbers()[12]) == 12
    assert paced.node_of(12).name == "client 12"
    assert paced.now_ns() == clock.now_ns


def test_whoever_takes_the_bus_for_himself_is_named_once(paced, clock, said):
    for _ in range(2500):
        list(paced.take(12, wire.of_frame(BusFrame(0, 0, 8, bytes(8)))))
        clock.now_ns += 10**6
    assert len(said) == 0
    for _ in range(25_000):
        list(paced.take(12, wire.of_frame(BusFrame(0, 0, 8, bytes(8)))))
        clock.now_ns += 10**5
    (line,) = said
    assert line.startswith("client 12 takes ")
    assert "identifier 0x000; load" in line
    paced.leave(12)
    passed(paced, clock, 2.0)
    assert len(said) == 1
