"""Files made to take memory or time are refused as fast as any other, by the program as it is started."""

import subprocess
import sys

import pytest

from cutgate.config.load import EXAMPLES

pytestmark = pytest.mark.processes

PEAK_KB = 300_000
CPU_S = 20
"""A refusal takes half a second; what these files were made for takes minutes, hours or all memory."""
COMMAND = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({CPU_S}, {CPU_S}))
from cutgate.runtime.commands.app import execute
code = execute(sys.argv[1:])
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
sys.exit(code)
"""
POSES = b"x,y,z,i,j,k\n" + 2 * b"600,20,100,0.5,0,0.8660254\n"
DIGITS = b"1" * 200_000
ROBOT = (EXAMPLES / "robot.toml").read_bytes()
SPARSE = 8 << 30
"""Bytes of a file that takes none on the disk."""


def keys(parts: int, count: int) -> bytes:
    """So many keys of so many parts, each in a table of its own."""
    return b"".join(b"%03d" % number + b".a" * (parts - 1) + b"=1\n" for number in range(count))


HOSTILE = {
    "one endless number": ("plan.csv", lambda: POSES + DIGITS, "line 4 is 1 fields"),
    "six endless numbers": ("plan.csv", lambda: POSES + b",".join([DIGITS] * 6), "line 4"),
    "numbers and a letter": ("plan.csv", lambda: POSES + b",".join([DIGITS] * 6) + b"x", "line 4 column k"),
    "fractions": ("plan.csv", lambda: POSES + b",".join([b"1." + DIGITS + b"e"] * 6), "line 4 column x"),
    "spaces": ("plan.csv", lambda: POSES + b",".join([b"1" + b" " * 200_000] * 6) + b"x", "line 4 column k"),
    "a line of fields": ("plan.csv", lambda: POSES + b"1," * 30_000_000, "line 4 is 30000001 fields"),
    "a header of fields": ("plan.csv", lambda: b"x," * 30_000_000, "line 1"),
    "empty lines": ("plan.csv", lambda: b"\n" * 60_000_001, "poses is 60000000 poses"),
    "empty lists": ("plan.json", lambda: b'{"poses": [' + b"[]," * 20_000_000, "20000001 times '['"),
    "empty objects": ("plan.json", lambda: b'{"poses": [' + b"{}," * 20_000_000, "20000001 times '{'"),
    "numbers": ("plan.json", lambda: b'{"poses": [' + b"1," * 30_000_000, "30000000 times ','"),
    "keys": (
        "plan.json",
        lambda: b'{"poses": [], ' + b",".join(b'"%x":1' % number for number in range(5_000_000)) + b"}",
        "5000001 times ':'",
    ),
    "an integer": ("plan.json", lambda: b'{"id": ' + b"9" * 60_000_000 + b"}", "line 1 column 8 is 999"),
    "a name": (
        "plan.json",
        lambda: b'{"schema": "cutgate.plan/1", "id": "' + b"9" * 30_000_000 + b'"}',
        'id is "999',
    ),
    "a sparse plan": ("plan.json", SPARSE, "must be <= 64000000 bytes"),
    "a sparse tool path": ("plan.csv", SPARSE, "must be <= 64000000 bytes"),
    "a sparse registration": ("registration.json", SPARSE, "must be <= 100000 bytes"),
    "a sparse robot": ("robot.toml", SPARSE, "must be <= 100000 bytes"),
    "nested lists": ("registration.json", lambda: b"[" * 100_000, "not usable JSON"),
    "a key of parts": ("robot.toml", lambda: b"a." * 10_000 + b"a = 1\n", "line 1 is a line of 10000 dots"),
    "keys of parts": ("robot.toml", lambda: keys(98, 100), "schema is missing"),
    "a table and keys of parts": (
        "robot.toml",
        lambda: b"[" + b"a." * 99 + b"a]\n" + keys(98, 490),
        "schema is missing",
    ),
    "nested tables": ("robot.toml", lambda: b"a = " + b"{a = " * 19_000, "not usable TOML"),
    "bits": ("robot.toml", lambda: ROBOT.replace(b"450.0", b"0x" + b"f" * 90_000, 1), "of 360000 bits"),
    "digits": ("robot.toml", lambda: ROBOT.replace(b"450.0", b"9" * 90_000, 1), "column 17 is 999"),
}


@pytest.mark.parametrize(("name", "content", "words"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_made_to_take_memory_or_time_is_refused_as_fast_as_any_other(name, content, words, tmp_path):
    plan, robot, hostile = tmp_path / "plan.csv", tmp_path / "robot.toml", tmp_path / name
    plan.write_bytes(POSES)
    robot.write_bytes(ROBOT)
    if content is SPARSE:
        with hostile.open("wb") as file:
            file.truncate(SPARSE)
    else:
        hostile.write_bytes(content())
    files = [str(hostile if hostile.stem == "plan" else plan), "--robot", str(robot)]
    files += ["--registration", str(hostile)] if hostile.stem == "registration" else []
    command = [sys.executable, "-c", COMMAND, "verify", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    hostile.unlink()
    assert done.returncode == 2, done.stderr
    assert str(hostile) in done.stderr
    assert words in done.stderr
    assert len(done.stderr.replace(str(tmp_path), "")) < 1000
    assert int(done.stdout) < PEAK_KB
