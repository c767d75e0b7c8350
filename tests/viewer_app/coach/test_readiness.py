"""The headline: its state, its step, and how rarely it changes."""

import itertools
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration
from recordings.appearance.state_card import State, fits
from tests.helpers.set_ups import SET_UPS, moments
from tests.helpers.two_views import A_FROM_B, calibrated_on
from viewer_app.coach.advice import Advice
from viewer_app.coach.readiness import LASTS, Readiness, headline, to_markdown

BODY = KINECT_V2
KNOWN = Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")


def advice(topic, level="WARN", side="", urgency=0.0):
    return Advice(
        topic, "…", level, side, f"{topic} wrong", f"mend {topic.split()[0]} of {{who}}", "", urgency
    )


TOPICS = [
    advice("person A", side="A"),
    advice("silent B", "INFO", "B"),
    advice("distance A", side="A", urgency=1.0),
    advice("distance B", side="B"),
    advice("feet B", side="B"),
    advice("mirrored B", side="B"),
    advice("angle"),
    advice("pose", "INFO"),
    advice("skew"),
    Advice("warm-up", "figures", figures=True),
]
SEQUENCES = st.lists(
    st.tuples(st.floats(0.01, 3.0), st.sets(st.sampled_from(range(len(TOPICS))), max_size=4)), max_size=60
)


@given(SEQUENCES)
def test_a_headline_stays_for_two_seconds_unless_a_view_is_lost(steps):
    readiness, time = Readiness(), 0.0
    changes = []
    for passed, now in steps:
        time += passed
        shown = readiness.watch(time, [TOPICS[k] for k in sorted(now)], KNOWN)
        assert shown.kind in {"", *(each.kind for each in readiness.advice)}  # the list says it, too
        if not changes or shown != changes[-1][1]:
            changes.append((time, shown))
    for (before, old), (at, new) in itertools.pairwise(changes):
        assert at - before >= LASTS or (new.lost and not old.lost)


@given(SEQUENCES, st.sets(st.sampled_from(range(len(TOPICS))), max_size=4))
def test_whatever_was_advised_the_headline_comes_to_say_what_is_wrong_now(steps, last):
    readiness, time = Readiness(), 0.0
    for passed, now in steps:
        time += passed
        readiness.watch(time, [TOPICS[k] for k in now], KNOWN)
    now = [TOPICS[k] for k in sorted(last)]
    for k in range(6):
        shown = readiness.watch(time + k, now, KNOWN)
    asked = {each.kind for each in now if each.step}
    assert (shown.state is State.READY) == (not asked)
    assert shown.kind in (asked or {""})


@given(st.sets(st.sampled_from(range(len(TOPICS))), max_size=6), st.randoms())
def test_state_and_list_depend_on_no_order_and_say_each_thing_once(which, rng):
    given_ = [TOPICS[k] for k in sorted(which)]
    shown = headline(given_, KNOWN)
    page = to_markdown(given_, shown)
    mixed = list(given_)
    rng.shuffle(mixed)
    assert headline(mixed, KNOWN) == shown
    kinds = {each.kind for each in given_ if each.step}
    assert page.count("###") == len(kinds)
    assert all(page.count(f"mend {kind} of") == (kind != shown.kind) for kind in kinds)
    assert (shown.state is State.ALMOST) == (bool(kinds) and kinds <= {"pose", "skew"})


def test_the_step_names_the_sensors_and_follows_the_one_that_asks_for_most():
    near = advice("distance A", side="A", urgency=0.2), advice("distance B", side="B", urgency=0.9)
    steps = [replace(each, step=f"step back {each.urgency} m from {{who}}") for each in near]
    assert headline(steps, KNOWN).step == "Step back 0.9 m from A and B"


@pytest.mark.parametrize(("told", "by"), [("whole", "distance"), ("pose", "calibration")])
def test_what_another_advice_tells_is_no_problem_of_its_own(told, by):
    one, other, third = (advice(topic) for topic in (told, by, "skew"))
    assert f"{told} wrong" in to_markdown([one, third]).lower()
    assert to_markdown([one, other, third]) == to_markdown([other, third])
    assert headline([one, other], KNOWN) == headline([other], KNOWN)


def test_ready_states_the_deviation_of_the_calibration():
    pose = calibrated_on(BODY)
    of = replace(pose, registration=replace(pose.registration, rotation_sd=0.00733))  # 0.42 degrees
    assert headline([], of).step == "Record now: ± 0.4°, whole body in both views"
    assert headline([], KNOWN).step == "Record now: whole body in both views"


EXPECTED = {
    "too near": ("distance", "Too near: step back"),
    "30 degrees apart": ("angle", "Only 30° apart: move B away from A, round you, to 90°"),
    "feet out of view": ("feet", "Feet out of view: tilt A and B down, or step back"),
    "mirrored B": ("mirrored", "Mirror image: turn off mirroring in the driver of B"),
    "someone else": ("others", "Someone else in view: ask them to step aside"),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_a_bad_set_up_is_told_in_one_step_that_stays(name):
    seen = [moment.headline for moment in moments(SET_UPS[name], 6.0)]
    kind, step = EXPECTED[name]
    assert {each.kind for each in seen} <= {kind, "pose"}  # 30 degrees are not known before the pose
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
        assert moment.headline.kind in ("pose", "calibration")
        assert "spot" in dict(moment.page.marks)
    assert first_ready is not None
    assert "spot" not in dict(first_ready.page.marks)
    calibration = first_ready.setup.calibration
    sd = calibration.registration.rotation_sd
    assert f"± {57.29578 * sd:.1f}°" in first_ready.headline.step
    truth = SET_UPS["good"].rig.a_from_b
    assert calibration.a_from_b.angle_to(truth) < 3.0 * sd
