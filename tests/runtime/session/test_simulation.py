"""A simulation is opted into by the site: what a controller announces about itself loosens nothing."""

from dataclasses import replace

import pytest

from cutgate.protocol.frames import CONTROL_IDS
from cutgate.protocol.records import Side
from cutgate.runtime.interlock.state import Phase

NAME = "speed of the plant, times the clock's"


def forbidden(pair):
    """The same job, of a site that says nothing of a simulation."""
    return replace(pair.job, simulation_allowed_by="")


@pytest.mark.parametrize("time_scale", [0.001, 0.999, 1.001, 50.0, 1000.0])
def test_a_plant_of_another_speed_is_refused_unless_the_site_allows_it(pair, time_scale):
    pair.power_up(time_scale=time_scale)
    pair.begin(forbidden(pair))
    assert pair.end() is Phase.REFUSED
    assert f"{NAME}: {time_scale:g} (required: 1, no simulation is allowed)" in pair.state.reason
    assert "--allow-simulated" in pair.state.reason
    sent = {seen.can_id for seen in pair.wire.seen if seen.sender is Side.RUNTIME}
    assert sent <= {CONTROL_IDS[Side.RUNTIME]}, "no heartbeat: no session was opened"
    pair.close()
    last = pair.read().of("/audit/decision")[-1]
    assert last["to_state"] == "refused"


def test_a_plant_that_keeps_the_clock_s_time_needs_no_word_of_the_site(pair):
    pair.power_up(time_scale=1.0)
    pair.begin(forbidden(pair))
    assert pair.end(60.0) is Phase.DONE


def test_the_log_shows_speed_bound_and_who_allowed_it_before_each_enabling_act(pair):
    pair.power_up(time_scale=50.0)
    assert pair.end() is Phase.DONE
    pair.close()
    shown = [
        permissive
        for decision in pair.read().of("/audit/decision")
        for permissive in decision.get("permissives", ())
        if permissive["name"] == NAME
    ]
    assert shown
    bound = "up to 1000, a simulation is allowed by --allow-simulated"
    assert {(one["holds"], one["value"], one["bound"]) for one in shown} == {(True, 50.0, bound)}
