"""Each knob of the simulated body tracker causes one error, of the size stated, and changes no other."""

from dataclasses import replace
from functools import cache
from itertools import pairwise, repeat

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.streams import Streams
from devices.simulated.tracking.mirroring import Mirroring
from devices.simulated.tracking.report import Tracked
from devices.simulated.tracking.tracker import Tracker
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, BLAZEPOSE, KINECT_V1, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.skeleton import INFERRED, TRACKED
from tests.helpers.pair_statistics import run_lengths

NONE = TrackerErrors()
BODY, LENS, FRAME = AZURE_KINECT, NOMINAL_INTRINSICS["azure_kinect"], 1 / 30
FLOAT32 = 4.0 * 2.0**-23
STANDING = simulated_pair(motion="startup", seconds=1.0)[2].positions_at(0)
ELBOW, KNEE, HAND, THUMB = (BODY.joint(f"{name}_LEFT") for name in ("ELBOW", "KNEE", "HAND", "THUMB"))
BLINKING = np.array((0.1, 1.0))


class Watch:
    """What a tracker reports of a person who stands, over (T,) frames; ``visible`` repeats."""

    def __init__(self, frames, visible=(1.0,), joints=STANDING, seed=0, which=0, **knobs):
        errors = replace(NONE, **knobs)
        streams = Streams(seed, which)
        tracker = Tracker(Tracked(BODY, errors, np.full(len(BODY), 0.05), LENS, FRAME, streams))
        shares = [np.broadcast_to(visible[k % len(visible)], len(BODY)) for k in range(frames)]
        self.all = [tracker.report(joints, share, k) for k, share in enumerate(shares)]
        seen = [one for one in self.all if one is not None]
        self.lost = np.array([one is None for one in self.all])
        self.errors = np.array([one.positions for one in seen]) - joints
        self.states = np.array([one.states for one in seen])
        self.stale = np.array([one.repeats(before) for before, one in pairwise(seen)])

    def lengths(self):
        """(T, J - 1) length of each bone over the truth."""
        lengths = bone_lengths_of(BODY, self.errors + STANDING) / bone_lengths_of(BODY, STANDING)
        return lengths[:, BODY.bone_joints]


def kinds(**sizes):
    return NONE.jitter | sizes


ELBOWS = kinds(elbow=0.01)
BONES = {"bones": 0.05, "stretch": 0.0}


def share_of(state, visible, **knobs):
    """Of the joints that are hidden in every other frame."""
    return np.mean(Watch(200, visible, seen_share=0.35, **knobs).states[::2] == state)


@cache
def losing():
    return Watch(7200, lost=0.1, lost_seconds=0.4).lost


def one_hidden(joint):
    visible = np.ones(len(BODY))
    visible[joint] = 0.0
    return (visible,)


def kept(values):
    """Share of a deviation that is kept from frame to frame."""
    return np.mean(values[1:] * values[:-1]) / np.mean(values**2)


def over_seeds(statistic, seeds=40):
    return np.mean([statistic(seed) for seed in range(seeds)])


def both_views(seed, **knobs):
    """What both sensors report of a person who stands alike before both."""
    return [Watch(1, seed=seed, which=which, **knobs) for which in (0, 1)]


SHARED = {
    "bones": lambda seed, shared: [w.lengths()[0] - 1.0 for w in both_views(seed, **BONES, shared=shared)],
    "view_bias": lambda seed, shared: [
        w.errors[0].ravel() for w in both_views(seed, view_bias=0.03, shared=shared)
    ],
}


def correlation(knob, shared):
    a, b = np.concatenate([SHARED[knob](seed, shared) for seed in range(20)], axis=1)
    return np.corrcoef(a, b)[0, 1]


