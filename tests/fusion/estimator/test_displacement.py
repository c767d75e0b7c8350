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
from fusion.skeleton import Skeleton
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, noisy, pair_of

BODY = KINECT_V2
FIRST, FRAMES = 60, 30
EVERY = slice(FIRST, FIRST + FRAMES)
RNG = np.random.default_rng(5)
CLEAN = [noisy(pair_of(BODY, at, t * FRAME_NS), RNG, 0.004) for t, at in enumerate(moving(BODY, 150))]


def fused(pairs):
    """(T, J, 3) S*, without correction of sides: this person has no front."""
    fuser = Fuser(FusionSetup(calibration_of(BODY)), Constants.of(BODY)._replace(heading=False))
    frames = fuser.fuse_sequence(pairs, Labels.with_sides(np.zeros((len(pairs), 2))))
    return np.array([frame.positions for frame in frames])


def displaced(by, frames=EVERY, views="a"):
    """The pairs with the same views displaced by (3,) metres in K_A's frame."""
    pairs = list(CLEAN)
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


@given(vectors())
def test_a_person_who_jumps_before_both_views_is_followed(clean, by):
    off = fused(displaced(by, views="ab"))[EVERY][10:] - clean[EVERY][10:] - by
    assert np.linalg.norm(off, axis=2).mean() < 0.02


@given(vectors(), st.sampled_from("ab"))
def test_a_jump_towards_the_other_view_is_a_correction(clean, by, view):
    """A view that was wrong from the start and is right later moves S* to where both see the person."""
    off = np.linalg.norm(fused(displaced(by, slice(0, FIRST), view)) - clean, axis=2)
    assert off[FIRST + 45 :].mean() < 0.02
