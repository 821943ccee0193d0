"""``cutgate audit export``: what is written is what the log holds, wherever it goes, and never over anything."""

import csv
import json
import os
import shutil
import stat
import subprocess
import time
import tracemalloc
from io import BytesIO
from pathlib import Path

import can
import pytest

from cutgate.config.interpreter import program
from cutgate.protocol.candump import RawFrame
from cutgate.runtime.audit import records
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.writer import LogWriter
from cutgate.runtime.commands import sinks
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.foxglove.lichtblick import layout_bytes
from cutgate.runtime.review.recorded_frames import SessionFrames
from tests.runtime.audit.build import LOG_ID, MODELS, forge, session_log, small_log
from tests.runtime.audit.test_replay import changed

SESSIONS = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"
(CUT,) = SESSIONS.glob("*-eea20e88.mcap")
RAW = CUT.with_suffix(".candump.log").read_bytes()
MICROSECOND = 1.5e-6
"""What is written to a microsecond, of a time that a double holds to a quarter of one."""


@pytest.fixture
def export(capfdbinary):
    """Runs the command; exit code, standard output as bytes, standard error."""

    def call(*arguments):
        code = execute(["audit", "export", *map(str, arguments)])
        found = capfdbinary.readouterr()
        return code, found.out, found.err.decode()

    return call


@pytest.fixture
def strange(tmp_path):
    """A log whose own frames are of every kind, without raw frames."""
    every = [
        {"id": 0x123, "data": "0011"}, {"id": 0x1ABCDEF0, "is_extended": True, "data": "ff" * 8}, {"id": 0x7FF, "data": ""},
        {"id": 0x120, "is_rtr": True, "data": ""}, {"id": 0x640, "data": "ab" * 64, "direction": "sent"},
        {"id": 4, "is_error": True, "data": "00" * 8}, {"id": 0x124, "data": "aa", "early": True},
    ]  # fmt: skip
    queue = [
        records.CanFrame(
            stamp=records.Time(sec=1_790_000_000 - (100 if one.pop("early", False) else 0), nsec=123_456_789 + number * 1_000),
            direction=one.pop("direction", "received"),
            dlc=len(one["data"]) // 2,
            **one,
        )
        for number, one in enumerate(every)
    ]  # fmt: skip

    def swap(record):
        return queue.pop(0) if isinstance(record, records.AuditOperator) and queue else record

    log = tmp_path / "strange.mcap"
    log.write_bytes(forge(small_log(tmp_path / "small", decisions=len(every)).log.read_bytes(), swap))
    return log


def expected(log):
    raw = log.with_suffix(".candump.log")
    frames = SessionFrames(read_log(log.read_bytes()), BytesIO(raw.read_bytes()) if raw.is_file() else None)
    return list(frames.each())


def records_of(log):
    return read_log(log.read_bytes())


# ---------------------------------------------------------------- frames


def kept(message: can.Message, *, form: str) -> tuple:
    """What a form keeps of a frame."""
    if message.is_error_frame and form == "asc":
        return ("error",)
    data = b"" if message.is_remote_frame else bytes(message.data)
    return (
        message.arbitration_id, message.is_extended_id, message.is_remote_frame, message.is_error_frame, message.is_fd,
        data, message.is_rx or message.is_error_frame,
    )  # fmt: skip


def as_kept(way: str, frame: RawFrame, *, form: str) -> tuple:
    if frame.is_error and form == "asc":
        return ("error",)
    return (
        frame.can_id, frame.is_extended, frame.is_remote, frame.is_error, frame.is_fd, frame.data,
        way == "received" or frame.is_error,
    )  # fmt: skip


