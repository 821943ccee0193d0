"""What is kept of a test that failed: everything but keys, and where it lies is said."""

import pytest

from cutgate.firmware_sim.hil import kept
from cutgate.firmware_sim.hil.kept import artefacts


@pytest.fixture
def folder(tmp_path):
    """Of a test."""
    (tmp_path / "test").mkdir()
    return tmp_path / "test"


def test_of_a_failure_everything_is_copied_but_keys_and_links(folder, tmp_path):
    (folder / "logs").mkdir()
    for name in (
        "logs/a.mcap",
        "logs/a.candump.log",
        "bus.candump.log",
        "1-runtime.txt",
        "site.key",
        "state",
    ):
        (folder / name).write_text(name, encoding="utf-8")
    (folder / "link.txt").symlink_to(folder / "site.key")
    for number in ("", "-2", "-3"):
        place = tmp_path / "kept" / f"test_a.py_test_b_1-2_{number}"
        lines = artefacts(folder, (), tmp_path / "kept", "test_a.py::test_b[1-2]")
        assert lines == sorted(
            str(place / name)
            for name in ("1-runtime.txt", "bus.candump.log", "logs/a.candump.log", "logs/a.mcap")
        )


@pytest.mark.parametrize("copies", [0, 1])
def test_what_cannot_be_copied_stays_where_it_lies_and_that_is_said(folder, tmp_path, monkeypatch, copies):
    (folder / "1-runtime.txt").write_text("x", encoding="utf-8")
    monkeypatch.setattr(kept, "COPIES_MAX", copies)
    directory = tmp_path / "kept"
    if copies:
        directory.write_text("a file", encoding="utf-8")
    said, left = artefacts(folder, (), directory, "test")
    assert said.startswith(f"not copied to {directory}: ")
    assert left == str(folder / "1-runtime.txt")


@pytest.mark.processes
def test_a_log_that_no_page_can_be_made_of_is_named(folder):
    (folder / "logs").mkdir()
    log = folder / "logs" / "a.mcap"
    log.write_text("no log", encoding="utf-8")
    trouble, left = artefacts(folder, [log], None, "test")
    assert trouble.startswith("no report page: ")
    assert left == str(log)
