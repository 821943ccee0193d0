"""Curves: however long, they are bounded, and no column loses its least or largest value."""

import math

from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.commands.report.curves import ROWS_MAX, Curves, thinned

VALUES = st.one_of(st.none(), st.floats(-1e6, 1e6))


@given(st.lists(st.tuples(st.floats(0, 1e6), VALUES, VALUES), min_size=1, max_size=200), st.integers(3, 40))
def test_no_group_loses_an_extreme_its_ends_or_its_order(rows, size):
    kept = thinned(rows, size)
    assert kept[0] == rows[0]
    assert kept[-1] == rows[-1]
    places = iter(rows)
    assert all(any(row is one for one in places) for row in kept), "in their order"
    for begin in range(0, len(rows), size):
        group = rows[begin : begin + size]
        for column in (1, 2):
            known = [row[column] for row in group if row[column] is not None]
            here = [
                row[column] for row in kept if any(row is one for one in group) and row[column] is not None
            ]
            if known:
                assert (min(known), max(known)) == (min(here), max(here))


@given(st.integers(1, 11), st.integers(0, 3 * ROWS_MAX))
def test_a_curve_of_any_length_is_bounded_and_keeps_its_spike(columns, spike):
    names = [f"c{k}" for k in range(columns)]
    curves = Curves(names)
    for at in range(3 * ROWS_MAX + 1):
        curves.add(float(at), {name: float(at == spike) - (at % 7) * 1e-3 for name in names})
        assert len(curves) <= ROWS_MAX
    document = curves.document(3)
    assert document["x"] == sorted(document["x"])
    assert all(max(series["values"]) > 0.99 for series in document["series"])


def test_what_is_absent_or_no_number_is_undefined():
    curves = Curves(("a", "b"))
    curves.add(0.0, {"a": math.nan})
    curves.add(1.0, {"a": math.inf, "b": 2.00049})
    assert curves.document(3) == {
        "x": [0.0, 1.0],
        "series": [{"name": "a", "values": [None, None]}, {"name": "b", "values": [None, 2.0]}],
    }
    assert Curves(("a",)).document(3) == {"x": [], "series": [{"name": "a", "values": []}]}
