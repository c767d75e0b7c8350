"""Frames of two sensors that see a moving person, as input of the loop; and how frames become pairs."""

from types import SimpleNamespace

import numpy as np

from devices.frame_pairs import FramePair
from devices.pairing import pair_views
from devices.people.recorded_people import RecordedPeople
from devices.sensor import SensorFrame
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving


def frame_pair(a, b, person, time_ns, skew_ns=0):
    """The pair of two frames, with the person who has this id in both."""
    seen = (None if frame is None else frame.people.get(person) for frame in (a, b))
    return FramePair(a, b, SkeletonPair(*seen, time_ns, skew_ns))


def paired(a, b, **more):
    """The frames of two recordings of one person in pairs."""
    frames_a, frames_b = list(a), list(b)
    body = next(person.body for frame in frames_a for person in frame.people.values())
    people = (RecordedPeople.of(body, frames) for frames in (frames_a, frames_b))
    return pair_views(body, *(each.view(each.ids) for each in people), **more)


class KnownSensors:
    """Two sensors that give the live loop these pairs. `waiting`: the next frame has already arrived."""

    figures = None

    def __init__(self, pairs, waiting=False, cameras=(None, None)):
        self._pairs, self.waiting = pairs, waiting
        self.a, self.b = (
            SimpleNamespace(sensor=SimpleNamespace(intrinsics=camera, depth_offset=0.0)) for camera in cameras
        )

    def pairs(self, every_frame=True):
        assert every_frame
        return iter(self._pairs)

    def events(self):
        return ()


def frame_pairs(body, frames, gap=(), only_a=(), no_a=(), no_b=(), jitter_ns=0, noise=0.02, depth=False):
    """Both sensors' noisy views.

    Args:
        body: The body.
        frames: How many.
        gap: Frames in which no one is seen.
        only_a: Frames in which B sees no one.
        no_a, no_b: Frames that A, and B, did not deliver.
        jitter_ns: Largest deviation of the times.
        noise: Metres, on each axis.
        depth: With small depth images.
    """
    rng = np.random.default_rng(4)
    pairs = []
    for t, at in enumerate(moving(body, frames)):
        time_ns = t * FRAME_NS + int(rng.integers(0, jitter_ns + 1)) * (t > 0)
        seen = []
        for side, points in enumerate((at, A_FROM_B.inverse().apply(at))):
            states = rng.choice([0, 1, 2], len(body), p=[0.02, 0.08, 0.9])
            own_ns = time_ns + side * 77_000_123
            skeleton = Skeleton.of(body, points + rng.normal(0, noise, points.shape), states, own_ns)
            absent = t in gap or (side == 1 and t in only_a)
            image = rng.integers(0, 4000, (24, 32)).astype(np.uint16) if depth else None
            seen.append(SensorFrame(own_ns, {} if absent else {"7": skeleton}, image))
        a, b = None if t in no_a else seen[0], None if t in no_b else seen[1]
        pairs.append(frame_pair(a, b, "7", time_ns, 0 if b is None else int(rng.integers(-9e6, 9e6))))
    return pairs
