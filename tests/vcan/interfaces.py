"""CAN interfaces of a test's own, and what the kernel does to the frames on them."""

import json
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import pytest

OWN: Final = "vcan9"
"""One that a test may take down or delete."""
NEAR, FAR = "vxcan8", "vxcan9"
"""Two ends of a wire, the controller's and the runtime's: each is an interface of its own. What a sender's neighbours on
the same interface hear comes before the wire, as it does on `vcan`; only what crosses a wire can be lost on it."""
GATED = ("vcan7", "vcan8")
"""Two buses with a gateway in between, the controller's and the runtime's."""
WIRE: Final = "500kbit"
"""Of a narrow interface: a classic frame counts 128 bits, an FD frame of 64 bytes 576."""


def ip(*words: str) -> None:
    """``ip link`` with these words."""
    subprocess.run(["ip", "link", *words], check=True)


@contextmanager
def interfaces(kind: str, *names: str) -> Iterator[None]:
    """Interfaces of the kernel that are up and take FD frames, gone at the end; skips the test where it cannot be.

    Args:
        kind: `vcan`, each a bus of its own, or `vxcan` with two names: the ends of one wire.
        names: of interfaces that are not there yet; the test may delete them.
    """
    if kind == "vxcan":
        added = [f"link add dev {names[0]} type vxcan peer name {names[1]}"]
    else:
        added = [f"link add dev {name} type {kind}" for name in names]
    raised = [f"link set {name} mtu 72 up" for name in names]
    here = {name for _, name in socket.if_nameindex()}
    assert here.isdisjoint(names), (
        f"{here.intersection(names)} is somebody else's: these tests make and delete it"
    )
    # One process for all of it, and for all that is left at the end: in a virtual machine each costs a tenth of a second.
    made = _batch([*added, *raised])
    try:
        if "Unknown device type" in made.stderr or "not supported" in made.stderr:
            pytest.skip(f"needs the kernel's {kind} interfaces: ip link add: {made.stderr.strip()}")
        made.check_returncode()
        yield
    finally:
        _batch([f"link del {name}" for name in names])


def _batch(lines: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Each line to ``ip``, whatever becomes of the one before."""
    command = ["ip", "-force", "-batch", "-"]
    return subprocess.run(command, input="\n".join(lines), check=False, capture_output=True, text=True)


def disturb(interface: str, *how: str) -> None:
    """From now on the kernel (tc, netem) does this to each frame that leaves by an interface; for once in a test."""
    command = ["tc", "qdisc", "add", "dev", interface, "root", "netem", *how]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if "kind is unknown" in done.stderr:
        pytest.skip(f"needs the kernel's sch_netem to disturb a wire: tc: {done.stderr.strip()}")
    done.check_returncode()


def slow_down(interface: str, rate: str) -> None:
    """From now on so much leaves the queue of ten frames."""
    command = ["tc", "qdisc", "replace", "dev", interface, "root", "netem", "rate", rate, "limit", "10"]
    subprocess.run(command, check=True, capture_output=True, text=True)


def queue(interface: str) -> dict[str, int]:
    """What ``tc -s`` counts of an interface's transmit queue: ``packets`` that left it, ``drops``, and more."""
    command = ["tc", "-s", "-j", "qdisc", "show", "dev", interface]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    counted: dict[str, int] = json.loads(done.stdout)[0]
    return counted


def refused_frames(interface: str) -> int:
    """How many frames the interface's transmit queue had no room for."""
    return queue(interface)["drops"]


def gate(rule: int, source: str, target: str, chosen: str, how: str) -> None:
    """Let the kernel's gateway pass chosen frames from one bus to another, altered; again for the same rule: otherwise.

    A rule goes with its interfaces.

    Args:
        rule: its number; what it does changes between two frames.
        source, target: the buses.
        chosen: which identifiers, as ``cangw -f`` takes them.
        how: what becomes of each, as ``cangw -m`` takes it.
    """
    # Of a virtual interface nobody but the sender's neighbours hears anything: they hear what the gateway sends by -e.
    words = ["-s", source, "-d", target, "-e", "-u", f"{rule:x}", "-f", chosen, "-m", how]
    done = subprocess.run(["cangw", "-A", *words], check=False, capture_output=True, text=True)
    if "not supported" in done.stderr + done.stdout:
        pytest.skip("needs the kernel's gateway: modprobe can-gw")
    done.check_returncode()
