"""The decoder of coded poses in C, compiled, and held against the golden vectors and against changed ones."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cutgate.protocol.coding import coded_bytes_max, decode, encode, written
from cutgate.protocol.wire import RecordError
from tests.protocol.vectors import generate

pytestmark = pytest.mark.processes

HERE = Path(__file__).parent
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wno-sign-conversion", "-O1")
VECTORS = json.loads((generate.HERE / "coding.json").read_text(encoding="ascii"))
CHANGES = 300


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler named cc on this machine")
    built = tmp_path_factory.mktemp("coding") / "coding"
    command = [compiler, *STRICT, HERE / "coding.c", "-o", built]
    made = subprocess.run(command, check=False, capture_output=True, text=True, timeout=100)
    assert made.returncode == 0, made.stderr
    return built


def answers(program: Path, asked: list[tuple[int, bytes]]) -> list[str]:
    text = "".join(f"{count} {data.hex() or '-'}\n" for count, data in asked)
    done = subprocess.run([program], input=text, check=True, capture_output=True, text=True, timeout=60)
    return done.stdout.split()


def answer(count: int, data: bytes) -> str:
    try:
        return decode(data, count).astype("<i4").tobytes().hex()
    except RecordError:
        return "refused"


def test_every_vector(program: Path):
    sound = [(len(one["poses"]) // 40, bytes.fromhex(one["data"])) for one in VECTORS["coded"]]
    assert answers(program, sound) == [one["poses"] for one in VECTORS["coded"]]
    refused = [(one["poses"], bytes.fromhex(one["data"])) for one in VECTORS["refused"]]
    assert answers(program, refused) == ["refused"] * len(refused)


def test_other_choices_and_changed_bytes_are_taken_or_refused_alike(program: Path):
    random = np.random.default_rng(7)
    asked = []
    for _ in range(CHANGES):
        count = int(random.integers(1, 201))
        poses = random.integers(-(2 ** random.integers(1, 31)), 2 ** random.integers(1, 31), (count, 5))
        for _ in range(random.integers(0, 7)):
            poses = np.cumsum(poses, axis=0)
        poses = (poses % 2**32).astype(np.uint32).view(np.int32)
        data = bytearray(encode(poses))
        asked.append((count, bytes(data)))
        data[random.integers(0, len(data))] ^= 1 << int(random.integers(0, 8))
        asked.append((count, bytes(data)))
        choice = [(int(random.integers(0, 8)), int(random.integers(0, 64))) for _ in range(5)]
        other = written(poses, choice)
        asked.append((count, other[: coded_bytes_max(200)]))
    found = answers(program, asked)
    assert found == [answer(count, data) for count, data in asked]
    assert 0 < found.count("refused") < len(found)
