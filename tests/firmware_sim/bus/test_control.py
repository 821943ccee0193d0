"""What a hub tells of itself, and the errors it can be told to make."""

import json

import pytest

from cutgate.firmware_sim.bus import stat, wire
from cutgate.firmware_sim.bus.carriers import AtOnce, Paced
from cutgate.firmware_sim.bus.control import InjectionRefusedError, inject, injection_of, status
from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium import medium as medium_module
from cutgate.firmware_sim.bus.medium.bits import Rates
from cutgate.firmware_sim.bus.medium.errors import Injection, WireFault

NODES = {1: 4, 11: 1, 12: 2}


def carrier(clock=lambda: 10**12):
    paced = Paced(Rates(1_000_000, 5_000_000), clock_ns=clock)
    for client in (11, 12):
        paced.join(client, f"client {client}")
    return paced


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"error": "bit"}, Injection(WireFault.BIT)),
        (
            {"error": "crc", "identifier": 0x80, "sender": 11, "receiver": 12, "skip": 3, "count": 4},
            Injection(WireFault.CRC, 0x80, frozenset({1}), frozenset({2}), 3, 4),
        ),
        ({"error": "last-bit", "count": None}, Injection(WireFault.LAST)),
        (
            {"error": "bit", "identifier": 0x1FFFFFFF, "skip": 1_000_000, "count": 1_000_000},
            Injection(WireFault.BIT, 0x1FFFFFFF, skip=1_000_000, count=1_000_000),
        ),
        ({"error": "bit", "identifier": 0, "skip": 0, "count": 1}, Injection(WireFault.BIT, 0)),
    ],
)
def test_an_injection_is_what_was_asked_for(asked, expected):
    assert injection_of(json.dumps(asked), NODES) == expected


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "not a JSON object"),
        ("[" * 100_000, "not a JSON object"),
        ("[]", "must be a JSON object of count, error"),
        ('{"error": "bit", "when": 1}', "must be a JSON object of count, error"),
        ("{}", "error is None, must be one of bit, stuff"),
        ('{"error": ["bit"]}', "error is .'bit'., must be one of"),
        ('{"error": "bit", "receiver": 12}', "seen by the sender"),
        ('{"error": "crc", "receiver": 13}', "receiver is 13, must be the number of a client: 1, 11, 12"),
        ('{"error": "crc", "sender": "x"}', "sender is 'x'"),
        ('{"error": "x"}', "error is 'x', must be one of bit, stuff"),
        ('{"error": "crc", "sender": true}', "sender is True"),
        ('{"error": "crc", "count": 0}', "count is 0, must be a whole number of 1 to 1000000"),
        ('{"error": "crc", "count": 1000001}', "count is 1000001, must be a whole number of 1 to"),
        ('{"error": "crc", "skip": -1}', "skip is -1, must be a whole number of 0 to 1000000"),
        ('{"error": "crc", "identifier": 536870912}', "identifier is 536870912, must be a .* 0 to 536870911"),
        ('{"error": "crc", "skip": true}', "skip is True"),
        ('{"error": "crc", "identifier": 1.5}', "identifier is 1.5"),
    ],
)
def test_what_cannot_be_injected_is_refused_with_the_reason(text, why):
    with pytest.raises(InjectionRefusedError, match=why):
        injection_of(text, NODES)


def test_of_a_bus_without_clients_there_is_none_to_name():
    with pytest.raises(InjectionRefusedError, match="of a client: none"):
        injection_of('{"error": "bit", "sender": 1}', {})


def test_injecting_answers_in_words(monkeypatch):
    paced = carrier()
    assert inject(paced, '{"error": "form", "count": 2}') == "to come: 2 x form"
    assert inject(paced, "x") == "refused: not a JSON object"
    monkeypatch.setattr(medium_module, "INJECTIONS_MAX", 1)
    assert "too many" in inject(paced, '{"error": "form"}')
    assert inject(AtOnce(), '{"error": "form"}').startswith("refused: this bus has no wire")


