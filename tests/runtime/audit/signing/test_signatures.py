"""The rule on what is signed of a log, record by record: a log is built, then one thing about it is wrong."""

from hashlib import sha256

import pytest

from cutgate.runtime.audit.signing.log_key import EPOCH_MAX, LogKey
from cutgate.runtime.audit.signing.note import NoteError
from cutgate.runtime.audit.signing.signatures import Signatures, key_of
from cutgate.runtime.audit.signing.signer import Sidecar, Signer
from cutgate.runtime.audit.tree import Tree

KEY, OTHER = LogKey(bytes(16), 3, bytes(range(32)), bytes(64)), LogKey(bytes(16), 3, bytes(32), bytes(64))
LOG_ID = "ab" * 16
OPENED = {
    "log_id": LOG_ID,
    "series": KEY.series.hex(),
    "epoch": 3,
    "public_key": KEY.public.public.hex(),
    "certificate": bytes(64).hex(),
}


class Log:
    """Records taken one by one; each checkpoint is signed unless told otherwise."""

    def __init__(self, opened=OPENED, key=KEY):
        self.signatures, self.tree, self.topics = Signatures(), Tree(), []
        self.signer = Signer(key, LOG_ID)
        self.add("/audit/open", opened)

    def add(self, topic, record=None):
        self.signatures.take(self.tree.size, topic, record or {}, self.tree)
        self.tree.append(f"{self.tree.size} {topic}".encode())
        self.topics.append(topic)
        return self

    def checkpoint(self, size=None, root=None, **changes):
        size, root = self.tree.size if size is None else size, root or self.tree.root
        record = {"size": size, "root": root.hex(), "note": self.signer.checkpoint(size, root)}
        return self.add("/audit/checkpoint", record | changes)

    def sent(self, size):
        return self.add("/audit/permit", {"stage": "sent", "log_size": size})

    @property
    def wrong(self):
        self.signatures.end(self.tree.size)
        return self.signatures.wrong


def whole():
    return Log().add("/a").checkpoint().sent(2).add("/b").checkpoint().add("/audit/close")


# ---------------------------------------------------------------- the key


def test_record_0_names_the_key():
    key = key_of(OPENED)
    assert key == KEY.public
    assert key_of({"log_id": LOG_ID}) is None, "of a version before logs were signed"
    without = {name: value for name, value in OPENED.items() if name != "certificate"}
    assert key_of(without).certificate is None


@pytest.mark.parametrize("epoch", [1, EPOCH_MAX])
def test_the_first_and_the_last_epoch_are_epochs(epoch):
    assert key_of(OPENED | {"epoch": epoch}).epoch == epoch


@pytest.mark.parametrize("name", ["series", "epoch", "public_key", "certificate", "enrolled"])
def test_whatever_is_left_of_a_key_makes_no_log_of_before(name):
    """Else half a key taken away would be an old log's."""
    with pytest.raises(NoteError):
        key_of({"log_id": LOG_ID, name: "x"})


def test_how_a_key_is_written_is_told():
    for name, digits in (("series", 32), ("public_key", 64), ("certificate", 128)):
        with pytest.raises(NoteError, match=f"its {name} must be {digits} hexadecimal digits"):
            key_of(OPENED | {name: "00"})


@pytest.mark.parametrize(
    "changes",
    [
        {"epoch": 0}, {"epoch": EPOCH_MAX + 1}, {"epoch": "3"}, {"epoch": None}, {"series": "00"}, {"series": 7},
        {"public_key": "xy" * 32}, {"public_key": None}, {"public_key": "AB" * 32}, {"certificate": ""},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_key_is_wrong_with_record_0(changes):
    with pytest.raises(NoteError):
        key_of(OPENED | changes)
    log = Log(OPENED | changes).add("/a").checkpoint()
    assert log.wrong.startswith("record 0: its ")
    assert log.wrong.endswith("record 0 is the first without a valid signature")
    assert log.signatures.key is None


def test_a_log_that_names_no_key_has_no_signatures_that_could_be_wrong():
    log = Log({"log_id": LOG_ID}).add("/audit/checkpoint", {"note": "x"}).sent(7)
    assert (log.wrong, log.signatures.key, log.signatures.covered) == ("", None, 0)
    assert log.signatures._origin == f"cutgate/{LOG_ID}"


def test_a_log_without_an_id_has_no_origin():
    assert (
        "its signature" in Log(OPENED | {"log_id": 7}).checkpoint().wrong
        or "no signature" in Log(OPENED | {"log_id": 7}).checkpoint().wrong
    )


# ---------------------------------------------------------------- checkpoints


def test_a_log_whose_every_chunk_is_signed_is_right():
    log = whole()
    assert (log.wrong, log.signatures.covered) == ("", 5)
    assert Log().wrong == "", "record 0 alone"
    assert Log().add("/a").checkpoint().wrong == "", "cut behind a checkpoint"


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda log: log.checkpoint(note="x"), "record 2 (/audit/checkpoint): a note is text"),
        (lambda log: log.checkpoint(note=7), "record 2 (/audit/checkpoint): a note is text"),
        (lambda log: log.checkpoint(size=1), "it signs another tree than that of the 2 records before it"),
        (lambda log: log.checkpoint(root=bytes(32)), "it signs another tree than that of the 2 records before it"),
        (lambda log: log.checkpoint(root="00"), "its size and root are not those of its note"),
        (lambda log: log.sent(2), "record 2 (/audit/permit): it names a tree of size 2, which no checkpoint signs"),
        (lambda log: log.sent({}), "it names a tree of size {}, which no checkpoint signs"),
        (lambda log: log.sent([1]), "it names a tree of size [1], which no checkpoint signs"),
    ],
    ids=["no note", "note is no text", "other size", "other root", "other fields", "unsigned tree", "no size", "list"],
)  # fmt: skip
def test_the_first_record_without_a_valid_signature_is_named(make, told):
    if told.startswith("its size"):
        log = Log().add("/a")
        note = log.signer.checkpoint(2, log.tree.root)
        log.add("/audit/checkpoint", {"size": 2, "root": "00", "note": note})
    else:
        log = make(Log().add("/a"))
    assert told in log.wrong
    assert log.wrong.endswith("; record 0 is the first without a valid signature")
    assert log.signatures.wrong_at == 2
    behind = log.wrong
    assert log.add("/b").checkpoint().wrong == behind, "the first is told"


