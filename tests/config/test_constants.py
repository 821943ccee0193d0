"""The table of constants and its page."""

import math
from pathlib import Path

import pytest

from cutgate.config.constants import (
    CONSTANTS,
    EARLIER_TIMEOUT_HEARTBEATS,
    TABLE,
    TIMEOUT_HEARTBEATS,
    markdown,
)
from cutgate.config.model import Site
from cutgate.protocol.records import POSES_MAX, Timing

ROOT = Path(__file__).parents[2]


def test_every_default_lies_within_its_bounds():
    assert all(constant.low < constant.high and constant.holds(constant.default) for constant in TABLE)


def test_names_are_unique_and_each_has_unit_and_meaning():
    assert len(CONSTANTS) == len(TABLE)
    assert all(constant.unit and constant.meaning for constant in TABLE)


@pytest.mark.parametrize("constant", TABLE, ids=lambda constant: constant.name)
def test_bounds_are_inside_and_nan_is_outside(constant):
    assert constant.holds(constant.low)
    assert constant.holds(constant.high)
    assert not constant.holds(math.nextafter(constant.low, -math.inf))
    assert not constant.holds(math.nextafter(constant.high, math.inf))
    assert not constant.holds(math.nan)
    assert constant.unit in constant.bound


def test_the_page_is_current():
    page = (ROOT / "docs" / "constants.md").read_text(encoding="utf-8")
    assert page == markdown(), "run: python -m cutgate.config.constants > docs/constants.md"


def test_the_default_time_out_spans_four_heartbeats_and_the_least_the_protocols_three():
    assert CONSTANTS["timeout_ms"].default >= TIMEOUT_HEARTBEATS * CONSTANTS["heartbeat_ms"].default
    assert CONSTANTS["timeout_ms"].low >= EARLIER_TIMEOUT_HEARTBEATS * CONSTANTS["heartbeat_ms"].low


def test_exchanged_constants_are_those_of_the_open_record():
    rename = {
        "start_tolerance_um": "start_tolerance_mm",
        "start_tolerance_mdeg": "start_tolerance_deg",
        "approach_clearance_um": "approach_clearance_mm",
    }
    fields = {rename.get(name, name) for name in Timing.__dataclass_fields__}
    assert {constant.name for constant in TABLE if constant.exchanged} == fields
    assert set(Site().constants(exchanged_only=True)) == fields


def test_the_longest_path_is_one_the_wire_carries():
    assert CONSTANTS["pose_limit"].high == POSES_MAX


def test_the_default_site_holds_every_constant_at_its_default():
    assert Site().constants() == {constant.name: constant.default for constant in TABLE}
