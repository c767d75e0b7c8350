"""Two views of different people are never fused, and a sensor that was moved is no other person."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.frame_pairs import FramePair
from devices.people.following import PersonOfPair
from devices.sensor import SensorFrame
from fusion.body import KINECT_V2 as BODY
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

FRAMES = moving(BODY, 300)
B_FROM_A = A_FROM_B.inverse()
ids = st.sampled_from(("1", "2"))


def walker(k, place=(0.0, 0.0, 0.0), phase=0.0):
    """Somebody who walks to and fro about a place."""
    return FRAMES[k % 300] + place + np.array((0.5 * np.sin(0.05 * k + phase), 0.0, 0.3 * np.cos(0.03 * k)))


def pair_of(k, a, b, id_b="1", b_from_a=B_FROM_A):
    """What the sensors see of these bodies, which are in K_A's frame; None for nobody."""
    t = k * FRAME_NS
    frames = []
    for name, at in (("1", a), (id_b, None if b is None else b_from_a.apply(b))):
        noise = np.random.default_rng(2 * k + len(frames)).normal(0.0, 0.01, (len(BODY), 3))
        people = {} if at is None else {name: Skeleton.of(BODY, at + noise, None, t)}
        frames.append(SensorFrame(t, people))
    return FramePair(*frames, SkeletonPair(None, None, t, 0))


def exchanged(pair):
    return replace(pair, a=pair.b, b=pair.a)


def chosen(pairs, swap=False, **options):
    """Of each pair: whether A and B are followed; and the events."""
    people, seen, events = PersonOfPair(BODY, **options), [], []
    for pair in pairs:
        known = B_FROM_A if swap else A_FROM_B
        of = people.chosen(exchanged(pair) if swap else pair, known).skeletons
        seen.append((of.b is not None, of.a is not None) if swap else (of.a is not None, of.b is not None))
        events += people.learn()
    return seen, events


@COSTLY
@given(st.floats(0.8, 3.0), st.floats(0.0, 6.28), ids, st.integers(0, 40), st.booleans(), st.booleans())
def test_a_view_that_sees_only_somebody_else_counts_as_empty(far, angle, id_b, hidden, same_walk, swap):
    place = far * np.array((np.cos(angle), 0.0, np.sin(angle)))
    phase = 0.0 if same_walk else 2.0
    pairs = [pair_of(k, walker(k), walker(k)) for k in range(30)]
    pairs += [pair_of(k, walker(k), None) for k in range(30, 30 + hidden)]
    between = range(30 + hidden, 200)
    other = [FRAMES[k] + place if same_walk else walker(3 * k, place, phase) for k in between]
    pairs += [pair_of(k, walker(k), at, id_b) for k, at in zip(between, other, strict=True)]
    pairs += [pair_of(k, walker(k), walker(k)) for k in range(200, 300)]  # a jump is waited out for 2 s
    seen, events = chosen(pairs, swap)
    near = [
        k for k, at in zip(between, other, strict=True)
        if np.linalg.norm((at - walker(k))[:1]) < 0.95
    ]  # fmt: skip
    assert all(a for a, _ in seen)
    assert not any(b for k, (_, b) in enumerate(seen[30 + hidden : 200], 30 + hidden) if k not in near)
    assert all(b for _, b in seen[-20:])
    assert ("sees somebody else" in " ".join(event.text for event in events)) or near


@given(st.floats(20.0, 90.0), st.floats(-1.0, 1.0), st.booleans())
def test_a_sensor_that_was_moved_is_followed_within_5_s_or_left_out(degrees, shift, follow_moves):
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    moved = RigidTransform.of(turn, (shift, 0.0, 0.0)) @ B_FROM_A
    pairs = [pair_of(k, walker(k), walker(k)) for k in range(60)]
    pairs += [pair_of(k, walker(k), walker(k), b_from_a=moved) for k in range(60, 240)]
    seen, events = chosen(pairs, follow_moves=follow_moves)
    assert all(a for a, _ in seen)
    far = np.linalg.norm(A_FROM_B.apply(moved.apply(walker(100)[:1])) - walker(100)[:1]) > 1.2
    if far:
        assert all(b is follow_moves for _, b in seen[-20:])
        assert follow_moves or "Calibrate again" in " ".join(event.text for event in events)


def test_who_is_alone_in_the_other_view_is_not_taken_for_a_while():
    pairs = [pair_of(k, walker(k), walker(k)) for k in range(30)]
    pairs += [pair_of(k, walker(k), walker(k, (1.5, 0.0, 0.0))) for k in range(30, 60)]
    pairs += [pair_of(k, None, walker(k, (1.5, 0.0, 0.0))) for k in range(60, 460)]
    seen, _ = chosen(pairs)
    assert not any(b for _, b in seen[30:350])
    assert all(b for _, b in seen[-60:])


MOVED = (
    RigidTransform.of(Rotation.from_euler("y", 60.0, degrees=True).as_matrix(), (0.3, 0.0, 0.0)) @ B_FROM_A
)
BEFORE = [pair_of(k, walker(k), walker(k)) for k in range(60)]
AFTER = [pair_of(k, walker(k), walker(k), b_from_a=MOVED) for k in range(60, 200)]


@pytest.mark.parametrize("follow_moves", [True, False])
def test_before_a_sensor_that_was_moved_there_is_one_person(follow_moves):
    """B's view is used when A loses the person, if it is registered anew; else never again."""
    gone = [pair_of(k, None, walker(k), b_from_a=MOVED) for k in range(200, 560)]
    seen, events = chosen([*BEFORE, *AFTER, *gone], follow_moves=follow_moves)
    assert all(b is follow_moves for _, b in seen[200:])
    assert "Both sensors" not in " ".join(event.text for event in events)


def test_a_method_that_follows_no_move_leaves_out_no_view():
    seen, events = chosen([*BEFORE, *AFTER], follow_moves=None)
    assert all(a and b for a, b in seen[:60])
    assert not any(event.topic == "elsewhere" for event in events)


def test_who_is_elsewhere_ends_when_several_people_come_or_time_begins_anew():
    place = np.array((1.5, 0.0, 0.0))
    apart = [pair_of(k, walker(k), walker(k, place)) for k in range(30)]
    crowd = pair_of(30, walker(30), walker(30))
    crowd = replace(crowd, a=replace(crowd.a, people={**crowd.a.people, "2": crowd.b.people["1"]}))
    for following in (crowd, pair_of(0, walker(0), walker(0))):
        _, events = chosen([*BEFORE[:1], *apart[1:], following])
        assert [event.phase for event in events if event.topic == "elsewhere"] == ["start", "end"]
