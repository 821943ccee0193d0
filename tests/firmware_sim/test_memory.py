"""The controller's non-volatile memory: believed whole or not at all."""

import json
import os
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim import memory
from firmware_sim.memory import ControllerMemoryError

ONE, TWO = bytes(range(32)), bytes(32)


@pytest.fixture
def file(tmp_path):
    return memory.beside(tmp_path / "key.hex")


def test_the_memory_lies_beside_its_key():
    assert memory.beside(Path("keys/a.key")) == Path("keys/a.key.sim-memory.json")


def test_a_new_controller_has_withdrawn_nothing(file):
    assert memory.load(file) == frozenset()


@settings(max_examples=20)
@given(withdrawn=st.frozensets(st.binary(min_size=32, max_size=32), max_size=5))
def test_what_is_saved_is_what_is_loaded(tmp_path_factory, withdrawn):
    file = tmp_path_factory.mktemp("memory") / "m.json"
    memory.save(file, withdrawn)
    assert memory.load(file) == withdrawn
    assert [entry.name for entry in file.parent.iterdir()] == ["m.json"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        '{"withdrawn": 1}',
        '{"withdrawn": [1]}',
        '{"withdrawn": ["zz"]}',
        '{"withdrawn": null}',
        json.dumps({"withdrawn": [ONE.hex()[:-2]]}),
        json.dumps({"withdrawn": [ONE.hex(), ""]}),
        '{"withdrawn": ["\u00e9"]}',
    ],
)
def test_a_memory_that_cannot_be_believed_is_refused_and_names_its_file(file, text):
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ControllerMemoryError, match=re.escape(file.name)):
        memory.load(file)


def test_a_memory_that_cannot_be_read_is_refused(file):
    file.mkdir()
    with pytest.raises(ControllerMemoryError, match="Is a directory"):
        memory.load(file)


def test_the_new_memory_is_durable_before_it_replaces_the_old(file, monkeypatch):
    """File first, then its name, then the directory: after a crash there is the old memory or the new one."""
    acts = []
    sync, replace = os.fsync, Path.replace

    def watched_sync(descriptor):
        acts.append(("sync", Path(f"/proc/self/fd/{descriptor}").readlink().name))
        sync(descriptor)

    def watched_replace(path, target):
        acts.append(("replace", path.name))
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", watched_sync)
    monkeypatch.setattr(Path, "replace", watched_replace)
    memory.save(file, frozenset({ONE}))
    new = file.name + ".new"
    assert acts == [("sync", new), ("replace", new), ("sync", file.parent.name)]


def test_a_disk_that_fails_leaves_the_old_memory(file, monkeypatch):
    memory.save(file, frozenset({ONE}))

    def fail(_descriptor):
        raise OSError(28, "full")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="full"):
        memory.save(file, frozenset({ONE, TWO}))
    monkeypatch.undo()
    assert memory.load(file) == {ONE}
