"""Who is followed in two views that show several people, live and recorded, whatever the ids."""

from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.frame_pairs import FramePair
from devices.people import following
from devices.people.following import PersonOfPair
from devices.people.placement import Placement, one_movement
from devices.people.recorded_people import OneRecording, RecordedPeople
from devices.people.recorded_person import follow_one_person
from devices.people.tracks import Numbering, Tracks
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError, SensorFrame
from devices.simulated.demonstration import therapist
from devices.simulated.kinect import PERSON, Beside, movement, simulated_pair
from devices.simulated.person.gait import walking
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.clocks import Clock
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
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
    with_ids,
)
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, standing


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


# --- One person is followed live among others, whatever ids the trackers give them.


AROUND = Beside(walking("walk", length=12.0, strides=14), (0.6, 0.0, 0.4), later=2.5)
"""Walks round the person, between them and each sensor, half a metre to two away."""


def live(frames, a_from_b=A_FROM_B, body=KINECT_V2, learns=True, **options):
    """Of each pair: the skeletons followed in A and B; and the events.

    ``a_from_b``: the placement, or a function of the number of the pair. ``learns``: whether it is searched.
    """
    people, seen, events = PersonOfPair(body, **options), [], []
    for k, (a, b) in enumerate(frames):
        later_ns = 0 if b is None else b.time_ns - a.time_ns
        pair = FramePair(a, b, SkeletonPair(None, None, a.time_ns, later_ns))
        skeletons = people.chosen(pair, a_from_b(k) if callable(a_from_b) else a_from_b).skeletons
        seen.append((skeletons.a, skeletons.b))
        events += people.learn() if learns else []
    return seen, events


@cache
def crossed(seed, other):
    """A simulated pair, its frames, and the place of the person in each view."""
    of = {"motion": "squat", "seed": seed, "body": KINECT_V2, "seconds": 20.0}
    a, b, truth = simulated_pair(**of, other=other, exchanged=10.0)
    frames = list(a.frames()), list(b.frames())
    alone = simulated_pair(**of)[:2]
    # the person's torso is where their tracker puts it if nobody else is there, to a decimetre or two
    places = [{f.time_ns: middle(f.people[PERSON]) for f in sensor.frames() if f.people} for sensor in alone]
    return frames, truth.a_from_b, places


def middle(skeleton):
    torso = skeleton.positions[list(skeleton.body.torso)]
    return np.nanmean(torso if np.isfinite(torso).any() else skeleton.positions, axis=0)


def longest_wrong(frames, seen, places):
    """Seconds for which another one is followed, at most, and the share of frames in which the person is."""
    right = []
    for frame, skeleton in zip(frames, seen, strict=True):
        at = places.get(frame.time_ns)
        if at is None or skeleton is None:
            right.append(None)
            continue
        others = [person for person in frame.people.values() if person is not skeleton]
        off = np.linalg.norm(middle(skeleton) - at)
        nearest = min((np.linalg.norm(middle(other) - at) for other in others), default=np.inf)
        right.append(bool(off < min(nearest, 0.5)))
    runs = [(k, len(list(run))) for k, run in groupby(right)]
    return max((n for k, n in runs if k is False), default=0) / 30.0, np.mean([k is True for k in right])


@pytest.mark.parametrize(
    ("seed", "other", "least"),
    [(0, AROUND, (0.75, 0.9)), (1, AROUND, (0.75, 0.9)), (0, therapist("sits"), (0.5, 0.5))],
    ids=["crosses", "crosses otherwise", "sits down before the person"],
)
@pytest.mark.parametrize("known", [True, False])
def test_a_therapist_is_not_followed(seed, other, least, known):
    frames, a_from_b, places = crossed(seed, other)
    seen, events = live(zip(*frames, strict=True), a_from_b if known else None)
    for view, of, at in zip(frames, zip(*seen, strict=True), places, strict=True):
        wrong, share = longest_wrong(view, of, at)
        assert wrong <= 0.3
        assert share > least[known]  # else they are hidden, or B's person is not known yet
    assert [event.phase for event in events if event.topic == "others"][:1] == ["start"]
    assert not any("another one" in event.text for event in events)


