"""One person is followed live among others, whatever ids the trackers give them."""

from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from devices.frame_pairs import FramePair
from devices.people import following
from devices.people.following import PersonOfPair
from devices.people.placement import Placement
from devices.sensor import SensorFrame
from devices.simulated.demonstration import therapist
from devices.simulated.kinect import PERSON, Beside, simulated_pair
from devices.simulated.person.gait import walking
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_people import THERAPIST, two_people, with_ids
from tests.helpers.two_views import standing

FRAME_NS = 33_333_333
AROUND = Beside(walking("walk", length=12.0, strides=14), (0.6, 0.0, 0.4), later=2.5)
"""Walks round the person, between them and each sensor, half a metre to two away."""


def pair_of(a, b=None):
    b = SensorFrame(a.time_ns) if b is None else b
    return FramePair(a, b, SkeletonPair(None, None, a.time_ns, b.time_ns - a.time_ns))


def followed(a, b, a_from_b=None):
    """Of each frame: the skeletons of the person followed; and the events."""
    people, seen, events = PersonOfPair(a[0].people[next(iter(a[0].people))].body), [], []
    for pair in map(pair_of, a, b):
        skeletons = people.chosen(pair, a_from_b).skeletons
        seen.append((skeletons.a, skeletons.b))
        events += people.learn()
    return seen, events


@cache
def treated(seconds=8.0):
    return two_people(("squat", THERAPIST), 0, seconds)


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
    seen, events = followed(*frames, a_from_b if known else None)
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


def names(frames, a_from_b=None, follow="middle"):
    """Of each frame of A, whom it follows, where B sees nobody."""
    people = PersonOfPair(AZURE_KINECT, follow)
    chosen = []
    for frame in frames:
        frame = replace(frame, people=breathing(frame.people, frame.time_ns))
        one = people.chosen(pair_of(frame), a_from_b).skeletons.a
        chosen.append(next((name for name, person in frame.people.items() if person is one), None))
    return chosen, people.learn()


def at_rate(*people, first=0):
    return [SensorFrame((first + k) * FRAME_NS, each) for k, each in enumerate(people)]


KNOWN = pytest.mark.parametrize("a_from_b", [None, RigidTransform.identity()], ids=["unknown", "known"])


@KNOWN
@pytest.mark.parametrize(("nearer_the_axis", "chosen"), [(0.06, "1"), (0.1, "2")])
def test_the_first_choice_is_nearest_to_the_middle_of_the_view(nearer_the_axis, chosen, a_from_b):
    """Of two at 2 and 4 m; the 2 m count as 0.08 radians."""
    two = {"1": still(2.0 * np.tan(0.2), 2.0), "2": still(-4.0 * np.tan(0.2 - nearer_the_axis), 4.0)}
    assert names(at_rate(two), a_from_b)[0] == [chosen]


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
        people.chosen(pair_of(frame, frame))
        people.learn()
    assert (people._search.found is not None) == found


@KNOWN
def test_a_stranger_is_not_taken_while_the_person_is_out_of_sight(a_from_b):
    stranger = {"2": still(2.5)}
    frames = [{"1": still(0.0), **stranger}] + [stranger] * 100 + [{"7": still(0.1), **stranger}]
    assert names(at_rate(*frames), a_from_b)[0] == ["1", *[None] * 100, "7"]


@pytest.mark.parametrize(("follow", "next_one"), [("middle", "3"), ("longest", "2")])
def test_when_the_person_is_gone_the_one_in_the_middle_or_seen_longest_is_next(follow, next_one):
    one, two, three = {"1": still(0.0)}, {"2": still(2.5)}, {"3": still(0.8, 3.0)}
    frames = at_rate(*[one | two] * 60, *[one | two | three] * 30, *[two | three] * 310)
    assert names(frames, follow=follow)[0][-1] == next_one


@given(st.integers(1, 120), st.floats(0.0, 12.0))
@example(1, 0.7)  # a frame, 0.53 m at most
@example(59, 8.0)
@example(60, 8.6)
def test_a_lone_person_who_is_nearer_than_a_running_one_gets_is_followed_on(later, metres):
    """At 4 m/s and 0.4 m; after two seconds, or where a clock is reset, they may be anywhere."""
    seconds = later * FRAME_NS * 1e-9
    assume(abs(metres - 0.4 - 4.0 * seconds) > 0.01)
    times = 0, later * FRAME_NS, -FRAME_NS
    people = {"1": still(0.0)}, {"2": still(metres)}, {"3": still(-5.0)}
    frames = [SensorFrame(1000 * FRAME_NS + t, of) for t, of in zip(times, people, strict=True)]
    taken = metres < 0.4 + 4.0 * seconds or seconds > 2.0
    assert names(frames)[0] == ["1", "2" if taken else None, "3"]


