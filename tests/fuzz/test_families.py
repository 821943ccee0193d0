"""Any bytes: only the documented refusal leaves a parser, and what it accepts has one form."""

import importlib
import pkgutil
import struct
import sys
import tracemalloc

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tools import fuzz
from tools.fuzz.harness import BrokenPromiseError, Family, attempt, choose, expect

ENGINES = {"harness", "search"}
FAMILIES: dict[str, Family] = {
    name: importlib.import_module(f"tools.fuzz.{name}").FAMILY
    for _, name, _ in pkgutil.iter_modules(fuzz.__path__)
    if name not in ENGINES
}
EXAMPLES = {"audit": 30, "transfers": 60}
SEED_BYTES_MAX = 20_000
"""Hypothesis shows what it draws; larger seeds are for `make fuzz` and the tests of the log."""
LYING_LENGTHS = [0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF]

families = pytest.mark.parametrize("name", sorted(FAMILIES))


def many(name: str):
    """As many examples as the family is quick; the budget of all is a minute."""
    checks = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=EXAMPLES.get(name, 150), deadline=None, suppress_health_check=checks)


@st.composite
def mutated(draw: st.DrawFn, seeds: tuple[bytes, ...]) -> bytes:
    """A sound input with up to four changes: bits, stretches cut, doubled, taken from elsewhere, lengths that lie."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data)))
        end = min(len(data), at + draw(st.integers(0, 40)))
        match draw(st.integers(0, 6)):
            case 0 if at < len(data):
                data[at] ^= 1 << draw(st.integers(0, 7))
            case 1:
                del data[at:]
            case 2:
                data[end:end] = data[at:end]
            case 3:
                del data[at:end]
            case 4:
                lie = draw(st.sampled_from(LYING_LENGTHS))
                size = draw(st.sampled_from([1, 2, 4, 8]))
                field = (lie & ((1 << 8 * size) - 1)).to_bytes(size, draw(st.sampled_from(["little", "big"])))
                data[at : at + size] = field
            case 5:
                other = draw(st.sampled_from(seeds))
                start = draw(st.integers(0, len(other)))
                data[at:end] = other[start : start + 40]
            case 6:
                data[at:at] = draw(st.binary(max_size=12))
    return bytes(data)


def test_every_family_of_parsers_is_here():
    assert set(FAMILIES) == {
        "audit", "bus", "certificate", "files", "frames", "records", "stored", "terminal", "transfers",
    }  # fmt: skip


@families
def test_sound_inputs_and_nothing_at_all_keep_every_promise(name):
    for seed in (*FAMILIES[name].seeds, b"", b"\0"):
        FAMILIES[name].check(seed)


@families
def test_any_bytes_keep_every_promise(name):
    @given(st.binary(max_size=300))
    @many(name)
    def any_bytes(data):
        FAMILIES[name].check(data)

    any_bytes()


@families
def test_changed_inputs_keep_every_promise(name):
    @given(mutated(tuple(seed for seed in FAMILIES[name].seeds if len(seed) <= SEED_BYTES_MAX)))
    @many(name)
    def changed(data):
        FAMILIES[name].check(data)

    changed()


# ---------------------------------------------------------------- memory and work

MEMORY_FIXED, MEMORY_A_BYTE = 3_000_000, 200
CALLS_FIXED, CALLS_A_BYTE = 60_000, 400


def cost(check, data: bytes) -> tuple[int, int]:
    """Peak of memory above the start, bytes, and number of function calls: neither depends on a machine's speed."""
    calls = 0

    def count(_frame, event, _argument):
        nonlocal calls
        calls += event in {"call", "c_call"}

    tracemalloc.start()
    try:
        check(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    before = sys.getprofile()
    sys.setprofile(count)
    try:
        check(data)
    finally:
        sys.setprofile(before)
    return peak, calls


def lies(seed: bytes):
    """The input with the largest numbers that fit written over it, at places all over it, its first bytes densely."""
    places = [*range(1, min(len(seed), 60)), *range(60, len(seed), max(1, len(seed) // 12))]
    for at in places:
        for lie in (struct.pack("<I", 0xFFFFFFFF), struct.pack("<Q", 1 << 62), b"\xff\x7f"):
            yield seed[:at] + lie + seed[at + len(lie) :]


@families
def test_a_length_that_lies_costs_neither_memory_nor_work(name):
    """Bounded by the input's own length, whatever the input says of itself."""
    family = FAMILIES[name]
    whole = [
        seed for seed in family.seeds if name != "audit" or seed[0] == 0
    ]  # a forged log is made, not read
    for seed in whole[:: 1 + len(whole) // 3]:
        family.check(seed)  # what is imported or kept for ever is not the input's doing
        for number, data in enumerate(lies(seed)):
            if number % (97 if name == "audit" else 11) == 0:
                peak, calls = cost(family.check, data)
                assert peak <= MEMORY_FIXED + MEMORY_A_BYTE * len(data), (len(data), peak)
                assert calls <= CALLS_FIXED + CALLS_A_BYTE * len(data), (len(data), calls)


# ---------------------------------------------------------------- the harness itself


def test_a_refusal_that_is_not_documented_is_a_finding():
    with pytest.raises(KeyError):
        attempt(ValueError, {}.__getitem__, "a")
    assert attempt(KeyError, {}.__getitem__, "a") is None
    assert attempt(KeyError, {"a": 1}.__getitem__, "a") == 1


def test_a_refusal_without_a_word_and_a_broken_promise_are_findings():
    def silent():
        raise ValueError

    with pytest.raises(BrokenPromiseError, match="reason"):
        attempt(ValueError, silent)
    with pytest.raises(BrokenPromiseError, match="so"):
        expect(False, "so")
    expect(True, "so")


def test_the_first_byte_chooses():
    assert choose(b"\x05rest", ("a", "b", "c")) == ("c", b"rest")
    assert choose(b"", ("a", "b")) == ("a", b"")
