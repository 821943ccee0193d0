"""``cutgate key``: a new one, and its fingerprint."""

import stat

from cutgate.config.key import load_key
from cutgate.protocol.codes import fingerprint
from cutgate.runtime.commands import app as cli


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
