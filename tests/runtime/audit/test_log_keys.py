"""The key of a log directory: no crash lets one key sign two sessions or leaves an epoch out, and what is no key is refused."""

import errno
import itertools
import json
import os
import stat
from dataclasses import FrozenInstanceError, replace

import pytest
from mcap.writer import CompressionType, Writer

from cutgate.config.load import InputError
from cutgate.runtime.audit import log_keys
from cutgate.runtime.audit.directory import HEAD, Previous
from cutgate.runtime.audit.disk import SystemDisk
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.log_keys import (
    ENROLLED_ANEW,
    ENROLLED_HERE,
    check_key,
    default_path,
    held_key,
    key_in_log,
    new_log_key,
    public_path,
    put_following,
    to_continue,
)
from cutgate.runtime.audit.signing.log_key import EPOCH_MAX, LogKey, PublicLogKey
from cutgate.runtime.audit.writer import LogWriter
from cutgate.runtime.commands.audit_folder import read_folder
from tests.logs import create, judged
from tests.runtime.audit.build import OPENED, PATIENCE_S, Ticking, WatchedDisk, decision, forge

DISK = SystemDisk()
SERIES = bytes(range(16))


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    """A state directory of this test's own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "cutgate" / "log-keys"


@pytest.fixture
def room(tmp_path):
    """Runs sessions in one log directory, a minute apart; what record 0 of each says."""
    clock = Ticking()
    folder = tmp_path / "logs"

    def session(disk=None, **options):
        clock.now_ns += 60_000_000_000
        log = create(
            folder, log_id=os.urandom(16).hex(), opened=OPENED, clock=clock.clock(), disk=disk, **options
        )
        paths = log.close(final_state="done", clean=True, timeout_s=PATIENCE_S)
        return judged(paths.log).of("/audit/open")[0]

    session.folder = folder
    return session


def key_in(path):
    return LogKey.parse(path.read_bytes())


def the_key(state):
    (path,) = state.glob("*.key")
    return path


def stored(path, *, series=SERIES, epoch=1, certificate=None):
    path.write_bytes(LogKey(series, epoch, bytes(32), certificate).encode())
    path.chmod(0o600)
    return path


def refusal(call, *arguments):
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return caught.value.problems[0]


# ---------------------------------------------------------------- sessions


def test_each_session_has_a_key_that_the_one_before_it_certifies(room, state):
    records = [room() for _ in range(4)]
    assert [record["epoch"] for record in records] == [1, 2, 3, 4]
    assert [record.get("enrolled") for record in records] == [ENROLLED_HERE, None, None, None]
    keys = [
        PublicLogKey(
            bytes.fromhex(record["series"]), record["epoch"], bytes.fromhex(record["public_key"]),
            bytes.fromhex(record.get("certificate", "")) or None,
        )
        for record in records
    ]  # fmt: skip
    assert all(before.certifies(after) for before, after in itertools.pairwise(keys))
    assert len({key.public for key in keys}) == 4
    following = key_in(the_key(state))
    assert keys[-1].certifies(following.public), "the file holds the next session's key"
    assert [record.get("previous_epoch") for record in records] == [None, 1, 2, 3]
    assert not any("previous_note" in record for record in records), "nothing is missing"


def test_the_first_session_puts_the_key_outside_the_log_directory_for_its_owner_alone(room, state):
    record = room()
    path = the_key(state)
    assert path.name == f"{record['series']}.key"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(public_path(path).stat().st_mode) & 0o444 == 0o444, "it is for others"
    public = PublicLogKey.parse(public_path(path).read_bytes())
    assert public.public.hex() == record["public_key"]
    assert not [file for file in room.folder.iterdir() if "key" in file.name]


def test_no_secret_stands_in_the_log_directory(room, state):
    room()
    secret = key_in(the_key(state)).secret
    room()
    for file in room.folder.iterdir():
        assert secret not in file.read_bytes()
        assert secret.hex().encode() not in file.read_bytes()


def crashing(operation, number):
    def trouble(name, count):
        if (name, count) == (operation, number):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    return trouble


@pytest.mark.parametrize(
    ("operation", "number", "epoch"),
    [
        pytest.param("replace", 0, 3, id="HEAD is not written"),
        pytest.param("write", 0, 3, id="record 0 is not written"),
        pytest.param("sync", 0, 4, id="record 0 is written and not synced"),
        pytest.param("replace", 1, 4, id="the key is not replaced"),
    ],
)
def test_a_session_cut_short_while_it_begins_leaves_no_key_used_twice_and_no_epoch_out(
    room, operation, number, epoch
):
    room()
    second = room()
    assert second["epoch"] == 2
    problem = refusal(lambda: room(WatchedDisk(trouble=crashing(operation, number))))
    assert "Input/output error" in f"{problem.value} {problem.bound}"
    following = room()
    assert following["epoch"] == epoch, "a record 0 that may be on the disk has used its key"
    names = {
        judged(log).of("/audit/open")[0]["public_key"]
        for log in room.folder.glob("*.mcap")
        if judged(log).report.messages
    }
    epochs = sorted(
        record["epoch"] for log in room.folder.glob("*.mcap") for record in judged(log).of("/audit/open")
    )
    assert epochs == list(range(1, epoch + 1))
    assert len(names) == epoch
    assert following["previous_crashed"] is (epoch == 4), "only what has a record 0 is a session"
    assert following["previous_epoch"] == epoch - 1
    read = read_folder(room.folder)
    codes = {one.code for one in read.found.findings if one.status is not Status.OK}
    assert read.found.status is Status.INCOMPLETE, codes
    assert ("before-record-0" in codes) == (epoch == 3), "an empty file, whether HEAD has named it or not"


def test_a_log_that_never_got_a_record_leaves_the_one_before_as_the_session_before(room):
    first = room()
    refusal(lambda: room(WatchedDisk(trouble=crashing("write", 0))))
    second = room()
    assert second["epoch"] == 2
    assert second["previous_root"]
    assert second["previous_epoch"] == first["epoch"]
    assert "was begun, and cut short before its first record" in second["previous_note"]


def test_what_a_session_that_was_cut_short_had_prepared_is_removed(room, state):
    room()
    left = the_key(state).with_name(f".{the_key(state).name}.0123.new")
    left.write_bytes(b"half a key")
    sidecar = room.folder / ".a.signature.json.0123.new"
    sidecar.write_bytes(b"half a signature")
    room()
    assert not left.exists()
    assert not sidecar.exists()


# ---------------------------------------------------------------- an old key, a lost key, another's


def test_a_key_of_a_backup_is_refused_and_a_new_one_enrolled_goes_on(room, state, tmp_path):
    room()
    old = the_key(state).read_bytes()
    room()
    room()
    the_key(state).write_bytes(old)
    problem = refusal(room)
    assert (problem.key, problem.value) == ("epoch", "2")
    assert "an older key has signed already" in problem.bound
    assert f"cutgate key new --log FILE --continues {room.folder}" in problem.remedy
    series, epoch = to_continue(room.folder)
    made = new_log_key(tmp_path / "anew.key", series=series, epoch=epoch)
    assert (made.epoch, made.certificate) == (4, None)
    record = room(key_file=tmp_path / "anew.key")
    assert (record["epoch"], record["enrolled"], record.get("certificate")) == (4, ENROLLED_ANEW, None)
    assert room(key_file=tmp_path / "anew.key")["certificate"]


@pytest.mark.parametrize("since", [1, 2])
def test_a_folder_of_a_backup_misses_the_sessions_since(room, since):
    room()
    kept = {file: file.read_bytes() for file in room.folder.iterdir()}
    for _ in range(since):
        room()
    for file in room.folder.iterdir():
        file.unlink()
    for file, data in kept.items():
        file.write_bytes(data)
        file.chmod(0o600)
    record = room()
    assert (record["epoch"], record["previous_epoch"]) == (2 + since, 1)
    assert f"sessions 2 to {1 + since} of this log directory are missing from it" in record["previous_note"]


def test_a_lost_key_is_refused_with_what_to_do(room, state):
    room()
    the_key(state).unlink()
    problem = refusal(room)
    assert problem.bound == "there is no such log key"
    assert "--continues" in problem.remedy


def test_a_key_of_another_directory_is_refused(room, tmp_path):
    room()
    problem = refusal(lambda: room(key_file=stored(tmp_path / "other.key", epoch=2)))
    assert problem.key == "series"
    assert "--log-key" in problem.remedy


def test_a_first_session_takes_no_key_that_has_signed_elsewhere(room, tmp_path):
    for epoch, certificate in ((2, None), (1, bytes(64))):
        path = stored(tmp_path / "used.key", epoch=epoch, certificate=certificate)
        assert refusal(lambda: room(key_file=path)).key == "epoch"  # noqa: B023 - called at once
    assert room(key_file=stored(tmp_path / "used.key"))["enrolled"] == ENROLLED_HERE


def test_a_missing_key_of_a_first_session_is_refused(room, tmp_path):
    assert (
        "make one with: cutgate key new --log FILE"
        in refusal(lambda: room(key_file=tmp_path / "missing.key")).remedy
    )


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff", b"[" * 900, b'{"schema": "cutgate.log-key/1"}'])
def test_what_is_no_key_is_refused(room, tmp_path, content):
    path = tmp_path / "no.key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert refusal(lambda: room(key_file=path)).bound.startswith("no log key: ")


def test_a_key_that_others_may_read_is_refused(room, tmp_path):
    path = stored(tmp_path / "open.key")
    path.chmod(0o644)
    assert refusal(lambda: room(key_file=path)).key == "mode"


def test_what_is_held_says_whether_it_was_made_and_may_not_change(tmp_path):
    (tmp_path / "state" / "cutgate" / "log-keys").mkdir(parents=True)
    made = held_key(tmp_path, Previous(), None, DISK)
    given = held_key(tmp_path, Previous(), stored(tmp_path / "a.key"), DISK)
    assert (made.made, given.made) == (True, False)
    assert made.noted(Previous(note="a")).note == "a"
    assert replace(made, note="b").noted(Previous(note="a")).note == "a; b"
    assert not hasattr(made, "__dict__")
    with pytest.raises(FrozenInstanceError):
        made.made = False


def test_a_directory_of_which_head_names_no_epoch_has_used_none(tmp_path):
    """A HEAD that says so is none that a session writes; the first epoch counts all the same."""
    path = stored(tmp_path / "a.key")
    for epoch in (None, 0):
        held = held_key(tmp_path, Previous(series=SERIES, epoch=epoch), path, DISK)
        assert (held.key.epoch, held.note) == (1, None)
    assert key_in(path).epoch == 1, "it is not replaced"


def test_the_last_epoch_has_none_behind_it(tmp_path):
    with pytest.raises(ValueError, match="is the last one"):
        LogKey(SERIES, EPOCH_MAX, bytes(32)).following(bytes(32))


def test_a_head_that_has_lost_its_series_begins_no_new_one(room, state):
    """A line taken out of HEAD would end the series, and enrol whoever comes next."""
    room()
    head = json.loads((room.folder / HEAD).read_bytes())
    (room.folder / HEAD).write_bytes(json.dumps({k: v for k, v in head.items() if k != "series"}).encode())
    problem = refusal(room)
    assert (problem.key, problem.value) == ("series", "missing")
    assert refusal(check_key, room.folder, None).key == "series"
    assert [file.name for file in state.glob("*.key")] == [f"{head['series']}.key"]
    assert refusal(room).key == "series", "nothing was changed by the try"


@pytest.mark.parametrize("content", [b"", b"no log", bytes(5000)])
def test_where_there_is_no_log_there_is_no_key_in_it(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(content)
    assert key_in_log(tmp_path / "a.mcap") is None
    assert key_in_log(tmp_path / "missing.mcap") is None
    os.mkfifo(tmp_path / "pipe.mcap")
    assert key_in_log(tmp_path / "pipe.mcap") is None, "nobody is waited for"
    assert key_in_log(tmp_path) is None


def test_a_record_0_that_is_no_object_names_no_key(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("cutgate.audit/1", "x")
        schema = writer.register_schema("cutgate.Open", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/audit/open", "json", schema), 0, b"7", 0)
        writer.finish()
    assert key_in_log(tmp_path / "a.mcap") is None


def test_the_key_in_a_log_is_that_of_its_record_0(room, tmp_path):
    record = room()
    (log,) = room.folder.glob("*.mcap")
    assert key_in_log(log).public.hex() == record["public_key"]
    other = LogWriter("ab" * 16, {})
    other.add(decision(1), log_time_ns=0, monotonic_ns=0)
    other.finish()
    (tmp_path / "other.mcap").write_bytes(other.take())
    assert key_in_log(tmp_path / "other.mcap") is None
    (tmp_path / "bad.mcap").write_bytes(
        forge(
            log.read_bytes(),
            lambda one: one.model_copy(update={"epoch": 0}) if one.TOPIC == "/audit/open" else one,
        )
    )
    assert key_in_log(tmp_path / "bad.mcap") is None
    log.chmod(0o000)
    assert os.geteuid() == 0 or key_in_log(log) is None


# ---------------------------------------------------------------- files


def test_a_new_key_is_never_put_over_another_file(tmp_path):
    new_log_key(tmp_path / "a.key")
    problem = refusal(new_log_key, tmp_path / "a.key")
    assert (problem.file, problem.bound) == (str(tmp_path / "a.key"), "exists and is never overwritten")
    (tmp_path / "b.key.pub").write_bytes(b"")
    problem = refusal(new_log_key, tmp_path / "b.key")
    assert (problem.file, problem.bound) == (str(tmp_path / "b.key.pub"), "exists and is never overwritten")


def test_a_key_that_cannot_be_written_is_refused(tmp_path):
    problem = refusal(new_log_key, tmp_path / "nowhere" / "a.key")
    assert "cannot be written" in problem.bound
    held = held_key(tmp_path, Previous(), stored(tmp_path / "a.key"), DISK)
    full = WatchedDisk(trouble=crashing("replace", 0))
    assert "cannot be written" in refusal(put_following, held, full).bound
    assert key_in(tmp_path / "a.key") == held.key, "the old one stands"


def test_a_state_directory_that_cannot_be_made_is_refused(room, tmp_path):
    (tmp_path / "state").write_bytes(b"a file")
    assert "cannot be written" in refusal(room).bound


def test_where_a_key_is_kept_goes_by_the_users_state_directory(tmp_path, monkeypatch):
    name = f"cutgate/log-keys/{SERIES.hex()}.key"
    assert default_path(SERIES) == tmp_path / "state" / name
    for given in ("", "relative"):
        monkeypatch.setenv("XDG_STATE_HOME", given)
        monkeypatch.setenv("HOME", str(tmp_path))
        assert default_path(SERIES) == tmp_path / ".local/state" / name
    monkeypatch.delenv("HOME")
    assert default_path(SERIES).is_absolute()

    def unknown(_uid):
        raise KeyError

    monkeypatch.setattr(log_keys.pwd, "getpwuid", unknown)
    assert "--log-key" in refusal(default_path, SERIES).remedy


def test_only_a_directory_with_a_signed_session_can_be_continued(tmp_path):
    assert "HEAD of a log directory" in refusal(to_continue, tmp_path).bound
    (tmp_path / HEAD).write_bytes(json.dumps({"log": "a.mcap", "head": None, "state": "closed"}).encode())
    (tmp_path / HEAD).chmod(0o600)
    assert "HEAD of a log directory" in refusal(to_continue, tmp_path).bound


def test_a_look_refuses_what_a_session_would_and_changes_nothing(room, state, tmp_path):
    check_key(tmp_path, None)
    check_key(tmp_path, stored(tmp_path / "new.key"))
    assert refusal(check_key, tmp_path, tmp_path / "missing.key").bound == "there is no such log key"
    room()
    before = the_key(state).read_bytes()
    check_key(room.folder, None)
    assert refusal(check_key, room.folder, tmp_path / "new.key").key == "series"
    assert the_key(state).read_bytes() == before
    room()
    the_key(state).write_bytes(LogKey(key_in(the_key(state)).series, 1, bytes(32)).encode())
    assert refusal(check_key, room.folder, None).key == "epoch"


def test_record_0_is_a_chunk_of_its_own(room, state):
    """Nothing else is on the disk before the next session's key is in this one's place."""
    seen = []

    class Watching(SystemDisk):
        def replace(self, prepared, data):
            if b"log-key" in data:
                (log,) = room.folder.glob("*.mcap")
                seen.append(judged(log).report.messages)
            super().replace(prepared, data)

    room(Watching())
    assert seen == [1]
