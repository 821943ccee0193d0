"""Key, log directory and disk: real files, real faults, and nothing left behind."""

import errno
import fcntl
import json
import os
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from cutgate.config.key import new_key_file
from cutgate.config.model import Site
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.audit.directory import HEAD, LOCK, WITHDRAWN, Head, lock
from cutgate.runtime.audit.log_keys import default_path
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Unknown
from cutgate.runtime.doctor.probes import files
from cutgate.runtime.doctor.probes.files import (
    WRITES,
    delays,
    disk_delays,
    free_space,
    key,
    log_folder,
    nearest,
    session_in,
)

NOBODY = 65534
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become somebody else")


def here(**named):
    return Examined(Site(), named.pop("key", None), **named)


@contextmanager
def as_nobody():
    """What root may, everybody may not."""
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def logs(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir(mode=0o700)
    return folder


# ---------------------------------------------------------------- the key


def test_a_key_is_told_by_its_fingerprint(tmp_path):
    new_key_file(tmp_path / "k", bytes(range(32)))
    facts = key(here(key=tmp_path / "k"))
    assert (facts.fingerprint, facts.problem) == (fingerprint(bytes(range(32))), None)


def spoiled(path, how):
    match how:
        case "missing":
            return
        case "pipe":
            os.mkfifo(path, 0o600)
        case "link":
            new_key_file(path.with_name("other"), bytes(32))
            path.symlink_to(path.with_name("other"))
        case "open":
            new_key_file(path, bytes(32))
            path.chmod(0o644)
        case "no key":
            path.write_bytes(b"secret")
            path.chmod(0o600)
        case "large":
            path.write_bytes(bytes(100_000))
            path.chmod(0o600)


@pytest.mark.parametrize(
    ("how", "told", "remedy"),
    [
        ("missing", "there is no such key file", "cutgate key new"),
        ("pipe", "not a regular file", "put the file itself there"),
        ("link", "is a symbolic link", "put the file itself there"),
        ("open", "0644", "chmod 600"),
        ("no key", "is not hexadecimal", "copy it anew"),
        ("large", "100000 bytes", "restore the file"),
    ],
)
def test_a_key_that_no_session_takes_is_refused_as_there_and_not_waited_for(tmp_path, how, told, remedy):
    spoiled(tmp_path / "k", how)
    problem = key(here(key=tmp_path / "k")).problem
    assert told in f"{problem.value} {problem.bound}"
    assert remedy in problem.remedy


def test_no_key_is_unknown():
    facts = key(here())
    assert isinstance(facts, Unknown)
    assert "--key" in facts.remedy


# ---------------------------------------------------------------- the log directory


def folder(path):
    return log_folder(here(log_directory=path))


def test_a_folder_that_can_be_made_is_not_made(tmp_path):
    facts = folder(tmp_path / "a" / "b" / "logs")
    assert (facts.there, facts.problem, facts.session) == (False, None, None)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_ours_is_left_as_it_is(logs):
    facts = folder(logs)
    assert (facts.there, facts.problem, facts.session) == (True, None, None)
    assert list(logs.iterdir()) == []


def test_a_file_is_no_folder_and_holds_none(tmp_path):
    (tmp_path / "file").touch()
    assert folder(tmp_path / "file").problem.value == "a file"
    assert folder(tmp_path / "file" / "logs").problem is not None


def test_a_name_that_is_none_is_refused():
    assert "null" in folder(Path("a\0b")).problem.value


@root_only
def test_what_may_not_be_written_is_refused(place):
    (place / "logs").mkdir(mode=0o700)
    with as_nobody():
        made, there, inside = (folder(place / name) for name in ("new/logs", "logs", "logs/below"))
    assert made.problem.bound.endswith(f"{place} cannot be written")
    assert "uid 0" in there.problem.value
    assert inside.problem is not None


@root_only
def test_a_folder_of_ours_that_we_cannot_write_is_refused(place):
    mine = place / "mine"
    mine.mkdir()
    os.chown(mine, NOBODY, NOBODY)
    mine.chmod(0o500)
    with as_nobody():
        facts = folder(mine)
    assert facts.problem.value == "not writable"
    assert "chmod 700" in facts.problem.remedy


def test_a_folder_in_which_others_may_delete_is_refused_as_a_session_refuses_it(logs):
    logs.chmod(0o777)
    assert "mode 0777" in folder(logs).problem.value


def test_a_clock_that_is_behind_and_a_list_that_is_lost_are_told(logs):
    (logs / HEAD).write_bytes(Head("a.mcap", None, closed=True, time_ns=(1 << 63) - 1).encode())
    (logs / HEAD).chmod(0o600)
    assert folder(logs).problem.key == "this computer's clock"
    content = {"schema": "cutgate.head/1", "log": "a.mcap", "state": "closed", "head": None}
    content["withdrawn"] = {"lines": 3, "sha256": "0" * 64}
    (logs / HEAD).write_text(json.dumps(content), encoding="ascii")
    assert "missing" in folder(logs).problem.value
    (logs / HEAD).write_bytes(b"no head")
    assert folder(logs).problem is None  # a session would go on, and say so
    (logs / HEAD).chmod(0o666)
    assert folder(logs).problem.key == "mode"
    assert not (logs / WITHDRAWN).exists()


def test_a_log_key_that_no_session_takes_is_told(logs):
    key = LogKey(bytes(16), 3, bytes(32))
    head = Head("a.mcap", None, closed=True, series=bytes(16), epoch=2)
    (logs / HEAD).write_bytes(head.encode())
    (logs / HEAD).chmod(0o600)
    assert folder(logs).problem.bound == "there is no such log key"
    path = default_path(bytes(16))
    path.parent.mkdir(parents=True, exist_ok=True)
    for given, told in (
        (key, None),
        (replace(key, epoch=1), "epoch"),
        (replace(key, series=bytes([1]) * 16), "series"),
    ):
        path.write_bytes(given.encode())
        path.chmod(0o600)
        problem = folder(logs).problem
        assert (problem and problem.key) == told
        assert path.read_bytes() == given.encode(), "nothing is replaced"
    path.unlink()


def test_a_session_that_runs_is_seen_and_not_disturbed(logs):
    if not Path("/proc/locks").exists():
        pytest.skip("this kernel lists no locks")
    held = lock(logs)
    try:
        assert folder(logs).session == os.getpid()
        assert isinstance(disk_delays(here(log_directory=logs)), Unknown)
        assert [path.name for path in logs.iterdir()] == [LOCK]
    finally:
        os.close(held)
    assert folder(logs).session is None
    fcntl.flock(again := lock(logs), fcntl.LOCK_UN)
    os.close(again)


def test_locks_of_others_are_not_ours(logs, tmp_path):
    (logs / LOCK).touch()
    inode = (logs / LOCK).stat().st_ino
    locks = tmp_path / "locks"
    lines = [
        f"1: POSIX  ADVISORY  WRITE 11 fd:00:{inode} 0 EOF",
        f"2: FLOCK  ADVISORY  WRITE 12 fd:00:{inode}1 0 EOF",
        "3: FLOCK",
        "",
    ]
    locks.write_text("\n".join(lines), encoding="ascii")
    assert session_in(logs, locks) is None
    locks.write_text(
        "\n".join([*lines, f"4: FLOCK  ADVISORY  WRITE 13 00:1f:{inode} 0 EOF"]), encoding="ascii"
    )
    assert session_in(logs, locks) == 13
    assert session_in(tmp_path, locks) is None


# ---------------------------------------------------------------- the disk


def test_free_space_is_that_of_the_nearest_folder(tmp_path):
    full = SimpleNamespace(f_bavail=3, f_frsize=4096, f_bfree=100)
    asked = []
    facts = free_space(here(log_directory=tmp_path / "a" / "b"), lambda path: asked.append(path) or full)
    assert (facts.folder, facts.free_bytes, asked) == (str(tmp_path), 3 * 4096, [tmp_path])
    assert free_space(here(log_directory=tmp_path)).free_bytes > 0


def test_nearest(tmp_path):
    assert nearest(tmp_path) == tmp_path
    assert nearest(tmp_path / "a" / "b") == tmp_path
    assert nearest(Path("nowhere")) == Path.cwd()


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def test_each_write_is_timed_and_the_file_is_removed(logs):
    clock, seen = Clock(), []

    def sync(descriptor):
        seen.append([path.name for path in logs.iterdir()])
        assert os.fstat(descriptor).st_mode & 0o777 == 0o600
        clock.now_s += 0.004 if len(seen) != 7 else 0.5

    facts = disk_delays(here(log_directory=logs), clock, sync)
    assert (facts.count, round(facts.median_ms, 6), round(facts.worst_ms, 6)) == (WRITES, 4.0, 500.0)
    assert all(len(names) == 1 and names[0].startswith(".cutgate-doctor-") for names in seen)
    assert list(logs.iterdir()) == []


def test_a_slow_disk_is_left_after_a_while(logs):
    clock = Clock()

    def sync(_descriptor):
        clock.now_s += 3.0

    facts = disk_delays(here(log_directory=logs), clock, sync)
    assert (facts.count, facts.worst_ms) == (2, 3000.0)


def test_a_disk_that_fails_leaves_nothing_behind(logs):
    def sync(_descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space left"):
        disk_delays(here(log_directory=logs), sync=sync)
    assert list(logs.iterdir()) == []


def test_without_the_folder_nothing_is_written_anywhere(tmp_path):
    facts = disk_delays(here(log_directory=tmp_path / "my logs"))
    assert isinstance(facts, Unknown)
    assert facts.remedy.endswith(f"mkdir -m 700 '{tmp_path}/my logs'")
    assert list(tmp_path.iterdir()) == []


def test_the_disk_that_is_there_is_timed(logs):
    facts = disk_delays(here(log_directory=logs))
    assert 0 <= facts.median_ms <= facts.worst_ms


def test_median_and_worst():
    facts = delays([0.003, 0.001, 0.009])
    assert (facts.count, facts.median_ms, facts.worst_ms) == (3, 3.0, 9.0)
    assert files.WRITE_BYTES % 4096 == 0
