"""An error on a CAN wire bit by bit: who sends a flag when, what each hears behind its own, and what ISO 11898-1 lets it
count of that. It shares nothing with the model: no table of errors, no knowledge of who is first."""

from dataclasses import dataclass
from typing import Final

TAIL: Final = (
    *("crc delimiter", "acknowledge", "acknowledge delimiter"),
    *("end",) * 6,
    "last of end",
    *("intermission",) * 3,
)
"""The fields behind the CRC, bit by bit."""
RIGHT_SO_FAR: Final = 8
"""A receiver takes a frame that is right to this bit of the tail, the last but one of its end."""
SEEN: Final = {"form": 0, "ack": 1, "crc": 2, "last-but-one-bit": 8, "last-bit": 9}
"""In which bit of the tail each error is seen; bit and stuff errors in the middle of the data."""
BY_RECEIVERS: Final = {"form", "crc", "stuff", "last-but-one-bit"}
BEHIND: Final = 40
"""So many bits later everything is over."""


@dataclass
class Station:
    """One error-active node.

    Attributes:
        sends: it is the transmitter.
        flag_left: so many dominant bits of its flag are to come.
        failed: it has begun an error flag.
        overloaded: it has begun an overload flag, which counts nothing.
        listens: its error flag is over, and the next bit is the one behind it.
        taken: it has taken the frame.
        counted: by how much its counter has gone up.
    """

    sends: bool
    flag_left: int = 0
    failed: bool = False
    overloaded: bool = False
    listens: bool = False
    taken: bool = False
    counted: int = 0

    def drives(self, field: str, place: int) -> int:
        """Its bit."""
        if self.flag_left:
            return 0
        if self.failed or self.overloaded:
            return 1
        return (place % 2 if field == "data" else 1) if self.sends else int(field != "acknowledge")

    def fails(self) -> None:
        """It sees an error: six dominant bits from the next one on."""
        self.flag_left, self.failed, self.taken = 6, True, False
        self.counted += 8 if self.sends else 1

    def hears(self, own: int, bit: int, field: str, equal: int) -> None:
        """What the wire was while it drove its own bit, the last of so many equal ones."""
        if self.flag_left:
            self.flag_left -= 1
            self.listens = self.failed and not self.flag_left
        elif self.failed or self.overloaded:
            if self.listens and bit == 0 and not self.sends:
                self.counted += 8
            self.listens = False
        elif self.sends:
            if bit != own and field != "acknowledge":
                self.fails()
        elif field in {"last of end", "intermission"}:
            if bit == 0:
                self.flag_left, self.overloaded = 6, True
        elif (equal >= 6) if field == "data" else (bit == 0 and field not in {"acknowledge", "idle"}):
            self.fails()


def signalled(kind: str, seers: set[int], receivers: int) -> list[tuple[int, bool]]:
    """What is counted of one error by each node, the transmitter first, and whether it has taken the frame.

    ``seers`` are the receivers that see the error, numbered from 1, where receivers do.
    """
    fields = [*TAIL, *["idle"] * BEHIND] if kind in SEEN else ["data"] * BEHIND
    stations = [Station(number == 0) for number in range(receivers + 1)]
    equal, before = 0, -1
    for place, field in enumerate(fields):
        driven = [station.drives(field, place) for station in stations]
        bit = min(driven)
        equal, before = (equal + 1 if bit == before else 1), bit
        for number, (station, own) in enumerate(zip(stations, driven, strict=True)):
            if place == SEEN.get(kind, 1) and number in (seers if kind in BY_RECEIVERS else {0}):
                station.fails()
            else:
                station.hears(own, bit, field, equal)
                if place == RIGHT_SO_FAR and kind in SEEN and not station.failed:
                    station.taken = not station.sends
    return [(station.counted, station.taken) for station in stations]
