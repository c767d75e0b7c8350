"""The benchmarks count what they say."""

from itertools import islice, pairwise, product

import numpy as np
import pytest

from fusion.body import KINECT_V1, KINECT_V2
from tests.benchmarks import accuracy, speed
from tests.benchmarks.certainty import limb_figures
from tests.benchmarks.harsher_errors import heavy_tails
from tests.benchmarks.methods import METHODS, OURS
from tests.benchmarks.trials import Outcome, Trial
from tests.helpers.two_views import FRAME_NS, moving, pair_of

NAMES = tuple(method.name for method in METHODS)


def made_up(size):
    """Two movements, two angles, three seeds; all figures of a method as large as ``size`` says, or 1."""
    outcomes = []
    for motion, angle, seed, method in product(("basketball", "still"), (45.0, 135.0), range(3), NAMES):
        figures = dict.fromkeys(("mpjpe", "lag"), size.get(method, 1.0) + 0.01 * seed)
        outcomes.append(Outcome(Trial(motion, angle, seed), method, figures))
    return outcomes


def test_a_trial_counts_only_where_every_method_has_the_figure():
    outcomes = made_up({})
    for outcome in outcomes:
        outcome.figures["lag"] = 1.0 if outcome.trial.motion == "still" else 5.0
        if outcome.method == "B alone" and outcome.trial.motion == "basketball":
            outcome.figures["lag"] = np.nan
    methods = accuracy.summary(outcomes)["methods"]
    assert {row["lag"] for row in methods.values()} == {1.0}


def test_nearer_recordings_are_counted_one_by_one():
    outcomes = made_up({})
    for outcome in outcomes:
        nearer = outcome.trial.motion == "still" and outcome.trial.seed > 0  # 4 of 12 recordings
        kalman = 2.0 if nearer else 0.9
        outcome.figures["mpjpe"] = {OURS: 1.0, "Kalman, refined": kalman}.get(outcome.method, 3.0)
    assert accuracy.nearer(outcomes, "Kalman, refined") == pytest.approx(4 / 12)
    assert accuracy.nearer(outcomes, "mean, refined") == 1.0


def test_cases_where_a_baseline_is_nearer_on_average_are_reported():
    outcomes = made_up(dict.fromkeys(NAMES, 2.0) | {OURS: 1.0, "oracle": 0.1, "duplex, smoothed": 0.5})
    assert accuracy.lost(outcomes) == []
    for outcome in outcomes:
        if outcome.method == "mean, refined" and (outcome.trial.motion, outcome.trial.angle) == (
            "still",
            135,
        ):
            outcome.figures["mpjpe"] = 0.5
    (case,) = accuracy.lost(outcomes)
    assert (case["motion"], case["angle"], case["method"]) == ("still", 135.0, "mean, refined")
    assert case["by"] == pytest.approx(0.51)


def test_a_repeated_recording_has_no_jumps_and_rising_times():
    pairs = [pair_of(KINECT_V1, joints, t * FRAME_NS) for t, joints in enumerate(moving(KINECT_V1, 5))]
    many = speed.repeated(pairs, 15)
    assert [pair.a for pair in many] == [pair.a for pair in pairs + pairs[::-1] + pairs]
    assert {b.time_ns - a.time_ns for a, b in pairwise(many)} == {speed.FRAME_NS}


def distances(body):
    """(T, J) of 40,000 frames: over 1,300 independent sizes, so a 99th percentile is known to a third."""
    errors = islice(heavy_tails(body, 1 / 30, np.random.default_rng(5)), 40_000)
    return np.linalg.norm([*errors], axis=2)


# Ranges over three exercises of one Kinect v2 view against optical motion capture: median, 90 %, 99 %, mm.
# Widened by what chance makes of the 99th percentile.
PUBLISHED = {
    "SpineBase": ((13, 24), (30, 70), (51, 100)),
    "Head": ((12, 31), (33, 245), (69, 273)),
    "KneeLeft": ((5, 15), (16, 33), (21, 55)),
    "HandLeft": ((18, 38), (84, 775), (279, 1139)),
    "HandRight": ((18, 38), (84, 775), (279, 1139)),
}


def test_tails_are_as_heavy_as_measured():
    found = distances(KINECT_V2) * 1e3
    for joint, ranges in PUBLISHED.items():
        tails = np.percentile(found[:, KINECT_V2.joint(joint)], (50, 90, 99))
        assert all(low <= value <= high for value, (low, high) in zip(tails, ranges, strict=True)), (
            joint,
            tails,
        )


def test_distances_as_large_as_what_sigma_grows_by_are_honest():
    random = np.random.default_rng(0)
    before, added = random.uniform(0.01, 0.03, (2, 20_000))
    apart = np.linalg.norm(random.normal(size=(20_000, 3)), axis=1) * added / np.sqrt(3.0)
    figures = limb_figures(np.stack([apart, np.hypot(before, added), before], axis=1))
    assert figures["rms_over_added"] == pytest.approx(1.0, abs=0.02)
    assert figures["within"] > 0.95
