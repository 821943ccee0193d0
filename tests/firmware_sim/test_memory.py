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
from cutgate.protocol.records import TreeHead
from cutgate.protocol.states import StopCause

ONE, TWO, THREE = bytes(range(32)), bytes(32), b"x" * 32
LOG = TreeHead(b"l" * 16, 41, b"t" * 32)
REMEMBERED = Memory(frozenset({ONE}), frozenset({TWO}), 17, True, LOG, StopCause.SECOND_NODE)
CONVERTED_US = 1_800_000_000_000_000
EMPTY = {
    "withdrawn": [],
    "earlier": [],
    "barrier_us": 0,
    "withdrawal_due": False,
    "log": {"log_id": "00" * 16, "size": 0, "root": "00" * 32},
    "latched": "NONE",
}
EARLIER = {"named": [], "withdrawn": [], "latched": "NONE"}


def load(file):
    return memory.load(file, now_us=CONVERTED_US)


def _document(schema, content):
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    return json.dumps({"schema": schema, "content": content, "sha256": digest})


def _text(**changes):
    """A memory with the right schema and digest, except for what is changed in its content."""
    return _document("cutgate.sim-memory/2", EMPTY | changes)


def _earlier(**changes):
    """A memory of the schema before, except for what is changed in its content."""
    return _document("cutgate.sim-memory/1", EARLIER | changes)


def test_the_altered_memories_below_are_sound_but_for_the_alteration(file):
    for text in (_text(), _earlier()):
        file.write_text(text, encoding="ascii")
        assert load(file) == Memory()


@pytest.fixture
def file(tmp_path):
    return memory.beside(tmp_path / "key.hex")


def test_the_memory_lies_beside_its_key():
    assert memory.beside(Path("keys/a.key")) == Path("keys/a.key.sim-memory.json")


def test_a_file_is_read_up_to_200_bytes_for_each_registration_that_can_be_remembered():
    assert memory.BYTES_MAX == 200 * REGISTRATIONS_MAX


def test_a_new_controller_remembers_nothing(file):
    assert load(file) == Memory()


digests = st.frozensets(st.binary(min_size=32, max_size=32), max_size=5)


@settings(max_examples=20)
@given(
    remembered=st.builds(
        Memory,
        digests,
        digests,
        st.integers(0, (1 << 63) - 1),
        st.booleans(),
        st.builds(
            TreeHead,
            st.binary(min_size=16, max_size=16),
            st.integers(0, (1 << 64) - 1),
            st.binary(min_size=32, max_size=32),
        ),
        st.sampled_from(StopCause),
    )
)
def test_what_is_saved_is_what_is_loaded(tmp_path_factory, remembered):
    file = tmp_path_factory.mktemp("memory") / "m.json"
    memory.save(file, remembered)
    assert load(file) == remembered
    assert [entry.name for entry in file.parent.iterdir()] == ["m.json"]


def test_a_full_memory_is_saved_and_loaded_and_a_fuller_one_refused(file):
    full = frozenset(number.to_bytes(32, "big") for number in range(REGISTRATIONS_MAX))
    memory.save(file, Memory(withdrawn=full, earlier=full, log=LOG))
    assert load(file) == Memory(withdrawn=full, earlier=full, log=LOG)
    for fuller in (Memory(withdrawn=full | {THREE}), Memory(earlier=full | {THREE})):
        memory.save(file, fuller)
        with pytest.raises(ControllerMemoryError, match="at most 1000 digests of 32 bytes each"):
            load(file)


def test_no_changed_character_of_a_memory_is_believed(file):
    memory.save(file, REMEMBERED)
    _no_changed_character_is_believed(file)


def test_no_changed_character_of_a_memory_of_the_schema_before_is_believed(file):
    file.write_text(_earlier(named=[THREE.hex()], withdrawn=[ONE.hex()]), encoding="ascii")
    _no_changed_character_is_believed(file)


