"""Left and right: labels of the facing filter, the doubt about a view, and poses."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given

from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, BLAZEPOSE, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.compiling.references import by_reference
from fusion.facing.evidence import upright_direction
from fusion.facing.filter import update_facing
from fusion.facing.labels import Labels
from fusion.facing.model import LEGS, WHOLE, FacingConstants, FacingState, new_facing_model
from fusion.fuser import Fuser
from fusion.plan import plan_recording
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.support.array_fields import new_arrays
from tests.helpers.exercises import POSES, UP, Exercise, exercises
from tests.helpers.labelled_views import FRAME, flips, heading, simulated_views, step, swapped
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

# --- Labels found by the facing filter: goals on simulated truth, faults.


def exchanged(views, which, first, last):
    """The views with labels exchanged in some frames."""
    source = views.body.mirror
    a, b = views.a.copy(), views.b_in_a.copy()
    for hit, at in zip(which, (a, b), strict=True):
        if hit:
            at[first:last] = at[first:last][:, source]
    return replace(views, a=a, b_in_a=b)


@pytest.mark.parametrize("motion", ["arms", "squat"])
@pytest.mark.parametrize("which", [(True, False), (False, True)])
def test_a_view_exchanged_at_once_is_known_in_the_same_frame(motion, which):
    views = exchanged(simulated_views(motion, tracker="right"), which, 150, 170)
    labels = views.relabel(smooth=False)
    hit = int(which[1])
    codes = labels.codes & WHOLE
    assert (codes[152:170, hit] == WHOLE).all()  # two frames, of which one may be stale
    assert (codes[150:170, 1 - hit] == 0).all()
    assert (codes[174:250] == 0).all()
    assert not swapped(views.body, views.fused(labels), views.truth).any()


@pytest.mark.parametrize(("first", "last", "found_at"), [(150, 250, 0), (0, 150, 120)])
def test_both_views_exchanged_at_once_are_found_and_let_go(first, last, found_at):
    """From the start there is no jump, and both views agree: knees, elbows, head and motion show it."""
    views = exchanged(simulated_views("walk", tracker="right"), (True, True), first, last)
    for smooth in (False, True):
        labels = views.relabel(smooth=smooth)
        assert not swapped(views.body, views.fused(labels), views.truth)[found_at:].any()


TURNED_BACKS = [
    ("walk", 45.0), ("turn", 90.0), ("squat@180", 90.0), ("bow@180", 90.0), ("backwards", 90.0),
]  # fmt: skip


def exchanged_shares(body, seconds, *seeds):
    """Shares of exchanged frames after two seconds: of the better view, of live S*, of a recording's S*."""
    found = []
    for (motion, angle), seed in product(TURNED_BACKS, seeds):
        views = simulated_views(motion, body, angle_deg=angle, seconds=seconds, seed=seed)
        labels = [views.relabel(smooth=smooth) for smooth in (False, True)]
        each = (views.a, views.b_in_a, *(views.fused(of) for of in labels))
        shares = [swapped(views.body, positions, views.truth)[60:].mean() for positions in each]
        found.append((min(shares[:2]), *shares[2:]))
    return np.mean(found, axis=0)


def test_a_fused_skeleton_of_azure_kinects_keeps_its_sides():
    _, live, whole = exchanged_shares("azure_kinect", 8.0, 11)
    assert live <= 0.01
    assert whole <= 0.003


def test_a_fused_skeleton_of_kinects_v2_is_seldom_exchanged():
    """The goals, 1 % live and 0.3 % of recordings, are missed: seed 11 is kind, seed 4000 is not."""
    view, live, whole = exchanged_shares("kinect_v2", 12.0, 11, 4000)
    assert view > 0.2  # the claim is not empty
    assert live <= 0.2 * view
    assert whole <= 0.2 * view


@pytest.mark.parametrize("motion", ["walk", "turn", "arms@120"])
def test_sides_swapped_at_random_never_reach_the_fused_skeleton(motion):
    views = simulated_views(motion, tracker="random", seconds=20.0, seed=4001)
    before = swapped(views.body, views.a, views.truth) | swapped(views.body, views.b_in_a, views.truth)
    assert before.mean() > 0.05  # the claim is not empty
    fused = views.fused(views.relabel(smooth=False))
    assert swapped(views.body, fused, views.truth)[30:].mean() <= 0.01
    assert flips(heading(views.body, fused)[30:]) == 0


