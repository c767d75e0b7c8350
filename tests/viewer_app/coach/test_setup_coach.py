"""The coach's advice over time. Time is that of the pairs."""

import itertools
import re
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.depth.camera import in_image, project
from devices.findings.finding import Finding, followed, judge
from devices.findings.rules import AIM, RING, RULES, WALK, farthest, nearest, within
from devices.sensor import SensorFrame
from devices.simulated.demonstration import demonstrated, good_rig, therapist
from devices.simulated.kinect import Scene, SimulatedKinect
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, TrackingState, nearer
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.floor import LEVEL_FLOOR, floor_frame, height_of
from recordings.appearance.state_card import State, fits
from recordings.data.session_arrays import SessionFrame
from recordings.fusing.pairs import fuse_one
from recordings.live_fusion import LiveFusion
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pair
from tests.helpers.laws import COSTLY, person
from tests.helpers.sentences import arguments, check_sentences
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibrated_on, pair_of, standing, turned_around
from viewer_app.coach.readiness import LASTS, Headline, Readiness, headline, to_markdown
from viewer_app.coach.scene import CoachScene, places
from viewer_app.coach.setup_coach import HOLD, Coach, Situation
from viewer_app.coach.standing_spot import ARM, standing_spot
from viewer_app.viewer.blueprint import overview


@dataclass(frozen=True)
class SetUp:
    """Where the sensors stand, and what is wrong."""

    rig: Rig
    mirrored_b: bool = False
    someone_else: bool = False
    motion: str = "walk"


SET_UPS = {
    "good": SetUp(good_rig(AZURE_KINECT)),
    "feet out of view": SetUp(Rig(distance=2.6, height=1.6, tilt_deg=-14.0)),
    "mirrored B": SetUp(good_rig(AZURE_KINECT), mirrored_b=True),
    "someone else": SetUp(good_rig(AZURE_KINECT), someone_else=True),
}


@dataclass(frozen=True)
class Moment:
    """One frame and what the coach says with it."""

    seconds: float
    setup: FusionSetup
    frame: SessionFrame
    headline: Headline
    page: CoachPage


