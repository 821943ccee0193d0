"""A session and the list of withdrawn registrations: asked before it begins, added to when it ends."""

from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

from cutgate.config.load import InputError
from cutgate.runtime.audit.directory import Listed
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session import withdrawn
from cutgate.runtime.session.journal import plain

WITHDRAW_S: Final = 5.0
"""So long is the disk waited for that is to list a withdrawal."""


def withdrawn_in(log: AuditLog, registration: bytes) -> str | None:
    """The log that tells why this registration was withdrawn, None if it was not; the list is read under the lock.

    Raises:
        InputError: the list cannot be believed; the log is closed.
    """
    try:
        return withdrawn.load(log.path.parent).get(registration)
    except InputError as error:
        log.close(final_state=Phase.REFUSED, outcome=plain(str(error)), clean=True)
        raise


def list_withdrawal(log: AuditLog, registration: bytes, note: Callable[[str], None]) -> None:
    """List it for every session to come, whether or not the controller has heard of it; a silent disk is left behind.

    Args:
        log: the session's, not closed yet.
        registration: SHA-256 digest.
        note: told where it could not be listed.
    """
    answers: SimpleQueue[Listed | Exception] = SimpleQueue()

    def add() -> None:
        try:
            answers.put(withdrawn.add(log.path.parent, registration, log.path.name, log.listed))
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
    note(f"the withdrawal could not be listed ({trouble}): never use this registration again")
