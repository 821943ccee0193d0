"""What permits and starts say of the log's tree: each way of naming another tree, alone."""

import json

import pytest

from cutgate.protocol import records as wire
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit import roots as module
from cutgate.runtime.audit.records import AuditPermit
from cutgate.runtime.audit.roots import Roots
from cutgate.runtime.audit.tree import Tree
from tests.runtime.audit.build import wire_permit, wire_start

TOPIC = AuditPermit.TOPIC
OTHER = "ab" * 32
LOG_ID = "cd" * 16
OTHER_LOG = "ef" * 16


def of_log(kind, log_id=LOG_ID):
    """What was signed of a permit or start that names this log, in hex; a reset names none."""
    if kind == "reset":
        return wire.Reset(bytes(16), 1, bytes(32), StopCause.SECOND_NODE).canonical().hex()
    permit = wire_permit(log=wire.TreeHead(bytes.fromhex(log_id), 1, bytes(32)))
    return (permit if kind == "permit" else wire_start(permit, permit.log)).canonical().hex()


class Records:
    """Records one after the other, and the tree of each size beside them."""

    def __init__(self):
        self.roots = Roots()
        self.roots.log_id = LOG_ID
        self.tree = Tree()
        self.trees = {0: self.tree.root.hex()}

    def add(self, topic="/can/frame", data=b"{}"):
        covered = f"{self.tree.size} {topic}".encode() + data
        self.roots.take(topic, covered, data)
        self.tree.append(covered)
        self.trees[self.tree.size] = self.tree.root.hex()
        return self

    def frames(self, count):
        for _ in range(count):
            self.add()
        return self

    def permit(self, stage, kind="permit", token=1, **changes):
        return self.add(TOPIC, AuditPermit(kind=kind, stage=stage, token=token, **changes).encode())

    def sent(self, size, root=None, **changes):
        named = {"log_size": size, "log_root": root or self.trees[size]}
        return self.permit("sent", **({"record": of_log(changes.get("kind", "permit"))} | named | changes))

    @property
    def wrong(self):
        return self.roots.wrong


def pending(**changes):
    """Record 3 authorises, records 4 and 5 follow; what is sent is record 6."""
    return Records().frames(3).permit("authorised", **changes).frames(2)


def test_the_tree_is_that_of_all_records():
    log = pending().sent(4).frames(3)
    assert (log.roots.tree.size, log.roots.tree.root) == (log.tree.size, log.tree.root)
    assert log.tree.size == 10


@pytest.mark.parametrize("size", [4, 5, 6])
def test_what_is_sent_names_a_tree_with_its_authorising_record_and_without_its_own(size):
    assert pending().sent(size).wrong == ""


@pytest.mark.parametrize("size", [-1, 0, 3, 7, 8])
def test_a_tree_without_the_authorising_record_or_behind_the_sent_one_is_named(size):
    assert pending().sent(size, OTHER).wrong == (
        f"record 6 (/audit/permit): it names a tree of size {size}, must be 4 to 6: "
        "with record 3, which authorised it, and without its own"
    )


@pytest.mark.parametrize("size", [4, 5, 6])
def test_another_root_at_that_size_is_named_with_the_one_there_is(size):
    log = pending()
    assert log.sent(size, OTHER).wrong == (
        f"record 6 (/audit/permit): it names the root {OTHER} at size {size}, the tree has {log.trees[size]} there"
    )


def test_the_first_record_that_is_wrong_is_told_by_its_number():
    log = pending()
    assert log.roots.wrong_at == 0
    log.sent(4, OTHER).frames(2).sent(5, OTHER)
    assert log.roots.wrong_at == 6


def test_the_root_of_another_size_is_another_root():
    log = pending()
    assert f"at size 5, the tree has {log.trees[5]}" in log.sent(5, log.trees[4]).wrong


@pytest.mark.parametrize("root", [{"log_size": 4}, {"log_root": OTHER}])
def test_size_and_root_are_named_together(root):
    told = "record 6 (/audit/permit): of the tree's size and root it names one alone"
    assert pending().permit("sent", **root).wrong == told


def test_before_version_4_no_tree_is_named():
    assert pending().permit("sent").wrong == ""
    assert Records().permit("sent").wrong == ""


@pytest.mark.parametrize("changes", [{"kind": "start"}, {"token": 2}, {"token": None}])
def test_a_tree_is_named_only_by_what_is_authorised(changes):
    kind = changes.get("kind", "permit")
    told = f"record 6 (/audit/permit): it names a tree of size 4, and no {kind} is authorised"
    assert pending().sent(4, **changes).wrong == told
    assert Records().frames(6).sent(4).wrong == told.replace("start", "permit")


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_each_kind_is_held_against_its_own(kind):
    assert pending(kind=kind, token=7).sent(5, kind=kind, token=7).wrong == ""
    assert pending(kind=kind, token=7).sent(5, OTHER, kind=kind, token=7).wrong


