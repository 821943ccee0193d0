"""What is claimed of translations is what was proved, with every reserve that the proof rests on.

Three paths of which it was once said, as proved, that nothing shorter than the move shown keeps 0.2 mm. There are
shorter moves that are admissible and keep more than that, though not 0.1 deg of the roll beyond its deadband.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification import certified
from cutgate.runtime.verification.placing import guidance
from cutgate.runtime.verification.placing.guidance import guide
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband
from cutgate.runtime.verification.report.document import guidance_document
from tests.runtime.verification.cases import DEG, problem, random_problem
from tests.seeds import seeds

ROLL = ("roll_min", "roll_max")
SCALE = np.array([DEG, DEG, 1.0, DEG, DEG])


POSES = {
    1: """
        375.557 130.233 -8.038 -0.155478 -0.644695 0.748462
        375.296 127.881 -10.836 -0.104693 -0.672040 0.733077
        373.446 127.737 -11.195 -0.112357 -0.647693 0.753571
        377.846 128.886 -11.833 -0.132596 -0.640191 0.756686
        367.621 131.676 -16.722 -0.087681 -0.651434 0.753621
        371.099 129.441 -11.741 -0.144190 -0.620306 0.770993
        374.771 125.383 -13.765 -0.122533 -0.642226 0.756658
        375.947 132.829 -11.601 -0.105303 -0.619981 0.777518
        376.687 131.947 -14.460 -0.114565 -0.654764 0.747101
        373.327 130.364 -12.095 -0.142369 -0.635407 0.758939
        375.461 126.263 -13.156 -0.131760 -0.639613 0.757320
        368.624 130.682 -12.369 -0.110710 -0.671188 0.732974
    """,
    3: """
        196.214 -808.014 137.764 0.452091 -0.390608 0.801897
        217.211 -797.397 150.106 0.402788 -0.268656 0.874978
        181.022 -778.474 149.918 0.234289 -0.314768 0.919799
        220.395 -809.509 154.056 0.409767 -0.094308 0.907302
        221.953 -795.943 168.488 0.322678 -0.397594 0.858952
        208.771 -769.616 125.638 0.415015 -0.202588 0.886973
        203.192 -784.825 150.245 0.370610 -0.326534 0.869496
        204.792 -826.174 171.961 0.388010 -0.357608 0.849450
        182.938 -791.972 156.865 0.486042 -0.461778 0.741973
        224.494 -777.737 143.362 0.449126 -0.376482 0.810276
        199.180 -804.431 128.075 0.578378 -0.424020 0.696912
        223.585 -805.693 156.174 0.464236 -0.545977 0.697419
    """,
    4: """
        630.994 -108.665 350.427 0.172852 -0.981106 -0.086904
        623.639 -71.348 350.300 0.135453 -0.985762 -0.099631
        631.502 -125.154 373.553 0.161289 -0.984521 -0.068585
        644.649 -107.683 382.581 0.153666 -0.984917 -0.079531
        642.147 -97.323 397.370 0.158689 -0.982454 -0.097992
        643.017 -108.603 361.414 0.162016 -0.979939 -0.116060
        618.655 -96.891 366.770 0.157472 -0.985430 -0.064259
        672.272 -76.392 368.408 0.148037 -0.986779 -0.065977
        626.397 -78.676 343.376 0.204376 -0.977756 -0.047147
        624.561 -89.767 357.945 0.160587 -0.985298 -0.058302
        624.182 -109.296 381.538 0.156199 -0.986280 -0.053427
        633.397 -97.997 380.555 0.172667 -0.983573 -0.052637
    """,
}
"""x y z i j k, as registered."""

ROBOTS = {
    1: {
        "arm": Arm(271.412292, 309.202627, "left"),
        "tool_length_mm": 137.324305,
        "lower": np.array([-200.000000, -150.0, 50.0, -54.650155, 5.0]) * SCALE,
        "upper": np.array([200.000000, -10.0, 450.0, 58.324104, 110.0]) * SCALE,
        "deadband": Deadband(2.922988, 1.304367 * DEG),
        "calibration": ArmCalibration(
            0.4,
            -0.3,
            joint_offset=np.array([0.571182, 0.03881, -0.141052, -0.04835, -0.076552]) * SCALE,
            slide_tilt=np.array([9.513511, 18.25069]) / 1000,
            residual_mm=0.1,
        ),
    },
    3: {
        "arm": Arm(410.811649, 452.483740, "left"),
        "tool_length_mm": 69.865328,
        "lower": np.array([-96.568619, -150.0, 50.0, -75.454203, 5.0]) * SCALE,
        "upper": np.array([96.568619, -10.0, 450.0, 72.728822, 110.0]) * SCALE,
        "deadband": Deadband(2.732187, 1.054379 * DEG),
    },
    4: {
        "arm": Arm(258.765861, 442.552229, "left"),
        "tool_length_mm": 83.937179,
        "lower": np.array([-58.132568, -150.0, 50.0, -47.808334, 5.0]) * SCALE,
        "upper": np.array([58.132568, -10.0, 450.0, 26.621280, 110.0]) * SCALE,
        "deadband": Deadband(2.140807, 0.842159 * DEG),
    },
}
SHORTER = {
    1: (-22.657, -40.093, 0.758),
    3: (46.163, 41.806, -0.725),
    4: (-71.357, -19.759, 0.17),
}
"""Admissible moves, shorter than what was said to be the shortest."""


def case(number):
    values = np.array(POSES[number].split(), dtype=float).reshape(-1, 6)
    axes = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return problem(values[:, :3], axes, speed=np.full(5, 5e3), **ROBOTS[number])


def quantise(tips, axes):
    return np.round(tips * 1000.0) / 1000.0, axes


def answer(path):
    verdict = certified.verify(path)
    return None if verdict.admissible else guide(path, verdict, quantise)


def kept_by(path, move):
    """What a moved path keeps beyond its deadbands, arm with slide in mm and roll in deg; None where not admitted."""
    verdict = certified.verify(guidance.moved(path, 0.0, (0, 0, 0), move))
    if not verdict.admissible:
        return None
    margins = {name: b.certified - b.deadband for name, b in verdict.boundaries.items()}
    arm = min(x for name, x in margins.items() if verdict.boundaries[name].unit == "mm")
    return arm, min(margins[name] for name in ROLL)


def claimed(text):
    """Length and reserves in the sentence, mm, mm, deg."""
    (found,) = re.findall(
        r"no translation shorter than ([0-9.]+) mm keeps ([0-9.]+) mm beyond the deadband of arm and slide"
        r" and ([0-9.]+) deg beyond that of the roll \(proved\)",
        text,
    )
    return tuple(map(float, found))


@pytest.mark.parametrize("number", POSES)
def test_a_shorter_move_that_is_admissible_lacks_a_reserve_that_is_stated(number):
    path = case(number)
    found = answer(path)
    length, reserve_mm, reserve_deg = claimed(found.text)
    arm, roll = kept_by(path, SHORTER[number])
    assert np.linalg.norm(SHORTER[number]) < length
    assert arm > reserve_mm
    assert roll < reserve_deg
    shown = guidance_document(found)
    assert (shown["reserve_mm"], shown["reserve_deg"]) == (reserve_mm, pytest.approx(reserve_deg))


@pytest.mark.parametrize("number", POSES)
def test_what_is_said_of_a_lower_bound_is_rounded_down(number):
    found = answer(case(number))
    length, _, _ = claimed(found.text)
    assert length <= found.at_least_mm <= np.linalg.norm(found.translation_mm)
    assert found.at_least_mm < length + 0.1
    again = kept_by(case(number), found.translation_mm)
    kept = float(re.search(r"keeps at least ([0-9.]+) mm beyond the arm deadband", found.text)[1])
    assert kept <= again[0] + 1e-6


@pytest.mark.parametrize("seed", seeds(3, 9))
def test_no_shorter_translation_keeps_every_reserve_that_is_stated(seed):
    rng = np.random.default_rng([20270501, seed])
    tried = 0
    while tried < 100:
        path = replace(random_problem(rng, spinning=rng.random() < 0.3), speed=np.full(5, 1e9))
        path = guidance.moved(path, 0.0, (0, 0, 0), rng.normal(0.0, rng.choice([3.0, 60.0]), 3))
        found = answer(path)
        if found is None or not found.at_least_mm:
            continue
        toward = np.asarray(found.translation_mm) / math.hypot(*found.translation_mm)
        for _ in range(25):
            move = toward + rng.normal(0, rng.choice([0.01, 0.3, 3.0]), 3)
            move *= found.at_least_mm * (1 - 10.0 ** rng.uniform(-4, -0.3)) / np.linalg.norm(move)
            kept = kept_by(path, move)
            assert kept is None or kept[0] < found.reserve_mm or kept[1] < found.reserve_deg
            tried += 1
