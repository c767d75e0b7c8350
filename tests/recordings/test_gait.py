"""Steps of people whose feet are known, and of people who do not walk."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.person.footsteps import smooth
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, BODIES
from fusion.movement.angles import UP
from recordings import fuse
from recordings.errors import RecordingError
from recordings.gait import SIDES, Gait, Step
from recordings.gait.events import _DEFINITION_SD, _LABELLED, find_gait
from tests.helpers.footfalls import contacts, laboratory_walk, stood, walker

SECONDS, RATE = 20.0, 30.0
TIMES = np.arange(0, round(SECONDS * RATE)) * round(1e9 / RATE)


def truth_of(name, body=AZURE_KINECT):
    """(T, J, 3) where the joints really are."""
    return Truth(Scene(movement(name), body), Rig()).positions_at(TIMES)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_every_step_of_a_walk_is_found_at_its_time_and_none_is_invented(body):
    random = np.random.default_rng(3)
    erring = truth_of("walk", body) + random.normal(0.0, 0.01, (len(TIMES), len(body), 3))
    gait = find_gait(body, TIMES, erring, UP)
    assert [step.side for step in gait.steps[:4]] == ["right", "left", "right", "left"]
    for side, (strikes, offs) in contacts("walk", SECONDS).items():
        steps = gait.of_side(side)
        seen = strikes[strikes < SECONDS - 0.35]  # a strike shows by what follows
        assert len(steps) in (len(seen), len(strikes))
        for found, contact in (([s.strike for s in steps], strikes), ([s.toe_off for s in steps], offs)):
            np.testing.assert_allclose(found, contact[: len(steps)] + _LABELLED, atol=0.05)


def test_figures_of_a_walk_agree_with_how_it_was_made():
    sigma = np.full((len(TIMES), len(AZURE_KINECT)), 0.02)
    gait = find_gait(AZURE_KINECT, TIMES, truth_of("walk"), UP, sigma)
    (walk,) = gait.walks
    assert gait.cadence.value == pytest.approx(2 * 60 / 1.15, rel=0.01)  # a stride takes 1.15 s
    assert gait.speed.value == pytest.approx(8.4 / 11.5, rel=0.01)  # loops of 8.4 m in 11.5 s
    assert 0.0 < gait.cadence.sigma < 1.0
    assert 0.0 < gait.speed.sigma < 0.02
    for side, (strikes, offs) in contacts("walk", SECONDS).items():
        assert np.nanmean(gait.stance(side)) == pytest.approx(stood(strikes, offs).mean(), abs=0.02)
    assert all(0.3 < step.length < 0.5 for step in walk)
    assert all(step.length_sigma == pytest.approx(0.02 * np.sqrt(2 / 3)) for step in walk)
    assert [name for _, name in gait.events[:4]] == [
        "toe_off_right", "heel_strike_right", "toe_off_left", "heel_strike_left",
    ]  # fmt: skip


def test_the_time_in_motion_has_walks_backwards_too():
    joints = truth_of("walk")
    forwards, backwards = (find_gait(AZURE_KINECT, TIMES, each, UP) for each in (joints, joints[::-1]))
    assert 0.8 * SECONDS - 3.0 < forwards.walking_seconds <= forwards.moving_seconds < SECONDS
    assert backwards.steps == ()
    assert backwards.walking_seconds == 0.0
    assert backwards.moving_seconds == pytest.approx(forwards.moving_seconds, abs=0.5)
    assert backwards.left_out["not forwards"] > 0.9 * backwards.moving_seconds
    assert find_gait(AZURE_KINECT, TIMES, in_place(joints), UP).moving_seconds < 0.1 * SECONDS


def test_two_strikes_are_no_walk_and_are_told_as_seconds_without_three():
    times, joints = walker(1.5, RATE)  # strikes at about 0.4 and 1.0 s
    gait = find_gait(AZURE_KINECT, times, joints, UP)
    assert gait.steps == ()
    assert gait.left_out == {"not forwards": 0.0, "no three strikes in turn": pytest.approx(1.5, abs=0.1)}


def in_place(positions):
    """The same movement of a pelvis that stays where it is: a march on the spot."""
    moved = positions - positions[:, :1] + positions[:1, :1]
    moved[..., 1] = positions[..., 1]
    feet = [AZURE_KINECT.joint(f"{part}{side}") for part in ("Ankle", "Foot") for side in ("Left", "Right")]
    moved[:, feet, 0] = positions[0, feet, 0]
    moved[:, feet, 2] = positions[0, feet, 2]
    return moved


@pytest.mark.parametrize("name", [name for name in MOTIONS if name != "walk"])
def test_people_who_do_not_walk_take_no_steps(name):
    erring = truth_of(name) + np.random.default_rng(4).normal(0.0, 0.02, (len(TIMES), len(AZURE_KINECT), 3))
    assert find_gait(AZURE_KINECT, TIMES, erring, UP).steps == ()


def test_a_march_on_the_spot_has_no_steps():
    assert find_gait(AZURE_KINECT, TIMES, in_place(truth_of("walk")), UP).steps == ()


@given(speed=st.floats(0.5, 1.5), moves=st.floats(0.0, 0.4))
def test_a_treadmill_has_no_steps_whoever_drifts_on_it(speed, moves):
    times, joints = walker(12.0, RATE, speed=speed)
    joints[..., 2] -= ((1.0 - moves) * speed * 1e-9 * times)[:, None]
    assert find_gait(AZURE_KINECT, times, joints, UP).steps == ()


def test_a_gap_divides_a_walk_and_nothing_is_invented_in_it():
    joints = truth_of("walk")
    whole = find_gait(AZURE_KINECT, TIMES, joints, UP)
    joints[(TIMES > 10.0e9) & (TIMES < 12.0e9)] = np.nan
    first, second = find_gait(AZURE_KINECT, TIMES, joints, UP).walks
    assert first[-1].strike < 10.0 < 12.0 < second[0].strike
    assert np.isnan(second[0].seconds)
    assert np.isnan(second[0].progress)
    strikes = np.array([step.strike for step in whole.steps])
    assert all(abs(strikes - step.strike).min() < 0.03 for step in (*first, *second))


def test_a_walk_ends_where_the_time_goes_back():
    joints, times = truth_of("walk"), TIMES.copy()
    times[300:] -= times[300] - times[30]
    first, second = find_gait(AZURE_KINECT, times, joints, UP).walks
    for walk, own in ((first, slice(0, 300)), (second, slice(300, None))):
        (alone,) = find_gait(AZURE_KINECT, times[own], joints[own], UP).walks
        assert [step.side for step in walk] == [step.side for step in alone]
        np.testing.assert_allclose([step[2:] for step in walk], [step[2:] for step in alone])


@pytest.mark.parametrize("begins", np.arange(9.0, 10.2, 0.1).round(1))
def test_a_person_who_stands_still_for_a_while_takes_two_walks(begins):
    """In whichever part of a step they stop, so that the next one may be the other foot's."""
    joints, stops = truth_of("walk"), round(begins * RATE)
    halted = np.concatenate([joints[:stops], joints[[stops] * 60], joints[stops:-60]])
    first, second = find_gait(AZURE_KINECT, TIMES, halted, UP).walks
    assert first[-1].strike < begins + 0.3
    assert second[0].strike > begins + 1.7


