"""Agreement of two methods: against scipy and an analysis of variance, and how often intervals cover."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_rel

from fusion.body import AZURE_KINECT, BODIES, KINECT_V1, KINECT_V2
from fusion.errors import FusionError
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings
from recordings.comparing.agreement import agreement, step_agreement
from recordings.comparing.session_comparison import Comparison
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.gait import SIDES, Gait
from recordings.gait.events import find_gait
from recordings.quality.without_truth import FusedPair, facing, figures_without_truth, judge_registration
from recordings.session import Session
from tests.helpers.footfalls import walker
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import A_FROM_B, calibration_of, standing

SEEDS = st.integers(0, 2**32 - 1)
COUNTS = st.integers(6, 40)


def samples(seed, n, bias=1.0, noise=2.0, spread=8.0):
    random = np.random.default_rng(seed)
    true = spread * random.normal(size=n)
    return true + bias + noise * random.normal(size=n), true


def icc_by_variances(found, true):
    """ICC(A,1) by the mean squares of rows, columns and the rest (McGraw and Wong 1996)."""
    values = np.stack([found, true], axis=1)
    n, k = values.shape
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    of_rows, of_columns = k * rows.var(ddof=1), n * columns.var(ddof=1)
    rest = values - rows[:, None] - columns + values.mean()
    error = np.sum(rest**2) / ((n - 1) * (k - 1))
    return (of_rows - error) / (of_rows + (k - 1) * error + k / n * (of_columns - error))


@given(seed=SEEDS, n=COUNTS)
def test_figures_are_those_of_the_sources(seed, n):
    found, true = samples(seed, n)
    of = agreement(found, true)
    off = found - true
    assert (of.n, of.bias) == (n, pytest.approx(off.mean()))
    assert of.limits == pytest.approx([off.mean() + side * 1.96 * off.std(ddof=1) for side in (-1, 1)])
    assert of.rmse == pytest.approx(math.sqrt(np.mean(off**2)))
    assert of.icc == pytest.approx(icc_by_variances(found, true))
    paired = ttest_rel(found, true).confidence_interval(0.95)
    assert of.bias_interval == pytest.approx((paired.low, paired.high))


@given(seed=SEEDS, n=COUNTS, factor=st.floats(0.1, 100.0), offset=st.floats(-100.0, 100.0))
def test_units_and_origin_do_not_matter(seed, n, factor, offset):
    found, true = samples(seed, n)
    one, other = agreement(found, true), agreement(factor * found + offset, factor * true + offset)
    for name in ("bias", "bias_interval", "limits", "rmse", "rmse_interval"):
        np.testing.assert_allclose(getattr(other, name), factor * np.array(getattr(one, name)), rtol=1e-6)
    np.testing.assert_allclose(other.icc_interval, one.icc_interval, rtol=1e-6)


@given(seed=SEEDS, n=COUNTS, repeats=st.integers(2, 5))
def test_values_of_a_block_count_once(seed, n, repeats):
    """Frames that repeat each other tell no more; as values of their own they seem to."""
    found, true = samples(seed, n)
    blocks = np.repeat(np.arange(n), repeats)
    one, many = agreement(found, true), agreement(found[blocks], true[blocks], blocks)
    np.testing.assert_allclose(many.bias_interval, one.bias_interval, rtol=1e-9)
    np.testing.assert_allclose(many.rmse_interval, one.rmse_interval, rtol=1e-9)
    alone = agreement(found[blocks], true[blocks])
    assert np.ptp(alone.rmse_interval) < np.ptp(many.rmse_interval)


def test_intervals_cover_the_true_figures():
    """Of 20 values; the jackknife covers a few per cent less than 95. One deviation of a share is 1.2 %."""
    bias, noise, spread = 1.0, 2.0, 8.0
    of_rows = 2.0 * (spread**2 + 0.25 * noise**2)
    error = 0.5 * noise**2
    true = {
        "bias_interval": bias,
        "rmse_interval": math.hypot(bias, noise),
        "icc_interval": (of_rows - error) / (of_rows + error + bias**2),
    }
    hits = dict.fromkeys(true, 0)
    for seed in range(400):
        of = agreement(*samples(seed, 20, bias, noise, spread))
        for name, value in true.items():
            low, high = getattr(of, name)
            hits[name] += low <= value <= high
    assert all(0.89 * 400 < count < 0.985 * 400 for count in hits.values()), hits


def test_few_values_have_no_interval():
    of = agreement(*samples(0, 4))
    assert np.isnan([of.bias_interval, of.rmse_interval, of.icc_interval, *of.limits_intervals]).all()
    assert np.isfinite([of.bias, of.rmse, of.icc, *of.limits]).all()


@pytest.fixture(scope="module")
def gait():
    times, positions = walker(12.0, 30.0)
    found = find_gait(AZURE_KINECT, times, positions, (0.0, -1.0, 0.0))
    assert len(found.steps) > 8
    return found


def test_steps_that_are_off_by_a_constant_have_it_as_bias(gait):
    off = Gait(
        tuple(
            step._replace(strike=step.strike + 0.03, toe_off=step.toe_off - 0.02, length=step.length + 0.05)
            for step in gait.steps
        )
    )
    found = step_agreement(off, gait)
    assert (found.missed, found.extra) == (0, 0)
    bias = {name: of.bias for name, (_, of) in found.of_each.items()}
    assert bias["heel strike"] == pytest.approx(0.03)
    assert bias["toe-off"] == pytest.approx(-0.02)
    assert bias["step length"] == pytest.approx(0.05)
    for name in ("step time", "step width", "speed", "cadence"):
        assert bias[name] == pytest.approx(0.0, abs=1e-12)
    cycles = [b.strike - a.strike for s in SIDES for a, b in pairwise(gait.of_side(s)) if a.walk == b.walk]
    assert bias["stance"] == pytest.approx(-5.0 * np.mean(1.0 / np.array(cycles)))
    assert math.isnan(found.of_each["heel strike"][1].icc)  # it grows with time, whatever a method finds
    assert {unit for unit, _ in found.of_each.values()} == {"s", "m", "%", "1/min", "m/s"}


def test_steps_of_one_of_both_are_counted(gait):
    fewer = replace(gait, steps=(*gait.steps[:4], *gait.steps[5:]))
    assert (step_agreement(fewer, gait).missed, step_agreement(fewer, gait).extra) == (1, 0)
    assert (step_agreement(gait, fewer).missed, step_agreement(gait, fewer).extra) == (0, 1)


def test_other_steps_do_not_agree(gait):
    apart = Gait(tuple(step._replace(strike=step.strike + 100.0) for step in gait.steps))
    assert step_agreement(apart, gait) is None
    assert step_agreement(Gait(()), gait) is step_agreement(gait, Gait(())) is None


# --- ``duplex compare`` on fusions with known differences.


@pytest.fixture
def session(fused_run):
    return fused_run(frame_pairs(KINECT_V1, 40), calibration_of(KINECT_V1))


def with_fused(session, fused):
    return replace(session, rows=replace(session.rows, fused=fused))


def test_a_limb_exchanged_with_its_mirror_image_is_swapped(session):
    left, right = KINECT_V1.joint("WristLeft"), KINECT_V1.joint("WristRight")
    fused = session.rows.fused.copy()
    fused[7:10, [left, right]] = fused[7:10, [right, left]]
    comparison = Comparison.of(session, with_fused(session, fused))
    expected = np.zeros(comparison.swapped.shape, dtype=bool)
    expected[7:10, [left, right]] = True
    np.testing.assert_array_equal(comparison.swapped, expected)


def test_differences_and_bone_deviations_are_those_put_in(session):
    hand = KINECT_V1.joint("HandLeft")
    fused = session.rows.fused.copy()
    along = fused[12, hand] - fused[12, KINECT_V1.parents[hand]]
    fused[12, hand] += 0.03 * along / np.linalg.norm(along)
    comparison = Comparison.of(session, with_fused(session, fused))
    apart = np.zeros(comparison.apart.shape)
    apart[12, hand] = 0.03
    np.testing.assert_allclose(comparison.apart, apart, atol=1e-12)
    # both ends of a bone are kept in float32: within 2⁻²³ m each, on each axis, at 4 m
    rounding = 2 * np.sqrt(3) * 2.0**-23
    assert np.nanmax(comparison.bone_deviation[0]) < rounding
    expected = np.zeros(len(KINECT_V1))
    expected[hand] = 0.03
    of_bones = KINECT_V1.bone_joints
    np.testing.assert_allclose(comparison.bone_deviation[1][of_bones], expected[of_bones], atol=rounding)
    assert comparison.worst(5) == [(12, hand)]
    assert comparison.worst(0) == []


def test_only_fusions_of_the_same_skeletons_are_compared(fused_run, tmp_path):
    calibration = calibration_of(KINECT_V1)
    one = fused_run(frame_pairs(KINECT_V1, 40), calibration)
    chance = fused_run(frame_pairs(KINECT_V1, 40, noise=0.03), calibration)  # the same times
    with pytest.raises(RecordingError, match="40 frames of the same time, but S_A or S_B of frame 0"):
        Comparison.of(one, chance)
    for name in ("clock_b", "positions_a", "positions_b", "states_a", "states_b"):
        other = getattr(one.rows, name).copy()
        other[23] += 1
        for pair in ((one, changed := replace(one, rows=replace(one.rows, **{name: other}))), (changed, one)):
            with pytest.raises(RecordingError, match="frame 23 differs from frame 23: not the same capture"):
                Comparison.of(*pair)
    again = fused_run(frame_pairs(KINECT_V1, 40), calibration, FuserSettings("paper", h=0.9))
    write_session(again.part(range(10, 30)), tmp_path / "part.rrd")
    part = Comparison.of(one, Session.open(tmp_path / "part.rrd"))
    assert part.first.frame.tolist() == list(range(10, 30))
    assert part.second.frame.tolist() == list(range(20))


# --- Figures without ground truth, on motions with known figures.


FRAME_NS = 33_333_333
FRAMES = 200
BODY = KINECT_V2


def walking(metres_per_second, *, backwards=False):
    """(T, J, 3) a stiff person who is carried in the direction faced, or against it."""
    still = standing(BODY)
    left = (still[BODY.joint("HipLeft")] - still[BODY.joint("HipRight")])[[0, 2]]
    left /= np.linalg.norm(left)
    way = np.array([left[1], 0.0, -left[0]]) * (-1.0 if backwards else 1.0)
    travelled = metres_per_second * FRAME_NS * 1e-9 * np.arange(FRAMES)
    return still + travelled[:, None, None] * way


def pair(a, fused=None, b_in_a=None):
    b = A_FROM_B.inverse().apply(a if b_in_a is None else b_in_a)
    times = np.arange(len(a), dtype=np.int64) * FRAME_NS
    return FusedPair(BODY, times, a, b, a if fused is None else fused, (A_FROM_B,) * len(a))


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_a_person_faces_the_sensor_in_a_rest_pose(body):
    at = np.zeros((1, len(body), 3))
    for joint in body.order[1:]:
        at[0, joint] = at[0, body.parents[joint]] + body.nominal_lengths[joint] * body.rest[joint]
    np.testing.assert_allclose(facing(body, at), [[0.0, -1.0]], atol=1e-12)


@pytest.mark.parametrize(("backwards", "against"), [(False, 0.0), (True, 1.0)])
def test_walking_backwards_fast_is_against_the_motion(backwards, against):
    found = figures_without_truth(pair(walking(1.2, backwards=backwards)))
    assert (found.against_a, found.against_b, found.against_fused) == (against,) * 3
    assert found.flips_per_minute == 0.0
    assert found.apart < 1e-9
    assert found.rotation_off < 1e-6


@pytest.mark.parametrize(("in_b", "together"), [(False, 0.25), (True, 0.0)])
def test_hands_in_one_place_that_a_view_has_apart_are_counted(in_b, together):
    walk = walking(1.2)
    joined, wrists = walk.copy(), [BODY.joint("WristLeft"), BODY.joint("WristRight")]
    joined[: FRAMES // 4, wrists] = joined[: FRAMES // 4, wrists].mean(axis=1, keepdims=True)
    found = figures_without_truth(pair(joined if in_b else walk, joined))  # then no view has them apart
    assert found.hands_together == together


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rate", [5, 10, 15, 60, 90])
def test_figures_are_of_seconds_and_not_of_frames(rate):
    """The walk of 30 frames per second is seen at another rate; its last three pairs have one time."""

    def seen(a, fused):
        recording = pair(a, fused)
        times = (np.arange(len(a)) * 1e9 / rate).astype(np.int64)
        times[-2:] = times[-3]
        return figures_without_truth(replace(recording, time_ns=times))

    count = 8 * rate
    still, way = standing(BODY), 25.0 * (walking(1.2)[1] - walking(1.2)[0])
    seconds = (np.arange(count) / rate)[:, None, None]
    walk = still + 1.2 * seconds * way
    turned = walk.copy()
    turned[3 * rate : 4 * rate] = turned[3 * rate : 4 * rate][:, BODY.mirror]
    found = seen(walk, turned)
    assert found.jumps_a == found.against_a == 0.0
    # of eight seconds without 0.4 s at each end; at five frames per second a frame is 3 %
    assert found.against_fused == pytest.approx(1.0 / 7.2, abs=0.03)
    assert found.flips_per_minute == pytest.approx(2 * 60.0 / ((count - 3) / rate), rel=0.01)
    stays = np.repeat(still[None], count, axis=0)
    assert seen(stays, still + 4.0 * seconds * way).jumps_own == 0.0
    assert seen(stays, still + 5.0 * seconds * way).jumps_own == pytest.approx(1.0, abs=0.06)


def test_slow_walking_backwards_is_not_judged():
    assert np.isnan(figures_without_truth(pair(walking(0.5, backwards=True))).against_fused)


def test_roughness_is_the_mean_second_difference():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    shaken = still.copy()
    shaken[::2, :, 0] += 0.01  # second differences of 20 mm, always
    found = figures_without_truth(pair(still, fused=shaken))
    assert found.rough_fused == pytest.approx(0.02)
    assert found.rough_a == found.rough_b == pytest.approx(0.0, abs=1e-12)
    found = figures_without_truth(pair(still, shaken, b_in_a=shaken))
    assert found.rough_mean == pytest.approx(0.01, rel=0.01)
    assert found.roughness_ratio == pytest.approx(2.0, rel=0.01)


def test_only_a_jump_that_neither_view_made_counts_for_the_fused_skeleton():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    hand, foot = BODY.joint("HandLeft"), BODY.joint("FootRight")
    fused, a = still.copy(), still.copy()
    fused[50:60, hand] += [0.2, 0.0, 0.0]  # two steps of S* alone
    fused[100:, foot] += [0.0, 0.2, 0.0]  # one step that view A makes, too
    a[100:, foot] += [0.0, 0.2, 0.0]
    found = figures_without_truth(pair(a, fused, b_in_a=still))
    steps = (FRAMES - 1) * len(BODY)
    assert found.jumps_fused == pytest.approx(3 / steps)
    assert found.jumps_own == pytest.approx(2 / steps)
    assert found.jumps_a == pytest.approx(1 / steps)
    assert found.jumps_b == 0.0


def test_a_mirrored_spell_is_two_flips():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    fused = still.copy()
    fused[80:120] = fused[80:120][:, BODY.mirror]
    minutes = (FRAMES - 1) * FRAME_NS * 1e-9 / 60.0
    assert figures_without_truth(pair(still, fused)).flips_per_minute == pytest.approx(2 / minutes)


def test_an_unseen_joint_gives_no_figure():
    a = walking(1.2)
    a[20:40] = np.nan
    a[:, BODY.joint("ThumbLeft")] = np.nan
    found = figures_without_truth(pair(a, fused=walking(1.2)))
    assert found.rough_fused < 1e-9
    assert found.jumps_own == 0.0


def test_too_short_a_recording_is_an_error():
    with pytest.raises(FusionError, match="30 pairs or more to be judged; got 29"):
        figures_without_truth(pair(walking(1.0)[:29]))


def test_a_registration_is_judged_where_the_person_is():
    a = walking(1.2)
    b = A_FROM_B.inverse().apply(a)
    turned = RigidTransform.of(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))
    off = judge_registration(RigidTransform.of(np.eye(3), [0.03, 0.0, 0.04]) @ A_FROM_B, a, b)
    assert off.rotation_off < 1e-6
    assert off.position_off == pytest.approx(0.05)
    assert off.apart == pytest.approx(0.05)
    assert judge_registration(turned @ A_FROM_B, a, b).rotation_off == pytest.approx(np.pi / 2)
