"""A second simulated person hides the first one and is hidden, and trackers exchange the ids of the two."""

import numpy as np
import pytest

from devices.simulated.demonstration import demonstration, therapist
from devices.simulated.kinect import OTHER, PERSON, Beside, Scene, movement, simulated_pair
from fusion.body import KINECT_V2

ASIDE = Beside(movement("sit"), (1.5, 0.0, 0.3))
BEHIND = Beside(movement("still"), (0.0, 0.0, 0.8))


def frames(other, seconds=2.0, **options):
    a, _, _ = simulated_pair(motion="walk", body=KINECT_V2, seconds=seconds, seed=3, other=other, **options)
    return list(a.frames())


def torso(skeleton):
    return np.nanmean(skeleton.positions[list(KINECT_V2.torso)], axis=0)


def test_a_person_who_stands_aside_changes_nothing_of_the_first_one():
    alone, both = frames(None), frames(ASIDE)
    assert [frame.time_ns for frame in alone] == [frame.time_ns for frame in both]
    for one, two in zip(alone, both, strict=True):
        assert one.people.keys() <= {PERSON}
        assert (PERSON in one.people) == (PERSON in two.people)
        if PERSON in one.people:
            assert one.people[PERSON].repeats(two.people[PERSON])
    apart = [np.linalg.norm(torso(f.people[OTHER]) - torso(f.people[PERSON])) for f in both[5:]]
    assert np.median(apart) == pytest.approx(np.hypot(1.5, 0.3), abs=0.4)


def test_who_stands_behind_another_is_hidden():
    seen = [frame.people for frame in frames(BEHIND, angle_deg=0.0) if PERSON in frame.people]
    first = np.mean([people[PERSON].tracked.mean() for people in seen])
    other = np.mean([people[OTHER].tracked.mean() if OTHER in people else 0.0 for people in seen])
    assert other < first - 0.2
    depth = frames(BEHIND, 0.1, angle_deg=90.0, depth="half")[0].depth
    alone = frames(None, 0.1, angle_deg=90.0, depth="half")[0].depth
    assert (depth != alone).mean() > 0.01


def test_a_therapist_who_sits_down_hides_a_part_of_the_person_from_one_sensor():
    seen = []
    for other in (None, therapist("sits")):
        scene = Scene(movement("squat"), KINECT_V2, seconds=12.0, other=other)
        shown = demonstration(scene)
        seen.append([np.mean([_share(frame) for frame in sensor.frames()]) for sensor in (shown.a, shown.b)])
    (alone_a, alone_b), (beside_a, beside_b) = seen
    assert beside_a < alone_a - 0.1
    assert beside_b == pytest.approx(alone_b, abs=0.02)


def _share(frame):
    """Of the person's joints, those that are tracked."""
    return frame.people[PERSON].tracked.mean() if PERSON in frame.people else 0.0
