"""What an archived session leaves: what it says holds, and nothing else is taken for one."""

import json
from base64 import b64encode
from dataclasses import replace

import pytest

from cutgate.runtime.audit.archive import _proven
from cutgate.runtime.audit.chain import ChainLink, covered
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.folder import session_of
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.note import sign
from cutgate.runtime.audit.signing.proof import RecordProof
from cutgate.runtime.audit.stub import MovedFile, Stub, key_in_stub, stub_name
from cutgate.runtime.audit.tree import Tree
from tests.runtime.audit.folders import folder_of
from tests.runtime.commands.test_audit_folder import OLD


def stub_of(path) -> tuple[Stub, object]:
    with reading(path) as log:
        session = session_of(path.name, log)
    proof, record = _proven(path, session)
    moved = (MovedFile(path.name, 1, "ab" * 32),)
    stub = Stub(
        path.name, session.status, session.closed, session.size, session.root, session.head, session.last_ns,
        proof, record, "/archive", moved,
    )  # fmt: skip
    return stub, session


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return folder_of(tmp_path_factory.mktemp("stubs") / "logs", 4, crashed=(2,), started=(1,))


@pytest.mark.parametrize("at", range(4))
def test_a_stub_says_of_its_session_what_its_log_says(logs, at):
    stub, session = stub_of(logs[at])
    found, reason = Stub.parse(stub.encode()).session()
    kept = replace(session, archived=True, trees=frozenset(), starts=False, witnesses=(), signed=0)
    assert found == kept
    assert found.status is (Status.INCOMPLETE if at == 2 else Status.OK)
    assert reason == ("the first 5 of 6 records are signed" if at == 2 else "")


def test_a_stub_of_before_signatures_holds_record_0_and_is_incomplete():
    stub, session = stub_of(OLD / "20261127T072440Z-b7809ef8.mcap")
    assert stub.proof is None
    found, reason = Stub.parse(stub.encode()).session()
    assert (found.log_id, found.previous, found.key) == (session.log_id, session.previous, None)
    assert (found.status, reason[:7]) == (Status.INCOMPLETE, "nothing")


def test_what_was_incomplete_is_not_ok_by_being_archived(logs):
    stub, _ = stub_of(logs[0])
    session, reason = replace(stub, status=Status.INCOMPLETE).session()
    assert (session.status, reason) == (Status.INCOMPLETE, "it was INCOMPLETE when it was archived")
    assert replace(stub, closed=False).session()[0].status is Status.INCOMPLETE


def test_whatever_is_changed_in_a_stub_it_never_says_another_thing_of_what_was_signed(logs):
    """All but what no signature covers: time, head and place; the next session names the head."""
    stub, session = stub_of(logs[1])
    whole = stub.encode()
    believed = 0
    for byte in range(0, len(whole), 7):
        data = bytearray(whole)
        data[byte] ^= 1
        try:
            found, _ = Stub.parse(bytes(data)).session()
        except ValueError:
            continue
        believed += 1
        if found.status is Status.OK:
            for name in ("log_id", "key", "previous", "enrolled", "size", "root", "opened_ns"):
                assert getattr(found, name) == getattr(session, name)
    assert believed < len(whole) / 7 / 4


def lie(stub: Stub, other: Stub, what: str) -> Stub:
    match what:
        case "another's proof":
            return replace(stub, proof=other.proof)
        case "another root":
            return replace(stub, root="00" * 32)
        case "fewer records":
            return replace(stub, size=3)
        case "no signature":
            return replace(stub, proof=None, record=scan(stub_log_bytes(stub)).messages[0].covered)
        case "another record":
            return replace(stub, proof=None, record=scan(stub_log_bytes(stub)).messages[1].covered)
        case _:
            return replace(stub, proof=stub.proof.replace("index 0", "index 1"))


LOGS: dict[str, bytes] = {}


def stub_log_bytes(stub: Stub) -> bytes:
    return LOGS[stub.log]


@pytest.mark.parametrize("what", ["another root", "fewer records", "another record", "another index"])
def test_a_stub_that_contradicts_itself_is_none(logs, what):
    stub, _ = stub_of(logs[0])
    LOGS[stub.log] = logs[0].read_bytes()
    with pytest.raises(ValueError, match=r"root|record|proof"):
        lie(stub, stub, what).session()


