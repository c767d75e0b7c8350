"""Feet on the floor neither slide nor sink, and bones keep their lengths; in files, and live."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.calibration.bone_lengths import bone_lengths_of
from recordings import fuse
from recordings.appearance.floor import floor_under
from recordings.export import writer_for
from recordings.planted_feet import BOBS, planted_feet
from tests.helpers.animations import bvh_joints
from tests.helpers.footfalls import walking_session
from viewer_app.outputs.avatars.live_feet import _FASTER, LiveFeet

SIDES = "Left", "Right"


@pytest.fixture(scope="module")
def true_walk(tmp_path_factory):
    """A walk whose S* is the truth."""
    return walking_session(tmp_path_factory.mktemp("walk") / "s.rrd")


def with_fused(session, fused):
    return replace(session, rows=replace(session.rows, fused=fused))


def erring(session, seed, largest=0.02):
    """S* with errors that change slowly, as those of trackers: of the whole person, in each direction."""
    random = np.random.default_rng(seed)
    hertz, phases = random.uniform(0.3, 1.0, (3, 1)), random.uniform(0.0, 2.0 * np.pi, (3, 1))
    errors = largest * np.sin(2.0 * np.pi * hertz * session.time + phases).T
    return with_fused(session, session.fused + errors[:, None])


def recorded(session):
    """S* with planted feet, in K_A's frame as S*."""
    floor = floor_under(session.rows)
    at = floor.inverse().apply(session.fused)
    return floor.apply(planted_feet(session.body, session.time, at, session.gait))


def toes_of(session, positions):
    """(T, 2, 3) metres above the floor, y down."""
    at = floor_under(session.rows).inverse().apply(positions)
    return at[:, [session.body.joint(f"Foot{side}") for side in SIDES]]


def stances(session, settled):
    """Side and frames in which toes do not move in truth, from some frames after their beginning."""
    at = toes_of(session, session.fused)
    still = np.linalg.norm(np.diff(at, axis=0, prepend=at[:1]), axis=2) < 0.002
    for side in (0, 1):
        for begin, end in np.flatnonzero(np.diff(still[:, side], prepend=False, append=False)).reshape(-1, 2):
            if end - begin > settled + 4:
                yield side, slice(begin + settled, end - 1)


def slides(session, positions, of):
    """Metres that the toes slide in each stance, and (N,) metres of their heights in all."""
    at = toes_of(session, positions)
    parts = [at[frames, side] for side, frames in of]
    across = [np.hypot(*np.ptp(part[:, [0, 2]], axis=0)) for part in parts]
    return np.array(across), -np.concatenate(parts)[:, 1]


def live(session):
    """S* with planted feet, frame by frame."""
    feet = LiveFeet(session.body)
    return np.array(
        [feet.update(*each) for each in zip(session.fused, session.time_ns.tolist(), strict=True)]
    )


@pytest.mark.parametrize("seed", range(2))
def test_toes_that_stand_neither_slide_nor_sink(true_walk, seed):
    session = erring(true_walk, seed)
    for planted, settled in ((recorded(session), 3), (live(session), 5)):
        of = list(stances(true_walk, settled))
        before, _ = slides(session, session.fused, of)
        after, heights = slides(session, planted, of)
        assert len(of) > 12
        assert np.median(before) > 0.005
        assert np.median(after) < 0.2 * np.median(before)
        assert np.quantile(after, 0.9) < 0.01
        if settled == 3:  # live, the floor itself is still found
            assert np.quantile(np.abs(heights - np.median(heights)), 0.95) < 0.005
            everywhere = -toes_of(session, planted)[..., 1]
            assert everywhere.min() > np.median(heights) - 0.001


@pytest.mark.parametrize("seed", range(2))
def test_bones_keep_their_lengths_and_what_is_no_leg_only_rises_and_sinks(true_walk, seed):
    session, body = erring(true_walk, seed), true_walk.body
    legs = [body.joint(part + side) for part in ("Knee", "Ankle", "Foot") for side in SIDES]
    others = np.setdiff1d(np.arange(len(body)), legs)
    for planted in (recorded(session), live(session)):
        lengths, own = (bone_lengths_of(body, each) for each in (planted, session.fused))
        np.testing.assert_allclose(lengths, own, atol=1e-9)
        moved = (planted - session.fused)[:, others]
        np.testing.assert_allclose(moved, np.broadcast_to(moved[:, :1], moved.shape), atol=1e-9)


