"""The bones of S* are those of the person present, whoever was there before and wherever absences lie."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import KINECT_V2 as BODY
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.calibration.person_size import PersonSize
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from tests.helpers.laws import COSTLY, SECOND
from tests.helpers.two_views import A_FROM_B, calibration_of, moving, noisy, pair_of

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