STEP = Step("left", 0, 0.0, 0.02, 0.0, 0.02, np.nan, 0.4, 0.02, 0.1, np.nan, np.nan)


def gait_of(strikes, speeds):
    """A walk with strikes at some seconds, of a pelvis with some speed in each step."""
    seconds = np.diff(strikes)
    return Gait(
        tuple(
            STEP._replace(side=SIDES[k % 2], strike=strike, seconds=of, progress=of * speed, turned=0.0)
            for k, (strike, of, speed) in enumerate(
                zip(strikes, [np.nan, *seconds], [np.nan, *speeds], strict=True)
            )
        )
    )


@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
def test_uncertainties_hold_however_few_the_steps_are(seed, count):
    """The median of a hundred persons with steps that vary, in deviations as stated, is below one."""
    random = np.random.default_rng(seed)
    off = []
    for _ in range(100):
        seconds, speeds = random.normal(0.6, 0.05, count), random.normal(0.7, 0.05, count)
        gait = gait_of(np.cumsum([1.0, *seconds]), speeds)
        off.append([abs(gait.cadence.value - 100.0) / gait.cadence.sigma])
        off[-1].append(abs(gait.speed.value - 0.7) / gait.speed.sigma)
    assert (np.median(off, axis=0) < 1.0).all()