def still(x, z=2.0, states=2, scale=1.0):
    """Somebody who stands."""
    at = standing(AZURE_KINECT)
    at = scale * (at - at[list(AZURE_KINECT.torso)].mean(axis=0)) + [x, 0.0, z]
    return Skeleton.of(AZURE_KINECT, at, np.full(32, states))


def breathing(people, time_ns):
    """The same, a millimetre off: a skeleton that is repeated to the bit is nobody."""
    off = np.float32(0.001 * np.sin(1e-9 * time_ns))
    return {name: replace(person, positions=person.positions + off) for name, person in people.items()}


def ids_of_both(frames, a_from_b=None, times=None, **options):
    """Of each frame: whom A and B follow, where (A's people, B's people) are given."""
    times = range(0, len(frames) * FRAME_NS, FRAME_NS) if times is None else times
    frames = [
        tuple(SensorFrame(time_ns, breathing(of, time_ns)) for of in sides)
        for time_ns, sides in zip(times, frames, strict=True)
    ]
    seen, _ = live(frames, a_from_b, AZURE_KINECT, learns=False, **options)
    return [
        tuple(
            next((name for name, person in frame.people.items() if person is one), None)
            for frame, one in zip(sides, picks, strict=True)
        )
        for sides, picks in zip(frames, seen, strict=True)
    ]


def ids_of_a(frames, *of, **how):
    """The same of A where B sees nobody."""
    return [a for a, _ in ids_of_both([(people, {}) for people in frames], *of, **how)]


KNOWN = pytest.mark.parametrize("a_from_b", [None, RigidTransform.identity()], ids=["unknown", "known"])


@KNOWN
@pytest.mark.parametrize(("nearer_the_axis", "chosen"), [(0.06, "1"), (0.1, "2")])
def test_the_first_choice_is_nearest_to_the_middle_of_the_view(nearer_the_axis, chosen, a_from_b):
    """Of two at 2 and 4 m; the 2 m count as 0.08 radians."""
    two = {"1": still(2.0 * np.tan(0.2), 2.0), "2": still(-4.0 * np.tan(0.2 - nearer_the_axis), 4.0)}
    assert ids_of_a([two], a_from_b) == [chosen]


@pytest.mark.parametrize(
    ("off", "beside", "taken"),
    [(0.55, {}, True), (0.65, {}, False), (0.25, {"2": still(2.5)}, True), (0.35, {"2": still(2.5)}, False)],
)
def test_in_a_crowd_a_body_of_the_other_view_must_be_nearer(off, beside, taken):
    in_a = {"1": still(0.0), **beside}
    frames = [(in_a, {})] * 30 + [(in_a, {"1": still(off)})]
    assert ids_of_both(frames, RigidTransform.identity())[-1] == ("1", "1" if taken else None)


@pytest.mark.parametrize(
    ("fit", "lead", "found"), [(0.51, 0.31, True), (0.49, 0.31, False), (0.51, 0.29, False)]
)
def test_a_registration_is_used_if_it_fits_and_no_other_does(monkeypatch, fit, lead, found):
    def search(*_):
        yield
        return Placement(RigidTransform.identity(), None, fit, lead, np.zeros(3))

    monkeypatch.setattr(following, "search_placement", search)
    people = PersonOfPair(AZURE_KINECT)
    for k in range(12):
        frame = SensorFrame(k * FRAME_NS, breathing({"1": still(0.0), "2": still(1.5)}, k * FRAME_NS))
        people.chosen(FramePair(frame, frame, SkeletonPair(None, None, frame.time_ns, 0)))
        people.learn()
    assert (people._search.found is not None) == found


