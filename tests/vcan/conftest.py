"""Interfaces of the tests on real SocketCAN."""

import os
import shutil
import subprocess

import pytest

from tests.vcan.interfaces import FAR, GATED, NEAR, OWN, WIRE, interfaces, ip, slow_down


@pytest.fixture
def own_interface():
    """A CAN interface that a test may take down or delete: nobody else's."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and ip (of iproute2) to make an interface")
    with interfaces("vcan", OWN):
        yield OWN


@pytest.fixture
def narrow_interface(own_interface):
    """An interface as hardware is: a transmit queue of ten frames, and a wire that takes them one after the other."""
    if shutil.which("tc") is None:
        pytest.skip("needs tc (of iproute2) to make an interface that is as slow as a wire")
    ip("set", own_interface, "down")
    ip("set", own_interface, "txqueuelen", "10")
    ip("set", own_interface, "up")
    try:
        slow_down(own_interface, WIRE)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"needs the kernel's sch_netem to be as slow as a wire: {error.stderr}")
    return own_interface


@pytest.fixture
def wire():
    """A wire whose two ends are interfaces: what it does to frames, :func:`disturb` says for each way."""
    if os.geteuid() != 0 or not (shutil.which("ip") and shutil.which("tc")):
        pytest.skip("needs root, ip and tc (of iproute2) to make a wire and to disturb it")
    with interfaces("vxcan", NEAR, FAR):
        yield NEAR, FAR


@pytest.fixture
def two_buses():
    """Two buses that nothing joins."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and ip (of iproute2) to make interfaces")
    if shutil.which("cangw") is None:
        pytest.skip("needs cangw: apt-get install can-utils")
    with interfaces("vcan", *GATED):
        yield GATED
