"""Choosing one person of a recording by id."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.people.recorded_people import OneRecording, RecordedPeople
from devices.people.recorded_person import follow_one_person
from devices.people.tracks import Numbering, Tracks
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError, SensorFrame
from devices.simulated.kinect import Beside, movement
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.clocks import Clock
from fusion.skeleton import Skeleton
from tests.helpers.laws import COSTLY
from tests.helpers.recorded_pairs import write_view
from tests.helpers.two_people import (
    BEHIND,
    FOLLOWED,
    OTHER,
    THERAPIST,
    recorded,
    share_right,
    two_people,
)
from tests.helpers.two_views import moving


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


def follow_one(a, b, offset_ns=0, follow="longest", ids=(None, None)):
    """Both recordings with the person, and who else is seen."""
    reads = (
        OneRecording(
            side, people, None, [], np.zeros((0, 2), np.int64), people.skeletons, name, f"person_{side}"
        )
        for side, people, name in zip("ab", (a, b), ids, strict=True)
    )
    return follow_one_person(tuple(reads), None if offset_ns is None else Clock(offset_ns), follow)


def test_the_next_person_is_followed_under_the_same_id():
    """Where the placement of the sensors is unknown, those who are never seen together are one person."""
    frames = [*_alone(range(7), "2"), SensorFrame(7), *_alone(range(8, 11), "4"), *_alone(range(11, 12), "5")]
    beside = _alone(range(3, 4), "3")[0].people | frames[3].people
    frames[3] = SensorFrame(3, beside)  # someone else, at the same time
    people = RecordedPeople.of(AZURE_KINECT, frames)
    assert [list(frame.people) for frame in people] == [list(frame.people) for frame in frames]
    nobody = RecordedPeople.of(AZURE_KINECT, [SensorFrame(0), SensorFrame(1)])
    read, _, everyone = follow_one(people, nobody)
    assert everyone == ()
    np.testing.assert_array_equal(read.person.time_ns, range(12))
    assert read.person.states.any(axis=1).tolist() == [True] * 7 + [False] + [True] * 4
    np.testing.assert_array_equal(read.person.positions[9], frames[9].people["4"].positions)
    assert "'4', '5' counts as the person '2'" in read.warnings[0]


# --- Who is one person in two views that show several people, whatever ids the trackers give them.


SECOND_NS = 1_000_000_000


@cache
def treated(seed=0):
    """A patient and a therapist who goes to and fro behind them."""
    return two_people(("squat", THERAPIST), seed, 8.0)[0]


def followed(a, b, offset_ns=0, **options):
    return [read.person for read in follow_one(a, b, offset_ns, **options)[:2]]


def assert_right(views, seen, who=FOLLOWED, least=0.995):
    for view, of_view in zip(views, seen, strict=True):
        share, wrong = share_right(view, of_view, who)
        assert wrong == 0
        assert share >= least


@pytest.mark.parametrize(
    ("motion", "other"),
    [
        ("walk", BEHIND),
        ("squat", Beside(movement("steps"), (1.3, 0.0, 0.3))),
        ("walk", Beside(movement("walk"), (1.2, 0.0, 1.0))),
    ],
)
def test_one_person_is_followed_through_crossings_and_exchanged_ids(motion, other):
    rng = np.random.default_rng(1)
    views, _ = two_people((motion, other), 1, 12.0)
    seen = followed(*(recorded(view, rng, exchanged=1 / 180, renewed=1 / 300) for view in views))
    assert_right(views, seen)


def test_the_clocks_may_differ():
    a, b = (
        recorded(view, np.random.default_rng(3), exchanged=0.01) for view in two_people(("walk", BEHIND))[0]
    )
    late = RecordedPeople(b.body, b.time_ns + 2 * SECOND_NS, b.ids, b.frame, b.person, b.skeletons)
    for one, other in zip(followed(a, b), followed(a, late, None), strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)


def test_views_that_have_nobody_in_common_are_not_brought_together():
    a, other = (two_people((motion, THERAPIST), seed)[0][0] for motion, seed in (("walk", 0), ("boxing", 9)))
    people = recorded(other)
    shifted = RecordedPeople(
        people.body, people.time_ns + 10**12, people.ids, people.frame, people.person, people.skeletons
    )
    *_, everyone = follow_one(recorded(a), shifted)
    assert everyone == ()


@COSTLY
@given(st.floats(0.0, 0.2), st.floats(0.0, 0.1), st.integers(0, 99))
def test_a_track_has_one_person(exchanged, renewed, seed):
    for view in treated():
        people = recorded(view, np.random.default_rng(seed), exchanged=exchanged, renewed=renewed)
        track = Tracks.of(people).track
        assert len(track) == len(people.frame)
        for k in np.unique(track):
            rows = np.flatnonzero(track == k)
            assert len(np.unique(people.frame[rows])) == len(rows)
            one = people.view_of(rows)
            who = {
                next(
                    w
                    for w, person in enumerate(view[t][1])
                    if person is not None
                    and np.array_equal(person.positions, one.positions[t], equal_nan=True)
                )
                for t in people.frame[rows].tolist()
            }
            assert len(who) == 1


@pytest.mark.parametrize(("least", "known"), [(0.02, False), (0.3, True)])
def test_after_two_were_in_one_place_nobody_knows_who_is_who(least, known):
    """They come towards each other, to a distance, and part again: their tracks go on, or are new."""
    halves = np.hypot(np.linspace(-1.0, 1.0, 90), least) / 2.0
    standing = moving(KINECT_V2, 1)[0]
    frames = [
        SensorFrame(
            t * 33_333_333,
            {
                k: Skeleton.of(KINECT_V2, standing + [side * half, 0.0, 0.0])
                for k, side in (("1", -1), ("2", 1))
            },
        )
        for t, half in enumerate(halves)
    ]
    track = Tracks.of(RecordedPeople.of(KINECT_V2, frames)).track.reshape(-1, 2)
    assert (set(track[0]) == set(track[-1])) == known
    assert set(track[0]).isdisjoint(track[-1]) != known
    ahead = Numbering(KINECT_V2)
    found = [ahead.of(f.time_ns, f.people.values()) for f in frames]
    np.testing.assert_array_equal([tracks for tracks, _, _ in found], track)
    assert any(any(doubtful) for _, doubtful, _ in found) != known


@pytest.mark.parametrize(("frames", "told"), [(2, "1 person is seen, "), (60, "2 people are seen, ")])
def test_those_who_are_seen_for_a_moment_are_not_counted(tmp_path, frames, told):
    choices = []
    for side in "ab":
        seen = moving(KINECT_V2, 60) + np.random.default_rng(ord(side)).normal(0.0, 0.005, (60, 25, 3))
        path = tmp_path / f"{side}.csv"
        other = write_view(path, KINECT_V2, seen[:frames] + [1.5, 0.0, 0.5]).read_text().splitlines()[1:]
        one = write_view(path, KINECT_V2, seen).read_text().splitlines()
        path.write_text("\n".join([*one, *(row.replace(",0,", ",1,", 1) for row in other)]) + "\n")
        choices.append(RecordingChoice(path, person_option=f"--person-{side}"))
    (line,) = (line for line in read_two(*choices).warnings if "The one followed" in line)
    assert line.startswith(told)
    assert "The one followed is '0' of A and '0' of B" in line
    people = read_two(*choices).people
    assert [person.ids for person in people] == [("0", "0"), ("1", "1")][: (frames > 2) * 2]
    for person in people:
        assert person.seconds == pytest.approx((2.0, 2.0), abs=0.1)
        again = read_two(
            *(replace(choice, person=name) for choice, name in zip(choices, person.ids, strict=True))
        )
        assert again.people[0] == person
        assert not any("choose" in line for line in again.warnings)


@given(st.integers(0, 99))
@COSTLY
def test_an_id_chooses_whoever_has_it_most_of_the_time(seed):
    """Also where ids are exchanged and renewed, and given for one view only."""
    a, b = (recorded(view, np.random.default_rng(seed), exchanged=0.004, renewed=0.01) for view in treated())
    who = {person.ids[0]: person for person in follow_one(a, b)[2]}
    for name, person in who.items():
        found = follow_one(a, b, ids=(name, None))
        assert found[2][0] == person


def test_ids_of_two_people_are_not_one():
    """Each view then follows who has its id."""
    a, b = (recorded(view) for view in treated())
    for read, name in zip(follow_one(a, b, ids=("1", "2"))[:2], "12", strict=True):
        np.testing.assert_array_equal(read.person.positions, read.people.view([name]).positions)


def test_the_one_in_the_middle_or_the_one_seen_longest():
    """Of a person in the middle every other second is seen; somebody stands beside all the time."""
    views = [
        [
            (time_ns, [person if t % 60 < 30 else None, other])
            for t, (time_ns, (person, other)) in enumerate(view)
        ]
        for view in two_people(("squat", Beside(movement("steps"), (1.2, 0.0, 0.4))))[0]
    ]
    a, b = (recorded(view) for view in views)
    for follow, who in (("middle", FOLLOWED), ("longest", OTHER)):
        for seen, view in zip(followed(a, b, follow=follow), views, strict=True):
            assert (share_right(view, seen)[0] > 0.5) == (who == FOLLOWED)


def test_people_whom_two_trackers_number_otherwise(shared):
    """Published case: the person nearest the middle is 1 of A and 2 of B; a line says so."""
    folder = shared / "cases" / "04-two-people-numbered-otherwise"
    if not folder.exists():
        pytest.skip("no cases beside the project")
    a, b = (RecordingChoice(folder / f"{side}.csv", person_option=f"--person-{side}") for side in "ab")
    read = read_two(a, b)
    first = [view.positions[0, read.body.root] for view in read.pairing.pairs.skeletons.views]
    np.testing.assert_allclose(first, [(-0.01, 0.01, 2.60), (-0.01, 0.02, 2.56)], atol=1e-6)
    (line,) = (line for line in read.warnings if "people" in line)
    assert "'1' of A and '2' of B" in line
    assert "--person-a and --person-b choose another" in line