@KNOWN
def test_a_stranger_is_not_taken_while_the_person_is_out_of_sight(a_from_b):
    stranger = {"2": still(2.5)}
    frames = [{"1": still(0.0), **stranger}] + [stranger] * 100 + [{"7": still(0.1), **stranger}]
    assert ids_of_a(frames, a_from_b) == ["1", *[None] * 100, "7"]


@pytest.mark.parametrize(("follow", "next_one"), [("middle", "3"), ("longest", "2")])
def test_when_the_person_is_gone_the_one_in_the_middle_or_seen_longest_is_next(follow, next_one):
    one, two, three = {"1": still(0.0)}, {"2": still(2.5)}, {"3": still(0.8, 3.0)}
    frames = [one | two] * 60 + [one | two | three] * 30 + [two | three] * 310
    assert ids_of_a(frames, follow=follow)[-1] == next_one


@given(st.integers(1, 120), st.floats(0.0, 12.0))
@example(1, 0.7)  # a frame, 0.53 m at most
@example(59, 8.0)
@example(60, 8.6)
def test_a_lone_person_who_is_nearer_than_a_running_one_gets_is_followed_on(later, metres):
    """At 4 m/s and 0.4 m; after two seconds, or where a clock is reset, they may be anywhere."""
    seconds = later * FRAME_NS * 1e-9
    assume(abs(metres - 0.4 - 4.0 * seconds) > 0.01)
    times = [(1000 + k) * FRAME_NS for k in (0, later, -1)]
    people = {"1": still(0.0)}, {"2": still(metres)}, {"3": still(-5.0)}
    taken = metres < 0.4 + 4.0 * seconds or seconds > 2.0
    assert ids_of_a(people, times=times) == ["1", "2" if taken else None, "3"]


@pytest.mark.parametrize("people", [{}, {"1": still(0.0, states=0)}])
def test_nobody_and_bodies_without_a_position_are_no_choice(people):
    assert ids_of_a([people]) == [None]
    both = {**people, "2": still(0.0), "3": still(1.0)}
    assert ids_of_a([both, people]) == ["2", None]


TWO = {"1": still(0.0), "2": still(1.5)}


def test_a_sensor_that_was_moved_splits_nobody():
    """The other sensor's people are half a metre off: the same skeletons are followed."""
    moved = RigidTransform.of(np.eye(3), (0.45, 0.0, 0.0))
    chosen = ids_of_both([(TWO, TWO)] * 120, lambda k: moved if k >= 30 else RigidTransform.identity())
    assert chosen == [("1", "1")] * 120


@pytest.mark.parametrize(("off", "who", "wrong_b"), [(1.5, "2", "1"), (3.0, "1", None)])
def test_views_that_were_put_together_wrongly_are_put_right_in_a_third_of_a_second(off, who, wrong_b):
    """A placement that is off brings the wrong people of B to those of A, or nobody."""
    wrong = RigidTransform.of(np.eye(3), (off, 0.0, 0.0))
    chosen = ids_of_both([(TWO, TWO)] * 60, lambda k: wrong if k < 30 else RigidTransform.identity())
    assert chosen[:30] == [(who, wrong_b)] * 30
    assert {a for a, _ in chosen[30:]} == {who}
    assert chosen[40:] == [(who, who)] * 20


def test_before_the_placement_is_known_two_who_come_back_are_told_apart_in_one_view_only():
    alone, back = {"1": still(0.0)}, {"8": still(1.4), "9": still(0.1)}
    chosen = ids_of_both([(of, of) for of in [*[alone] * 10, *[TWO] * 30, *[{}] * 45, *[back] * 5]])
    assert chosen[:40] == [("1", "1")] * 40
    assert chosen[-5:] == [("9", None)] * 5


PLACES = {"1": (0.05, 2.0), "2": (1.3, 2.5), "3": (-1.7, 3.0)}
SIGHT = st.lists(
    st.tuples(*[st.sets(st.sampled_from(sorted(PLACES)))] * 2, st.integers(1, 120)), min_size=1, max_size=6
)