def test_a_signed_log_whose_stub_has_no_proof_is_never_ok(logs):
    stub, _ = stub_of(logs[0])
    LOGS[stub.log] = logs[0].read_bytes()
    found, reason = lie(stub, stub, "no signature").session()
    assert found.status is Status.INCOMPLETE
    assert reason == "the first 0 of 6 records are signed"


def test_a_stub_with_the_proof_of_another_log_tells_of_that_log(logs):
    """So it takes no place but that one's: it is named after its log, and the next session names size and root."""
    stub, other = stub_of(logs[0])[0], stub_of(logs[3])[0]
    with pytest.raises(ValueError, match=r"root|record"):
        replace(stub, proof=other.proof, size=5).session()


def made_up(record: dict, key: LogKey, named: str = "ab" * 16, sequence: int = 0) -> Stub:
    """The stub of a log of one record, signed by this key under this name."""
    data = json.dumps(record).encode()
    covered_bytes = covered(ChainLink("/audit/open", "json", "Open", b"{}", 1, 1, sequence, data))
    tree = Tree()
    tree.append(covered_bytes)
    origin = origin_of(named)
    note = sign(Checkpoint(origin, 1, tree.root).text, origin, key.private)
    proof = RecordProof(covered_bytes, 0, (), note, key.public.public).encode().decode()
    moved = (MovedFile("a.mcap", 1, "ab" * 32),)
    return Stub("a.mcap", Status.OK, True, 1, tree.root.hex(), "00" * 32, 1, proof, None, "/x", moved)


def test_a_signature_is_of_the_key_and_the_log_that_record_0_names():
    key, other = (LogKey(bytes(16), 1, bytes([n]) * 32) for n in (1, 2))
    record = {
        "log_id": "ab" * 16,
        "series": key.series.hex(),
        "epoch": 1,
        "public_key": key.public.public.hex(),
    }
    assert made_up(record, key).session()[0].status is Status.OK
    for stub, told in (
        (made_up(record, other), "another key has signed it"),
        (made_up(record, key, named="cd" * 16), f"its checkpoint is of the log {'cd' * 16}"),
        (made_up(record | {"epoch": 0}, key), "record 0: its epoch is 0"),
        (made_up({"log_id": "ab" * 16}, key), "names a key that has signed nothing of it"),
        (made_up({key: value for key, value in record.items() if key != "log_id"}, key), "or no log"),
        (made_up(record, key, sequence=1), "its proof"),
    ):
        with pytest.raises(ValueError, match=told):
            stub.session()
    broken = replace(made_up(record, key), proof="none")
    with pytest.raises(ValueError, match="its proof: "):
        broken.session()


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "cutgate.archived/2"}, {"log": "a/b.mcap"}, {"log": "b.log"}, {"root": "00"}, {"head": None},
        {"size": -1}, {"size": True}, {"size": 1.5}, {"last_ns": 1 << 70}, {"status": "TAMPERED"}, {"closed": 1},
        {"proof": None}, {"proof": 3}, {"record": b64encode(b"x").decode()}, {"moved": []}, {"moved": [1]},
        {"moved": [{"name": "../x", "size": 1, "sha256": "ab" * 32}]}, {"moved": "x"}, {"place": 3},
        {"moved": [{"name": "x", "size": 1, "sha256": "AB" * 32}]}, {"moved": [{"name": "x", "size": 1, "sha256": "ab" * 32}] * 9},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_stub_is_refused(logs, change):
    stub, _ = stub_of(logs[0])
    content = json.loads(stub.encode()) | change
    with pytest.raises(ValueError, match="it "):
        Stub.parse(json.dumps({key: value for key, value in content.items() if value is not None}).encode())


@pytest.mark.parametrize("data", [b"", b"[]", b"\xff", b"[" * 100_000, b'{"schema": NaN}'])
def test_what_is_no_json_is_refused(data):
    with pytest.raises(ValueError, match="no JSON"):
        Stub.parse(data)


def test_the_key_of_a_stub(logs, tmp_path):
    stub, session = stub_of(logs[0])
    file = tmp_path / "x.archived"
    file.write_bytes(stub.encode())
    assert key_in_stub(file) == session.key
    for data in (b"", replace(stub, size=3).encode(), b"x" * (2 << 20)):
        file.write_bytes(data)
        assert key_in_stub(file) is None
    assert key_in_stub(tmp_path / "none") is None


def test_a_stub_is_named_after_its_log():
    assert stub_name("20261127T072440Z-b7809ef8.mcap") == "20261127T072440Z-b7809ef8.archived"
