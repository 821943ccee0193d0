"""``cutgate key``: a new one, its fingerprint, and the keys of one session."""

import fcntl
import stat
from dataclasses import replace
from pathlib import Path

import pytest

from cutgate.config.key import load_key, new_key_file
from cutgate.config.session_keys import load_review_key
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.audit.records import AuditPermit, AuditSession
from cutgate.runtime.commands import app as cli
from tests.runtime.audit.recomputed.coded import Coded
from tests.runtime.session.pair import KEY, job_of, pair_of

OTHER_KEY = KEY[::-1]
EARLIER = Path(__file__).parents[2] / "compat/0.1.0/sessions/20261127T072416Z-eea20e88.mcap"


def test_a_new_key_is_readable_by_its_owner_only_and_can_be_loaded(tmp_path, capsys):
    assert cli.execute(["key", "new", str(tmp_path / "k")]) == 0
    assert stat.S_IMODE((tmp_path / "k").stat().st_mode) == 0o600
    assert len(load_key(tmp_path / "k")) == 32
    assert "keep it secret" in capsys.readouterr().err


def test_two_new_keys_differ(tmp_path):
    for name in "ab":
        assert cli.execute(["key", "new", str(tmp_path / name)]) == 0
    assert load_key(tmp_path / "a") != load_key(tmp_path / "b")


def test_a_key_is_never_overwritten(tmp_path, capsys):
    (tmp_path / "k").write_text("old", encoding="utf-8")
    assert cli.execute(["key", "new", str(tmp_path / "k")]) == 2
    assert (tmp_path / "k").read_text(encoding="utf-8") == "old"
    assert "never overwritten" in capsys.readouterr().err


def test_a_folder_that_does_not_exist_is_refused(tmp_path, capsys):
    assert cli.execute(["key", "new", str(tmp_path / "no" / "k")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_key_without_a_verb_shows_help_and_exits_2():
    assert cli.execute(["key"]) == 2


def test_a_fingerprint_is_told_when_a_key_is_made_and_asked_for_later(tmp_path, capsys):
    assert cli.execute(["key", "new", str(tmp_path / "k")]) == 0
    digits = fingerprint(load_key(tmp_path / "k"))
    assert f"fingerprint {digits}. Give the controller the same file" in capsys.readouterr().err
    assert cli.execute(["key", "fingerprint", str(tmp_path / "k")]) == 0
    assert capsys.readouterr().out == f"{digits}\n"


def test_a_fingerprint_of_no_key_is_refused(tmp_path, capsys):
    assert cli.execute(["key", "fingerprint", str(tmp_path / "k")]) == 2
    assert "there is no such key file" in capsys.readouterr().err


# ---------------------------------------------------------------- the keys of one session


@pytest.fixture(scope="module")
def coded(tmp_path_factory):
    files, job = job_of(tmp_path_factory)
    job = replace(job, key_fingerprint=fingerprint(KEY))
    with pair_of(tmp_path_factory.mktemp("keys"), files, job) as pair:
        pair.end()
        return Coded.of(pair)


@pytest.fixture
def asked(tmp_path, capsys):
    """Writes a log and both keys, and asks for the keys of its session."""
    for name, key in (("key", KEY), ("other", OTHER_KEY)):
        new_key_file(tmp_path / name, key)

    def ask(log, key="key", out="session.json"):
        file = log if isinstance(log, Path) else tmp_path / "log.mcap"
        if not isinstance(log, Path):
            file.write_bytes(log)
        code = cli.execute(
            ["key", "session", str(file), "--key", str(tmp_path / key), "-o", str(tmp_path / out)]
        )
        return code, " ".join(capsys.readouterr().err.split())

    return ask


def test_the_keys_of_a_session_are_written_for_their_owner_alone_and_check_its_codes(coded, asked, tmp_path):
    code, told = asked(coded.log)
    assert code == 0
    assert f"Keys of session {coded.keys.codes.digest.hex()[:8]} of log {coded.keys.log_id} in " in told
    file = tmp_path / "session.json"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert load_review_key(file) == coded.keys
    assert coded.check(load_review_key(file)).answer == "yes"
    assert asked(coded.log)[0] == 2, "never overwritten"
    assert load_review_key(file) == coded.keys


def test_a_session_key_file_is_no_pre_shared_key(coded, asked, tmp_path, capsys):
    assert asked(coded.log)[0] == 0
    assert cli.execute(["key", "fingerprint", str(tmp_path / "session.json")]) == 2
    assert "it holds something else" in capsys.readouterr().err


def test_a_key_that_is_not_the_sessions_is_refused_with_both_fingerprints(coded, asked, tmp_path):
    code, told = asked(coded.log, "other")
    assert code == 2
    assert f"fingerprint is {fingerprint(OTHER_KEY)}, must be {fingerprint(KEY)}, that of the key" in told
    assert not (tmp_path / "session.json").exists()


def test_an_open_that_was_altered_gives_no_keys(coded, asked, tmp_path):
    (session,) = coded.read.of("/audit/session")
    other = coded.session(open=session["open"][:-10] + "0" + session["open"][-9:])
    code, told = asked(other.log)
    assert (code, (tmp_path / "session.json").exists()) == (2, False)
    assert "/audit/session cannot be read: " in told


@pytest.mark.parametrize("kind", ["of 0.1.0", "without its session", "with two"])
def test_a_log_without_one_session_is_refused(coded, asked, kind):
    log = EARLIER
    if kind == "without its session":
        log = coded.edited(lambda one: None if isinstance(one, AuditSession) else one).log
    elif kind == "with two":
        session = AuditSession(session="", open="", opened="")
        log = coded.edited(lambda one: session if isinstance(one, AuditPermit) else one).log
    code, told = asked(log)
    assert code == 2
    assert ("a log has one session" if kind == "with two" else "holds no OPEN and OPENED") in told


def test_of_a_session_that_may_be_running_no_keys_are_given_and_of_one_that_was_cut_off_they_are(
    coded, asked, tmp_path
):
    torn = coded.log[: len(coded.log) * 3 // 4]
    with (tmp_path / "LOCK").open("w") as lock:
        (tmp_path / "LOCK").chmod(0o600)
        fcntl.flock(lock, fcntl.LOCK_EX)
        code, told = asked(torn)
        assert code == 2
        assert "a session is running in its folder; wait until it has ended" in told
        assert asked(coded.log, out="closed.json")[0] == 0
    assert asked(torn)[0] == 0


@pytest.mark.parametrize("data", [b"", b"no log"])
def test_what_is_no_log_is_refused(asked, data):
    assert asked(data)[0] == 2
