"""The log that the controller saw last, looked up beside the session's loop: a disk takes as long as it likes."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from cutgate.protocol.records import TreeHead
from cutgate.runtime.audit.witness import WitnessFound, look_up


class WitnessSearch:
    """One look-up, in a thread that keeps nobody from leaving.

    Args:
        directory: of the logs.
        look: as ``audit.witness.look_up``.
    """

    def __init__(
        self, directory: Path, look: Callable[[Path, bytes, int, bytes], WitnessFound] = look_up
    ) -> None:
        self._directory, self._look = directory, look
        self._answers: SimpleQueue[WitnessFound] = SimpleQueue()
        self._sought: TreeHead | None = None

    def begin(self, log: TreeHead) -> None:
        """Look up this log. A session opens once: a second one is not looked up."""
        if self._sought is None:
            self._sought = log
            Thread(target=self._run, args=(log,), name="witness", daemon=True).start()

    def answer(self) -> WitnessFound | None:
        """What was found, once; None until then."""
        with suppress(Empty):
            return self._answers.get_nowait()
        return None

    def _run(self, log: TreeHead) -> None:
        try:
            found = self._look(self._directory, log.log_id, log.size, log.root)
        except Exception as error:  # noqa: BLE001 - whatever it is, the log is not found, and somebody waits
            found = WitnessFound(None, f"it cannot be looked up: {type(error).__name__}: {error}")
        self._answers.put(found)