def test_stale_skeletons_are_no_evidence():
    views = simulated_views("walk", tracker="right")
    model = by_reference(new_facing_model(KINECT_V2))
    state = by_reference(new_arrays(FacingState, J=len(KINECT_V2)))
    for k in range(200):
        step(model, state, views, k)
    codes, facing, mirrored_before = (
        state.result.codes.copy(),
        state.result.facing.copy(),
        state.result.mirrored.copy(),
    )
    for _ in range(30):
        step(model, state, views, 199, stale=(True, True))
    np.testing.assert_array_equal(state.result.codes, codes)
    np.testing.assert_allclose(state.result.mirrored, mirrored_before, atol=1e-6)
    assert state.evidence.likelihood.min() == state.evidence.likelihood.max() == 0.0
    assert state.result.facing @ facing > 0.9
    assert state.result.confidence[0] < 0.95  # less certain after a second without evidence


@pytest.mark.parametrize("smooth", [False, True])
def test_a_view_that_misses_frames_keeps_its_labels_in_between(smooth):
    views = simulated_views("walk")
    b, states_b = views.b_in_a.copy(), views.states_b.copy()
    b[1::2], states_b[1::2] = np.nan, 0
    whole = views.relabel(smooth=smooth).codes[:, 1]
    half = replace(views, b_in_a=b, states_b=states_b).relabel(smooth=smooth).codes[:, 1]
    changes = np.count_nonzero(np.diff(whole))
    assert changes > 1
    assert np.count_nonzero(np.diff(half)) <= changes + 2
    assert (half == whole).mean() > 0.95


def test_a_skeleton_is_repeated_also_after_moments_without_the_view():
    views = simulated_views("walk", seconds=4.0)
    b, states_b = views.b_in_a.copy(), views.states_b.copy()
    b[40:80], states_b[40:80] = b[40], states_b[40]
    b[1::2], states_b[1::2] = np.nan, 0
    stale = replace(views, b_in_a=b, states_b=states_b).reported().stale[:, 1]
    assert stale[42:80].all()
    assert stale[1::2].all()
    assert not stale[:40:2].all()


def test_a_held_posture_does_not_change_the_labels():
    views = simulated_views("walk", tracker="right")
    model = by_reference(new_facing_model(KINECT_V2))
    state = by_reference(new_arrays(FacingState, J=len(KINECT_V2)))
    for k in range(60):
        step(model, state, views, k)
    assert (state.result.codes == 0).all()
    # Three seconds of a posture whose head says the opposite, and whose knees and elbows say nothing.
    front, body = heading(views.body, views.truth[59:60])[0], views.body
    held = []
    for at in (views.a[59].copy(), views.b_in_a[59].copy()):
        at[body.joint("Head")] -= 0.10 * front
        for first, middle, last in (("Hip", "Knee", "Ankle"), ("Shoulder", "Elbow", "Wrist")):
            for side in ("Left", "Right"):
                ends = at[body.joint(first + side)] + at[body.joint(last + side)]
                at[body.joint(middle + side)] = 0.5 * ends
        held.append(at)
    for k in range(90):
        shake = 1e-4 * np.sin(k + np.arange(75.0)).reshape(25, 3)
        pair = views.reported_at(59)._replace(positions=np.stack(held) + shake)
        update_facing(model, state, pair, FRAME)
    assert (state.result.codes == 0).all()


@pytest.mark.parametrize("motion", ["badminton", "boxing", "arms", "still"])
def test_heads_that_both_trackers_place_too_far_back_do_not_turn_the_person(motion):
    """By 70 mm, two or three deviations of a recording's mean, in both views."""
    views = simulated_views(motion, seconds=6.0)
    back = 0.07 * heading(views.body, views.truth)
    a, b, head = views.a.copy(), views.b_in_a.copy(), views.body.joint("Head")
    a[:, head] -= back
    b[:, head] -= back
    views = replace(views, a=a, b_in_a=b)
    for smooth in (False, True):
        labels = views.relabel(smooth=smooth)
        assert (np.sum(labels.heading * heading(views.body, views.truth), axis=1)[60:] > 0.0).all()


