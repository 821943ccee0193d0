"""The rules over the records, each broken alone, without a file around them."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Metadata

from cutgate.protocol.records import TreeHead
from cutgate.runtime.audit import judge as module
from cutgate.runtime.audit import records
from cutgate.runtime.audit.chain import GENESIS, of_channel
from cutgate.runtime.audit.container.stored import ChannelInfo, Scan, Stored, StoredAttachment
from cutgate.runtime.audit.judge import Judge, missing, parse_object
from cutgate.runtime.audit.recovered import Recovered
from cutgate.runtime.audit.tree import Tree
from tests.runtime.audit.build import wire_permit

LOG_ID = "ab" * 16
ATTACHED = {"name": "plan.csv", "media_type": "text/csv", "sha256": "cd", "size": 3}


def found(**changes):
    """What the scan has found beside the messages."""
    scan = Scan(finished=True, metadata=[Metadata("cutgate", {"log_id": LOG_ID})])
    for name, value in changes.items():
        setattr(scan, name, value)
    return scan


def stored(**changes):
    """An attachment as it stands in the file."""
    values = ATTACHED | {"log_time": 1, "create_time": 1, "offset": 100, "file": None}
    return StoredAttachment(**values | changes)


class Records:
    """A log's records, chained; each taken by the judge as it is made."""

    def __init__(self, anchors=()):
        self.judge = Judge(anchors)
        self.messages = []
        self.head = GENESIS
        self.number = 0

    def add(self, topic, content=None, *, encoding="json", sequence=None, data=None, prev=None):
        content = dict(content or {})
        if topic.startswith("/audit/"):
            content["prev"] = self.head.hex() if prev is None else prev
        data = json.dumps(content).encode() if data is None else data
        kind = (topic, encoding, "cutgate.X", b"{}")
        message = Stored(
            ChannelInfo(*kind, of_channel(*kind)),
            5,
            5,
            self.number if sequence is None else sequence,
            data,
            1000,
        )
        message.offset += self.number
        self.messages.append(message)
        self.judge.take(message)
        self.head = message.advance(self.head)
        self.number += 1
        return self

    def opened(self):
        return self.add("/audit/open", {"log_id": LOG_ID})

    def closed(self, **changes):
        return self.add("/audit/close", {"message_count": self.number + 1, **changes})

    def problems(self, scan=None):
        return [
            *self.judge.problems,
            *filter(None, [self.judge.roots.wrong]),
            *self.judge.content(scan or found()),
        ]


def test_a_log_that_keeps_every_rule_has_no_problem():
    log = Records().opened().add("/audit/attachment", ATTACHED).add("/can/frame", {"id": 1}).closed()
    assert log.problems(found(attachments=[stored()])) == []
    assert missing(found(), log.judge) == []
    assert (log.judge.count, log.judge.head) == (4, log.head)
    assert log.judge.first["log_id"] == LOG_ID
    assert log.judge.last["message_count"] == 4
    assert log.judge.last_topic == "/audit/close"


@pytest.mark.parametrize("topic", ["/can/frame", "/tracking", "/timing"])
def test_places_are_those_of_all_records_whose_topic_is_not_streamed(topic):
    judge = Records().opened().add(topic, {"id": 1}).closed().judge
    assert judge.streamed == {topic}
    assert [(topic, offset) for topic, offset, _ in judge.places] == [
        ("/audit/open", 1000),
        ("/audit/close", 1002),
    ]
    assert all(size > 80 for *_, size in judge.places)


FRAME = records.CanFrame(stamp=records.Time(sec=7, nsec=8), direction="sent", id=9, dlc=8, data="00ff" * 4)


@given(st.builds(
    records.CanFrame,
    stamp=st.builds(records.Time, sec=st.integers(0, 2**32 - 1), nsec=st.integers(0, 10**9 - 1)),
    direction=st.sampled_from(["received", "sent"]),
    id=st.integers(0, 2**29 - 1),
    is_rtr=st.booleans(), is_extended=st.booleans(), is_error=st.booleans(),
    dlc=st.integers(0, 15),
    data=st.binary(max_size=64).map(bytes.hex),
))  # fmt: skip
def test_every_frame_that_a_session_writes_is_known_for_an_object_without_being_parsed(frame):
    assert module._PLAIN.fullmatch(frame.encode())


