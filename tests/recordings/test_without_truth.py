"""Figures without ground truth, on motions with known figures."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.body import BODIES, KINECT_V2
from fusion.errors import FusionError
from fusion.rigid import RigidTransform
from recordings.quality.without_truth import FusedPair, facing, figures_without_truth, judge_registration
from tests.helpers.two_views import A_FROM_B, standing

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
