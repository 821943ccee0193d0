"""Every row of the table of attacks, played on a folder of four sessions."""

import json
import os
import random
import re
import shutil
from dataclasses import replace
from time import process_time

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.directory import HEAD, Head
from cutgate.runtime.audit.folder import session_of
from cutgate.runtime.audit.inspect import Status, verify_log
from cutgate.runtime.audit.judge import Judge
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.series import examine
from cutgate.runtime.audit.series_facts import Folder, HeadNamed
from cutgate.runtime.audit.signing.log_key import EPOCH_MAX, LogKey, PublicLogKey
from cutgate.runtime.audit.signing.signer import SIDECAR_MAX, Sidecar
from cutgate.runtime.audit.trust import Trust, TrustAnswer, key_chain
from cutgate.runtime.commands import audit_trust
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.audit_folder import read_folder
from cutgate.runtime.commands.audit_trust import beside, certificates
from tests.runtime.audit.attacks import (
    ATTACKED,
    ATTACKS,
    FIRST,
    JOURNALD,
    LAST,
    STARTED,
    Scene,
    changed,
    doubled,
    edit,
    left_out,
    rewritten,
    sessions,
    stripped,
    swapped,
)

ROWS = [row for rows in ATTACKS.values() for row in rows]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attacked") / "logs"
    return folder, [path.name for path in sessions(folder)]


@pytest.fixture
def scene(made, tmp_path):
    folder = tmp_path / "logs"
    shutil.copytree(made[0], folder)
    return Scene(folder, [folder / name for name in made[1]])


def told(scene, trust):
    """Status and reasons of the attacked log; None where it is gone."""
    path = scene.logs[scene.at]
    if not path.exists():
        return None, ()
    with reading(path, beside(trust, path)) as log:
        return log.report.status, log.report.reasons


def answers(scene, attack):
    """What the table says, as it is; and all that names something."""
    pinned = Trust(pinned=scene.key(0).public)
    attack.act(scene)
    (alone, _), (with_key, reasons) = told(scene, Trust()), told(scene, pinned)
    found = read_folder(scene.folder, pinned, running=False).found
    codes = [finding.code for finding in found.findings if finding.status is not Status.OK]
    return (alone, with_key, found.status), [*reasons, *codes]


def test_untouched_it_is_ok(scene):
    trust = Trust(pinned=scene.key(0).public)
    assert told(scene, trust) == (Status.OK, ())
    assert read_folder(scene.folder, trust, running=False).found.status is Status.OK


@pytest.mark.parametrize("attack", ROWS, ids=[row.what for row in ROWS])
def test_an_attack_is_answered_as_the_table_says(scene, attack):
    found, names = answers(scene, attack)
    assert found == (attack.alone, attack.pinned, attack.folder), names
    assert any(attack.named in name for name in names) if attack.named else not names, names


# ---------------------------------------------------------------- which record is named first

NAMED = re.compile(r"record (\d+)")


def first_bad(data):
    """The record with which the rules are broken first, asked record by record; None where none does."""
    judge = Judge()
    for number, message in enumerate(scan(data).messages):
        judge.take(message)
        if judge.problems or judge.roots.wrong or judge.signatures.wrong:
            return number
    return None


def names_the_first(data, reasons):
    """Of all that is told the first names the first record of the file; and none before it is bad."""
    at = [NAMED.match(reason) for reason in reasons]
    numbers = [int(found[1]) for found in at if found]
    if numbers:
        assert at[0], reasons
        assert int(at[0][1]) == min(numbers), reasons
    bad = first_bad(data)
    if bad is not None:
        assert int(at[0][1]) <= bad, (bad, reasons)


@pytest.mark.parametrize("attack", ROWS, ids=[row.what for row in ROWS])
def test_the_first_reason_names_the_first_bad_record_of_the_file(scene, attack):
    attack.act(scene)
    if scene.logs[scene.at].exists():
        _, reasons = told(scene, Trust())
        names_the_first(scene.logs[scene.at].read_bytes(), reasons)


CHANGES = {
    "edited": lambda at: lambda links: [*links[:at], changed(links[at], changed=True), *links[at + 1 :]],
    "left out": left_out,
    "inserted": lambda at: lambda links: [*links[:at], links[-2], *links[at:]],
    "swapped": swapped,
    "doubled": doubled,
    "another root": lambda at: (
        lambda links: [
            changed(link, log_root="00" * 32)
            if number >= at and "log_root" in json.loads(link.data)
            else link
            for number, link in enumerate(links)
        ]
    ),
    "unsigned": lambda at: (
        lambda links: [
            link for number, link in enumerate(links) if number < at or link.topic != "/audit/checkpoint"
        ]
    ),
}


