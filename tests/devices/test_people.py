"""Choosing one person of a recording by id."""

import numpy as np
import pytest

from devices.people.association import Followed
from devices.people.recorded_people import RecordedPeople
from devices.sensor import DeviceError, SensorFrame
from fusion.body import AZURE_KINECT
from fusion.skeleton import Skeleton


def _person(x):
    offsets = np.linspace(-0.3, 0.3, 32)[:, None] * [0.0, 1.0, 0.0]
    return Skeleton.of(AZURE_KINECT, np.array([x, 0.0, 2.0]) + offsets)


def _alone(times_ns, person):
    return [SensorFrame(time_ns, {person: _person(0.0)}) for time_ns in times_ns]


def test_the_person_seen_longest_is_followed_unless_another_is_wanted():
    people = RecordedPeople.of(AZURE_KINECT, [*_alone(range(5), "1"), *_alone(range(5, 12), "2")])
    assert people.choose_person(None, "a.csv", "--person-a") == "2"
    assert people.choose_person("1", "a.csv", "--person-a") == "1"
    with pytest.raises(DeviceError, match=r"no person '9'.*'2' \(7 frames\).*--person-a"):
        people.choose_person("9", "a.csv", "--person-a")
    with pytest.raises(DeviceError, match="no person in any"):
        RecordedPeople.of(AZURE_KINECT, [SensorFrame(0)]).choose_person(None, "a.csv", "--person-a")


def test_an_id_that_somebody_else_has_longer_chooses_nobody():
    """Of two people: one has the id 1 for 9 frames, the other for 4, then 2 for 3."""
    ids = ["1"] * 9 + ["1"] * 4 + ["2"] * 3
    people = RecordedPeople.of(
        AZURE_KINECT, [frame for t, name in enumerate(ids) for frame in _alone([t], name)]
    )
    for end, expected in ((16, "2"), (13, None)):
        rows = np.arange(9), np.arange(9, end)
        one, other = Followed([(rows[0],) * 2, (rows[1],) * 2], 2).people((people, people))
        assert one.ids == ("1", "1")
        assert other.ids == (expected, expected)


def test_the_next_person_is_followed_under_the_same_id():
    frames = [*_alone(range(7), "2"), SensorFrame(7), *_alone(range(8, 11), "4"), *_alone(range(11, 12), "5")]
    beside = _alone(range(3, 4), "3")[0].people | frames[3].people
    frames[3] = SensorFrame(3, beside)  # someone else, at the same time
    people = RecordedPeople.of(AZURE_KINECT, frames)
    assert [list(frame.people) for frame in people] == [list(frame.people) for frame in frames]
    assert people.successors("2") == ("4", "5")
    followed = people.view(("2", "4", "5"))
    np.testing.assert_array_equal(followed.time_ns, range(12))
    assert followed.states.any(axis=1).tolist() == [True] * 7 + [False] + [True] * 4
    np.testing.assert_array_equal(followed.positions[9], frames[9].people["4"].positions)
    assert RecordedPeople.of(AZURE_KINECT, _alone(range(2), "2")).successors("2") == ()