def moments(of: SetUp, seconds: float):
    """Yields the moments of a set-up, fused as the live loop does."""
    other = therapist() if of.someone_else else None
    scene = Scene(demonstrated(of.motion), AZURE_KINECT, seconds=seconds, other=other)
    a, b = (SimulatedKinect(scene, of.rig, which) for which in (0, 1))
    setup = FusionSetup(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    fusion, coach, readiness = LiveFusion(setup), Coach(AZURE_KINECT, setup.intrinsics), Readiness()
    drawings = CoachScene(AZURE_KINECT, setup.intrinsics)
    for one, other_view in zip(a.frames(), b.frames(), strict=True):
        seen_by_b = _mirrored(other_view) if of.mirrored_b else other_view
        skew_ns = other_view.time_ns - one.time_ns
        person = next(iter(one.people), "")
        pair = fusion.chosen(frame_pair(one, seen_by_b, person, one.time_ns, skew_ns))
        frame = fusion.fuse(pair)
        fusion.learn(frame)
        now = Situation(fusion.setup.calibration, fusion.calibrator.final, fusion.calibrator.held)
        time = pair.time_ns * 1e-9
        shown = readiness.watch(time, coach.watch(frame, now), now.calibration)
        page = drawings.page(readiness.findings, now, frame.fused, shown)
        yield Moment(time, fusion.setup, frame, shown, page)


def _mirrored(frame: SensorFrame) -> SensorFrame:
    people = {
        name: Skeleton.of(each.body, each.positions * (-1.0, 1.0, 1.0), each.states, each.time_ns)
        for name, each in frame.people.items()
    }
    return replace(frame, people=people)


BODY = KINECT_V2
CAMERA = NOMINAL_INTRINSICS[BODY.name]
KNOWN = Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")


def watched(
    truth=None,
    *,
    seconds=3.0,
    now=None,
    really=A_FROM_B,
    b=True,
    every=1,
    lost_feet=(),
    dropping=0,
    losing=0,
    b_gone=(np.inf, np.inf),
    b_other=False,
    origins=("sensor", "sensor"),
    frames=None,
    refined=False,
):
    """The findings after some seconds of unchanged frames; ``refined``: the calibration is, each second."""
    now = now or Situation(KNOWN, final=True, held=0.0)
    coach = Coach(BODY, (CAMERA, CAMERA), origins=origins)
    fuser, fused_first = Fuser(FusionSetup(now.calibration)), None
    joints = standing(BODY) if truth is None else truth
    found = []
    for k in range(0, round(seconds * 1e9 / FRAME_NS) + 1, every):
        time_ns = k * FRAME_NS
        seen = pair_of(BODY, joints, time_ns, really)
        people = []
        for shown, skeleton in ((True, seen.a), (b, seen.b)):
            if lost_feet:
                states = np.array(skeleton.states)
                states[[BODY.joint(f"ANKLE_{foot}") for foot in lost_feet]] = TrackingState.INFERRED
                skeleton = Skeleton.of(BODY, skeleton.positions, states, time_ns)
            people.append({"1": skeleton} if shown else {})
        from_b = None if b_gone[0] <= time_ns * 1e-9 < b_gone[1] else SensorFrame(time_ns, people[1])
        pair = frame_pair(SensorFrame(time_ns, people[0]), from_b, "1", time_ns)
        if b_other:  # B's only person is not the one followed
            pair = replace(pair, skeletons=replace(pair.skeletons, b=None))
        if refined and k % 30 == 0:
            now = replace(now, calibration=replace(now.calibration))
        drops = replace(now, dropped=(k * dropping, 0), lost=(0, k * losing))
        fused_first = fused_first or fuse_one(fuser, pair)  # nobody moves
        frame = replace(fused_first, pair=pair)
        found = coach.watch(frame, drops)
        if frames is not None:
            frames.append(frame)
    return found


@given(st.floats(0.0, 0.29), st.integers(2, 55))
def test_one_pause_is_no_lower_rate(pause_s, after):
    """Also where both sensors paused: what comes back at its rate has it."""
    coach, joints = Coach(BODY, (CAMERA, CAMERA)), standing(BODY)
    fused, found = None, []
    for k in range(60):
        time_ns = k * FRAME_NS + round(pause_s * 1e9) * (k >= after)
        seen = pair_of(BODY, joints, time_ns, A_FROM_B)
        frames = (SensorFrame(time_ns, {"1": of}) for of in (seen.a, seen.b))
        pair = frame_pair(*frames, "1", time_ns)
        fused = fused or fuse_one(Fuser(FusionSetup(KNOWN)), pair)
        found += coach.watch(replace(fused, pair=pair), Situation(KNOWN, final=True, held=0.0))
    assert "rate" not in {each.rule for each in found}


def test_depth_errors_that_a_calibration_states_are_no_distance_of_the_views():
    far, rules = 0.08, []
    seen = pair_of(BODY, standing(BODY), 0, A_FROM_B)
    views = [nearer(of.positions, -far) for of in (seen.a, seen.b)]
    for errors in ((0.0, 0.0), (far, far)):
        coach, fused = Coach(BODY, (CAMERA, CAMERA)), None
        now = Situation(replace(KNOWN, depth_errors=np.array(errors)), final=True, held=0.0)
        for time_ns in range(0, 3 * 10**9, FRAME_NS):
            people = (Skeleton.of(BODY, at, None, time_ns) for at in views)
            pair = frame_pair(*(SensorFrame(time_ns, {"1": person}) for person in people), "1", time_ns)
            fused = fused or fuse_one(Fuser(FusionSetup(KNOWN)), pair)
            found = coach.watch(replace(fused, pair=pair), now)
        rules.append({each.rule for each in found} & {"views", "moved"})
    assert rules[0]
    assert not rules[1]


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=12), st.booleans())
def test_sensors_are_aimed_at_one_place_if_both_see_somebody_but_never_at_once(seen, final):
    """A second each; who is not seen by either is asked before a sensor if the views overlap."""
    coach, found = Coach(BODY, (CAMERA, CAMERA)), []
    fuser = Fuser(FusionSetup(KNOWN))
    for k, time_ns in enumerate(range(0, len(seen) * 10**9, 10**9 // 10)):
        both = pair_of(BODY, standing(BODY), time_ns)
        views = [
            {"1": of} if there else {} for of, there in zip((both.a, both.b), seen[k // 10], strict=True)
        ]
        pair = frame_pair(*(SensorFrame(time_ns, view) for view in views), "1", time_ns)
        found = coach.watch(fuse_one(fuser, pair), replace(NOT_PLACED, final=final))
    told = {each.rule: each.step for each in found}
    later = len(seen) - next((k for k, both in enumerate(seen[::-1]) if all(both)), len(seen))
    apart = all(map(any, zip((False, False), *seen[later:], strict=True)))
    assume(later == 0 or len(seen) - later != 4)  # seconds since both saw somebody: the border
    apart &= (later == 0 or len(seen) - later > 4) and not final  # then there is a ring
    assert (told.get("unseen_together") == AIM) == apart
    assert not (apart and "unseen" in told)


NOT_PLACED = Situation(replace(KNOWN, provisional=True), final=False, held=0.0)
"""So that nobody is asked into the ring."""


@pytest.mark.parametrize("way", [(-45.0, 0.0), (45.0, 0.0), (0.0, -25.0), (0.0, 40.0)], ids=str)
@COSTLY
@given(st.floats(0.9, 1.0))
def test_a_sensor_that_is_turned_as_told_has_the_whole_person_in_its_image(way, share):
    """A person before sensor A who is beyond an edge of its image, by degrees from its middle."""
    aside, down = share * way[0], share * way[1]

    def person_at(aside, down):
        joints = standing(BODY)
        joints = joints - joints.mean(axis=0) + (0.0, 0.0, 3.4)
        return Rotation.from_euler("xy", (-down, aside), degrees=True).apply(joints)

    for _ in range(4):  # one direction with each step
        joints = person_at(aside, down)
        found = watched(joints, seconds=2.0, every=5, now=NOT_PLACED, b=False)
        told = next((of.step for of in found if of.side == "A" and of.rule in ("feet", "whole")), None)
        if told is None:
            assert in_image(CAMERA, project(CAMERA, joints)).all()
            return
        way, degrees = re.search(r"(up|down|turn).* (\d+)°( to its right)?", told).group(1, 2)
        if way == "turn":
            aside -= float(degrees) * (1 if "to its right" in told else -1)
        else:
            down -= float(degrees) * (1 if way == "down" else -1)
    raise AssertionError(told)


@given(st.floats(15.0, 165.0))
def test_the_angle_is_told_before_the_calibration(angle):
    provisional = replace(calibrated_of(angle), provisional=True)
    now = Situation(provisional, final=False, held=0.0)
    rules = {each.rule for each in watched(now=now, really=turned_around(angle), seconds=2.5, every=5)}
    assert ("angle" in rules) == (not 59.0 <= angle <= 121.0)
    assert ("uncalibrated" in rules) != ("angle" in rules)


def test_feet_out_of_view_make_no_mirror_image():
    joints = standing(BODY) + (0.0, 1.0, 0.0)
    for side in ("LEFT", "RIGHT"):
        joints[BODY.joint(f"FOOT_{side}"), 2] += 0.3
    assert "mirrored" not in {each.rule for each in watched(joints, seconds=6.0)}


SHARED = {"angle", "distance", "error", "mirrored", "moved", "precision", "unconfirmed", "views"}
"""Rules that judge a set-up and a session."""


def calibrated_of(angle):
    """A calibration of a person who walked, of sensors so many degrees apart."""
    pose = calibrated_on(BODY, turned_around(angle))
    return replace(pose, registration=replace(pose.registration, rotation_sd=np.radians(0.5)))


def situation(shift=(0.0, 0.0, 0.0), away=None, angle=None, held=None, **more):
    """What :func:`watched` sees of a person who is moved, and of sensors so many degrees apart."""
    joints = standing(BODY) + shift
    if away is not None:
        joints[:, 2] += away - joints[list(BODY.torso), 2].mean()
    if held is not None:
        more["now"] = Situation(KNOWN, final=False, held=held)
    if angle is not None:
        really = turned_around(angle)
        more |= {"now": Situation(calibrated_of(angle), final=True, held=0.0), "really": really}
    return watched(joints, **more)


def test_sentences_of_the_coach():
    def told(case):
        found = situation(**arguments(case))
        lines = [headline(found, KNOWN).step, *(each.sentence for each in found)]
        return "\n".join(lines)

    check_sentences("coach", told)


@given(st.none() | st.floats(15.0, 165.0), st.floats(1.0, 6.0), st.booleans())
def test_coach_and_verdict_have_the_same_word_for_the_same_frames(angle, away, loaded):
    """And a calibration that is loaded has no better one."""
    frames, more = [], {}
    if loaded:
        really = A_FROM_B if angle is None else turned_around(angle)
        calibration = replace(
            calibrated_on(BODY, really), registration=None, how="loaded from room.json (pose)"
        )
        more = {"now": Situation(calibration, final=True, held=0.0), "really": really}
    found = situation(away=away, angle=None if loaded else angle, frames=frames, **more)
    now = more["now"].calibration if loaded else None
    if now is None:
        now = KNOWN if angle is None else calibrated_of(angle)
    told = Session.of([(FusionSetup(now), frames)]).verdict.findings
    both = [
        {
            (each.rule, each.side, each.rule != "distance" and each.word)  # which has that of feet, live
            for each in of
            if each.rule in SHARED
        }
        for of in (found, told)
    ]
    assert both[0] == both[1]


@pytest.mark.parametrize("refined", [False, True])
def test_views_that_differ_are_told_while_the_calibration_is_refined(refined):
    moved = replace(A_FROM_B, translation=A_FROM_B.translation + (0.15, 0.0, 0.0))
    assert "views" in {each.rule for each in watched(really=moved, refined=refined)}


@pytest.mark.parametrize(
    ("there", "angle", "step"),
    [(False, 90.0, RING), (True, 62.0, AIM), (True, 118.0, AIM), (True, 90.0, "")],
)
def test_who_stands_in_the_ring_is_not_told_to_nor_are_aimed_sensors_aimed(there, angle, step):
    a_from_b = turned_around(angle)
    really = replace(a_from_b, translation=a_from_b.translation + (0.13, 0.0, 0.0))
    spot = standing_spot(a_from_b, (CAMERA, CAMERA), BODY.name, LEVEL_FLOOR)
    joints = standing(BODY)
    away = np.zeros(3) if there else np.array([0.6, 0.0, 0.0])
    torso = joints[list(BODY.torso)].mean(axis=0)
    at = joints + [spot.x - torso[0], 0.0, spot.z - torso[2]] + away
    found = watched(at, really=really, now=Situation(calibrated_of(angle), final=True, held=0.0))
    assert {each.step for each in found if each.rule == "views"} == {step}


def test_a_tall_person_fits_into_the_image_at_the_nearest_distance():
    top, bottom = project(CAMERA, [[0.0, -1.0, nearest(CAMERA)], [0.0, 1.0, nearest(CAMERA)]])[:, 1]
    assert bottom - top == pytest.approx(CAMERA.height)


@given(st.integers(0, 20), st.integers(0, 60), st.integers(0, 40), st.integers(-(10**17), 10**17))
def test_a_mirror_image_is_told_while_it_makes_up_half_of_what_is_remembered(before, mirrored, after, begin):
    """Of frames 0.24 s apart, the newest of which count most, from two seconds on."""
    coach, first, found = Coach(BODY, (CAMERA, CAMERA)), None, []
    of_a = [False] * before + [True] * mirrored + [False] * after
    for k, is_mirrored in enumerate(of_a):
        seen = pair_of(BODY, person(), begin + k * 240_000_000)
        frames = [SensorFrame(each.time_ns, {"1": each}) for each in (seen.a, seen.b)]
        frames[0] = _mirrored(frames[0]) if is_mirrored else frames[0]
        pair = frame_pair(*frames, "1", frames[0].time_ns)
        first = first or fuse_one(Fuser(FusionSetup(KNOWN)), pair)
        found = coach.watch(replace(first, pair=pair), Situation(KNOWN, final=True, held=0.0))
    ages = 0.24 * np.arange(len(of_a))[::-1]
    weights = np.exp(-ages / 15.0)
    share = weights[of_a].sum() / max(weights.sum(), 1e-9)
    assume(abs(share - 0.5) > 1e-6)
    told = len(of_a) > 9 and share > 0.5
    assert any((each.rule, each.side) == ("mirrored", "A") for each in found) == told


def test_who_walks_away_from_a_kinect_v2_is_no_mirror_image():
    """Its tracker takes a back for a front: for four seconds, more than half of the frames look mirrored."""
    scene, first = Scene(demonstrated("walk"), BODY, seconds=20.0, seed=3), None
    sensors = [SimulatedKinect(scene, good_rig(BODY), which) for which in (0, 1)]
    coach = Coach(BODY, tuple(each.intrinsics for each in sensors))
    for a, b in zip(*(each.frames() for each in sensors), strict=True):
        pair = frame_pair(a, b, next(iter(a.people), ""), a.time_ns, b.time_ns - a.time_ns)
        first = first or fuse_one(Fuser(FusionSetup(KNOWN)), pair)
        found = coach.watch(replace(first, pair=pair), Situation(KNOWN, final=True, held=0.0))
        assert "mirrored" not in {each.rule for each in found}


# --- The headline: its state, its step, and how rarely it changes.


def finding(rule, side="", word="poor", beyond=0.0):
    return Finding(rule, word, f"{rule} of {side} wrong", "", f"mend {rule} of {side}", side, beyond)


FINDINGS = [
    finding("unseen", "A"),
    finding("no_frames", "B"),
    finding("distance", "A", beyond=1.0),
    finding("distance", "B", "usable"),
    finding("feet", "B"),
    finding("mirrored", "B"),
    finding("angle", word="usable"),
    finding("uncalibrated", word="unknown"),
    finding("precision", word="usable"),
    finding("views"),
]
SEQUENCES = st.lists(
    st.tuples(st.floats(0.01, 3.0), st.sets(st.sampled_from(range(len(FINDINGS))), max_size=4)), max_size=60
)


@given(st.lists(st.booleans(), min_size=2, max_size=20))
def test_a_headline_stays_with_its_sensor(a_is_nearer):
    """Where both have one fault, and their figures swing about each other."""
    readiness, sides = Readiness(), set()
    for k, nearer_a in enumerate(a_is_nearer):
        metres = (1.30, 1.31) if nearer_a else (1.31, 1.30)
        found = [
            each
            for side, far in zip("AB", metres, strict=True)
            for each in judge("distance", far, side, limits=within(1.8, 4.0))
        ]
        sides.add(readiness.watch(3.0 * k, followed(found), KNOWN).side)
    assert len(sides) == 1


@given(SEQUENCES)
def test_a_headline_stays_for_two_seconds_unless_a_view_is_lost_or_calibrated(steps):
    """The list has what was advised in two seconds, each thing once, and else only what the headline says."""
    pose = next(k for k, each in enumerate(FINDINGS) if each.rule == "uncalibrated")
    readiness, time, advised = Readiness(), 0.0, {}
    changes = []
    for passed, now in steps:
        time += passed
        advised |= dict.fromkeys(now, time)
        if pose not in now:
            advised.pop(pose, None)
        shown = readiness.watch(time, [FINDINGS[k] for k in sorted(now)], KNOWN)
        lately = followed(FINDINGS[k] for k, at in sorted(advised.items()) if time - at < LASTS)
        assert readiness.findings[: len(lately)] == lately
        held = [each.rule for each in readiness.findings[len(lately) :]]
        assert set(held) <= {shown.kind} - {each.rule for each in lately}
        assert shown.kind in {"", *(each.rule for each in readiness.findings)}
        if not changes or shown != changes[-1][1]:
            changes.append((time, shown))
    for (before, old), (at, new) in itertools.pairwise(changes):
        assert at - before >= LASTS or (new.lost and not old.lost) or old.kind == "uncalibrated"


@given(SEQUENCES, st.sets(st.sampled_from(range(len(FINDINGS))), max_size=4))
def test_whatever_was_advised_the_headline_comes_to_say_what_is_wrong_now(steps, last):
    readiness, time = Readiness(), 0.0
    for passed, now in steps:
        time += passed
        readiness.watch(time, [FINDINGS[k] for k in now], KNOWN)
    now = [FINDINGS[k] for k in sorted(last)]
    for k in range(6):
        shown = readiness.watch(time + k, now, KNOWN)
    asked = {each.rule for each in now}
    assert (shown.state is State.READY) == (not asked)
    assert shown.kind in (asked or {""})


@given(
    st.sets(st.sampled_from(range(len(FINDINGS)))), st.sampled_from(["distance", "feet", "whole", "angle"])
)
def test_nobody_is_asked_to_walk_about_before_person_and_sensors_are_in_place(others, rule):
    """Nor into place while they walk about as asked."""
    found = followed([finding(rule, "A"), finding("precision"), *(FINDINGS[k] for k in others)])
    told = headline(found, KNOWN)
    assert RULES[told.kind].live != WALK
    walks = headline(
        [finding("precision"), finding(rule, "A")], KNOWN, Headline(State.NOT_YET, "", "precision")
    )
    assert walks.kind == "precision"


@given(st.sets(st.sampled_from(range(len(FINDINGS))), max_size=6), st.randoms())
def test_no_order_changes_what_is_said_and_a_cause_has_the_word_of_its_consequence(which, rng):
    given_ = [FINDINGS[k] for k in sorted(which)]
    found = followed(given_)
    page = to_markdown(found, (), headline(found, KNOWN))
    mixed = list(given_)
    rng.shuffle(mixed)
    assert followed(mixed) == found
    assert page.count("###") == max(0, len(found) - 1)
    rules = {each.rule for each in given_}
    assert all(RULES[rule].told_by & rules for rule in rules - {each.rule for each in found})
    assert (headline(found, KNOWN).state is State.NOT_YET) == any(each.word == "poor" for each in given_)


def test_why_and_step_are_of_the_sensor_that_asks_for_most():
    limits = RULES["distance"].limits._replace(good=(1.7, 3.9))
    near, far = (judge("distance", away, side, limits=limits) for away, side in ((1.6, "A"), (5.1, "B")))
    shown = headline(followed((*near, *far)), KNOWN).step
    assert shown == "You are 5.1 m from B: come 1.5 m closer to B"


def test_ready_states_the_deviation_of_the_calibration():
    pose = calibrated_on(BODY)
    of = replace(pose, registration=replace(pose.registration, rotation_sd=0.00733))  # 0.42 degrees
    assert headline([], of).step == "Record now: ± 0.4°, whole body in both views"
    assert headline([], KNOWN).step == "Record now: whole body in both views"


EXPECTED = {
    "feet out of view": ("feet", "Feet out of view of A: tilt A down by 20°, or step back from it"),
    "mirrored B": ("mirrored", "B is the mirror image of a person: turn off mirroring in the driver of B"),
    "someone else": ("others", "Someone else is in view of "),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_a_bad_set_up_is_told_in_one_step_that_stays(name):
    seen = [moment.headline for moment in moments(SET_UPS[name], 4.5)]
    kind, step = EXPECTED[name]
    assert {each.kind for each in seen} <= {kind, "", "uncalibrated"}
    assert seen[-1].kind == kind
    assert seen[-1].state is State.NOT_YET
    assert seen[-1].step.startswith(step)
    assert all(fits(each.step) for each in seen)


def test_a_good_set_up_is_ready_after_some_steps_and_its_deviation_is_true():
    first_ready = None
    for moment in moments(SET_UPS["good"], 16.0):
        if moment.headline.state is State.READY:
            first_ready = moment
            break
        assert moment.headline.kind in ("", "uncalibrated", "precision")
        assert ("spot" in dict(moment.page.marks)) == (moment.headline.kind != "precision"), "or walk about"
    assert first_ready is not None
    assert "spot" not in dict(first_ready.page.marks)
    calibration = first_ready.setup.calibration
    sd = calibration.registration.rotation_sd
    assert f"± {57.29578 * sd:.1f}°" in first_ready.headline.step
    truth = SET_UPS["good"].rig.a_from_b
    assert calibration.a_from_b.angle_to(truth) < 3.0 * sd


# --- Drawings of the coach: where to stand, which problem to solve, a better place for B.


CAMERAS = (CAMERA, CAMERA)
PERSON = standing(BODY)
FEET_GONE = finding("feet", "B")


def fused(at=PERSON):
    return Fuser(FusionSetup(KNOWN)).update(pair_of(BODY, at))


def page(now=None, seen=None, *found, state=State.NOT_YET, kind="", floor=None):
    now = now or Situation(KNOWN, final=False, held=0.0)
    headline = Headline(state, "as advised", kind)
    return CoachScene(BODY, CAMERAS).page(found, now, seen, headline, floor=floor)


def marks(*given, **more):
    return dict(page(*given, **more).marks)


def middle_of_ring(mark):
    ring = np.array(mark.lines[0])
    assert mark.words_at[1] > ring[0, 1]
    assert ring[0] == pytest.approx(ring[-1])
    return np.asarray(ring[:-1].mean(axis=0))


@pytest.mark.parametrize("b", [None, A_FROM_B])
def test_a_person_with_arms_out_is_fully_in_view_at_the_advised_place(b):
    far = farthest(BODY.name, CAMERA)
    spot = standing_spot(b, CAMERAS, BODY.name, LEVEL_FLOOR)
    assert spot.room > 0.0
    for sensor in (RigidTransform.identity(), b):
        if sensor is None:
            continue
        torso = sensor.inverse().apply([spot.x, 0.0, spot.z])
        assert nearest(CAMERA) <= torso[2] <= far
        for side in (-ARM, ARM):
            pixel = project(CAMERA, torso + [side, 0.0, 0.0])
            assert 0.0 <= pixel[0] <= CAMERA.width


@given(
    st.floats(50.0, 130.0),
    st.tuples(st.floats(0.4, 2.2), st.floats(0.4, 2.2)),
    st.tuples(st.floats(-10.0, 25.0), st.floats(-10.0, 25.0)),
)
def test_who_stands_in_the_ring_is_seen_from_head_to_foot_if_there_is_such_a_place(angle, high, tilt):
    """As the sensors are tilted, K_A too."""
    around, down = Rotation.from_euler("y", -angle, degrees=True), Rotation.from_euler
    b = around.apply([0.0, 0.0, -2.6]) + (0.0, high[0] - high[1], 2.6)
    tilted = [down("x", -of, degrees=True) for of in tilt]
    level_from_a = RigidTransform.of(tilted[0].as_matrix(), np.zeros(3))
    level_from_b = RigidTransform.of((around * tilted[1]).as_matrix(), b)
    a_from_b = level_from_a.inverse() @ level_from_b
    a_from_floor = floor_frame(level_from_a.inverse().apply([0.0, -1.0, 0.0]), high[0])

    def seen(x, z, tall, aside=0.0, step=0.0):
        """Whether both see all of a person so tall, and as much aside, with a step to go in each distance."""
        up = -a_from_floor.rotation[:, 1]
        feet = np.array([x, height_of(a_from_floor, np.array(x), np.array(z)), z])
        for a_from_k in (RigidTransform.identity(), a_from_b):
            corners = [[k * aside, 0.0, 0.0] for k in (-1.0, 0.0, 1.0)]
            person = a_from_k.inverse().apply([feet, feet + up, feet + tall * up])
            far = nearest(CAMERA) + step <= person[1, 2] <= farthest(BODY.name, CAMERA) - step
            images = [project(CAMERA, person + corner) for corner in corners]
            if not (far and all(in_image(CAMERA, image).all() for image in images)):
                return False
        return True

    spot = standing_spot(a_from_b, CAMERAS, BODY.name, a_from_floor)
    places = product(np.arange(-2.0, 2.1, 0.2), np.arange(1.4, 4.6, 0.2))
    if not seen(spot.x, spot.z, 1.9):
        assert not any(seen(x, z, 2.1, ARM + 0.5, 0.5) for x, z in places)


def test_sensors_that_look_away_from_each_other_leave_no_place():
    back = RigidTransform.of(Rotation.from_euler("y", 180, degrees=True).as_matrix(), [0.0, 0.0, 0.0])
    assert standing_spot(back, CAMERAS, BODY.name, LEVEL_FLOOR).room < 0.0


def test_the_circle_is_on_the_floor_and_an_arrow_leads_to_it():
    away = fused(PERSON + [1.5, 0.0, 0.3])
    mark = marks(seen=away, floor=floor_frame(np.array([0.0, -1.0, 0.0]), 0.9))["spot"]
    assert middle_of_ring(mark)[1] == pytest.approx(0.9)
    arrow = np.array(mark.lines[2])
    torso = away.positions[list(BODY.torso)].mean(axis=0)
    assert np.linalg.norm(arrow[0] - torso, axis=0) > 0.3  # on the floor, not in the body
    assert np.abs(arrow[0] - torso)[[0, 2]].max() < 0.051
    along, to_go = (each[[0, 2]] for each in (arrow[1] - arrow[0], middle_of_ring(mark) - arrow[0]))
    assert along / np.linalg.norm(along) == pytest.approx(to_go / np.linalg.norm(to_go), abs=1e-6)


def test_the_pose_is_counted_down_on_the_card_and_the_circle_stays_until_ready():
    spot = standing_spot(A_FROM_B, CAMERAS, BODY.name, LEVEL_FLOOR)
    torso = PERSON[list(BODY.torso)].mean(axis=0)
    there = fused(PERSON + [spot.x - torso[0], 0.0, spot.z - torso[2]])
    assert page(seen=there, kind="uncalibrated").card == (State.NOT_YET, "as advised")
    now = Situation(KNOWN, final=False, held=HOLD - 1.4)
    assert page(now, there, kind="uncalibrated").card == (State.NOT_YET, "Hold still: 2 s")
    assert page(now, there, kind="feet").card == (State.NOT_YET, "as advised")
    for shown in (None, now, replace(now, final=True, held=0.0)):
        assert len(marks(shown, there)["spot"].lines) == 2  # no arrow
    assert "spot" not in marks(now, there, state=State.READY)
    for kind, rule in RULES.items():
        assert ("spot" in marks(now, there, kind=kind)) == (rule.live != WALK)


def test_before_the_first_person_a_circle_is_shown_in_front_of_a():
    mark = marks(Situation(nominal_calibration(BODY), final=False, held=0.0))["spot"]
    x, y, z = middle_of_ring(mark)
    assert (abs(x), y) == pytest.approx((0.0, 1.0), abs=0.1)
    assert nearest(CAMERA) < z < farthest(BODY.name, CAMERA)


def test_a_sensor_with_a_problem_is_marked_where_it_stands():
    drawn = marks(None, None, finding("unseen", "B"), finding("whole", "A"))
    assert "sensor_a" not in drawn
    assert drawn["sensor_b"].meaning == "mend"
    edge, first, *_ = drawn["sensor_b"].lines
    assert first[0] == pytest.approx(A_FROM_B.translation)
    assert edge[0] == edge[-1]


@pytest.mark.parametrize("angle", [30.0, 150.0])
def test_b_is_shown_a_place_at_a_right_angle_and_as_far_from_the_person(angle):
    a_from_b = turned_around(angle)
    now = Situation(calibrated_on(BODY, a_from_b), final=True, held=0.0)
    mark = marks(now, fused(), finding("angle"))["better_b"]
    way = np.array(mark.lines[-1])
    assert way[0] == pytest.approx(a_from_b.translation, abs=1e-3)
    spot = standing_spot(a_from_b, CAMERAS, BODY.name, LEVEL_FLOOR)
    away = np.array([spot.x, 0.0, spot.z])
    # the floor is known to 0.1 m only, which moves the spot by a step at most
    assert np.linalg.norm(way[-1] - away) == pytest.approx(np.linalg.norm(way[0] - away), abs=0.15)
    looks = np.mean([line[1] for line in mark.lines[1:5]], axis=0) - mark.lines[1][0]
    assert mark.words_at[1] > way[-1, 1]  # y is down
    assert looks[2] / np.linalg.norm(looks) == pytest.approx(0.0, abs=0.02)  # at a right angle to A's axis


def test_a_good_angle_needs_no_better_place():
    now = Situation(calibrated_on(BODY), final=True, held=0.0)
    assert "better_b" not in marks(now, fused())


@given(st.floats(15.0, 165.0), st.floats(1.2, 4.0), st.floats(0.5, 2.0), st.booleans())
def test_sensors_person_spot_and_better_place_are_in_the_picture(angle, distance, height, known):
    rig = Rig(angle_deg=angle, distance=distance, height=height)
    calibration = replace(KNOWN, a_from_b=rig.a_from_b) if known else nominal_calibration(BODY)
    setup = FusionSetup(calibration)
    towards = np.array([0.6, 0.0, -0.8])
    eye, target = overview(places(setup), towards)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(back, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    shown = marks(Situation(calibration, final=known, held=0.0), fused(), FEET_GONE, finding("angle"))
    drawn = np.concatenate([line for mark in shown.values() for line in mark.lines])
    for points in (places(setup), drawn if known else drawn[:0]):
        seen = points - eye
        depth = -seen @ back
        assert (depth > 0.0).all()
        # the viewer's eye sees 55° of the height; the scene is wider than high
        assert (np.abs(seen @ np.cross(right, back)) / depth < np.tan(np.radians(27.5))).all()
        assert (np.abs(seen @ right) / depth < 1.4 * np.tan(np.radians(27.5))).all()
