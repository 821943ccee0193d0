"""One simulated controller without a program around it, and the ends of its wires: what the tests of its loop start from."""

import os
from collections import deque

import can

from cutgate.config.terminal import CommandReader
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity, Memory
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from tests.firmware_sim.arms import LIMITS, NOMINAL, TOOL

KEY = bytes(32)


class Leaping:
    """Leaps by more than any period whenever it is read, so that no loop waits."""

    def __init__(self):
        self.now_s = 50.0

    def __call__(self):
        self.now_s += 0.25
        return self.now_s


class Bus:
    """Nobody else; ``after`` turns of reading something happens."""

    def __init__(self):
        self.sent = []
        self.reads = 0
        self.after = {}
        self.broken = False
        self.room = 1_000_000
        """So many frames are taken, then no more."""
        self.inbox = deque()
        """What arrives."""
        self.descriptor = os.eventfd(0)

    def fileno(self):
        return self.descriptor

    def recv(self, timeout):
        self.reads += 1
        self.after.pop(self.reads, lambda: None)()
        if self.broken:
            raise can.CanOperationError("gone")
        return self.inbox.popleft() if self.inbox else None

    def send(self, message, timeout):
        if self.room == 0:
            raise can.CanTimeoutError("full")
        self.room -= 1
        self.sent.append(message)


class Bench:
    """One controller and the ends of its wires."""

    def __init__(self, directory, *, limits=LIMITS, typed=True, clock=None, **options):
        self.bus, self.shown, self.slept = Bus(), [], []
        self.file = directory / "memory.json"
        reading, self.typing = os.pipe2(os.O_NONBLOCK)
        self.wake, self.waking = os.pipe2(os.O_NONBLOCK)
        self.descriptors = [self.bus.descriptor, reading, self.typing, self.wake, self.waking]
        endpoint = Endpoint(Side.CONTROLLER, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0)
        self.process = Process(
            Controller.powered_up(
                Identity("SIM-1", fingerprint(KEY)),
                Holdings(limits.body(), NOMINAL.body(), TOOL.body()),
                Memory(),
                bytes(16),
            ),
            Port(self.bus, endpoint),
            self.file,
            options=Options(**options),
            commands=CommandReader(reading, ConsoleCommand) if typed else None,
            say=self.shown.append,
            clock=clock or Leaping(),
            random=b"n".__mul__,
            sleep=self.slept.append,
        )

    def end_after(self, reads):
        self.bus.after[reads] = lambda: os.write(self.waking, b"\0")
