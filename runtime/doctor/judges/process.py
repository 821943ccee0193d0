"""Whether this process gets the processor in time, keeps its memory, and has a clock that can be believed."""

from collections.abc import Iterable
from typing import Final

from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import ClockSource, MemoryFacts, Priority, Synchronisation
from cutgate.runtime.doctor.finding import Condition, Finding, within

PRIORITY: Final = 10
"""What docs/timing.md gives the loop: above everything ordinary, below the kernel's own threads."""
REAL_TIME: Final = ("SCHED_FIFO", "SCHED_RR")
MIB: Final = 1 << 20

SOUND_SOURCES: Final = frozenset(
    {
        "tsc",
        "kvm-clock",
        "xen",
        "hyperv_clocksource_tsc_page",
        "arch_sys_counter",
        "timebase",
        "riscv_clocksource",
        "tod",
    }
)
"""Read in some ten nanoseconds, and never back."""
SLOW_SOURCES: Final = frozenset({"hpet", "acpi_pm", "hyperv_clocksource_msr", "i8253", "pit"})
"""A microsecond or more a look. The kernel takes one of these when it has given the better one up."""
COARSE_SOURCES: Final = frozenset({"jiffies", "refined-jiffies"})
"""Stand still between ticks of up to 10 ms."""


def judge_priority(facts: Priority, _examined: Examined) -> Iterable[Finding]:
    """The loop has a real-time priority, or may be given one."""
    bound = f"real-time, or allowed up to {PRIORITY}"
    if facts.policy in REAL_TIME:
        yield Finding("real-time priority", Condition.OK, f"{facts.policy} {facts.priority}", bound)
        return
    allowed = "any (CAP_SYS_NICE)" if facts.capable else f"up to {facts.limit} (RLIMIT_RTPRIO)"
    may = facts.capable or facts.limit >= PRIORITY
    found = f"{facts.policy}; allowed: {allowed if may or facts.limit else 'none'}"
    if may:
        found += f", given by: chrt --rr {PRIORITY} cutgate run"
    remedy = (
        "a line @GROUP - rtprio 10 in /etc/security/limits.d and a new login, or the unit of systemd "
        "(docs/timing.md)"
    )
    yield Finding("real-time priority", within(may, Condition.WARNING), found, bound, "" if may else remedy)


def judge_memory(facts: MemoryFacts, _examined: Examined) -> Iterable[Finding]:
    """Nothing of the process has to come back from swap: cutgate locks no memory itself."""
    lockable = (
        "without limit" if facts.lockable_bytes is None else f"up to {facts.lockable_bytes / MIB:.0f} MiB"
    )
    swap = f"{facts.swap_bytes / MIB:.0f} MiB" if facts.swap_bytes else "none"
    remedy = "as root: swapoff -a, or MemorySwapMax=0 in the unit; cutgate does not lock its memory"
    yield Finding(
        "memory",
        within(facts.swap_bytes == 0, Condition.WARNING),
        f"swap: {swap}; may be locked: {lockable}",
        "no swap",
        remedy if facts.swap_bytes else "",
    )


def judge_clock_source(facts: ClockSource, _examined: Examined) -> Iterable[Finding]:
    """Time is read quickly and finely."""
    name, bound = "clock source", "one that is fine and read quickly"
    others = [one for one in facts.available if one in SOUND_SOURCES and one != facts.current]
    better = f"there is {', '.join(others)}" if others else "the kernel offers no better one"
    remedy = f"{better}: see why it was given up (dmesg | grep -i clocksource), then the firmware's settings"
    if facts.current in SOUND_SOURCES:
        yield Finding(name, Condition.OK, facts.current, bound)
    elif facts.current in COARSE_SOURCES:
        yield Finding(name, Condition.FAIL, f"{facts.current}: stands still between ticks", bound, remedy)
    elif facts.current in SLOW_SOURCES:
        yield Finding(name, Condition.WARNING, f"{facts.current}: slow to read", bound, remedy)
    else:
        yield Finding(name, Condition.UNKNOWN, f"{facts.current}: not known here", bound, "")


def judge_synchronisation(facts: Synchronisation, examined: Examined) -> Iterable[Finding]:
    """The clock is kept by something, as closely as registrations are compared by it."""
    skew_s = examined.site.clock_skew_s
    bound = f"synchronised, within clock_skew_s = {skew_s:g} s"
    if not facts.synchronised:
        found, remedy = (
            "not synchronised",
            "turn on time synchronisation: chrony, or timedatectl set-ntp true",
        )
        yield Finding("clock synchronisation", Condition.WARNING, found, bound, remedy)
        return
    holds = facts.error_max_s <= skew_s
    remedy = "" if holds else "look at the time servers: chronyc sources, or timedatectl timesync-status"
    found = f"synchronised, error at most {facts.error_max_s:.3g} s"
    yield Finding("clock synchronisation", within(holds, Condition.WARNING), found, bound, remedy)