def test_a_reset_names_no_log():
    told = "record 6 (/audit/permit): what was signed cannot be read: "
    assert pending(kind="reset").sent(5, kind="reset").wrong.startswith(told)
    assert pending(kind="reset").permit("sent", kind="reset").wrong == ""


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_the_log_that_was_signed_is_this_one(kind):
    log = pending(kind=kind).sent(4, kind=kind, record=of_log(kind, OTHER_LOG))
    assert log.wrong == f"record 6 (/audit/permit): it names the log {OTHER_LOG}, this one is {LOG_ID}"


@pytest.mark.parametrize("log_id", [None, "", "CD" * 16, 7, ["cd" * 16]])
def test_where_record_0_names_none_nothing_names_it(log_id):
    log = pending()
    log.roots.log_id = log_id
    assert log.sent(4).wrong == f"record 6 (/audit/permit): it names the log {LOG_ID}, this one is {log_id}"


def test_before_record_0_there_is_no_log():
    assert Roots().log_id is None


@pytest.mark.parametrize("kind", ["permit", "start"])
@pytest.mark.parametrize("record", [None, "", "00", "xyz"])
def test_what_was_signed_can_be_read(kind, record):
    told = "record 6 (/audit/permit): what was signed cannot be read: "
    assert pending(kind=kind).sent(4, kind=kind, record=record).wrong.startswith(told)


@pytest.mark.parametrize(("kind", "other"), [("permit", "start"), ("start", "permit")])
def test_what_was_signed_is_of_its_own_kind(kind, other):
    assert pending(kind=kind).sent(4, kind=kind, record=of_log(other)).wrong


def test_another_tree_is_told_before_another_log():
    assert "it names the root" in pending().sent(4, OTHER, record=of_log("permit", OTHER_LOG)).wrong


@pytest.mark.parametrize("stage", ["sent", "withheld"])
def test_one_authorisation_lets_one_go(stage):
    log = pending().permit(stage).sent(4)
    assert log.wrong == "record 7 (/audit/permit): it names a tree of size 4, and no permit is authorised"


@pytest.mark.parametrize("stage", ["acknowledged", "refused"])
def test_answers_change_nothing(stage):
    """They name no tree, whatever they say of one: the answer to a permit may come while a start is authorised."""
    assert pending().permit(stage, log_size=99, log_root=OTHER).sent(4).wrong == ""


def test_the_latest_authorisation_counts():
    log = pending().permit("authorised", token=2)
    assert log.sent(6, token=2).wrong.startswith(
        "record 7 (/audit/permit): it names a tree of size 6, must be 7 to 7"
    )
    assert pending().permit("authorised", token=2).sent(4).wrong.endswith("and no permit is authorised")


def test_permit_and_start_of_one_session():
    log = pending().sent(5).permit("acknowledged").frames(4)
    log.permit("authorised", kind="start", token=2).frames(1)
    assert log.sent(log.tree.size, kind="start", token=2).frames(3).wrong == ""


def test_the_first_wrong_one_is_told_and_the_rest_is_not():
    log = pending().sent(4, OTHER).permit("authorised", token=2).sent(4, OTHER, token=2)
    assert log.wrong.startswith("record 6 ")
    assert pending().sent(4, OTHER).permit("authorised").wrong.startswith("record 6 ")


@pytest.mark.parametrize("data", [b"7", b"{", b"{}", b'{"kind": "permit", "stage": "sent", "log_size": "4"}'])
def test_a_permit_that_cannot_be_read_is_wrong(data):
    assert Records().add(TOPIC, data).wrong.startswith("record 0 (/audit/permit): it cannot be read: ")


def test_what_cannot_be_read_says_why():
    data = json.dumps({"kind": "permit", "stage": "sent", "log_size": True}).encode()
    assert Records().add(TOPIC, data).wrong.endswith("Input should be a valid integer")


@pytest.mark.parametrize("topic", ["/audit/decision", "/can/frame"])
def test_other_records_name_no_tree(topic):
    data = AuditPermit(kind="permit", stage="sent", log_size=9, log_root=OTHER).encode()
    assert Records().add(topic, data).wrong == ""


def test_memory_is_bounded_however_late_it_is_sent(monkeypatch):
    monkeypatch.setattr(module, "ROOTS_MAX", 5)
    log = pending().frames(50)
    assert len(log.roots._authorised.roots) == 5
    assert pending().frames(50).sent(8).wrong == ""
    assert pending().frames(50).sent(9).wrong == (
        "record 56 (/audit/permit): it names a tree of size 9, over 5 records behind record 3"
    )
    assert log.roots.tree.root == log.tree.root


def test_the_bound_is_what_it_is():
    assert module.ROOTS_MAX == 65_536


def test_nothing_is_remembered_when_nothing_is_authorised():
    assert pending().sent(4).frames(9).roots._authorised is None
