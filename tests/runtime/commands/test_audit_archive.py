"""``cutgate audit archive``: what it prints, what it refuses, and the folder afterwards."""

import errno
import os
import shutil
from fcntl import LOCK_EX, flock

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cutgate.runtime.audit import archive as archive_module
from cutgate.runtime.audit.directory import HEAD, LOCK
from cutgate.runtime.audit.log_keys import default_path
from cutgate.runtime.audit.signing.note import SignatureType, VerifierKey
from cutgate.runtime.audit.signing.signer import sidecar_of
from tests.runtime.audit.folders import folder_of, head, write_session
from tests.runtime.commands.test_audit_folder import OLD, audit, verify
from tests.runtime.commands.test_audit_verify import cosigned


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Five sessions; the second crashed, the third started."""
    directory = tmp_path_factory.mktemp("made") / "logs"
    return directory, folder_of(directory, 5, crashed=(1,), started=(2,))


@pytest.fixture
def logs(made, tmp_path):
    directory = tmp_path / "logs"
    shutil.copytree(made[0], directory)
    directory.chmod(0o700)
    return directory, [path.name for path in made[1]], tmp_path / "old"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_folder_verifies_as_before_and_says_where_the_logs_are(capsys, logs):
    directory, files, old = logs
    before = verify(capsys, directory)
    code, out, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == "2 sessions moved"
    assert f"{files[2]} stays: the last start was in it" in out
    assert verify(capsys, directory) == (before[0], before[1] | {"archived"})
    _, out, _ = audit(capsys, "verify", directory)
    assert f"{files[0]}: OK, epoch 1, archived, enrolled here" in out
    assert f"{files[1]}: INCOMPLETE, epoch 2, archived, follows" in out
    assert "records are signed" in out
    assert f"2, whose logs are not here; moved to {old}" in out
    assert "archived" in audit(capsys, "list", directory)[1]
    assert verify(capsys, old) == (1, {"head-missing"})
    assert not {name for name in names(directory) if name.startswith(files[0][:25])} - {
        files[0][:25] + ".archived"
    }


def test_sessions_go_on_and_a_pinned_key_vouches_across_what_was_archived(capsys, logs):
    directory, _, old = logs
    audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    write_session(directory, 5)
    pinned = default_path(bytes.fromhex(head(directory)["series"])).with_suffix(".key.pub")
    code, out, _ = audit(capsys, "verify", directory, "--public-key", pinned)
    assert code == 1  # of the crash
    assert "vouches for 6 by certificates" in out
    assert "TAMPERED" not in out


def test_a_log_alone_is_certified_across_what_was_archived(capsys, logs):
    directory, files, old = logs
    pinned = default_path(bytes.fromhex(head(directory)["series"])).with_suffix(".key.pub")
    audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert audit(capsys, "verify", directory / files[4], "--public-key", pinned)[0] == 0
    (directory / f"{files[1][:25]}.archived").unlink()
    assert audit(capsys, "verify", directory / files[4], "--public-key", pinned)[0] == 2


def test_asked_again_it_moves_nothing_twice(capsys, logs):
    directory, _, old = logs
    audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    before = names(directory), names(old)
    code, out, _ = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert (code, out.splitlines()[-1]) == (0, "0 sessions moved")
    assert (names(directory), names(old)) == before


def test_a_dry_run_says_what_would_be_moved_and_moves_nothing(capsys, logs):
    directory, files, old = logs
    before = names(directory)
    code, out, _ = audit(capsys, "archive", directory, "--to", old, "--keep", "1", "--dry-run")
    assert code == 0
    assert f"would move {files[0]}, {files[0][:25]}.candump.log, {files[0][:25]}.signature.json" in out
    assert out.splitlines()[-1] == "2 sessions to be moved"
    assert names(directory) == before
    assert not old.exists()


@pytest.mark.parametrize(
    ("date", "count"),
    [("2026-09-21", 0), ("2026-09-21T15:00", 1), ("2026-09-21T15:00+01:00", 0), ("2027-01-01", 2)],
)
def test_before_a_date(capsys, logs, date, count):
    directory, _, old = logs
    code, out, _ = audit(capsys, "archive", directory, "--to", old, "--before", date)
    assert code == 0
    assert out.splitlines()[-1] == f"{count} session{'' if count == 1 else 's'} moved"


def test_it_is_refused_while_a_session_runs(capsys, logs):
    directory, _, old = logs
    before = names(directory)
    with (directory / LOCK).open() as lock:
        flock(lock, LOCK_EX)
        code, _, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert code == 2
    assert "in use, must be free of any running session" in err
    assert names(directory) == before


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ((), "either --before DATE or --keep N"),
        (("--keep", "1", "--before", "2026-11-01"), "either --before DATE or --keep N"),
        (("--before", "yesterday\x1b"), "a date, as 2026-11-01"),
        (("--before", "9" * 5000), "a date, as 2026-11-01"),
        (("--keep", "0"), "greater than or equal to 1"),
    ],
)
def test_bad_options_are_refused(capsys, logs, options, told):
    directory, _, old = logs
    code, _, err = audit(capsys, "archive", directory, "--to", old, *options)
    assert code == 2
    assert told in err
    assert "\x1b" not in err


def test_bad_folders_are_refused_and_none_is_made(capsys, logs):
    directory, files, _ = logs
    for source, to, told in (
        (directory.parent / "none", directory.parent / "old", "no such folder"),
        (directory, directory, "the log directory itself"),
        (directory, directory / files[0], "not a folder"),
        (directory, directory / files[0] / "x", "cannot be made"),
    ):
        code, _, err = audit(capsys, "archive", source, "--to", to, "--keep", "1")
        assert code == 2
        assert told in err
    assert not (directory.parent / "none").exists()
    directory.chmod(0o777)
    assert audit(capsys, "archive", directory, "--to", directory.parent / "old", "--keep", "1")[0] == 2


def test_what_is_tampered_with_stays_and_is_told(capsys, logs):
    directory, files, old = logs
    path = directory / files[0]
    path.write_bytes(path.read_bytes().replace(b"time scale", b"time skale"))
    code, out, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert code == 2
    assert f"{files[0]} stays: it is TAMPERED" in err
    assert f"{files[1]}: INCOMPLETE, epoch 2, archived" in audit(capsys, "verify", directory)[1]
    assert out.splitlines()[-1] == "1 session moved"


def test_what_is_tampered_with_behind_record_0_stays_in_its_place(capsys, logs):
    directory, files, old = logs
    path = directory / files[0]
    path.write_bytes(path.read_bytes().replace(b'"from_state":"a"', b'"from_state":"z"'))
    code, _, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert code == 2
    assert f"{files[0]} stays: it is TAMPERED" in err
    assert f"{files[0]}: TAMPERED, epoch 1, enrolled here" in audit(capsys, "verify", directory)[1]


def test_a_log_put_back_beside_its_stub_and_a_stub_taken_away_or_exchanged_are_told(capsys, logs):
    directory, files, old = logs
    audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    stubs = [directory / f"{name[:25]}.archived" for name in files[:2]]
    shutil.copy(old / files[0], directory)
    assert "archive-unfinished" in verify(capsys, directory)[1]
    shutil.copy(old / files[1], directory / files[0])
    assert "stub-wrong" in verify(capsys, directory)[1]
    (directory / files[0]).unlink()
    kept = stubs[1].read_bytes()
    stubs[1].write_bytes(stubs[0].read_bytes())
    code, codes = verify(capsys, directory)
    assert code == 2
    assert {"stub-wrong", "epoch-missing"} <= codes
    stubs[1].write_bytes(kept)
    stubs[0].write_bytes(b"x" * (2 << 20))
    assert {"stub-wrong", "begins-late"} <= verify(capsys, directory)[1]
    stubs[0].unlink()
    assert verify(capsys, directory)[1] == {"archived", "begins-late"}


def test_cosigned_logs_are_archived_and_that_the_stub_does_not_tell_of_witnesses_is_told(capsys, tmp_path):
    directory, old = tmp_path / "logs", tmp_path / "old"
    paths, key = folder_of(directory, 3), Ed25519PrivateKey.generate()
    witness, *_ = [cosigned(path, key) for path in paths]
    assert verify(capsys, directory, "--cosigner", witness) == (0, set())
    code, _, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert (code, err) == (0, "")
    assert verify(capsys, directory) == (0, {"archived"})
    assert verify(capsys, directory, "--cosigner", witness) == (1, {"archived", "cosigner-not-checked"})
    assert verify(capsys, old, "--cosigner", witness) == (1, {"head-missing"})
    other = VerifierKey("other.example", bytes(32), SignatureType.COSIGNATURE)
    assert verify(capsys, directory, "--cosigner", str(other))[0] == 2


def test_a_full_disk_is_told_and_the_log_stays(capsys, logs, monkeypatch):
    def full(_descriptor, _data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    directory, _, old = logs
    before = names(directory)
    monkeypatch.setattr(archive_module.os, "write", full)
    code, _, err = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert code == 2
    assert "not moved (No space left on device); free the disk of the other folder" in err
    assert names(directory) == before


def test_another_folder_than_the_one_it_was_archived_to_is_told(capsys, logs, tmp_path):
    directory, files, old = logs
    audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    shutil.copy(old / files[0], directory)
    code, out, err = audit(capsys, "archive", directory, "--to", tmp_path / "x", "--keep", "1", "--dry-run")
    assert (code, f"would remove {files[0]}" in out, err) == (0, True, "")
    code, _, err = audit(capsys, "archive", directory, "--to", tmp_path / "x", "--keep", "1")
    assert code == 2
    assert "name the folder that it was archived to" in err
    code, out, _ = audit(capsys, "archive", directory, "--to", old, "--keep", "1")
    assert (code, f"removed {files[0]}: copied by an earlier call" in out) == (0, True)
    assert sidecar_of(old / files[0]).exists()


def test_a_folder_of_0_1_0_is_archived_too_but_for_what_its_list_names(capsys, tmp_path):
    directory, old = tmp_path / "logs", tmp_path / "old"
    shutil.copytree(OLD, directory)
    directory.chmod(0o700)
    for path in directory.iterdir():
        path.chmod(0o600)
    before = verify(capsys, directory)
    code, out, _ = audit(capsys, "archive", directory, "--to", old, "--before", "2030-01-01")
    assert code == 0
    assert verify(capsys, directory) == (before[0], before[1] | {"archived"})
    assert "20261127T072431Z-c0838631.mcap stays: " in out
    assert (directory / HEAD).read_bytes() == (OLD / HEAD).read_bytes()
