"""``cutgate audit``: exit codes and what is printed."""

import errno
import json
import os
import re
import resource
import shutil
import subprocess
import tracemalloc

import pytest

from cutgate.config.interpreter import program
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.screen import output
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from tests.logs import judged, signature_of
from tests.runtime.audit.build import decision, forge, session_log, small_log
from tests.runtime.audit.test_replay import admit, in_document

WIDTH = 100


@pytest.fixture(scope="module")
def admitted(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted"))


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), 850.0)


def cutgate(capsys, *arguments):
    code = execute(["audit", *map(str, arguments)])
    found = capsys.readouterr()
    return code, found.out, found.err


def changed(paths, tmp_path, data):
    copy = tmp_path / paths.log.name
    copy.write_bytes(data)
    shutil.copy(paths.candump, tmp_path)
    return copy


# ---------------------------------------------------------------- verify


def test_verify_prints_ok_and_names_key_and_anchor(capsys, admitted):
    code, out, _ = cutgate(capsys, "verify", admitted.log)
    told = (
        rf"OK \(signed, key (?:[0-9a-f]{{4}} ?){{4}} from the log itself; no anchor given\): {admitted.log}"
    )
    assert code == 0
    assert re.fullmatch(told, out.splitlines()[0])


def test_verify_says_incomplete(capsys, admitted, tmp_path):
    copy = changed(admitted, tmp_path, admitted.log.read_bytes()[:-100])
    code, out, _ = cutgate(capsys, "verify", copy)
    assert code == 1
    assert out.startswith("INCOMPLETE")
    assert "no whole record" in out


def test_verify_names_the_first_bad_record(capsys, admitted, tmp_path):
    data = admitted.log.read_bytes()
    copy = changed(admitted, tmp_path, data.replace(b"time scale", b"time skale"))
    code, out, _ = cutgate(capsys, "verify", copy)
    assert code == 2
    assert out.startswith("TAMPERED")
    assert "chunk at offset" in out


def test_verify_finds_other_raw_frames(capsys, admitted, tmp_path):
    copy = changed(admitted, tmp_path, admitted.log.read_bytes())
    (tmp_path / admitted.candump.name).write_bytes(b"other\n")
    assert cutgate(capsys, "verify", copy)[0] == 2


def test_a_log_without_its_raw_frames_is_never_ok(capsys, admitted, tmp_path):
    copy = tmp_path / "log.mcap"
    copy.write_bytes(admitted.log.read_bytes())
    code, out, _ = cutgate(capsys, "verify", copy)
    assert code == 1
    assert out.startswith("INCOMPLETE")
    assert "the file of raw frames, whose SHA-256 the close record names, is not beside the log" in out