def test_what_another_key_or_log_has_signed_is_wrong():
    assert "has no signature of the key" in Log(key=OTHER).checkpoint().wrong
    log = Log().add("/a")
    log.signer = Signer(KEY, "cd" * 16)
    assert "has no signature of the key" in log.checkpoint().wrong


@pytest.mark.parametrize(
    ("tail", "at"),
    [
        (["/audit/close"], None), (["/a"], 3), (["/a", "/audit/close"], 3), (["/audit/close", "/a"], 4),
        (["/audit/close", "/audit/close"], 4), (["/a", "/a"], 3),
    ],
    ids=str,
)  # fmt: skip
def test_behind_the_last_checkpoint_stands_the_close_record_alone(tail, at):
    log = Log().add("/a").checkpoint()
    for topic in tail:
        log.add(topic)
    assert (log.wrong == "") == (at is None)
    if at is not None:
        assert log.signatures.wrong_at == at
        assert log.wrong.startswith(f"record {at}: ")
        assert f"behind record 2 no checkpoint signs the {len(tail)} records that follow" in log.wrong
        assert log.wrong.endswith("record 2 is the first without a valid signature")


def test_what_a_later_checkpoint_signs_was_not_left_behind():
    log = Log().add("/a").checkpoint().add("/a").add("/a").checkpoint()
    assert (log.wrong, log.signatures.wrong_at) == ("", 0)
    assert log.add("/b").wrong.startswith("record 6: behind record 5 ")
    assert log.signatures.wrong_at == 6


def test_without_any_checkpoint_record_0_alone_may_stand():
    assert "behind record 0" in Log().add("/a").wrong
    assert Log().add("/audit/close").wrong == ""


def test_a_permit_that_is_not_sent_or_names_no_tree_asks_for_none():
    assert Log().add("/audit/permit", {"stage": "authorised", "log_size": 9}).checkpoint().wrong == ""
    assert Log().add("/audit/permit", {"stage": "sent"}).checkpoint().wrong == ""


# ---------------------------------------------------------------- the closed file


DIGEST = sha256(b"file").digest()


def beside(log, **changes):
    """What is wrong with a sidecar over this log and a file of 1000 bytes."""
    given = {
        "size": log.tree.size,
        "root": log.tree.root,
        "bytes": 1000,
        "sha256": DIGEST,
        "signer": log.signer,
    }
    given |= changes
    sidecar = given["signer"].sidecar(given["size"], given["root"], given["bytes"], given["sha256"])
    return log.signatures.sidecar(Sidecar.parse(sidecar), log.tree.size, log.tree.root, 1000, DIGEST)


def test_the_signature_beside_a_closed_log_is_of_it():
    assert beside(whole()) == ""


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"signer": Signer(OTHER, LOG_ID)}, "the signature beside it is not this log's"),
        ({"signer": Signer(KEY, "cd" * 16)}, "the signature beside it is not this log's"),
        ({"size": 8}, "it was closed with 8 records, 7 are there: those from 7 on are gone"),
        ({"size": 6}, "its records are not those that were signed when it was closed"),
        ({"root": bytes(32)}, "its records are not those that were signed when it was closed"),
        ({"bytes": 1001}, "its file is not the one that was signed when it was closed"),
        ({"sha256": bytes(32)}, "its file is not the one that was signed when it was closed"),
    ],
    ids=["another key", "another log", "longer", "shorter", "other root", "other length", "other bytes"],
)  # fmt: skip
def test_a_signature_of_anything_else_is_wrong(changes, told):
    assert told in beside(whole(), **changes)


def test_the_tree_and_the_file_are_not_taken_for_each_other():
    log = whole()
    sidecar = Sidecar.parse(log.signer.sidecar(log.tree.size, log.tree.root, 1000, DIGEST))
    swapped = Sidecar(sidecar.file, sidecar.checkpoint)
    assert "its origin is" in log.signatures.sidecar(swapped, log.tree.size, log.tree.root, 1000, DIGEST)
