"""A session and the list of withdrawn registrations: asked before it begins, added to when it ends."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

from cutgate.config.load import SETTINGS_LIMIT, InputError
from cutgate.protocol import records
from cutgate.runtime.audit import names
from cutgate.runtime.audit.directory import Listed
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.interlock.state import Interlock, Phase
from cutgate.runtime.plan.load import registration_from_bytes
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.session import withdrawn
from cutgate.runtime.session.journal import plain
from cutgate.runtime.session.withdrawn import NO_REGISTRATION, Withdrawal

WITHDRAW_S: Final = 5.0
"""So long is the disk waited for that is to list a withdrawal."""


def listed_before(log: AuditLog) -> tuple[Withdrawal, ...]:
    """Every withdrawal in the list beside the log, which is read under the lock.

    Lines of 0.1.0 are completed first; the disk is waited for.

    Args:
        log: the session's, just begun.

    Raises:
        InputError: the list cannot be believed or completed; the log is closed.
    """
    try:
        listed = withdrawn.load(log.path.parent)
        older = withdrawn.incomplete(listed)
        if older:
            listed += _completed(log, older)
    except InputError as error:
        log.close(final_state=Phase.REFUSED, outcome=plain(str(error)), clean=True)
        raise
    return listed


def _completed(log: AuditLog, older: Sequence[Withdrawal]) -> tuple[Withdrawal, ...]:
    """What is added to the list for lines of 0.1.0."""
    directory = log.path.parent
    attached = {one.log: attached_registration(directory / one.log, one.registration) for one in older}
    added = withdrawn.complete(older, attached, datetime.now(UTC))
    try:
        log.listed = withdrawn.add(directory, added, log.listed)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            directory,
            "list of withdrawn registrations",
            reason,
            "a list that can be written",
            "make room there",
        ) from None
    return added


def attached_registration(path: Path, file: bytes) -> Registration | None:
    """The registration with this SHA-256 that a log holds; None if there is none, or no log any more.

    The digest is what it is believed by, whatever else is wrong with the log.
    """
    with suppress(InputError), reading(path) as log:
        entry = log.scan.attachment(f"{names.REGISTRATION}.json")
        if entry is not None and entry.size <= SETTINGS_LIMIT and sha256(entry.data).digest() == file:
            return registration_from_bytes(path, entry.data)
    return None


def of_session(
    state: Interlock, log: str, registration: Registration | None, skew_s: float
) -> Iterator[Withdrawal]:
    """What a session adds to the list: what was due at the controller before it, and its own registration.

    Args:
        state: as the session ended.
        log: its log's name.
        registration: its own; None for a path in robot coordinates.
        skew_s: ``clock_skew_s`` of the site.
    """
    moved = state.opened is not None and state.opened.withdrawal_due
    if moved and state.barrier_us != records.NO_TIME:  # else the next session is told of it, as this one was
        yield withdrawn.of_motion(log, state.barrier_us, skew_s)
    if state.registration_withdrawn:
        yield withdrawn.of_now(state.job.registration, log, registration, datetime.now(UTC))


def list_withdrawal(log: AuditLog, entry: Withdrawal, note: Callable[[str], None]) -> None:
    """List it for every session to come, whether or not the controller has heard of it; a silent disk is left behind.

    Args:
        log: the session's, not closed yet.
        entry: with the time since when it is known.
        note: told where it could not be listed.
    """
    answers: SimpleQueue[Listed | Exception] = SimpleQueue()

    def add() -> None:
        try:
            answers.put(withdrawn.add(log.path.parent, (entry,), log.listed))
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told below
            answers.put(error)

    Thread(target=add, name="withdraw", daemon=True).start()
    trouble: object = f"the disk did not answer within {WITHDRAW_S:g} s"
    with suppress(Empty):
        match answers.get(timeout=WITHDRAW_S):
            case Listed() as listed:
                log.listed = listed
                return
            case error:
                trouble = error
    which = (
        "any registration" if entry.registration == NO_REGISTRATION else "this registration again, nor any"
    )
    note(
        f"the withdrawal could not be listed ({trouble}): never use {which} that was taken "
        f"before {entry.known:%Y-%m-%d %H:%M:%S} UTC"
    )
