"""Registration by the surface that both sensors see: laws on a person of ellipsoids."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from fusion.body import KINECT_V2 as BODY
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.calibration.person_size import PersonSize
from fusion.calibration.surface_fit import (
    SharedSurface,
    Surface,
    depth_errors,
    fit_surface,
    with_surface,
    without_depth_errors,
)
from fusion.registration.keyframes import Evidence
from fusion.registration.lasting_errors import common_variance
from fusion.registration.rigid_fit import Registration
from fusion.registration.robust_fit import RobustFit
from fusion.rigid import RigidTransform, rotation_of
from fusion.skeleton import SkeletonPair
from tests.helpers.laws import COSTLY, SECOND, pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, noisy, pair_of

SEEDS = st.integers(0, 2**32 - 1)
ANGLES = st.floats(40.0, 110.0)
PARTS = np.array([
    (0.0, -1.65, 0.0, 0.09, 0.12, 0.10),
    (0.0, -1.2, 0.0, 0.19, 0.32, 0.12), (0.0, -0.9, 0.0, 0.17, 0.15, 0.13),
    (0.28, -1.2, 0.05, 0.05, 0.3, 0.05), (-0.28, -1.2, -0.05, 0.05, 0.3, 0.05),
    (0.12, -0.45, 0.04, 0.07, 0.42, 0.08), (-0.12, -0.45, -0.04, 0.07, 0.42, 0.08),
])  # fmt: skip
"""Centres and half axes of ellipsoids, metres; y is down."""


def surface_of(parts, seed):
    """(N, 3) points of the ellipsoids, and their normals."""
    rng = np.random.default_rng(seed)
    points, normals = [], []
    for x, y, z, *axes in parts:
        around = rng.normal(size=(700, 3))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        points.append((x, y, z) + around * axes)
        out = around / axes
        normals.append(out / np.linalg.norm(out, axis=1, keepdims=True))
    return np.concatenate(points), np.concatenate(normals)


def scene(seed, angle, parts=PARTS, moments=5, offset=0.0, floor=True):
    """What both sensors see of a person who turns, and the truth; ``offset`` along each ray."""
    rng, rig = np.random.default_rng(seed), Rig(angle_deg=angle)
    seen = []
    for k in range(moments):
        turn = Rotation.from_euler("y", rng.uniform(-40, 40), degrees=True).as_matrix()
        views = []
        for which in (0, 1):
            points, normals = surface_of(parts, (seed, k, which))
            from_world = rig.world_from_sensor(which).inverse()
            at = from_world.apply(points @ turn.T + np.array((0.2, 0.0, 0.1)) * k)
            n = normals @ turn.T @ from_world.rotation.T
            rays = at / np.linalg.norm(at, axis=1, keepdims=True)
            front = (n * rays).sum(axis=1) < -0.17
            views.append(Surface((at + offset * rays)[front], n[front]))
        seen.append(tuple(views))
    floors = []  # y = 0 of the world
    for which in (0, 1):
        place = rig.world_from_sensor(which)
        floors.append(np.append(-place.rotation[1], place.translation[1]))
    shared = SharedSurface(seen, tuple(floors) if floor else (None, None))
    return shared, rig.a_from_b


def joints_of(truth, seed, shift=0.02, turn_deg=1.0):
    """A fit of joints that is off: by a turn, and along u_A − u_B."""
    rng = np.random.default_rng(seed)
    centre = np.array((0.0, 0.1, 2.6))
    towards = [to / np.linalg.norm(to) for to in (-centre, truth.translation - centre)]
    axis = rng.normal(size=3)
    R = rotation_of(np.radians(turn_deg) * axis / np.linalg.norm(axis))
    off = RigidTransform.of(R, centre - R @ centre + shift * (towards[0] - towards[1])) @ truth
    covariance = np.diag([0.01**2] * 3 + [np.radians(0.5) ** 2] * 3)
    covariance[:3, :3] += common_variance(off, centre) * np.eye(3)
    return RobustFit(off, covariance, centre, np.zeros((3, 32, 3)), 0.02), towards[0] - towards[1]


def exchanged(shared, joints):
    """The same with A and B exchanged."""
    R, turned = joints.a_from_b.rotation, np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = R
    inverse = joints.a_from_b.inverse()
    return (
        SharedSurface([(b, a) for a, b in shared.moments], shared.floors[::-1]),
        replace(
            joints, a_from_b=inverse, centre=inverse.apply(joints.centre),
            covariance=turned.T @ joints.covariance @ turned,
        ),
    )  # fmt: skip


def errors(a_from_b, truth, centre):
    """Degrees, and metres at the person."""
    there = a_from_b.apply(truth.inverse().apply(centre)) - centre
    return np.degrees(a_from_b.angle_to(truth)), there


@COSTLY
@given(SEEDS, ANGLES, st.floats(-0.03, 0.03), st.booleans())
def test_the_surface_takes_away_the_joints_error_along_the_rays(seed, angle, shift, floor):
    shared, truth = scene(seed, angle, floor=floor)
    joints, _ = joints_of(truth, seed, shift)
    found = fit_surface(shared, joints)
    assert found.certain
    assert found.floor == floor
    turn, there = errors(found.fit.a_from_b, truth, joints.centre)
    # 3,000 points a view are 15 mm apart: chords of a limb of radius 50 mm lie 0.6 mm inside it
    assert turn < 0.4
    assert np.linalg.norm(there) < 0.004
    assert found.fit.translation_sd < joints.translation_sd


@COSTLY
@given(SEEDS, ANGLES, st.floats(-0.03, 0.03))
def test_exchanging_the_sensors_gives_the_inverse(seed, angle, shift):
    shared, truth = scene(seed, angle)
    joints, _ = joints_of(truth, seed, shift)
    one, other = fit_surface(shared, joints), fit_surface(*exchanged(shared, joints))
    turn, there = errors(other.fit.a_from_b.inverse(), one.fit.a_from_b, joints.centre)
    assert turn < 0.01
    assert np.linalg.norm(there) < 2e-4
    assert one.certain == other.certain


@COSTLY
@given(SEEDS, st.floats(55.0, 110.0), st.floats(-0.025, 0.025))
def test_an_offset_of_both_cameras_stays_in_t_and_in_its_stated_error(seed, angle, offset):
    shared, truth = scene(seed, angle, offset=offset)
    joints, apart = joints_of(truth, seed, 0.0, 0.2)
    fit = fit_surface(shared, joints).fit
    there = errors(fit.a_from_b, truth, joints.centre)[1]
    # 28 mm of the joints against a surface of mm: they take little; the place below the centre is not seen
    np.testing.assert_allclose(there, -offset * apart, atol=0.006)
    assert fit.translation_sd > 0.010 * np.linalg.norm(apart)


@COSTLY
@given(SEEDS, ANGLES, st.sampled_from(["nothing", "one limb", "few moments", "another place"]))
def test_too_little_of_the_surface_is_not_trusted(seed, angle, what):
    parts = PARTS[3:4] * (1, 1, 1, 1, 0.3, 1) if what == "one limb" else PARTS
    shared, truth = scene(seed, angle, parts, moments=3 if what == "few moments" else 5)
    if what == "nothing":
        shared = shared._replace(moments=[])
    if what == "another place":  # B's images are of another time
        shared = shared._replace(
            moments=[(a, b._replace(points=b.points + (0.5, 0.0, 0.3))) for a, b in shared.moments]
        )
    assert not fit_surface(shared, joints_of(truth, seed)[0]).certain


@given(SEEDS, ANGLES, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_depth_errors_of_the_views_are_found_and_taken_away(seed, angle, of_a, of_b):
    rng, truth = np.random.default_rng(seed), Rig(angle_deg=angle).a_from_b
    at = np.array((0.0, 0.0, 2.6)) + rng.normal(0.0, 0.4, (40, 32, 3))
    views = []
    for by, own in ((of_a, at), (of_b, truth.inverse().apply(at))):
        views.append(own * (1.0 + by / np.linalg.norm(own, axis=2, keepdims=True)))
    evidence = Evidence(*views, np.ones((40, 32)), np.ones((40, 3)), np.arange(40))
    found = depth_errors(evidence, truth)
    # the prior of 30 mm takes a little of them
    np.testing.assert_allclose(found, (of_a, of_b), atol=0.005)
    without = without_depth_errors(evidence, np.array((of_a, of_b)))
    np.testing.assert_allclose(without.a, truth.apply(without.b), atol=1e-9)


def test_a_start_up_pose_of_a_short_recording_is_still_what_the_calibration_rests_on():
    """Two keyframes alone would be "calibrated on 2 frames"."""
    (shared, truth), of = scene(3, 80.0), np.full(32, np.nan)
    joints, _ = joints_of(truth, 3)
    sd = joints.rotation_sd, 61, AZURE_KINECT, joints.translation_sd, joints.centre
    pose = Registration(joints.a_from_b, 0.02, 0.02, of, *sd)
    fitted = Calibration(AZURE_KINECT, joints.a_from_b, AZURE_KINECT.nominal_lengths, "start-up pose", pose)
    at = joints.centre + np.random.default_rng(3).normal(0.0, 0.4, (2, 32, 3))
    evidence = Evidence(at, truth.inverse().apply(at), np.ones((2, 32)), np.ones((2, 3)), np.arange(2))
    found = with_surface(AZURE_KINECT, evidence, fitted, None, shared)
    assert found.how.startswith("start-up pose, of the surface in 5 moments")
    assert found.registration.frames == 61
    assert found.a_from_b.angle_to(truth) < 0.5 * joints.a_from_b.angle_to(truth)
    by_joints = found.by_joints(joints.a_from_b, "refined", pose)
    assert not by_joints.depth_errors.any(), "a fit of joints contains them"


def test_a_recording_without_images_has_the_same_bits():
    times = np.arange(120) * FRAME_NS
    pairs = pairs_at(times, moving(AZURE_KINECT, 120), AZURE_KINECT)
    asked = []

    def nothing(moments):
        asked.append(moments)

    one, other = (learn_from_recording(AZURE_KINECT, pairs, surfaces=of).spans[0] for of in (None, nothing))
    np.testing.assert_array_equal(one.calibration.a_from_b.rotation, other.calibration.a_from_b.rotation)
    np.testing.assert_array_equal(one.calibration.bone_lengths, other.calibration.bone_lengths)
    assert one.calibration.how == other.calibration.how
    (moments,) = asked
    assert 4 <= len(moments) <= 12
    assert np.diff(moments.time_ns).min() > 0


# --- The bones of S* are those of the person present, whoever was there before and wherever absences lie.


STEP_NS = SECOND // 10
KEPT = LearnerSettings().if_learned(False)
PLACES = moving(BODY, 300)[::3]
START = replace(calibration_of(BODY), bone_lengths=np.nan_to_num(bone_lengths_of(BODY, PLACES[0])))
scales = st.one_of(st.floats(0.6, 0.92), st.floats(1.085, 1.4))


def seen(scale, begin_ns, seconds):
    """Somebody of this size who walks before both sensors."""
    pairs = []
    for k in range(round(10 * seconds)):
        at = PLACES[k % len(PLACES)] * scale + (0.5 * np.sin(0.1 * k), 0.0, 2.6 * (1.0 - scale))
        pairs.append(pair_of(BODY, at, begin_ns + k * STEP_NS))
    return pairs


def learned(pairs, settings=KEPT):
    learner = CalibrationLearner(BODY, START, settings)
    return learner, [change for pair in pairs for change in learner.observe(pair)]


def size(lengths):
    bones = BODY.bone_joints
    return float(np.median(lengths[bones] / START.bone_lengths[bones]))


@COSTLY
@given(scales, st.floats(1.1, 90.0), st.booleans(), st.floats(3.0, 15.0))
def test_another_persons_bones_are_theirs_after_3_s(scale, away_s, kept, before_s):
    first = seen(1.0, 0, before_s)
    second = seen(scale, first[-1].time_ns + STEP_NS + round(away_s * SECOND), 3.0)
    learner, changes = learned(first + second, KEPT if kept else LearnerSettings(refine=False, follow=False))
    assert abs(size(learner.calibration.bone_lengths) / scale - 1.0) < 0.02
    event = next(change for change in changes if change.kind == "person")
    assert event.since_ns == second[0].time_ns
    assert ("smaller" if scale < 1.0 else "larger") in event.event
    assert learner.calibration.person == START.person + 1


@given(scales, st.floats(2.0, 60.0))
def test_who_comes_back_has_the_bones_of_before(scale, away_s):
    pairs = seen(1.0, 0, 12.0)
    for of in (scale, 1.0):
        pairs += seen(of, pairs[-1].time_ns + round(away_s * SECOND), 12.0)
    learner, changes = learned(pairs)
    assert [change.kind for change in changes].count("person") == 2
    assert learner.calibration.bone_lengths is START.bone_lengths
    assert learner.calibration.person == START.person


@given(
    st.one_of(st.floats(0.6, 0.83), st.floats(0.88, 1.14), st.floats(1.19, 1.4)),
    st.floats(3.0, 15.0),
    st.floats(0.0, 0.85),
)
def test_without_a_gap_of_a_second_only_a_far_other_size_is_another_person(scale, before_s, away_s):
    """A tracker may have fitted a body of another size at first, as a real Kinect v2 does for 7 s."""
    first = seen(1.0, 0, before_s)
    second = seen(scale, first[-1].time_ns + STEP_NS + round(away_s * SECOND), 4.0)
    learner, changes = learned(first + second)
    another = abs(np.log(scale)) > 0.15
    assert [change.kind for change in changes] == ["person"] * bool(another)
    assert abs(size(learner.calibration.bone_lengths) / (scale if another else 1.0) - 1.0) < 0.02


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.035), st.floats(0.3, 1.0), st.floats(-0.02, 0.02))
def test_a_trackers_wandering_scale_is_nobody_else(seed, scale_sd, lasting_s, usual):
    """Sizes of two views that wander on their own, about one that is a little off."""
    noise = np.random.default_rng(seed)
    kept = np.exp(-0.1 / lasting_s)
    steps = noise.normal(0.0, scale_sd * np.sqrt(1.0 - kept * kept), (600, 2))
    size, sizes = PersonSize(), np.zeros(2)
    for k, step in enumerate(steps):
        sizes = kept * sizes + step
        assert not size.observe(k * STEP_NS, *(usual + sizes).tolist())


def told(*spans):
    """In which spans somebody else is told: seconds away, then seconds of the sizes in both views."""
    size, time_ns, found = PersonSize(), 0, []
    for away_s, seconds, *sizes in spans:
        time_ns += round(away_s * SECOND)
        found.append(sum(size.observe(time_ns + k * STEP_NS, *sizes) for k in range(10 * seconds)) > 0)
        time_ns += 10 * seconds * STEP_NS
    return found


@given(st.floats(0.07, 0.4), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 9.0), st.booleans())
def test_another_person_is_who_both_views_show_whenever_they_do(off, sign, away_s, first_a):
    """One view alone shows a tracker's error; it is waited for until both do."""
    one = (sign * off, 0.0) if first_a else (0.0, sign * off)
    assert told((0.0, 5, *one), (0.0, 5, sign * off, sign * off)) == [False, True]
    assert told((0.0, 5, 0.0, 0.0), (away_s, 5, *one)) == [False, False]


