"""The campaign: short scenarios by the hundred, each with faults of its own; nothing unsafe, no log that is not whole or does not fit.

``CUTGATE_SEED=n CUTGATE_FAULT_RUNS=1`` plays scenario n alone; ``make test-long`` plays 10 000.
"""

import os

import pytest

from cutgate.firmware_sim import table as controller
from cutgate.firmware_sim.state import HeartbeatLost
from tests.fault_injection.campaign import CUT_SHORT, KILLED, Tally, campaign
from tests.runtime.session.pair import job_of

pytestmark = pytest.mark.no_cover
FIRST = int(os.environ.get("CUTGATE_SEED", "1"))
MANY = int(os.environ.get("CUTGATE_FAULT_RUNS", "300"))
LONG = int(os.environ.get("CUTGATE_FAULT_RUNS", "10000"))
BATCH = 50
TOLD_EVERY = 1000


def judged(tally, number):
    """Nothing is wrong, and all were played."""
    print(tally)  # noqa: T201 - a campaign says what it did
    assert not tally.wrong, str(tally)
    assert tally.ends.total() == tally.logs.total() == number
    assert tally.unsafe == tally.logs[CUT_SHORT] == 0
    assert tally.logs[KILLED] == tally.ends["killed"]


@pytest.mark.parametrize("begin", range(FIRST, FIRST + MANY, BATCH))
def test_whatever_happens_nothing_unsafe_moves_and_every_log_is_whole_and_fits(
    tmp_path, tmp_path_factory, begin
):
    number = min(BATCH, FIRST + MANY - begin)
    judged(campaign(tmp_path, *job_of(tmp_path_factory), range(begin, begin + number)), number)


@pytest.mark.long
def test_ten_thousand_scenarios(tmp_path, tmp_path_factory):
    tally = Tally()
    for begin in range(FIRST, FIRST + LONG, TOLD_EVERY):
        end = min(begin + TOLD_EVERY, FIRST + LONG)
        tally += campaign(tmp_path, *job_of(tmp_path_factory), range(begin, end))
        print(f"{end - FIRST} of {LONG} from seed {FIRST} on: {len(tally.wrong)} wrong", flush=True)  # noqa: T201
    judged(tally, LONG)


def test_the_campaign_tells_unsafe_motion_and_the_seed_that_brings_it_back(
    tmp_path, tmp_path_factory, monkeypatch
):
    """A controller that outlives the loss of heartbeats: some runtime is killed while it cuts."""
    ignored = lambda state, _event, _now_s: (state, ())  # noqa: E731 - one entry of a table
    monkeypatch.setitem(controller.EVERYWHERE, HeartbeatLost, ignored)
    for seed in range(20):
        tally = campaign(tmp_path, *job_of(tmp_path_factory), [seed], only=["the runtime is killed"])
        if tally.unsafe:
            assert list(tally.wrong) == [seed]
            assert f"seed {seed}: " in str(tally)
            return
    raise AssertionError("not seen in 20 scenarios")
