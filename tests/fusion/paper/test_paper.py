"""The paper's method: reliability of eqs. (10), (11), and the fuser."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba.core import event
from numba.core.runtime import _nrt_python, rtsys
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V1, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.compiling.kernels import kernel
from fusion.errors import FusionError
from fusion.fuser import Fuser
from fusion.paper import method as paper_method
from fusion.paper.reliability import ViewPixels, weigh_views
from fusion.rigid import RigidTransform
from fusion.setup import PAPER_H, FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from tests.helpers.poses import posed
from tests.helpers.two_views import FRAME_NS, calibration_of, moving, noisy, pair_of, standing

# --- The fuser with the paper's method.


# float32 positions at up to 4 m from a sensor are exact to 2.4e-7 m in each coordinate; R and t of the torso
# add as much again, and turning an error over the longest chain of a body triples it at most.
FLOAT32 = 3e-6

PAPER = FuserSettings(method="paper")
WEIGHTS = ("paper", "equal")


def with_states(skeleton, states):
    all_states = np.array(skeleton.states)
    for name, state in states.items():
        all_states[skeleton.body.joint(name)] = state
    return Skeleton.of(skeleton.body, skeleton.positions, all_states, skeleton.time_ns)


def bone_error(body, frame):
    lengths = bone_lengths_of(body, frame.positions)[body.bone_joints]
    return float(np.abs(lengths - body.nominal_lengths[body.bone_joints]).max())


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_fused_bones_have_their_length_whatever_the_noise(body):
    rng = np.random.default_rng(5)
    fuser = Fuser(FusionSetup(calibration_of(body), PAPER))
    for t, at in enumerate(moving(body, 40)):
        frame = fuser.update(noisy(pair_of(body, at, t * FRAME_NS), rng, 0.06))
        assert bone_error(body, frame) < 1e-9


def test_a_joint_that_was_never_seen_points_as_at_rest():
    body = KINECT_V2
    truth = posed(body, {})
    lost = dict.fromkeys(("HandLeft", "HandTipLeft"), TrackingState.NOT_TRACKED)
    seen = pair_of(body, truth)
    pair = SkeletonPair(with_states(seen.a, lost), with_states(seen.b, lost), 0)
    frame = Fuser(FusionSetup(calibration_of(body), PAPER)).update(pair)
    np.testing.assert_allclose(frame.positions, truth, atol=1e-5)


@pytest.mark.parametrize(("seconds", "forgotten"), [(0.5, False), (1.5, True)])
def test_after_a_second_without_anyone_the_frame_before_is_forgotten(seconds, forgotten):
    body = KINECT_V2
    lost = dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft", "HandTipLeft"), TrackingState.NOT_TRACKED)
    back = pair_of(body, standing(body, arms_out=20.0), round(seconds * 1e9))
    back = SkeletonPair(with_states(back.a, lost), with_states(back.b, lost), back.time_ns)
    fuser = Fuser(FusionSetup(calibration_of(body), PAPER))
    fuser.update(pair_of(body, standing(body, arms_out=80.0)))
    found = fuser.update(back).positions
    anew = Fuser(FusionSetup(calibration_of(body), PAPER)).update(back).positions
    elbow = body.joint("ElbowLeft")
    assert (np.linalg.norm(found[elbow] - anew[elbow]) < FLOAT32) == forgotten


@pytest.mark.parametrize("h", [0.5, 1.0, 2.0, float("nan")])
def test_h_outside_its_range_is_refused(h):
    with pytest.raises(FusionError, match=r"between 0\.5 and 1"):
        FuserSettings(h=h)


def test_a_sequence_is_bit_for_bit_the_pairs_one_by_one():
    body = KINECT_V2
    rng = np.random.default_rng(9)
    pairs = [noisy(pair_of(body, at, t * FRAME_NS), rng, 0.05) for t, at in enumerate(moving(body, 60))]
    pairs[20] = SkeletonPair(None, pairs[20].b, pairs[20].time_ns)
    pairs[21] = SkeletonPair(None, None, pairs[21].time_ns)
    pairs[22] = SkeletonPair(
        with_states(pairs[22].a, {"HandLeft": TrackingState.NOT_TRACKED}), None, 22 * FRAME_NS
    )
    pairs[30] = replace(pairs[30], b=pairs[29].b)
    one_by_one, at_once = (Fuser(FusionSetup(calibration_of(body), PAPER)) for _ in range(2))
    frames = at_once.fuse_sequence(pairs)
    assert np.flatnonzero(frames[22].predicted).tolist() == [body.joint("HandLeft")]
    assert frames[21].predicted.all()
    assert (frames[30].stale_a, frames[30].stale_b) == (False, True)
    for single, of_sequence in zip([one_by_one.update(pair) for pair in pairs], frames, strict=True):
        assert single.positions.tobytes() == of_sequence.positions.tobytes()
        assert single.weights_a.tobytes() == of_sequence.weights_a.tobytes()
        assert single.a_from_b.translation.tobytes() == of_sequence.a_from_b.translation.tobytes()
        assert (single.iterations, single.stale_a, single.stale_b) == (
            of_sequence.iterations, of_sequence.stale_a, of_sequence.stale_b,
        )  # fmt: skip


def test_a_frame_allocates_nothing():
    """A call allocates the same memory for any number of frames."""
    _nrt_python.memsys_enable_stats()
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 20))]
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1), PAPER))
    allocated = []
    try:
        for some in (pairs[:1], pairs[:1], pairs):
            before = rtsys.get_allocation_stats()
            fuser.fuse_sequence(some)
            after = rtsys.get_allocation_stats()
            allocated.append((after.alloc - before.alloc, after.mi_alloc - before.mi_alloc))
    finally:
        _nrt_python.memsys_disable_stats()
    assert allocated[1] > (0, 0)  # they are counted
    assert allocated[2] == allocated[1]


@pytest.mark.parametrize(
    ("method", "name"), [("paper", "fuse_frames"), ("published", "fuse_frames_as_published")]
)
def test_no_frame_after_warming_up_compiles(method, name, monkeypatch):
    fresh = kernel(getattr(paper_method, name).py_func)  # as in a new process
    monkeypatch.setattr(paper_method, name, fresh)
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 8))]
    pairs += [
        SkeletonPair(None, None, 8 * FRAME_NS),
        SkeletonPair(pairs[0].a, None, 9 * FRAME_NS),
        SkeletonPair(None, pairs[0].b, 10 * FRAME_NS),
        replace(a_noisy_pair(KINECT_V1, 0), time_ns=11 * FRAME_NS),
    ]
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1), FuserSettings(method=method)))
    fuser.warm_up()
    assert len(fresh.signatures) == 1
    with event.install_recorder("numba:compile") as compiling:
        for pair in pairs:
            fuser.update(pair)
        fuser.fuse_sequence(pairs)
    assert compiling.buffer == []
    assert len(fresh.signatures) == 1  # a kernel found on disk here would have to be compiled elsewhere


def test_warming_up_leaves_no_trace():
    body = KINECT_V1
    pairs = [pair_of(body, at, t * FRAME_NS) for t, at in enumerate(moving(body, 5))]
    cold, warm = (Fuser(FusionSetup(calibration_of(body), PAPER)) for _ in range(2))
    warm.warm_up()
    for pair in pairs:
        assert cold.update(pair).positions.tobytes() == warm.update(pair).positions.tobytes()


def a_noisy_pair(body, seed):
    """Views that differ by 20 mm a coordinate, with an inferred joint in each and one that B lost."""
    rng = np.random.default_rng(seed)
    pair = noisy(pair_of(body, standing(body)), rng, 0.02)
    i, j, k = rng.choice(len(body), 3, replace=False)
    a = with_states(pair.a, {body.joints[i]: TrackingState.INFERRED})
    b = with_states(
        pair.b, {body.joints[j]: TrackingState.INFERRED, body.joints[k]: TrackingState.NOT_TRACKED}
    )
    return SkeletonPair(a, b, 0)


def moved_by(skeleton, by):
    return Skeleton.of(skeleton.body, by.apply(skeleton.positions), skeleton.states, skeleton.time_ns)


def fused_in_moved_frames(pair, weights, by_a, by_b):
    """S* of a pair, moved; and S* of the pair whose views were moved, each by its sensor's motion."""
    chosen = FuserSettings(method="paper", weights=weights)
    calibration = calibration_of(pair.a.body)
    other = replace(calibration, a_from_b=by_a @ calibration.a_from_b @ by_b.inverse())
    plain = Fuser(FusionSetup(calibration, chosen)).update(pair)
    moved = Fuser(FusionSetup(other, chosen)).update(
        SkeletonPair(moved_by(pair.a, by_a), moved_by(pair.b, by_b), 0)
    )
    return by_a.apply(plain.positions), moved.positions


