"""The person given is one in both views, live and recorded, and a moved sensor is no other person."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.frame_pairs import FramePair
from devices.people.following import PersonOfPair
from devices.people.recorded_people import OneRecording, RecordedPeople
from devices.people.recorded_person import follow_one_person
from devices.sensor import SensorFrame
from fusion.body import KINECT_V2 as BODY
from fusion.clocks import Clock
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

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


def live(frames, a_from_b=A_FROM_B, at=None, **options):
    """Of each pair: the skeletons followed in A and B; and the events.

    ``at``: a frame, and the placement from then on.
    """
    people, seen, events = PersonOfPair(BODY, **options), [], []
    for k, (a, b) in enumerate(frames):
        a_from_b = a_from_b if at is None or k < at[0] else at[1]
        pair = FramePair(a, b, SkeletonPair(None, None, a.time_ns, 0))
        skeletons = people.chosen(pair, a_from_b).skeletons
        seen.append((skeletons.a, skeletons.b))
        events += people.learn()
    return seen, events


def recorded(frames):
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
    for seen in (live(frames)[0], recorded(frames)):
        found = who_is(frames, seen, names)
        (person,) = {who for pair in found for who in pair} - {None}
        there = np.array([[person in each.values() for each in called] for called in names])
        given = np.array([[who is not None for who in pair] for pair in found])
        assert given[there].mean() > 0.97
        follows.append((person, found))
    (live_person, online), (person, offline) = follows
    if live_person == person:
        assert np.mean([a == b for a, b in zip(online, offline, strict=True)]) > 0.97
    later = live(frames, None, at=(90, A_FROM_B))[0]
    assert len({who for pair in who_is(frames, later, names)[120:] for who in pair} - {None}) <= 1


def both(k, b_from_a=B_FROM_A):
    return tuple(frame_of(k, side, [("1", walker(k))], b_from_a) for side in (0, 1))


MOVED = RigidTransform.of(Rotation.from_euler("y", 60.0, degrees=True).as_matrix(), (0.3, 0, 0)) @ B_FROM_A


@COSTLY
@given(st.floats(20.0, 75.0), st.floats(-1.0, 1.0), st.booleans(), st.booleans())
def test_a_sensor_that_was_moved_is_found_within_5_s(degrees, shift, follow_moves, beside):
    """Its view is used on if it is registered anew, and left out otherwise; others are no hindrance."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    moved = RigidTransform.of(turn, (shift, 0.0, 0.0)) @ B_FROM_A
    far = min(
        np.linalg.norm(np.mean(A_FROM_B.apply(moved.apply(at)) - at, 0)) for at in map(walker, (60, 99))
    )
    frames = []
    for k in range(240):
        place = B_FROM_A if k < 60 else moved
        people = [("1", walker(k)), *([("2", walker(k, (-1.6, 0.0, 0.6), 1))] if beside else [])]
        frames.append((frame_of(k, 0, people), frame_of(k, 1, people, place)))
    seen, events = live(frames, follow_moves=follow_moves)
    called = [({"1": 1, "2": 2},) * 2] * len(frames)
    who = who_is(frames, seen, called)
    assert {a for a, _ in who} == {1}
    assert {b for _, b in who} <= {1, None}
    if far > 0.8:
        assert all(b == (1 if follow_moves else None) for _, b in who[-20:])
        assert follow_moves or "Calibrate again" in " ".join(event.text for event in events)


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
    for seen in (live(frames)[0], recorded(frames)):
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
    for seen in (live(frames)[0], recorded(frames)):
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
    assert who_is(frames, recorded(frames), called)[:150] == [(None, None)] * 90 + [(None, 2)] * 60


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
    found = who_is(frames, recorded(frames), [({"1": 1, "2": 2, "3": 3},) * 2] * len(frames))
    assert found == [(1, 1)] * 150 + [(None, None)] * 60 + [(2, 2)] * 60
