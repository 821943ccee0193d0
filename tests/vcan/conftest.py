"""Interfaces of the tests on real SocketCAN."""

import os
import shutil
import subprocess

import pytest

OWN = "vcan9"


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


def ip(*words: str) -> None:
    """``ip link`` with these words."""
    subprocess.run(["ip", "link", *words], check=True)