def test_a_missing_view_a_missing_person_and_views_that_contradict_each_other():
    views = simulated_views("walk", tracker="right")
    model = by_reference(new_facing_model(KINECT_V2))
    state = by_reference(new_arrays(FacingState, J=len(KINECT_V2)))
    gone = replace(views, b_in_a=np.full_like(views.b_in_a, np.nan), states_b=np.zeros_like(views.states_b))
    nobody = replace(gone, a=np.full_like(views.a, np.nan), states_a=np.zeros_like(views.states_a))
    inverted = replace(views, b_in_a=-views.b_in_a)
    for k, seen in enumerate([inverted] * 20 + [views] * 130 + [nobody] * 30 + [gone] * 80):
        step(model, state, seen, k, stale=(False, seen is gone))
        assert np.isfinite(state.result.mirrored).all()
    assert (state.result.codes[0], state.result.codes[1]) == (0, 0)
    facing = heading(views.body, views.truth[259:260])[0]
    assert state.result.facing @ facing > 0.5


def test_a_rough_registration_is_good_enough():
    yaw = np.radians(12.0)
    R = np.array(((np.cos(yaw), 0.0, np.sin(yaw)), (0.0, 1.0, 0.0), (-np.sin(yaw), 0.0, np.cos(yaw))))
    views = simulated_views("walk")
    rough = replace(
        views, b_in_a=views.b_in_a @ R.T + (0.2, 0.0, -0.2), sensor_b=R @ views.sensor_b + (0.2, 0.0, -0.2)
    )
    labels = rough.relabel()
    a, b = views.relabelled(labels)
    # A tracker changes over in 0.25 s, its legs up to 0.5 s later: labels are wrong for a part of that.
    assert swapped(views.body, a, views.truth)[60:].mean() <= 0.08
    assert swapped(views.body, b, views.truth)[60:].mean() <= 0.08


def test_every_body_has_a_model():
    azure = new_facing_model(AZURE_KINECT)
    assert azure.heading_placed[AZURE_KINECT.joint("Nose")]
    assert azure.face[AZURE_KINECT.joint("EarLeft")]
    shares = [FacingConstants.of(body).mirrored_back for body in (BLAZEPOSE, AZURE_KINECT, KINECT_V2)]
    assert shares == sorted(set(shares)), "of the trackers, from the one that errs least"


# --- The doubt about a view's sides when its labels are known beforehand.


SETUP = FusionSetup(
    Calibration(KINECT_V2, A_FROM_B, KINECT_V2.nominal_lengths, "known"), FuserSettings(hindsight="labels")
)


def walk(count):
    pairs = []
    for k, truth in enumerate(np.tile(moving(KINECT_V2, 1), (count, 1, 1))):
        a, b = (
            Skeleton.of(KINECT_V2, at, None, k * FRAME_NS) for at in (truth, A_FROM_B.inverse().apply(truth))
        )
        pairs.append(SkeletonPair(a, b, k * FRAME_NS))
    return pairs


def test_labels_are_stored_to_the_nearest_step():
    labels = Labels.with_sides([[WHOLE, 0], [5, 7]], [[0.0, 1.0], [0.2, 0.5019]])
    labels.heading[:] = (0.2, 0.0, -0.9)
    stored = labels.as_stored()
    np.testing.assert_array_equal(stored.codes, labels.codes)
    np.testing.assert_array_equal(stored.doubt * np.float32(255.0), [[0, 255], [51, 128]])
    np.testing.assert_array_equal(stored.heading, np.array([(205, 0, -922)] * 2, np.float32) / 1024)


def test_recorded_sides_without_doubt_give_a_live_run_again():
    """A replay of a live session knows the sides only; the filter finds the doubt again, to the bit."""
    pairs = walk(40)
    fuser, again = Fuser(SETUP), Fuser(SETUP)
    live = [fuser.update(pair) for pair in pairs]
    labels = Labels.with_sides([(frame.exchanged_a, frame.exchanged_b) for frame in live], np.nan)
    for k, (frame, pair) in enumerate(zip(live, pairs, strict=True)):
        replayed = again.update(pair, labels.rows(slice(k, k + 1)))
        assert (replayed.doubt_a, replayed.doubt_b) == (frame.doubt_a, frame.doubt_b)
        assert replayed.positions.tobytes() == frame.positions.tobytes()
    legs = again.update(replace(pairs[0], time_ns=40 * FRAME_NS), Labels.with_sides([(LEGS, 0)], np.nan))
    assert legs.exchanged_a == LEGS, "version 1.0 exchanged limbs alone"