@given(st.integers(3, 30), st.floats(0.2, 0.8), st.data())
def test_a_step_too_many_or_too_few_is_within_the_uncertainty_of_the_cadence(count, share, data):
    right = 1.0 + 0.6 * np.arange(count + 2)
    k = data.draw(st.integers(1, count))
    more = np.insert(right, k, right[k - 1] + 0.6 * share)
    for strikes in (more, np.delete(right, k)):
        cadence = gait_of(strikes, np.full(len(strikes) - 1, 0.7)).cadence
        assert abs(cadence.value - 100.0) < 2.5 * cadence.sigma


def test_the_speed_is_as_uncertain_as_both_ends_of_a_walk_and_its_curves():
    """The middle of two hips is half as uncertain as the distance of two ankles; in a curve half lasts."""
    straight = gait_of(1.0 + 0.6 * np.arange(6), np.full(5, 0.7))
    first, *later = straight.steps
    half_circle = Gait((first, *(step._replace(turned=np.pi / 5) for step in later)))
    end = 0.5 * STEP.length_sigma
    assert straight.speed.sigma == pytest.approx(np.hypot(end, end) / 3.0)
    assert half_circle.speed.sigma == pytest.approx(np.linalg.norm([end, end, end * np.pi / 2]) / 3.0)


WALKS = {
    "speed": st.floats(0.15, 1.6),
    "stride": st.floats(0.95, 2.0),
    "stance": st.floats(0.58, 0.75),
    "turning": st.floats(-1.2, 1.2),
    "weaving": st.tuples(st.floats(0.0, 0.8), st.floats(0.05, 0.25)),
}


@given(st.fixed_dictionaries(WALKS))
def test_the_speed_is_that_of_the_path_whatever_its_curves(how):
    bends = abs(how["turning"]) + 2.0 * np.pi * np.prod(how["weaving"])
    assume(how["speed"] * bends < 1.2)  # radians per second: faster, steps in turn are not beside the path
    times, joints = walker(12.0, RATE, **how)
    gait = find_gait(AZURE_KINECT, times, joints, UP)
    assert len(gait.walks) == 1
    assert gait.speed.value == pytest.approx(how["speed"], rel=0.01)
    assert gait.cadence.value == pytest.approx(120.0 / how["stride"], rel=0.01)


@given(st.fixed_dictionaries(WALKS), st.floats(5.0, 90.0))
def test_every_rate_shows_the_same_walk(how, rate):
    often, seldom = (
        find_gait(AZURE_KINECT, times, joints, UP, np.zeros(joints.shape[:2]))
        for times, joints in (walker(12.0, each, **how) for each in (100.0, rate))
    )
    assert seldom.speed.value == pytest.approx(often.speed.value, rel=0.01)
    for side in SIDES:
        steps, true = seldom.of_side(side), often.of_side(side)
        strikes = [step.strike for step in true]
        inner = [
            step for step in steps if how["stride"] < step.strike < 12.0 - how["stride"]
        ]  # others may not show
        nearest = np.abs(np.subtract.outer(strikes, [step.strike for step in inner])).argmin(axis=0)
        assert nearest.tolist() == list(range(nearest[0], nearest[0] + len(inner)))
        for step, k in zip(inner, nearest, strict=True):
            assert abs(step.strike - strikes[k]) < 2.5 * step.strike_sigma
            assert not abs(step.toe_off - true[k].toe_off) > 2.5 * step.toe_off_sigma