def bobs(session, planted):
    """m/s, by which the hips rise or fall otherwise than those of S*, between near frames."""
    hips = [session.body.joint("Hip" + side) for side in SIDES]
    moved = np.linalg.norm((planted - session.fused)[:, hips].mean(axis=1), axis=1)
    near = np.diff(session.time) < 0.3
    return np.abs(np.diff(moved) / np.diff(session.time))[near]


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2))
def test_people_do_not_bob(true_walk, seed, largest):
    session = erring(true_walk, seed, largest)
    for planted, most in ((recorded(session), 2.0 * BOBS), (live(session), 2.0 * _FASTER * BOBS)):
        assert bobs(session, planted).max() <= most + 1e-6


@pytest.mark.parametrize("real", ["real/kinect_v2_90deg_walk", "real_more/kinect_v2_90deg_walk_2"])
def test_real_people_do_not_bob(shared, real):
    session = fuse(shared / real / "a.csv", shared / real / "b.csv")
    for planted, most in ((recorded(session), 2.0 * BOBS), (live(session), 2.0 * _FASTER * BOBS)):
        off = bobs(session, planted)
        assert np.nanmax(off) <= most + 1e-3  # S* is saved to a micrometre
        assert np.nanmax(off) > 0.25 * most  # they are moved


def test_feet_that_stand_already_stay(true_walk):
    of = list(stances(true_walk, 3))
    for planted in (recorded(true_walk), live(true_walk)):
        at, there = (toes_of(true_walk, each)[..., [0, 2]] for each in (planted, true_walk.fused))
        off = [np.linalg.norm((at - there)[frames, side], axis=1).max() for side, frames in of]
        assert np.median(off) < 0.01


@pytest.mark.parametrize("seed", range(2))
def test_a_mirrored_walk_has_the_feet_exchanged(true_walk, seed):
    session, mirror = erring(true_walk, seed), true_walk.body.mirror
    mirrored = with_fused(session, session.fused[:, mirror] * (-1.0, 1.0, 1.0))
    for plant in (recorded, live):
        np.testing.assert_allclose(plant(mirrored), plant(session)[:, mirror] * (-1.0, 1.0, 1.0), atol=1e-6)


def test_frames_without_a_person_stay_so_and_end_what_stood(true_walk):
    fused = true_walk.fused.astype(np.float64)
    fused[100:130] = np.nan
    fused[130:] += (0.3, 0.0, 0.0)
    session = with_fused(true_walk, fused)
    for planted in (recorded(session), live(session)):
        np.testing.assert_array_equal(np.isnan(planted), np.isnan(fused))
        assert np.linalg.norm((planted - fused)[130:], axis=2).max() < 0.2
    nobody = with_fused(true_walk, np.full_like(fused, np.nan))
    assert np.isnan(recorded(nobody)).all()


@pytest.mark.parametrize("lower", [-0.5, 0.6])
def test_live_feet_are_not_moved_to_a_floor_that_is_only_assumed(true_walk, lower):
    down = floor_under(true_walk.rows).rotation[:, 1]
    session = with_fused(true_walk, true_walk.fused + lower * down)
    moved = np.linalg.norm(live(session) - session.fused, axis=2)
    assert moved.max() < 0.2


def test_feet_stand_anew_when_a_clock_was_reset(true_walk):
    feet = LiveFeet(true_walk.body)
    for begins_ns in (100_000_000_000, 0):
        planted = [
            feet.update(at, begins_ns + time_ns)
            for at, time_ns in zip(true_walk.fused, true_walk.time_ns.tolist(), strict=True)
        ]
        assert np.linalg.norm(np.array(planted) - true_walk.fused, axis=2).max() < 0.2


def test_animations_have_planted_feet_unless_they_are_free(true_walk, tmp_path):
    """At another rate, too, and with the lengths of the calibration instead of those of the frames."""
    session, body = erring(true_walk, 1), true_walk.body
    lowest, slid = {}, {}
    for feet in ("planted", "free"):
        path = tmp_path / f"{feet}.bvh"
        writer_for(path, rate=60.0, feet=feet)(session, path)
        found = bvh_joints(path, body) * (1.0, -1.0, -1.0)
        lengths = bone_lengths_of(body, found)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-4)
        toes = found[:, [body.joint("Foot" + side) for side in SIDES]]
        lowest[feet] = toes[..., 1].max()
        of = [(side, slice(2 * frames.start, 2 * frames.stop - 1)) for side, frames in stances(true_walk, 3)]
        slid[feet] = np.median(
            [np.hypot(*np.ptp(toes[frames, side][:, [0, 2]], axis=0)) for side, frames in of]
        )
    assert slid["planted"] < min(0.005, 0.5 * slid["free"])
    assert lowest["planted"] < lowest["free"] - 0.01  # y is down
