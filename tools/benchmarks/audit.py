"""What a signed log costs: ``python tools/benchmarks/audit.py [--write FILE]``."""

import os
import select
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from statistics import median

from measure import in_a_child, machine, seconds
from pages import Rows, document, show

from cutgate.runtime.audit import records
from cutgate.runtime.audit.chain import GENESIS, ChainLink, covered, follow
from cutgate.runtime.audit.commit import Durable
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.log import AuditLog, OpenInfo
from cutgate.runtime.audit.proving import prove
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.schema import schema_bytes
from cutgate.runtime.audit.signing.log_key import KEY_BYTES, SERIES_BYTES, LogKey
from cutgate.runtime.audit.signing.signer import Signer, sidecar_of
from cutgate.runtime.audit.tree import Tree
from cutgate.runtime.audit.writer import CHUNK_BYTES, LogWriter, schema_name

LOG_ID = "5f" * 16
WORK = 2000
"""Records in one work."""
SYNCS = 10
Work = Callable[[], object]
SIZES_MB = (5, 50, 200)
PERIOD_NS = 20_000_000
FRAMES = (0x080, 0x081, 0x100, 0x101, 0x102, 0x103)
"""What one period has while it cuts: two heartbeats, three frames of joints, progress."""
PERIODS_A_MINUTE = 3000
PERMITS = 50