# Both runs round to float32, each in its own frame.
TWICE = 2 * FLOAT32


@given(seed=st.integers(0, 10_000), angles=st.tuples(*[st.floats(-180.0, 180.0)] * 2))
def test_a_sensor_turned_about_its_optical_axis_turns_the_skeleton_with_it(seed, angles):
    """The motion that leaves all distances in a viewing plane as they are, and so eqs. (10), (11)."""
    turns = [
        RigidTransform.of(Rotation.from_euler("z", angle, degrees=True).as_matrix(), np.zeros(3))
        for angle in angles
    ]
    expected, got = fused_in_moved_frames(a_noisy_pair(KINECT_V2, seed), "paper", *turns)
    np.testing.assert_allclose(got, expected, rtol=0, atol=TWICE)


@given(seed=st.integers(0, 10_000), shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_with_equal_weights_any_motion_of_a_sensor_moves_the_skeleton_with_it(seed, shift):
    centre = np.array([0.0, 0.0, 2.6])  # a rotation that keeps the person in front of the sensor
    motions = []
    for rotation in Rotation.random(2, rng=seed):
        R = rotation.as_matrix()
        motions.append(RigidTransform.of(R, centre - R @ centre + shift))
    expected, got = fused_in_moved_frames(a_noisy_pair(KINECT_V2, seed), "equal", *motions)
    np.testing.assert_allclose(got, expected, rtol=0, atol=TWICE)


@given(seed=st.integers(0, 10_000), weights=st.sampled_from(WEIGHTS))
def test_a_weighted_mean_with_the_right_bones_is_the_skeleton(seed, weights):
    body = KINECT_V2
    pair = a_noisy_pair(body, seed)
    chosen = FuserSettings(method="paper", weights=weights)
    first = Fuser(FusionSetup(calibration_of(body), chosen)).update(pair)
    b_in_a = np.nan_to_num(first.a_from_b.apply(pair.b.positions))  # where B has no joint its weight is 0
    mean = first.weights_a[:, None] * pair.a.positions + first.weights_b[:, None] * b_in_a
    calibration = replace(calibration_of(body), bone_lengths=bone_lengths_of(body, mean))
    frame = Fuser(FusionSetup(calibration, chosen)).update(pair)
    # no step is needed: the remaining error is the rounding of a few metres, summed along the longest chain
    np.testing.assert_allclose(frame.positions, mean, rtol=0, atol=1e-12)


# --- The reliability of a view, eqs. (10), (11).


def by_the_paper(pixels_a, pixels_b, states_a, states_b, linked, h):
    """A direct implementation of sec. 3, one joint at a time."""
    joints = range(len(pixels_a))
    has_a = [bool(np.isfinite(pixels_a[i]).all()) for i in joints]
    has_b = [bool(np.isfinite(pixels_b[i]).all()) for i in joints]
    result = []
    for i in joints:
        if not (has_a[i] and has_b[i]):
            result.append((float(has_a[i]), float(has_b[i]), -1))
            continue
        in_a = {j: np.linalg.norm(pixels_a[i] - pixels_a[j]) for j in joints if has_a[j] and has_b[j]}
        in_b = {j: np.linalg.norm(pixels_b[i] - pixels_b[j]) for j in in_a}
        candidates = [j for j in in_a if not linked[i, j]]
        basic_a = basic_b = 0.5
        m = -1
        if candidates:
            j, k = min(candidates, key=in_a.__getitem__), min(candidates, key=in_b.__getitem__)
            m = j if in_a[j] < in_b[k] else k
            if in_a[m] + in_b[m] > 0:
                basic_a, basic_b = in_a[m] / (in_a[m] + in_b[m]), in_b[m] / (in_a[m] + in_b[m])
        h_a, h_b = (h if states_a[i] == 2 else 1 - h), (h if states_b[i] == 2 else 1 - h)
        power_a, power_b = (h_a * basic_a) ** 4, (h_b * basic_b) ** 4
        result.append((power_a / (power_a + power_b), power_b / (power_a + power_b), m))
    return tuple(np.array(column) for column in zip(*result, strict=True))


def reliability_weights(pixels_a, pixels_b, states_a, states_b, linked, h=PAPER_H):
    joints = len(pixels_a)
    weights_a, weights_b, misleading = np.empty(joints), np.empty(joints), np.empty(joints, dtype=np.int64)
    views = ViewPixels(pixels_a, pixels_b, states_a, states_b, np.empty(joints, dtype=np.bool_))
    weigh_views(views, linked, h, weights_a, weights_b, misleading)
    return weights_a, weights_b, misleading


def random_views(rng, body):
    pixels_a, pixels_b = rng.uniform(0, 500, (2, len(body), 2))
    states_a, states_b = rng.choice([1, 2], (2, len(body)), p=[0.3, 0.7]).astype(np.uint8)
    for pixels, states in ((pixels_a, states_a), (pixels_b, states_b)):
        hole = rng.random(len(body)) < rng.choice([0.0, 0.2, 0.9])
        pixels[hole], states[hole] = np.nan, 0
    if rng.random() < 0.3:  # joints that lie on each other in both views
        pixels_a[:3], pixels_b[:3] = pixels_a[0], pixels_b[0]
    return pixels_a, pixels_b, states_a, states_b, body.linked.copy()


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_weights_are_those_of_the_paper_word_by_word(body):
    rng = np.random.default_rng(0)
    for _ in range(60):
        views = random_views(rng, body)
        h = rng.uniform(0.5, 1.0)
        weights_a, weights_b, misleading = reliability_weights(*views, h)
        expected_a, expected_b, expected_misleading = by_the_paper(*views, h)
        np.testing.assert_allclose(weights_a, expected_a, rtol=0, atol=1e-12)
        np.testing.assert_allclose(weights_b, expected_b, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(misleading, expected_misleading)
