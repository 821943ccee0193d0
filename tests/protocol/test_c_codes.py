"""The golden vectors' tags and codes in C: a library that firmware people use, compiled, and held against each of them.

tests/protocol/codes.c is ours, tiny-AES-c below it is the source that the package index has, pinned by its hash.
"""

import json
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.protocol.vectors import generate

pytestmark = [pytest.mark.slow, pytest.mark.processes]

HERE = Path(__file__).parent
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-DCBC=0", "-DCTR=0")
RFC_4493 = (
    ("-", "bb1d6929e95937287fa37d129b756746"),
    ("6bc1bee22e409f96e93d7e117393172a", "070a16b46b4d4144f79bdd9dd04a287c"),
    (
        "6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e5130c81c46a35ce411",
        "dfa66747de9ae63030ca32611497c827",
    ),
    (
        (
            "6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e51"
            "30c81c46a35ce411e5fbc1191a0a52eff69f2445df4f9b17ad2b417be66c3710"
        ),
        "51f0bebf7e3b9d92fc49741779363cfe",
    ),
)
"""Section 4: messages of 0, 16, 40 and 64 bytes under one key."""
RFC_4493_KEY = "2b7e151628aed2a6abf7158809cf4f3c"


def load(name: str) -> Any:
    return json.loads((generate.HERE / f"{name}.json").read_text(encoding="ascii"))


SIGNED, OPENING, TAGS = load("signed"), load("opening"), load("tags")
RECORDS = ("opened", "permit", "start", "reset", "acknowledge", "withdraw")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of aes.c and aes.h."""
    folder = tmp_path_factory.mktemp("library")
    fetch = [
        "download",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-binary",
        ":all:",
        "--dest",
        folder,
    ]
    command = [sys.executable, "-m", "pip", *fetch, "--require-hashes", "-r", HERE / "tiny_aes.txt"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    [archive] = folder.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    [found] = folder.glob("*/tiny-AES-c")
    return found


@pytest.fixture(scope="module")
def program(library: Path) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler named cc on this machine")
    built = library / "codes"
    command = [compiler, *STRICT, f"-I{library}", HERE / "codes.c", library / "aes.c", "-o", built]
    made = subprocess.run(command, check=False, capture_output=True, text=True, timeout=100)
    assert made.returncode == 0, made.stderr
    return built


def computed(program: Path, lines: Iterable[str]) -> list[str]:
    """What the program answers to each line."""
    text = "".join(f"{line}\n" for line in lines)
    done = subprocess.run([program], input=text, check=True, capture_output=True, text=True, timeout=60)
    return done.stdout.split()


def key(info: str) -> str:
    return generate.hkdf16(
        bytes.fromhex(TAGS["key"]), info.encode(), bytes.fromhex(TAGS["session_digest"])
    ).hex()


def test_the_library_computes_the_codes_of_the_rfc(program):
    asked = [f"bytes {RFC_4493_KEY} {message}" for message, _ in RFC_4493]
    assert computed(program, asked) == [code for _, code in RFC_4493]


def test_every_tag_of_a_heartbeat(program):
    keys = {
        "runtime": key("runtime to controller: heartbeat"),
        "controller": key("controller to runtime: heartbeat"),
    }
    beats = TAGS["heartbeats"]
    asked = [
        f"heartbeat {keys[beat['from']]} {beat['counter']} {beat['echo']} {beat['last_bytes']}"
        for beat in beats
    ]
    assert {beat["from"] for beat in beats} == set(keys)
    assert computed(program, asked) == [str(beat["tag"]) for beat in beats]


def test_every_tag_of_a_joint_sample(program):
    own = key("controller to runtime: sample")
    asked = [f"sample {own} {one['counter']} {' '.join(map(str, one['joints']))}" for one in TAGS["samples"]]
    assert asked
    assert computed(program, asked) == [str(one["tag"]) for one in TAGS["samples"]]


@pytest.mark.parametrize("name", RECORDS)
def test_the_code_of_every_signed_record(program, name):
    body, sequence, code = parts(SIGNED[name])
    own = key(f"{'controller to runtime' if name == 'opened' else 'runtime to controller'}: record")
    asked = f"record {own} cutgate/{name}/1 {SIGNED['session_digest']} {sequence} {body.hex()}"
    assert computed(program, [asked]) == [code.hex()]


def test_the_code_of_open(program):
    body, _, code = parts(OPENING["open"])
    own = generate.hkdf16(bytes.fromhex(OPENING["key"]), b"cutgate/open/1").hex()
    assert computed(program, [f"open {own} {body.hex()}"]) == [code.hex()]


def test_no_signed_record_and_no_list_of_tags_is_left_out():
    held = {name for name, value in SIGNED.items() if isinstance(value, str) and len(value) > 64}
    assert held == set(RECORDS)
    assert {name for name, value in TAGS.items() if isinstance(value, list)} == {"heartbeats", "samples"}


def parts(record: str) -> tuple[bytes, int, bytes]:
    """Body without its code, sequence and code of a whole record: 12 bytes of envelope before it, a CRC-32 behind."""
    data = bytes.fromhex(record)
    return data[12:-20], int.from_bytes(data[8:12], "little"), data[-20:-4]
