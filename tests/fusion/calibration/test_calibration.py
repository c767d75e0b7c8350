import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from fusion.body import AZURE_KINECT, BODIES, KINECT_V1
from fusion.calibration.bone_lengths import measure_bone_lengths
from fusion.calibration.calibration import calibrate
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.start_up_pose import (
    StartUpPose,
    _tremble,
    _window_tremble,
    find_start_up_pose,
    limbs_apart,
)
from fusion.errors import CalibrationError
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, pair_of, standing


def pairs_of(truth, body=KINECT_V1):
    return [pair_of(body, at, t * FRAME_NS) for t, at in enumerate(truth)]


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_the_start_up_pose_is_recognised_where_it_is_held(body):
    pairs = pairs_of(moving(body, 120), body)
    held, how = find_start_up_pose(body, pairs)
    assert held[0].time_ns == pairs[0].time_ns
    # still for 1.5 s, then the first 40 mm (RMS) of movement still count as still
    assert 1.4e9 < held[-1].time_ns < 2.2e9
    assert how.startswith("start-up pose at 0.0 s")


@COSTLY
@given(
    rate=st.sampled_from([5, 10, 15, 30, 60]),
    lost=st.sampled_from([0.0, 0.05, 0.2]),
    every=st.sampled_from([1, 2]),
    shift_ns=st.sampled_from([0, -(10**15), 2**61]),
    swap=st.booleans(),
    held=st.floats(0.5, 4.0),
    seed=st.integers(0, 999),
)
@example(rate=30, lost=0.05, every=1, shift_ns=0, swap=False, held=3.0, seed=0)
@example(rate=30, lost=0.0, every=2, shift_ns=0, swap=True, held=3.0, seed=0)
@example(rate=30, lost=0.0, every=1, shift_ns=0, swap=False, held=0.5, seed=0)
def test_a_recording_and_a_live_session_take_the_same_start_up_pose(
    rate, lost, every, shift_ns, swap, held, seed
):
    """Also where frames of a view are lost, at half the rate, exchanged, or at other times.

    The person stands, holds the pose, and stands again, with and without it moving on.
    """
    rng, apart = np.random.default_rng(seed), standing(KINECT_V1)
    pairs: list[SkeletonPair] = []
    for t in range(round(6.5 * rate)):
        posing = 1.0 <= t / rate < 1.0 + held
        at = (apart if posing else standing(KINECT_V1, arms_out=5.0)) + rng.normal(0.0, 0.003, (20, 3))
        pair = pair_of(KINECT_V1, at, shift_ns + round(t * 1e9 / rate))
        a, b = (pair.b, pair.a) if swap else (pair.a, pair.b)
        gone = rng.random(2) < lost
        a, b = None if gone[0] else a, None if gone[1] or t % every else b
        pairs.append(SkeletonPair(a, b, pair.time_ns))
    both = [pair for pair in pairs if pair.a is not None and pair.b is not None]
    start_ns, end_ns = (shift_ns + round(second * 1e9) for second in (1.0, 1.0 + held))
    posed = [pair for pair in both if start_ns <= pair.time_ns < end_ns]
    assume(np.diff([pair.time_ns for pair in posed]).max(initial=0) <= 10**9)
    found, how = find_start_up_pose(KINECT_V1, pairs)
    calibrator = Calibrator(KINECT_V1, frontal=False)
    told = [calibration for pair in pairs if (calibration := calibrator.watch(pair)) is not None]
    live = next((calibration for calibration in told if not calibration.provisional), None)
    if len(posed) < 15 or posed[-1].time_ns - posed[0].time_ns < 10**9:
        assert how.startswith("no start-up pose found")
        assert live is None or not live.how.startswith("start-up pose, ")
        return
    assert (
        how == f"start-up pose at {(found[0].time_ns - pairs[0].time_ns) * 1e-9:.1f} s, {len(found)} frames"
    )
    assert [pair.time_ns for pair in found] == [pair.time_ns for pair in posed[: len(found)]]
    lasts = posed[len(found) - 1].time_ns - posed[0].time_ns
    assert len(found) == len(posed) or (lasts >= 3 * 10**9 and len(found) >= 15)
    assert live is not None
    assert live.how == f"start-up pose, {len(found)} frames"
    a_from_b = A_FROM_B.inverse() if swap else A_FROM_B
    assert np.degrees(live.a_from_b.angle_to(a_from_b)) < 0.5


def test_a_second_without_both_views_ends_the_pose():
    pairs = pairs_of(np.array([standing(KINECT_V1)] * 60))
    late = [pair_of(KINECT_V1, standing(KINECT_V1), pair.time_ns + 3 * 10**9) for pair in pairs]
    alone = SkeletonPair(pairs[0].a, None, 61 * FRAME_NS)
    for tail in ([*late], [alone, *late]):
        found, _ = find_start_up_pose(KINECT_V1, [*pairs[:14], *tail])
        assert found[0].time_ns == late[0].time_ns, "fourteen pairs are too few"
        watcher = StartUpPose(KINECT_V1)
        held = [pose for pair in [*pairs, *tail] if (pose := watcher.watch(pair)) is not None]
        assert [pair.time_ns for pair in held[0]] == [pair.time_ns for pair in pairs]


