"""Settings told: each one is there, with what the model itself says and does about it."""

import pytest
from pydantic import BaseModel

from cutgate.config.constants import CONSTANTS, grouped
from cutgate.config.load import InputError, site_from_bytes
from cutgate.config.model import Site
from cutgate.config.settings import Source, settings

DEFAULTS = {one.key: one for one in settings(Site())}
NUMBERS = [key for key, one in DEFAULTS.items() if " to " in one.bounds and one.bounds[-1].isdigit()]


def keys_of(model, before=""):
    """The leaves of the model, found in its annotations."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from keys_of(field.annotation, f"{name}.")
        elif name != "schema_":
            yield f"{before}{name}"


def site_with(key, text):
    """A site.toml in which one key has this value, and the other of heartbeat and time-out lets it."""
    table, _, name = key.rpartition(".")
    head = f"[{table}]\n" if table else ""
    more = {"heartbeat_ms": "\ntimeout_ms = 1000", "timeout_ms": "\nheartbeat_ms = 5"}.get(name, "")
    return site_from_bytes("site.toml", f'schema = "cutgate.site/1"\n{head}{name} = {text}{more}\n'.encode())


def low_and_high(bounds):
    low, high = (part.replace(" ", "") for part in bounds.removeprefix("over ").split(" to "))
    return float(low), float(high)


def test_every_setting_of_the_model_is_told_once_and_nothing_else():
    told = [one.key for one in settings(Site())]
    assert sorted(told) == sorted(keys_of(Site))
    assert len(told) == len(set(told)) > 30


@pytest.mark.parametrize("setting", DEFAULTS.values(), ids=DEFAULTS.keys())
def test_each_says_what_it_does_and_where_it_ends(setting):
    assert setting.effect
    assert setting.bounds
    assert setting.source is Source.DEFAULT
    assert "\n" not in setting.effect


@pytest.mark.parametrize("setting", DEFAULTS.values(), ids=DEFAULTS.keys())
def test_a_unit_in_the_name_is_the_unit_that_is_told(setting):
    suffixes = {
        "_bit_s": "bit/s",
        "_ms": "ms",
        "_s": "s",
        "_mm": "mm",
        "_deg": "deg",
        "_mb": "MB",
        "_percent": "%",
    }
    unit = next((unit for suffix, unit in suffixes.items() if setting.name.endswith(suffix)), None)
    assert unit in (None, setting.unit)


@pytest.mark.parametrize("name", CONSTANTS)
def test_a_constant_is_told_as_the_one_table_has_it(name):
    one = next(one for one in DEFAULTS.values() if one.name == name)
    constant = CONSTANTS[name]
    assert (one.value, one.unit, one.effect) == (constant.default, constant.unit, constant.meaning)
    assert one.bounds.startswith(f"{grouped(constant.low)} to {grouped(constant.high)}")


@pytest.mark.parametrize("key", NUMBERS)
def test_the_bounds_told_are_those_that_the_model_keeps(key):
    """The bounds are read back from the words and tried."""
    words = DEFAULTS[key].bounds.split(" in steps")[0]
    low, high = low_and_high(words)
    whole = isinstance(DEFAULTS[key].value, int)
    step = 1 if whole else 0.001
    show = (lambda value: str(int(value))) if whole else (lambda value: repr(round(value, 3)))
    if key == "timing.timeout_ms":  # below it is the rule of four heartbeats that refuses, as its effect says
        low = 20
    inside = [low + step if words.startswith("over") else low, high]
    outside = [low if words.startswith("over") else low - step, high + step]
    for value in inside:
        site_with(key, show(value))
    for value in outside:
        with pytest.raises(InputError, match=key.rpartition(".")[2]):
            site_with(key, show(value))


@pytest.mark.parametrize("key", [key for key, one in DEFAULTS.items() if " in steps of " in one.bounds])
def test_a_value_between_two_steps_is_refused(key):
    assert DEFAULTS[key].bounds.endswith("in steps of 0.001")
    with pytest.raises(InputError, match="thousandths"):
        site_with(key, "0.5005")


def test_what_is_in_the_file_is_the_files_and_the_rest_the_defaults():
    text = b'schema = "cutgate.site/1"\nkey_file = "a.key"\n[timing]\nheartbeat_ms = 20\n[bus]\n'
    found = {one.key: one for one in settings(site_from_bytes("site.toml", text))}
    assert {key for key, one in found.items() if one.source is Source.SITE} == {
        "key_file",
        "timing.heartbeat_ms",
    }
    assert found["key_file"].value == "a.key"
    assert {key: one.value for key, one in found.items()} == {
        **{key: one.value for key, one in DEFAULTS.items()},
        "key_file": "a.key",
    }