@given(SIGHT)
@example([(set(), {"1"}, 1), ({"2"}, set(), 1), ({"1", "2"}, {"1"}, 1)])
@example([({"2"}, {"1"}, 1), ({"1", "2"}, {"1"}, 1)])
@example([(set(), {"1", "2"}, 1), (set(), set(), 12), ({"1"}, {"2", "3"}, 1)])
def test_both_views_follow_one_person_and_neither_comes_first(sight):
    """Sensors in one place see the same people, as far as they see them."""
    at = {name: still(*place) for name, place in PLACES.items()}
    frames = [
        tuple({name: at[name] for name in sorted(of)} for of in (a, b)) for a, b, n in sight for _ in range(n)
    ]
    chosen = ids_of_both(frames, RigidTransform.identity())
    crowd = next((k for k, sides in enumerate(frames) if max(map(len, sides)) > 1), len(frames))
    assert all(a == b for a, b in chosen[crowd:] if None not in (a, b))
    assert [
        pair[::-1] for pair in ids_of_both([sides[::-1] for sides in frames], RigidTransform.identity())
    ] == chosen


@pytest.mark.parametrize("side", [0, 1])
def test_a_child_is_told_by_the_bones_in_either_view(side):
    beside = {"2": still(2.5, 3.0)}
    both, child = {"1": still(0.0), **beside}, {"9": still(0.2, scale=0.6), **beside}
    back = [({}, child), (child, {})][side]
    chosen = ids_of_both(
        [(both, both)] * 60 + [(beside, beside)] * 120 + [back] * 5, RigidTransform.identity()
    )
    assert chosen == [("1", "1")] * 60 + [(None, None)] * 125


@KNOWN
def test_who_comes_back_first_is_not_taken_if_all_were_away_for_seconds(a_from_b):
    crowd, therapist_only = {"1": still(0.0), "2": still(1.5)}, {"2": still(1.5)}
    frames = [crowd] * 60 + [{}] * 180 + [therapist_only] * 30 + [crowd] * 5
    assert ids_of_a(frames, a_from_b) == ["1"] * 60 + [None] * 210 + ["1"] * 5


def test_after_a_clock_reset_the_placement_is_found_and_the_others_end():
    a, b = (with_ids(view, np.random.default_rng(0)) for view in treated())
    frames = list(zip(a, b, strict=True))
    late = [tuple(replace(of, time_ns=of.time_ns + 3600 * 10**9) for of in pair) for pair in frames[:40]]
    assert np.mean([b is not None for _, b in live(late + frames, None)[0][-60:]]) > 0.9
    alone = {"1": still(0.0)}
    times = [(9000 + k) * FRAME_NS for k in range(60)] + [k * FRAME_NS for k in range(90)]
    frames = [
        (SensorFrame(time_ns, breathing(TWO if k < 60 else alone, time_ns)), SensorFrame(time_ns))
        for k, time_ns in enumerate(times)
    ]
    _, events = live(frames, None, AZURE_KINECT)
    assert [event.phase for event in events if event.topic == "others"] == ["start", "end"]


@pytest.mark.parametrize("side", [0, 1])
def test_who_was_beside_the_person_is_no_newcomer_when_the_other_view_sees_them_later(side):
    one, two = {"1": still(0.0)}, {"1": still(0.0), "2": still(1.5)}
    off, near = {"2": still(1.85)}, {"2": still(1.75)}  # at first too far from where the other view has them
    sides = [(one, two)] * 60 + [(off, {"2": still(1.5)})] * 5 + [(near, {"2": still(1.5)})] * 200
    chosen = ids_of_both([pair[::-1] if side else pair for pair in sides], RigidTransform.identity())
    assert set(chosen[60:]) == {(None, None)}


