"""Records over ISO-TP, one channel: classic frames of 8 bytes or FD frames of 64, driven by the caller.

The state machine is `isotp.TransportLayerLogic`. Its own timers read a clock of their own and are set out of the
way; the deadline stands here, against the caller's time. Errors are values: nothing is raised, nothing is logged.
A failed transfer never yields a record; what was queued behind a failed one is dropped with it.

How a :class:`Transfer` is used, one on either side of a channel:

- :meth:`Transfer.send` queues a record, :meth:`Transfer.feed` takes a frame that came on ``rx_id``. Neither sends
  anything: after both, give :meth:`Transfer.hand_out` the bus, for what is fed may have to be answered.
- After :meth:`Transfer.feed`, take what is whole by now (:meth:`Transfer.received`) and what went wrong
  (:meth:`Transfer.errors`).
- Once a cycle, look at the clock with :meth:`Transfer.expire`, which voids what stands still.
- Whatever stops motion voids what is under way: :meth:`Transfer.abort`.

One record, carried over a bus that loses nothing::

    >>> sender, receiver = Transfer(0x600, 0x601), Transfer(0x601, 0x600)
    >>> sender.send(b"longer than a frame", now_s=0.0)
    >>> while sender.sending:
    ...     for _can_id, data in sender.outgoing():
    ...         receiver.feed(data)
    ...     for _can_id, data in receiver.outgoing():  # a flow control: without it the sender waits
    ...         sender.feed(data)
    >>> receiver.received(), receiver.errors(), sender.errors()
    ([b'longer than a frame'], [], [])

A record whose flow control never comes is given up, the time-out after it was queued::

    >>> sender.send(b"longer than a frame", now_s=0.0)
    >>> sender.expire(now_s=0.9), sender.busy
    (None, True)
    >>> sender.expire(now_s=1.1).reason, sender.busy
    ('transfer on 0x600 stood still for more than 1.0 s', False)
"""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import isotp

FRAME_BYTES = 8
FD_FRAME_BYTES = 64
FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, FD_FRAME_BYTES)
"""What an FD frame of a transfer may be long: the last of a record is the shortest that holds it."""
BLOCK_FRAMES = 32
"""Consecutive frames between two flow controls: a socket buffer of 278 frames never overflows."""
PADDING = 0xCC
PAYLOAD_BYTES_MAX = 4095
TIMEOUT_S = 1.0

_NEVER_MS = 2**31 - 1
_LOGGER = "cutgate.isotp"
_FIRST_FRAME, _FLOW_CONTROL, _CONTINUE = 0x1, 0x3, 0x0


def _is_flow_control(data: bytes) -> bool:
    """Whether a frame answers the other side's transfer, and is no part of one of ours."""
    return data[0] >> 4 == _FLOW_CONTROL


_SENDING_ENDED = (isotp.OverflowError, isotp.UnsupportedWaitFrameError, isotp.MaximumWaitFrameReachedError)
_RECEPTION_ENDED = (
    isotp.WrongSequenceNumberError,
    isotp.ReceptionInterruptedWithSingleFrameError,
    isotp.ReceptionInterruptedWithFirstFrameError,
    isotp.FrameTooLongError,
)

# isotp warns through logging for every error, which is handed over as a value as well.
logging.getLogger(_LOGGER).setLevel(logging.CRITICAL + 1)


@dataclass(frozen=True)
class TransferError:
    """Something went wrong on a channel.

    Attributes:
        reason: in words.
        lost: whether a record of either direction was lost by it; otherwise a stray frame was ignored.
        refused: whether what was lost goes out, and the peer asked for it in a form that is not sent: again it is no
            better.
    """

    reason: str
    lost: bool
    refused: bool = False


@dataclass(frozen=True)
class _Progress:
    """How far one direction is (None: nothing in progress), and since when it stands there."""

    mark: int | None = None
    since_s: float = 0.0

    def at(self, mark: int | None, now_s: float) -> "_Progress":
        """The same if nothing has moved, else dated now."""
        return self if mark == self.mark else _Progress(mark, now_s)

    def stuck(self, now_s: float, timeout_s: float) -> bool:
        """Whether a transfer in progress has stood still for too long."""
        return self.mark is not None and not 0.0 <= now_s - self.since_s <= timeout_s


