"""Node.js and the packages of viewers, as a program of their own: tests that need them skip, saying so, where they are not."""

import shutil
import subprocess

import pytest

TIMEOUT_S = 60
"""A bound, not an expectation."""


def node(script, *arguments):
    command = [shutil.which("node") or "node", "-e", script, "--", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S)


def needs_packages(what, *packages):
    """Skips where node or one of these is not there; ``what`` is not read by them then."""
    named = " and ".join(packages)
    if shutil.which("node") is None:
        pytest.skip(f"node is not installed: {what} is not read by {named}")
    if node("; ".join(f'require.resolve("{one}")' for one in packages)).returncode:
        pytest.skip(f"node finds no {named} (npm install, and set NODE_PATH): {what} is not read by it")
