"""A controller that only pretends: it opens a session and reports what it is told to. Put your own in its place."""

import secrets
import threading
import time
from dataclasses import replace
from pathlib import Path

import can

from cutgate.config.key import load_key
from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records
from cutgate.protocol.endpoint import Endpoint, Item, RecordReceived
from cutgate.protocol.frames import ControllerHeartbeat, RuntimeStop, joint_frames
from cutgate.protocol.link import Accepted
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from cutgate.protocol.states import ControllerState, StopCause

HEARTBEAT_S = 0.05
ANNOUNCE_S = 0.2
CYCLE_S = 0.005
JOINTS = (0.0, 1.2, 250.0, 0.0, 1.0)
"""Where the arm stands, rad and mm."""


class PretendedController(threading.Thread):
    """It announces itself, opens a session, beats, and answers Collect. It stores no path.

    Args:
        bus: a node on the bus.
        key: file of the pre-shared key.
        robot: robot.toml: what it reports.
        narrower_deg: its upper limit of q0 is so much lower than robot.toml says.
        silent_when_asked: it falls silent when it is asked for its limits.
    """

    def __init__(
        self,
        bus: can.BusABC,
        key: Path,
        robot: Path,
        *,
        narrower_deg: int = 0,
        silent_when_asked: bool = False,
    ) -> None:
        super().__init__(name="pretended-controller", daemon=True)
        read = load_robot(robot).value
        limits = limits_record(read)
        upper = (limits.q_max_u[0] - narrower_deg * records.UNIT, *limits.q_max_u[1:])
        self._reports = (replace(limits, q_max_u=upper), calibration_record(read), tool_record(read))
        endpoint = Endpoint(
            Side.CONTROLLER, load_key(key), heartbeat_s=HEARTBEAT_S, timeout_s=1.0, transfer_timeout_s=2.0
        )
        self._port = Port(bus, endpoint)
        self._silent_when_asked, self._silent = silent_when_asked, False
        self._nonce = secrets.token_bytes(16)
        self._due_s = 0.0
        self._ended = threading.Event()

    def run(self) -> None:
        """Cycle until the end of the test, or of the bus."""
        try:
            while not self._ended.wait(CYCLE_S):
                self._cycle(time.monotonic())
        except can.CanError:
            return

    def end(self) -> None:
        """Leave."""
        self._ended.set()
        self.join()

    def _cycle(self, now_s: float) -> None:
        for item in self._port.read(now_s):
            self._item(item, now_s)
        if self._silent:
            return
        if now_s >= self._due_s:
            in_session = self._port.endpoint.link.is_open
            self._due_s = now_s + (HEARTBEAT_S if in_session else ANNOUNCE_S)
            self._beat(now_s) if in_session else self._announce(now_s)
        self._port.flush()

    def _item(self, item: Item, now_s: float) -> None:
        endpoint = self._port.endpoint
        match item:
            case RecordReceived(record=records.Open() as request, authentic=True):
                self._open(request, now_s)
            case RecordReceived(record=records.Collect()):
                self._silent = self._silent_when_asked
                for record in self._reports:
                    endpoint.send_record(record, now_s)
            case Accepted(frame=RuntimeStop()):
                self._nonce = secrets.token_bytes(16)
                endpoint.end_session()

    def _open(self, request: records.Open, now_s: float) -> None:
        endpoint, timing = self._port.endpoint, request.timing
        self._nonce = secrets.token_bytes(16)  # an OPEN opens once
        endpoint.stop_sending()
        endpoint.use_timing(heartbeat_s=timing.heartbeat_ms / 1000, timeout_s=timing.timeout_ms / 1000)
        endpoint.use_session(records.session_digest(request))
        endpoint.open_link(now_s)
        endpoint.send_record(records.Opened(epoch=1, state=ControllerState.OPEN, cause=StopCause.NONE), now_s)
        self._due_s = now_s

    def _announce(self, now_s: float) -> None:
        if self._port.endpoint.receiving:  # most likely an OPEN
            return
        self._port.endpoint.abort()
        announcement = records.Announce(
            protocol_version=records.PROTOCOL_VERSION,
            firmware_version="pretended",
            serial="MINE-1",
            announce_nonce=self._nonce,
            plant_speed_permille=1000,
            state=ControllerState.INHIBITED,
            cause=StopCause.NONE,
        )
        self._port.endpoint.send_record(announcement, now_s)

    def _beat(self, now_s: float) -> None:
        endpoint = self._port.endpoint
        heartbeat = ControllerHeartbeat(
            state=ControllerState.OPEN,
            epoch=1,
            cause=StopCause.NONE,
            device_pressed=False,
            emergency_stop_ok=True,
            cutting_mode=False,
        )
        for frame in (heartbeat, *joint_frames(JOINTS)):
            endpoint.send_frame(frame, now_s)