def test_the_fused_frame_tells_code_and_doubt():
    fuser = Fuser(SETUP)
    labels = Labels.with_sides([(WHOLE, 0)], (0.0, 0.4))
    labels.heading[:] = (0.5, 0.0, 0.5)
    frame = fuser.update(walk(1)[0], labels)
    np.testing.assert_array_equal(frame.heading, labels.heading[0])
    assert (frame.exchanged_a, frame.exchanged_b) == (WHOLE, 0)
    assert (frame.doubt_a, frame.doubt_b) == (0.0, pytest.approx(0.4))


def test_a_view_with_doubtful_sides_pulls_the_limbs_less():
    """B's labels become wrong after a second: with certain labels its joints count, with doubt hardly.

    Both views repeat their first skeleton before, so that S* does not know better.
    """
    pairs = walk(40)
    wrong = list(pairs)
    for k, pair in enumerate(pairs[30:], 30):
        exchanged = Skeleton.of(KINECT_V2, pair.b.positions[KINECT_V2.mirror], None, pair.time_ns)
        wrong[k] = replace(pair, b=exchanged)
    off = []
    for doubt in (0.0, 1.0):
        fuser = Fuser(SETUP)
        labels = Labels.with_sides(np.zeros((40, 2)), [(0.0, doubt if k >= 30 else 0.0) for k in range(40)])
        frames = fuser.fuse_sequence(wrong, labels)
        right = Fuser(SETUP).fuse_sequence(pairs, Labels.with_sides(np.zeros((40, 2))))
        limbs = KINECT_V2.mirror != np.arange(len(KINECT_V2))
        apart = np.array([f.positions - r.positions for f, r in zip(frames, right, strict=True)])
        off.append(np.linalg.norm(apart[:, limbs], axis=2).mean())
    assert off[1] < 0.7 * off[0]


# --- Whoever stands, sits, bows or lies: left and right stay where they are, and S* with them.


TIMES = np.arange(0.0, 14.0, 1.0 / 15.0)


@cache
def scene(body):
    """Somebody who moves the arms, at 15 frames per second, and the true calibration."""
    *_, truth = simulated_pair(motion="arms", body=body, seed=3, seconds=16.0)
    standing = truth.positions_at((2e9 + 1e9 * TIMES).astype(np.int64))
    lengths = np.median(bone_lengths_of(body, standing), axis=0)
    return standing, Calibration(body, truth.a_from_b, lengths, "the truth")


def fused(body, exercise):
    """The truth, and S* with its frames' exchange codes: live, and of the recording."""
    standing, calibration = scene(body)
    truth = exercise.truth(body, standing, TIMES)
    pairs = exercise.pairs(body, truth, calibration.a_from_b, TIMES)
    settings = FuserSettings(hindsight="labels")
    labels = plan_recording(body, pairs, settings, calibration, refine=False).labels
    frames = [Fuser(FusionSetup(calibration)).fuse_sequence(pairs, given) for given in (None, labels)]
    codes = [np.array([frame.exchanged_a | frame.exchanged_b for frame in of]) for of in frames]
    return truth, [of.positions for of in frames], codes


@given(exercise=exercises())
def test_no_pose_exchanges_left_and_right(exercise):
    truth, found, codes = fused(AZURE_KINECT, exercise)
    stands = np.r_[0:25, -25:0]
    for at, exchanged in zip(found, codes, strict=True):
        assert not exchanged.any()
        error = np.linalg.norm(at - truth, axis=2).mean(axis=1)
        assert error.mean() < 1.5 * error[stands].mean() + 0.005


@pytest.mark.parametrize("pose", sorted(set(POSES) - {"cartwheel"}))
def test_a_kinect_v2_exchanges_them_at_most_while_the_pose_changes(pose):
    _, _, (live, recorded) = fused(KINECT_V2, Exercise(POSES[pose]))
    assert max(live.mean(), recorded.mean()) < 0.05


def test_the_vertical_is_that_of_a_person_who_mostly_lies():
    standing, _ = scene(AZURE_KINECT)
    times = np.where(np.arange(len(standing)) < 30, 0.0, 6.0)
    lying = Exercise(POSES["on the belly"]).truth(AZURE_KINECT, standing, times)
    assert upright_direction(AZURE_KINECT, lying) @ UP > np.cos(np.radians(8.0))
