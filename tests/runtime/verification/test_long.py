"""The long run, ``make test-long``: a million random segments, and a million poses in bounded memory."""

import multiprocessing
import os
import resource
import sys
import time

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from tests.runtime.verification import decided, judge
from tests.runtime.verification.cases import axis, problem, wrist_path

SEGMENTS = int(os.environ.get("CUTGATE_SEGMENTS", "1000000"))
SEED = int(os.environ.get("CUTGATE_SEED", "20260201"))
SHARE = 1000
MILLION = 1_000_000
DECISIONS = 10_000
MOST_MEMORY_MIB = 1024.0

pytestmark = pytest.mark.long


def _share(number):
    """Judge one share in a process of its own; its seed is [SEED, number]."""
    count = min(SHARE, SEGMENTS - number * SHARE)
    return judge.share([SEED, number], count), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _summary(whole, seconds, peak):
    return (
        f"seed {SEED}: {whole.segments} segments in {whole.paths} paths, {whole.admitted} admitted, "
        f"{whole.sharpened} tried at their deadbands, "
        f"{whole.by_rule['admitted_paths_keep_every_deadband']} false admissions, "
        f"{whole.by_rule['paths_with_room_are_admitted']} false refusals, "
        f"{whole.refused_within_a_hundredth} refused with room below {judge.ROOM} mm and deg, "
        f"{whole.undecided} with an undecided bracket, largest gap {whole.largest_gap:.5f}, "
        f"{seconds:.0f} s, at most {peak:.0f} MiB a process"
    )


def test_random_segments_against_dense_sampling_on_all_cores():
    whole, began, peak = judge.Tally(), time.monotonic(), 0.0
    shares = range(-(-SEGMENTS // SHARE))
    # Not ProcessPoolExecutor: with max_tasks_per_child Python 3.11 stops for good when its first workers retire.
    with multiprocessing.get_context("spawn").Pool(maxtasksperchild=50) as pool:
        for done, (tally, memory) in enumerate(pool.imap_unordered(_share, shares), 1):
            whole.add(tally)
            peak = max(peak, memory)
            for wrong in tally.wrong:
                print(*wrong, sep=": ", flush=True)
            if done % 50 == 0 or done == len(shares):
                print(_summary(whole, time.monotonic() - began, peak), flush=True)
    assert whole.segments == SEGMENTS
    assert whole.wrong == []
    assert peak < MOST_MEMORY_MIB


def _decided(number):
    """Compare one share of the answers alone with whole verdicts, in a process of its own."""
    return decided.share([SEED, 1, number], DECISIONS // 50, 0.1)


def test_the_answer_alone_is_that_of_the_whole_verification():
    whole = decided.Compared()
    with multiprocessing.get_context("spawn").Pool(maxtasksperchild=5) as pool:
        for found in pool.imap_unordered(_decided, range(50)):
            whole.add(found)
            for wrong in found.wrong:
                print(*wrong, sep=": ", flush=True)
    print(
        f"seed {SEED}: {whole.problems} problems, {whole.admitted} admitted, {whole.alone} by one look alone, "
        f"{whole.sampled} of those held against dense samples, {len(whole.wrong)} differ",
        flush=True,
    )
    assert whole.problems == DECISIONS
    assert whole.wrong == []
    assert whole.sampled > DECISIONS / 250


def _million_poses(conversation):
    """Verify a million poses in a process of its own; send the verdict, the seconds and the peak memory."""
    t = np.linspace(0, 15000, MILLION)
    centres = np.stack((520 + 40 * np.cos(t), 30 * np.sin(t), 150 + t / 250), axis=1)
    tips, axes = wrist_path(centres, axis(0.9 + 0.1 * np.sin(t / 7), 0.3 * np.cos(t / 5)))
    began = time.monotonic()
    verdict = certified.verify(problem(tips, axes, speed=np.full(5, 1e6)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    conversation.send((verdict.admissible, verdict.reasons, time.monotonic() - began, peak))


def test_a_million_poses_are_verified_in_less_than_a_gibibyte():
    if sys.platform != "linux":
        pytest.skip("ru_maxrss is in KiB on Linux only")
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    child = context.Process(target=_million_poses, args=(there,))
    child.start()
    admissible, reasons, seconds, peak = here.recv()
    child.join()
    print(f"{MILLION} poses: {seconds:.1f} s, peak {peak:.0f} MiB of the whole process", flush=True)
    assert admissible, reasons
    assert peak < MOST_MEMORY_MIB
