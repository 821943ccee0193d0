"""`cutgate bus serve` as a process."""

import os
import signal
import subprocess

import can
import pytest

from cutgate.config.interpreter import program
from cutgate.firmware_sim.bus.serve import main, serve
from cutgate.firmware_sim.hil.hub import hub_process

pytestmark = pytest.mark.processes

WAIT_S = 20.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly_with_exit_0(place, number):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        with can.Bus(interface="cutgate", channel=str(path)):
            hub.send_signal(number)
            assert hub.wait(WAIT_S) == 0
        assert not path.exists()


def test_it_ends_with_whoever_started_it(place):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        hub.stdin.close()
        assert hub.wait(WAIT_S) == 0
        assert not path.exists()


def test_a_hub_that_does_not_come_up_is_an_error(place, capfd):
    with pytest.raises(RuntimeError, match="did not come up"), hub_process(place / "missing" / "bus.sock"):
        pass
    assert "make it first" in capfd.readouterr().err


def test_bad_input_is_one_line_and_exit_2(place, capfd):
    (place / "old.log").write_text("precious")
    for arguments in (
        ["--socket", str(place / "missing" / "bus.sock")],
        ["--socket", "no such name!"],
        ["--socket", str(place / "bus.sock"), "--log", str(place / "old.log")],
    ):
        assert main(["serve", *arguments]) == 2
        said = capfd.readouterr()
        assert said.out == ""
        assert said.err.startswith("cutgate bus: ")
        assert said.err.count("\n") == 1
    assert (place / "old.log").read_text() == "precious"
    assert not (place / "bus.sock").exists()


def test_the_default_socket_lies_in_the_users_runtime_directory_and_frames_are_logged(place):
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(place)}
    log = place / "frames.log"
    command = program("cutgate.firmware_sim", "bus", "serve", "--log", str(log))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as hub:
        path = place / "cutgate" / "bus0.sock"
        assert hub.stdout.readline() == f"serving on {path}\n"
        with can.Bus(interface="cutgate", channel=str(path), receive_own_messages=True) as bus:
            bus.send(can.Message(arbitration_id=0x42, is_extended_id=False, data=b"\x01"))
            bus.recv(WAIT_S)
        hub.terminate()
        assert hub.wait(WAIT_S) == 0
    assert log.read_text().endswith(" bus0 042#01\n")


def test_serve_gives_the_signals_back(place, monkeypatch, capfd):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(
        "cutgate.firmware_sim.bus.serve.Hub.serve", lambda hub: signal.raise_signal(signal.SIGTERM)
    )
    serve(str(place / "bus.sock"))
    assert signal.getsignal(signal.SIGTERM) is before
    assert capfd.readouterr().out == f"serving on {place / 'bus.sock'}\n"
