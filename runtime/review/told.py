"""A message from the bus as a line: of words for people, of JSON for programs. Pure."""

import json
from typing import Any, Final

from cutgate.config.screen import printable
from cutgate.runtime.review.decoding import NANOSECONDS, DecodedMessage

SCHEMA: Final = "cutgate.decode/1"
_SENDER_WIDTH: Final = 10
LOST: Final = "(no message)"


def text_line(heard: DecodedMessage, start_ns: int, *, interfaces: bool) -> str:
    """Time in seconds since the start, identifier, sender, message, fields with units, and in brackets what is wrong.

    Args:
        heard: the message.
        start_ns: of the first frame.
        interfaces: whether the bus is named: there are several.
    """
    seconds = (heard.time_ns - start_ns) / NANOSECONDS
    parts = [
        f"{seconds:12.6f}",
        heard.interface if interfaces else "",
        f"{heard.can_id:03X}",
        heard.sender.ljust(_SENDER_WIDTH),
        heard.name or LOST,
        ", ".join(map(str, heard.fields)),
        f"[{'; '.join(heard.notes)}]" if heard.notes else "",
    ]
    return printable("  ".join(filter(None, parts))) + "\n"


def json_line(heard: DecodedMessage, start_ns: int) -> str:
    """The same as one JSON object; ``data``, digests and codes in hex, times since 1970 UTC."""
    sec, nsec = divmod(heard.time_ns, NANOSECONDS)
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "time": {"sec": sec, "nsec": nsec},
        "offset_s": round((heard.time_ns - start_ns) / NANOSECONDS, 9),
        "interface": heard.interface,
        "id": f"0x{heard.can_id:03X}",
        "sender": heard.sender,
        "message": heard.name or None,
        "fields": {field.key: field.value for field in heard.fields},
        "notes": list(heard.notes),
    }
    if heard.segments:
        took_s = round((heard.time_ns - heard.began_ns) / NANOSECONDS, 9)
        document |= {"segments": heard.segments, "took_s": took_s}
    if heard.numbers is not None:
        document |= {"session": f"{heard.numbers[0]:08x}", "sequence": heard.numbers[1]}
    return json.dumps(document, allow_nan=False, separators=(",", ":")) + "\n"