@given(st.fixed_dictionaries(WALKS), st.floats(0.0, 4.0), st.floats(1.5, 5.0))
def test_a_part_of_a_recording_has_the_strikes_a_quarter_of_a_stride_within_it(how, first, strides):
    times, joints = walker(14.0, RATE, **how)
    strikes = [step.strike for step in find_gait(AZURE_KINECT, times, joints, UP).steps]
    last = min(first + strides * how["stride"], 14.0)
    part = (times >= first * 1e9) & (times <= last * 1e9)
    found = np.array([step.strike for step in find_gait(AZURE_KINECT, times[part], joints[part], UP).steps])
    margin = 0.25 * how["stride"]
    within = [strike for strike in strikes if first + margin < strike < last - margin]
    assume(len(within) >= 3)  # a walk
    assert all(np.abs(found - strike).min() < 0.05 for strike in within)


@pytest.mark.parametrize("rate", [10.0, 15.0])
def test_strikes_between_few_frames_are_not_late(rate):
    """Straight lines between the frames put them 13 ms late at ten per second, and 6 ms at 15."""
    walk = Truth(Scene(movement("walk"), AZURE_KINECT), Rig())
    often, seldom = (
        find_gait(AZURE_KINECT, times, walk.positions_at(times), UP)
        for times in (np.arange(0, 20_000_000_000, round(1e9 / each)) for each in (100.0, rate))
    )
    strikes = np.array([step.strike for step in often.steps])
    late = [step.strike - strikes[np.abs(strikes - step.strike).argmin()] for step in seldom.steps]
    assert abs(np.mean(late)) < 0.06 / rate


def events(gait):
    """(N, 2) seconds of strikes and toe-offs."""
    return np.array([(step.strike, step.toe_off) for step in gait.steps])


TILTS = st.tuples(*[st.floats(-40.0, 40.0)] * 3)


@given(st.fixed_dictionaries(WALKS), st.floats(0.5, 2.0), st.integers(-(10**15), 10**15), TILTS)
def test_another_size_side_hour_or_tilt_changes_nothing_else(how, scale, later_ns, tilt):
    times, joints = walker(8.0, RATE, **how)
    gait = find_gait(AZURE_KINECT, times, joints, UP)
    larger = find_gait(AZURE_KINECT, times, scale * joints, UP)
    np.testing.assert_allclose(events(larger), events(gait), atol=1e-6)
    assert larger.speed.value == pytest.approx(scale * gait.speed.value)
    widths = np.array([step.width for step in gait.steps])
    np.testing.assert_allclose([step.width for step in larger.steps], scale * widths, atol=1e-6)
    mirrored = find_gait(AZURE_KINECT, times, joints[:, AZURE_KINECT.mirror] * (-1.0, 1.0, 1.0), UP)
    np.testing.assert_allclose(events(mirrored), events(gait), atol=1e-6)
    assert [step.side for step in mirrored.steps] == [SIDES[step.side == "left"] for step in gait.steps]
    np.testing.assert_allclose([step.width for step in mirrored.steps], widths, atol=1e-6)
    for name, each in gait.asymmetry.items():
        assert mirrored.asymmetry[name].value == pytest.approx(-each.value, abs=1e-4)
        assert larger.asymmetry[name].value == pytest.approx(each.value, abs=1e-4)
    turn = Rotation.from_euler("xyz", tilt, degrees=True)
    tilted = find_gait(AZURE_KINECT, times, joints @ turn.as_matrix().T, turn.apply(UP))
    assert [step.side for step in tilted.steps] == [step.side for step in gait.steps]
    np.testing.assert_allclose(
        [step[2:] for step in tilted.steps], [step[2:] for step in gait.steps], atol=1e-6
    )
    later = find_gait(AZURE_KINECT, times + later_ns, joints, UP)
    np.testing.assert_allclose(events(later) - later_ns * 1e-9, events(gait), atol=1e-6)