@given(
    st.lists(st.tuples(st.sampled_from(list(CHANGES)), st.integers(0, 16)), min_size=1, max_size=3),
    st.booleans(),
)
@example([("edited", 7), ("another root", 0)], True)
def test_of_several_changes_the_first_in_the_file_is_named_first(made, changes, chain):
    path = made[0] / made[1][ATTACKED]
    data = path.read_bytes()
    for name, drawn in changes:
        at = min(
            max(drawn, int(chain)), len(scan(data).messages) - 2
        )  # no chain is made anew without record 0
        data = rewritten(data, CHANGES[name](at), chain=chain)
    names_the_first(data, verify_log(data, None, path.with_suffix(".signature.json").read_bytes()).reasons)


def test_of_the_faults_of_journald_none_is_ok_where_it_can_be_known():
    """Each has its rows, and the folder finds every one."""
    by_name = {row.what: row for row in ROWS}
    assert len(by_name) == len(ROWS)
    for _, _, rows in JOURNALD.values():
        for row in (by_name[name] for name in rows):
            assert row.folder is Status.TAMPERED, row.what
            assert row.pinned is not Status.OK, row.what


# ---------------------------------------------------------------- one bit of any byte

SEEDED = 500


@pytest.fixture(scope="module")
def started(made):
    """The smallest log with a start, raw frames and signature."""
    log = made[0] / made[1][STARTED]
    return (
        log.read_bytes(),
        log.with_suffix(".candump.log").read_bytes(),
        log.with_suffix(".signature.json").read_bytes(),
    )


def flipped(data, place, bit):
    return data[:place] + bytes((data[place] ^ 1 << bit,)) + data[place + 1 :]


def never_ok(started, places, bit):
    log, frames, signature = started
    assert verify_log(log, frames, signature).status is Status.OK
    for place in places:
        assert verify_log(flipped(log, place, bit(place)), frames, signature).status is not Status.OK, place


@pytest.mark.no_cover
def test_a_flipped_bit_of_the_log_is_never_ok(started):
    draws = random.Random(31437)
    never_ok(started, draws.sample(range(len(started[0])), SEEDED), lambda _place: draws.randrange(8))


@pytest.mark.long
def test_a_flipped_bit_of_any_byte_of_the_log_is_never_ok(started):
    never_ok(started, range(len(started[0])), lambda place: place % 8)


@pytest.mark.no_cover
def test_a_flipped_bit_of_any_byte_of_the_signature_is_told_or_changes_none_of_its_notes(started):
    log, frames, signature = started
    notes = Sidecar.parse(signature)
    same = 0
    for place in range(len(signature)):
        changed = flipped(signature, place, place % 8)
        try:
            unaltered = Sidecar.parse(changed) == notes
        except ValueError:
            unaltered = False
        same += unaltered
        report = verify_log(log, frames, changed)
        assert report.status is (Status.OK if unaltered else Status.TAMPERED), place
    assert same < 10  # spaces between the parts of the JSON


def test_a_flipped_bit_of_any_byte_of_head_is_told_or_changes_nothing_that_is_held_against_the_logs(made):
    folder, names = made
    logs = []
    for name in names:
        with reading(folder / name) as log:
            logs.append(session_of(name, log))
    data = (folder / HEAD).read_bytes()

    def named(content):
        head = Head.parse(content)
        series = None if head.series is None else head.series.hex()
        return HeadNamed(head.log, head.closed, head.head, series, head.epoch, head.size, head.root)

    def found(head):
        return examine(Folder(logs, head, None, False, ())).status

    whole = named(data)
    assert found(whole) is Status.OK
    for place in range(len(data)):
        try:
            head = named(flipped(data, place, place % 8))
        except ValueError:
            continue
        assert head == whole or found(head) is not Status.OK, (place, head)


def test_a_flipped_bit_of_any_byte_of_the_key_file_is_refused_or_the_key_is_certified_by_nobody(made):
    before = Scene(made[0], [made[0] / name for name in made[1]]).key(STARTED)
    key = before.following(bytes(range(32)))
    data = key.encode()
    for place in range(len(data)):
        try:
            other = LogKey.parse(flipped(data, place, place % 8))
        except ValueError:
            continue
        assert other == key or not before.public.certifies(other.public), place


# ---------------------------------------------------------------- what costs


def test_an_epoch_as_large_as_can_be_is_answered_at_once(made):
    """The certificates between the pinned key and the log's are counted, not listed."""
    first = Scene(made[0], [made[0] / name for name in made[1]]).key(0).public
    last = PublicLogKey(first.series, EPOCH_MAX, bytes(32), bytes(64))
    begun = process_time()
    step = key_chain(last, Trust(pinned=first, certified={2: first, EPOCH_MAX: last}))
    assert process_time() - begun < 1
    assert step.answer is TrustAnswer.NO
    assert f"the certificate of epoch 3 is missing ({EPOCH_MAX - 3} in all)" in step.text