def test_a_pose_held_for_less_than_a_second_is_not_taken():
    watcher = StartUpPose(KINECT_V1)
    rng = np.random.default_rng(0)
    for t in range(60):
        jump = rng.normal(0, 0.3, 3) if t % 25 == 0 else np.zeros(3)  # moves every 0.83 s
        if t % 25 == 0:
            at = standing(KINECT_V1) + jump
        assert watcher.watch(pair_of(KINECT_V1, at, t * FRAME_NS)) is None
    assert watcher.end() is None


def test_arms_hanging_down_are_no_start_up_pose():
    assert limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1)))
    assert not limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1, arms_out=5.0)))
    assert not limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1, legs_out=-4.0)))  # feet together
    pairs = pairs_of(np.array([standing(KINECT_V1, arms_out=5.0)] * 60))
    _, how = find_start_up_pose(KINECT_V1, pairs)
    assert how.startswith("no start-up pose found; calmest window")


def test_an_inferred_main_joint_breaks_the_pose():
    watcher = StartUpPose(KINECT_V1)
    states = np.full(20, 2)
    states[KINECT_V1.joint("KneeLeft")] = TrackingState.INFERRED
    for t in range(60):
        pair = pair_of(KINECT_V1, standing(KINECT_V1), t * FRAME_NS)
        hidden = Skeleton.of(KINECT_V1, standing(KINECT_V1), states)
        assert watcher.watch(SkeletonPair(hidden, pair.b, pair.time_ns)) is None


def test_without_a_start_up_pose_the_calmest_window_serves():
    rng = np.random.default_rng(1)
    truth = np.array([standing(KINECT_V1, arms_out=5.0)] * 150)
    truth[:60] += rng.normal(0, 0.05, (60, 20, 3))
    truth[125:] += rng.normal(0, 0.05, (25, 20, 3))
    held, how = find_start_up_pose(KINECT_V1, pairs_of(truth))
    assert held[0].time_ns >= 59 * FRAME_NS
    assert held[-1].time_ns <= 125 * FRAME_NS
    assert "no start-up pose" in how


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_bone_lengths_of_flawless_views_are_the_persons(body):
    calibration = calibrate(body, pairs_of(moving(body, 40), body), "test")
    np.testing.assert_allclose(calibration.bone_lengths, body.nominal_lengths, atol=2e-6)  # float32 at 4 m


def test_bone_lengths_average_both_views_before_measuring():
    # eq. (13): the length of the mean skeleton, not the mean of the lengths
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    elbow = KINECT_V1.joint("ElbowLeft")
    shifted = np.array(pair.a.positions)
    shift = np.array([0.0, 0.0, 0.2])
    shifted[elbow] += shift
    lengths = measure_bone_lengths(
        KINECT_V1, [SkeletonPair(Skeleton.of(KINECT_V1, shifted), pair.b, 0)], A_FROM_B
    )
    upper_arm = standing(KINECT_V1)[elbow] - standing(KINECT_V1)[KINECT_V1.parents[elbow]]
    assert lengths[elbow] == pytest.approx(np.linalg.norm(upper_arm + 0.5 * shift), abs=1e-6)


def test_an_unseen_bone_takes_its_mirror_image_or_an_adults_proportions():
    body = AZURE_KINECT
    scale = 0.9
    states = np.full(len(body), 2)
    states[[body.joint("FOOT_LEFT"), body.joint("HAND_LEFT"), body.joint("HAND_RIGHT")]] = 0
    truth = standing(body, scale * body.nominal_lengths)
    truth[body.joint("FOOT_RIGHT")] += [0.0, 0.05, 0.0]
    pairs = [
        SkeletonPair(
            Skeleton.of(body, truth, states), Skeleton.of(body, A_FROM_B.inverse().apply(truth), states), 0
        )
    ]
    lengths = measure_bone_lengths(body, pairs, A_FROM_B)
    assert lengths[body.bone("foot_left")] == lengths[body.bone("foot_right")]
    assert lengths[body.bone("hand_left")] == pytest.approx(
        scale * body.nominal_lengths[body.bone("hand_left")], rel=1e-4
    )


def test_no_person_in_both_views_is_reported():
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    with pytest.raises(CalibrationError, match="No frame shows a person to both sensors"):
        find_start_up_pose(KINECT_V1, [SkeletonPair(pair.a, None, 0)])


def test_windows_searched_at_once_are_as_calm_as_each_looked_at_singly():
    rng = np.random.default_rng(4)
    at = (rng.normal(0, 0.02, (80, 13, 3)) + rng.normal(size=(1, 13, 3)) + [0.0, 0.0, 3.0]).astype(np.float32)
    at[rng.random((80, 13)) < 0.1] = np.nan
    starts = np.arange(60)
    ends = starts + rng.integers(1, 20, 60)
    singly = [_tremble(at[first:end]) for first, end in zip(starts, ends, strict=True)]
    # sums of 80 squares of up to 3 m carry 80 · 9 · 2e-16 m² of rounding; its root is 4e-7 m
    np.testing.assert_allclose(_window_tremble(at, starts, ends), singly, atol=1e-6)