@given(st.fixed_dictionaries(WALKS), st.floats(1.0, 2.0))
def test_a_slower_walk_has_the_same_steps_later(how, slower):
    times, joints = walker(8.0, 100.0, **how)
    whole = find_gait(AZURE_KINECT, times, joints, UP)
    slow_how = how | {"speed": how["speed"] / slower, "stride": how["stride"] * slower}
    slow = find_gait(AZURE_KINECT, *walker(8.0 * slower, 100.0 / slower, **slow_how), UP)
    inner = slice(1, -1)  # others may not show
    assume(len(slow.steps) == len(whole.steps))
    np.testing.assert_allclose(events(slow)[inner], slower * events(whole)[inner], atol=0.05)


@given(st.floats(0.15, 1.6), st.floats(0.95, 2.0), st.floats(0.58, 0.75))
def test_a_step_is_as_long_as_the_feet_are_apart_at_its_strike(speed, stride, stance):
    """A stride is two steps. Of a swing with minimum jerk up to 2 % is left, or the next step has begun."""
    times, joints = walker(10.0, RATE, speed=speed, stride=stride, stance=stance)
    lengths = [step.length for step in find_gait(AZURE_KINECT, times, joints, UP).steps[1:-1]]
    assert np.mean(lengths) == pytest.approx(0.5 * speed * stride, rel=0.02)


@given(st.floats(0.3, 1.4), st.floats(-1.0, 1.0))
def test_the_steps_are_as_wide_as_the_feet_are_apart_in_curves_too(speed, turning):
    times, joints = walker(10.0, RATE, speed=speed, turning=turning)  # ankles 0.16 m apart
    widths = [step.width for step in find_gait(AZURE_KINECT, times, joints, UP).steps]
    assert np.mean(widths) == pytest.approx(0.16, abs=0.02)


@given(st.sampled_from([-1.0, 1.0]), st.floats(45.0, 120.0), st.floats(1.5, 4.0))
def test_a_turn_on_the_spot_has_its_angle_and_its_time(sign, per_second, lasts):
    degrees = per_second * lasts
    t = np.arange(0.0, lasts + 4.0, 1.0 / RATE)
    left = sign * np.radians(degrees) * smooth((t - 2.0) / lasts)
    joints = np.repeat(walker(1.0, RATE)[1][:1], len(t), axis=0)
    cos, sin = np.cos(left)[:, None], np.sin(left)[:, None]
    turned = joints.copy()
    turned[..., 0] = cos * joints[..., 0] - sin * joints[..., 2]
    turned[..., 2] = sin * joints[..., 0] + cos * joints[..., 2]
    (turn,) = find_gait(AZURE_KINECT, np.rint(t * 1e9), turned, UP, np.full(turned.shape[:2], 0.01)).turns
    fast = np.flatnonzero(np.abs(np.gradient(left, t)) > np.radians(15.0))
    # it is smoothed with a standard deviation of 0.2 s
    assert -0.1 < turn.seconds - (t[fast[-1]] - t[fast[0]]) < 0.5
    assert -0.3 < turn.begins - t[fast[0]] < 0.1
    assert np.degrees(turn.angle) == pytest.approx(sign * degrees, abs=10.0)
    assert 0.0 < turn.angle_sigma < turn.seconds_sigma < 0.5


