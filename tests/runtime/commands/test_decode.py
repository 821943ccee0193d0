"""``cutgate decode``: of a log and of recorded frames, as people write them; refused with the line, or passed over."""

import json
import os
import shutil
import subprocess
import tracemalloc
from pathlib import Path

import pytest

from cutgate.config.interpreter import program
from cutgate.protocol import candump
from cutgate.protocol.frames import RuntimeHeartbeat, encode_frame
from cutgate.protocol.records import Collect, Limits
from cutgate.protocol.states import RuntimeCode
from cutgate.runtime.audit import records
from cutgate.runtime.commands.app import execute
from tests.runtime.audit.build import forge
from tests.runtime.review.test_decoding import ANSWER, BEAT, OPENING, said, segments, single

SESSIONS = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"
(CUT,) = SESSIONS.glob("*-eea20e88.mcap")
LIMITS = Limits((-80_000_000, 0, 0, 0, 0), (1,) * 5, (1,) * 5)
FRAMES = said(
    [*OPENING, single(BEAT, 0), single(ANSWER, 0), *segments(Collect()), *segments(LIMITS), single(BEAT, 1)],
    "vcan0",
)
LINES = [frame.line for frame in FRAMES]
SHOWN = ["Open", "RuntimeHeartbeat", "ControllerHeartbeat", "Collect", "Limits", "RuntimeHeartbeat"]


@pytest.fixture
def decode(capfdbinary):
    def call(*arguments):
        code = execute(["decode", *map(str, arguments)])
        found = capfdbinary.readouterr()
        return code, found.out.decode(), found.err.decode()

    return call


@pytest.fixture
def file(tmp_path):
    def make(data, name="bus.log"):
        path = tmp_path / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return path

    return make


def shown(out):
    """The messages of the text lines."""
    first, *rest = out.splitlines()
    assert first.startswith("# seconds since ")
    return [line.split()[3] for line in rest]


# ---------------------------------------------------------------- what is shown


def test_a_line_for_each_message_with_time_sender_and_fields(decode, file):
    code, out, err = decode(file("".join(LINES)))
    assert code == 0
    assert shown(out) == SHOWN
    line = next(line for line in out.splitlines() if "ControllerHeartbeat" in line)
    assert line.split()[:4] == [
        f"{(len(OPENING) + 1) / 1000:.6f}",
        "081",
        "controller",
        "ControllerHeartbeat",
    ]
    assert "state OPEN" in line
    assert "q_min.q0 -80 deg" in out
    assert out.startswith("# seconds since 1970-01-01 00:00:00.000000 UTC\n")
    assert f"6 lines; {len(LINES)} frames, 6 messages, 3 records of {len(LINES) - 3} segments" in err


def test_json_is_an_object_a_line(decode, file):
    code, out, _ = decode(file("".join(LINES)), "--json")
    found = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert [one["message"] for one in found] == SHOWN
    limits = found[4]
    assert (limits["schema"], limits["id"], limits["sender"]) == ("cutgate.decode/1", "0x641", "controller")
    assert limits["fields"]["q_min.q0_deg"] == -80.0
    assert limits["segments"] == len(segments(LIMITS))
    last = FRAMES[-2].time_ns
    assert limits["time"] == {"sec": last // 10**9, "nsec": last % 10**9}


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["--id", "080"], ["RuntimeHeartbeat"] * 2),
        (["--id", "0x81", "--id", "641"], ["ControllerHeartbeat", "Limits"]),
        (["--message", "Limits"], ["Limits"]),
        (["--message", "limits", "--message", "Open"], ["Open", "Limits"]),
        (["--message", "Limits", "--id", "080"], []),
        (["--id", "123"], []),
    ],
)
def test_identifiers_and_messages_are_chosen(decode, file, arguments, names):
    assert shown(decode(file("".join(LINES)), *arguments)[1]) == names


