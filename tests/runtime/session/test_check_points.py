"""Check points of the registration in whole sessions: shown, judged before the permit, and found again in the log."""

import json
from contextlib import contextmanager

import pytest

from cutgate.runtime.audit import records
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.job import make_job, read_files
from tests.runtime.audit.build import inputs
from tests.runtime.session.pair import NOW, PLACED, pair_of

RIGHT = {"id": "epicondyle", "ct_mm": [10, 20, 30], "robot_mm": [510, 70, 150]}
OFF = {"id": "notch", "ct_mm": [0, 0, 0], "robot_mm": [500, 50, 122.5]}


@contextmanager
def session(folder, points, site=""):
    """A session whose registration has these check points, under this site."""
    i = inputs()
    for name, data in (
        ("plan.csv", i.plan),
        ("robot.toml", i.robot.data),
        ("registration.json", json.dumps(json.loads(i.registration) | {"check_points": points}).encode()),
        ("site.toml", f'schema = "cutgate.site/1"\n{site}\n'.encode()),
    ):
        (folder / name).write_bytes(data)
    names = (folder / name for name in ("plan.csv", "robot.toml", "registration.json", "site.toml"))
    files = read_files(*names, None, allow_simulated=True)
    job = make_job(files, now=NOW)
    PLACED[job.registration] = files.placed
    with pair_of(folder, files, job) as pair:
        yield pair


def test_a_cut_whose_check_points_are_where_they_were_touched_is_admitted_and_replays(tmp_path):
    with session(tmp_path, [RIGHT, OFF], "check_point_tolerance_mm = 2.5\ncheck_points_min = 2") as pair:
        assert pair.end() is Phase.DONE
        assert pair.close().closed
        document = json.loads(pair.read().of(records.AuditVerdict.TOPIC)[0]["document"])
        assert document["check_points"] == [
            {"id": "epicondyle", "residual_mm": 0.0},
            {"id": "notch", "residual_mm": 2.5},
        ]
        assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


@pytest.mark.parametrize(
    ("points", "site", "reason"),
    [
        (
            [RIGHT, OFF],
            "",
            "of 2 the worst, notch is 2.5 mm off (required: each within 2 mm): touch the point again; if it stays off",
        ),
        (
            [RIGHT],
            "check_points_min = 3",
            "epicondyle is 0 mm off (required: at least 3, each within 2 mm): touch 2 more landmarks",
        ),
    ],
)
def test_a_check_point_that_is_off_or_missing_is_refused_before_a_permit_in_words(
    tmp_path, points, site, reason
):
    with session(tmp_path, points, site) as pair:
        assert pair.end() is Phase.REFUSED
        assert f"check points of the registration: {reason}" in pair.state.reason
        assert pair.close().closed
        assert not pair.read().of(records.AuditPermit.TOPIC)
        warnings = json.loads(pair.read().of(records.AuditVerdict.TOPIC)[0]["document"])["warnings"]
        assert [one["code"] for one in warnings] == [
            "CHECK_POINT_OFF" if OFF in points else "CHECK_POINTS_MISSING"
        ]
        assert pair.replayed().outcome is ReplayOutcome.IDENTICAL
