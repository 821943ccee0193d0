"""A site's settings as OPEN carries them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.constants import CONSTANTS
from cutgate.config.load import site_from_bytes
from cutgate.config.model import Site
from cutgate.config.records import timing_record
from cutgate.protocol.records import Timing

TEXT = """schema = "cutgate.site/1"
[timing]
heartbeat_ms = 30
timeout_ms = 150
[permit]
permit_lifetime_s = 45
[start]
start_lifetime_ms = 1500
start_tolerance_mm = 1.25
start_tolerance_deg = 0.75
[approach]
approach_clearance_mm = 12.5
approach_speed_percent = 40
"""


def test_each_setting_has_its_place_and_tolerances_leave_in_thousandths():
    site = site_from_bytes("site.toml", TEXT.encode())
    assert timing_record(site) == Timing(30, 150, 45, 1500, 1250, 750, 12_500, 40)


def test_the_defaults_are_those_of_the_table():
    timing = timing_record(Site())
    defaults = {name: CONSTANTS[name].default for name in CONSTANTS if CONSTANTS[name].exchanged}
    assert {name: getattr(timing, name) for name in defaults} == defaults


@given(
    name=st.sampled_from(
        [name for name in CONSTANTS if name.endswith(("_mm", "_deg")) and CONSTANTS[name].exchanged]
    ),
    part=st.integers(0, 1000),
)
def test_a_tolerance_in_thousandths_is_the_same_number_on_both_sides(name, part):
    constant = CONSTANTS[name]
    thousandths = round((constant.low + (constant.high - constant.low) * part / 1000) * 1000)
    section = name.partition("_")[0]
    text = f'schema = "cutgate.site/1"\n[{section}]\n{name} = {thousandths / 1000!r}\n'
    assert getattr(timing_record(site_from_bytes("site.toml", text.encode())), name) == thousandths / 1000


@pytest.mark.parametrize("text", ["0.5004", "0.49999"])
def test_what_a_log_of_an_older_version_holds_is_read_all_the_same(text):
    whole = f'schema = "cutgate.site/1"\n[start]\nstart_tolerance_mm = {text}\n'.encode()
    assert site_from_bytes("site.toml", whole, recorded=True).start.start_tolerance_mm == float(text)
