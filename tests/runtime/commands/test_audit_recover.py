"""``cutgate audit recover``: what is written, what becomes of the original, and what is refused with which remedy."""

import errno
import fcntl
import json
import os
import stat
from hashlib import sha256

import pytest

from cutgate import __version__
from cutgate.config import durable
from cutgate.runtime.audit.commit import Durable
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.log import AuditLog
from cutgate.runtime.audit.reading import candump_of, copy_of
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.commands import audit_recover as module
from cutgate.runtime.commands.app import execute
from tests.logs import signature_of
from tests.runtime.audit.build import OPENED, Ticking, decision, open_log, session_log, wait_for

FRAMES = b"(1.0) vcan0 080#00\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("session")).log.read_bytes()


@pytest.fixture
def crashed(whole, tmp_path):
    """A log as a crash leaves it, in a folder of its own, with its raw frames."""
    log = tmp_path / "logs" / "20260921T141321Z-01234567.mcap"
    log.parent.mkdir()
    log.write_bytes(whole[: len(whole) * 3 // 4])
    candump_of(log).write_bytes(FRAMES)
    return log


def cutgate(capsys, *arguments):
    code = execute(["audit", *map(str, arguments)])
    found = capsys.readouterr()
    return code, found.out, found.err


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def held(folder):
    return {path.name: (path.read_bytes(), mode(path)) for path in folder.iterdir()}


# ---------------------------------------------------------------- the copy and the original


def test_a_copy_is_written_beside_the_original_which_is_made_read_only(capsys, crashed):
    before = held(crashed.parent)
    code, out, err = cutgate(capsys, "recover", crashed)
    copy = crashed.with_name("20260921T141321Z-01234567.recovered.mcap")
    left = crashed.read_bytes()
    assert (code, err) == (0, "")
    dropped = read_log(left).report.dropped_bytes
    assert out.splitlines() == [
        f"recovered: {copy}",
        f"  41 records and 9 attachments kept, {dropped} bytes dropped at the end",
        "  audit verify says INCOMPLETE of it, never OK: it is a copy of what was left",
        f"  {crashed}: the original, now read-only: keep it",
    ]
    after = held(crashed.parent)
    assert after.pop(copy.name)[1] == 0o600
    assert after == before | {crashed.name: (left, 0o400)}
    told = read_log(copy.read_bytes()).scan.metadata[1].metadata
    assert told == {
        "original": crashed.name,
        "original_sha256": sha256(left).hexdigest(),
        "original_bytes": str(len(left)),
        "dropped_bytes": str(dropped),
        "records": "41",
        "software": f"cutgate {__version__}",
    }


def test_the_copy_is_incomplete_shown_and_replayed_with_the_raw_frames_of_the_original(capsys, crashed):
    assert cutgate(capsys, "recover", crashed)[0] == 0
    copy = copy_of(crashed)
    code, out, _ = cutgate(capsys, "verify", copy)
    assert (code, out.splitlines()[0]) == (1, f"INCOMPLETE: {copy}")
    assert out.splitlines()[1].startswith(f"  it is a recovered copy of {crashed.name}, ")
    code, out, _ = cutgate(capsys, "show", copy, "--json")
    document = json.loads(out)
    assert (code, document["candump"], document["messages"]) == (0, str(candump_of(crashed)), 41)
    code, out, _ = cutgate(capsys, "replay", copy)
    assert code == 0
    assert out.startswith("IDENTICAL")


def test_the_copy_of_a_log_that_was_closed_is_held_to_its_raw_frames(capsys, crashed, whole):
    crashed.write_bytes(whole[:-1])
    candump_of(crashed).write_bytes(b"")
    assert cutgate(capsys, "recover", crashed)[0] == 0
    code, out, _ = cutgate(capsys, "verify", copy_of(crashed))
    assert code == 1
    assert "structure: yes" in out
    candump_of(crashed).write_bytes(b"other")
    assert cutgate(capsys, "verify", copy_of(crashed))[0] == Status.TAMPERED


@pytest.mark.parametrize("option", ["-o", "--out"])
def test_the_copy_goes_where_it_is_told_to(capsys, crashed, tmp_path, option):
    out = tmp_path / "elsewhere.mcap"
    assert cutgate(capsys, "recover", crashed, option, out)[0] == 0
    assert read_log(out.read_bytes()).report.messages == 41
    assert not copy_of(crashed).exists()


def test_raw_frames_of_another_log_beside_the_copy_are_no_matter_of_its(capsys, crashed, whole, tmp_path):
    crashed.write_bytes(whole[:-1])
    candump_of(crashed).write_bytes(b"")
    (tmp_path / "x.candump.log").write_bytes(b"of another")
    assert cutgate(capsys, "recover", crashed, "-o", tmp_path / "x.mcap")[0] == 0


def test_a_copy_that_cannot_be_read_back_is_removed(capsys, crashed, monkeypatch):
    def broken(_file):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(module, "read_log", broken)
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert err.startswith(f"{copy_of(crashed)}: cannot be read (Input/output error)")


def test_an_original_that_is_read_only_keeps_its_mode(capsys, crashed):
    crashed.chmod(0o444)
    code, out, _ = cutgate(capsys, "recover", crashed)
    assert (code, mode(crashed)) == (0, 0o444)
    assert out.endswith(f"{crashed}: the original, which is read-only\n")


def test_an_original_that_cannot_be_made_read_only_is_said_and_the_copy_counts(capsys, crashed, monkeypatch):
    def refuse(*_arguments):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    change = os.fchmod
    monkeypatch.setattr(
        module.os, "fchmod", lambda fd, to: refuse() if to == module.READ_ONLY else change(fd, to)
    )
    code, out, _ = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (0, True)
    assert "could not be made read-only (Operation not permitted): keep it as it is" in out


@pytest.mark.parametrize("name", ["[red]x\x1b[2J\n.mcap", b"\xff\xfe.mcap", "x" * 200 + ".mcap"])
def test_a_name_is_data(capsys, crashed, name):
    log = crashed.rename(crashed.parent / os.fsdecode(name))
    code, out, err = cutgate(capsys, "recover", log)
    assert (code, err) == (0, "")
    assert [one for one in out if not (one.isprintable() or one == "\n")] == []
    assert len(out.splitlines()) == 4
    (reason, *_) = read_log(copy_of(log).read_bytes()).report.reasons
    assert repr(name)[2:6] in reason or name in reason or r"\xff\xfe.mcap" in reason


# ---------------------------------------------------------------- nothing is written over, nothing half


@pytest.mark.parametrize("what", ["file", "folder", "link", "dangling link"])
def test_nothing_is_written_over(capsys, crashed, tmp_path, what):
    out, victim = tmp_path / "out.mcap", tmp_path / "victim"
    if what == "file":
        out.write_bytes(b"mine")
    elif what == "folder":
        out.mkdir()
    else:
        out.symlink_to(victim)
        if what == "link":
            victim.write_bytes(b"mine")
    before = held(crashed.parent)
    code, said, err = cutgate(capsys, "recover", crashed, "-o", out)
    assert (code, said) == (2, "")
    assert err == (f"{out}: there is something of this name already; name the copy another way, with -o\n")
    assert held(crashed.parent) == before
    assert what == "folder" or not out.exists() or out.read_bytes() == b"mine"
    assert victim.exists() is (what == "link")


def test_what_appears_meanwhile_is_not_written_over(capsys, crashed, monkeypatch):
    monkeypatch.setattr(module.os.path, "lexists", lambda _path: False)
    copy_of(crashed).write_bytes(b"mine")
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).read_bytes()) == (2, b"mine")
    assert "there is something of this name already" in err


