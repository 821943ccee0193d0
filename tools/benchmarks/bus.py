"""What the virtual bus carries, beside python-can's own and the kernel's: ``python benchmarks/bus.py [--write FILE]``.

Markdown tables on stdout; with ``--write`` in a file as well.
"""

import multiprocessing
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import can
from measure import machine
from pages import Rows, document, show
from paths import EXAMPLES

sys.path.insert(0, str(Path(__file__).parents[2]))
from cutgate.config.bus import SOCKETCAN_CHANNEL, has_socketcan, open_bus
from cutgate.firmware_sim.bus import wire as datagrams
from cutgate.firmware_sim.bus.frame import BusFrame
from cutgate.firmware_sim.bus.medium.bits import INTERMISSION_BITS, Rates, frame_bits
from cutgate.firmware_sim.bus.messages import frame_of
from cutgate.firmware_sim.bus.virtual_time import VirtualTime
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.protocol.frames import IDS, ControllerHeartbeat, RuntimeHeartbeat
from cutgate.protocol.records import Side
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.job import make_job, read_files
from tests.runtime.session.pair import NOW
from tests.runtime.session.wired import WiredPair, wired

FRAMES = 60_000
RAW_FRAMES = 200_000
ROUND_TRIPS = 3000
RATES = Rates(1_000_000, 5_000_000)
MESSAGE = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"12345678")
FD_MESSAGE = can.Message(
    arbitration_id=0x123, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(range(64))
)
CONTEXT = multiprocessing.get_context("fork")

# ---------------------------------------------------------------- in another process


def _sends(open_one: Callable[[], can.BusABC], go: Any, done: Any, count: int) -> None:
    with open_one() as bus:
        go.wait()
        for _ in range(count):
            bus.send(MESSAGE, timeout=10.0)
        done.wait()


def _echoes(open_one: Callable[[], can.BusABC], go: Any, count: int) -> None:
    with open_one() as bus:
        go.set()
        for _ in range(count):
            message = bus.recv(10.0)
            assert message is not None
            bus.send(message)


def _one_way(open_one: Callable[[], can.BusABC]) -> float:
    """Frames a second from one process to another."""
    go, done = CONTEXT.Event(), CONTEXT.Event()
    with open_one() as bus:
        sender = CONTEXT.Process(target=_sends, args=(open_one, go, done, FRAMES))
        sender.start()
        go.set()
        bus.recv(10.0)
        began = time.perf_counter()
        for _ in range(FRAMES - 1):
            if bus.recv(10.0) is None:
                raise ValueError("frames were lost")
        took = time.perf_counter() - began
        done.set()
        sender.join()
    return (FRAMES - 1) / took


def _round_trip(open_one: Callable[[], can.BusABC]) -> list[float]:
    """Seconds of each, between two processes, shortest first."""
    go, took = CONTEXT.Event(), []
    with open_one() as bus:
        other = CONTEXT.Process(target=_echoes, args=(open_one, go, ROUND_TRIPS))
        other.start()
        go.wait()
        for _ in range(ROUND_TRIPS):
            began = time.perf_counter()
            bus.send(MESSAGE)
            assert bus.recv(10.0) is not None
            took.append(time.perf_counter() - began)
        other.join()
    return sorted(took)