def test_a_folder_is_looked_into_for_certificates_once_whatever_is_asked_of_it(scene, tmp_path, monkeypatch):
    looked = []

    def certificates_of(folder, series):
        looked.append(folder)
        return certificates(folder, series)

    monkeypatch.setattr(audit_trust, "certificates", certificates_of)
    pinned = tmp_path / "first.pub"
    pinned.write_bytes(scene.key(0).public.encode())
    assert execute(["audit", "verify", *map(str, scene.logs), "--public-key", str(pinned)]) == Status.OK
    assert looked == [scene.folder]


@pytest.mark.parametrize("log_id", ["\ud800", "", " ", "a\nb", "a+b", "\x1b[31m", 7, None, [], "0" * 100_000])
def test_a_log_of_any_id_is_answered(scene, capsys, log_id):
    """Record 0 is anybody's text: whoever plants a log in a folder ends no verification of it."""
    path = scene.logs[FIRST]
    first, *rest = [message.link for message in scan(path.read_bytes()).messages]
    content = json.dumps({**json.loads(first.data), "log_id": log_id}).encode()
    path.write_bytes(
        rewritten(path.read_bytes(), lambda _: [replace(first, data=content), *rest], chain=False)
    )
    for options in ([], ["--json"]):
        for target in (path, scene.folder):
            assert execute(["audit", "verify", str(target), *options]) == Status.TAMPERED
    assert "\x1b" not in capsys.readouterr().out


@pytest.mark.parametrize("size", [SIDECAR_MAX + 1, 1 << 33])
def test_a_signature_that_is_larger_than_any_is_that_of_somebody_else(scene, size, capsys):
    """The log can be read: what stands beside it was exchanged. However large it is, it is not read."""
    os.truncate(scene.files(ATTACKED)[2], size)
    status, reasons = told(scene, Trust())
    assert status is Status.TAMPERED
    assert reasons == (f"the signature beside it cannot be read: it has {size} bytes, at most {SIDECAR_MAX}",)
    assert execute(["audit", "verify", str(scene.folder)]) == Status.TAMPERED
    assert reasons[0] in capsys.readouterr().out


def test_a_log_of_before_signatures_is_of_that_time_whatever_stands_beside_it(scene):
    log = scene.logs[ATTACKED]
    log.write_bytes(rewritten(log.read_bytes(), stripped))
    for content in (b"", b"{}", scene.files(STARTED)[2].read_bytes(), b" " * (SIDECAR_MAX + 1)):
        scene.files(ATTACKED)[2].write_bytes(content)
        assert told(scene, Trust())[0] is Status.INCOMPLETE


def test_two_logs_of_one_epoch_with_two_keys_prove_nothing_and_both_are_named(scene, tmp_path, capsys):
    """Whichever comes first by its name: ``audit verify`` of the folder calls it doubled."""
    pinned = tmp_path / "first.pub"
    pinned.write_bytes(scene.key(0).public.encode())

    def proven(out):
        told = execute(
            [
                "audit",
                "prove",
                str(scene.logs[LAST]),
                "--record",
                "1",
                "-o",
                str(out),
                "--public-key",
                str(pinned),
            ]
        )
        return told, capsys.readouterr().err

    assert proven(tmp_path / "before.proof")[0] == 0
    path = scene.logs[STARTED]
    theirs = LogKey(scene.key(STARTED).series, 2, bytes(range(32)))
    planted = edit("/audit/open", public_key=theirs.public.public.hex())
    for name in ("0.mcap", "z.mcap"):
        other = path.with_name(name)
        other.write_bytes(rewritten(path.read_bytes(), planted))
        code, err = proven(tmp_path / "after.proof")
        assert code == 2
        assert all(one in " ".join(err.split()) for one in ("epoch 2 has two keys", path.name, name))
        assert not (tmp_path / "after.proof").exists()
        codes = {one.code for one in read_folder(scene.folder, running=False).found.findings}
        assert "doubled" in codes
        other.write_bytes(path.read_bytes())
        assert proven(tmp_path / f"{name}.proof")[0] == 0, "a copy names the same key"
        other.unlink()


def test_a_public_key_of_any_size_is_refused_with_what_to_name(scene, tmp_path, capsys):
    pinned = tmp_path / "large.pub"
    pinned.touch()
    os.truncate(pinned, 1 << 33)
    assert execute(["audit", "verify", str(scene.folder), "--public-key", str(pinned)]) == Status.UNREADABLE
    assert "name the .pub file of a log key" in capsys.readouterr().err
