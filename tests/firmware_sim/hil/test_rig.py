"""What a test has started: nodes with faults in between, and what is kept of a failure."""

import can
import pytest

from cutgate.firmware_sim.fault_language import parse_fault
from cutgate.firmware_sim.hil import rig as hil
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


def test_of_a_failure_everything_is_copied_but_keys_and_links(rig, tmp_path):
    (rig.folder / "logs").mkdir()
    for name in (
        "logs/a.mcap",
        "logs/a.candump.log",
        "bus.candump.log",
        "1-runtime.txt",
        "site.key",
        "state",
    ):
        (rig.folder / name).write_text(name, encoding="utf-8")
    (rig.folder / "link.txt").symlink_to(rig.files.key)
    for number in ("", "-2", "-3"):
        place = tmp_path / "kept" / f"test_a.py_test_b_1-2_{number}"
        lines = rig.artefacts(tmp_path / "kept", "test_a.py::test_b[1-2]")
        assert lines == sorted(
            str(place / name)
            for name in ("1-runtime.txt", "bus.candump.log", "logs/a.candump.log", "logs/a.mcap")
        )


@pytest.mark.parametrize("copies", [0, 1])
def test_what_cannot_be_copied_stays_where_it_lies_and_that_is_said(rig, tmp_path, monkeypatch, copies):
    (rig.folder / "1-runtime.txt").write_text("x", encoding="utf-8")
    monkeypatch.setattr(hil, "COPIES_MAX", copies)
    directory = tmp_path / "kept"
    if copies:
        directory.write_text("a file", encoding="utf-8")
    said, kept = rig.artefacts(directory, "test")
    assert said.startswith(f"not copied to {directory}: ")
    assert kept == str(rig.folder / "1-runtime.txt")


def test_the_files_of_a_short_session_are_admitted(rig):
    files = rig.files
    words = ["verify", files.plan, "--robot", files.robot, "--registration", files.registration]
    assert cli.execute(list(map(str, words))) == 0
    assert files.key.stat().st_mode & 0o077 == 0
