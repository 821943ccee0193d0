"""A check looks, then judges; what cannot be found is unknown and never good."""

import pytest

from cutgate.runtime.doctor.checks import Probed, findings
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Unknown
from cutgate.runtime.doctor.finding import Condition, Finding
from cutgate.runtime.doctor.installation import INSTALLATION
from cutgate.runtime.doctor.machine import MACHINE


def judged(facts, examined):
    return [Finding("a", Condition.OK, f"{facts} of {examined}", "b")]


def failing(_examined):
    raise PermissionError(13, "Permission denied")


def nameless(_examined):
    raise ValueError("embedded null byte")


def test_facts_are_judged():
    assert list(findings([Probed("a", "b", str.upper, judged)], "x")) == [
        Finding("a", Condition.OK, "X of x", "b")
    ]


def test_what_a_probe_cannot_know_is_unknown_with_its_reason():
    check = Probed("a", "b", lambda _: Unknown("asleep", "wake it"), judged)
    assert list(findings([check], "x")) == [Finding("a", Condition.UNKNOWN, "asleep", "b", "wake it")]


@pytest.mark.parametrize(("probe", "why"), [(failing, "Permission denied"), (nameless, "embedded null byte")])
def test_a_probe_that_fails_ends_nothing(probe, why):
    (found, after) = findings([Probed("a", "b", probe, judged), Probed("c", "d", str.upper, judged)], "x")
    assert (found.state, found.found) == (Condition.UNKNOWN, f"could not be looked at: {why}")
    assert after.state is Condition.OK


def test_each_table_names_what_it_asks_for():
    for check in (*INSTALLATION, *MACHINE):
        assert check.name
        assert check.bound


def test_without_a_word_vcan0_is_looked_at():
    assert Examined.__dataclass_fields__["channel"].default == "vcan0"
