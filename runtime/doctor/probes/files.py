"""Key file, log directory and its disk. The one file that is written is taken away again."""

import os
import secrets
import shlex
import statistics
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from cutgate.config.durable import create_ours
from cutgate.config.key import load_key
from cutgate.config.load import InputError
from cutgate.config.refusal import FileProblem
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.audit.directory import LOCK, check_head, check_ours, withdrawn_list
from cutgate.runtime.audit.log_keys import check_key
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Delays, FreeSpace, KeyFile, LogFolder, Unknown
from cutgate.runtime.doctor.probes.text import number, read_text

WRITES: Final = 20
WRITE_BYTES: Final = 4096
DISK_S: Final = 5.0
"""No further write is begun after this."""
LOCKS: Final = Path("/proc/locks")
BEGIN: Final = ".cutgate-doctor-"
_FREE: Final = "make a folder of your own there, or name another with --log-dir"


def key(examined: Examined) -> KeyFile | Unknown:
    """Read the key as a session does."""
    if examined.key is None:
        remedy = "name it with --key, or key_file in site.toml; make one with: cutgate key new FILE"
        return Unknown("no key file is named", remedy)
    try:
        return KeyFile(str(examined.key), fingerprint(load_key(examined.key)), None)
    except InputError as error:
        return KeyFile(str(examined.key), "", error.problems[0])


def log_folder(examined: Examined) -> LogFolder:
    """Whether a session could begin a log there; nothing is made and nothing locked."""
    directory = examined.log_directory
    try:
        there = _enterable(directory)
        if there:
            check_head(directory, time.time_ns())
            withdrawn_list(directory)
        named = examined.site.log.key_file
        check_key(directory, Path(named) if named else None)
    except InputError as error:
        return LogFolder(str(directory), os.path.isdir(directory), error.problems[0], None)  # noqa: PTH112
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        found, bound = getattr(error, "strerror", None) or str(error), "a directory that can be reached"
        remedy = "let this user enter what is above it, or name another with --log-dir"
        problem = FileProblem(str(directory), "log directory", found, bound, remedy)
        return LogFolder(str(directory), True, problem, None)
    return LogFolder(str(directory), there, None, session_in(directory))


def _enterable(directory: Path) -> bool:
    """Whether it is there, and can be written; else it could be made.

    Raises:
        InputError: neither.
    """
    try:
        found = directory.stat()
    except FileNotFoundError:
        above = nearest(directory)
        if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK, effective_ids=_EFFECTIVE)):
            bound = f"one that this user can make: {above} cannot be written"
            raise InputError(directory, "log directory", "missing", bound, _FREE) from None
        return False
    if not directory.is_dir():
        raise InputError(directory, "log directory", "a file", "a directory that can be written", _FREE)
    check_ours(directory, found)
    if not os.access(directory, os.R_OK | os.W_OK | os.X_OK, effective_ids=_EFFECTIVE):
        raise InputError(
            directory,
            "log directory",
            "not writable",
            "a directory that can be written",
            f"chmod 700, or {_FREE}",
        )
    return True


_EFFECTIVE: Final = os.access in os.supports_effective_ids


def nearest(directory: Path) -> Path:
    """The first that is there, of the folder and those above it."""
    path = directory.absolute()
    return next((one for one in (path, *path.parents) if os.path.lexists(one)), path)


def session_in(directory: Path, locks: Path = LOCKS) -> int | None:
    """The process that holds the directory's lock, as the kernel lists it: to try it would keep a session out.

    Found by the file's number alone: some file systems tell ``stat`` another device than the list.
    """
    try:
        inode = os.lstat(directory / LOCK).st_ino
    except OSError:
        return None
    for line in (read_text(locks) or "").splitlines():
        # 1: FLOCK  ADVISORY  WRITE 3456 fd:00:12345 0 EOF
        fields = line.split()
        if len(fields) >= 6 and fields[1] == "FLOCK" and fields[5].rpartition(":")[2] == str(inode):
            return number(fields[4])
    return None


def free_space(examined: Examined, statvfs: Callable[[Path], os.statvfs_result] = os.statvfs) -> FreeSpace:
    """What is free where the log is, or would be made."""
    folder = nearest(examined.log_directory)
    found = statvfs(folder)
    return FreeSpace(str(folder), found.f_bavail * found.f_frsize)


def disk_delays(
    examined: Examined,
    clock: Callable[[], float] = time.monotonic,
    sync: Callable[[int], None] = os.fdatasync,
) -> Delays | Unknown:
    """Write a few blocks into a file of a fresh name in the log directory, each made durable, and remove it."""
    directory = examined.log_directory
    if not directory.is_dir():
        remedy = f"make it and look again: mkdir -m 700 {shlex.quote(str(directory))}"
        return Unknown(f"{directory} is not there yet", remedy)
    if (session := session_in(directory)) is not None:
        return Unknown(
            f"a session runs there (process {session}): its disk is left alone", "look again after it"
        )
    path = directory / f"{BEGIN}{secrets.token_hex(8)}"
    descriptor = create_ours(path)
    try:
        return _delays(descriptor, clock, sync)
    finally:
        os.close(descriptor)
        with suppress(OSError):
            path.unlink()


def _delays(descriptor: int, clock: Callable[[], float], sync: Callable[[int], None]) -> Delays:
    block, until_s = bytes(WRITE_BYTES), clock() + DISK_S
    taken_s: list[float] = []
    while len(taken_s) < WRITES and (not taken_s or clock() < until_s):
        os.write(descriptor, block)
        began_s = clock()
        sync(descriptor)
        taken_s.append(clock() - began_s)
    return delays(taken_s)


def delays(seconds: list[float]) -> Delays:
    """Median and worst of some times; at least one."""
    return Delays(len(seconds), 1000 * statistics.median(seconds), 1000 * max(seconds))
