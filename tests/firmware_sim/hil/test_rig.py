"""What a test has started: nodes with faults in between, and what is kept of a failure."""

import can
import pytest

from cutgate.firmware_sim.fault_language import parse_fault
from cutgate.firmware_sim.hil.health import HealthFinding
from cutgate.firmware_sim.hil.inputs import write_files
from cutgate.firmware_sim.hil.rig import HilRig
from cutgate.runtime.commands import app as cli


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "test").mkdir()
    made = HilRig(tmp_path / "test", write_files(tmp_path / "files"), ())
    yield made
    made.close()


def test_without_a_bus_nothing_is_started_and_nothing_found(rig):
    rig.close()
    rig.close()
    assert (rig.findings, rig.summary) == ([], "")


@pytest.mark.parametrize("command", ["stop", "hold"])
def test_nobody_types_where_nothing_runs(rig, command):
    with pytest.raises(LookupError, match="was started: ask for the fixture cutgate_"):
        rig.operator.type(command)


@pytest.mark.processes
def test_a_node_with_faults_hears_what_they_leave(rig):
    sender, plain = rig.bus.open(), rig.bus.open()
    faulty = rig.bus.open("lose Joints01 x2", parse_fault("repeat any"))
    with pytest.raises(ValueError, match="hang@loaded is a fault of the simulated controller, no bus has it"):
        rig.bus.open("hang")
    for number in range(4):
        sender.send(can.Message(arbitration_id=0x300, data=[number], is_extended_id=False))
    assert [plain.recv(5).data[0] for _ in range(4)] == [0, 1, 2, 3]
    assert [faulty.recv(5).data[0] for _ in range(3)] == [2, 2, 3]
    rig.close()
    assert len(rig.bus.candump.read_text(encoding="ascii").splitlines()) == 4
    with pytest.raises(can.CanOperationError):
        sender.send(can.Message(arbitration_id=0x300, is_extended_id=False))


@pytest.mark.processes
def test_a_session_that_the_test_leaves_behind_is_one_finding(rig):
    rig.session().process.expect("key fingerprint")
    rig.close()
    assert [finding.name for finding in rig.findings] == ["unfinished"]


@pytest.mark.processes
def test_a_refused_input_is_found_and_a_controller_that_ends_by_itself(rig):
    rig.files.plan.write_text("{}", encoding="utf-8")
    controller = rig.controller()
    session = rig.session()
    assert session.ended() == 2
    assert (session.document, session.log, session.summary) == (None, None, "no session")
    assert controller.end() == 0
    rig.close()
    assert [finding.name for finding in rig.findings] == ["controller-ended", "refused"]
    assert isinstance(rig.findings[0], HealthFinding)


def test_the_files_of_a_short_session_are_admitted(rig):
    files = rig.files
    words = ["verify", files.plan, "--robot", files.robot, "--registration", files.registration]
    assert cli.execute(list(map(str, words))) == 0
    assert files.key.stat().st_mode & 0o077 == 0
