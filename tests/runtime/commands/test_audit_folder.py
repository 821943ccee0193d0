"""``cutgate audit verify`` and ``list`` of folders: real logs, taken away, put back, copied, renamed and cut."""

import json
import os
import shutil
from fcntl import LOCK_EX, flock
from pathlib import Path

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit import folder as folders_module
from cutgate.runtime.audit import records
from cutgate.runtime.audit.directory import HEAD, LOCK
from cutgate.runtime.audit.log_keys import default_path, new_log_key, to_continue
from cutgate.runtime.audit.recomputed.authenticated import CodesFound
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.commands import audit_folder as commands_module
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.audit_folder import verify_folder
from tests.runtime.audit.build import forge
from tests.runtime.audit.folders import (
    folder_of,
    head,
    log_id,
    started_tree,
    witness_of,
    write_session,
)

OLD = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Five sessions; the second and the fourth started, each told of by the controller afterwards."""
    directory = tmp_path_factory.mktemp("made") / "logs"
    return directory, folder_of(directory, 5, started=(1, 3))


@pytest.fixture
def logs(made, tmp_path):
    """A copy of them, to be manipulated; and the names of the logs."""
    directory = tmp_path / "logs"
    shutil.copytree(made[0], directory)
    return directory, [path.name for path in made[1]]


def audit(capsys, *arguments):
    code = execute(["audit", *map(str, arguments)])
    found = capsys.readouterr()
    return code, found.out, found.err


def verify(capsys, directory, *options):
    """Exit code, and the codes of what was found."""
    code, out, _ = audit(capsys, "verify", directory, "--json", *options)
    document = json.loads(out)
    return code, {finding["code"] for finding in document["findings"]}


def remove(path):
    path.unlink()
    sidecar_of(path).unlink(missing_ok=True)
    path.with_suffix(".candump.log").unlink()


# ---------------------------------------------------------------- verify


def test_an_untouched_folder_is_ok_with_a_line_for_each_session_in_order(capsys, logs):
    directory, names = logs
    code, out, err = audit(capsys, "verify", directory)
    assert (code, err) == (0, "")
    *lines, last = out.splitlines()
    assert lines == [
        f"{names[0]}: OK, epoch 1, enrolled here",
        *(f"{name}: OK, epoch {epoch}, follows" for epoch, name in enumerate(names[1:], 2)),
    ]
    assert last.startswith(f"OK: {directory}: 5 sessions; key from the logs themselves (epoch 1: ")
    assert "witness: of 3 logs that a controller told of 3 found; anchor: not given" in last


def test_the_last_session_removed_and_head_left_names_the_lost_log(capsys, logs):
    directory, names = logs
    remove(directory / names[-1])
    code, out, _ = audit(capsys, "verify", directory)
    assert code == 2
    assert f"TAMPERED head-log-missing: HEAD: the last log is {names[-1]}, which is not here" in out


def begun(data):
    """What may be left of a session that is cut short before record 0 is whole."""
    first = data.index(b'"log_id"')  # the metadata's stands elsewhere
    yield from (b"", bytes(100), bytes(3_000_000))
    yield from (data[:at] for at in (*range(1, 10), *range(10, first, 97)))


def test_what_is_left_of_a_session_before_record_0_is_named_and_is_no_tampering(capsys, logs):
    """A crash at the very start leaves it, or somebody cut it: no folder with it is OK without a word."""
    directory, names = logs
    for left in begun((directory / names[0]).read_bytes()):
        (directory / "29991231T000000Z-00000000.mcap").write_bytes(left)
        assert verify(capsys, directory) == (1, {"before-record-0"}), len(left)
    _, out, _ = audit(capsys, "verify", directory)
    (line,) = (line for line in out.splitlines() if "before-record-0" in line)
    assert line.startswith("INCOMPLETE before-record-0: 29991231T000000Z-00000000.mcap: ")
    assert "cut before record 0 was whole: a crash at the very start of a session leaves that" in line
    assert "nothing, if power failed or the program ended as a session began" in out


@pytest.mark.parametrize("left", [b"", b"\x89MC", bytes(4096)])
def test_a_crash_before_the_first_byte_that_head_names_is_a_crash(capsys, logs, left):
    directory, names = logs
    told = json.loads((directory / HEAD).read_bytes()) | {
        "log": "29991231T000000Z-00000000.mcap",
        "state": "open",
    }
    (directory / HEAD).write_text(json.dumps(told))
    (directory / told["log"]).write_bytes(left)
    assert verify(capsys, directory) == (1, {"before-record-0", "crashed-last"})
    (directory / names[2]).write_bytes(left)
    code, codes = verify(capsys, directory)
    assert (code, "epoch-missing" in codes) == (2, True), "a session that was emptied is missed"


@pytest.mark.parametrize("left", [b"x", b"\x89MD", bytes(100) + b"x", b"\x00" * 7 + b"\x89MCAP0\r\n"])
def test_what_no_session_leaves_is_foreign(capsys, logs, left):
    directory, _ = logs
    (directory / "a.mcap").write_bytes(left)
    assert verify(capsys, directory) == (0, {"not-a-log"})


@pytest.mark.parametrize("at", range(4))
def test_whichever_session_is_removed_it_is_missed(capsys, logs, at):
    directory, names = logs
    remove(directory / names[at])
    code, codes = verify(capsys, directory)
    assert code != 0
    assert codes & {"epoch-missing", "begins-late"}


def test_an_old_state_put_back_after_a_session_leaves_a_gap(capsys, tmp_path):
    """HEAD and the folder's other small files from before it; its log is gone; one more session runs."""
    directory = tmp_path / "logs"
    folder_of(directory, 1)
    kept = (directory / HEAD).read_bytes()
    taken = write_session(directory, 1, start=True)
    tree = {1: started_tree(taken)}
    remove(taken)
    (directory / HEAD).write_bytes(kept)
    write_session(directory, 2, seen=witness_of(1, tree, found=False))
    code, out, _ = audit(capsys, "verify", directory)
    assert code == 2
    assert "TAMPERED epoch-missing" in out
    assert "the session of epoch 2 is not in this folder" in out
    assert f"INCOMPLETE witness-unknown: {directory.joinpath(head(directory)['log']).name}" in out


