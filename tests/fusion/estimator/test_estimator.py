"""Properties of S* with the method duplex, on a person with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.compiling.kernels import kernel
from fusion.errors import FusionError
from fusion.estimator.arrays import Views
from fusion.estimator.constants import Constants
from fusion.estimator.measurements.heading import turn_girdles
from fusion.facing.labels import Labels
from fusion.facing.model import new_facing_model
from fusion.fuser import Fuser
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.support.array_fields import new_arrays
from tests.helpers.labelled_views import heading, simulated_views
from tests.helpers.laws import pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, standing

BODY = KINECT_V2


def fuser(smoothing=0.5, body=BODY, calibration=None):
    """Without headings: these artificial people have no front."""
    setup = FusionSetup(calibration or calibration_of(body), FuserSettings(smoothing=smoothing))
    return Fuser(setup, Constants.of(body)._replace(heading=False))


def recording(truth, sd=0.0, seed=0, body=BODY):
    return pairs_at(np.arange(len(truth)) * FRAME_NS, truth, body, sd=sd, seed=seed)


def changed(skeleton, change):
    return Skeleton.of(
        skeleton.body, change(skeleton.positions.astype(float)), skeleton.states, skeleton.time_ns
    )


def fused(pairs, smoothing=0.5, body=BODY):
    """S* without correction of sides: these artificial people have no front."""
    return fuser(smoothing, body).fuse_sequence(pairs, Labels.with_sides(np.zeros((len(pairs), 2))))


def positions(frames):
    return np.array([frame.positions for frame in frames])


def apart(a, b):
    return np.linalg.norm(a - b, axis=-1)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_two_flawless_views_of_a_still_person_give_the_truth(body):
    truth = np.tile(standing(body), (20, 1, 1))
    shaken = recording(truth, 1e-6, body=body)  # a skeleton that repeats would be stale
    np.testing.assert_allclose(positions(fused(shaken, body=body)), truth, atol=1e-5)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_bones_are_exact_whatever_the_noise(body):
    for frame in fused(recording(moving(body, 40), 0.06, body=body), body=body):
        lengths = bone_lengths_of(body, frame.positions)[body.bone_joints]
        np.testing.assert_allclose(lengths, body.nominal_lengths[body.bone_joints], atol=1e-9)


def test_a_stale_view_is_no_measurement():
    pairs = recording(moving(BODY, 70)[40:], 0.005)
    pairs[20] = replace(pairs[20], b=pairs[19].b)
    frame = fused(pairs)[20]
    assert frame.stale_b
    assert (frame.weights_b == 0.0).all()
    assert (frame.weights_a[~frame.predicted] == 1.0).all()


def test_the_skeleton_stays_between_the_views_while_one_of_them_is_lost():
    """After 12 s of agreement, B is lost for three: S* moves by less than half of the way to A.

    The views are 6 cm apart, so S* lies 3 cm from A. n / (n + 3 s) of an offset is known after n = 12 s,
    and S* would keep 0.8 of it; without usual offsets it keeps exp(-3/0.85), 3 %.
    """
    truth = np.tile(standing(BODY), (450, 1, 1))
    pairs = [replace(p, b=changed(p.b, lambda at: at + 0.035)) for p in recording(truth, 0.002)]
    for k in range(360, 450):
        pairs[k] = replace(pairs[k], b=None)
    found = positions(fused(pairs))
    seen = np.array([p.a.positions for p in pairs if p.a is not None])
    before, after = (
        np.median(apart(found[k], seen[k].mean(axis=0))) for k in (slice(300, 360), slice(440, 450))
    )
    assert after > 0.5 * before > 0.01


def test_another_calibration_makes_no_jump_and_is_followed():
    truth = np.tile(standing(BODY), (200, 1, 1))
    pairs = recording(truth, 0.002)
    off = RigidTransform.of(
        Rotation.from_euler("y", 4.0, degrees=True).as_matrix() @ A_FROM_B.rotation,
        A_FROM_B.translation + np.array((0.05, 0.0, 0.03)),
    )
    wrong = Calibration(BODY, off, BODY.nominal_lengths, "knocked")
    found = fuser(calibration=wrong)
    before = [found.update(pair, Labels.with_sides([(0, 0)])) for pair in pairs[:60]]
    found.recalibrate(FusionSetup(calibration_of(BODY)))
    after = [found.update(pair, Labels.with_sides([(0, 0)])) for pair in pairs[60:]]
    # the noise, and (1/30 s)² / 0.15 s² of the 0.23 m by which the calibration changes
    assert apart(after[0].positions, before[-1].positions).max() < 0.006 + 0.0074 * 0.23
    assert (
        np.median(apart(after[-1].positions, truth[-1]))
        < np.median(apart(before[-1].positions, truth[0])) / 3.0
    )
    with pytest.raises(FusionError, match="body and settings stay"):
        found.recalibrate(FusionSetup(calibration_of(BODIES["kinect_v1"])))


@pytest.mark.parametrize("metres", [0.1, 1.0])
@pytest.mark.parametrize("before", [0, 150])
def test_a_corrected_calibration_leaves_no_error_behind(before, metres):
    """For two seconds B is not where it is assumed, from the start or after a knock; then this is known."""
    truth = np.tile(standing(BODY), (before + 240, 1, 1))
    moved = RigidTransform.of(np.eye(3), np.array((metres, 0.0, 0.0)))
    old = calibration_of(BODY)
    pairs = [
        pair if k < before else replace(pair, b=changed(pair.b, moved.inverse().apply))
        for k, pair in enumerate(recording(truth, 0.002))
    ]
    found = fuser(calibration=old)
    for pair in pairs[: before + 60]:
        found.update(pair, Labels.with_sides([(0, 0)]))
    found.recalibrate(FusionSetup(replace(old, a_from_b=old.a_from_b @ moved)))
    last = [found.update(pair, Labels.with_sides([(0, 0)])).positions for pair in pairs[before + 60 :]][-30:]
    assert np.median(apart(np.array(last), truth[-30:])) < 0.005


def test_a_smoothed_recording_is_nearer_to_the_truth_and_has_exact_bones():
    truth = moving(BODY, 200)
    pairs = recording(truth, 0.015)
    filtered, smoothed = fused(pairs), fuser().smooth_sequence(pairs, Labels.with_sides(np.zeros((200, 2))))
    off, smooth_off = (apart(positions(frames), truth)[10:-10].mean() for frames in (filtered, smoothed))
    assert smooth_off < 0.9 * off
    rough, smooth_rough = (
        np.abs(np.diff(positions(frames), 2, axis=0)).mean() for frames in (filtered, smoothed)
    )
    assert smooth_rough < 0.8 * rough
    lengths = bone_lengths_of(BODY, positions(smoothed))[:, BODY.bone_joints]
    np.testing.assert_allclose(lengths - BODY.nominal_lengths[BODY.bone_joints], 0.0, atol=1e-9)
    with pytest.raises(FusionError, match="Only the method duplex"):
        Fuser(FusionSetup(calibration_of(BODY), FuserSettings(method="paper"))).smooth_sequence(pairs)


def test_what_b_sees_alone_is_as_uncertain_as_its_place():
    """Earlier versions took K_B to be K_A before a calibration; one may be loaded without its deviation."""
    pairs = [replace(pair, a=None) for pair in recording(np.tile(standing(BODY), (10, 1, 1)))]
    sides = Labels.with_sides(np.zeros((len(pairs), 2)))
    earlier = replace(nominal_calibration(BODY), placed=True)
    for calibration, least in ((earlier, 1.0), (calibration_of(BODY), 0.05)):
        frame = fuser(calibration=calibration).fuse_sequence(pairs, sides)[-1]
        assert frame.sigma.min() > least


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30))
@pytest.mark.parametrize("method", ["duplex", "paper", "published"])
def test_s_star_is_of_a_alone_while_the_place_of_b_is_unknown(method, seen):
    pairs = [
        replace(pair, a=pair.a if a else None, b=pair.b if b else None)
        for pair, (a, b) in zip(recording(moving(BODY, len(seen))), seen, strict=True)
    ]
    alone = [replace(pair, b=None) for pair in pairs]
    setup = FusionSetup(nominal_calibration(BODY), FuserSettings(method))
    whole, of_a = (Fuser(setup).fuse_sequence(each) for each in (pairs, alone))
    one_by_one = Fuser(setup)
    for frame, expected, pair in zip(whole, of_a, pairs, strict=True):
        np.testing.assert_array_equal(frame.positions, expected.positions)
        np.testing.assert_array_equal(one_by_one.update(pair).positions, expected.positions)
    if not any(a for a, _ in seen):
        assert not any(frame.has_person for frame in whole)


def test_the_reported_deviation_holds_the_truth():
    """Errors as the filter assumes them: a lasting one of the joint's own size in each view, a fast one."""
    body, inside = BODY, []
    exact = Registration(A_FROM_B, 0.0, 0.0, np.zeros(len(body)), 0.0, 1, body, 0.0)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        model = fuser()._fusion._filter.model
        k = model.constants
        truth = moving(body, 100, seed)
        bias = rng.normal(size=(2, len(body), 3)) * k.slow_scale * model.slow[:, None]
        pairs = [
            replace(p, a=changed(p.a, lambda at: at + bias[0]), b=changed(p.b, lambda at: at + bias[1]))  # noqa: B023
            for p in recording(truth, 0.003, seed)
        ]
        setup = FusionSetup(replace(calibration_of(body), registration=exact))
        found = Fuser(setup, k._replace(spread=1.0))
        frames = found.fuse_sequence(pairs, Labels.with_sides(np.zeros((len(pairs), 2))))[40:]
        sigma = np.array([frame.sigma for frame in frames])
        inside.append([np.mean(apart(positions(frames), truth[40:]) < n * sigma) for n in (1, 2)])
    one, two = np.mean(inside, axis=0)
    assert 0.5 < one < 0.95
    assert two > 0.9


