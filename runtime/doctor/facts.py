"""What probes find: small and typed, and nothing of it judged."""

from dataclasses import dataclass
from enum import Enum

from cutgate.config.refusal import FileProblem


@dataclass(frozen=True, slots=True)
class Unknown:
    """Nothing could be found, and why; ``remedy`` says how it could be."""

    why: str
    remedy: str = ""


# ---------------------------------------------------------------- the installation


@dataclass(frozen=True, slots=True)
class PythonVersion:
    """The interpreter's version, and what the program asks for."""

    version: str
    required: str


@dataclass(frozen=True, slots=True)
class PackageFound:
    """A package that the program asks for, and the version that is installed, None without one."""

    name: str
    required: str
    version: str | None


@dataclass(frozen=True, slots=True)
class ProgramFiles:
    """The program's own files.

    Attributes:
        count: how many were read.
        unreadable: names of those that are missing or cannot be read.
        altered: names of those that are not what was installed; None where nothing says what that was.
    """

    count: int
    unreadable: tuple[str, ...]
    altered: tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class CodeSources:
    """Where code comes from.

    Attributes:
        root: the folder of the program.
        foreign: modules of the program that came from elsewhere, with their files.
        open_folders: folders from which modules are taken and in which somebody else may put some.
    """

    root: str
    foreign: tuple[str, ...]
    open_folders: tuple[str, ...]


# ---------------------------------------------------------------- the bus


class SocketRefusal(Enum):
    """Why no raw CAN socket could be opened."""

    NO_CAN = "this kernel has no CAN"
    NO_RAW = "this kernel has CAN, but no raw CAN sockets"
    FORBIDDEN = "not permitted"


@dataclass(frozen=True, slots=True)
class RawSocket:
    """Whether this process may open a raw CAN socket; None is yes."""

    refused: SocketRefusal | None


@dataclass(frozen=True, slots=True)
class LinkDetail:
    """What ``ip -details -json link`` says of a CAN controller; None is what it does not say.

    Attributes:
        state: ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, STOPPED or SLEEPING.
        bitrate_bit_s: nominal.
        tx_errors, rx_errors: error counters.
        restart_ms: after bus-off it restarts by itself after this time; 0 never.
        modes: as LISTEN-ONLY, LOOPBACK, ONE-SHOT, FD.
    """

    state: str | None
    bitrate_bit_s: int | None
    tx_errors: int | None
    rx_errors: int | None
    restart_ms: int | None
    modes: frozenset[str]


@dataclass(frozen=True, slots=True)
class CanInterface:
    """A CAN interface of the kernel.

    Attributes:
        name: of the interface.
        virtual: it is known to have no hardware (vcan, vxcan).
        up: it is switched on.
        mtu: bytes of its longest frame: 16, or 72 with CAN FD.
        queue_frames: length of its transmit queue (``txqueuelen``).
        detail: of its controller; None where it has none, or nothing is said of it.
    """

    name: str
    virtual: bool
    up: bool
    mtu: int
    queue_frames: int
    detail: LinkDetail | None


@dataclass(frozen=True, slots=True)
class Interfaces:
    """All CAN interfaces, and why nothing more is known of them; empty if it is."""

    found: tuple[CanInterface, ...]
    no_detail: str = ""


@dataclass(frozen=True, slots=True)
class Backend:
    """Whether python-can has an interface of this name."""

    known: bool


@dataclass(frozen=True, slots=True)
class LocalBus:
    """The hub of the local virtual bus.

    Attributes:
        path: its socket.
        there: something stands at that path.
        refused: why a client did not join; None if it did.
    """

    path: str
    there: bool
    refused: str | None


# ---------------------------------------------------------------- the process and its machine


@dataclass(frozen=True, slots=True)
class Priority:
    """Scheduling of this process.

    Attributes:
        policy: SCHED_OTHER, SCHED_FIFO, SCHED_RR ...
        priority: real-time priority, 0 without one.
        limit: the highest that RLIMIT_RTPRIO allows.
        capable: CAP_SYS_NICE: no limit counts.
    """

    policy: str
    priority: int
    limit: int
    capable: bool


@dataclass(frozen=True, slots=True)
class MemoryFacts:
    """Memory that may be locked (RLIMIT_MEMLOCK), bytes, None without a limit; and swap that is in use as a place to go, bytes."""

    lockable_bytes: int | None
    swap_bytes: int


@dataclass(frozen=True, slots=True)
class ClockSource:
    """What the kernel counts time by, and what else it could."""

    current: str
    available: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Synchronisation:
    """What the kernel says of its clock: synchronised or not, and the largest error it may have, s."""

    synchronised: bool
    error_max_s: float


# ---------------------------------------------------------------- files and disk


@dataclass(frozen=True, slots=True)
class KeyFile:
    """A key file: the fingerprint of its key, or why it is refused."""

    path: str
    fingerprint: str
    problem: FileProblem | None


@dataclass(frozen=True, slots=True)
class LogFolder:
    """The log directory.

    Attributes:
        path: where.
        there: it exists; else the first session makes it.
        problem: why a session would not begin there.
        session: number of the process whose session holds it, None without one.
    """

    path: str
    there: bool
    problem: FileProblem | None
    session: int | None


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """Bytes free for this user on the disk of this folder."""

    folder: str
    free_bytes: int


@dataclass(frozen=True, slots=True)
class Delays:
    """How long something took, or how late it came, ms: so often, the median, and the worst."""

    count: int
    median_ms: float
    worst_ms: float