@pytest.mark.parametrize("zone", ["UTC", "Pacific/Chatham", "America/New_York"])
@pytest.mark.parametrize("which", ["cut", "strange"])
@pytest.mark.parametrize("form", ["blf", "asc"])
def test_frames_are_read_back_by_python_can(export, strange, tmp_path, monkeypatch, form, which, zone):
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    log = CUT if which == "cut" else strange
    out = tmp_path / f"x.{form}"
    assert export(log, "--to", form, "-o", out)[0] == 0
    readers = {"blf": can.BLFReader, "asc": lambda file: can.ASCReader(file, relative_timestamp=False)}
    read = list(readers[form](str(out)))
    wanted = expected(log)
    assert len(read) == len(wanted) > 0
    assert [kept(one, form=form) for one in read] == [as_kept(*one, form=form) for one in wanted]
    for message, (_, frame) in zip(read, wanted, strict=True):
        assert message.timestamp == pytest.approx(frame.time_ns / 1e9, abs=MICROSECOND)
    monkeypatch.undo()
    time.tzset()


def test_candump_of_a_sound_log_is_its_raw_frames_byte_for_byte(export, tmp_path):
    code, out, err = export(CUT, "--to", "candump")
    assert (code, out) == (0, RAW)
    assert "the raw frames beside the log, whose SHA-256 its close record names" in err
    assert f"{RAW.count(10)} frames" in err


def test_candump_without_the_right_raw_frames_is_of_the_logs_own_and_says_so(export, tmp_path):
    log = tmp_path / CUT.name
    shutil.copy(CUT, log)
    code, alone, err = export(log, "--to", "candump")
    assert code == 0
    assert "INCOMPLETE" in err
    assert "single frames of the log itself" in err
    assert alone.decode() == "".join(frame.line for _, frame in expected(log))
    log.with_suffix(".candump.log").write_bytes(RAW + b"(1.0) can0 123#\n")
    code, other, err = export(log, "--to", "candump")
    assert (code, other) == (0, alone)
    assert "TAMPERED" in err
    assert "not those that its close record names" in err


def test_a_log_without_frames_gives_files_without_frames(export, tmp_path):
    log = session_log(tmp_path / "one").log
    for form, reader in (("blf", can.BLFReader), ("asc", can.ASCReader), ("candump", can.CanutilsLogReader)):
        out = tmp_path / f"x.{form}"
        assert export(log, "--to", form, "-o", out)[0] == 0
        assert list(reader(str(out))) == []


# ---------------------------------------------------------------- records


def test_jsonl_has_each_record_of_the_log(export):
    code, out, err = export(CUT, "--to", "jsonl")
    found = [json.loads(line) for line in out.decode("ascii").splitlines()]
    log = records_of(CUT)
    assert code == 0
    assert [one["sequence"] for one in found] == list(range(log.report.messages))
    for topic in {one["topic"] for one in found}:
        assert [one["data"] for one in found if one["topic"] == topic] == log.of(topic)
    assert err.splitlines()[-1] == f"{len(found)} records"
    assert "INCOMPLETE" in err.splitlines()[0], "a log of 0.1.0, which nobody signed"


def test_topics_are_chosen(export):
    code, out, _ = export(CUT, "--to", "jsonl", "--topic", "/audit/open", "--topic", "/audit/close")
    assert code == 0
    assert [json.loads(line)["topic"] for line in out.splitlines()] == ["/audit/open", "/audit/close"]


def test_csv_is_a_table_for_each_topic_in_a_new_folder(export, tmp_path):
    code, out, err = export(CUT, "--to", "csv", "-o", tmp_path / "tables")
    assert (code, out) == (0, b"")
    log = records_of(CUT)
    topics = {"/can/frame", *(topic for topic, _, _ in log.places)}
    written = {path.name: path for path in (tmp_path / "tables").iterdir()}
    assert set(written) == {topic.strip("/").replace("/", "-") + ".csv" for topic in topics}
    assert f"{len(topics)} tables" in err
    text = written["audit-controller.csv"].read_text(encoding="utf-8")
    (header, *rows) = csv.reader(text.splitlines())
    for row, record in zip(rows, log.of("/audit/controller"), strict=True):
        named = dict(zip(header, row, strict=True))
        assert named["state"] == record["state"]
        assert int(named["epoch"]) == record["epoch"]
        assert named["fresh"] == str(record["fresh"]).lower()
        assert named["utc"] == f"{record['utc']['sec']}.{record['utc']['nsec']:09d}"
    assert {stat.S_IMODE(path.stat().st_mode) for path in written.values()} == {0o600}
    assert stat.S_IMODE((tmp_path / "tables").stat().st_mode) == 0o700


