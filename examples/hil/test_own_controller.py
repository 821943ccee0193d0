"""Our own controller, here a pretended one, against cutgate's runtime."""

import pytest
from pretended import PretendedController


@pytest.fixture
def own_controller(cutgate_bus, cutgate_files):
    """Starts it on this test's bus; ended before the bus is."""
    started = []

    def start(**how):
        controller = PretendedController(cutgate_bus.open(), cutgate_files.key, cutgate_files.robot, **how)
        controller.start()
        started.append(controller)

    yield start
    for controller in started:
        controller.end()


@pytest.mark.cutgate_expect("not-admitted")
def test_limits_that_are_not_the_approved_ones_admit_nothing(own_controller, cutgate_session):
    own_controller(narrower_deg=1)
    assert cutgate_session.ended() == 1
    assert "controller MINE-1" in cutgate_session.process.told


@pytest.mark.cutgate_expect("HEARTBEAT_LOST")
def test_the_runtime_stops_when_it_falls_silent(own_controller, cutgate_session):
    own_controller(silent_when_asked=True)
    assert cutgate_session.ended() == 3
