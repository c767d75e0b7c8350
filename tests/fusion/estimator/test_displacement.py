"""A view whose whole skeleton jumps to another place: S* stays, and the view still shows the movement."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from fusion.estimator.constants import Constants
from fusion.facing.labels import Labels
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, noisy, pair_of, standing

BODY = KINECT_V2
FIRST, FRAMES = 60, 30
EVERY = slice(FIRST, FIRST + FRAMES)
CLEAN = pairs_at(np.arange(150) * FRAME_NS, moving(BODY, 150), sd=0.004, seed=5)


def new_fuser(a_from_b=A_FROM_B):
    """Without headings: this person has no front."""
    calibration = replace(calibration_of(BODY), a_from_b=a_from_b)
    return Fuser(FusionSetup(calibration), Constants.of(BODY)._replace(heading=False))


def fused(pairs, a_from_b=A_FROM_B):
    """(T, J, 3) S*, without correction of sides."""
    frames = new_fuser(a_from_b).fuse_sequence(pairs, Labels.with_sides(np.zeros((len(pairs), 2))))
    return np.array([frame.positions for frame in frames])


def displaced(by, frames=EVERY, views="a", of=CLEAN):
    """The pairs with views displaced by (3,) metres in K_A's frame."""
    pairs = list(of)
    for k in range(len(pairs))[frames]:
        for view in views:
            old = getattr(pairs[k], view)
            move = by if view == "a" else A_FROM_B.rotation.T @ by
            moved = Skeleton.of(BODY, old.positions + move, old.states, old.time_ns)
            pairs[k] = replace(pairs[k], **{view: moved})
    return pairs


@pytest.fixture(scope="module")
def clean():
    return fused(CLEAN)


@st.composite
def vectors(draw, shortest=0.2, longest=0.8):
    """(3,) metres."""
    azimuth, height = draw(st.floats(0.0, 2.0 * np.pi)), draw(st.floats(-1.0, 1.0))
    flat = np.sqrt(1.0 - height * height)
    unit = np.array((flat * np.cos(azimuth), height, flat * np.sin(azimuth)))
    return draw(st.floats(shortest, longest)) * unit


@given(vectors(), st.sampled_from("ab"))
def test_a_second_of_displacement_hardly_moves_the_skeleton_and_leaves_nothing(clean, by, view):
    off = np.linalg.norm(fused(displaced(by, views=view)) - clean, axis=2)
    assert off[EVERY].mean() < 0.12 * np.linalg.norm(by)
    assert off[FIRST + FRAMES + 30 :].mean() < 0.01


@given(vectors())
def test_a_displaced_view_still_shows_the_movement(by):
    """With the other view gone too, S* follows the displaced one."""
    only = [replace(p, b=None) if k > FIRST + 5 else p for k, p in enumerate(displaced(by))]
    alone = [replace(p, b=None) if k > FIRST + 5 else p for k, p in enumerate(CLEAN)]
    off = np.linalg.norm(fused(only) - fused(alone), axis=2)
    assert off[EVERY].mean() < 0.3 * np.linalg.norm(by)


@given(vectors(), st.integers(0, 30), st.sampled_from(("ab", "ba")))
def test_a_person_who_jumps_is_followed_however_late_the_second_view_is(clean, by, late, order):
    first, second = order
    pairs = displaced(by, slice(FIRST, None), first)
    pairs = displaced(by, slice(FIRST + late, None), second, pairs)
    off = np.linalg.norm(fused(pairs) - clean - by, axis=2)[FIRST + late + 1 :]
    assert off.mean(axis=1)[10:].max() < 0.03


@given(vectors(), st.sampled_from("ab"), st.integers(1, 80))
def test_a_view_that_returns_is_right_again_after_any_time(clean, by, view, frames):
    off = np.linalg.norm(fused(displaced(by, slice(FIRST, FIRST + frames), view)) - clean, axis=2)
    assert off[FIRST + frames + 5 :].mean(axis=1).max(initial=0.0) < 0.15 * np.linalg.norm(by)
    if frames <= FRAMES:
        assert off[FIRST + frames + 5 :].mean(axis=1).max() < 0.03


@given(vectors(), st.sampled_from("ab"))
def test_a_jump_towards_the_other_view_is_a_correction(clean, by, view):
    """A view that was wrong from the start and is right later moves S* to where both see the person."""
    off = np.linalg.norm(fused(displaced(by, slice(0, FIRST), view)) - clean, axis=2)
    assert off[FIRST + 45 :].mean() < 0.02


@given(vectors(), st.sampled_from("ab"))
def test_the_same_calibration_again_changes_nothing(by, view):
    fuser, other = new_fuser(), new_fuser()
    for k, pair in enumerate(displaced(by, slice(FIRST, None), view)[: FIRST + 40]):
        if k == FIRST + 15:
            other.recalibrate(FusionSetup(calibration_of(BODY)))
        one, two = (each.update(pair, Labels.with_sides([(0, 0)])).positions for each in (fuser, other))
        assert np.linalg.norm(one - two, axis=1).mean() < 0.02


@given(vectors())
def test_the_sensors_are_alike(by):
    """B displaced is A displaced, with the sensors' names exchanged."""
    pairs = displaced(by, views="b")
    exchanged = [SkeletonPair(pair.b, pair.a, pair.time_ns) for pair in pairs]
    other = A_FROM_B.apply(fused(exchanged, A_FROM_B.inverse()))
    np.testing.assert_allclose(other, fused(pairs), atol=1e-5)  # skeletons are float32


@given(st.floats(0.3, 1.5), st.sampled_from((-0.5, 0.5)))
def test_a_lunge_between_the_times_of_both_views_is_no_displacement(metres, share):
    """At 5 frames per second, B half a frame before or after A."""
    frame_ns = 200_000_000
    at = lambda t: standing(BODY) + np.array((metres * np.clip((t - 4.0) / 0.5, 0.0, 1.0), 0.0, 0.0))  # noqa: E731
    rng, pairs = np.random.default_rng(2), []
    for k in range(50):
        skew = int(share * frame_ns)
        a = pair_of(BODY, at(0.2 * k), k * frame_ns).a
        b = pair_of(BODY, at(0.2 * k + 1e-9 * skew), k * frame_ns + skew).b
        pairs.append(replace(noisy(SkeletonPair(a, b, k * frame_ns), rng, 0.004), skew_ns=skew))
    off = np.linalg.norm(fused(pairs) - [at(0.2 * k) for k in range(50)], axis=2).mean(axis=1)
    assert off[25:].max() < 0.1


@given(vectors(), st.sampled_from("ab"))
def test_the_deviation_tells_that_a_displaced_view_may_be_right(by, view):
    fuser = new_fuser()
    pairs = displaced(by, slice(FIRST, None), view)
    frames = [fuser.update(pair, Labels.with_sides([(0, 0)])) for pair in pairs]
    before, after = (np.nanmedian(frames[k].sigma) for k in (FIRST - 5, FIRST + 5))
    assert after > before
