"""The controller's non-volatile memory: believed whole or not at all."""

import hashlib
import json
import os
import re
import stat
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.config import ours
from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.memory import ControllerMemoryError
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.states import StopCause

ONE, TWO = bytes(range(32)), bytes(32)
REMEMBERED = Memory(frozenset({ONE}), frozenset({TWO}), StopCause.SECOND_NODE)


def _text(**changes):
    """A memory with the right schema and digest, except for what is changed in its content."""
    content = {"named": [], "withdrawn": [], "latched": "NONE"} | changes
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    return json.dumps({"schema": "cutgate.sim-memory/1", "content": content, "sha256": digest})


def test_the_altered_memories_below_are_sound_but_for_the_alteration(file):
    file.write_text(_text(), encoding="ascii")
    assert memory.load(file) == Memory()


@pytest.fixture
def file(tmp_path):
    return memory.beside(tmp_path / "key.hex")


def test_the_memory_lies_beside_its_key():
    assert memory.beside(Path("keys/a.key")) == Path("keys/a.key.sim-memory.json")


def test_a_file_is_read_up_to_100_bytes_for_each_registration_that_can_be_remembered():
    assert memory.BYTES_MAX == 100 * REGISTRATIONS_MAX


def test_a_new_controller_remembers_nothing(file):
    assert memory.load(file) == Memory()


digests = st.frozensets(st.binary(min_size=32, max_size=32), max_size=5)


@settings(max_examples=20)
@given(remembered=st.builds(Memory, digests, digests, st.sampled_from(StopCause)))
def test_what_is_saved_is_what_is_loaded(tmp_path_factory, remembered):
    file = tmp_path_factory.mktemp("memory") / "m.json"
    memory.save(file, remembered)
    assert memory.load(file) == remembered
    assert [entry.name for entry in file.parent.iterdir()] == ["m.json"]


def test_a_full_memory_is_saved_and_loaded_and_a_fuller_one_refused(file):
    full = frozenset(number.to_bytes(32, "big") for number in range(REGISTRATIONS_MAX))
    for one in (Memory(named=full), Memory(withdrawn=full)):
        memory.save(file, one)
        assert memory.load(file) == one
    memory.save(file, Memory(named=full, withdrawn=frozenset({b"x" * 32})))
    with pytest.raises(ControllerMemoryError, match="at most 1000 digests"):
        memory.load(file)


def test_no_changed_character_of_a_memory_is_believed(file):
    memory.save(file, REMEMBERED)
    text = file.read_text(encoding="ascii")
    for at, character in enumerate(text):
        if character == " ":
            continue
        file.write_text(text[:at] + ("0" if character != "0" else "1") + text[at + 1 :], encoding="ascii")
        with pytest.raises(ControllerMemoryError, match=re.escape(file.name)):
            memory.load(file)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        '{"withdrawn": []}',
        '{"schema": "cutgate.sim-memory/2"}',
        '{"schema": "cutgate.sim-memory/1"}',
        '{"schema": "cutgate.sim-memory/1", "content": []}',
        _text(withdrawn=1),
        _text(withdrawn=[1]),
        _text(withdrawn=["zz"]),
        _text(withdrawn=None),
        _text(withdrawn=[ONE.hex()[:-2]]),
        _text(withdrawn=[ONE.hex(), ""]),
        _text(withdrawn=[TWO.hex(), ONE.hex()], named=[ONE.hex(), ONE.hex()]),
        _text(named=[ONE.hex().upper()]),
        _text(named=["\u00e9"]),
        _text(latched="SOMETHING"),
        _text(latched=9),
        _text(more=1),
        "[" * 5000,
        " " * (memory.BYTES_MAX + 1),
    ],
)
def test_a_memory_that_cannot_be_believed_is_refused_and_names_its_file(file, text):
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ControllerMemoryError, match=re.escape(file.name)):
        memory.load(file)


@pytest.mark.parametrize("schema", ["cutgate.sim-memory/2", "", None, 1])
def test_a_memory_of_another_version_is_named_as_such(file, schema):
    file.write_text(json.dumps(json.loads(_text()) | {"schema": schema}), encoding="ascii")
    with pytest.raises(ControllerMemoryError, match=r"its schema is not cutgate\.sim-memory/1"):
        memory.load(file)


def test_a_memory_that_cannot_be_read_is_refused(file):
    file.mkdir()
    with pytest.raises(ControllerMemoryError, match="not a regular file"):
        memory.load(file)


def test_a_memory_is_never_written_through_a_link_at_a_name_that_can_be_guessed(file):
    """The victim is whatever whoever writes in the folder would like to have overwritten."""
    victim = file.with_name("victim")
    victim.write_text("precious", encoding="ascii")
    for name in (file.name + ".new", f".{file.name}.new"):
        file.with_name(name).symlink_to(victim)
    memory.save(file, REMEMBERED)
    memory.save(file, Memory())
    assert memory.load(file) == Memory()
    assert victim.read_text(encoding="ascii") == "precious"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_memory_behind_a_link_is_refused(file):
    memory.save(file.with_name("elsewhere"), REMEMBERED)
    file.symlink_to("elsewhere")
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: is a symbolic link"):
        memory.load(file)


def test_a_memory_of_another_user_is_refused(file, monkeypatch):
    memory.save(file, REMEMBERED)
    mine = os.geteuid()
    monkeypatch.setattr(ours.os, "geteuid", lambda: mine + 1)
    with pytest.raises(ControllerMemoryError, match=rf"{file.name}: owner is .*\(uid {mine}\), must be"):
        memory.load(file)


def test_a_memory_that_others_can_write_is_refused(file):
    memory.save(file, REMEMBERED)
    file.chmod(0o622)
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: mode is 0622"):
        memory.load(file)


def test_a_disk_that_fails_leaves_the_old_memory(file, monkeypatch):
    memory.save(file, REMEMBERED)

    def fail(_descriptor):
        raise OSError(28, "full")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: the memory cannot be written: .*full"):
        memory.save(file, Memory())
    monkeypatch.undo()
    assert memory.load(file) == REMEMBERED