def test_a_second_recovery_does_not_take_the_place_of_the_first(capsys, crashed):
    assert cutgate(capsys, "recover", crashed)[0] == 0
    first = copy_of(crashed).read_bytes()
    assert cutgate(capsys, "recover", crashed)[0] == 2
    assert copy_of(crashed).read_bytes() == first


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, "free the disk, or name the copy elsewhere with -o"),
        (errno.EROFS, "name the copy elsewhere, with -o"),
    ],
)
def test_a_disk_that_takes_no_copy_leaves_none_and_the_original_as_it_was(
    capsys, crashed, monkeypatch, code, remedy
):
    write, count = os.write, []

    def full(descriptor, data):
        count.append(len(data))
        if len(count) > 5:
            raise OSError(code, os.strerror(code))
        return write(descriptor, data)

    before = held(crashed.parent)
    monkeypatch.setattr(durable.os, "write", full)
    ended, out, err = cutgate(capsys, "recover", crashed)
    monkeypatch.undo()
    assert (ended, out, len(count)) == (2, "", 6)
    assert err == f"{copy_of(crashed)}: cannot be written ({os.strerror(code)}); {remedy}\n"
    assert held(crashed.parent) == before


@pytest.mark.parametrize(
    ("out", "why"), [("absent/x.mcap", "No such file"), ("x" * 256, "File name too long")]
)
def test_a_place_where_nothing_can_be_made_is_refused(capsys, crashed, tmp_path, out, why):
    code, _, err = cutgate(capsys, "recover", crashed, "-o", f"{tmp_path}/{out}")
    assert code == 2
    assert f"cannot be written ({why}" in err
    assert mode(crashed) != module.READ_ONLY