def test_the_asymmetry_is_what_left_has_more_than_right_over_their_mean():
    gait = gait_of(np.arange(1.0, 9.0), np.full(7, 0.7))
    longer = Gait(tuple(step._replace(length=0.44 if step.side == "left" else 0.36) for step in gait.steps))
    assert gait.asymmetry["step_length"] == (0.0, 0.0)
    assert longer.asymmetry["step_length"].value == pytest.approx(20.0)
    assert np.isnan(Gait(()).asymmetry["stance"].value)


@given(st.fixed_dictionaries(WALKS), st.integers(0, 2**32 - 1))
def test_who_stands_first_does_not_leave_the_floor_meanwhile(how, seed):
    _, joints = walker(8.0, RATE, **how)
    stands = np.concatenate([np.repeat(joints[:1], 90, axis=0), joints])
    stands = stands + np.random.default_rng(seed).normal(0.0, 0.01, stands.shape)
    steps = find_gait(AZURE_KINECT, np.arange(len(stands)) * round(1e9 / RATE), stands, UP).steps
    assert not any(step.strike - step.toe_off > how["stride"] for step in steps)


@given(st.floats(0.05, 0.3), st.floats(0.3, 1.0))
@example(0.1, 0.5)
def test_who_sways_back_before_the_first_step_has_not_lifted_the_foot_then(metres, rise_s):
    """No swing is far longer than the others; its toe-off is unknown."""
    _, joints = walker(6.0, RATE)
    hips = joints[:, AZURE_KINECT.joint("HipLeft")]
    ahead = (hips[60] - hips[0]) / np.linalg.norm(hips[60] - hips[0])
    stands = np.repeat(joints[:1], 90, axis=0)
    sways = [
        AZURE_KINECT.joint(f"{part}{side}") for part in ("Hip", "Shoulder") for side in ("Left", "Right")
    ]
    stands[:, sways] += (
        np.interp(np.arange(90) / RATE, [0.0, rise_s, 3.0], [0.0, metres, 0.0])[:, None, None] * ahead
    )
    stands = np.concatenate([stands, joints])
    first, *later = find_gait(AZURE_KINECT, np.arange(len(stands)) * round(1e9 / RATE), stands, UP).steps
    usual = np.median([step.strike - step.toe_off for step in later])
    assert not first.strike - first.toe_off > 2.0 * usual


@given(
    st.fixed_dictionaries({name: WALKS[name] for name in ("speed", "stride", "stance")}),
    st.floats(30.0, 100.0),
)
def test_a_heel_strikes_where_its_ankle_becomes_slower_than_three_quarters_of_the_pelvis(how, rate):
    """Feet swing with minimum jerk. The uncertainty is that of the labels and a quarter of a frame."""
    times, joints = walker(10.0, rate, **how)
    gait = find_gait(AZURE_KINECT, times, joints, UP, np.zeros(joints.shape[:2]))
    swing = (1.0 - how["stance"]) * how["stride"]
    assume(swing > 0.38)  # what is shorter, S* is smoothed over
    share = brentq(lambda x: 30.0 * (x * (1.0 - x)) ** 2 - 0.75 * (1.0 - how["stance"]), 0.0, 0.5)
    for side, first in zip(SIDES, (0.0, 0.5 * how["stride"]), strict=True):
        for step in gait.of_side(side)[1:-1]:
            late = (step.strike - _LABELLED - first - (1.0 - share) * swing) % how["stride"]
            assert min(late, how["stride"] - late) < 0.007 * swing  # at 0.6 of it: 0.012
            assert step.strike_sigma == pytest.approx(np.hypot(_DEFINITION_SD, 0.25 / rate), rel=0.02)


