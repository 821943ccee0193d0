"""Moving old sessions: what is moved and what stays, and that no cut in between loses or doubles anything."""

import errno
import os
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest

from cutgate.config.load import InputError
from cutgate.runtime.audit import archive as module
from cutgate.runtime.audit.archive import archive, copied, plan, read_stub, removed, withdrawn_by
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.stub import stub_name
from cutgate.runtime.commands.audit_archive import archive_sessions
from cutgate.runtime.commands.audit_folder import read_folder
from tests.runtime.audit.folders import folder_of
from tests.runtime.audit.test_series import codes, examined, head_of, series_of

# ---------------------------------------------------------------- what is moved


def chosen(sessions, **options):
    found = plan(examined(sessions, head_of(sessions[-1])), **options)
    return [sessions.index(one) for one in found.moved], {
        sessions.index(one.session): one for one in found.kept
    }


def without_starts(sessions):
    return [replace(one, starts=False) for one in sessions]


def test_all_but_the_newest_are_moved_or_all_before_a_time():
    sessions = without_starts(series_of(6))
    for keep in range(1, 8):
        assert chosen(sessions, keep=keep)[0] == list(range(6 - keep))
    for at in range(6):
        assert chosen(sessions, before_ns=sessions[at].opened_ns)[0] == list(range(at))


def test_the_newest_stays_whatever_is_asked():
    sessions = without_starts(series_of(3))
    moved, kept = chosen(sessions, before_ns=1 << 62)
    assert moved == [0, 1]
    assert (kept[2].why, kept[2].wrong) == ("it is the newest", False)


@pytest.mark.parametrize("started", range(5))
def test_all_from_the_last_start_on_stay(started):
    sessions = [replace(one, starts=at <= started) for at, one in enumerate(series_of(6))]
    moved, kept = chosen(sessions, keep=1)
    assert moved == list(range(started))
    assert sorted(kept) == list(range(started, 5))
    assert not any(one.wrong for one in kept.values())


def test_what_is_not_sound_stays_and_that_is_told():
    sessions = without_starts(series_of(6))
    sessions[1] = replace(sessions[1], status=Status.TAMPERED)
    sessions[2] = replace(sessions[2], status=Status.INCOMPLETE)
    sessions[3] = replace(sessions[3], head="00" * 32)  # session 4 names another
    moved, kept = chosen(sessions, keep=1)
    assert moved == [0, 2, 3]
    assert {at: one.wrong for at, one in kept.items()} == {1: True, 4: True}
    assert "link-differs" in kept[4].why


def test_what_is_archived_already_and_what_has_no_place_is_not_asked_for():
    sessions = without_starts(series_of(5))
    sessions[0] = replace(sessions[0], archived=True)
    copy = replace(sessions[1], file="copy.mcap")
    found = plan(examined([*sessions, copy], head_of(sessions[-1])), keep=1)
    assert [one.file for one in found.moved] == [one.file for one in sessions[1:4]]


def test_a_log_in_which_the_next_session_looks_for_a_place_stays():
    sessions = without_starts(series_of(4))
    named = withdrawn_by([f"ab {sessions[1].file}", f"cd {sessions[2].file} ef 2026", ""])
    assert named == {sessions[1].file}
    moved, kept = chosen(sessions, keep=1, named=named)
    assert moved == [0, 2]
    assert "WITHDRAWN" in kept[1].why


# ---------------------------------------------------------------- moving


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("made") / "logs"
    folder_of(directory, 3, crashed=(1,))
    return directory


@pytest.fixture
def folder(made, tmp_path):
    shutil.copytree(made, tmp_path / "logs")
    (tmp_path / "logs").chmod(0o700)
    (tmp_path / "old").mkdir()
    return tmp_path / "logs"


def digests(*folders: Path) -> dict[str, set[str]]:
    """Of each file of a session that is there: the digests of all that has its name."""
    found: dict[str, set[str]] = {}
    for folder in folders:
        for path in folder.iterdir() if folder.is_dir() else ():
            if path.suffix in (".mcap", ".log", ".json"):
                found.setdefault(path.name, set()).add(sha256(path.read_bytes()).hexdigest())
    return found


class Cut(BaseException):
    """The power fails."""