@pytest.mark.parametrize("to_a_file", [True, False])
def test_csv_of_one_topic_is_one_table(export, tmp_path, to_a_file):
    file = tmp_path / "x.csv"
    where = ["-o", file] if to_a_file else []
    code, out, _ = export(CUT, "--to", "csv", "--topic", "/audit/verdict", *where)
    assert code == 0
    text = (file.read_bytes() if to_a_file else out).decode()
    assert text.startswith("log_sequence,log_time_s,publish_time_s,prev,")
    assert text.count("\n") == 2


def test_a_records_text_is_no_formula_in_a_table(export, tmp_path):
    log = tmp_path / "x.mcap"
    made = session_log(tmp_path / "one").log.read_bytes()
    log.write_bytes(forge(made, changed(records.AuditOpen, operator='=HYPERLINK("http://x")')))
    out = export(log, "--to", "csv", "--topic", "/audit/open")[1].decode()
    header, row = csv.reader(out.splitlines())
    assert row[header.index("operator")] == '\'=HYPERLINK("http://x")'


class UnknownRecord(records.AuditRecord):
    """A record of a later version."""

    TOPIC = "/audit/checkpoint"

    note: str = "=1"
    sizes: tuple[int, ...] = (1, 2)


def test_any_record_is_taken_as_it_is_whatever_its_topic(export, tmp_path):
    log = tmp_path / "x.mcap"
    log.write_bytes(many(small_log(tmp_path / "small").log.read_bytes(), UnknownRecord(), 2))
    last = json.loads(export(log, "--to", "jsonl")[1].splitlines()[-1])
    assert (last["topic"], last["data"]["note"], last["data"]["sizes"]) == ("/audit/checkpoint", "=1", [1, 2])
    header, *rows = csv.reader(
        export(log, "--to", "csv", "--topic", "/audit/checkpoint")[1].decode().splitlines()
    )
    assert [row[header.index("note")] for row in rows] == ["'=1", "'=1"]
    assert [row[header.index("sizes")] for row in rows] == ["[1,2]", "[1,2]"]
    assert export(log, "--to", "csv", "-o", tmp_path / "tables")[0] == 0
    assert (tmp_path / "tables" / "audit-checkpoint.csv").is_file()


# ---------------------------------------------------------------- what does not go


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--to", "blf"], "must be a file: BLF is not text"),
        (["--to", "blf", "-o", "-"], "must be a file: BLF is not text"),
        (["--to", "csv"], "must be a folder"),
        (["--to", "csv", "--topic", "/audit/open", "--topic", "/audit/close"], "must be a folder"),
        (["--to", "candump", "--topic", "/audit/open"], "frames have no topics"),
        (["--to", "asc", "--topic", "/can/frame"], "frames have no topics"),
        (["--to", "jsonl", "--topic", "/audit/opened"], "must be one of /audit/approach, "),
        (["--to", "foxglove"], "must be a file: MCAP is not text"),
        (["--to", "foxglove", "-o", "-"], "name one with -o FILE.mcap"),
        (["--to", "foxglove", "-o", "x", "--topic", "/log"], "it has topics of its own; leave it out"),
        (["--to", "jsonl", "--layout", "x"], "must be of --to foxglove; leave it out"),
        (["--to", "rosbag"], "foxglove"),
        ([], "--to"),
    ],
)
def test_what_does_not_go_together_is_refused(export, arguments, told):
    code, out, err = export(CUT, *arguments)
    assert (code, out) == (2, b"")
    assert told in " ".join(err.split())