# knob, statistic, expected, tolerance: four standard errors of the statistic, by the count of what is drawn
KNOBS = {
    # 5,400 values known to 1 %
    "jitter by kind": (lambda: Watch(1800, jitter=ELBOWS, jitter_memory=0.0).errors[:, ELBOW].std(),
                       0.01, 5e-4),
    "jitter of another kind": (lambda: np.abs(Watch(20, jitter=ELBOWS).errors[:, KNEE]).max(), 0.0, FLOAT32),
    "jitter_memory": (lambda: kept(Watch(1800, jitter=ELBOWS, jitter_memory=0.7).errors[:, ELBOW]),
                      0.7, 0.05),
    "inferred_jitter": (lambda: Watch(1860, one_hidden(ELBOW), seen_share=0.35, jitter=ELBOWS,
                                      jitter_memory=0.0, inferred_jitter=3.0).errors[60:, ELBOW].std(),
                        0.03, 0.0015),
    # 40 seeds of 96 values
    "view_bias": (lambda: over_seeds(lambda s: np.std(Watch(1, seed=s, view_bias=0.03).errors)), 0.03, 0.004),
    "skin": (lambda: np.linalg.norm(Watch(1, skin=0.5).errors[0], axis=1).mean(), 0.5 * 0.05, FLOAT32),
    "stretch 0": (lambda: np.abs(Watch(1, view_bias=0.05, stretch=0.0).lengths() - 1.0).max(), 0.0, 1e-4),
    "bones": (lambda: over_seeds(lambda s: np.std(Watch(1, seed=s, **BONES).lengths())), 0.05, 0.004),
    "bones, over time": (lambda: np.std(Watch(50, **BONES).lengths(), axis=0).max(), 0.0, 1e-4),
    # 20 seeds of 31 bones, and of 96 coordinates
    "shared 0, bones": (lambda: correlation("bones", 0.0), 0.0, 0.16),
    "shared 0.6, bones": (lambda: correlation("bones", 0.6), 0.6, 0.12),
    "shared 0, view_bias": (lambda: correlation("view_bias", 0.0), 0.0, 0.1),
    "shared 0.6, view_bias": (lambda: correlation("view_bias", 0.6), 0.6, 0.1),
    # 60 s hold 150 independent scales: known to 6 %
    "rescale": (lambda: Watch(1800, rescale=0.04, rescale_seconds=0.2).lengths()[:, 0].std(), 0.04, 0.01),
    "rescale, of one bone": (lambda: np.ptp(Watch(50, rescale=0.04).lengths(), axis=1).max(), 0.0, 2e-4),
    "rescale_seconds": (lambda: kept(Watch(1800, rescale=0.04, rescale_seconds=0.2).lengths()[:, 0] - 1.0),
                        np.exp(-FRAME / 0.2), 0.06),
    # 32 joints, spells in every other frame: 3,200, known to 0.8 %
    "not_tracked": (lambda: share_of(0, BLINKING, not_tracked=0.3), 0.3, 0.033),
    "mistracked": (lambda: share_of(TRACKED, BLINKING, mistracked=0.3), 0.3, 0.033),
    "seen_share": (lambda: share_of(INFERRED, BLINKING), 1.0, 0.0),
    # 32 hidden joints, a guess lasts 0.6 s: 3,200 independent values in 60 s
    "inferred_error": (lambda: Watch(1800, (0.0 * np.ones(len(BODY)) + 0.3,), seen_share=0.35,
                                     inferred_error=0.08).errors[60:].std(), 0.08, 0.008),
    # 180 spells of each of two joints: 5 %
    "unsure": (lambda: np.mean(Watch(3600, unsure=kinds(thumb=0.3)).states[:, THUMB] == INFERRED), 0.3, 0.09),
    # 32 joints in 60 s: 320 spells of 0.12 s, known to 6 %
    "outliers": (lambda: np.mean(np.abs(Watch(1800, outliers=0.02, outlier_size=0.2).errors) > 1e-5),
                 0.02, 0.005),
    "outlier_size": (lambda: np.abs(Watch(1800, outliers=0.1, outlier_size=0.2).errors).max(), 0.2, 0.002),
    # 1,800 draws: 0.7 %
    "stale": (lambda: Watch(1800, stale=0.1, jitter=ELBOWS).stale.mean(), 0.1, 0.028),
    # 60 spells in four minutes: 13 %
    "lost": (lambda: losing().mean(), 0.1, 0.05),
    "lost_seconds": (lambda: FRAME * np.mean(run_lengths(losing())), 0.4, 0.2),
    "added": (lambda: Watch(20, added=lambda *_: repeat(np.array((1.0, 0.0, 0.0)))).errors.sum(axis=2).mean(),
              1.0, FLOAT32),
    "none": (lambda: np.abs(Watch(20).errors).max(), 0.0, FLOAT32),
    "none, states": (lambda: np.mean(Watch(20).states == TRACKED), 1.0, 0.0),
}  # fmt: skip


