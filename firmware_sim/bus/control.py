"""What a hub tells of itself, and the errors it can be told to make: `cutgate bus stat` and `cutgate bus inject`."""

import json
from collections.abc import Mapping
from typing import Any, Final

from cutgate.firmware_sim.bus.carriers import AtOnce, Carrier, Paced
from cutgate.firmware_sim.bus.frame import EXTENDED_MAX
from cutgate.firmware_sim.bus.medium.errors import CASES, Injection, WireFault
from cutgate.firmware_sim.bus.medium.nodes import Node

SCHEMA: Final = "cutgate.bus/1"
TALKERS: Final = 20
COUNT_MAX: Final = 1_000_000
_KEYS: Final = frozenset({"error", "identifier", "sender", "receiver", "skip", "count"})


class InjectionRefusedError(ValueError):
    """An injection that this bus cannot make; the message says why."""


def status(carrier: Carrier, queues: Mapping[int, tuple[str, int, int]]) -> dict[str, object]:
    """Everything that is counted since the bus began.

    Args:
        carrier: what carries the frames.
        queues: by client its name, the frames that wait to be read by it, and those it lost by reading too slowly.
    """
    clients = [
        {"client": number, "name": name, "unread": unread, "lost": lost, **_node(carrier, number)}
        for number, (name, unread, lost) in sorted(queues.items())
    ]
    return {"schema": SCHEMA, **_bus(carrier), "clients": clients}


def _bus(carrier: Carrier) -> dict[str, object]:
    if not isinstance(carrier, Paced):
        return {"paced": False}
    medium = carrier.medium
    rates, totals = medium.rates, medium.totals
    loudest = sorted(totals.talkers.items(), key=lambda entry: -entry[1].busy_ns)[:TALKERS]
    return {
        "paced": True,
        "bitrate_bit_s": rates.nominal_bit_s,
        "data_bitrate_bit_s": rates.data_bit_s,
        "time_ns": carrier.now_ns(),
        "busy_ns": totals.busy_ns,
        "frames": totals.frames,
        "error_frames": totals.error_frames,
        "talkers": [
            {
                "client": carrier.client_of(node),
                "identifier": number,
                "frames": talker.frames,
                "busy_ns": talker.busy_ns,
            }
            for (node, number), talker in loudest
        ],
    }


def _node(carrier: Carrier, client: int) -> dict[str, object]:
    if isinstance(carrier, AtOnce):
        return {"sent": carrier.sent[client]}
    node = carrier.node_of(client) if isinstance(carrier, Paced) else None
    return {} if node is None else _counts(node)


def _counts(node: Node) -> dict[str, object]:
    tally = node.tally
    return {
        "state": node.state.name,
        "transmit_errors": node.counters.transmit,
        "receive_errors": node.counters.receive,
        "queued": len(node.queue),
        "depth": node.depth,
        "sent": tally.sent,
        "received": tally.received,
        "refused": tally.refused,
        "lost_arbitration": tally.lost_arbitration,
        "errors": tally.errors,
        "busy_ns": tally.busy_ns,
    }


# ---------------------------------------------------------------- errors on demand


def inject(carrier: Carrier, text: str) -> str:
    """Let an error come that somebody has asked for; what to answer."""
    if not isinstance(carrier, Paced):
        return "refused: this bus has no wire to err; serve it with --bitrate"
    try:
        injection = injection_of(text, carrier.numbers())
    except InjectionRefusedError as error:
        return f"refused: {error}"
    if not carrier.medium.inject(injection):
        return "refused: too many errors are to come already; let some happen first"
    return f"to come: {injection.count} x {injection.kind}"


def injection_of(text: str, nodes: Mapping[int, int]) -> Injection:
    """The injection of a JSON object.

    Args:
        text: its members are those of ``Injection``; sender and receiver are clients' numbers.
        nodes: by client, the medium's number for it.

    Raises:
        InjectionRefusedError: what is wrong with it.
    """
    try:
        asked: Any = json.loads(text)
    except (ValueError, RecursionError):
        raise InjectionRefusedError("not a JSON object") from None
    if not isinstance(asked, dict) or not set(asked) <= _KEYS:
        raise InjectionRefusedError(f"must be a JSON object of {', '.join(sorted(_KEYS))}")
    kind = asked.get("error")
    if not isinstance(kind, str) or kind not in [*WireFault]:
        raise InjectionRefusedError(f"error is {kind!r}, must be one of {', '.join(WireFault)}")
    error = WireFault(kind)
    receiver = asked.get("receiver")
    if receiver is not None and not CASES[error].by_receivers:
        raise InjectionRefusedError(
            f"a receiver is named, but an error of kind {error} is seen by the sender"
        )
    return Injection(
        error,
        number=None if asked.get("identifier") is None else _number(asked, "identifier", 0, EXTENDED_MAX),
        senders=_node_number(asked, "sender", nodes),
        receivers=_node_number(asked, "receiver", nodes),
        skip=_number(asked, "skip", 0, COUNT_MAX),
        count=_number(asked, "count", 1, COUNT_MAX),
    )


def _number(asked: dict[str, Any], key: str, least: int, most: int) -> int:
    """What is asked for, or the least where nothing is."""
    value = asked.get(key)
    if value is None:
        return least
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise InjectionRefusedError(f"{key} is {value!r}, must be a whole number of {least} to {most}")
    return value


def _node_number(asked: dict[str, Any], key: str, nodes: Mapping[int, int]) -> frozenset[int] | None:
    client = asked.get(key)
    if client is None:
        return None
    if not isinstance(client, int) or isinstance(client, bool) or client not in nodes:
        known = ", ".join(map(str, sorted(nodes))) or "none"
        raise InjectionRefusedError(
            f"{key} is {client!r}, must be the number of a client: {known} (bus stat)"
        )
    return frozenset({nodes[client]})