@KNOWN
@pytest.mark.parametrize(("away_s", "newcomer"), [(30, False), (70, True)])
def test_who_was_there_a_minute_ago_is_no_newcomer_in_a_crowd(away_s, newcomer, a_from_b):
    one, two, three = {"1": still(0.0)}, {"2": still(2.5)}, {"3": still(-2.5)}
    passes = [one | three | {"4": still(0.0, 5.0, scale=0.5)}]  # then people are forgotten
    frames = [one | two | three] * 30 + [one | three] * (30 * away_s) + passes + [three] * 75
    frames += [two | three] * 5
    assert ids_of_a(frames, a_from_b)[-1] == ("2" if newcomer else None)


# --- The person given is one in both views, live and recorded, and a moved sensor is no other person.


BODY = KINECT_V2
COUNT = 360
BODIES = [moving(BODY, COUNT, seed) for seed in range(3)]
B_FROM_A = A_FROM_B.inverse()


def walker(k, place=(0.0, 0.0, 0.0), who=0):
    """Somebody who walks to and fro about a place."""
    to_and_fro = (0.4 * np.sin(0.05 * k + who), 0.0, 0.3 * np.cos(0.03 * k + 2 * who))
    k = k % (2 * COUNT)
    return BODIES[who][min(k, 2 * COUNT - 1 - k)] + place + np.array(to_and_fro)


def frame_of(k, side, people, b_from_a=B_FROM_A):
    """What a sensor sees of (id, joints in K_A's frame)."""
    rng, t = np.random.default_rng(2 * k + side), k * FRAME_NS
    seen = {}
    for name, at in people:
        at = b_from_a.apply(at) if side else at
        seen[name] = Skeleton.of(BODY, at + rng.normal(0.0, 0.01, at.shape), None, t)
    return SensorFrame(t, seen)


def image_of(at):
    """Somebody in a mirror."""
    return (at * (1.0, 1.0, -1.0) + (0.0, 0.0, 8.0))[BODY.mirror]


def followed_recorded(frames):
    """The same of a recording: the positions."""
    reads = []
    for side, of in zip("ab", zip(*frames, strict=True), strict=True):
        people, none = RecordedPeople.of(BODY, of), np.zeros((0, 2), np.int64)
        reads.append(OneRecording(side, people, None, [], none, people.skeletons, None, f"person_{side}"))
    views = [read.person for read in follow_one_person(tuple(reads), Clock(), "longest")[:2]]
    return [
        [view.positions[k] if view.states[k].any() else None for view in views] for k in range(len(frames))
    ]


def who_is(frames, seen, names):
    """Of each frame and view: who is followed; None for nobody. ``names``: of each frame and view, by id."""
    found = []
    for of, picks, called in zip(frames, seen, names, strict=True):
        row = []
        for frame, pick, each in zip(of, picks, called, strict=True):
            at = getattr(pick, "positions", pick)
            ids = (
                []
                if at is None
                else [n for n, p in frame.people.items() if np.array_equal(p.positions, at, equal_nan=True)]
            )
            row.append(each[ids[0]] if ids else None)
        found.append(tuple(row))
    return found


HIDDEN = st.tuples(st.integers(0, 2), st.integers(0, 1), st.integers(60, 240), st.integers(3, 100))
"""Who is hidden from which view, from when on, and for how many frames."""


