"""Steps of people whose feet are known, and of people who do not walk."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from fusion.angles import UP
from fusion.body import AZURE_KINECT, BODIES
from recordings.gait import SIDES, Gait, cycle_curves, find_gait
from tests.helpers.footfalls import contacts

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
        np.testing.assert_allclose([step.strike for step in steps], strikes[: len(steps)], atol=0.05)
        np.testing.assert_allclose([step.toe_off for step in steps], offs[: len(steps)], atol=0.05)


def test_figures_of_a_walk_agree_with_how_it_was_made():
    sigma = np.full((len(TIMES), len(AZURE_KINECT)), 0.02)
    gait = find_gait(AZURE_KINECT, TIMES, truth_of("walk"), UP, sigma)
    (walk,) = gait.walks
    assert gait.cadence.value == pytest.approx(2 * 60 / 1.15, rel=0.01)  # a stride takes 1.15 s
    assert gait.speed.value == pytest.approx(0.67, abs=0.03)  # on loops of 7.7 m in 11.5 s, with some sway
    assert 0.0 < gait.cadence.sigma < 1.0
    assert 0.0 < gait.speed.sigma < 0.02
    for side in SIDES:
        # toes are off the floor for 0.38 of a stride, and the heel lands before them
        assert np.nanmean(gait.stance(side)) == pytest.approx(0.73, abs=0.03)
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
    assert backwards.moving_seconds == pytest.approx(forwards.moving_seconds, abs=0.3)
    assert find_gait(AZURE_KINECT, TIMES, in_place(joints), UP).moving_seconds < 0.1 * SECONDS


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


def test_a_tilted_sensor_sees_the_same_steps():
    turn = Rotation.from_euler("xyz", [-25, 40, 10], degrees=True)
    joints = truth_of("walk")
    tilted = turn.apply(joints.reshape(-1, 3)).reshape(joints.shape)
    steps, seen = (
        find_gait(AZURE_KINECT, TIMES, positions, up).steps
        for positions, up in ((joints, UP), (tilted, turn.apply(UP)))
    )
    assert [step.side for step in seen] == [step.side for step in steps]
    np.testing.assert_allclose([step[2:] for step in seen], [step[2:] for step in steps], atol=1e-9)


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


@pytest.mark.parametrize("begins", np.arange(9.0, 10.2, 0.1).round(1))
def test_a_person_who_stands_still_for_a_while_takes_two_walks(begins):
    """In whichever part of a step they stop, so that the next one may be the other foot's."""
    joints, stops = truth_of("walk"), round(begins * RATE)
    halted = np.concatenate([joints[:stops], joints[[stops] * 60], joints[stops:-60]])
    first, second = find_gait(AZURE_KINECT, TIMES, halted, UP).walks
    assert first[-1].strike < begins + 0.3
    assert second[0].strike > begins + 1.7


def test_uncertainties_are_the_spread_of_what_is_computed_from_uncertain_strikes():
    sigma = np.full((len(TIMES), len(AZURE_KINECT)), 0.02)
    joints = truth_of("walk")
    joints[(TIMES > 10.0e9) & (TIMES < 11.0e9)] = np.nan
    steps = [
        step._replace(length_sigma=0.0) for step in find_gait(AZURE_KINECT, TIMES, joints, UP, sigma).steps
    ]
    random, drawn = np.random.default_rng(0), []
    for _ in range(2000):
        moved = [step.strike + random.normal(0.0, step.strike_sigma) for step in steps]
        gait = Gait(
            tuple(
                step._replace(strike=moved[k], seconds=moved[k] - moved[k - 1])
                if np.isfinite(step.seconds)
                else step._replace(strike=moved[k])
                for k, step in enumerate(steps)
            )
        )
        drawn.append((gait.cadence.value, gait.speed.value))
    gait = Gait(tuple(steps))
    assert len(gait.walks) == 2
    told = [gait.cadence.sigma, gait.speed.sigma]
    np.testing.assert_allclose(np.std(drawn, axis=0), told, rtol=0.08)  # 2,000 draws tell it to 1.6 %


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
    curves = cycle_curves(seconds, 3.0 * seconds, np.array([[1.0, 2.0], [4.0, 6.0]]))
    np.testing.assert_allclose(curves[:, [0, 50, 100]], [[3.0, 4.5, 6.0], [12.0, 15.0, 18.0]])