def test_a_disk_that_cannot_be_read_is_told_of_the_original(capsys, crashed, monkeypatch):
    def broken(*_arguments):
        yield b"half"
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(module, "copied", broken)
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert err.startswith(f"{crashed}: cannot be read (Input/output error)")


def test_whoever_interrupts_it_finds_no_copy(capsys, crashed, monkeypatch):
    def interrupted(*_arguments):
        yield b"half"
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "copied", interrupted)
    before = held(crashed.parent)
    assert cutgate(capsys, "recover", crashed)[0] == 130
    assert held(crashed.parent) == before


# ---------------------------------------------------------------- a file that changes


@pytest.mark.parametrize("by", [b"more", None])
def test_a_log_whose_size_changes_is_refused(capsys, crashed, monkeypatch, by):
    judge = module.refused

    def meanwhile(log):
        with crashed.open("ab") as file:
            file.write(by) if by else file.truncate(9000)
        return judge(log)

    monkeypatch.setattr(module, "refused", meanwhile)
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert err == f"{crashed}: it changes while it is read; wait until whatever writes it has ended\n"


def altered(crashed, place, kept=False):
    """After the log was judged, a byte is another, or the rest is gone."""

    def named(_path):
        data = bytearray(crashed.read_bytes())
        data[place] ^= 1
        crashed.write_bytes(data if kept else data[:place])
        return "x"

    return named


def test_a_log_that_gets_shorter_after_its_digest_is_refused(capsys, crashed, monkeypatch):
    told = module.what_is_told

    def meanwhile(*arguments):
        os.truncate(crashed, 9000)
        return told(*arguments)

    monkeypatch.setattr(module, "what_is_told", meanwhile)
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert err == f"{crashed}: it changes while it is read; wait until whatever writes it has ended\n"


def test_a_log_that_changes_in_a_chunk_is_refused(capsys, crashed, monkeypatch, whole):
    place = whole.index(b'"time scale"')
    monkeypatch.setattr(module, "_named", altered(crashed, place, kept=True))
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert err == f"{crashed}: its checksum is wrong; no session writes such a log; keep it as it is\n"


def test_a_log_that_changes_in_an_attachment_is_refused_by_its_copy(capsys, crashed, monkeypatch, whole):
    place = whole.index(b"x,y,z,i,j,k")
    monkeypatch.setattr(module, "_named", altered(crashed, place, kept=True))
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert "it changes while it is read: its copy holds something else; wait until" in err


# ---------------------------------------------------------------- what is not recovered


@pytest.mark.parametrize("name", ["missing.mcap", ".", "/", "pyproject.toml"])
def test_what_is_no_log_is_refused(capsys, name):
    code, out, err = cutgate(capsys, "recover", name)
    assert (code, out) == (2, "")
    assert err.startswith(f"{name}: ")