@contextmanager
def _hub(*arguments: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
        path = Path(directory) / "bus.sock"
        with hub_process(path, *arguments):
            yield path


def _in_process() -> float:
    """Through python-can's `virtual`, which joins threads of one process only."""
    options = {"interface": "virtual", "channel": "benchmark", "ignore_config": True}
    with can.Bus(**options) as sender, can.Bus(**options) as receiver:
        began = time.perf_counter()
        for _ in range(FRAMES):
            sender.send(MESSAGE)
        for _ in range(FRAMES):
            receiver.recv(1.0)
        return FRAMES / (time.perf_counter() - began)


# ---------------------------------------------------------------- side by side


def side_by_side() -> Rows:
    """Classic frames of 8 bytes through python-can's API, from one process to another; `virtual` within one process.

    Round trips: a frame there, and the same one back.
    """
    yield ("bus", "frames/s", "of `virtual`", "round trip, median", "99 %")
    virtual = median(_in_process() for _ in range(3))
    yield ("python-can `virtual`, one process", f"{virtual:.0f}", "1.00", "", "")
    with _hub() as path:
        yield _row("hub, at once", lambda: open_bus("cutgate", str(path)), virtual)
    if has_socketcan():
        yield _row("kernel's vcan0", lambda: open_bus("socketcan", SOCKETCAN_CHANNEL), virtual)
    else:
        yield ("kernel's vcan0", "none on this machine", "", "", "")


def _row(name: str, open_one: Callable[[], can.BusABC], virtual: float) -> tuple[str, ...]:
    rate, trips = median(_one_way(open_one) for _ in range(3)), _round_trip(open_one)
    return (
        name,
        f"{rate:.0f}",
        f"{rate / virtual:.2f}",
        f"{median(trips) * 1e6:.0f} us",
        f"{trips[int(0.99 * len(trips))] * 1e6:.0f} us",
    )


def raw_sockets() -> Rows:
    """Frames a second through the hub's own sockets, from one process to another, so many in a datagram."""
    yield ("frames in a datagram", "frames/s")
    with _hub() as path:
        for together in (1, 8, 32):
            yield (str(together), f"{median(_raw(path, together) for _ in range(3)):.0f}")


def _raw_joined(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.connect(str(path))
    sock.send(datagrams.hello(fd=False, own=False).pack())
    sock.recv(100)
    return sock


def _raw_sends(path: Path, together: int, go: Any, done: Any) -> None:
    with _raw_joined(path) as sock:
        raw = datagrams.of_frame(frame_of(MESSAGE, fd=False)) * together
        go.wait()
        for _ in range(RAW_FRAMES // together):
            sock.send(raw)
        done.wait()


def _raw(path: Path, together: int) -> float:
    go, done = CONTEXT.Event(), CONTEXT.Event()
    size = len(datagrams.of_frame(frame_of(MESSAGE, fd=False)))
    with _raw_joined(path) as sock:
        sender = CONTEXT.Process(target=_raw_sends, args=(path, together, go, done))
        sender.start()
        go.set()
        count = len(sock.recv(datagrams.MAX_DATAGRAM)) // size
        began = time.perf_counter()
        while count < RAW_FRAMES:
            count += len(sock.recv(datagrams.MAX_DATAGRAM)) // size
        took = time.perf_counter() - began
        done.set()
        sender.join()
    return RAW_FRAMES / took


# ---------------------------------------------------------------- paced


def pace() -> Rows:
    """A sender whose transmit queue, of 1000 frames here, is never empty: bits on the wire, stuff bits and intermission counted, of the rate.

    FD frames of 64 bytes with bit rate switch: of the time that they take.
    """
    yield ("frames", "real time", "virtual time", "virtual seconds in one of the processor")
    for name, message in (("classic, 1 Mbit/s", MESSAGE), ("FD, 1 and 5 Mbit/s", FD_MESSAGE)):
        frame = frame_of(message, fd=True)
        each_s = (frame_bits(frame).ns(RATES) + RATES.nominal_ns(INTERMISSION_BITS)) * 1e-9
        virtual, ratio = _paced_virtual(message, each_s)
        yield (name, f"{_paced_real(message) * each_s:.2%}", f"{virtual:.2%}", f"{ratio:.1f}")


def _paced_real(message: can.Message) -> float:
    """Frames a second."""
    count = 10_000
    with (
        _hub("--bitrate", "1M", "--fd", "5M", "--queue", "1000") as path,
        open_bus("cutgate", str(path), fd=True) as sender,
        open_bus("cutgate", str(path), fd=True) as receiver,
    ):
        thread = threading.Thread(target=lambda: [sender.send(message) for _ in range(count)])
        thread.start()
        receiver.recv(10.0)
        began = time.perf_counter()
        for _ in range(count - 1):
            receiver.recv(10.0)
        took = time.perf_counter() - began
        thread.join()
    return (count - 1) / took


def _paced_virtual(message: can.Message, each_s: float) -> tuple[float, float]:
    virtual = VirtualTime(RATES)
    with virtual.join("sender", fd=True) as sender, virtual.join("receiver", fd=True) as receiver:

        def fill() -> None:
            receiver.inbox.clear()
            try:
                while True:
                    sender.send(message)
            except can.CanTimeoutError:
                return

        virtual.add(sender, fill, lambda: 0.0005)
        began, since = time.process_time(), virtual.clock()
        virtual.run(2.0)
        spent, passed = time.process_time() - began, virtual.clock() - since
    return virtual.medium.totals.frames * each_s / passed, passed / spent


# ---------------------------------------------------------------- sessions in virtual time


def sessions() -> Rows:
    """Both loops on the bus's clock at 1 Mbit/s, the hip stem's path: from its upload to its cut, and while it cuts."""
    yield (
        "transfers",
        "upload",
        "virtual seconds in one of the processor, upload",
        "while it cuts",
        "load while it cuts",
    )
    for name, fd in (("classic", ()), ("FD", tuple(Side))):
        with _session(fd) as pair:
            began, since = time.process_time(), pair.clock()
            pair.to(Phase.CUTTING, limit_s=60.0)
            upload_s = pair.clock() - since
            upload = upload_s / (time.process_time() - began)
            busy_ns, began, since = pair.time.medium.totals.busy_ns, time.process_time(), pair.clock()
            pair.cycle_s = 0.02
            pair.run(20.0)
            ratio = (pair.clock() - since) / (time.process_time() - began)
            load = (pair.time.medium.totals.busy_ns - busy_ns) / 20e9
            yield (name, f"{upload_s:.2f} s", f"{upload:.1f}", f"{ratio:.1f}", f"{load:.2%}")


@contextmanager
def _session(fd: tuple[Side, ...], registration: str = "second", **options: Any) -> Iterator[WiredPair]:
    with tempfile.TemporaryDirectory() as directory:
        os.environ["XDG_STATE_HOME"] = directory  # where a first session puts its key
        files = read_files(
            EXAMPLES / "hip-stem.plan.json",
            EXAMPLES / "robot.toml",
            EXAMPLES / f"registration-{registration}.json",
            None,
            None,
            allow_simulated=True,
        )
        job = make_job(files, now=NOW)
        with wired(Path(directory), files, job, fd, **options) as pair:
            pair.power_up(time_scale=1.0)
            yield pair


def heartbeats() -> Rows:
    """How long a heartbeat waits from the transmit queue to its last bit, on a bus of 1 Mbit/s, virtual time.

    Own bulk: while the path is uploaded, by whoever sends it, behind its own frames in a queue of ten. Bulk of others:
    a third node keeps the bus full of frames of low priority. Real time: the same with three processes on the hub, from
    `send` to the return of `recv`, whatever else the machine did.
    """
    yield ("load", "heartbeats of", "heard", "median", "99 %", "max")
    for name, load in (
        ("the path's upload, 10 times over", _uploading),
        ("bulk of another node, bus full", _bulk_of_others),
    ):
        waits = load()
        for kind in (RuntimeHeartbeat, ControllerHeartbeat):
            yield (name, kind.SENDER.name.lower(), *_distribution(sorted(waits[IDS[kind]])))
    yield ("bulk of another process, bus full, real time", "runtime", *_distribution(_real()))


def _distribution(took: list[float]) -> tuple[str, ...]:
    times = (median(took), took[int(0.99 * len(took))], took[-1])
    return (str(len(took)), *(f"{each * 1e6:.0f} us" for each in times))


def _real() -> list[float]:
    """Seconds from `send` to the return of `recv`, while another process keeps the paced hub full; shortest first."""
    count = 500
    with _hub("--bitrate", "1M") as path:

        def open_one() -> can.BusABC:
            return open_bus("cutgate", str(path))

        go, done = CONTEXT.Event(), CONTEXT.Event()
        with open_one() as bus:
            bulk = CONTEXT.Process(target=_floods, args=(open_one, done))
            beats = CONTEXT.Process(target=_beats, args=(open_one, go, done, count))
            bulk.start()
            beats.start()
            go.set()
            took: list[float] = []
            while len(took) < count:
                message = bus.recv(10.0)
                assert message is not None
                if message.arbitration_id == IDS[RuntimeHeartbeat]:
                    took.append(time.monotonic() - int.from_bytes(message.data, "big") * 1e-9)
            done.set()
            bulk.join()
            beats.join()
    return sorted(took)


def _floods(open_one: Callable[[], can.BusABC], done: Any) -> None:
    bulk = can.Message(arbitration_id=0x7F0, is_extended_id=False, data=bytes(8))
    with open_one() as bus:
        while not done.is_set():
            for _ in range(100):
                bus.send(bulk)
            while bus.recv(0) is not None:
                pass


def _beats(open_one: Callable[[], can.BusABC], go: Any, done: Any, count: int) -> None:
    with open_one() as bus:
        go.wait()
        for _ in range(count):
            data = time.monotonic_ns().to_bytes(8, "big")
            bus.send(can.Message(arbitration_id=IDS[RuntimeHeartbeat], is_extended_id=False, data=data))
            time.sleep(0.02)
            while bus.recv(0) is not None:
                pass
        done.wait()


def _watched(pair: WiredPair) -> dict[int, list[float]]:
    """From here on, how long each heartbeat waits."""
    waits: dict[int, list[float]] = {IDS[RuntimeHeartbeat]: [], IDS[ControllerHeartbeat]: []}
    offered: dict[BusFrame, int] = {}
    offer = pair.time.offer

    def offers(number: int, frame: BusFrame) -> bool:
        taken = offer(number, frame)
        if taken and frame.number in waits:
            offered[frame] = pair.time.now_ns
        return taken

    def seen(event: Any) -> None:
        frame = getattr(event, "frame", None)
        if frame in offered:
            waits[frame.number].append((event.at_ns - offered.pop(frame)) * 1e-9)

    pair.time.offer = offers  # type: ignore[method-assign]
    pair.time.watchers.append(seen)
    return waits


def _uploading() -> dict[int, list[float]]:
    waits: dict[int, list[float]] = {}
    for _ in range(10):
        with _session(()) as pair:
            found = _watched(pair)
            pair.to(Phase.VERIFYING, limit_s=60.0)
            for number, took in found.items():
                waits.setdefault(number, []).extend(took)
    return waits


def _bulk_of_others() -> dict[int, list[float]]:
    with _session(()) as pair:
        pair.to(Phase.CUTTING, limit_s=60.0)
        node = pair.time.join("bulk")
        bulk = BusFrame(0x7F0, 0, 8, bytes(8))

        def fill() -> None:
            while pair.time.offer(node.number, bulk):
                pass

        pair.time.add(node, fill, lambda: 0.0005)
        waits = _watched(pair)
        pair.run(10.0)
        node.shutdown()
        return waits


SECTIONS: dict[str, Callable[[], Rows]] = {
    "Side by side": side_by_side,
    "The hub's own sockets": raw_sockets,
    "At the pace of a wire": pace,
    "Sessions in virtual time": sessions,
    "Heartbeats on a full bus": heartbeats,
}


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}; the machine may have done other work meanwhile: what counts are ratios of one run."
    show(
        document("Benchmarks of the virtual bus", about, SECTIONS),
        __doc__.splitlines()[0] if __doc__ else None,
    )


if __name__ == "__main__":
    main()