def test_a_lost_record_is_shown_where_it_may_have_been_the_one(decode, file):
    lost = [*LINES[: len(OPENING) - 1], *LINES[len(OPENING) :]]
    path = file("".join(lost))
    assert "[record lost: another one begins" in decode(path, "--message", "Permit")[1]
    assert "lost" not in decode(path, "--message", "Limits")[1]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--id", "xyz"], "must be a hexadecimal number"), (["--id", ""], "must be a hexadecimal number"),
        (["--id", "20000000"], "up to 1FFFFFFF"), (["--id", "1" * 5000], "must be a hexadecimal number"),
        (["--message", "Permits"], "must be one of Acknowledge, Announce, "),
    ],
)  # fmt: skip
def test_what_is_asked_for_wrongly_is_refused(decode, file, arguments, told):
    code, out, err = decode(file("".join(LINES)), *arguments)
    assert (code, out) == (2, "")
    assert told in err


# ---------------------------------------------------------------- files as people write them


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "  \n"),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: text.replace("\n", " R\n"),
        lambda text: text.replace(") vcan0 ", ")  vcan0  "),
        lambda text: text.lower(),
        lambda text: text.rstrip("\n"),
    ],
    ids=["CRLF", "BOM", "blanks", "blank lines", "direction", "wide", "lower case", "no end"],
)
def test_files_as_programs_and_editors_leave_them(decode, file, edit):
    code, out, err = decode(file(edit("".join(LINES))))
    assert code == 0
    assert shown(out) == SHOWN
    assert ("the last one, has no end: it may be cut off" in err) == (edit("\n") == "")


def test_a_last_line_that_is_cut_off_is_passed_over_and_told(decode, file):
    code, out, err = decode(file("".join(LINES)[:-2]))
    assert code == 0
    assert shown(out) == SHOWN[:-1]
    assert f"line {len(LINES)}, the last one, is cut off and was passed over" in err
    code, out, err = decode(file("".join(LINES) + "(1.0) vca"))
    assert (code, shown(out)) == (0, SHOWN)
    assert f"line {len(LINES) + 1}, the last one, is cut off and was passed over" in err


BAD = [b"hello\n", b"  vcan0  080   [8]  00 11\n", b"\xfe\xfd\n", b"(1.0) can0 800#\n", b"x" * 5000 + b"\n", b"\x00" * 100 + b"\n", b"(1.0) a\x1b[2J 1#\n"]  # fmt: skip


@pytest.mark.parametrize("bad", BAD, ids=range(len(BAD)))
@pytest.mark.parametrize("place", [0, 3, len(LINES)])
def test_a_line_that_is_none_is_refused_with_its_number_before_anything_is_shown(decode, file, bad, place):
    data = "".join(LINES[:place]).encode() + bad + "".join(LINES[place:]).encode()
    code, out, err = decode(file(data))
    assert (code, out) == (2, "")
    assert f"line {place + 1} is " in err
    assert "--lenient" in err
    assert [c for c in err if not (c.isprintable() or c == "\n")] == []
    code, out, err = decode(file(data), "--lenient")
    assert (code, shown(out)) == (0, SHOWN)
    assert f"lines passed over, which are no frames: 1; the first is line {place + 1}\n" in err


def test_a_file_in_utf_16_is_refused_with_what_to_do(decode, file):
    code, _, err = decode(file("".join(LINES).encode("utf-16")), "--lenient")
    assert code == 2
    assert "is UTF-16, must be ASCII or UTF-8; save it as UTF-8" in err


def test_several_interfaces_are_told_apart_and_bounded(decode, file):
    other = [line.replace("vcan0", "can7") for line in LINES]
    code, out, _ = decode(file("".join(line for pair in zip(LINES, other, strict=True) for line in pair)))
    assert code == 0
    assert [line.split()[1] for line in out.splitlines()[1:]] == ["vcan0", "can7"] * len(SHOWN)
    many = "".join(candump.line(0, f"can{number}", 1, b"") for number in range(65))
    code, _, err = decode(file(many))
    assert code == 2
    assert "line 65" in err
    assert "must be <= 64 interfaces" in err


def test_strange_frames_are_told_as_unknown(decode, file):
    strange = [
        candump.line(0, "vcan0", 0x123, b"\1"),
        candump.line(0, "vcan0", 4, bytes(8), is_error=True),
        candump.line(0, "vcan0", 0x1ABCDEF0, bytes(64), is_extended=True, is_fd=True),
        candump.line(0, "vcan0", 0x120, b"", is_remote=True),
    ]
    _, out, err = decode(file("".join(strange)))
    assert [line.split()[2] for line in out.splitlines()[1:]] == ["unknown"] * 4
    assert "1ABCDEF0" in out
    assert "class 0x4" in out
    assert "4 unknown" in err