@pytest.mark.parametrize(
    ("size", "word"), [(8 << 30, "must be <= 4294967296 bytes"), (3 << 30, "not an audit log")]
)
@pytest.mark.parametrize("command", ["verify", "show", "replay"])
def test_a_huge_file_that_is_no_log_is_refused_unread(capsys, tmp_path, command, size, word):
    file = tmp_path / "sparse.mcap"
    file.write_bytes(b"")
    os.truncate(file, size)
    tracemalloc.start()
    code, out, err = cutgate(capsys, command, file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert code == (3 if command == "verify" else 2)
    assert word in out + err
    assert peak < 8 << 20


@pytest.mark.processes
@pytest.mark.parametrize("command", ["verify", "show", "replay"])
def test_a_log_is_read_within_the_memory_that_its_reader_needs_anyhow(admitted, command):
    """The address space of libraries and threads is most of it; 4 GiB were taken once, whatever the log's size."""
    limits = (1_500_000 << 10, 1_500_000 << 10)
    done = subprocess.run(
        [*program("cutgate.runtime.cli"), "audit", command, str(admitted.log)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, limits),
        capture_output=True,
        check=False,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert str(admitted.log) in done.stdout


def test_a_file_that_cannot_be_read_to_its_end_is_refused(capsys, admitted, tmp_path, monkeypatch):
    def fail(*_arguments):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("cutgate.runtime.audit.reading.read_log", fail)
    code, out, err = cutgate(capsys, "verify", admitted.log)
    assert (code, out) == (3, "")
    assert "cannot be read (Input/output error)" in err


def test_a_file_that_cannot_be_read_again_is_refused(capsys, admitted, monkeypatch):
    def fail(*_arguments):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("cutgate.runtime.audit.inspect.Log.each", fail)
    code, out, err = cutgate(capsys, "replay", admitted.log)
    assert (code, out) == (2, "")
    assert "cannot be read (Input/output error)" in err


@pytest.mark.parametrize("name", [names.PLAN + ".csv", names.PATH, names.SITE])
def test_an_attachment_that_is_larger_than_the_site_reads_files_is_not_replayed(
    capsys, tmp_path, monkeypatch, name
):
    site = b'schema = "cutgate.site/1"\n[files]\nfile_size_limit_mb = 1\n'
    paths = session_log(tmp_path, site=site)
    monkeypatch.setattr("cutgate.runtime.audit.recomputed.inputs.DEFAULT_LIMIT", 2_000_000)
    large = forge(
        paths.log.read_bytes(), attachments=lambda of, data: data + b" " * 2_000_001 if of == name else data
    )
    paths.log.write_bytes(large)
    code, out, _ = cutgate(capsys, "replay", paths.log)
    assert code == 2
    assert f"attachment {name} has" in out


@pytest.mark.parametrize("arguments", [[], ["--nothing", "x"], ["a", "b"], ["missing.mcap"], ["."]])
def test_verify_without_a_readable_file_is_unreadable(capsys, arguments):
    code, out, err = cutgate(capsys, "verify", *arguments)
    assert code == 3
    assert not out
    assert err


def test_verify_of_another_file_is_unreadable(capsys):
    code, out, _ = cutgate(capsys, "verify", "pyproject.toml")
    assert code == 3
    assert out.startswith("UNREADABLE")


def test_verify_as_one_json_document(capsys, admitted):
    code, out, _ = cutgate(capsys, "verify", admitted.log, "--json")
    document = json.loads(out)
    assert code == 0
    assert (document["status"], document["headline"], document["reasons"]) == (
        "OK",
        judged(admitted.log).report.headline,
        [],
    )


# ---------------------------------------------------------------- replay


def test_replay_of_an_admitted_session(capsys, admitted):
    code, out, _ = cutgate(capsys, "replay", admitted.log)
    assert code == 0
    assert out.startswith("IDENTICAL")
    assert "recomputed verdict: admissible" in out


def test_replay_finds_a_forged_verdict_that_verify_cannot(capsys, refused, tmp_path):
    data = forge(refused.log.read_bytes(), in_document(admit))
    copy = changed(refused, tmp_path, data)
    sidecar_of(copy).write_bytes(signature_of(data))
    assert cutgate(capsys, "verify", copy)[0] == 0
    code, out, _ = cutgate(capsys, "replay", copy)
    assert code == 1
    assert out.startswith("DIFFERS")
    assert "recorded admissible, recomputed inadmissible" in out


@pytest.mark.parametrize("arguments", [[], ["missing.mcap"], ["pyproject.toml"]])
def test_replay_of_no_log_is_bad_input(capsys, arguments):
    assert cutgate(capsys, "replay", *arguments)[0] == 2


def test_replay_as_one_json_document(capsys, refused):
    code, out, _ = cutgate(capsys, "replay", refused.log, "--json")
    document = json.loads(out)
    assert code == 0
    assert (document["outcome"], document["verdict"]["verdict"]) == ("IDENTICAL", "inadmissible")


# ---------------------------------------------------------------- show


def test_show_tells_the_story(capsys, admitted):
    code, out, _ = cutgate(capsys, "show", admitted.log)
    assert code == 0
    for text in (
        "OK (signed, key ",
        "time scale 20",
        "ADMISSIBLE",
        "wrist_singularity",
        "Approach and retract: ADMISSIBLE, entry 10.670 mm, exit 10.000 mm",
        "a -> b",
        "AUTHORISED",
        "SENT",
        "path.bin",
        str(admitted.log.name),
        str(admitted.candump.name),
    ):
        assert text in out, text
    files = (str(admitted.log), str(admitted.candump))
    assert max(len(line) for line in out.splitlines() if not line.endswith(files)) <= WIDTH
    assert "\x1b" not in out


def test_show_marks_what_is_violated(capsys, refused):
    out = cutgate(capsys, "show", refused.log)[1]
    assert re.search(r"^outer .*VIOLATED", out, re.MULTILINE)
    assert "INADMISSIBLE" in out


def test_show_as_one_json_document(capsys, admitted):
    document = json.loads(cutgate(capsys, "show", admitted.log, "--json")[1])
    assert document["schema"] == "cutgate.audit-show/1"
    (verdict,) = document["verdicts"]
    assert len(verdict["boundaries"]) == 11
    assert [entry["disposition"] for entry in document["decisions"]] == [
        "decided", "authorised", "sent", "authorised", "sent",
    ]  # fmt: skip
    assert document["closed"]["final_state"] == "done"
    assert document["decisions"][0]["offset_s"] > 0


@pytest.mark.parametrize(
    ("guidance", "line"),
    [
        (
            {"translation_mm": [-50.0, 0.0, 1.5], "yaw_deg": 0.0, "verified": True},
            "move the bone by (-50.000, 0.000, 1.500) mm (verified)",
        ),
        (
            {"translation_mm": [1.0, 2.0, 3.0], "yaw_deg": 4.0, "verified": False},
            "mm, turn it by 4.000 deg about the vertical (NOT verified)",
        ),
        ({"translation_mm": None, "yaw_deg": 0.0, "verified": False}, "no translation was found"),
        (None, ""),
    ],
)
def test_show_repeats_the_guidance(capsys, refused, tmp_path, guidance, line):
    def guide(document):
        document["guidance"] = guidance

    copy = changed(refused, tmp_path, forge(refused.log.read_bytes(), in_document(guide)))
    out = cutgate(capsys, "show", copy)[1]
    assert line in " ".join(out.split())
    assert ("Guidance" in out) == bool(guidance)


def test_show_says_why_a_path_is_refused(capsys, refused, tmp_path):
    def reason(record):
        changes = {"reason": "the outer boundary"}
        return record.model_copy(update=changes) if isinstance(record, records.AuditVerdict) else record

    copy = changed(refused, tmp_path, forge(refused.log.read_bytes(), reason))
    assert "\n  the outer boundary\n" in cutgate(capsys, "show", copy)[1]


def test_a_verdict_without_document_has_no_guidance(refused):
    data = forge(
        refused.log.read_bytes(),
        lambda record: (
            record.model_copy(update={"document": "{"})
            if isinstance(record, records.AuditVerdict)
            else record
        ),
    )
    assert story(read_log(data), refused.log, None)["verdicts"][0]["guidance"] is None


@pytest.mark.parametrize("arguments", [[], ["missing.mcap"], ["pyproject.toml"]])
def test_show_of_no_log_is_bad_input(capsys, arguments):
    assert cutgate(capsys, "show", *arguments)[0] == 2


def test_show_of_a_cut_log_says_what_is_missing(capsys, admitted, tmp_path):
    data = admitted.log.read_bytes()
    copy = changed(admitted, tmp_path, data[: data.index(b'"final_state"') - 300])
    code, out, _ = cutgate(capsys, "show", copy)
    assert code == 0
    assert "INCOMPLETE" in out
    assert "no close record" in out


def test_show_of_a_damaged_log_warns_and_shows_the_rest(capsys, admitted, tmp_path):
    data = bytearray(admitted.log.read_bytes())
    data[-40] ^= 1
    code, out, _ = cutgate(capsys, "show", changed(admitted, tmp_path, bytes(data)))
    assert code == 0
    assert "TAMPERED" in out
    assert "ADMISSIBLE" in out


def test_show_lists_what_went_wrong(capsys, tmp_path):
    """Faults, refused words, differing parameters, failing permissives, a crash before, equal steps as one."""
    failing = (
        records.PermissiveValue(name="bone [x]", holds=False, value=0.7, bound="<= 0.5 mm", remedy="move"),
        records.PermissiveValue(name="key", holds=False, text="none", bound="given", remedy="make one"),
        records.PermissiveValue(name="bus", holds=True, text="up", bound="up", remedy=""),
    )
    extra = [
        records.AuditOperator(word="start", accepted=False, reason="not yet"),
        records.AuditFault(source="controller", code="LATCHED", cause="SECOND_NODE", detail="seen"),
        records.AuditCollected(kind="limits", sha256="00", matches_approved=False),
        records.AuditCollected(kind="tool", sha256="00", matches_approved=True),
        decision(1, from_state="a", to_state="a"),
        decision(2, from_state="a", to_state="a"),
        decision(3, first_out="HEARTBEAT_LOST", reason="why", permissives=failing),
    ]
    paths = small_log(tmp_path, decisions=len(extra))
    queue = list(extra)

    def swap(record):
        if isinstance(record, records.AuditOpen):
            return record.model_copy(update={"previous_crashed": True, "previous_note": "gone"})
        if isinstance(record, records.AuditClose):
            return record.model_copy(update={"clean": False, "outcome": "stopped"})
        return queue.pop(0) if isinstance(record, records.AuditDecision) and queue else record

    paths.log.write_bytes(forge(paths.log.read_bytes(), swap))
    out = cutgate(capsys, "show", paths.log)[1]
    for text in (
        "operator: start (refused: not yet)",
        "fault of the controller: SECOND_NODE seen",
        "the controller's limits otherwise than approved",
        "(x2)",
        "first-out HEARTBEAT_LOST",
        "bone [x]: 0.700 mm (required: <= 0.5 mm)",
        "key: none (required: given)",
        "CRASHED (gone)",
        "stopped",
        "NOT in order",
    ):
        assert text in out, text
    assert "tool are not" not in out
    assert "bus:" not in out


def test_the_story_of_a_strange_log_is_told_without_an_error(tmp_path):
    data = forge(small_log(tmp_path).log.read_bytes(), lambda record: record)
    log = read_log(data.replace(b'"utc":', b'"utC":').replace(b'"monotonic"', b'"monotoniC"'))
    document = story(log, tmp_path / "x.mcap", None)
    print_story(output(), document)
    assert document["candump"] is None
    assert document["judgement"] == "TAMPERED"


# ---------------------------------------------------------------- several logs


@pytest.fixture
def four(admitted, refused, tmp_path):
    """Logs that are OK, OK, INCOMPLETE and TAMPERED, and a file that is none."""
    data = admitted.log.read_bytes()
    cut, forged, other = (tmp_path / name for name in ("cut.mcap", "forged.mcap", "other.mcap"))
    cut.write_bytes(data[:-100])
    forged.write_bytes(data.replace(b"time scale", b"time skale"))
    other.write_bytes(b"hello")
    for copy in (cut, forged):
        shutil.copy(admitted.candump, copy.with_suffix(".candump.log"))
    lies = tmp_path / "lies.mcap"
    lies.write_bytes(forge(refused.log.read_bytes(), in_document(admit)))
    shutil.copy(refused.candump, lies.with_suffix(".candump.log"))
    return {
        "ok": admitted.log, "too": refused.log, "cut": cut, "forged": forged, "other": other, "lies": lies
    }  # fmt: skip


@pytest.mark.parametrize(
    ("named", "worst"),
    [
        (("ok", "too"), 0),
        (("ok", "cut"), 1),
        (("cut", "other", "ok"), 3),
        (("other", "forged", "cut"), 2),
        (("ok", "absent"), 3),
    ],
)
def test_verify_takes_several_logs_and_the_worst_decides(capsys, four, tmp_path, named, worst):
    logs = [four.get(name, tmp_path / f"{name}.mcap") for name in named]
    code, out, err = cutgate(capsys, "verify", *logs)
    assert code == worst
    places = [(out + err).index(str(log)) for log in logs]
    assert len(places) == len(logs)
    code, out, _ = cutgate(capsys, "verify", "--json", *logs)
    documents = json.loads(out)
    assert code == worst
    assert [document["log"] for document in documents] == [str(log) for log in logs]


@pytest.mark.parametrize(
    ("named", "worst"),
    [(("ok", "too"), 0), (("ok", "other"), 2), (("other", "lies", "ok"), 1), (("ok", "absent"), 2)],
)
def test_replay_takes_several_logs_and_the_worst_decides(capsys, four, tmp_path, named, worst):
    logs = [four.get(name, tmp_path / f"{name}.mcap") for name in named]
    assert cutgate(capsys, "replay", *logs)[0] == worst
    code, out, _ = cutgate(capsys, "replay", "--json", *logs)
    assert code == worst
    assert [document["log"] for document in json.loads(out)] == [str(log) for log in logs]


def test_show_takes_several_logs(capsys, four):
    code, out, _ = cutgate(capsys, "show", four["ok"], four["too"])
    assert code == 0
    assert out.index(str(four["ok"])) < out.index(str(four["too"]))
    code, out, _ = cutgate(capsys, "show", "--json", four["ok"], four["too"])
    assert code == 0
    assert [document["log"] for document in json.loads(out)] == [str(four["ok"]), str(four["too"])]
    assert cutgate(capsys, "show", four["ok"], four["other"])[0] == 2


def test_one_log_is_one_document(capsys, four):
    for command in ("verify", "show", "replay"):
        assert isinstance(json.loads(cutgate(capsys, command, "--json", four["ok"])[1]), dict)