# --- Shoulders and hips turned towards the heading.


@kernel
def turn(model, up, sensors, views):
    turn_girdles(model, up, sensors, views)


def turned(body, to, confidence):
    """(J, 3) a person before and after, whose back is turned to both sensors, with the heading ``to``."""
    views = new_arrays(Views, J=len(body))
    before = standing(body)
    views.positions[:], views.states[:] = before, 2
    views.heading[:] = confidence * to
    sensors = np.stack([before.mean(axis=0) - 100.0 * to] * 2)
    turn(new_facing_model(body), np.array((0.0, -1.0, 0.0)), sensors, views)
    np.testing.assert_array_equal(views.positions[0], views.positions[1])
    return before, views.positions[0]


def test_a_certain_heading_turns_a_kinect_v2s_shoulders_and_hips():
    to = np.array((0.6, 0.0, 0.8))
    before, after = turned(KINECT_V2, to, 1.0)
    np.testing.assert_allclose(heading(KINECT_V2, after[None])[0], to, atol=1e-4)
    girdles = [[KINECT_V2.joint(n + side) for side in ("Left", "Right")] for n in ("Shoulder", "Hip")]
    for pair in girdles:
        np.testing.assert_allclose(after[pair].mean(axis=0), before[pair].mean(axis=0), atol=1e-12)
        widths = [np.linalg.norm(x[pair[0]] - x[pair[1]]) for x in (before, after)]
        assert widths[0] == pytest.approx(widths[1], abs=1e-12)
    rest = np.setdiff1d(np.arange(len(KINECT_V2)), np.ravel(girdles))
    np.testing.assert_array_equal(after[rest], before[rest])


