"""The simulated controller in virtual time: at once, the same every time, and with the faults of the lines."""

import pytest

from cutgate.firmware_sim.hil.child import HilTimeoutError
from cutgate.firmware_sim.hil.inputs import write_files
from cutgate.firmware_sim.hil.virtual import RepeatableGenerator, VirtualRig
from cutgate.protocol import records
from cutgate.protocol.frames import IDS, ControllerHeartbeat
from cutgate.protocol.states import ControllerState
from cutgate.runtime.commands.negative_suite.items import NAMES, bench_in

pytest_plugins = ["pytester"]


@pytest.fixture
def files(tmp_path):
    (tmp_path / "files").mkdir()
    return write_files(tmp_path / "files")


@pytest.fixture
def a_rig(tmp_path, files):
    """Makes rigs, each with a memory of its own; closed after the test."""
    rigs = []

    def make():
        folder = tmp_path / f"rig-{len(rigs)}"
        folder.mkdir()
        rigs.append(VirtualRig(folder, files))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()


def opened(rig, *faults):
    """A session that has been open for a second: the bench, and what a listener has heard, with its time."""
    listener = rig.open("listener")
    controller, bench = rig.controller(*faults), bench_in(rig)
    bench.hello()
    bench.open()
    bench.run(1.0)
    heard = []
    while (message := listener.recv(timeout=0)) is not None:
        heard.append((round(message.timestamp - 1000.0, 6), message.arbitration_id, bytes(message.data)))
    return controller, bench, heard


def beats(heard):
    return [at_s for at_s, can_id, _ in heard if can_id == IDS[ControllerHeartbeat]]


def test_the_same_script_hears_the_same_frames_at_the_same_times(a_rig):
    first, second = (opened(a_rig(), "lose any p=0.01 seed=4")[2] for _ in range(2))
    assert first == second
    assert len(first) > 50


def test_an_hour_passes_only_when_it_is_waited_for(a_rig):
    rig = a_rig()
    begun_s = rig.now_s()
    assert rig.now_s() == begun_s
    rig.run(3600)
    assert rig.now_s() == pytest.approx(begun_s + 3600)
    with pytest.raises(HilTimeoutError, match="within 5 s of virtual time"):
        rig.until(lambda: False, 5)
    rig.until(lambda: rig.now_s() >= begun_s + 3700, 200)


def test_a_line_acts_on_the_controllers_bus_in_the_state_that_it_names(a_rig):
    sound, _, heard = opened(a_rig())
    assert sound.state is ControllerState.OPEN
    lost = beats(opened(a_rig(), "lose ControllerHeartbeat @open x5")[2])
    assert beats(heard)[5] == lost[0]
    first = next(data for _, can_id, data in heard if can_id == IDS[ControllerHeartbeat])
    for state, altered in (("open", True), ("cutting", False)):
        again = opened(a_rig(), f"corrupt ControllerHeartbeat @{state}")[2]
        found = next(data for _, can_id, data in again if can_id == IDS[ControllerHeartbeat])
        assert (found != first) is altered


def test_a_frame_that_is_late_arrives_in_its_time(a_rig):
    heard = beats(opened(a_rig())[2])
    late = beats(opened(a_rig(), "delay ControllerHeartbeat by 30ms @open")[2])
    assert late[1] == pytest.approx(heard[0] + 0.03, abs=0.006) or late[0] == pytest.approx(
        heard[0] + 0.03, abs=0.006
    )


def test_a_controller_that_stands_still_lets_the_others_go_on(a_rig):
    rig = a_rig()
    listener, controller = rig.open(), rig.controller("hang@inhibited")
    before_s, message = rig.now_s(), listener.recv(timeout=60)
    assert message.timestamp - before_s > 0.9
    assert controller.lines[0] == "fault injected: hang"
    assert listener.recv(timeout=60).timestamp - message.timestamp < 0.5


def test_a_person_types_at_its_terminal(a_rig):
    controller = a_rig().controller()
    controller.type("estop")
    assert controller.lines[0] == "emergency stop pressed"
    with pytest.raises(ValueError, match="dance"):
        controller.type("dance")


def test_random_bytes_are_the_same_again_and_no_others_are():
    first, again, other = RepeatableGenerator(1), RepeatableGenerator(1), RepeatableGenerator(2)
    drawn = [first(16), first(16)]
    assert drawn == [again(16), again(16)]
    assert len({*drawn, other(16)}) == 3
    assert [len(first(size)) for size in (0, 1, 5)] == [0, 1, 5]


def test_it_announces_itself_as_the_simulation_that_it_is(a_rig):
    rig = a_rig()
    rig.controller(time_scale=2.0)
    found = bench_in(rig).hello()
    assert isinstance(found, records.Announce)
    assert (found.serial, found.plant_speed_permille) == ("SIM-VIRTUAL", 2000)


SUITE = """
    import pytest
    from cutgate.runtime.commands.negative_suite.items import ConformSuite, bench_in
    from cutgate.firmware_sim.hil.inputs import write_files
    from cutgate.firmware_sim.hil.virtual import VirtualRig

    @pytest.fixture(scope="session")
    def cutgate_conform_suite(tmp_path_factory):
        folder = tmp_path_factory.mktemp("suite")
        files = write_files(folder)
        rig = VirtualRig(folder, files)
        rig.controller()
        yield ConformSuite(bench_in(rig), files.robot)
        rig.close()

    def test_conforms(cutgate_conform_case):
        cutgate_conform_case()

    @pytest.mark.cutgate_faults("lose ControllerControl p=1")
    def test_a_silent_controller_is_not_heard(cutgate_virtual):
        cutgate_virtual.controller()
        assert cutgate_virtual.open().recv(timeout=60) is None
"""


@pytest.mark.processes
def test_cases_of_the_negative_suite_take_no_time(pytester, within):
    pytester.makepyfile(SUITE)
    done = within("-k", "version or approved or expires or nothing or silent")
    done.assert_outcomes(passed=6, deselected=len(NAMES) + 1 - 6)


@pytest.mark.slow
@pytest.mark.processes
def test_the_whole_negative_suite_passes_in_virtual_time(pytester, within):
    pytester.makepyfile(SUITE)
    within().assert_outcomes(passed=len(NAMES) + 1)