@given(st.data())
@settings(max_examples=400)
def test_what_is_taken_for_an_object_unparsed_is_one(draws):
    """A frame with anything changed, inserted or taken out; the parser is the oracle."""
    data = bytearray(FRAME.encode())
    for _ in range(draws.draw(st.integers(1, 3))):
        at = draws.draw(st.integers(0, len(data)))
        new = draws.draw(st.sampled_from(PIECES) | st.binary(max_size=2))
        data[at : at + draws.draw(st.integers(0, 3))] = new
    if module._PLAIN.fullmatch(bytes(data)):
        assert parse_object(bytes(data)) is not None


PIECES = (
    b"{",
    b"}",
    b'"',
    b",",
    b":",
    b"[",
    b"]",
    b"0",
    b"01",
    b"-",
    b".",
    b"1" * 5000,
    b"NaN",
    b"\\",
    b"\\u",
    b"\n",
    b"\xff",
    b"true",
)


@pytest.mark.parametrize(
    "data",
    [
        b'{"a":NaN}',
        b'{"a":01}',
        b'{"a":1,}',
        b'{"a":{"b":1},}',
        b'{"a":1}{}',
        b'{"a":"\n"}',
        b'{"a":"\\"}',
        b'{"a":"\xff"}',
        b'{"a":%b}' % (b"1" * 5000),
        b"{,}",
        b"",
        b'{"a"}',
        b'["a"]',
        b'{"a":1',
    ],
)
def test_a_frame_that_is_no_object_is_named(data):
    assert Records().opened().add("/can/frame", data=data).judge.problems == [
        "record 1 (/can/frame): it is not a JSON object"
    ]


@pytest.mark.parametrize(
    "data",
    [b'{ "a": -1.5e3 }', b'{"a":null}', b'{"a":[1,{"b":[]}]}', b"{}", b'{"a":{"b":{"c":1}}}', b'{"a":"\\n"}'],
)
def test_a_frame_that_is_an_object_of_another_form_is_one_too(data):
    assert Records().opened().add("/can/frame", data=data).judge.problems == []


def test_a_frame_in_place_of_record_0_is_parsed():
    judge = Records().add("/can/frame", data=b'{"log_id":"x"}').judge
    assert (judge.first, judge.last, judge.roots.log_id) == ({"log_id": "x"}, {"log_id": "x"}, "x")


def test_before_the_first_record_there_is_nothing():
    judge = Judge()
    assert (judge.first, judge.last, judge.last_topic, judge.count, judge.head) == (
        None,
        None,
        "",
        0,
        GENESIS,
    )
    assert (judge.places, judge.problems, list(judge.content(found(metadata=[])))) == ([], [], [])


# ---------------------------------------------------------------- the chain


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"data": b"[]"}, "it is not a JSON object"),
        ({"data": b"\xff"}, "it is not a JSON object"),
        ({"sequence": 0}, "its sequence is 0"),
        ({"sequence": 2}, "its sequence is 2"),
        ({"encoding": "cbor"}, "its encoding is not json"),
        ({"prev": "00" * 32}, "it does not follow from the records before it"),
        ({"prev": None, "data": b"{}"}, "it does not follow from the records before it"),
    ],
)
def test_the_first_record_that_is_wrong_in_its_place_is_named_alone(changes, told):
    log = Records().opened().add("/audit/decision", **changes).add("/audit/decision", prev="x", sequence=9)
    assert log.judge.problems == [f"record 1 (/audit/decision): {told}"]


def test_record_0_follows_from_the_beginning():
    assert Records().add("/audit/open", prev="").judge.problems == [
        "record 0 (/audit/open): it does not follow from the records before it"
    ]


