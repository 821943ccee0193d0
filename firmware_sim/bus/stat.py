"""Two counts of a hub as a page of text: load, rates and errors between them, the nodes, and who talks most."""

from typing import Any, Final

TALKERS: Final = 5
_COLUMNS: Final = ("client", "state", "tx/rx err", "queue", "sent/s", "load", "lost", "who")
_FORM: Final = "{:>6} {:<13} {:>9} {:>5} {:>7} {:>6} {:>5} {}"


def page(before: dict[str, Any], after: dict[str, Any], seconds: float) -> list[str]:
    """Lines for a terminal.

    Args:
        before: a document of ``cutgate.bus/1``.
        after: a later one.
        seconds: between them.
    """
    if not after["paced"]:
        return [
            "not paced: frames are carried at once, there is no load and no error on a wire",
            *(_line_at_once(before, client, seconds) for client in after["clients"]),
        ]
    span_ns = max(1, after["time_ns"] - before["time_ns"])
    fast = after["data_bitrate_bit_s"]
    rates = f"{after['bitrate_bit_s'] / 1000:g} kbit/s" + (f", data {fast / 1000:g} kbit/s" if fast else "")
    line = (
        f"{rates}: load {(after['busy_ns'] - before['busy_ns']) / span_ns:.1%}, "
        f"{(after['frames'] - before['frames']) / seconds:.0f} frames/s, "
        f"{after['error_frames'] - before['error_frames']} error frames in {seconds:.1f} s, "
        f"{after['error_frames']} in all"
    )
    return [
        line,
        _FORM.format(*_COLUMNS),
        *(_line(before, client, seconds, span_ns) for client in after["clients"]),
        *_talkers(before, after, span_ns),
    ]


def _was(before: dict[str, Any], client: int) -> dict[str, Any]:
    found = [entry for entry in before["clients"] if entry["client"] == client]
    return found[0] if found else {}


def _who(client: dict[str, Any]) -> str:
    """The name without the number, which stands before it."""
    name = str(client["name"])
    return name.removeprefix(f"client {client['client']} ").strip("()")


def _line_at_once(before: dict[str, Any], client: dict[str, Any], seconds: float) -> str:
    sent = client["sent"] - _was(before, client["client"]).get("sent", 0)
    return (
        f"{client['client']:>6}  {sent / seconds:.0f} frames/s, {client['unread']} unread, {client['lost']} lost  "
        f"{_who(client)}"
    )


def _line(before: dict[str, Any], client: dict[str, Any], seconds: float, span_ns: int) -> str:
    was = _was(before, client["client"])
    return _FORM.format(
        client["client"],
        client["state"].lower().replace("_", "-"),
        f"{client['transmit_errors']}/{client['receive_errors']}",
        f"{client['queued']}/{client['depth']}",
        f"{(client['sent'] - was.get('sent', 0)) / seconds:.0f}",
        f"{(client['busy_ns'] - was.get('busy_ns', 0)) / span_ns:.1%}",
        client["lost"] + client["refused"],
        _who(client),
    )


def _talkers(before: dict[str, Any], after: dict[str, Any], span_ns: int) -> list[str]:
    earlier = {(entry["client"], entry["identifier"]): entry["busy_ns"] for entry in before["talkers"]}
    shares = [
        (entry["busy_ns"] - earlier.get((entry["client"], entry["identifier"]), 0), entry)
        for entry in after["talkers"]
    ]
    loudest = sorted((share for share in shares if share[0] > 0), key=lambda share: -share[0])[:TALKERS]
    return [
        f"  {'other identifiers' if entry['identifier'] < 0 else format(entry['identifier'], '03X')} of "
        f"{'a client that has left' if entry['client'] is None else 'client ' + str(entry['client'])}: "
        f"{busy_ns / span_ns:.1%} of the bus"
        for busy_ns, entry in loudest
    ]
