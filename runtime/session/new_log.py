"""A new log for a session: record 0, and every input file as the bytes that were parsed."""

import importlib.resources
import os
from collections.abc import Callable
from pathlib import Path
from socket import gethostname
from typing import Final

from cutgate.config.ours import user
from cutgate.runtime.audit import names
from cutgate.runtime.audit.commit import Committer, LogFiles
from cutgate.runtime.audit.configuration import SIMULATED
from cutgate.runtime.audit.disk import Disk
from cutgate.runtime.audit.log import AuditLog, Clock, OpenInfo
from cutgate.runtime.audit.names import READING
from cutgate.runtime.audit.recomputed.transitions import transitions_sha256
from cutgate.runtime.plan.registrations.foreign import Converted
from cutgate.runtime.plan.toolpath.languages import language_of
from cutgate.runtime.plan.toolpath.model import as_words
from cutgate.runtime.session.job import VERIFIER, InputFiles
from cutgate.runtime.session.journal import plain
from cutgate.runtime.verification.asked import AskedTurns

DECLARED: Final = "registration declared"
"""Name of record 0's option that says how a registration of another program was read."""
BRANCH: Final = "joint branch"
"""Name of record 0's option that says which turns were asked for; the path and the permit hold the branch itself."""


def new_log(
    directory: Path,
    files: InputFiles,
    path: bytes,
    bus: str,
    asked: AskedTurns,
    operator: str | None,
    *,
    log_id: bytes,
    log_key: Path | None = None,
    clock: Clock | None = None,
    committer: Callable[[Disk, LogFiles], Committer] = Committer,
) -> AuditLog:
    """A new log, in a directory that is locked from now on. Waits for the disk.

    Args:
        directory: where logs are kept.
        files: what was read.
        path: the canonical path.
        bus: interface and channel.
        asked: the joint branch that was asked for.
        operator: who runs the session, as he calls himself.
        log_id: names it, 16 random bytes.
        log_key: the file of the directory's key; else as site.toml says, or where its first session has put it.
        clock: of the computer, if none is given.
        committer: who writes and syncs the files.

    Raises:
        InputError: as ``AuditLog.create``.
    """
    settings = files.settings.log
    named = log_key or (Path(settings.key_file) if settings.key_file else None)
    log = AuditLog.create(
        directory,
        log_id=log_id.hex(),
        opened=OpenInfo(
            VERIFIER,
            VERIFIER,
            _options(files, bus, asked),
            plain(user(os.getuid())),
            plain(gethostname()),
            operator,
            transitions_sha256(),
        ),
        key_file=named,
        clock=clock,
        committer=committer,
        chunk_period_s=settings.chunk_period_ms / 1000,
    )
    prepared = files.prepared
    log.attach(f"{names.PLAN}{prepared.plan.path.suffix}", "application/octet-stream", prepared.plan.data)
    if prepared.registration is not None:
        log.attach(f"{names.REGISTRATION}.json", "application/json", prepared.registration.data)
        if isinstance(prepared.registration, Converted):
            suffix = prepared.registration.path.suffix.lower()
            source = prepared.registration.source
            log.attach(f"{names.REGISTRATION_SOURCE}{suffix}", "application/octet-stream", source)
    log.attach(names.ROBOT, "application/toml", files.robot.data)
    if files.site is not None:
        log.attach(names.SITE, "application/toml", files.site.data)
    log.attach(names.PATH, "application/octet-stream", path)
    dbc = importlib.resources.files("cutgate.protocol").joinpath("cutgate.dbc").read_bytes()
    log.attach(names.DBC, "text/plain", dbc)
    return log


def _options(files: InputFiles, bus: str, asked: AskedTurns) -> tuple[tuple[str, str], ...]:
    """What record 0 says: the bus; a joint branch that was asked for; how a registration was read; an allowed simulation."""
    allowed_by = files.simulation_allowed_by
    allowed = ((SIMULATED, f"allowed by {allowed_by}"),) if allowed_by else ()
    branch = ((BRANCH, f"asked for: {asked}"),) if str(asked) else ()
    placed = files.prepared.registration
    declared = ((DECLARED, plain(str(placed.declared))),) if isinstance(placed, Converted) else ()
    return (("bus", plain(bus)), *branch, *declared, *_reading(files), *allowed)


def _reading(files: InputFiles) -> tuple[tuple[str, str], ...]:
    """How a tool path was read, where its language leaves anything open: a replay reads it in the same way."""
    language = language_of(files.prepared.plan.path)
    return ((READING, as_words(files.reading, language.declared)),) if language and language.declared else ()
