"""The table of checks of the machine, for a site."""

from typing import Any, Final

from cutgate.runtime.doctor.checks import Probed
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.judges import can_bus as judged_bus
from cutgate.runtime.doctor.judges import files as judged_files
from cutgate.runtime.doctor.judges import process as judged_process
from cutgate.runtime.doctor.probes import can_bus, files, latency, process

MACHINE: Final[tuple[Probed[Examined, Any], ...]] = (
    Probed("raw CAN socket", "may be opened", can_bus.raw_socket, judged_bus.judge_socket),
    Probed("CAN interfaces", "as the bus needs them", can_bus.interfaces, judged_bus.judge_interfaces),
    Probed("bus", "an interface of python-can", can_bus.backend, judged_bus.judge_backend),
    Probed("local virtual bus", "serving, and ours", can_bus.local_bus, judged_bus.judge_local),
    Probed("real-time priority", "allowed", process.priority, judged_process.judge_priority),
    Probed("memory", "no swap", process.memory, judged_process.judge_memory),
    Probed("clock source", "fine and quick", process.clock_source, judged_process.judge_clock_source),
    Probed(
        "clock synchronisation", "synchronised", process.synchronisation, judged_process.judge_synchronisation
    ),
    Probed("key", "a key that only this user may read", files.key, judged_files.judge_key),
    Probed("log directory", "this user's own", files.log_folder, judged_files.judge_log_folder),
    Probed("log space", "for a session of an hour", files.free_space, judged_files.judge_space),
    Probed("log disk", "durable within commit_deadline_ms", files.disk_delays, judged_files.judge_disk),
    Probed("loop latency", "within a heartbeat", latency.loop_delays, judged_files.judge_loop),
)