def _no_changed_character_is_believed(file):
    text = file.read_text(encoding="ascii")
    load(file)
    for at, character in enumerate(text):
        if character == " ":
            continue
        file.write_text(text[:at] + ("0" if character != "0" else "1") + text[at + 1 :], encoding="ascii")
        with pytest.raises(ControllerMemoryError, match=re.escape(file.name)):
            load(file)


def test_a_memory_of_the_schema_before_refuses_what_it_withdrew_and_all_that_was_registered_until_now(file):
    withdrawn = sorted([ONE.hex(), TWO.hex()])
    text = _earlier(named=[THREE.hex()], withdrawn=withdrawn, latched="SECOND_NODE")
    file.write_text(text, encoding="ascii")
    expected = Memory(earlier=frozenset({ONE, TWO}), barrier_us=CONVERTED_US, latched=StopCause.SECOND_NODE)
    assert load(file) == expected
    memory.save(file, expected)
    assert memory.load(file, now_us=CONVERTED_US + 1) == expected, "converted once"


def test_a_memory_of_the_schema_before_that_withdrew_nothing_has_no_barrier(file):
    text = _earlier(named=[THREE.hex()], latched="OPERATOR_STOP")
    file.write_text(text, encoding="ascii")
    assert load(file) == Memory(latched=StopCause.OPERATOR_STOP)


def test_a_full_memory_of_the_schema_before_is_converted(file):
    full = [number.to_bytes(32, "big") for number in range(REGISTRATIONS_MAX)]
    file.write_text(_earlier(withdrawn=[one.hex() for one in full]), encoding="ascii")
    assert load(file) == Memory(earlier=frozenset(full), barrier_us=CONVERTED_US)


@pytest.mark.parametrize("barrier_us", [-1, 1 << 63])
def test_a_barrier_that_no_session_can_tell_is_refused(file, barrier_us):
    file.write_text(_text(barrier_us=barrier_us), encoding="ascii")
    with pytest.raises(ControllerMemoryError, match=f"its barrier is {barrier_us} us, which no session"):
        load(file)


def test_nothing_else_is_refused_of_a_barrier(file):
    for barrier_us in (0, 1, (1 << 63) - 1):
        file.write_text(_text(barrier_us=barrier_us), encoding="ascii")
        assert load(file).barrier_us == barrier_us


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
        '{"schema": "cutgate.sim-memory/2", "content": []}',
        '{"schema": "cutgate.sim-memory/2", "content": {}}',
        '{"schema": ["cutgate.sim-memory/2"]}',
        _text(withdrawn=1),
        _text(withdrawn=[1]),
        _text(withdrawn=["zz"]),
        _text(withdrawn=None),
        _text(withdrawn=[ONE.hex()[:-2]]),
        _text(withdrawn=[ONE.hex(), ""]),
        _text(withdrawn=[ONE.hex(), TWO.hex()]),
        _text(withdrawn=[TWO.hex(), TWO.hex()]),
        _text(earlier=[ONE.hex().upper()]),
        _text(earlier=[ONE.hex()[:-2]]),
        _text(earlier=["\u00e9"]),
        _text(barrier_us=None),
        _text(barrier_us=True),
        _text(barrier_us=1.0),
        _text(barrier_us="1"),
        _text(withdrawal_due=0),
        _text(withdrawal_due=1),
        _text(withdrawal_due=None),
        _text(log=None),
        _text(log={}),
        _text(log=EMPTY["log"] | {"size": True}),
        _text(log=EMPTY["log"] | {"size": -1}),
        _text(log=EMPTY["log"] | {"root": ""}),
        _text(log=EMPTY["log"] | {"more": 1}),
        _earlier(withdrawn=[ONE.hex()[:-2]]),
        _earlier(withdrawn=[ONE.hex(), TWO.hex()]),
        _earlier(named=[ONE.hex()[:-2]]),
        _earlier(latched="SOMETHING"),
        _earlier(more=1),
        _document("cutgate.sim-memory/1", EMPTY),
        _document("cutgate.sim-memory/2", EARLIER),
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
        load(file)


