"""Choosing and following one person among several."""

import numpy as np
import pytest

from devices.people import PersonChoice, RecordedPeople
from devices.sensor import DeviceError, SensorFrame
from fusion.body import AZURE_KINECT
from fusion.skeleton import Skeleton

FRAME_NS = 33_333_333


def _person(x, z=2.0, states=2):
    offsets = np.linspace(-0.3, 0.3, 32)[:, None] * [0.0, 1.0, 0.0]
    return Skeleton.of(AZURE_KINECT, np.array([x, 0.0, z]) + offsets, np.full(32, states))


def _ids(choice, *frames):
    chosen = []
    for index, people in enumerate(frames):
        skeleton = choice.choose(people, index * FRAME_NS)
        chosen.append(next((name for name, person in people.items() if person is skeleton), None))
    return chosen


def test_the_first_choice_is_nearest_to_the_centre_of_the_view():
    # 0.5 m aside at 4 m is 7 degrees from the axis, 0.4 m at 1.5 m is 15: the farther one is more central.
    people = {"1": _person(0.4, 1.5), "2": _person(-0.5, 4.0)}
    assert _ids(PersonChoice(), people) == ["2"]


def test_the_same_person_stays_chosen_when_another_is_more_central():
    frames = [{"1": _person(0.1 + 0.02 * i), "2": _person(-1.5 + 0.03 * i)} for i in range(60)]
    assert _ids(PersonChoice(), *frames) == ["1"] * 60


def test_a_new_id_in_the_same_place_takes_over_but_not_from_an_id_that_stays_with_its_body():
    frames = [{"1": _person(0.0)}, {"1": _person(0.02)}, {"9": _person(0.04)}, {"9": _person(0.06)}]
    assert _ids(PersonChoice(), *frames) == ["1", "1", "9", "9"]
    nearer = {"1": _person(0.0), "2": _person(0.15)}, {"1": _person(0.15), "2": _person(0.02)}
    assert _ids(PersonChoice(), *nearer) == ["1", "1"]


# 0.5 m in one frame is what a runner could do, but somebody else stands exactly where the person stood.
@pytest.mark.parametrize("apart", [1.2, 0.5])
def test_swapped_ids_do_not_swap_the_person(apart):
    before = {"1": _person(0.0), "2": _person(apart)}
    after = {"2": _person(0.02), "1": _person(apart - 0.02)}
    assert _ids(PersonChoice(), before, before, after, after) == ["1", "1", "2", "2"]


def test_two_who_pass_close_by_keep_their_ids():
    # 1 m/s each, through each other's place: at 0.1 m distance proximity alone would be a guess.
    frames = [{"1": _person(0.033 * i - 1, 2.0), "2": _person(1.1 - 0.033 * i, 2.1)} for i in range(60)]
    assert set(_ids(PersonChoice(), *frames)) == {"1"}


def test_a_stranger_is_not_taken_while_the_person_is_out_of_sight():
    stranger = {"2": _person(2.5)}
    frames = [{"1": _person(0.0), **stranger}] + [stranger] * 10 + [{"7": _person(0.1), **stranger}]
    assert _ids(PersonChoice(), *frames) == ["1", *[None] * 10, "7"]


def test_after_two_seconds_or_a_clock_reset_the_choice_starts_anew():
    choice = PersonChoice()
    choice.choose({"1": _person(0.0)}, 0)
    assert choice.choose({"2": _person(15.0, 4.0)}, 1_900_000_000) is None
    assert choice.choose({"2": _person(15.0, 4.0)}, 2_100_000_000) is not None
    assert choice.identity == "2"
    assert choice.choose({"3": _person(3.0)}, 0) is not None


def test_nobody_and_bodies_without_a_position_are_no_choice():
    assert PersonChoice().choose({}, 0) is None
    assert PersonChoice().choose({"1": _person(0.0, states=0)}, 0) is None


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
