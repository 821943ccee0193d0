"""Registrations that this site must never use again: the runtime's own list, beside its logs.

The controller keeps a list as well, but a withdrawal that never reached it (a dead bus, a controller without power)
would be forgotten without this one. One line each: the registration's digest (`Registration.digest`; in a line of 0.1.0
its file's SHA-256), the log that tells why, the digest of the place that it gave the bone, and when this side learned of
it. What is withdrawn is the place, whatever else is written around it; and every registration that was taken before, for
the bone has moved since.

Lines are only ever added, and HEAD says how many there are; a list that cannot be read, or has lost any, stops the next
session, for nobody knows what it held. Lines of 0.1.0 have neither place nor time; `complete` adds a line with both.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cutgate.config.load import InputError
from cutgate.protocol.times import BEGINNING
from cutgate.runtime.audit.directory import WITHDRAWN, Listed, extend_list, withdrawn_list
from cutgate.runtime.plan.registration import Registration

_ENTRY: Final = re.compile(
    r"(?P<registration>[0-9a-f]{64}) (?P<log>\S+)"
    r"(?: (?P<place>[0-9a-f]{64}|-) (?P<known>\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z))?"
)
YEAR_MAX: Final = 2999
"""Nobody withdraws later; and no sum of times is too large."""
_TIME: Final = "%Y-%m-%dT%H:%M:%S.%fZ"
_SECOND: Final = timedelta(seconds=1)
NO_REGISTRATION: Final = bytes(32)
"""Stands in a line for no registration in particular: the bone moved before the session, as the controller tells."""


@dataclass(frozen=True)
class Withdrawal:
    """One line of the list.

    Attributes:
        registration: its digest, or, of 0.1.0, its file's.
        log: name of the log that tells why.
        place: digest of the place (``Registration.place``); None where nobody can tell it any more.
        known: when this side learned of it, aware; None in a line of 0.1.0.
    """

    registration: bytes
    log: str
    place: bytes | None = None
    known: datetime | None = None

    def line(self) -> bytes:
        """As it stands in the list."""
        if self.known is None:
            return f"{self.registration.hex()} {self.log}\n".encode("ascii")
        place = "-" if self.place is None else self.place.hex()
        return f"{self.registration.hex()} {self.log} {place} {self.known.astimezone(UTC):{_TIME}}\n".encode(
            "ascii"
        )


def load(directory: Path) -> tuple[Withdrawal, ...]:
    """Every withdrawal, in the order of the list; empty where nothing was ever withdrawn.

    Raises:
        InputError: the list is not whole (``audit.directory.withdrawn_list``) or a line of it is no entry.
    """
    file = directory / WITHDRAWN
    try:
        lines = withdrawn_list(directory).decode("ascii").split("\n")
    except UnicodeDecodeError as error:
        raise InputError(file, "list of withdrawn registrations", None, f"cannot be read: {error}") from None
    entries = [_entry(file, number, line) for number, line in enumerate(lines[:-1], start=1)]
    if lines[-1]:  # the power went while it was written
        raise _no_entry(file, len(lines), lines[-1])
    return tuple(entries)


def _entry(file: Path, number: int, line: str) -> Withdrawal:
    found = _ENTRY.fullmatch(line)
    if found is None:
        raise _no_entry(file, number, line)
    digest, place, known = (found[name] for name in ("registration", "place", "known"))
    try:
        at = None if known is None else datetime.fromisoformat(known)
    except ValueError:  # the 31st of February
        raise _no_entry(file, number, line) from None
    if at is not None and not at.year <= YEAR_MAX:
        raise _no_entry(file, number, line)
    where = bytes.fromhex(place) if place not in {None, "-"} else None
    return Withdrawal(bytes.fromhex(digest), found["log"], where, at)


def _no_entry(file: Path, number: int, line: str) -> InputError:
    bound = "a registration's SHA-256, the name of a log, place and time, and an end of line"
    return InputError(file, f"line {number}", line, bound, "restore the list from a backup")


def add(directory: Path, added: Iterable[Withdrawal], known: Listed | None = None) -> Listed:
    """List withdrawals; they are on the disk, directory entry included, when this returns.

    Args:
        directory: the log directory, locked by this session.
        added: at least one.
        known: how the list stood when the session began.

    Returns:
        How the list stands, for HEAD.

    Raises:
        InputError: the list or HEAD is not ours.
        OSError: it cannot be written.
    """
    return extend_list(directory, b"".join(one.line() for one in added), known)


def incomplete(listed: Sequence[Withdrawal]) -> tuple[Withdrawal, ...]:
    """Lines of 0.1.0 to which none with a time has been added."""
    timed = {(one.registration, one.log) for one in listed if one.known is not None}
    return tuple(one for one in listed if one.known is None and (one.registration, one.log) not in timed)


def complete(
    lines: Iterable[Withdrawal], attached: Mapping[str, Registration | None], now: datetime
) -> tuple[Withdrawal, ...]:
    """The same with place and time: the place that the named log holds, and now, for nobody wrote down when it was.

    Args:
        lines: of 0.1.0.
        attached: by log, the registration that it holds; None where it holds none with this digest.
        now: aware.
    """
    found = ((one, attached[one.log]) for one in lines)
    return tuple(
        Withdrawal(one.registration, one.log, None if placed is None else placed.place, now)
        for one, placed in found
    )


def of_now(digest: bytes, log: str, registration: Registration | None, now: datetime) -> Withdrawal:
    """What is to be listed: known now, and never before the registration itself, whatever became of the clock."""
    if registration is None:
        return Withdrawal(digest, log, None, now)
    return Withdrawal(digest, log, registration.place, max(now, registration.created))


def of_motion(log: str, barrier_us: int, skew_s: float) -> Withdrawal:
    """What is to be listed where the bone moved before the session: which place it was, the controller does not tell.

    Args:
        log: name of the log that tells why.
        barrier_us: what the controller was told (``barrier``), since 1970, UTC.
        skew_s: what it was told beyond the time itself.
    """
    told = BEGINNING + timedelta(microseconds=barrier_us)
    return Withdrawal(NO_REGISTRATION, log, None, told - timedelta(seconds=skew_s))


def barrier(
    now: datetime,
    motion_age_s: int | None,
    registration: Registration | None,
    listed: Sequence[Withdrawal],
    skew_s: float,
) -> datetime:
    """Only a registration later than this counts after a withdrawal: never before any time that this side has seen.

    Args:
        now: aware; a clock that was set back lowers nothing.
        motion_age_s: how long ago the bone moved, s. Where nobody knows, or that is now, it is this side's registration
            that does not count any more.
        registration: what it says; None for a path that is in robot coordinates.
        listed: every withdrawal that was known when the session began.
        skew_s: how far the clock of who registers may be ahead of this one, s.
    """
    seen = [one.known for one in listed if one.known is not None]
    if motion_age_s is None and registration is not None:
        seen.append(registration.created)
    learned = now - timedelta(seconds=motion_age_s or 0)
    return max((learned, *seen)) + timedelta(seconds=skew_s)


def refusal(
    listed: Sequence[Withdrawal],
    digests: Collection[bytes],
    registration: Registration | None,
    skew_s: float,
) -> str:
    """Why a registration must not be used; empty if it may.

    Args:
        listed: every withdrawal.
        digests: what the registration is known by, and its file's SHA-256, by which lines of 0.1.0 know it.
        registration: what it says; None for a path that is in robot coordinates, which has no time.
        skew_s: how far the clock of who registers may be ahead of this one, s.
    """
    for one in listed:
        if one.registration in digests:
            return f"this registration was withdrawn in {one.log}: register the bone anew"
        if registration is not None and one.place == registration.place:
            return f"the same place was withdrawn in {one.log}, under whatever name: register the bone anew"
    barriers = [(one.known, one.log) for one in listed if one.known is not None]
    if not barriers:
        return ""
    known, log = max(barriers)
    first = known + timedelta(seconds=skew_s)
    taken = None if registration is None else registration.created
    if taken is not None and taken > first:
        return ""
    which = "without a time" if taken is None else f"of {taken:%Y-%m-%d %H:%M:%S} UTC"
    return (
        f"a registration {which} is not surely later than the withdrawal in {log}, known here since {known:%Y-%m-%d %H:%M:%S} UTC "
        f"(clock_skew_s {skew_s:g} s): register the bone anew; what is taken from {first + _SECOND:%Y-%m-%d %H:%M:%S} UTC on counts"
    )