@pytest.mark.parametrize("form", ["jsonl", "csv", "candump", "blf", "asc", "foxglove"])
@pytest.mark.parametrize("kind", ["file", "folder", "link", "the log"])
def test_nothing_is_ever_overwritten(export, tmp_path, form, kind):
    log = tmp_path / CUT.name
    shutil.copy(CUT, log)
    out = tmp_path / "out"
    if kind == "file":
        out.write_bytes(b"mine")
    elif kind == "folder":
        out.mkdir()
    elif kind == "link":
        out.symlink_to(tmp_path / "nowhere")
    else:
        out = log
    code, _, err = export(log, "--to", form, "-o", out)
    assert code == 2
    assert "exists already; name another, or remove it first" in err
    assert log.read_bytes() == CUT.read_bytes()
    assert kind != "file" or out.read_bytes() == b"mine"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("form", ["jsonl", "csv", "candump", "blf", "asc", "foxglove"])
@pytest.mark.parametrize("log", ["absent.mcap", "pyproject.toml", "key"])
def test_what_is_no_log_is_refused_and_leaves_nothing(export, tmp_path, form, log):
    key = tmp_path / "key"
    key.write_text("00" * 32 + "\n")
    key.chmod(0o600)
    code, _, err = export(key if log == "key" else log, "--to", form, "-o", tmp_path / "out")
    assert code == 2
    assert "00000000" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["key"]


@pytest.mark.parametrize("form", ["jsonl", "csv", "candump", "blf", "asc", "foxglove"])
def test_what_cannot_be_written_leaves_nothing(export, tmp_path, monkeypatch, form):
    class Full(sinks.Sink):
        def write(self, data):
            raise sinks.UnwrittenError(OSError(28, os.strerror(28)))

    monkeypatch.setattr(sinks, "Sink", Full)
    code, _, err = export(CUT, "--to", form, "-o", tmp_path / "out")
    assert code == 2
    assert "cannot be written (No space left on device)" in err
    assert list(tmp_path.iterdir()) == []


def test_a_layout_is_written_beside_it_and_never_over_anything(export, tmp_path):
    out, layout = tmp_path / "x.mcap", tmp_path / "layout.json"
    code, _, err = export(CUT, "--to", "foxglove", "-o", out, "--layout", layout)
    assert code == 0
    assert layout.read_bytes() == layout_bytes()
    assert f"layout to {layout}" in " ".join(err.split())
    out.unlink()
    layout.write_bytes(b"mine")
    code, _, err = export(CUT, "--to", "foxglove", "-o", out, "--layout", layout)
    assert code == 2
    assert f"{layout}: --layout: exists already; name another, or remove it first" in " ".join(err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["layout.json"]
    assert layout.read_bytes() == b"mine"


def test_a_layout_in_the_place_of_the_file_is_refused(export, tmp_path):
    out = tmp_path / "x.mcap"
    code, _, err = export(CUT, "--to", "foxglove", "-o", out, "--layout", out)
    assert code == 2
    assert "exists already" in err
    assert list(tmp_path.iterdir()) == []


def test_where_there_is_no_folder_nothing_is_written(export, tmp_path):
    code, _, err = export(CUT, "--to", "jsonl", "-o", tmp_path / "a" / "b")
    assert code == 2
    assert "cannot be written (No such file or directory)" in err


def test_a_table_of_columns_without_end_is_refused(export, tmp_path, monkeypatch):
    monkeypatch.setattr("cutgate.runtime.commands.audit_export.COLUMNS_MAX", 5)
    code, _, err = export(CUT, "--to", "csv", "-o", tmp_path / "out")
    assert code == 2
    assert "must be <= 5 columns of one topic; export it to jsonl" in err
    assert not (tmp_path / "out").exists()
    monkeypatch.undo()
    monkeypatch.setattr("cutgate.runtime.commands.audit_export.TABLES_MAX", 5)
    code, _, err = export(CUT, "--to", "csv", "-o", tmp_path / "out")
    assert code == 2
    assert "must be <= 5; name some with --topic" in err


@pytest.mark.parametrize(
    ("edit", "status"), [(lambda data: data[:-100], "INCOMPLETE"), (lambda data: data.replace(b"sim-0.1", b"sim-0.2"), "TAMPERED")]
)  # fmt: skip
def test_a_log_that_does_not_verify_is_exported_and_that_is_said(export, tmp_path, edit, status):
    log = tmp_path / CUT.name
    log.write_bytes(edit(CUT.read_bytes()))
    shutil.copy(CUT.with_suffix(".candump.log"), tmp_path)
    code, out, err = export(log, "--to", "jsonl")
    assert code == 0
    assert f"{status}: " in err
    assert len(out.splitlines()) == records_of(log).report.messages


# ---------------------------------------------------------------- where it goes


@pytest.mark.processes
@pytest.mark.parametrize("form", ["jsonl", "candump", "asc"])
def test_a_reader_that_goes_away_ends_it_with_141(form):
    reading, writing = os.pipe()
    os.close(reading)
    command = [*program("cutgate.runtime.cli"), "audit", "export", str(CUT), "--to", form]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, text=True)
    os.close(writing)
    assert (done.returncode, "Traceback" in done.stderr) == (141, False)