def test_an_empty_file_has_no_messages(decode, file):
    code, out, err = decode(file(b""))
    assert (code, out) == (0, "")
    assert "0 lines; 0 frames" in err


@pytest.mark.parametrize("name", ["absent.log", "."])
def test_what_cannot_be_read_is_refused(decode, name):
    code, out, err = decode(name)
    assert (code, out) == (2, "")
    assert name in err


@pytest.mark.no_cover
def test_memory_is_bounded_whatever_the_file(decode, file):
    """Also by a line without end, and by a record that never ends."""
    peaks = []
    for times in (1, 4):
        path = file("".join(LINES) * 8 * times + "x" * 100_000 * times + "\n" + LINES[0] * 50 * times)
        tracemalloc.start()
        assert decode(path, "--id", "123", "--lenient")[0] == 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + (100 << 10)


# ---------------------------------------------------------------- a log


def test_of_a_log_the_raw_frames_beside_it_are_told(decode, tmp_path):
    code, out, err = decode(CUT)
    assert code == 0
    assert "of the raw frames beside the log, whose SHA-256 its close record names" in err
    assert {"ControllerHeartbeat", "PathBlock", "Limits", "BlockStored"} <= set(shown(out))
    alone = decode(shutil.copy(CUT.with_suffix(".candump.log"), tmp_path))[1]
    assert shown(alone) == shown(out)


def test_of_a_log_without_them_its_own_frames_and_the_names_of_its_transfers(decode, tmp_path):
    shutil.copy(CUT, tmp_path)
    code, out, err = decode(tmp_path / CUT.name)
    assert code == 0
    assert "INCOMPLETE" in err
    assert "of the single frames of the log itself" in err
    line = next(line for line in out.splitlines() if " Permit " in line)
    assert "600  runtime     Permit" in line
    assert "its fields are in the raw frames alone" in line
    times = [float(line.split()[0]) for line in out.splitlines()[1:]]
    assert times == sorted(times)


def test_somebody_who_speaks_in_the_name_of_a_side_is_told(decode, tmp_path):
    can_id, data = encode_frame(RuntimeHeartbeat(RuntimeCode.CUT, epoch=0), 3, 0)

    def swap(record):
        if isinstance(record, records.CanFrame) and record.id == 0x081 and not swap.done:
            swap.done = True
            return record.model_copy(update={"id": can_id, "data": data.hex()})
        return record

    swap.done = False
    log = tmp_path / "x.mcap"
    log.write_bytes(forge(CUT.read_bytes(), swap))
    out = decode(log)[1]
    assert "[received by the runtime of this log: somebody else speaks in the name of the runtime" in out


def test_another_mcap_file_is_refused(decode, tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(CUT.read_bytes().replace(b"cutgate", b"gutcate"))
    code, out, err = decode(path)
    assert (code, out) == (2, "")
    assert "name a session's .mcap file, or raw frames" in err


def test_a_transfer_without_a_time_has_that_of_what_came_before_it(decode, tmp_path):
    shutil.copy(CUT, tmp_path)
    path = tmp_path / CUT.name
    path.write_bytes(
        forge(
            CUT.read_bytes(),
            lambda record: (
                record.model_copy(update={"stamp": records.Time(sec=-5, nsec=0)})
                if isinstance(record, records.CanTransfer)
                else record
            ),
        )
    )
    code, out, _ = decode(path)
    assert code == 0
    times = [float(line.split()[0]) for line in out.splitlines()[2:]]
    assert times == sorted(times)


# ---------------------------------------------------------------- readers


@pytest.mark.processes
def test_a_reader_that_goes_away_ends_it_with_141():
    reading, writing = os.pipe()
    os.close(reading)
    command = [*program("cutgate.runtime.cli"), "decode", str(CUT)]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, text=True)
    os.close(writing)
    assert (done.returncode, "Traceback" in done.stderr) == (141, False)