def test_frames_carry_no_link_and_are_covered_by_the_next_that_does():
    log = Records().opened().add("/can/frame", {"id": 1})
    assert log.judge.problems == []
    other = Records().opened().add("/can/frame", {"id": 2})
    other.head = log.head  # a link computed over another frame
    other.add("/audit/decision")
    assert other.judge.problems == [
        "record 2 (/audit/decision): it does not follow from the records before it"
    ]


def test_a_frame_is_a_json_object_with_its_sequence_too():
    assert Records().opened().add("/can/frame", data=b"7").judge.problems
    assert Records().opened().add("/can/frame", sequence=5).judge.problems
    assert Records().opened().add("/can/frame", encoding="x").judge.problems


# ---------------------------------------------------------------- the tree


def test_the_tree_covers_every_record_as_the_chain_does():
    log, tree = Records().opened().add("/can/frame", {"id": 1}).closed(), Tree()
    for message in log.messages:
        tree.append(message.covered)
    assert (log.judge.roots.tree.size, log.judge.roots.tree.root) == (3, tree.root)


def test_an_anchor_is_found_where_it_was_the_root_or_the_head():
    log, tree = Records().opened().add("/can/frame", {"id": 1}).closed(), Tree()
    roots, heads, head = [], [], GENESIS
    for message in log.messages:
        tree.append(message.covered)
        head = message.advance(head)
        roots.append(tree.root)
        heads.append(head)
    other = bytes(32)
    again = Records((roots[1], heads[2], other)).opened().add("/can/frame", {"id": 1}).closed()
    assert again.judge.anchors == {roots[1]: 1, heads[2]: 2}
    assert log.judge.anchors == {}


def test_a_permit_that_names_another_tree_is_named():
    named = wire_permit(log=TreeHead(bytes.fromhex(LOG_ID), 2, bytes(32)))
    permit = {"kind": "permit", "token": 1, "record": named.canonical().hex()}
    for root, told in (
        ("right", []),
        ("ab" * 32, ["record 2 (/audit/permit): it names the root abababababa"]),
    ):
        log = Records().opened().add("/audit/permit", permit | {"stage": "authorised"})
        named = log.judge.roots.tree.root.hex() if root == "right" else root
        log.add("/audit/permit", permit | {"stage": "sent", "log_size": 2, "log_root": named}).closed()
        assert [problem[:55] for problem in log.problems()] == told
        assert log.judge.problems == []


def test_a_permit_that_names_another_log_than_record_0_is_named():
    named = wire_permit(log=TreeHead(bytes.fromhex(LOG_ID), 2, bytes(32))).canonical().hex()
    for content, this in (({"log_id": "cd" * 16}, "cd" * 16), ({}, "None"), ({"log_id": 7}, "7")):
        log = Records().add("/audit/open", content)
        permit = {"kind": "permit", "token": 1, "record": named}
        log.add("/audit/permit", permit | {"stage": "authorised"})
        root = log.judge.roots.tree.root.hex()
        log.add("/audit/permit", permit | {"stage": "sent", "log_size": 2, "log_root": root})
        log.add("/audit/decision", {"log_id": LOG_ID})
        assert f"record 2 (/audit/permit): it names the log {LOG_ID}, this one is {this}" in log.problems()


def test_where_record_0_is_no_object_a_permit_names_no_log():
    log = Records().add("/audit/open", data=b"7")
    assert log.judge.roots.log_id is None


# ---------------------------------------------------------------- open and close


def test_record_0_opens_the_log():
    log = Records().add("/audit/decision", {"log_id": LOG_ID})
    assert log.problems() == ["record 0 is /audit/decision, must be /audit/open"]
    assert Records().problems() == []


def test_it_is_opened_and_closed_once():
    assert Records().opened().opened().opened().problems() == ["/audit/open is there 3 times"]
    log = Records().opened().closed().closed()
    assert log.problems() == [
        "/audit/close is there 2 times",
        "record 2 (/audit/close) stands after the close record",
    ]