@pytest.mark.processes
def test_a_full_disk_behind_standard_output_is_74_and_no_code_of_a_verdict():
    command = [*program("cutgate.runtime.cli"), "audit", "export", str(CUT), "--to", "candump"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False, text=True)
    assert done.returncode == 74
    assert "what was to be written is not whole" in done.stderr


def test_what_a_log_says_reaches_no_terminal_as_control_characters(export, tmp_path, monkeypatch):
    log = tmp_path / "x.mcap"
    made = session_log(tmp_path / "one").log.read_bytes()
    log.write_bytes(forge(made, changed(records.AuditOpen, operator="\x1b[2J\u202e\nx")))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    for form in (["--to", "jsonl"], ["--to", "csv", "--topic", "/audit/open"]):
        out = export(log, *form)[1].decode()
        assert [c for c in out if not (c.isprintable() or c == "\n")] == []


@pytest.mark.no_cover
@pytest.mark.parametrize("form", ["jsonl", "foxglove"])
def test_memory_does_not_grow_with_the_log(tmp_path, export, form):
    """A log of 1000 frames, and one of four times as many."""
    peaks = []
    for times in (1, 4):
        frame = records.CanFrame(
            stamp=records.Time(sec=1, nsec=2), direction="sent", id=1, dlc=8, data="00" * 8
        )
        log = tmp_path / f"{times}.mcap"
        log.write_bytes(
            many(small_log(tmp_path / str(times), decisions=2).log.read_bytes(), frame, 1000 * times)
        )
        tracemalloc.start()
        assert export(log, "--to", form, "-o", tmp_path / f"{times}.{form}")[0] == 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + (1 << 20)


def many(data, record, times):
    """The log with one frame many times, in chunks as a session makes them."""
    old = scan(data)
    writer = LogWriter(LOG_ID, {"software": "x"})
    first = old.messages[0]
    writer.add(
        MODELS[first.topic].model_validate_json(first.data), log_time_ns=first.log_time, monotonic_ns=1
    )
    for number in range(times):
        writer.add(record, log_time_ns=number, monotonic_ns=number)
        if number % 500 == 499:
            writer.close_chunk()
    writer.finish()
    return writer.take()


def test_nothing_of_a_session_but_its_records_and_frames_is_exported(export, tmp_path):
    """A key beside the log, and in a file of its name, is not looked at."""
    log = tmp_path / CUT.name
    shutil.copy(CUT, log)
    shutil.copy(CUT.with_suffix(".candump.log"), tmp_path)
    (tmp_path / "log.key").write_text("5ec7e7" * 10)
    (tmp_path / "log.key").chmod(0)
    for form in ("jsonl", "candump", "asc"):
        code, out, _ = export(log, "--to", form)
        assert code == 0
        assert b"5ec7e7" * 10 not in out
