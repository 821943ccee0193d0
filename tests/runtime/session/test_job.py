"""From files to a job: digests of the bytes that were read, the branch, the deadlines."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from cutgate.config.load import InputError, load_site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records
from cutgate.protocol.path import BLOCK_BYTES
from cutgate.runtime.session.job import VERIFIER, configuration, make_job, read_files, utc_now
from cutgate.runtime.verification.asked import AskedTurns
from tests.runtime.session.pair import NOW, job_of


@pytest.fixture
def files(tmp_path_factory):
    return job_of(tmp_path_factory)[0]


def site(tmp_path, text):
    file = tmp_path / "site.toml"
    file.write_text('schema = "cutgate.site/1"\n' + text)
    return load_site(file)


def test_a_job_names_what_was_read(files):
    job, robot = make_job(files, now=NOW), files.robot.value
    assert job.limits == limits_record(robot).body()
    assert job.calibration == calibration_record(robot).body()
    assert job.tool == tool_record(robot).body()
    assert job.registration == files.prepared.registration.value.digest
    assert job.path_digest == hashlib.sha256(job.path).digest()
    assert (job.verifier, job.serial, job.registration_max_age_s) == (VERIFIER, None, None)
    assert len(VERIFIER) <= 16
    assert job.blocks == -(-len(job.path) // BLOCK_BYTES) == len(records.split(job.path))


def test_a_job_names_where_the_bone_is_and_when_that_was_found(files):
    job, said = make_job(files, now=NOW), files.prepared.registration.value
    assert job.place == said.place
    assert datetime.fromtimestamp(job.registration_time_us / 1e6, UTC) == said.created
    bare = make_job(replace(files, prepared=replace(files.prepared, registration=None)), now=NOW)
    assert (bare.place, bare.registration_time_us) == (records.NO_PLACE, records.NO_TIME)
    assert job.prepared_us == bare.prepared_us == NOW.timestamp() * 1e6


def test_the_age_of_a_registration_counts_from_its_creation(files):
    created = files.prepared.registration.value.created
    assert make_job(files, now=created + timedelta(seconds=90)).registration_age_s == 90.0


def test_the_turns_that_are_asked_for_are_the_jobs_and_others_are_refused(files):
    limits = files.robot.value.limits.model_copy(update={"q3_deg": (-1000.0, 1000.0)})
    wide = files.robot.value.model_copy(update={"limits": limits})
    files = replace(files, prepared=replace(files.prepared, robot=wide))
    job = make_job(files, now=NOW, asked=AskedTurns(roll=2))
    assert job.branch == records.Branch("right", 0, 2)
    assert records.Path.parse(job.path).roll_turns == 2
    assert make_job(files, now=NOW).branch == records.Branch("right", 0, 0)
    with pytest.raises(InputError, match="--roll-turns is 3, must be -2 to 2; q3 goes from"):
        make_job(files, now=NOW, asked=AskedTurns(roll=3))


def test_without_a_registration_there_is_no_age(files):
    bare = replace(files, prepared=replace(files.prepared, registration=None))
    assert make_job(bare, now=NOW).registration_age_s == 0.0


def test_the_configuration_is_both_files(files, tmp_path):
    one, other = site(tmp_path, ""), site(tmp_path, "[timing]\ntimeout_ms = 120\n")
    digests = {configuration(replace(files, site=which)) for which in (None, one, other)}
    assert len(digests) == 3


def test_the_configuration_is_what_loosens_a_check_too(files, tmp_path):
    """The option of the command line is in no file: it has a part of its own in the digest."""
    bare, allowing = site(tmp_path, ""), site(tmp_path, "[controller]\nsimulated = true\n")
    given = [
        replace(files, site=which, allow_simulated=option)
        for which in (None, bare, allowing)
        for option in (False, True)
    ]
    assert len({make_job(one, now=NOW).configuration for one in given}) == 6
    assert [make_job(one, now=NOW).simulation_allowed_by for one in given] == [
        "",
        "--allow-simulated",
        "",
        "--allow-simulated",
        "site.toml",
        "--allow-simulated and site.toml",
    ]


def test_a_configuration_without_such_an_option_has_the_digest_it_always_had(files, tmp_path):
    chosen = site(tmp_path, "")
    plain = replace(files, site=chosen, allow_simulated=False)
    digest = hashlib.sha256(b"cutgate/configuration/1" + files.robot.sha256 + chosen.sha256).digest()
    assert configuration(plain) == digest


def test_the_sites_settings_become_deadlines(files, tmp_path):
    chosen = site(
        tmp_path,
        "[timing]\nheartbeat_ms = 30\ntimeout_ms = 150\nreply_timeout_ms = 700\nstop_confirm_ms = 400\n"
        '[log]\ncommit_deadline_ms = 600\n[controller]\nserial = "A-1"\n',
    )
    job = make_job(replace(files, site=chosen), now=NOW)
    timing, waits = job.timing, job.deadlines
    assert (timing.heartbeat_ms, timing.timeout_ms) == (30, 150)
    assert (waits.reply_timeout_s, waits.stop_confirm_s, waits.commit_deadline_s) == (0.7, 0.4, 0.6)
    assert job.serial == "A-1"
    assert files.settings.controller.serial is None


def test_a_path_without_a_feasible_branch_keeps_the_turns_it_has(tmp_path_factory):
    files, job = job_of(tmp_path_factory, 2000.0)
    assert job.branch == records.Branch("right", 0, 0)
    assert job.path == files.prepared.path.body()


def test_a_file_that_is_not_there_is_refused(files, tmp_path):
    with pytest.raises(InputError):
        read_files(tmp_path / "none.csv", files.robot.path, files.prepared.registration.path, None, None)


def test_a_sites_file_is_read_with_the_others(files, tmp_path):
    chosen = site(tmp_path, "").path
    read = read_files(
        files.prepared.plan.path, files.robot.path, files.prepared.registration.path, chosen, 25.0
    )
    assert read.site is not None
    assert read.prepared.path.feed_mm_s == 25.0


def test_the_time_of_day_is_aware():
    assert abs(utc_now() - datetime.now(UTC)) < timedelta(minutes=1)