def test_the_first_record_after_the_close_record_is_named():
    log = Records().opened().closed().add("/can/frame", {"id": 1}).add("/audit/decision")
    assert log.problems() == ["record 2 (/can/frame) stands after the close record"]
    assert missing(found(), log.judge) == ["there is no close record: the session did not end in order"]


@pytest.mark.parametrize("count", [1, 3, None, "2", True])
def test_the_close_record_counts_every_message(count):
    log = Records().opened().closed(message_count=count)
    assert log.problems() == [f"the close record counts {count} messages, the file holds 2"]


def test_a_close_record_that_is_none_counts_nothing():
    log = Records().opened().add("/audit/close", data=b"7")
    assert log.problems() == [
        "record 1 (/audit/close): it is not a JSON object",
        "the close record counts None messages, the file holds 2",
    ]


def test_the_first_close_record_is_the_one_that_is_read():
    """A second one that counts what the first hides is named whatever it says."""
    log = Records().opened().closed().closed(message_count=3)
    assert "/audit/close is there 2 times" in log.problems()


# ---------------------------------------------------------------- metadata and attachments


@pytest.mark.parametrize(
    "metadata",
    [
        [],
        [Metadata("cutgate", {"log_id": "other"})],
        [Metadata("cutgate", {})],
        [Metadata("other", {"log_id": LOG_ID})],
        [Metadata("cutgate", {"log_id": LOG_ID})] * 2,
    ],
)
def test_the_metadata_name_the_log_of_record_0(metadata):
    told = ["the file's metadata are not those of record 0"]
    assert Records().opened().problems(found(metadata=metadata)) == told
    assert Records().problems(found(metadata=metadata)) == []


def test_a_record_0_that_is_none_has_no_log():
    log = Records().add("/audit/open", data=b"7")
    assert log.problems()[-1] == "the file's metadata are not those of record 0"
    assert log.judge.first is None


@pytest.mark.parametrize("field", ["name", "media_type", "sha256", "size"])
def test_an_attachment_is_what_its_record_says(field):
    log = Records().opened().add("/audit/attachment", ATTACHED)
    other = stored(**{field: 4 if field == "size" else "other"})
    assert log.problems(found(attachments=[other])) == [
        f"attachment 0 ({other.name}) is not what its record says"
    ]
    lacking = {key: value for key, value in ATTACHED.items() if key != field}
    log = Records().opened().add("/audit/attachment", lacking)
    assert log.problems(found(attachments=[stored()])) == [
        "attachment 0 (plan.csv) is not what its record says"
    ]


def test_attachments_are_in_the_order_of_their_records():
    one, two = ATTACHED, ATTACHED | {"name": "robot.toml"}
    log = Records().opened().add("/audit/attachment", one).add("/audit/attachment", two)
    assert log.problems(found(attachments=[stored(), stored(name="robot.toml")])) == []
    assert log.problems(found(attachments=[stored(name="robot.toml"), stored()])) == [
        "attachment 0 (robot.toml) is not what its record says",
        "attachment 1 (plan.csv) is not what its record says",
    ]
    assert log.problems(found(attachments=[stored()])) == [
        "attachment robot.toml has a record but is not there"
    ]


def test_an_attachment_has_its_record_in_a_file_that_is_finished():
    log, extra = Records().opened(), [stored(name="more.bin")]
    assert log.problems(found(attachments=extra)) == ["attachment more.bin has no record"]
    assert log.problems(found(attachments=extra, finished=False)) == []


def test_a_record_of_an_attachment_that_is_none_fits_none():
    log = Records().opened().add("/audit/attachment", data=b"7")
    told = "attachment 0 (plan.csv) is not what its record says"
    assert told in log.problems(found(attachments=[stored()]))


def test_records_that_are_not_streamed_are_bounded(monkeypatch):
    monkeypatch.setattr(module, "KEPT_MAX", 2)
    log = Records().opened()
    for _ in range(5):
        log.add("/can/frame", {"id": 1})
    assert log.add("/audit/decision").problems() == []
    log.add("/audit/decision")
    assert log.problems() == ["it holds over 2 records that are not streamed; no session writes so many"]
    assert len(log.judge.places) == 2
    assert module.KEPT_MAX == 2