@COSTLY
@given(
    st.integers(1, 3),
    st.floats(0.0, 6.28),
    st.floats(1.1, 1.6),
    st.lists(HIDDEN, max_size=4),
    st.one_of(st.none(), st.tuples(st.integers(0, 1), st.integers(60, 100), st.integers(60, 200))),
    st.sampled_from(["kept", "renewed", "exchanged"]),
    st.booleans(),
    st.booleans(),
)
def test_who_is_followed_is_one_person_in_both_views_live_and_recorded(
    count, angle, far, hidden, elsewhere, ids_are, one_each, mirror
):
    """Args of the scene: ``elsewhere`` is when a view does not see the first person, ``ids_are`` what the
    tracker does with ids, ``one_each`` whether it gives one person, the first whom it sees, and ``mirror``
    whether A sees the first person's mirror image, too."""
    turns = [angle + k * np.pi / 2 for k in range(count - 1)]
    places = [np.zeros(3), *(far * np.array((np.cos(a), 0.0, np.sin(a))) for a in turns)]
    spans = [(who, side, range(begin, begin + n)) for who, side, begin, n in hidden]
    if elsewhere is not None:
        side, begin, n = elsewhere
        spans.append((0, side, range(begin, begin + n)))
    frames, names, rng, order = [], [], np.random.default_rng(round(1e6 * far)), np.arange(count)
    for k in range(COUNT):
        sides, called = [], []
        for side in (0, 1):
            gone = {who for who, of, span in spans if of == side and k in span}
            seen = [who for who in range(count) if who not in gone][: 1 if one_each else None]
            ids = ["1" if one_each else str(who) for who in seen]
            if ids_are == "renewed":
                ids = [str(k // 50 + 10 * who) for who in seen]
            elif ids_are == "exchanged":
                order = rng.permutation(count) if rng.random() < 0.05 else order
                seen = [who for who in order if who in seen]
                ids = [str(order[who]) for who in seen]
            people = [(i, walker(k, places[who], who)) for i, who in zip(ids, seen, strict=True)]
            if mirror and not side and not one_each:
                people.append(("77", image_of(walker(k, places[0]))))
            sides.append(frame_of(k, side, people))
            called.append({**dict(zip(ids, seen, strict=True)), "77": 77})
        frames.append(tuple(sides))
        names.append(tuple(called))
    follows = []
    for seen in (live(frames)[0], followed_recorded(frames)):
        found = who_is(frames, seen, names)
        (person,) = {who for pair in found for who in pair} - {None}
        there = np.array([[person in each.values() for each in called] for called in names])
        given = np.array([[who is not None for who in pair] for pair in found])
        assert given[there].mean() > 0.97
        follows.append((person, found))
    (live_person, online), (person, offline) = follows
    if live_person == person:
        assert np.mean([a == b for a, b in zip(online, offline, strict=True)]) > 0.97
    later = live(frames, lambda k: A_FROM_B if k >= 90 else None)[0]
    assert len({who for pair in who_is(frames, later, names)[120:] for who in pair} - {None}) <= 1


def both(k, b_from_a=B_FROM_A):
    return tuple(frame_of(k, side, [("1", walker(k))], b_from_a) for side in (0, 1))


MOVED = RigidTransform.of(Rotation.from_euler("y", 60.0, degrees=True).as_matrix(), (0.3, 0, 0)) @ B_FROM_A


def exchanged(frame, k, share):
    """The frame with left and right exchanged in a share of the time, as trackers see backs."""
    if k % 50 >= 50 * share:
        return frame
    people = {of: replace(at, positions=at.positions[BODY.mirror]) for of, at in frame.people.items()}
    return replace(frame, people=people)


@COSTLY
@given(
    st.sampled_from("xy"),
    st.floats(20.0, 75.0),
    st.floats(-1.0, 1.0),
    st.booleans(),
    st.booleans(),
    st.floats(0.0, 0.4),
)
def test_a_sensor_that_was_moved_is_found_within_5_s(axis, degrees, shift, follow_moves, beside, backs):
    """Its view is used on if it is registered anew, and left out otherwise; others are no hindrance."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    moved = RigidTransform.of(turn, (shift, 0.0, 0.0)) @ B_FROM_A
    far = min(
        np.linalg.norm(np.mean(A_FROM_B.apply(moved.apply(at)) - at, 0)) for at in map(walker, (60, 99))
    )
    frames = []
    for k in range(240):
        place = B_FROM_A if k < 60 else moved
        people = [("1", walker(k)), *([("2", walker(k, (-1.6, 0.0, 0.6), 1))] if beside else [])]
        frames.append((exchanged(frame_of(k, 0, people), k, backs), frame_of(k, 1, people, place)))
    seen, events = live(frames, follow_moves=follow_moves)
    called = [({"1": 1, "2": 2},) * 2] * len(frames)
    who = who_is(frames, seen, called)
    assert {a for a, _ in who} == {1}
    assert {b for _, b in who} <= {1, None}
    if far > 0.8:
        assert all(b == (1 if follow_moves else None) for _, b in who[-20:])
        assert follow_moves or "Calibrate again" in " ".join(event.text for event in events)


@given(st.integers(0, 600), st.floats(0.0, 0.4))
def test_a_mirror_image_is_no_person_before_a_sensor_that_was_moved(first, backs):
    at = range(first, first + 180, 3)
    p = np.array([walker(k) for k in at])
    image = np.array([image_of(walker(k)) for k in at])
    some = [k % 50 < 50 * backs for k in at]
    image[some] = image[some][:, BODY.mirror]
    assert one_movement(BODY, p, MOVED.apply(image.reshape(-1, 3)).reshape(p.shape)) is None


@pytest.mark.parametrize("follow_moves", [True, False])
def test_a_view_that_is_registered_anew_is_used_alone(follow_moves):
    frames = [both(k) for k in range(60)] + [both(k, MOVED) for k in range(60, 200)]
    frames += [(frame_of(k, 0, []), both(k, MOVED)[1]) for k in range(200, 560)]
    seen, _ = live(frames, follow_moves=follow_moves)
    assert all((b is not None) is follow_moves for _, b in seen[200:])


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_one_person_is_followed_whatever_each_view_misses_from_the_first_frame_on(there):
    frames = [
        tuple(frame_of(k, side, [("1", walker(k))] if seen else []) for side, seen in enumerate(each))
        for k, each in enumerate(there)
    ]
    seen, events = live(frames)
    assert [tuple(at is not None for at in each) for each in seen] == there
    assert events == []


def elsewhere(k, who=1):
    return frame_of(k, 0, [("1", walker(k))]), frame_of(k, 1, [("1", walker(k, (1.5, 0.0, 0.5), who))])


@pytest.mark.parametrize("who", [0, 1])
def test_a_view_that_sees_only_somebody_else_is_told_within_a_second(who):
    """Also where both stand and move alike, but for their walk."""
    _, events = live(
        [*map(both, range(60)), *(elsewhere(k, who) for k in range(60, 120)), *map(both, range(120, 260))]
    )
    told = [event for event in events if event.topic == "others"]
    assert [event.phase for event in told] == ["start", "end"]
    assert "The one followed is '1' of A. B sees somebody else" in told[0].text


def test_who_is_alone_in_the_other_view_is_taken_after_ten_seconds():
    frames = [*map(both, range(30)), *map(elsewhere, range(30, 60))]
    frames += [(frame_of(k, 0, []), elsewhere(k)[1]) for k in range(60, 460)]
    seen, events = live(frames)
    assert not any(b for _, b in seen[30:358])
    assert all(b for _, b in seen[-60:])
    assert sum("another one is followed" in event.text for event in events) == 1


@given(st.integers(0, 60), st.integers(1, 90), st.booleans())
def test_a_skeleton_that_is_repeated_for_more_than_a_second_is_nobody(begin, repeated, one_view):
    frames = [both(k) for k in range(begin + 1)]
    a, b = frames[-1]
    for k in range(begin + 1, begin + 1 + repeated):
        t = k * FRAME_NS
        fresh = both(k)[0] if one_view else replace(a, time_ns=t)
        frames.append((fresh, replace(b, time_ns=t)))
    frames += [both(k) for k in range(begin + 1 + repeated, begin + 4 + repeated)]
    stale = [False] * (begin + 1) + [k * FRAME_NS > 1e9 for k in range(1, repeated + 1)] + [False] * 3
    for seen in (live(frames)[0], followed_recorded(frames)):
        assert [b is None for _, b in seen] == stale
        assert [a is None for a, _ in seen] == [not one_view and of for of in stale]


def test_two_people_who_hide_each_other_for_half_a_second_stay_two():
    """Seen apart for 3 s; then each view sees only one of them, both in nearly one place."""
    frames, names = [], []
    for k in range(200):
        away = max(0.2, 1.5 - 0.015 * max(0, k - 15))
        people = [("0", walker(k)), ("1", walker(k) + (away, 0.0, 0.0))]
        hide = 100 <= k < 115
        frames.append((frame_of(k, 0, people[:1] if hide else people), frame_of(k, 1, people[hide:])))
        names.append(({"0": 0, "1": 1},) * 2)
    for seen in (live(frames)[0], followed_recorded(frames)):
        assert len({who for pair in who_is(frames, seen, names) for who in pair} - {None}) == 1


def test_a_child_who_comes_alone_after_a_helper_is_followed_after_two_seconds():
    child = walker(0).mean(axis=0)
    frames = list(map(both, range(60)))
    frames += [tuple(frame_of(k, side, []) for side in (0, 1)) for k in range(60, 90)]
    small = [child + 0.65 * (walker(k) - child) for k in range(90, 160)]
    frames += [tuple(frame_of(k, v, [("2", at)]) for v in (0, 1)) for k, at in enumerate(small, 90)]
    seen, _ = live(frames)
    assert all(a is None for a, _ in seen[90:120])
    assert all(a is not None and b is not None for a, b in seen[125:])


@given(st.floats(-0.5, 0.5))
@example(0.2)
def test_who_was_beside_the_person_is_not_followed_later_whenever_the_frames_are(off):
    """B's frames are so many intervals later: it sees the other one first while A sees the person."""
    off_ns, frames = round(off * FRAME_NS), []
    for k in range(270):
        one, other = ("1", walker(k)), ("2", walker(k, (1.6, 0.0, 0.6), 1))
        a, b = frame_of(k, 0, [one if k < 150 else other]), frame_of(k, 1, [one if k < 90 else other])
        frames.append((a, replace(b, time_ns=b.time_ns + off_ns)))
    called = [({"1": 1, "2": 2},) * 2] * len(frames)
    assert who_is(frames, followed_recorded(frames), called)[:150] == [(None, None)] * 90 + [(None, 2)] * 60


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_mirror_image_that_was_seen_first_is_left_for_the_person(every):
    """Also where B has fewer frames than A."""
    people, chosen = PersonOfPair(BODY), []
    for k in range(240):
        seen = [("1", walker(k))] if k >= 60 else []
        a, b = frame_of(k, 0, [("77", image_of(walker(k))), *seen]), frame_of(k, 1, seen)
        b = None if k % every else b
        one = people.chosen(FramePair(a, b, SkeletonPair(None, None, a.time_ns, 0)), A_FROM_B).skeletons.a
        chosen.append(one is a.people.get("1") is not None)
    assert not any(chosen[:60])
    assert all(chosen[-60:])


def test_a_child_who_comes_after_the_person_is_followed_after_two_seconds_in_a_recording():
    """Somebody else is in view at first. A recording of one person at a time takes the next one at once."""
    frames, child = [], walker(0).mean(axis=0)
    for k in range(270):
        seen = [("1", walker(k))] if k < 150 else []
        seen += [("3", walker(k, (1.6, 0.0, 0.6), 1))] if k < 20 else []
        seen += [("2", child + 0.65 * (walker(k) - child))] if k >= 190 else []
        frames.append((frame_of(k, 0, seen), frame_of(k, 1, seen)))
    found = who_is(frames, followed_recorded(frames), [({"1": 1, "2": 2, "3": 3},) * 2] * len(frames))
    assert found == [(1, 1)] * 150 + [(None, None)] * 60 + [(2, 2)] * 60