class Transfer:
    """One side of one channel.

    Args:
        tx_id: identifier to send on.
        rx_id: identifier to receive on.
        timeout_s: how long a transfer in progress may stand still, s.
        fd: FD frames of up to 64 bytes, both ways, instead of classic ones.
    """

    def __init__(self, tx_id: int, rx_id: int, timeout_s: float = TIMEOUT_S, *, fd: bool = False) -> None:
        self.tx_id = tx_id
        self.rx_id = rx_id
        self.timeout_s = timeout_s
        self.fd = fd
        self._lengths = FD_LENGTHS if fd else (FRAME_BYTES,)
        self._alone = FD_FRAME_BYTES - 2 if fd else FRAME_BYTES - 1
        self._errors: list[TransferError] = []
        self._clear()

    def _clear(self) -> None:
        self._inbox: deque[isotp.CanMessage] = deque()
        self._outbox: deque[tuple[int, bytes]] = deque()
        self._queue: deque[bytes] = deque()
        self._done: deque[bytes] = deque()
        self._sent = 0
        self._sending = _Progress()
        self._receiving = _Progress()
        self._logic = isotp.TransportLayerLogic(
            rxfn=self._next_frame,
            txfn=self._put_frame,
            address=isotp.Address(isotp.AddressingMode.Normal_11bits, txid=self.tx_id, rxid=self.rx_id),
            error_handler=self._note_error,
            params={
                "stmin": 0,
                "override_receiver_stmin": 0.0,
                "blocksize": BLOCK_FRAMES,
                "tx_padding": PADDING,
                "tx_data_length": self._lengths[-1],
                "tx_data_min_length": FRAME_BYTES,
                "can_fd": self.fd,
                "max_frame_size": PAYLOAD_BYTES_MAX,
                "rx_flowcontrol_timeout": _NEVER_MS,
                "rx_consecutive_frame_timeout": _NEVER_MS,
                "blocking_send": False,
                "logger_name": _LOGGER,
                "wait_func": lambda _seconds: None,
            },
        )

    def _next_frame(self, _timeout_s: float) -> isotp.CanMessage | None:
        return self._inbox.popleft() if self._inbox else None

    def _put_frame(self, message: isotp.CanMessage) -> None:
        self._outbox.append((message.arbitration_id, bytes(message.data)))

    def _note_error(self, error: Exception) -> None:
        """Keep the error as a value; what was to follow a failed sending must not go out alone."""
        lost = isinstance(error, _SENDING_ENDED + _RECEPTION_ENDED)
        if isinstance(error, isotp.InvalidCanDataError):
            lost = self.receiving
        if isinstance(error, _SENDING_ENDED):
            self.stop_sending()
        self._errors.append(TransferError(str(error), lost=lost, refused=isinstance(error, _SENDING_ENDED)))

    def send(self, payload: bytes, now_s: float) -> None:
        """Queue a record; records leave one after the other. Then hand out what may go.

        Args:
            payload: the record's envelope.
            now_s: when; from here on it must not stand still for longer than the time-out.

        Raises:
            ValueError: not 1..4095 bytes.
        """
        if not 1 <= len(payload) <= PAYLOAD_BYTES_MAX:
            raise ValueError(f"payload is {len(payload)} bytes, must be 1..{PAYLOAD_BYTES_MAX}")
        if not self.sending:
            self._sending = _Progress(self._sent, now_s)
        self._queue.append(payload)
        self._run()

    def feed(self, data: bytes) -> None:
        """Take one frame received on `rx_id`, whatever it is. Then hand out, and take what was received and the errors."""
        if len(data) not in self._lengths:
            wanted = ", ".join(map(str, self._lengths))
            self._errors.append(TransferError(f"frame is {len(data)} bytes, must be {wanted}", lost=False))
            return
        if data[0] == (_FLOW_CONTROL << 4 | _CONTINUE) and (refusal := self._refusal(data)):
            self._errors.append(TransferError(refusal, lost=self.sending, refused=self.sending))
            self.stop_sending()
            return
        if data[0] >> 4 == _FIRST_FRAME and not self._begins_a_record(data):
            wanted = f"must be {self._lengths[-1]} and announce more than {self._alone}"
            self._errors.append(TransferError(f"first frame is {len(data)} bytes, {wanted}", lost=False))
            return
        self._inbox.append(isotp.CanMessage(arbitration_id=self.rx_id, data=data))
        self._run()

    @staticmethod
    def _refusal(flow_control: bytes) -> str:
        """What a flow control asks for that is not sent so; empty where it asks for what is."""
        blocks, pause = flow_control[1], flow_control[2]
        if not 1 <= blocks <= BLOCK_FRAMES:
            return f"flow control asks for blocks of {blocks}, must be 1..{BLOCK_FRAMES}"
        if pause != 0:
            return f"flow control asks for a separation time (STmin) of {pause:#04x}, must be 0"
        return ""

    def _begins_a_record(self, data: bytes) -> bool:
        """Whether a first frame is full and its length, in its shortest form, is more than one frame carries alone."""
        length = (data[0] & 0xF) << 8 | data[1]
        long = length == 0 and int.from_bytes(data[2:6], "big") > PAYLOAD_BYTES_MAX
        return len(data) == self._lengths[-1] and (length > self._alone or long)

    def _run(self) -> None:
        """Let the state machine work until it has nothing left to do without another frame."""
        while True:
            if self._queue and not self._logic.transmitting():
                self._logic.send(self._queue.popleft())
            self._logic.process(rx_timeout=0.0)
            while self._logic.available():
                self._done.append(bytes(self._logic.recv() or b""))
            if not self._inbox and not (self._queue and not self._logic.transmitting()):
                return

    def hand_out(self, take: Callable[[int, bytes], bool]) -> bool:
        """Give away the frames to send now, in order, until one is not taken.

        Args:
            take: sends a frame, by identifier and bytes; False if it cannot now. What was not taken is offered again.

        Returns:
            Whether none waits any longer.
        """
        while self._outbox:
            can_id, data = self._outbox[0]
            if not take(can_id, data):
                return False
            self._outbox.popleft()
            self._sent += not _is_flow_control(data)
        return True

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Frames to send now, in order; each is handed out once, and lost if the caller does not send it."""
        frames: list[tuple[int, bytes]] = []

        def take(can_id: int, data: bytes) -> bool:
            frames.append((can_id, data))
            return True

        self.hand_out(take)
        return frames

    def received(self) -> list[bytes]:
        """Complete records, in order; each is handed out once."""
        records = list(self._done)
        self._done.clear()
        return records

    def errors(self) -> list[TransferError]:
        """What went wrong since the last call."""
        errors, self._errors = self._errors, []
        return errors

    @property
    def sending(self) -> bool:
        """Whether a record is going out or queued, or its last frames wait."""
        waiting = any(not _is_flow_control(data) for _, data in self._outbox)
        return waiting or bool(self._queue) or self._logic.transmitting()

    @property
    def receiving(self) -> bool:
        """Whether a record is coming in."""
        return self._logic.is_rx_active()

    @property
    def busy(self) -> bool:
        """Whether a transfer of either direction is in progress."""
        return self.sending or self.receiving

    def expire(self, now_s: float) -> TransferError | None:
        """Void everything once a transfer in progress has stood still for longer than the time-out.

        To be called in every cycle: progress is dated by the first call after it.

        Returns:
            What was lost; None while nothing is late. Nothing is left to do for it but to tell of it.
        """
        sent = self._sent if self.sending else None
        came = len(self._logic.rx_buffer) if self.receiving else None
        self._sending = self._sending.at(sent, now_s)
        self._receiving = self._receiving.at(came, now_s)
        if not self._sending.stuck(now_s, self.timeout_s) and not self._receiving.stuck(
            now_s, self.timeout_s
        ):
            return None
        self.abort()
        reason = f"transfer on {self.tx_id:#05x} stood still for more than {self.timeout_s} s"
        if self.fd:
            reason += "; do both sides use CAN FD?"
        return TransferError(reason, lost=True)

    def stop_sending(self) -> None:
        """Void what goes out, queued and half sent; what comes in goes on."""
        self._logic.stop_sending()
        self._queue.clear()
        self._outbox = deque(frame for frame in self._outbox if _is_flow_control(frame[1]))

    def abort(self) -> None:
        """Void both directions: queued and half sent, half received and received but not taken."""
        self._clear()
