"""What the kernel says of a process, as it says it and as it might."""

import os

import pytest

from cutgate.config.model import Site
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import ClockSource, MemoryFacts, Priority, Synchronisation, Unknown
from cutgate.runtime.doctor.probes import process
from cutgate.runtime.doctor.probes.process import capable, clock_source, memory, priority, swap_bytes, told
from cutgate.runtime.doctor.probes.text import TEXT_MAX, number, read_text

HERE = Examined(Site(), None)
SWAPS = "Filename\t\t\t\tType\t\tSize\t\tUsed\t\tPriority\n"


def test_the_priority_of_this_process(monkeypatch, tmp_path):
    monkeypatch.setattr(process.os, "sched_getscheduler", lambda _: os.SCHED_RR | 0x40000000)
    monkeypatch.setattr(process.os, "sched_getparam", lambda _: os.sched_param(7))
    monkeypatch.setattr(process.resource, "getrlimit", lambda _: (process.resource.RLIM_INFINITY, 0))
    assert priority(HERE, tmp_path) == Priority("SCHED_RR", 7, 99, capable=False)


def test_a_policy_without_a_name_is_told_by_its_number(monkeypatch):
    monkeypatch.setattr(process.os, "sched_getscheduler", lambda _: 6)
    assert priority(HERE).policy == "policy 6"


@pytest.mark.parametrize(
    ("status", "has"),
    [
        ("Name:\tx\nCapEff:\t0000000000800000\n", True),
        ("CapEff:\t000001ffffffffff\n", True),
        ("CapEff:\t000001ffff7fffff\n", False),
        ("CapPrm:\t000001ffffffffff\nCapEff:\t0000000000000000\n", False),
        ("CapEff:\tnone\n", False),
        ("", False),
        (None, False),
    ],
)
def test_a_capability_is_had_only_where_it_is_listed(status, has):
    assert capable(status, process.CAP_SYS_NICE) is has


@pytest.mark.parametrize(
    ("text", "size"),
    [
        (SWAPS, 0),
        (f"{SWAPS}/dev/sda2 partition\t1048572\t0\t-2\n", 1048572 * 1024),
        (f"{SWAPS}/a file 8 0 -2\n/b file 4 0 -3\n", 12 * 1024),
        (f"{SWAPS}/a file many 0 -2\n", None),
        (f"{SWAPS}/a\n", None),
        ("", None),
        (None, None),
    ],
)
def test_swap_is_added_up_and_never_guessed(text, size):
    assert swap_bytes(text) == size


def test_memory_of_this_machine(tmp_path):
    assert isinstance(memory(HERE), MemoryFacts | Unknown)
    assert isinstance(memory(HERE, tmp_path), Unknown)
    (tmp_path / "swaps").write_text(SWAPS, encoding="ascii")
    assert memory(HERE, tmp_path).swap_bytes == 0


def test_a_clock_source(tmp_path):
    assert isinstance(clock_source(HERE, tmp_path), Unknown)
    (tmp_path / "current_clocksource").write_text("hpet\n", encoding="ascii")
    assert clock_source(HERE, tmp_path) == ClockSource("hpet", ())
    (tmp_path / "available_clocksource").write_text("tsc hpet acpi_pm \n", encoding="ascii")
    assert clock_source(HERE, tmp_path) == ClockSource("hpet", ("tsc", "hpet", "acpi_pm"))


@pytest.mark.parametrize(
    ("state", "status", "synchronised"),
    [(0, 0x2001, True), (1, 0, True), (5, 0x2001, False), (0, 0x2041, False), (5, 0x40, False)],
)
def test_a_clock_is_synchronised_only_if_both_answers_say_so(state, status, synchronised):
    assert told(state, status, 1500) == Synchronisation(synchronised, 0.0015)


def test_the_clock_of_this_machine_is_asked_and_not_set():
    facts = process.synchronisation(HERE)
    assert isinstance(facts, Unknown) or facts.error_max_s >= 0


class Library:
    """A C library that answers ``adjtimex`` so; without an answer it has none."""

    def __init__(self, answer=None):
        if answer is not None:
            self.adjtimex = lambda asked: answer(asked._obj)


def test_an_adjtimex_that_is_refused_or_missing_is_unknown(monkeypatch):
    monkeypatch.setattr(process.ctypes, "CDLL", lambda *_, **__: Library(lambda _: -1))
    assert process.synchronisation(HERE).why.startswith("adjtimex: ")
    monkeypatch.setattr(process.ctypes, "CDLL", lambda *_, **__: Library())
    assert "no adjtimex" in process.synchronisation(HERE).why


def test_adjtimex_is_asked_to_set_nothing(monkeypatch):
    def answer(asked):
        assert asked.modes == 0
        asked.maxerror, asked.status = 250_000, 0
        return 0

    monkeypatch.setattr(process.ctypes, "CDLL", lambda *_, **__: Library(answer))
    assert process.synchronisation(HERE) == Synchronisation(synchronised=True, error_max_s=0.25)


def test_texts_are_read_to_a_bound_and_pipes_are_not_waited_for(tmp_path):
    (tmp_path / "long").write_bytes(b"x" * (3 * TEXT_MAX))
    os.mkfifo(tmp_path / "pipe")
    assert TEXT_MAX <= len(read_text(tmp_path / "long")) <= 2 * TEXT_MAX
    assert read_text(tmp_path / "pipe") == ""
    assert read_text(tmp_path) is None
    assert read_text(tmp_path / "none") is None


@pytest.mark.parametrize(
    ("text", "value"), [("12", 12), ("0x1f", 31), ("", None), ("x", None), (None, None), ("9" * 5000, None)]
)
def test_numbers(text, value):
    assert number(text) == value