@pytest.mark.parametrize("people", [{}, {"1": still(0.0, states=0)}])
def test_nobody_and_bodies_without_a_position_are_no_choice(people):
    assert names(at_rate(people))[0] == [None]
    both = {**people, "2": still(0.0), "3": still(1.0)}
    assert names(at_rate(both, people))[0] == ["2", None]


def test_a_sensor_that_was_moved_splits_nobody():
    """The other sensor's people are half a metre off: the same skeletons are followed."""
    moved = RigidTransform.of(np.eye(3), (0.45, 0.0, 0.0))
    people = PersonOfPair(AZURE_KINECT)
    for k in range(120):
        crowd = breathing({"1": still(0.0), "2": still(1.5)}, k * FRAME_NS)
        frame = SensorFrame(k * FRAME_NS, crowd)
        known = RigidTransform.identity() if k < 30 else moved
        pair = people.chosen(pair_of(frame, frame), known)
        assert pair.skeletons.a is pair.skeletons.b is crowd["1"]


@pytest.mark.parametrize(("off", "who", "wrong_b"), [(1.5, "2", "1"), (3.0, "1", None)])
def test_views_that_were_put_together_wrongly_are_put_right_in_a_third_of_a_second(off, who, wrong_b):
    """A placement that is off brings the wrong people of B to those of A, or nobody."""
    wrong = RigidTransform.of(np.eye(3), (off, 0.0, 0.0))
    people = PersonOfPair(AZURE_KINECT)
    for k in range(60):
        crowd = breathing({"1": still(0.0), "2": still(1.5)}, k * FRAME_NS)
        frame = SensorFrame(k * FRAME_NS, crowd)
        pair = people.chosen(pair_of(frame, frame), wrong if k < 30 else RigidTransform.identity())
        assert pair.skeletons.a is crowd[who]
        assert pair.skeletons.b is crowd.get(wrong_b if k < 30 else who) or 30 <= k < 40


def test_before_the_placement_is_known_two_who_come_back_are_told_apart_in_one_view_only():
    alone, crowd = {"1": still(0.0)}, {"1": still(0.0), "2": still(1.5)}
    back = {"8": still(1.4), "9": still(0.1)}
    people, seen = PersonOfPair(AZURE_KINECT), []
    for k, of in enumerate([*[alone] * 10, *[crowd] * 30, *[{}] * 45, *[back] * 5]):
        frame = SensorFrame(k * FRAME_NS, breathing(of, k * FRAME_NS))
        seen.append((frame, people.chosen(pair_of(frame, frame)).skeletons))
    assert all(pair.a is pair.b is not None for _, pair in seen[:40])
    assert all(pair.a is frame.people["9"] and pair.b is None for frame, pair in seen[-5:])


def ids_of_both(frames, a_from_b=None):
    """Of each frame: whom A and B follow, where (A's people, B's people) are given."""
    people, chosen = PersonOfPair(AZURE_KINECT), []
    for k, sides in enumerate(frames):
        sides = tuple(breathing(of, k * FRAME_NS) for of in sides)
        a, b = (SensorFrame(k * FRAME_NS, of) for of in sides)
        pair = people.chosen(pair_of(a, b), a_from_b).skeletons
        chosen.append(
            tuple(
                next((name for name, person in of.items() if person is one), None)
                for of, one in zip(sides, (pair.a, pair.b), strict=True)
            )
        )
    return chosen


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
    chosen, _ = names(at_rate(*frames), a_from_b)
    assert chosen == ["1"] * 60 + [None] * 210 + ["1"] * 5


def test_after_a_clock_reset_the_placement_is_found_and_the_others_end():
    views, _ = treated()
    a, b = (with_ids(view, np.random.default_rng(0)) for view in views)
    people, found = PersonOfPair(KINECT_V2), []
    for later, count in ((3600 * 10**9, 40), (0, len(a))):
        for one, other in list(zip(a, b, strict=True))[:count]:
            moved = (replace(frame, time_ns=frame.time_ns + later) for frame in (one, other))
            found.append(people.chosen(pair_of(*moved)).skeletons.b is not None)
            people.learn()
    assert np.mean(found[-60:]) > 0.9
    crowd, people, events = {"1": still(0.0), "2": still(1.5)}, PersonOfPair(AZURE_KINECT), []
    for frame in at_rate(*[crowd] * 60, first=9000) + at_rate(*[{"1": still(0.0)}] * 90):
        people.chosen(pair_of(replace(frame, people=breathing(frame.people, frame.time_ns))))
        events += people.learn()
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
    assert names(at_rate(*frames), a_from_b)[0][-1] == ("2" if newcomer else None)
