"""Feet of animations: those that stand stay in their places, and the knees pay hardly anything for it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import BODIES
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.movement.angles import ANGLES, joint_angles
from recordings import fuse
from recordings.export import writer_for
from recordings.export.even_frames import even_moments
from recordings.planted_feet import FASTEST, MOST_MOVED, planted_feet
from tests.helpers.animations import bvh_joints
from tests.helpers.footfalls import walking_session
from tests.helpers.poses import posed

SIDES = "Left", "Right"
KNEES = [ANGLES.index(f"knee_flexion_{side}") for side in ("left", "right")]


@pytest.fixture(scope="module")
def true_walk(tmp_path_factory):
    """A walk whose S* is the truth."""
    return walking_session(tmp_path_factory.mktemp("walk") / "s.rrd")


def erring(session, seed, largest=0.02, nobody=()):
    """S* with errors that change slowly, as those of trackers: of the whole person, in each direction."""
    random = np.random.default_rng(seed)
    hertz, phases = random.uniform(0.3, 1.0, (3, 1)), random.uniform(0.0, 2.0 * np.pi, (3, 1))
    errors = largest * np.sin(2.0 * np.pi * hertz * session.time + phases).T
    fused = session.fused + errors[:, None]
    fused[list(nobody)] = np.nan
    return replace(session, rows=replace(session.rows, fused=fused))


def planted_in(session, sigma=0.0):
    fused = session.fused.astype(np.float64)
    return planted_feet(session.body, session.time_ns, fused, np.full(fused.shape[:2], sigma))


def check_cost(body, planted, fused):
    """What planting costs at each joint: nothing above the knees, and a bounded turn of the leg."""
    legs = [[body.joint(part + side) for side in SIDES] for part in ("Knee", "Ankle", "Foot")]
    heels = [heel for side in SIDES if (heel := body.find(f"Heel{side}")) is not None]
    others = np.setdiff1d(np.arange(len(body)), [*np.ravel(legs), *heels])
    np.testing.assert_array_equal(planted[:, others], fused[:, others])
    moved = np.linalg.norm(planted - fused, axis=2)
    assert np.nanmax(moved[:, legs[0]]) <= MOST_MOVED + 1e-9
    assert np.nanmax(moved[:, legs[1]]) <= 3.0 * MOST_MOVED  # a shin as long as a thigh: twice
    bends = [joint_angles(body, each)[:, KNEES] for each in (planted, fused)]
    np.testing.assert_allclose(*bends, atol=1e-4)
    np.testing.assert_allclose(*(bone_lengths_of(body, each) for each in (planted, fused)), atol=1e-6)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.3), st.floats(0.0, 0.1), st.integers(0, 290))
def test_knees_bend_as_in_s_and_move_by_25_mm_at_most(true_walk, seed, largest, sigma, gap):
    session = erring(true_walk, seed, largest, nobody=range(gap, gap + 5))
    check_cost(session.body, planted_in(session, sigma), session.fused)


@pytest.mark.parametrize("real", ["real/kinect_v2_90deg_walk", "real_more/kinect_v2_90deg_walk_2"])
def test_knees_of_real_people_bend_as_in_s(shared, real):
    session = fuse(shared / real / "a.csv", shared / real / "b.csv")
    check_cost(session.body, planted := planted_in(session), session.fused)
    assert np.nanmax(np.linalg.norm(planted - session.fused, axis=2)) > 0.01  # they are moved


@given(
    st.sampled_from(list(BODIES.values())),
    st.floats(1.4 * FASTEST, 3.0),
    st.floats(0.0, 6.28),
    st.integers(10, 60),
)
def test_a_foot_that_is_faster_than_a_standing_one_is_not_held(body, speed, heading, stood):
    """Half a second after it began to move it is where S* has it."""
    times = np.arange(120) / 30.0
    way = np.maximum(np.arange(120) - stood, 0)[:, None] / 30.0 * speed
    fused = posed(body, {}) + (way * [np.sin(heading), 0.0, np.cos(heading)])[:, None]
    planted = planted_feet(body, np.rint(1e9 * times).astype(int), fused, np.zeros(fused.shape[:2]))
    np.testing.assert_allclose(planted[stood + 15 :], fused[stood + 15 :], atol=1e-3)
    np.testing.assert_allclose(planted[:stood], fused[:stood], atol=1e-12)


def test_a_foot_that_may_move_by_its_uncertainty_is_as_in_s(true_walk):
    session = erring(true_walk, 0)
    np.testing.assert_allclose(planted_in(session, 0.2), session.fused, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_toes_that_stand_slide_by_less_than_half(true_walk, seed):
    session = erring(true_walk, seed)
    toes = [session.body.joint(f"Foot{side}") for side in SIDES]
    still, before, after = (
        np.linalg.norm(np.diff(at[:, toes], axis=0), axis=2)
        for at in (true_walk.fused, session.fused, planted_in(session))
    )
    stands = still < 0.0005
    assert stands.mean() > 0.2
    assert np.median(after[stands]) < 0.5 * np.median(before[stands])


@pytest.mark.parametrize("seed", range(2))
def test_a_mirrored_walk_has_the_feet_exchanged(true_walk, seed):
    session, mirror = erring(true_walk, seed), true_walk.body.mirror
    rows = replace(session.rows, fused=session.fused[:, mirror] * (-1.0, 1.0, 1.0))
    mirrored = planted_in(replace(session, rows=rows))
    np.testing.assert_allclose(mirrored, planted_in(session)[:, mirror] * (-1.0, 1.0, 1.0), atol=1e-6)


def test_a_gap_and_a_clock_that_was_reset_end_what_stood(true_walk):
    fused, times = true_walk.fused.astype(np.float64), true_walk.time_ns.copy()
    fused[100:103] = np.nan
    fused[103:] += (0.3, 0.0, 0.0)
    times[200:] -= times[200]
    fused[200:] -= (0.3, 0.0, 0.0)
    planted = planted_feet(true_walk.body, times, fused, np.zeros(fused.shape[:2]))
    begins = [*range(100, 104), 200]
    np.testing.assert_allclose(planted[begins], fused[begins], atol=1e-12)


def test_animations_have_the_feet_of_live_outputs_unless_they_are_free(true_walk, tmp_path):
    """With bones of the lengths of the calibration, and at the rate of the recording."""
    session, body, found = erring(true_walk, 1), true_walk.body, {}
    for feet in ("planted", "free"):
        path = tmp_path / f"{feet}.bvh"
        writer_for(path, feet=feet)(session, path)
        found[feet] = bvh_joints(path, body)
    times_ns = even_moments(session.rows).time_ns
    expected = planted_feet(body, times_ns, found["free"], session.sigma_at(1e-9 * times_ns))
    np.testing.assert_allclose(found["planted"], expected, atol=1e-3)
    assert np.abs(found["planted"] - found["free"]).max() > 0.01