@pytest.mark.parametrize("schema", ["cutgate.sim-memory/3", "cutgate.sim-memory/0", "", None, 1])
def test_a_memory_of_another_version_is_named_as_such(file, schema):
    file.write_text(json.dumps(json.loads(_text()) | {"schema": schema}), encoding="ascii")
    with pytest.raises(ControllerMemoryError, match=r"its schema is not cutgate\.sim-memory/2"):
        load(file)


def test_a_memory_that_cannot_be_read_is_refused(file):
    file.mkdir()
    with pytest.raises(ControllerMemoryError, match="not a regular file"):
        load(file)


def test_a_memory_is_never_written_through_a_link_at_a_name_that_can_be_guessed(file):
    """The victim is whatever whoever writes in the folder would like to have overwritten."""
    victim = file.with_name("victim")
    victim.write_text("precious", encoding="ascii")
    for name in (file.name + ".new", f".{file.name}.new"):
        file.with_name(name).symlink_to(victim)
    memory.save(file, REMEMBERED)
    memory.save(file, Memory())
    assert load(file) == Memory()
    assert victim.read_text(encoding="ascii") == "precious"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_memory_behind_a_link_is_refused(file):
    memory.save(file.with_name("elsewhere"), REMEMBERED)
    file.symlink_to("elsewhere")
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: is a symbolic link"):
        load(file)


def test_a_memory_of_another_user_is_refused(file, monkeypatch):
    memory.save(file, REMEMBERED)
    mine = os.geteuid()
    monkeypatch.setattr(ours.os, "geteuid", lambda: mine + 1)
    with pytest.raises(ControllerMemoryError, match=rf"{file.name}: owner is .*\(uid {mine}\), must be"):
        load(file)


def test_a_memory_that_others_can_write_is_refused(file):
    memory.save(file, REMEMBERED)
    file.chmod(0o622)
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: mode is 0622"):
        load(file)


def test_a_disk_that_fails_leaves_the_old_memory(file, monkeypatch):
    memory.save(file, REMEMBERED)

    def fail(_descriptor):
        raise OSError(28, "full")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ControllerMemoryError, match=f"{file.name}: the memory cannot be written: .*full"):
        memory.save(file, Memory())
    monkeypatch.undo()
    assert load(file) == REMEMBERED


# ---------------------------------------------------------------- what a fault makes of it


def test_a_writing_that_is_cut_short_leaves_what_there_was_and_half_of_the_new_one_beside_it(file):
    memory.save(file, REMEMBERED)
    memory.cut_short(file, Memory())
    assert load(file) == REMEMBERED
    (torn,) = file.parent.glob(f".{file.name}.*.new")
    assert stat.S_IMODE(torn.stat().st_mode) == 0o600
    memory.save(file, Memory())
    whole = file.read_bytes()
    assert torn.read_bytes() == whole[: len(whole) // 2]
    assert load(file) == Memory()


def test_where_nothing_was_remembered_a_writing_that_is_cut_short_leaves_nothing(file):
    memory.cut_short(file, REMEMBERED)
    assert not file.exists()
    assert load(file) == Memory()


def test_a_flipped_bit_is_one_and_is_found(file):
    memory.save(file, REMEMBERED)
    before = file.read_bytes()
    memory.flip_bit(file)
    after = file.read_bytes()
    assert [(at, a ^ b) for at, (a, b) in enumerate(zip(before, after, strict=True)) if a != b] == [
        (len(before) // 2, 1)
    ]
    with pytest.raises(ControllerMemoryError):
        load(file)


def test_of_no_file_no_bit_flips(file):
    memory.flip_bit(file)
    assert not file.exists()
