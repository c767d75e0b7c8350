"""A person who moves all the time, at any moment: what two sensors of any frame rate saw of one motion."""

import numpy as np

from fusion.body import KINECT_V2
from fusion.pair_arrays import View
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, standing

RATES = (5, 8, 10, 13, 15, 30, 60, 90)
"""Frames per second, from a slow body tracker to the fastest sensor."""


def person_at(seconds, seed=0, body=KINECT_V2):
    """(T, J, 3) metres in K_A's frame at (T,) seconds: up to 0.5 Hz, without repetition."""
    rng = np.random.default_rng(seed)
    at = np.asarray(seconds, dtype=float)[:, None, None]
    moved = np.broadcast_to(standing(body), (len(at), len(body), 3)).copy()
    for frequency in rng.uniform(0.8, 3.0, 4):
        whole = rng.normal(0.0, 0.12, (1, 1, 3)) * (1.0, 0.1, 1.0)
        each = rng.normal(0.0, 0.04, (1, len(body), 3))
        moved += (whole + each) * np.sin(frequency * at + rng.uniform(0.0, 2.0 * np.pi, (1, len(body), 1)))
    return moved


def views_at(seconds_a, seconds_b, seed=0, noise=0.004):
    """The person as A and B saw them at these moments: (T, J, 3) float32, each in the sensor's frame."""
    rng = np.random.default_rng(seed + 1)
    a, b = person_at(seconds_a, seed), A_FROM_B.inverse().apply(person_at(seconds_b, seed))
    return tuple((view + rng.normal(0.0, noise, view.shape)).astype(np.float32) for view in (a, b))


def as_view(positions, seconds):
    """A recording whose time stamps say that it was seen at these moments."""
    states = np.full(positions.shape[:2], 2, dtype=np.uint8)
    return View((np.asarray(seconds) * 1e9).astype(np.int64), positions, states)


def as_pairs(a, b, seconds, skew=0.0, body=KINECT_V2):
    """Pairs at these seconds, of which B's time stamps are later by ``skew`` seconds."""
    pairs = []
    for one, other, time in zip(a, b, seconds, strict=True):
        time_ns, skew_ns = round(time * 1e9), round(skew * 1e9)
        views = Skeleton.of(body, one, None, time_ns), Skeleton.of(body, other, None, time_ns + skew_ns)
        pairs.append(SkeletonPair(*views, time_ns, skew_ns))
    return pairs
