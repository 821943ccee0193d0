"""Scheduling and memory of this process, and the kernel's clock."""

import ctypes
import os
import resource
from pathlib import Path
from typing import Final

from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import ClockSource, MemoryFacts, Priority, Synchronisation, Unknown
from cutgate.runtime.doctor.probes.text import number, read_text

PROC: Final = Path("/proc")
CLOCK_SOURCE: Final = Path("/sys/devices/system/clocksource/clocksource0")
CAP_SYS_NICE: Final = 23
KIB: Final = 1024
PRIORITY_MAX: Final = 99
POLICIES: Final = {
    os.SCHED_OTHER: "SCHED_OTHER",
    os.SCHED_FIFO: "SCHED_FIFO",
    os.SCHED_RR: "SCHED_RR",
    os.SCHED_BATCH: "SCHED_BATCH",
    os.SCHED_IDLE: "SCHED_IDLE",
}
_RESET_ON_FORK: Final = 0x40000000
_US: Final = 1e-6
_TIME_ERROR: Final = 5
"""What ``adjtimex`` returns of a clock that nothing keeps."""
_STA_UNSYNC: Final = 0x0040


def priority(_examined: Examined, proc: Path = PROC) -> Priority:
    """How this process is scheduled, and how it may be."""
    policy = os.sched_getscheduler(0) & ~_RESET_ON_FORK
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return Priority(
        policy=POLICIES.get(policy, f"policy {policy}"),
        priority=os.sched_getparam(0).sched_priority,
        limit=PRIORITY_MAX if limit == resource.RLIM_INFINITY else limit,
        capable=capable(read_text(proc / "self" / "status"), CAP_SYS_NICE),
    )


def capable(status: str | None, capability: int) -> bool:
    """Whether ``/proc/self/status`` lists an effective capability."""
    for line in (status or "").splitlines():
        name, _, value = line.partition(":")
        if name == "CapEff":
            mask = number(f"0x{value.strip()}")
            return mask is not None and bool(mask >> capability & 1)
    return False


def memory(_examined: Examined, proc: Path = PROC) -> MemoryFacts | Unknown:
    """How much may be locked, and how much swap there is."""
    swap = swap_bytes(read_text(proc / "swaps"))
    if swap is None:
        return Unknown("the kernel does not say what swap there is (/proc/swaps)")
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return MemoryFacts(None if limit == resource.RLIM_INFINITY else limit, swap)


def swap_bytes(text: str | None) -> int | None:
    """The sizes of ``/proc/swaps`` together: a head, and a line for each with the size in KiB as third field."""
    if text is None or not text.startswith("Filename"):
        return None
    sizes = [
        number(fields[2]) if len(fields := line.split()) >= 3 else None for line in text.splitlines()[1:]
    ]
    return None if None in sizes else KIB * sum(size for size in sizes if size)


def clock_source(_examined: Examined, folder: Path = CLOCK_SOURCE) -> ClockSource | Unknown:
    """What the kernel counts time by."""
    current = read_text(folder / "current_clocksource")
    if not current:
        return Unknown(f"the kernel does not say it ({folder})")
    return ClockSource(current, tuple((read_text(folder / "available_clocksource") or "").split()))


class _Timex(ctypes.Structure):
    """``struct timex`` of Linux, and room for what a later kernel may add."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


def synchronisation(_examined: Examined) -> Synchronisation | Unknown:
    """What ``adjtimex`` says when it is asked to change nothing."""
    function = getattr(ctypes.CDLL(None, use_errno=True), "adjtimex", None)
    if function is None:
        return Unknown("this C library has no adjtimex")
    asked = _Timex()  # modes 0: nothing is set
    state = function(ctypes.byref(asked))
    if state < 0:
        return Unknown(f"adjtimex: {os.strerror(ctypes.get_errno())}")
    return told(state, asked.status, asked.maxerror)


def told(state: int, status: int, error_max_us: int) -> Synchronisation:
    """What the answer of ``adjtimex`` means."""
    return Synchronisation(state != _TIME_ERROR and not status & _STA_UNSYNC, error_max_us * _US)