@given(st.fixed_dictionaries(WALKS))
def test_a_foot_is_on_the_floor_from_its_strike_to_its_toe_off(how):
    times, joints = walker(8.0, RATE, **how)
    gait = find_gait(AZURE_KINECT, times, joints, UP, np.full(joints.shape[:2], 0.01))
    for side in SIDES:
        first, *later = gait.of_side(side)
        for a, b in zip([first, *later], later, strict=False):
            assume(
                min(b.toe_off - a.strike, b.strike - b.toe_off) > 6.0 * max(a.strike_sigma, b.toe_off_sigma)
            )
            middles = [(a.strike + b.toe_off) / 2.0, (b.toe_off + b.strike) / 2.0]
            np.testing.assert_allclose(gait.contact(side, middles), [1.0, 0.0], atol=0.01)
            np.testing.assert_allclose(gait.contact(side, [b.toe_off]), [0.5], atol=0.01)
        everywhere = gait.contact(side, np.linspace(-1.0, 9.0, 1001))
        known = np.isfinite(everywhere)
        assert ((everywhere[known] >= 0.0) & (everywhere[known] <= 1.0)).all()
        assert np.mean(known) == pytest.approx((later[-1].strike - first.strike) / 10.0, abs=0.002)


@pytest.mark.parametrize("real", ["kinect_v2_90deg_walk_18", "kinect_v2_90deg_walk_9"])
def test_a_foot_leaves_the_floor_after_the_other_one_has_struck(shared, real):
    """S* loses a foot of these walks, whose toes then seem to leave the floor early in the stance."""
    gait = fuse(*(shared / "real_more" / real / f"{side}.csv" for side in "ab")).gait
    for walk in gait.walks:
        for before, step in pairwise(walk):
            assert not step.toe_off < before.strike - 0.1
    for side in SIDES:
        assert np.nanmin(gait.stance(side)) > 0.3


def test_revisions_lose_no_steps_of_the_nine_real_walks(shared):
    """Revision 12 found 144."""
    walks = sorted(shared.glob("real*/*_walk*"))
    assert sum(len(fuse(*(walk / f"{side}.csv" for side in "ab")).gait.steps) for walk in walks) >= 144


@pytest.mark.parametrize("stretched", [1.0, 1.5])
@pytest.mark.parametrize("shortened", [1.0, 0.6, 0.4, 0.25])
def test_a_slow_walker_of_a_laboratory_takes_all_labelled_steps(shortened, stretched):
    """As recorded at 0.63 m/s, and with shorter and slower steps, down to 0.1 m/s."""
    seconds, joints, labelled = laboratory_walk()
    hips = joints[:, [AZURE_KINECT.joint(f"Hip{side}") for side in ("Left", "Right")]].mean(axis=1)
    way = (hips[-1] - hips[0]) * (1.0, 0.0, 1.0)
    way /= np.linalg.norm(way)
    joints = joints - (1.0 - shortened) * (joints @ way)[..., None] * way
    gait = find_gait(
        AZURE_KINECT, np.rint(stretched * seconds * 1e9).astype(np.int64), joints, (0.0, 1.0, 0.0)
    )
    off = {"heel_strike": [], "toe_off": []}
    for side, told in labelled.items():
        for (kind, errors), labels in zip(off.items(), told, strict=True):
            found = [seconds / stretched for seconds, event in gait.events if event == f"{kind}_{side}"]
            assert len(found) == len(labels), (kind, side)
            errors += (found - labels).tolist()
    assert np.abs(off["heel_strike"] + off["toe_off"]).max() < 0.1
    for errors in off.values():  # the means of eight walks scatter by 18 ms
        assert abs(np.mean(errors)) < 2.5 * 0.018
    share = np.mean([stood(*told) for told in labelled.values()])
    assert np.mean([gait.stance(side) for side in SIDES]) == pytest.approx(share, abs=0.02)


@given(st.fixed_dictionaries(WALKS), st.floats(0.02, 0.2), st.integers(0, 2**32 - 1))
def test_the_clearance_is_how_far_toes_rise_in_a_swing(how, rises, seed):
    """Within its uncertainty, besides what is filtered out of a short swing and what noise adds."""
    times, joints = walker(8.0, RATE, **how, rises=rises)
    noise = 0.01
    joints += np.random.default_rng(seed).normal(0.0, noise, joints.shape)
    sigma = np.full(joints.shape[:2], np.sqrt(3.0) * noise)
    gait = find_gait(AZURE_KINECT, times, joints, UP, sigma)
    found = np.array([(s.clearance, s.clearance_sigma) for s in gait.steps if np.isfinite(s.clearance)])
    assume(len(found) > 3 and (1.0 - how["stance"]) * how["stride"] > 0.38)
    assert np.mean(np.abs(found[:, 0] - rises) < 2.5 * found[:, 1] + 0.1 * rises) >= 0.9