@pytest.mark.parametrize("knob", KNOBS)
def test_a_knob_causes_what_it_says(knob):
    statistic, expected, tolerance = KNOBS[knob]
    assert statistic() == pytest.approx(expected, abs=tolerance)


def test_a_mistracked_joint_is_reported_at_the_joint_in_front_of_it_if_there_is_one():
    joints = STANDING.copy()
    elbow, foot = BODY.joint("ELBOW_RIGHT"), BODY.joint("FOOT_RIGHT")
    joints[HAND] = (
        joints[elbow] * 1.15
    )  # straight behind it, seen from the sensor; nothing is before the foot
    watch = Watch(60, one_hidden([HAND, foot]), joints, seen_share=0.35, mistracked=1.0, snap=1.0)
    assert (watch.states == TRACKED).all()
    np.testing.assert_allclose(watch.errors[-1, HAND], joints[elbow] - joints[HAND], atol=1e-5)
    assert np.abs(np.delete(watch.errors, HAND, axis=1)).max() <= FLOAT32


def test_a_bias_changes_smoothly_with_the_view_and_moving_joints_jitter_more():
    def errors_of(motion, seconds, **knobs):
        a, _, truth = simulated_pair(motion=motion, seconds=seconds, errors=replace(NONE, **knobs))
        frames = list(a.frames())
        reported = np.array([frame.people[PERSON].positions for frame in frames])
        return reported - truth.positions_at([frame.time_ns for frame in frames])

    for shared in (0.0, 1.0):
        turning = errors_of("turn", 13.0, view_bias=0.03, shared=shared)
        assert turning[:60].std(axis=0).max() < 0.002  # facing one way: but for the sway's few degrees
        assert np.ptp(turning, axis=0).mean() > 0.02
        assert np.abs(np.diff(turning, axis=0)).max() < 0.02
    still, walking = (np.abs(errors_of(motion, 5.5, moving_jitter=0.01)) for motion in ("still", "walk"))
    assert walking[120:].mean() > 10 * still.mean()


def zeros(body, _, random):
    """Added errors that draw, and change nothing."""
    while True:
        yield 0.0 * random.standard_normal((len(body), 3))


@pytest.mark.parametrize("body", [KINECT_V1, KINECT_V2, AZURE_KINECT, BLAZEPOSE], ids=str)
def test_what_one_error_draws_changes_no_other(body):
    """The person is mirrored in half of the frames and partly hidden; errors are switched off in turn."""
    fitted = TrackerErrors.of(body)
    mirroring = replace(fitted.mirroring, back=0.5, centre=2.0)

    def frames(**knobs):
        errors = replace(fitted, **{"lost": 0.0, "stale": 0.0, "mirroring": mirroring, **knobs})
        sensor = simulated_pair(motion="walk", seconds=6.0, seed=3, body=body, errors=errors)[0]
        return [frame.people[PERSON] for frame in sensor.frames() if frame.people]

    def labels_and_states(**knobs):
        return [one.states.tobytes() for one in frames(**knobs)]

    plain, added = frames(), frames(added=zeros)
    assert len(plain) > 100
    assert [a.positions.tobytes() + a.states.tobytes() for a in plain] == [
        a.positions.tobytes() + a.states.tobytes() for a in added
    ]
    states = labels_and_states()  # drawn by hiding, exchanged by mirroring
    for off in (
        {"view_bias": 0.0},
        {"outliers": 0.0},
        {"rescale": 0.0},
        {"bones": 0.0},
        {"moving_jitter": 0.0},
    ):
        assert labels_and_states(**off) == states
    assert labels_and_states(mirroring=Mirroring()) != states
