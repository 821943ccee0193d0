"""Interfaces of the tests on real SocketCAN."""

import json
import os
import shutil
import subprocess

import pytest

OWN = "vcan9"
WIRE = "500kbit"
"""Of a narrow interface: a classic frame counts 128 bits, an FD frame of 64 bytes 576."""


@pytest.fixture
def own_interface():
    """A CAN interface that a test may take down or delete: nobody else's."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and ip to make an interface")
    ip("add", "dev", OWN, "type", "vcan")
    try:
        ip("set", OWN, "up")
        yield OWN
    finally:  # the test may have deleted it
        subprocess.run(["ip", "link", "del", OWN], check=False, capture_output=True)


@pytest.fixture
def narrow_interface(own_interface):
    """An interface as hardware is: a transmit queue of ten frames, and a wire that takes them one after the other."""
    if shutil.which("tc") is None:
        pytest.skip("needs tc (of iproute2) to make an interface that is as slow as a wire")
    ip("set", own_interface, "down")
    ip("set", own_interface, "mtu", "72", "txqueuelen", "10")  # the mtu of FD frames
    ip("set", own_interface, "up")
    try:
        slow_down(own_interface, WIRE)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"needs the kernel's sch_netem to be as slow as a wire: {error.stderr}")
    return own_interface


def slow_down(interface: str, rate: str) -> None:
    """From now on so much leaves the queue of ten frames."""
    command = ["tc", "qdisc", "replace", "dev", interface, "root", "netem", "rate", rate, "limit", "10"]
    subprocess.run(command, check=True, capture_output=True, text=True)


def refused_frames(interface: str) -> int:
    """How many frames the interface's transmit queue had no room for."""
    command = ["tc", "-s", "-j", "qdisc", "show", "dev", interface]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)[0]["drops"]


def ip(*words: str) -> None:
    """``ip link`` with these words."""
    subprocess.run(["ip", "link", *words], check=True)