def test_the_bound_is_what_it_is():
    assert module.KEPT_MAX == 1_000_000


# ---------------------------------------------------------------- what is missing


def test_a_log_that_ends_early_says_where():
    cut = found(finished=False)
    assert missing(cut, Records().judge) == [
        "the file ends before its first record",
        "there is no close record: the session did not end in order",
    ]
    assert missing(cut, Records().opened().add("/can/frame", {"id": 1}).judge) == [
        "the file ends early: record 1 is the last whole one",
        "there is no close record: the session did not end in order",
    ]
    assert missing(cut, Records().opened().closed().judge) == [
        "the file ends early: record 1 is the last whole one"
    ]


def test_zeros_at_the_end_are_a_loss_of_power():
    (line,) = missing(found(zeros=True), Records().opened().closed().judge)
    assert line == "it ends in zeros, as a file system leaves it after a loss of power"


@pytest.mark.parametrize(
    ("data", "content"),
    [
        (b'{"a": 1}', {"a": 1}),
        (b'{"a": "\xed\xa0\x80"}', {"a": "\ud800"}),
        (b"{}", {}),
        (b"7", None),
        (b"null", None),
        (b'{"a": NaN}', None),
        (b'{"a": Infinity}', None),
        (b'{"a": -Infinity}', None),
        (b"\xff", None),
        (b"[" * 100_000, None),
        (b"", None),
    ],
)
def test_a_record_is_a_json_object_and_nan_is_no_json(data, content):
    assert parse_object(data) == content


# ---------------------------------------------------------------- a recovered copy

OWN = Metadata("cutgate", {"log_id": LOG_ID})
TOLD = Recovered("x.mcap", "ab" * 32, 500, 20, 2, "cutgate 1")
MARK = TOLD.metadata()


def marked(**changes):
    """The metadata of a copy, with something else in them."""
    return Metadata(MARK.name, MARK.metadata | changes)


def test_a_recovered_copy_lacks_its_end_whatever_it_holds():
    log = Records().opened().closed()
    copy = found(metadata=[OWN, MARK])
    assert log.problems(copy) == []
    assert missing(copy, log.judge) == ["it is a recovered copy of x.mcap, 20 bytes dropped"]
    assert missing(found(), log.judge) == []


def test_a_copy_that_was_cut_holds_fewer_records_than_its_recovery_has_kept():
    log = Records().opened()
    told = "its recovery has kept 2 records, the file holds 1"
    assert log.problems(found(metadata=[OWN, MARK])) == [told]
    assert log.problems(found(metadata=[OWN, MARK], finished=False)) == []


@pytest.mark.parametrize(
    "metadata", [[MARK, OWN], [OWN, MARK, MARK], [MARK], [OWN, OWN, MARK], [OWN, MARK, OWN]]
)
def test_what_a_recovery_says_stands_once_and_behind_the_logs_own(metadata):
    log = Records().opened().closed()
    assert log.problems(found(metadata=metadata)) == ["the file's metadata are not those of record 0"]
    assert missing(found(metadata=metadata), log.judge), "and it is OK in no case"


def test_what_no_recovery_says_is_a_problem_and_never_ok():
    log = Records().opened().closed()
    copy = found(metadata=[OWN, marked(records="two")])
    (told,) = log.problems(copy)
    assert told.startswith("the metadata cutgate.recovered are none that a recovery writes: what must be a")
    assert missing(copy, log.judge) == ["it is a recovered copy that does not say of what"]


def test_an_attachment_whose_record_a_crash_has_cut_off_is_no_problem_in_a_copy():
    log = Records().opened().add("/can/frame", {"id": 1})
    attached = {"attachments": [stored()]}
    assert log.problems(found(metadata=[OWN, MARK], **attached)) == []
    assert log.problems(found(**attached)) == ["attachment plan.csv has no record"]
