"""Two simulated people before two sensors, and trackers that exchange, lose and renew their ids."""

from functools import cache

import numpy as np

from devices.people.recorded_people import RecordedPeople
from devices.sensor import SensorFrame
from devices.simulated.kinect import PERSON, Beside, movement, simulated_pair
from fusion.body import KINECT_V2

FOLLOWED, OTHER = 0, 1
_BEHIND_RAD = np.radians(7.0)


THERAPIST = Beside(movement("idle"), (0.9, 0.0, 0.8), (1.6, 0.0, 0.1))
"""Goes to and fro behind a person who stands, and crosses them in both views."""
BEHIND = Beside(movement("idle"), (0.0, 0.0, 1.4), (1.6, 0.0, 0.1))
"""The same behind a person who walks: the two are never nearer than half a metre."""


@cache
def two_people(motions, seed=0, seconds=10.0):
    """Of each sensor and frame: time and the skeletons of both people, None where one is not seen.

    The one behind another is not seen. The lists are shared by all who ask for the same.
    """
    each = [
        simulated_pair(motion=motion, seed=2 * seed + k, body=KINECT_V2, seconds=seconds, height=height)
        for k, (motion, height) in enumerate(zip(motions, (1.75, 1.62), strict=True))
    ]
    views = []
    for side in (0, 1):
        frames = zip(*(pair[side].frames() for pair in each), strict=True)
        views.append(
            [
                (one.time_ns, _without_hidden([f.people.get(PERSON) for f in (one, two)]))
                for one, two in frames
            ]
        )
    return views, each[0][2]


def _without_hidden(people):
    if None in people:
        return people
    middle = np.array([np.nanmean(person.positions, axis=0) for person in people])
    bearing = np.arctan2(middle[:, 0], middle[:, 2])
    hidden = int(np.argmax(middle[:, 2])) if np.abs(np.diff(bearing)) < _BEHIND_RAD else None
    return [None if k == hidden else person for k, person in enumerate(people)]


def with_ids(view, rng, exchanged=0.0, renewed=0.0, shuffled=False):
    """Frames of a view, with ids that change places and are new, so many times a frame.

    Args:
        shuffled: Whether people come in any order.
    """
    ids, count, frames = ["1", "2"], 2, []
    for time_ns, people in view:
        if rng.random() < exchanged:
            ids = ids[::-1]
        if rng.random() < renewed:
            count += 1
            ids[rng.integers(2)] = str(count)
        seen = [(ids[k], person) for k, person in enumerate(people) if person is not None]
        frames.append(SensorFrame(time_ns, dict(seen[::-1] if shuffled and rng.random() < 0.5 else seen)))
    return frames


def recorded(view, rng=None, body=KINECT_V2, **ids):
    """The frames as a recording."""
    return RecordedPeople.of(body, with_ids(view, rng or np.random.default_rng(0), **ids))


def share_right(view, followed, who=FOLLOWED):
    """Of the frames in which either person is followed or the right one is seen, those that are right."""
    right = wrong = missed = 0
    for k, (_, people) in enumerate(view):
        seen, true = followed.positions[k], people[who]
        if not followed.states[k].any():
            missed += true is not None
        elif true is not None and np.array_equal(seen, true.positions, equal_nan=True):
            right += 1
        else:
            wrong += 1
    return right / max(1, right + wrong + missed), wrong