@pytest.mark.parametrize("arguments", [[], ["a", "b"], ["--nothing", "x"]])
def test_a_usage_error_is_refused(capsys, arguments):
    assert cutgate(capsys, "recover", *arguments)[:2] == (2, "")


def test_a_log_that_is_refused_is_left_as_it_is(capsys, crashed, whole):
    crashed.write_bytes(whole)
    candump_of(crashed).write_bytes(b"")
    sidecar_of(crashed).write_bytes(signature_of(whole))
    before = held(crashed.parent)
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, err) == (2, f"{crashed}: it is whole: there is nothing to recover; read it as it is\n")
    assert held(crashed.parent) == before


def test_raw_frames_that_are_not_those_of_a_closed_log_are_refused(capsys, crashed, whole):
    crashed.write_bytes(whole[:-1])
    code, _, err = cutgate(capsys, "recover", crashed)
    assert (code, copy_of(crashed).exists()) == (2, False)
    assert "it is altered, not cut: the file of raw frames beside the log has 19 bytes" in err


def test_a_copy_is_not_recovered(capsys, crashed):
    cutgate(capsys, "recover", crashed)
    code, _, err = cutgate(capsys, "recover", copy_of(crashed))
    assert code == 2
    assert f"it is a recovered copy of {crashed.name}, and no log that was cut; read it as it is" in err


# ---------------------------------------------------------------- a session that runs


def test_the_log_that_a_session_is_writing_is_no_crash(capsys, tmp_path):
    with open_log(tmp_path) as log:
        log.write(decision(1))
        before = mode(log.path)
        code, _, err = cutgate(capsys, "recover", log.path)
        assert code == 2
        assert err == (
            f"{log.path}: a session is writing it; end the session; a log that it closes needs no recovery\n"
        )
        link = tmp_path.parent / f"{tmp_path.name}.link.mcap"
        link.symlink_to(log.path)
        assert cutgate(capsys, "recover", link)[0] == 2
        assert mode(log.path) == before
        (tmp_path / "HEAD").write_bytes(b"no head")
        assert "a session is writing it" in cutgate(capsys, "recover", log.path)[2]


def test_a_log_beside_that_of_a_session_is_recovered(capsys, tmp_path, whole):
    with open_log(tmp_path):
        log = tmp_path / "before.mcap"
        log.write_bytes(whole[:-100])
        assert cutgate(capsys, "recover", log)[0] == 0


def test_a_log_whose_session_has_ended_is_recovered_and_the_next_one_finds_what_it_left(capsys, tmp_path):
    log = AuditLog.create(tmp_path, log_id="ab" * 16, opened=OPENED, clock=Ticking().clock())
    log.write(decision(1))
    log.commit(1)
    wait_for(log, lambda event: isinstance(event, Durable) and event.token == 1)
    path = log.path
    os.close(log._locked)  # as the process ends
    head = read_log(path.read_bytes()).report.head
    code, _, err = cutgate(capsys, "recover", path)
    assert (code, err) == (0, "")
    later = Ticking()
    later.now_ns += 60_000_000_000
    following = AuditLog.create(tmp_path, log_id="cd" * 16, opened=OPENED, clock=later.clock())
    assert (following.previous.crashed, following.previous.log) == (True, path.name)
    assert following.previous.head == head
    following.close(final_state="done", clean=True)


def test_where_it_cannot_be_told_whether_a_session_runs_nothing_is_done(capsys, crashed):
    (crashed.parent / "LOCK").symlink_to("elsewhere")
    before = {path.name for path in crashed.parent.iterdir()}
    code, _, err = cutgate(capsys, "recover", crashed)
    assert code == 2
    assert "LOCK: whether a session is writing here cannot be told (" in err
    assert "copy log and raw frames to a folder of their own" in err
    assert {path.name for path in crashed.parent.iterdir()} == before


def test_a_lock_that_nobody_holds_is_free_afterwards(capsys, crashed):
    lock = crashed.parent / "LOCK"
    lock.touch()
    assert cutgate(capsys, "recover", crashed)[0] == 0
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
