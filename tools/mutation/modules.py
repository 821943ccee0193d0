"""The modules that decide, and each one's own tests: what coverage and mutation hold them to.

``python -m tools.mutation.modules`` runs each module's own tests alone and fails below 100 % branch coverage.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
OWN_TESTS: Final[dict[str, tuple[str, ...]]] = {
    "runtime/interlock/phases.py": ("tests/runtime/interlock/test_table.py",),
    "runtime/interlock/table.py": ("tests/runtime/interlock/test_table.py",),
    "runtime/interlock/permissives.py": ("tests/runtime/interlock/test_permissives.py",),
    "runtime/interlock/tracking.py": ("tests/runtime/interlock/test_tracking.py",),
    "runtime/session/check.py": ("tests/runtime/session/test_check.py",),
    "runtime/session/events.py": ("tests/runtime/session/test_events.py",),
    "runtime/session/loop.py": tuple(
        f"tests/runtime/session/test_{name}.py"
        for name in (
            "session",
            "bus",
            "clocks",
            "disk",
            "failures",
            "false_worker",
            "full_queue",
            "guided",
            "operator",
            "screen",
            "space",
            "witness",
        )
    ),
    "runtime/session/messages.py": ("tests/runtime/session/test_messages.py",),
    "runtime/session/pauses.py": ("tests/runtime/session/test_pauses.py",),
    "runtime/session/strangers.py": ("tests/runtime/session/test_strangers.py",),
    "runtime/session/verifying.py": ("tests/runtime/session/test_verifying.py",),
    "runtime/session/withdrawal.py": ("tests/runtime/session/test_withdrawal.py",),
    "runtime/session/withdrawn.py": ("tests/runtime/session/test_withdrawn.py",),
    "runtime/session/witness.py": ("tests/runtime/session/test_witness.py",),
    "firmware_sim/table.py": (
        "tests/firmware_sim/test_table.py",
        "tests/firmware_sim/test_remembering.py",
    ),
    "firmware_sim/rules.py": ("tests/firmware_sim/test_rules.py",),
    "firmware_sim/state.py": ("tests/firmware_sim/test_state.py",),
    "firmware_sim/memory.py": ("tests/firmware_sim/test_memory.py",),
    "firmware_sim/loop.py": (
        "tests/firmware_sim/test_loop.py",
        "tests/firmware_sim/test_loop_in_session.py",
    ),
    "firmware_sim/arrivals.py": ("tests/firmware_sim/test_arrivals.py",),
    "firmware_sim/upload.py": ("tests/firmware_sim/test_upload.py",),
    "firmware_sim/arm.py": ("tests/firmware_sim/test_arm.py",),
    "firmware_sim/mechanical.py": ("tests/firmware_sim/test_mechanical.py",),
    "firmware_sim/drives.py": ("tests/firmware_sim/test_drives.py",),
    "firmware_sim/bone.py": ("tests/firmware_sim/test_bone.py",),
    "firmware_sim/faults.py": ("tests/firmware_sim/test_faults.py",),
    "firmware_sim/console.py": ("tests/firmware_sim/test_console.py",),
    "firmware_sim/reports.py": ("tests/firmware_sim/test_reports.py",),
    "firmware_sim/approach.py": ("tests/firmware_sim/test_approach.py",),
    "firmware_sim/path_check.py": ("tests/firmware_sim/test_path_check.py",),
    "protocol/cycle.py": ("tests/protocol/test_cycle.py",),
    "protocol/e2e.py": ("tests/protocol/test_e2e.py",),
    "protocol/link.py": ("tests/protocol/test_link.py",),
    "protocol/codes.py": ("tests/protocol/test_codes.py",),
    "protocol/conversation.py": ("tests/protocol/test_conversation.py",),
    "protocol/endpoint.py": ("tests/protocol/test_endpoint.py", "tests/protocol/test_waiting.py"),
    "protocol/frames.py": ("tests/protocol/test_frames.py",),
    "protocol/states.py": ("tests/protocol/test_states.py",),
    "protocol/wire.py": ("tests/protocol/test_wire.py",),
    "protocol/records.py": ("tests/protocol/test_records.py", "tests/protocol/test_vectors.py"),
    # What decides of a path: its bytes, their coding, approach and retract.
    "protocol/path.py": ("tests/protocol/test_path.py",),
    "protocol/coding.py": ("tests/protocol/test_coding.py",),
    "runtime/verification/approach/decision.py": ("tests/runtime/verification/approach/test_decision.py",),
    "runtime/verification/approach/straight_line.py": (
        "tests/runtime/verification/approach/test_straight_line.py",
    ),
    "runtime/verification/approach/joint_line.py": (
        "tests/runtime/verification/approach/test_joint_line.py",
    ),
    "runtime/verification/approach/curve.py": ("tests/runtime/verification/approach/test_curve.py",),
    "runtime/verification/approach/report.py": ("tests/runtime/verification/approach/test_report.py",),
    # The audit log: what could make a forged or broken log pass as whole.
    "runtime/audit/chain.py": ("tests/runtime/audit/test_chain.py",),
    "runtime/audit/tree.py": ("tests/runtime/audit/test_tree.py",),
    "runtime/audit/signing/note.py": ("tests/runtime/audit/signing/test_note.py",),
    "runtime/audit/signing/checkpoint.py": ("tests/runtime/audit/signing/test_checkpoint.py",),
    "runtime/audit/signing/log_key.py": ("tests/runtime/audit/signing/test_log_key.py",),
    "runtime/audit/signing/signer.py": ("tests/runtime/audit/signing/test_signer.py",),
    "runtime/audit/signing/signatures.py": ("tests/runtime/audit/signing/test_signatures.py",),
    "runtime/audit/trust.py": ("tests/runtime/audit/test_trust.py",),
    "runtime/audit/log_keys.py": ("tests/runtime/audit/test_log_keys.py",),
    "runtime/audit/signing/proof.py": ("tests/runtime/audit/signing/test_proof.py",),
    "runtime/audit/proving.py": ("tests/runtime/audit/test_proving.py",),
    "runtime/audit/signed.py": ("tests/runtime/audit/test_signed.py",),
    "runtime/audit/series.py": ("tests/runtime/audit/test_series.py",),
    "runtime/audit/series_rules.py": ("tests/runtime/audit/test_series.py",),
    "runtime/audit/roots.py": ("tests/runtime/audit/test_roots.py",),
    "runtime/audit/witness.py": (
        "tests/runtime/audit/test_witness.py",
        "tests/runtime/audit/test_signed_start.py",
    ),
    "runtime/audit/signed_start.py": ("tests/runtime/audit/test_signed_start.py",),
    "runtime/audit/judge.py": ("tests/runtime/audit/test_judge.py",),
    "runtime/audit/recovered.py": ("tests/runtime/audit/test_recovered.py",),
    "runtime/audit/recovery.py": ("tests/runtime/audit/test_recovery.py",),
    "runtime/audit/container/raw.py": ("tests/runtime/audit/container/test_raw.py",),
    "runtime/audit/container/kinds.py": ("tests/runtime/audit/container/test_kinds.py",),
    "runtime/audit/container/chunk.py": ("tests/runtime/audit/container/test_chunk.py",),
    "runtime/audit/container/attachment.py": ("tests/runtime/audit/container/test_attachment.py",),
    "runtime/audit/container/summary.py": ("tests/runtime/audit/container/test_summary.py",),
    "runtime/audit/container/places.py": ("tests/runtime/audit/container/test_places.py",),
    "runtime/audit/container/scan.py": ("tests/runtime/audit/container/test_scan.py",),
    "runtime/audit/recomputed/inputs.py": ("tests/runtime/audit/recomputed/test_inputs.py",),
    "runtime/audit/recomputed/comparison.py": ("tests/runtime/audit/recomputed/test_comparison.py",),
    "runtime/audit/recomputed/verdict.py": ("tests/runtime/audit/recomputed/test_verdict.py",),
    "runtime/audit/recomputed/approach.py": ("tests/runtime/audit/recomputed/test_approach.py",),
    "runtime/audit/recomputed/enabled.py": ("tests/runtime/audit/recomputed/test_enabled.py",),
    "runtime/audit/recomputed/transitions.py": ("tests/runtime/audit/recomputed/test_transitions.py",),
    "runtime/audit/recomputed/steps.py": ("tests/runtime/audit/recomputed/test_steps.py",),
    "runtime/audit/written.py": ("tests/runtime/audit/test_written.py",),
    "config/durable.py": ("tests/config/test_durable.py",),
    # The simulated wire: who may speak, and when; what fails a node and brings it back.
    **{
        f"firmware_sim/bus/medium/{name}.py": (f"tests/firmware_sim/bus/medium/test_{name}.py",)
        for name in ("bits", "confinement", "errors", "medium", "nodes")
    },
    **{
        f"firmware_sim/bus/{name}.py": (f"tests/firmware_sim/bus/test_{name}.py",)
        for name in ("carriers", "control", "frame", "messages", "overload", "states", "virtual_time")
    },
}
"""Module to the test files that must cover and guard it without help from any other."""


def covered(module: str) -> tuple[bool, str]:
    """Whether the module's own tests pass and reach each branch; with the line of the report."""
    with tempfile.TemporaryDirectory() as folder:
        data = f"COVERAGE_FILE={folder}/data"
        name = f"cutgate.{module.removesuffix('.py').replace('/', '.')}"
        pytest = ["-m", "pytest", "-q", "-p", "no:cacheprovider", f"--cov={name}", "--cov-branch"]
        limits = ["--cov-report=term-missing:skip-covered", "--cov-fail-under=100"]
        done = subprocess.run(  # noqa: S603 - our own interpreter on our own tests
            ["/usr/bin/env", data, sys.executable, *pytest, *limits, *OWN_TESTS[module]],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
    lines = [
        line for line in done.stdout.splitlines() if line.startswith((module, "TOTAL", "FAILED", "ERROR"))
    ]
    return done.returncode == 0, "\n    ".join(lines)


def main(modules: Iterable[str]) -> int:
    """Print one line a module, as many at a time as there are cores; 1 if any falls short."""
    asked, short = list(modules) or [*OWN_TESTS], 0
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for module, (whole, report) in zip(asked, pool.map(covered, asked), strict=True):
            print(f"{'ok  ' if whole else 'MISS'} {module}\n    {report}", flush=True)  # noqa: T201 - a report
            short += not whole
    return int(short > 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
