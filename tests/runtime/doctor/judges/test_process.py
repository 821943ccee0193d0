"""Priority, memory and clocks: what each means, and what to do."""

import math

import pytest

from cutgate.config.model import Site
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import ClockSource, MemoryFacts, Priority, Synchronisation
from cutgate.runtime.doctor.finding import Condition
from cutgate.runtime.doctor.judges import process
from cutgate.runtime.doctor.judges.process import (
    judge_clock_source,
    judge_memory,
    judge_priority,
    judge_synchronisation,
)

HERE = Examined(Site(clock_skew_s=2.0), None)


def only(found):
    (one,) = found
    assert bool(one.remedy) is (one.state in {Condition.WARNING, Condition.FAIL})
    return one


@pytest.mark.parametrize(
    ("facts", "state", "told"),
    [
        (Priority("SCHED_RR", 10, 0, capable=False), Condition.OK, "SCHED_RR 10"),
        (Priority("SCHED_FIFO", 1, 0, capable=False), Condition.OK, "SCHED_FIFO 1"),
        (Priority("SCHED_OTHER", 0, 0, capable=True), Condition.OK, "CAP_SYS_NICE"),
        (Priority("SCHED_OTHER", 0, 10, capable=False), Condition.OK, "up to 10 (RLIMIT_RTPRIO)"),
        (Priority("SCHED_OTHER", 0, 9, capable=False), Condition.WARNING, "up to 9 (RLIMIT_RTPRIO)"),
        (Priority("SCHED_BATCH", 0, 0, capable=False), Condition.WARNING, "allowed: none"),
    ],
)
def test_priority_is_had_or_may_be_given_or_it_is_a_warning(facts, state, told):
    found = only(judge_priority(facts, HERE))
    assert found.state is state
    assert told in found.found
    assert ("chrt" in found.found) is (state is Condition.OK and facts.policy == "SCHED_OTHER")


@pytest.mark.parametrize(
    ("facts", "state", "told"),
    [
        (MemoryFacts(8 << 20, 0), Condition.OK, "swap: none; may be locked: up to 8 MiB"),
        (MemoryFacts(None, 0), Condition.OK, "without limit"),
        (MemoryFacts(None, 1 << 30), Condition.WARNING, "swap: 1024 MiB"),
    ],
)
def test_swap_is_a_warning(facts, state, told):
    found = only(judge_memory(facts, HERE))
    assert found.state is state
    assert told in found.found


@pytest.mark.parametrize(
    ("current", "state"),
    [
        ("tsc", Condition.OK),
        ("kvm-clock", Condition.OK),
        ("arch_sys_counter", Condition.OK),
        ("hpet", Condition.WARNING),
        ("acpi_pm", Condition.WARNING),
        ("jiffies", Condition.FAIL),
        ("refined-jiffies", Condition.FAIL),
        ("sundial", Condition.UNKNOWN),
    ],
)
def test_a_clock_source(current, state):
    found = only(judge_clock_source(ClockSource(current, (current, "tsc")), HERE))
    assert found.state is state
    assert current in found.found
    if state in {Condition.WARNING, Condition.FAIL}:
        assert "there is tsc" in found.remedy


@pytest.mark.parametrize(
    "current", ["xen", "hyperv_clocksource_tsc_page", "timebase", "riscv_clocksource", "tod"]
)
def test_clock_sources_of_other_machines_are_as_good(current):
    assert only(judge_clock_source(ClockSource(current, (current,)), HERE)).state is Condition.OK


@pytest.mark.parametrize("current", ["hyperv_clocksource_msr", "i8253", "pit"])
def test_what_is_slow_to_read_is_so_everywhere(current):
    assert only(judge_clock_source(ClockSource(current, (current,)), HERE)).state is Condition.WARNING


def test_a_better_clock_source_is_named_only_where_there_is_one():
    assert "no better one" in only(judge_clock_source(ClockSource("hpet", ("hpet", "acpi_pm")), HERE)).remedy


def test_no_clock_source_is_of_two_kinds():
    kinds = [process.SOUND_SOURCES, process.SLOW_SOURCES, process.COARSE_SOURCES]
    assert len(frozenset().union(*kinds)) == sum(map(len, kinds))


@pytest.mark.parametrize(
    ("facts", "state", "remedy"),
    [
        (Synchronisation(synchronised=True, error_max_s=0.01), Condition.OK, ""),
        (Synchronisation(synchronised=True, error_max_s=2.0), Condition.OK, ""),
        (Synchronisation(synchronised=True, error_max_s=2.1), Condition.WARNING, "chronyc sources"),
        (Synchronisation(synchronised=True, error_max_s=math.nan), Condition.WARNING, "chronyc sources"),
        (Synchronisation(synchronised=False, error_max_s=0.0), Condition.WARNING, "turn on"),
    ],
)
def test_a_clock_that_nothing_keeps_is_a_warning(facts, state, remedy):
    found = only(judge_synchronisation(facts, HERE))
    assert found.state is state
    assert remedy in found.remedy
    assert "clock_skew_s = 2 s" in found.bound