class Power:
    """It fails before the nth operation that changes the disk, and then nothing works any more."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
        self.left = at
        self.names: list[str] = []
        for owner, name in (
            (module.os, "write"), (module.os, "link"), (Path, "unlink"), (module, "sync_folder"),
            (module.os, "rename"), (module.os, "fsync"),
        ):  # fmt: skip
            monkeypatch.setattr(owner, name, self.cut(name, getattr(owner, name)))

    def cut(self, name, call):
        def changed(*arguments, **options):
            if self.left <= 0:
                raise Cut
            self.left -= 1
            self.names.append(name)
            return call(*arguments, **options)

        return changed


def run(folder: Path) -> None:
    with pytest.raises(Exception, match="0"):  # typer.Exit(0)
        archive_sessions(folder, to=folder.parent / "old", keep=1)


@pytest.mark.no_cover
def test_wherever_power_fails_nothing_is_lost_or_doubled_and_asking_again_completes_it(
    made, tmp_path, capsys
):
    whole = digests(made)
    steps = 0
    while True:
        folder, old = tmp_path / f"{steps}" / "logs", tmp_path / f"{steps}" / "old"
        shutil.copytree(made, folder)
        folder.chmod(0o700)
        with pytest.MonkeyPatch.context() as patch:
            power = Power(patch, steps)
            try:
                run(folder)
            except Cut:
                pass
            else:
                break
        there = digests(folder, old)
        assert there == whole, power.names
        found = read_folder(folder).found
        assert found.status is Status.INCOMPLETE, power.names
        unfinished = any(
            (folder / entry.name).exists()
            for path in folder.glob("*.archived")
            for entry in read_stub(path).moved
        )
        assert ("archive-unfinished" in codes(found)) is unfinished, power.names
        run(folder)
        assert digests(folder, old) == whole
        assert sorted(path.name for path in old.iterdir()) == sorted(digests(old))
        assert not digests(folder).keys() & digests(old).keys()
        assert read_folder(folder).found.status is Status.INCOMPLETE
        shutil.rmtree(folder.parent)
        steps += 1
    assert steps > 20
    assert {"write", "link", "unlink", "sync_folder", "rename", "fsync"} <= set(power.names)
    order = " ".join(power.names)
    assert order.count("write fsync link unlink sync_folder fsync") == len(digests(old)), order
    assert order.count("unlink") == order.count("unlink sync_folder fsync"), order
    capsys.readouterr()


def session(folder: Path, at: int = 0):
    return read_folder(folder).found.joined[at].session


def test_what_is_moved_is_the_same_and_its_stub_stays(folder):
    before, one = digests(folder), session(folder)
    stub = archive(folder, one, folder.parent / "old")
    names = [entry.name for entry in stub.moved]
    assert names[0] == one.file
    assert len(names) == 3
    assert digests(folder.parent / "old") == {name: before[name] for name in names}
    assert not any((folder / name).exists() for name in names)
    assert read_stub(folder / stub_name(one.file)) == stub


@pytest.mark.parametrize("kind", ["file", "link", "dangling", "folder"])
def test_nothing_is_overwritten(folder, kind):
    one, old = session(folder), folder.parent / "old"
    in_the_way = old / one.file
    other = folder.parent / "other"
    other.write_text("mine")
    match kind:
        case "file":
            in_the_way.write_text("mine")
        case "link":
            in_the_way.symlink_to(other)
        case "dangling":
            in_the_way.symlink_to("nowhere")
        case _:
            in_the_way.mkdir()
    before = digests(folder)
    with pytest.raises(InputError):
        archive(folder, one, old)
    assert digests(folder) == before
    assert not (folder / stub_name(one.file)).exists()
    assert other.read_text() == "mine"


def test_a_log_that_is_a_link_is_not_moved(folder):
    one = session(folder)
    elsewhere = folder.parent / "elsewhere.mcap"
    (folder / one.file).rename(elsewhere)
    (folder / one.file).symlink_to(elsewhere)
    with pytest.raises(InputError, match="symbolic link"):
        archive(folder, one, folder.parent / "old")
    assert elsewhere.exists()


def test_what_changed_since_it_was_copied_is_not_removed(folder):
    one, old = session(folder), folder.parent / "old"
    stub = archive(folder, one, old)
    shutil.copy(old / one.file, folder / one.file)
    with (folder / one.file).open("ab") as file:
        file.write(b"x")
    with pytest.raises(InputError, match="SHA-256"):
        removed(folder, stub, old)
    shutil.copy(old / one.file, folder / one.file)
    (old / one.file).write_bytes(b"lost")
    with pytest.raises(InputError, match="SHA-256"):
        removed(folder, stub, old)
    (old / one.file).unlink()
    with pytest.raises(InputError, match="name the folder that it was archived to"):
        removed(folder, stub, old)
    assert (folder / one.file).exists()


def test_a_full_disk_leaves_nothing_of_the_copy_and_the_log_where_it_was(folder, monkeypatch):
    def full(_descriptor, _data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    one, old = session(folder), folder.parent / "old"
    before = digests(folder)
    monkeypatch.setattr(module.os, "write", full)
    with pytest.raises(OSError, match="No space"):
        archive(folder, one, old)
    assert list(old.iterdir()) == []
    assert digests(folder) == before


def test_a_file_system_without_hard_links_will_do(folder, monkeypatch):
    def none(*_arguments, **_options):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    one, old = session(folder), folder.parent / "old"
    monkeypatch.setattr(module.os, "link", none)
    archive(folder, one, old)
    assert digests(old).keys() == {path.name for path in old.iterdir()}


def test_what_takes_the_name_meanwhile_is_not_overwritten(folder, monkeypatch):
    one, old = session(folder), folder.parent / "old"

    def taken(_fresh, copy, **_options):
        copy.write_text("mine")
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))

    monkeypatch.setattr(module.os, "link", taken)
    with pytest.raises(FileExistsError):
        archive(folder, one, old)
    assert [path.read_text() for path in old.iterdir()] == ["mine"]
    assert (folder / one.file).exists()


def test_a_copy_that_comes_back_otherwise_is_refused(folder, monkeypatch):
    one = session(folder)
    write = os.write
    monkeypatch.setattr(module.os, "write", lambda file, data: write(file, bytes(len(data))))
    with pytest.raises(InputError, match="another file"):
        copied(folder / one.file, folder.parent / "old")


def test_a_stub_that_would_not_tell_what_its_log_told_is_not_left(folder):
    one = session(folder)
    before = digests(folder)
    (folder / stub_name(one.file)).write_text("")
    with pytest.raises(InputError, match="is there already"):
        archive(folder, one, folder.parent / "old")
    (folder / stub_name(one.file)).unlink()
    for change in ({"root": "00" * 32}, {"size": one.size + 1}, {"enrolled": None}):
        with pytest.raises(InputError, match="stub"):
            archive(folder, replace(one, **change), folder.parent / "old")
    assert digests(folder) == before


def test_a_file_that_is_no_stub_is_refused(folder):
    (folder / "x.archived").write_text("{}")
    (folder / "x.archived").chmod(0o600)
    with pytest.raises(InputError, match="no stub"):
        read_stub(folder / "x.archived")