@given(st.floats(0.015, 0.03), st.sampled_from([-1.0, 1.0]))
def test_another_person_is_told_by_who_was_there_not_by_the_first_bones(usual, sign):
    assert told((0.0, 14, *[sign * usual] * 2), (2.0, 5, *[sign * (usual - 0.062)] * 2)) == [False, True]


@COSTLY
@given(
    st.one_of(st.just(1.0), scales),
    st.lists(st.tuples(st.floats(2.5, 6.0), st.floats(0.2, 60.0)), min_size=1, max_size=6),
    st.floats(-5.0, 5.0),
)
def test_what_is_learned_is_of_the_person_present_wherever_absences_lie(scale, presence, turn):
    """R, t and bones after 12 s of presence, from a start that is off and somebody else's bones."""
    rng, begin_ns, pairs, walked = np.random.default_rng(0), 0, [], 0
    whole = seen(scale, 0, 12.0)
    for seen_s, away_s in [*presence, (12.0, 0.0)]:
        for pair in whole[walked : walked + round(10 * seen_s)]:
            pairs.append(noisy(replace(pair, time_ns=begin_ns), rng, 0.003))
            begin_ns += STEP_NS
            walked += 1
        begin_ns += round(away_s * SECOND)
    turned = RigidTransform.of(Rotation.from_euler("y", turn, degrees=True).as_matrix(), (0.05, 0.0, 0.0))
    learner = CalibrationLearner(BODY, replace(START, a_from_b=turned @ A_FROM_B))
    for pair in pairs:
        learner.observe(pair)
    found = learner.calibration
    assert np.degrees(found.a_from_b.angle_to(A_FROM_B)) < 0.7
    assert abs(size(found.bone_lengths) / scale - 1.0) < 0.02


@given(scales, st.floats(4.0, 10.0), st.floats(4.0, 10.0))
def test_a_recording_has_the_bones_of_each_person(scale, before_s, after_s):
    first = seen(1.0, 0, before_s)
    pairs = first + seen(scale, first[-1].time_ns + 3 * SECOND, after_s)
    found = learn_from_recording(BODY, pairs, start=START, settings=KEPT)
    assert [span.first_ns for span in found.spans] == [0, pairs[len(first)].time_ns]
    assert [
        round(size(span.calibration.bone_lengths) / of, 2)
        for span, of in zip(found.spans, (1.0, scale), strict=True)
    ] == [1.0, 1.0]
    assert found.spans[0].calibration.bone_lengths is START.bone_lengths
    assert [change.kind for change in found.events] == ["person"]
    assert [span.calibration.person for span in found.spans] == [0, 1]


def test_one_person_is_one_span_whatever_the_calibration_was():
    pairs: list[SkeletonPair] = seen(0.8, 0, 10.0)
    found = learn_from_recording(BODY, pairs, start=START, settings=KEPT)
    (span,) = found.spans
    assert abs(size(span.calibration.bone_lengths) / 0.8 - 1.0) < 0.01
