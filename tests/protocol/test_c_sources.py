"""C sources generated from the DBC pack and unpack the same bytes as protocol.frames, for every frame."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cantools.database.can import Message
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cutgate.protocol.frames import DATABASE, IDS, Frame, FrameError, decode_frame, encode_frame, message_of
from cutgate.protocol.states import RuntimeCode

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[2]
TAG = 0xC0FFEE
MESSAGES = {message.name: message for message in DATABASE.messages}
KINDS = {kind.__name__: kind for kind in IDS}


def c_name(name: str) -> str:
    """The name of a message in the generated sources: RuntimeStop is runtime_stop."""
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("_")


def case(message: Message) -> str:
    """C that reads the signals of one message, packs them, unpacks the bytes, and prints both."""
    names = [signal.name for signal in message.signals]
    name = f"cutgate_{c_name(message.name)}"
    reads = "\n".join(f"        in.{signal} = next();" for signal in names)
    prints = "\n".join(f'        printf(" %lld", (long long)out.{signal});' for signal in names)
    return f"""
    if (strcmp(word, "{message.name}") == 0) {{
        struct {name}_t in, out;
        memset(&out, 0xA5, sizeof out);
        {name}_init(&in);
{reads}
        if ({name}_pack(bytes, &in, sizeof bytes) != 8) return 2;
        if ({name}_unpack(&out, bytes, sizeof bytes) != 0) return 3;
        for (int i = 0; i < 8; i++) printf("%02x", bytes[i]);
{prints}
        printf("\\n");
    }}"""


def program() -> str:
    """Reads lines of a message's name and its raw signals; writes its bytes and the signals read from them."""
    return f"""
#include <stdio.h>
#include <string.h>
#include "cutgate.h"
static long long next(void) {{
    long long value = 0;
    if (scanf("%lld", &value) != 1) return 0;
    return value;
}}
int main(void) {{
    char word[64];
    uint8_t bytes[8];
    while (scanf("%63s", word) == 1) {{{"".join(case(message) for message in DATABASE.messages)}
    }}
    return 0;
}}
"""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """As `make c-sources OUT=...` writes them."""
    directory = tmp_path_factory.mktemp("c")
    ready, tools = (
        ".venv/ready",
        Path(sys.executable).parent,
    )  # the packages this test runs with, never made anew
    command = ["make", f"--assume-old={ready}", f"BIN={tools}", "c-sources", f"OUT={directory}"]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    assert {path.name for path in directory.iterdir()} == {"cutgate.c", "cutgate.h"}
    return directory


@pytest.fixture(scope="module")
def through_c(sources):
    """Many frames' raw signals through the compiled program: their bytes, and the signals of those bytes."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler named cc on this machine")
    (sources / "main.c").write_text(program())
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
    built = sources / "pack"
    files = [str(sources / "cutgate.c"), str(sources / "main.c")]
    command = [compiler, *strict, *files, "-o", str(built), "-lm"]
    made = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert made.returncode == 0, made.stderr

    def run(lines: list[tuple[str, list[int]]]) -> list[tuple[bytes, list[int]]]:
        text = "".join(f"{name} {' '.join(map(str, values))}\n" for name, values in lines)
        done = subprocess.run(
            [str(built)], input=text, capture_output=True, text=True, check=True, timeout=60
        )
        answers = [line.split() for line in done.stdout.splitlines()]
        return [(bytes.fromhex(head), [int(value) for value in rest]) for head, *rest in answers]

    return run


def raw(message: Message, data: bytes) -> list[int]:
    """The raw signals of eight bytes, by cantools' Python."""
    values = message.decode(data, decode_choices=False, scaling=False)
    return [int(values[signal.name]) for signal in message.signals]


@given(st.data())
@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
def test_any_eight_bytes_are_the_same_signals_in_c(through_c, data):
    """CRC, counter and reserved bits are signals as every other."""
    contents = st.lists(st.binary(min_size=8, max_size=8), min_size=10, max_size=20)
    chosen = [(name, content) for name in MESSAGES for content in data.draw(contents)]
    lines = [(name, raw(MESSAGES[name], content)) for name, content in chosen]
    for (name, content), (packed, signals) in zip(chosen, through_c(lines), strict=True):
        assert packed == content, name
        assert signals == raw(MESSAGES[name], content), name


def frames(kind: type[Frame]) -> st.SearchStrategy[Frame]:
    """Any frame of a kind that may be sent."""
    fields = {}
    for signal in message_of(kind).signals:
        if signal.name in {"crc", "counter", "reserved"}:
            continue
        holds = kind.__dataclass_fields__[signal.name].type
        half = 1 << signal.length - 1
        low, high = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
        if holds is int:
            fields[signal.name] = st.integers(low, high) | st.sampled_from([low, high, 0])
        elif holds is bool:
            fields[signal.name] = st.booleans()
        else:
            fields[signal.name] = st.sampled_from(list(holds))
    return st.builds(kind, **fields)


@given(st.data())
@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
def test_frames_that_are_sent_are_packed_alike(through_c, data):
    """What protocol.frames sends is what C packs from the same fields; what C packs decodes to the same frame."""
    sent, lines = [], []
    for kind in KINDS.values():
        for frame in data.draw(st.lists(frames(kind), min_size=5, max_size=10)):
            _, content = encode_frame(frame, data.draw(st.integers(0, 255)), TAG)
            values = {signal.name: int(getattr(frame, signal.name, 0)) for signal in message_of(kind).signals}
            values |= {"crc": int.from_bytes(content[:2], "little"), "counter": content[2]}
            sent.append((frame, content))
            lines.append((kind.__name__, list(values.values())))
    for (frame, content), (packed, _) in zip(sent, through_c(lines), strict=True):
        assert packed == content
        assert decode_frame(IDS[type(frame)], packed) == frame


def test_every_message_of_the_dbc_is_covered(through_c):
    assert set(KINDS) == set(MESSAGES)
    answers = through_c([(name, [0] * len(message.signals)) for name, message in MESSAGES.items()])
    assert [packed for packed, _ in answers] == [bytes(8)] * len(MESSAGES)


def test_c_packs_what_the_runtime_would_never_send(through_c):
    """The generated code checks no codes: a controller must, as protocol.frames does."""
    unlisted = 7
    assert unlisted not in set(RuntimeCode)
    message = MESSAGES["RuntimeHeartbeat"]
    values = [unlisted if signal.name == "code" else 0 for signal in message.signals]
    [(packed, signals)] = through_c([(message.name, values)])
    assert signals == values
    with pytest.raises(FrameError, match="code"):
        decode_frame(message.frame_id, packed)