def test_somebody_without_shoulders_or_toes_walks_too():
    times, joints = walker(8.0, RATE)
    whole = find_gait(AZURE_KINECT, times, joints, UP)
    for part in ("Shoulder", "Foot"):
        lacking = joints.copy()
        lacking[:, [AZURE_KINECT.joint(f"{part}{side}") for side in ("Left", "Right")]] = np.nan
        steps = find_gait(AZURE_KINECT, times, lacking, UP).steps
        np.testing.assert_allclose([s.strike for s in steps], [s.strike for s in whole.steps], atol=1e-6)
        # without toes the ankles are used, but how far they rise is no clearance
        assert np.isfinite([s.clearance for s in steps[2:]]).all() == (part == "Shoulder")


def test_a_swing_in_which_toes_were_lost_has_no_clearance():
    times, joints = walker(8.0, RATE, rises=0.05)
    first, *later = find_gait(AZURE_KINECT, times, joints, UP).of_side("left")[1:]
    swings = times[:, None] * 1e-9 - [first.toe_off + 0.1, first.strike - 0.1]
    joints[(swings[:, 0] > 0.0) & (swings[:, 1] < 0.0), AZURE_KINECT.joint("FootLeft")] = np.nan
    cut, *others = find_gait(AZURE_KINECT, times, joints, UP).of_side("left")[1:]
    assert np.isnan([cut.clearance, cut.clearance_sigma]).all()
    np.testing.assert_allclose([s.clearance for s in others], [s.clearance for s in later], atol=1e-3)


def test_two_frames_of_one_moment_are_one():
    times, joints = walker(8.0, RATE)
    off = joints[1::40] + 0.02  # a nanosecond before the next frame
    twice = np.concatenate([times, times[1::40] - 1])
    order = np.argsort(twice)
    found = find_gait(AZURE_KINECT, twice[order], np.concatenate([joints, off])[order], UP)
    np.testing.assert_allclose(events(found), events(find_gait(AZURE_KINECT, times, joints, UP)), atol=0.03)


def test_nobody_and_nothing_have_no_steps():
    nobody = np.full((len(TIMES), len(AZURE_KINECT), 3), np.nan)
    for count in (0, 1, len(TIMES)):
        gait = find_gait(AZURE_KINECT, TIMES[:count], nobody[:count], UP)
        assert gait.steps == ()
        assert np.isnan(gait.cadence.value)
        assert np.isnan(gait.speed.value)
        assert gait.cycles("left").shape == (0, 2)


def test_curves_over_the_gait_cycle_begin_and_end_with_their_strikes():
    seconds = np.linspace(0.0, 10.0, 301)
    step = Step("left", 0, *([np.nan] * 10))
    steps = tuple(
        step._replace(strike=strike, walk=walk) for strike, walk in ((1, 0), (2, 0), (4, 1), (6, 1))
    )
    gait = Gait(steps, time=seconds, angles={"knee_flexion_left": 3.0 * seconds})
    for curves in (gait.curves("knee_flexion_left"), gait.curves(3.0 * seconds, "left")):
        np.testing.assert_allclose(curves[:, [0, 50, 100]], [[3.0, 4.5, 6.0], [12.0, 15.0, 18.0]])
    assert gait.curves("knee_flexion_left", "right").shape == (0, 101)
    with pytest.raises(RecordingError, match=r"each of 301 frames; got \(300,\) values"):
        gait.curves(seconds[1:], "left")