def test_an_uncertain_heading_turns_them_little_and_other_trackers_not_at_all():
    to = np.array((0.6, 0.0, 0.8))
    for body, confidence, limit in ((KINECT_V2, 0.0, 0.25), (AZURE_KINECT, 1.0, 1e-5)):
        before, after = (heading(body, x[None])[0] for x in turned(body, to, confidence))
        assert np.arccos(min(before @ after, 1.0)) <= limit * np.arccos(before @ to)


def test_the_trunk_follows_a_walk_that_kinects_v2_report_askew():
    views = simulated_views("walk", seconds=20.0, seed=4002)
    calibration = Calibration(
        KINECT_V2, RigidTransform.of(np.eye(3), views.sensor_b), KINECT_V2.nominal_lengths, "known"
    )
    pairs = [
        SkeletonPair(
            Skeleton.of(KINECT_V2, views.a[t], views.states_a[t], time),
            Skeleton.of(KINECT_V2, views.b_in_a[t] - views.sensor_b, views.states_b[t], time),
            time,
        )
        for t, time in enumerate(views.time_ns.tolist())
    ]
    off = []
    for on in (True, False):
        fuser = Fuser(FusionSetup(calibration), Constants.of(KINECT_V2)._replace(heading=on))
        fused = np.array([fuser.update(pair).positions for pair in pairs])
        along = np.sum(heading(KINECT_V2, fused) * heading(KINECT_V2, views.truth), axis=1)
        off.append(np.degrees(np.arccos(np.clip(along[60:], -1.0, 1.0))))
    assert off[0].mean() < 0.8 * off[1].mean()
