"""Laws of S* of the method ``duplex``, for every input: no history lasts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.fuser import Fuser
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import (
    BODY,
    SECOND,
    Stage,
    exchanged,
    pairs_at,
    setup_of,
    walking,
)

FEW = settings(max_examples=15)
RATES = (10, 15, 30, 60, 90)


def times_of(seconds, rate=30, start=100.0):
    return (np.arange(round(seconds * rate)) * SECOND / rate + start * SECOND).astype(np.int64)


def walk(seconds, rate=30, start=100.0, **more):
    """Pairs of a walking person, and where the person is."""
    times = times_of(seconds, rate, start)
    place = {name: more.pop(name) for name in ("place", "turned", "speed", "body") if name in more}
    truth = walking((times - times[0]) * 1e-9, **place)
    return pairs_at(times, truth, body=place.get("body", BODY), **more), truth


def distance(a, b):
    return np.linalg.norm(a - b, axis=-1)


def with_the_up_of(fuser):
    """A new fuser that knows the upward direction, which belongs to the sensor and not to the person."""
    fresh = Fuser(fuser.setup)
    ours, its = fuser._fusion._filter.facing.memory, fresh._fusion._filter.facing.memory
    for name in ("up", "up_seconds"):
        getattr(its, name)[...] = getattr(ours, name)
    return fresh


# No history lasts


@FEW
@given(
    away=st.sampled_from((1.01, 2.5, 3600.0, -5.0, -0.001)),
    empty=st.sampled_from((0, 40)),
    mirrored=st.booleans(),
    scale=st.floats(0.94, 1.06),
)
def test_a_person_who_comes_back_after_a_second_is_a_new_one(away, empty, mirrored, scale):
    before, _ = walk(1.5, seed=1, turned=180.0)
    middle = np.array((0.0, 0.0, 2.6))
    for k, pair in enumerate(before):
        a = Skeleton.of(BODY, middle + (pair.a.positions - middle) * scale, pair.a.states, pair.time_ns)
        before[k] = replace(pair, a=exchanged(a) if mirrored else a)
    last_ns = before[-1].time_ns
    nobody = [SkeletonPair(None, None, last_ns + k * 25_000_000) for k in range(1, empty + 1)]
    after, _ = walk(0.7, seed=2, place=(0.4, 0.0, 0.3), start=last_ns / SECOND + away)
    fuser = Fuser(setup_of())
    fuser.fuse_sequence(before + nobody)
    fresh = with_the_up_of(fuser)
    for pair in after:
        frame, other = fuser.update(pair), fresh.update(pair)
        for name in ("positions", "velocities", "sigma", "covariance", "weights_a", "doubt_a", "doubt_b"):
            np.testing.assert_allclose(getattr(frame, name), getattr(other, name), rtol=0.0, atol=1e-9)
        assert (frame.exchanged_a, frame.exchanged_b) == (other.exchanged_a, other.exchanged_b)


@pytest.mark.parametrize("views", ["both", "a", "b"])
@pytest.mark.parametrize("metres", [0.3, 1.2])
@pytest.mark.parametrize("seconds", [0.001, 1 / 30, 0.9])
def test_a_person_found_elsewhere_is_followed_within_a_second(views, metres, seconds):
    stage = Stage(views=views)
    stage.step(30)
    stage.place = (-0.6 * metres, 0.0, 0.8 * metres)
    stage.happen(("step", round(seconds * SECOND)))
    stage.step(30)
    assert (
        distance(stage.frames[-1].positions, walking(stage.clock - 1 / 30, place=stage.place)[0]).max() < 0.1
    )