def test_with_the_key_put_back_as_well_the_controller_alone_misses_it(capsys, tmp_path):
    directory = tmp_path / "logs"
    folder_of(directory, 1)
    kept = {
        path: path.read_bytes()
        for path in (directory / HEAD, default_path(bytes.fromhex(head(directory)["series"])))
    }
    taken = write_session(directory, 1, start=True)
    tree = {1: started_tree(taken)}
    remove(taken)
    for path, data in kept.items():
        path.write_bytes(data)
    write_session(directory, 2, seen=witness_of(1, tree, found=False))
    assert verify(capsys, directory) == (1, {"witness-unknown"})


@pytest.mark.parametrize("crashed", range(4))
def test_a_crash_is_incomplete_and_the_next_session_follows_after_it(capsys, tmp_path, crashed):
    directory = tmp_path / "logs"
    names = [path.name for path in folder_of(directory, 4, crashed=(crashed,), started=(crashed,))]
    code, out, _ = audit(capsys, "verify", directory)
    assert code == 1
    assert f"{names[crashed]}: INCOMPLETE, epoch {crashed + 1}" in out
    if crashed < 3:
        assert f"{names[crashed + 1]}: OK, epoch {crashed + 2}, after a crash" in out
    assert ("INCOMPLETE crashed-last" in out) is (crashed == 3)
    assert "TAMPERED" not in out


def test_a_recovered_copy_beside_its_original_takes_no_place(capsys, tmp_path):
    directory = tmp_path / "logs"
    path = folder_of(directory, 3, crashed=(1,))[1]
    assert audit(capsys, "recover", path)[0] == 0
    assert verify(capsys, directory) == (1, {"recovered-copy"})
    path.unlink()
    code, codes = verify(capsys, directory)
    assert (code, codes) == (2, {"renamed"})