class Clock:
    now_ns = 10**12

    def __call__(self):
        return self.now_ns


def test_everything_is_counted_and_a_page_shows_what_happened_between_two_counts():
    clock = Clock()
    paced = carrier(clock)
    queues = {11: ("client 11", 0, 0), 12: ("client 12 (process 4242)", 3, 7)}
    before = status(paced, queues)
    inject(paced, '{"error": "bit"}')
    list(paced.take(11, b"".join(wire.of_frame(BusFrame(number, 0, 8, bytes(8))) for number in (5, 5, 6))))
    clock.now_ns += 10**9
    list(paced.go_on())
    after = json.loads(json.dumps(status(paced, queues)))
    first, second = after["clients"]
    assert (first["sent"], first["errors"], first["transmit_errors"], first["queued"]) == (3, 1, 5, 0)
    assert (second["received"], second["unread"], second["lost"]) == (3, 3, 7)
    assert (after["frames"], after["error_frames"]) == (3, 1)
    lines = stat.page(before, after, 1.0)
    assert lines[0].startswith("1000 kbit/s, data 5000 kbit/s: load 0.0")
    assert lines[0].endswith("%, 3 frames/s, 1 error frames in 1.0 s, 1 in all")
    assert lines[2].split()[:6] == ["11", "error-active", "5/0", "0/10", "3", lines[2].split()[5]]
    assert lines[3].split()[-3:] == ["7", "process", "4242"]
    assert lines[4].startswith("  005 of client 11: ")
    assert len(lines) == 6
    assert stat.page(after, after, 1.0)[4:] == []


def test_those_who_talk_most_come_first_and_no_more_than_twenty_of_them():
    clock = Clock()
    paced = carrier(clock)
    for number in range(25):
        for _ in range(number + 1):
            list(paced.take(11, wire.of_frame(BusFrame(number))))
            clock.now_ns += 10**6
    list(paced.go_on())
    document = status(paced, {11: ("client 11", 0, 0)})
    assert document["schema"] == "cutgate.bus/1"
    assert [(talker["identifier"], talker["frames"]) for talker in document["talkers"]] == [
        (number, number + 1) for number in range(24, 4, -1)
    ]
    node = paced.node_of(11)
    assert document["clients"] == [
        {
            "client": 11,
            "name": "client 11",
            "unread": 0,
            "lost": 0,
            "state": "ERROR_ACTIVE",
            "transmit_errors": 0,
            "receive_errors": 0,
            "queued": 0,
            "depth": 10,
            "sent": 325,
            "received": 0,
            "refused": 0,
            "lost_arbitration": 0,
            "errors": 0,
            "busy_ns": node.tally.busy_ns,
        }
    ]


def test_who_has_left_and_what_is_lumped_together_is_shown_as_that():
    document = status(carrier(), {})
    talker = {"client": None, "identifier": -1, "frames": 1, "busy_ns": 10**8}
    lines = stat.page(document | {"time_ns": 0}, document | {"time_ns": 10**9, "talkers": [talker]}, 1.0)
    assert lines[-1] == "  other identifiers of a client that has left: 10.0% of the bus"


def test_of_a_bus_that_carries_at_once_rates_are_shown_and_nothing_that_it_has_not():
    at_once = AtOnce()
    at_once.join(1, "client 1")
    at_once.sent[1] = 50
    document = status(at_once, {1: ("client 1", 2, 0)})
    lines = stat.page({"clients": []}, document, 2.0)
    assert lines == [
        "not paced: frames are carried at once, there is no load and no error on a wire",
        "     1  25 frames/s, 2 unread, 0 lost  client 1",
    ]


def test_a_page_of_classic_frames_names_one_rate():
    paced = Paced(Rates(500_000))
    document = status(paced, {})
    assert stat.page(document, document, 1.0)[0].startswith("500 kbit/s: load 0.0%")