def frame(number: int) -> records.CanFrame:
    """One frame of a cut."""
    stamp = records.Time.of(1_790_000_000_000_000_000 + number // len(FRAMES) * PERIOD_NS)
    data = number.to_bytes(8, "little").hex()
    return records.CanFrame(
        stamp=stamp, direction="received", id=FRAMES[number % len(FRAMES)], dlc=8, data=data
    )


@contextmanager
def a_log() -> Iterator[AuditLog]:
    """A log in a folder of its own, its key too."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as folder:
        os.environ["XDG_STATE_HOME"] = folder
        opened = OpenInfo(software="cutgate benchmark", verifier="none")
        log = AuditLog.create(Path(folder) / "logs", log_id=os.urandom(16).hex(), opened=opened)
        yield log
        if log.writable:
            log.close(final_state="done", clean=True, timeout_s=60)


def _in_memory() -> dict[str, tuple[int, Work]]:
    """Works that need no disk, by name, each with how often it does the same."""
    frames = [frame(number) for number in range(WORK)]
    bodies = [body(number, one) for number, one in enumerate(frames)]
    signer = Signer(LogKey(os.urandom(SERIES_BYTES), 1, os.urandom(KEY_BYTES)), LOG_ID)

    def treeing() -> None:
        tree = Tree()
        for one in bodies:
            tree.append(one)

    return {
        "build and encode": (WORK, lambda: [frame(number).encode() for number in range(WORK)]),
        "chain": (WORK, lambda: reduce(follow, bodies, GENESIS)),
        "tree": (WORK, treeing),
        "signature": (WORK, lambda: [signer.checkpoint(number, bytes(32)) for number in range(WORK)]),
    }


def body(number: int, one: records.CanFrame) -> bytes:
    """What the chain covers of it."""
    schema = schema_bytes(records.CanFrame)
    link = ChainLink(one.TOPIC, "json", schema_name(records.CanFrame), schema, 1, 1, number, one.encode())
    return covered(link)


def per_record() -> Rows:
    """Microseconds, each work by itself, the works in turn; a signature is one a checkpoint, of which a chunk has one.

    The last column: as a share of building and encoding a record of a frame.
    """
    data = body(0, frame(0))
    with tempfile.NamedTemporaryFile(prefix="cutgate-") as file:

        def flushing() -> None:
            for _ in range(WORK):
                os.write(file.fileno(), data)

        def syncing() -> None:
            for _ in range(SYNCS):
                os.write(file.fileno(), data)
                os.fdatasync(file.fileno())

        disk = {"write to the system": (WORK, flushing), "write and fdatasync": (SYNCS, syncing)}
        works = _in_memory() | disk
        took = seconds(*(work for _, work in works.values()))
    each = [spent / count for spent, (count, _) in zip(took, works.values(), strict=True)]
    yield ("work", "us", "of building and encoding")
    for name, spent in zip(works, each, strict=True):
        yield (name, f"{spent * 1e6:.1f}", f"{spent / each[0]:.2f}")


def permits() -> Rows:
    """From a decision's record to the report that it is durable, ms; the two logs in turn, ten frames before each."""
    with a_log() as signed, a_log() as plain:
        plain._writer._signer = None
        took: dict[str, list[float]] = {"signed": [], "without signatures": []}
        for number in range(PERMITS):
            for log, name in ((signed, "signed"), (plain, "without signatures")):
                for one in range(10):
                    log.write(frame(number * 10 + one))
                began = time.perf_counter()
                log.commit(number)
                while not any(isinstance(e, Durable) and e.token == number for e in log.events()):
                    select.select([log], [], [], 1.0)
                took[name].append(time.perf_counter() - began)
    yield ("log", "median", "longest")
    for name, times in took.items():
        yield (name, f"{median(times) * 1e3:.2f}", f"{max(times) * 1e3:.2f}")
    more = median(took["signed"]) - median(took["without signatures"])
    yield ("a permit waits longer by", f"{more * 1e3:.2f}", "")


def verified(path: Path) -> tuple[float, str]:
    """Seconds of judging a log by itself, and its status."""
    began = time.perf_counter()
    with reading(path) as log:
        return time.perf_counter() - began, log.report.status.name


def verification() -> Rows:
    """Structure, chain, tree and signatures of a closed log, as `audit verify` judges it, in a process of its own; no replay."""
    yield (
        "log, MB",
        "records",
        "seconds",
        "MB/s",
        "peak of the process, MiB",
        "sidecar, bytes",
        "proof, bytes",
    )
    for size_mb in SIZES_MB:
        with a_log() as log:
            number = 0
            while log.size < size_mb * 1_000_000:
                log.write(frame(number))
                number += 1
                if number % 1000 == 0:
                    log.commit(None)
            assert log.close(final_state="done", clean=True, timeout_s=60).closed
            (took, status), peak = in_a_child(verified, log.path)
            assert status == Status.OK.name, status
            size = log.path.stat().st_size
            proof = len(prove(log.path, number // 2).encode())
            yield (
                f"{size / 1e6:.0f}", str(number), f"{took:.2f}", f"{size / took / 1e6:.1f}", f"{peak:.0f}",
                str(sidecar_of(log.path).stat().st_size), str(proof),
            )  # fmt: skip


def growth() -> Rows:
    """A minute of cutting at heartbeats of 20 ms: six frames a period, a chunk each 0.8 s; tracking and timing come on top.

    No decisions: each ends a chunk of its own, with a checkpoint more.
    """
    sizes = []
    checkpoints = 0
    for signer in (Signer(LogKey(bytes(SERIES_BYTES), 1, os.urandom(KEY_BYTES)), LOG_ID), None):
        writer = LogWriter(LOG_ID, {}, signer)
        for period in range(PERIODS_A_MINUTE):
            for one in range(len(FRAMES)):
                writer.add(frame(period * len(FRAMES) + one), log_time_ns=1, monotonic_ns=1)
            if period % 40 == 39:
                writer.close_chunk()
        checkpoints = writer.count - PERIODS_A_MINUTE * len(FRAMES) if signer else checkpoints
        sizes.append(len(writer.take()))
    yield ("log, MB a minute", "checkpoints", "MB without", "checkpoints' share", "chunk closed at, bytes")
    share = (sizes[0] - sizes[1]) / sizes[0]
    yield (
        f"{sizes[0] / 1e6:.2f}",
        str(checkpoints),
        f"{sizes[1] / 1e6:.2f}",
        f"{share:.2%}",
        str(CHUNK_BYTES),
    )


SECTIONS = {
    "Per record": per_record,
    "What a permit waits": permits,
    "Verification": verification,
    "Growth": growth,
}


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}. What is signed, and how it is verified: [audit.md](audit.md)."
    show(document("Signed logs", about, SECTIONS), __doc__.splitlines()[0] if __doc__ else None)


if __name__ == "__main__":
    main()