def test_a_log_cut_after_the_next_session_began_is_not_a_crash(capsys, logs):
    directory, names = logs
    path = directory / names[1]
    os.truncate(path, path.stat().st_size // 2)
    sidecar_of(path).unlink()
    code, codes = verify(capsys, directory)
    assert code == 2
    assert {"cut-off", "link-differs"} <= codes


def test_copies_renamed_files_and_foreign_logs_are_named(capsys, logs, tmp_path):
    directory, names = logs
    shutil.copy(directory / names[0], directory / "copy.mcap")
    other = folder_of(tmp_path / "other", 2)
    shutil.copy(other[1], directory / "z.mcap")
    (directory / names[2]).rename(directory / "renamed.mcap")
    code, codes = verify(capsys, directory)
    assert code == 2
    assert codes >= {"copy", "foreign", "renamed"}


def test_a_folder_full_of_foreign_files_is_no_error(capsys, logs):
    directory, _ = logs
    for number in range(20):
        (directory / f"note {number}.txt").write_text("x")
        (directory / f"other {number}.mcap").write_bytes(b"no log")
    (directory / "folder.mcap").mkdir()
    (directory / "nowhere.mcap").symlink_to("nowhere")
    os.mkfifo(directory / "pipe.mcap")
    assert verify(capsys, directory) == (0, {"not-a-log"})


def test_so_many_findings_are_told_only_in_json(capsys, logs, monkeypatch):
    directory, names = logs
    for number in range(4):
        shutil.copy(directory / names[0], directory / f"copy {number}.mcap")
    monkeypatch.setattr(commands_module, "SHOWN", 2)
    out = audit(capsys, "verify", directory)[1]
    assert out.count("TAMPERED copy") == 2
    assert "... and 2 more; --json has all of them" in out


def test_a_folder_that_cannot_be_read_is_told(capsys, logs, monkeypatch):
    def denied(_path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(folders_module.os, "scandir", denied)
    code, _, err = audit(capsys, "verify", logs[0])
    assert (code, "cannot be read (Permission denied)" in err) == (3, True)
    code, out, _ = audit(capsys, "list", logs[0], "--json")
    assert (code, json.loads(out)[0]["status"]) == (3, "UNREADABLE")


def test_names_of_files_reach_no_terminal(capsys, logs):
    directory, names = logs
    shutil.copy(directory / names[0], directory / "[bold]\x1b[31m\n.mcap")
    for command in ("verify", "list"):
        code, out, _ = audit(capsys, command, directory)
        assert code == 2
        assert "\x1b" not in out
        assert "[bold]\\x1b[31m\\n.mcap" in out


def test_a_folder_without_logs_and_one_that_cannot_be_read_are_unreadable(capsys, tmp_path):
    for command in ("verify", "list"):
        code, out, err = audit(capsys, command, tmp_path)
        assert (code, out) == (3, "")
        assert "a folder without logs (*.mcap); name a log, or the folder of logs" in err
    (tmp_path / "x.mcap").write_bytes(b"no log")
    assert verify(capsys, tmp_path) == (3, {"no-logs", "not-a-log"})


def test_a_file_that_cannot_be_read_is_named(capsys, logs, monkeypatch):
    directory, names = logs
    os.truncate(directory / names[1], 5 << 30)
    code, codes = verify(capsys, directory)
    assert code == 2
    assert "unreadable" in codes
    monkeypatch.setattr(folders_module, "SESSIONS_MAX", 4)
    code, _, err = audit(capsys, "verify", directory)
    assert code == 3
    assert "at most 4 logs" in err


def test_a_head_that_is_none_is_named(capsys, logs):
    directory, _ = logs
    for data in (b"{}", b"x" * 5000):
        (directory / HEAD).write_bytes(data)
        code, codes = verify(capsys, directory)
        assert code == 2
        assert "head-unreadable" in codes
    (directory / HEAD).unlink()
    assert verify(capsys, directory) == (1, {"head-missing"})


def test_a_session_that_runs_is_told(capsys, tmp_path):
    directory = tmp_path / "logs"
    folder_of(directory, 2, crashed=(1,))
    with (directory / LOCK).open() as lock:
        flock(lock, LOCK_EX)
        assert verify(capsys, directory) == (1, {"running"})
    assert verify(capsys, directory) == (1, {"crashed-last"})


def test_the_pinned_key_vouches_for_all_that_it_certified(capsys, logs, tmp_path):
    directory, names = logs
    series = bytes.fromhex(head(directory)["series"])
    pinned = default_path(series).with_suffix(".key.pub")
    code, out, _ = audit(capsys, "verify", directory, "--public-key", pinned)
    assert code == 0
    assert "key pinned (" in out
    assert "vouches for 5 by certificates; epochs 1 to 5" in out
    new_log_key(tmp_path / "other.key", series=series)
    code, codes = verify(capsys, directory, "--public-key", tmp_path / "other.key.pub")
    assert (code, codes) == (2, {"key-differs"})
    remove(directory / names[0])
    assert verify(capsys, directory, "--public-key", pinned) == (1, {"begins-late"})


def test_a_new_enrolment_is_told_and_breaks_what_was_pinned_before(capsys, tmp_path):
    directory = tmp_path / "logs"
    folder_of(directory, 2)
    series, epoch = to_continue(directory)
    anew = tmp_path / "anew.key"
    new_log_key(anew, series=series, epoch=epoch)
    write_session(directory, 2, key_file=anew)
    code, out, _ = audit(capsys, "verify", directory)
    assert code == 0
    assert "follows, enrolled here" in out
    assert "told enrolled: " in out
    pinned = default_path(series).with_suffix(".key.pub")
    code, codes = verify(capsys, directory, "--public-key", pinned)
    assert (code, codes) == (2, {"enrolled", "key-not-certified"})


def test_anchors_are_those_of_the_whole_folder(capsys, logs):
    directory, names = logs
    roots = [started_tree(directory / names[at])[1] for at in (1, 3)]
    options = [word for root in (*roots, head(directory)["head"]) for word in ("--anchor", root)]
    code, out, _ = audit(capsys, "verify", directory, *options)
    assert code == 0
    assert "anchor: 3 of 3 found" in out
    assert verify(capsys, directory, "--anchor", "ab" * 32) == (2, {"anchor-missing"})


def test_the_codes_of_each_session_are_checked_and_what_the_key_does_not_fit_is_told(logs, capsys):
    directory, names = logs
    documents = []

    def check(answers):
        def codes(file, _log):
            answer = answers[names.index(file.name)]
            if answer is None:
                raise InputError("--key", "log_id", "a", "b", "name another")
            return CodesFound(answer, "session keys", wrong=("record 3",) if answer == "no" else ())

        status = verify_folder(directory, documents.append, codes=codes)
        return status, documents[-1]["codes"], [finding["code"] for finding in documents[-1]["findings"]]

    assert check(["yes"] * 5) == (0, "5 yes", [])
    assert check(["yes", None, "not checked", None, "yes"]) == (0, "3 not checked, 2 yes", [])
    assert check(["yes", "no", "yes", None, "yes"]) == (2, "1 no, 1 not checked, 3 yes", ["codes-wrong"])
    assert check([None] * 5) == (1, "5 not checked", ["codes-not-checked"])
    assert verify_folder(directory, None, codes=lambda *_: CodesFound("yes", "session keys")) == 0
    assert capsys.readouterr().out.endswith("codes: 5 yes\n")
    (directory / "x.mcap").write_bytes(b"no log")
    assert check(["yes"] * 5) == (0, "5 yes", ["not-a-log"])
    for name in names:
        (directory / name).unlink()
    verify_folder(directory, documents.append, codes=check)
    assert documents[-1]["codes"] == "not checked"


def test_a_folder_of_0_1_0_is_incomplete_and_each_of_its_sessions_follows(capsys):
    code, out, _ = audit(capsys, "verify", OLD)
    assert code == 1
    assert "older form" in out
    assert "INCOMPLETE old-form: 20261127T072416Z-eea20e88.mcap: logs: 7 unsigned" in out
    assert "TAMPERED" not in out


def test_a_folder_of_0_1_0_goes_on_signed(capsys, tmp_path):
    directory = tmp_path / "logs"
    shutil.copytree(OLD, directory)
    directory.chmod(0o700)
    for path in directory.iterdir():
        path.chmod(0o600)
    path = write_session(directory, 24 * 365)
    write_session(directory, 24 * 365 + 1)
    code, codes = verify(capsys, directory)
    assert (code, codes) == (1, {"old-form", "enrolled"})
    shutil.copy(directory / "20261127T072440Z-b7809ef8.mcap", directory / "late.mcap")
    assert verify(capsys, directory) == (2, {"old-form", "enrolled", "copy"})
    assert path.name in audit(capsys, "verify", directory)[1]


def test_logs_and_folders_may_be_mixed_and_the_worst_decides(capsys, logs):
    directory, names = logs
    code, out, _ = audit(capsys, "verify", "--json", directory / names[0], directory, OLD)
    assert code == 1
    assert [document.get("folder") for document in json.loads(out)] == [None, str(directory), str(OLD)]


# ---------------------------------------------------------------- list


def test_list_prints_a_line_for_each_session_and_what_was_found(capsys, logs):
    directory, names = logs
    remove(directory / names[2])
    code, out, _ = audit(capsys, "list", directory)
    assert code == 2
    rows = [line.split() for line in out.splitlines()[1:5]]
    assert [row[2] for row in rows] == [log_id(number)[:8] for number in (0, 1, 3, 4)]
    assert "TAMPERED epoch-missing" in out


def test_list_tells_verdict_clearance_and_replay(capsys, tmp_path):
    a, b = (OLD / f"20261127T{name}.mcap" for name in ("072416Z-eea20e88", "072422Z-aafdf719"))
    code, out, _ = audit(capsys, "list", a, b, "--replay", "--json")
    a, b = (document["sessions"][0] for document in json.loads(out))
    assert code == 1
    assert (a["verdict"], a["outcome"], a["replay"]) == ("admissible", "done", "identical")
    assert (a["boundary"], round(a["certified"], 6), a["unit"]) == ("pitch_min", 40.0, "deg")
    assert (b["verdict"], b["outcome"], b["replay"]) == ("inadmissible", "refused", "identical")
    assert (b["boundary"], b["certified"]) == ("roll_min", None)
    assert "roll_min undefined" in audit(capsys, "list", OLD)[1]
    _, out, _ = audit(capsys, "list", OLD, "--json")
    (document,) = json.loads(out)
    assert {session["replay"] for session in document["sessions"]} == {"not checked"}


def test_a_replay_that_differs_makes_a_list_tampered(capsys, tmp_path):
    """The chain is computed anew over another verdict: what stands in the log of before signatures is sound."""
    data = (OLD / "20261127T072422Z-aafdf719.mcap").read_bytes()
    frames = (OLD / "20261127T072422Z-aafdf719.candump.log").read_bytes()

    def admissible(record):
        changed = isinstance(record, records.AuditVerdict)
        return record.model_copy(update={"reason": "moved", "poses": 1}) if changed else record

    (tmp_path / "forged.mcap").write_bytes(forge(data, admissible))
    (tmp_path / "forged.candump.log").write_bytes(frames)
    assert audit(capsys, "list", tmp_path / "forged.mcap")[0] == 1
    code, out, _ = audit(capsys, "list", tmp_path / "forged.mcap", "--replay")
    assert code == 2
    assert "TAMPERED replay-differs: forged.mcap: decided again: it differs: " in out
    _, out, _ = audit(capsys, "list", tmp_path, "--replay", "--json")
    assert {"replay-differs"} <= {finding["code"] for finding in json.loads(out)[0]["findings"]}


def test_list_takes_a_log_alone_and_its_usage_errors_are_unreadable(capsys, logs):
    directory, names = logs
    code, out, _ = audit(capsys, "list", directory / names[0])
    assert code == 0
    assert log_id(0)[:8] in out
    assert audit(capsys, "list", directory / "none.mcap")[0] == 3
    code, _, err = audit(capsys, "list", "--nonsense")
    assert code == 3
    assert "cutgate audit list: " in err


@pytest.mark.parametrize("columns", [80, 100, 140])
def test_the_table_fits_the_terminal(made, columns):
    from rich.console import Console  # noqa: PLC0415

    from cutgate.runtime.commands.audit_folder import Rows, read_folder  # noqa: PLC0415

    rows = Rows(again=False)
    read = read_folder(made[0], visit=rows.visit)
    console = Console(width=columns, color_system=None)
    with console.capture() as capture:
        console.print(rows.table([joined.session for joined in read.found.joined]))
    lines = capture.get().splitlines()
    assert max(map(len, lines)) <= columns
    assert len(lines) == 6
    assert ("replay" in lines[0]) is (columns >= 100)
