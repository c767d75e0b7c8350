"""The coach's advice over time. Time is that of the pairs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.depth.camera import project
from devices.sensor import SensorFrame
from fusion.body import BODIES, KINECT_V2
from fusion.calibration.calibration import Calibration, calibrate
from fusion.fuser import Fuser
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, TrackingState
from recordings.fusing.pairs import fuse_one
from recordings.quality.limits import FARTHEST_PERSON, nearest
from tests.helpers.frame_pairs import frame_pair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibrated_on, pair_of, standing, turned_around
from viewer_app.coach.advice import calibration_advice, placement
from viewer_app.coach.setup_coach import MOVED, Coach, Situation

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
    skew_ns=0,
    every=1,
    lost_feet=(),
    dropping=0,
    losing=0,
    b_gone=(np.inf, np.inf),
    b_other=False,
    simulated=False,
    remote="",
):
    """The coach's advice by topic after some seconds of unchanged frames."""
    now = now or Situation(KNOWN, final=True, held=0.0)
    coach = Coach(BODY, (CAMERA, CAMERA), simulated=simulated, remote=remote)
    fuser = Fuser(FusionSetup(now.calibration))
    joints = standing(BODY) if truth is None else truth
    advice = []
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
        pair = frame_pair(SensorFrame(time_ns, people[0]), from_b, "1", time_ns, skew_ns)
        if b_other:  # B's only person is not the one followed
            pair = replace(pair, skeletons=replace(pair.skeletons, b=None))
        drops = replace(now, dropped=(k * dropping, 0), lost=(0, k * losing))
        advice = coach.watch(fuse_one(fuser, pair), drops)
    return {each.topic: each for each in advice}


def wrong(said):
    return {topic for topic, advice in said.items() if advice.level == "WARN"}


def millimetres(advice):
    """The first figure in millimetres."""
    return int(advice.text[: advice.text.index(" mm")].split()[-1])


def test_nothing_is_wrong_with_a_person_in_both_views():
    assert wrong(watched()) == set()


def test_a_sensor_that_sees_no_one_is_named_after_a_second():
    assert wrong(watched(b=False, seconds=0.9)) == set()
    said = watched(b=False, seconds=3.0)
    assert wrong(said) == {"person B"}
    assert "has seen no one for 3 s" in said["person B"].text
    assert wrong(watched(b_other=True)) == set()


@pytest.mark.parametrize("lost", ["states", "image"])
def test_feet_that_are_hidden_or_outside_the_image_are_noticed(lost):
    lowered = standing(BODY) + [0.0, 1.2, 0.0]
    said = watched(lost_feet=("LEFT", "RIGHT")) if lost == "states" else watched(lowered)
    assert {"feet A", "feet B"} <= wrong(said)
    assert said["feet A"].text == "Sensor A does not see both feet. Tilt it down, or step back."


def test_a_foot_behind_the_other_leg_is_no_fault_of_the_placement():
    assert wrong(watched(lost_feet=("LEFT",))) == set()


def test_too_close_and_too_far_name_the_distance_and_the_limit():
    torso = standing(BODY)[list(BODY.torso), 2].mean()
    for distance, words in ((1.0, "Too close to"), (5.5, "Too far from")):
        said = watched(standing(BODY) + [0.0, 0.0, distance - torso])["distance A"]
        assert said.text.startswith(f"{words} sensor A: {distance:.1f} m")
    assert nearest(CAMERA) < 2.6 < FARTHEST_PERSON[BODY.name]


def test_a_tall_person_fits_into_the_image_at_the_nearest_distance():
    top, bottom = project(CAMERA, [[0.0, -1.0, nearest(CAMERA)], [0.0, 1.0, nearest(CAMERA)]])[:, 1]
    assert bottom - top == pytest.approx(CAMERA.height)


@pytest.mark.parametrize(
    ("angle", "advice"), [(30.0, "further apart"), (150.0, "closer together"), (90.0, None)]
)
def test_the_angle_between_the_sensors_is_judged(angle, advice):
    a_from_b = turned_around(angle)
    pose = calibrated_on(BODY, a_from_b)
    walked = replace(pose, registration=replace(pose.registration, rotation_sd=np.radians(0.5)))
    said = watched(now=Situation(walked, final=True, held=0.0), really=a_from_b)
    if advice is None:
        assert "angle" not in said
    else:
        assert advice in said["angle"].text
        assert f"look {angle:.0f}° apart" in said["angle"].text


def test_the_start_up_pose_is_asked_for_until_the_calibration_is_final():
    for held in (0.0, 0.5):
        said = watched(now=Situation(KNOWN, final=False, held=held))["pose"]
        assert "hold still 3 s" in said.step
    assert "pose" not in watched()


def test_slow_late_and_dropping_sensors_are_named():
    assert wrong(watched(every=2)) == {"rate A", "rate B"}
    assert "USB" in watched(every=2)["rate A"].text
    of_two_pcs = watched(every=2, remote="B")
    assert "USB" in of_two_pcs["rate A"].text
    assert "network" in of_two_pcs["rate B"].text
    assert "USB" not in of_two_pcs["rate B"].text
    assert wrong(watched(skew_ns=-20_000_000)) == {"skew"}
    assert wrong(watched(skew_ns=15_000_000)) == set()
    said = watched(dropping=1)
    assert wrong(said) == {"drops A"}
    assert said["drops A"].text.startswith("60 frames of A came too fast for this machine in 2 s")
    said = watched(losing=1)
    assert wrong(said) == {"drops B"}
    assert said["drops B"].text.startswith("60 frames of B were lost on USB in 2 s")


@pytest.mark.parametrize("seconds", [3.3, 4.0, 5.5, 7.1, 8.5, 9.5])
def test_a_sensor_that_is_gone_from_3_to_7_s_gets_no_advice_on_its_place_or_usb(seconds):
    assert wrong(watched(seconds=seconds, b_gone=(3.0, 7.0))) == set()


def test_this_machine_is_blamed_for_a_low_rate_where_it_is_too_slow():
    assert "USB" not in watched(every=2, dropping=1)["rate A"].text
    assert "This machine is too slow" in watched(every=2, dropping=1)["rate A"].text
    assert "USB" in watched(every=2, dropping=1)["rate B"].text  # it drops none
    assert "This machine is too slow" in watched(every=2, simulated=True)["rate B"].text


def test_a_turned_sensor_asks_for_a_new_calibration():
    turned = Rotation.from_euler("y", 8.0, degrees=True).as_matrix()
    really = RigidTransform.of(A_FROM_B.rotation @ turned, A_FROM_B.translation)
    assert "moved" not in watched(really=really, seconds=5.0)  # not before eight seconds agree
    said = watched(really=really, seconds=9.0)["moved"]
    assert millimetres(said) > 1e3 * MOVED
    assert "Calibrate again" in said.text
    assert "moved" not in watched(seconds=9.0)


def test_the_verdict_says_how_many_millimetres_and_what_limits_it():
    rng = np.random.default_rng(0)
    noisy = []
    for k in range(60):
        pair = pair_of(BODY, standing(BODY), k * FRAME_NS)
        joints = pair.b.positions + rng.normal(0, 0.06, (len(BODY), 3)).astype(np.float32)
        noisy.append(replace(pair, b=Skeleton.of(BODY, joints, None, k * FRAME_NS)))
    said = calibration_advice(calibrate(BODY, noisy, "start-up pose"))
    # noise of 60 mm an axis in one view: a Maxwell median of 1.538 · 60 mm
    assert millimetres(said) == pytest.approx(92.3, rel=0.05)
    assert said.level == "WARN"
    assert "poor" in said.text
    assert "limited by" in said.text
    assert "_" not in said.text  # joints are named as one says them


def a_calibration(angle, sd_deg, *, residual=0.03, provisional=False, frames=40):
    """A calibration of sensors so many degrees apart, with its standard deviation."""
    R = Rotation.from_euler("y", angle, degrees=True).as_matrix()
    a_from_b = RigidTransform.of(R, np.zeros(3))
    joints = np.full(len(BODY), residual)
    sds = np.radians(sd_deg), 0.03
    registration = Registration(a_from_b, residual, residual, joints, sds[0], frames, BODY, sds[1])
    return Calibration(BODY, a_from_b, BODY.nominal_lengths, "known", registration, provisional)


@pytest.mark.parametrize(
    ("angle", "sd_deg", "provisional", "advised"),
    [
        (50.0, 0.5, False, True),
        (50.0, 6.0, False, False),  # it may be 60°
        (130.0, 0.5, False, True),
        (130.0, 6.0, False, False),
        (90.0, 0.5, False, False),
        (15.0, 2.0, True, False),  # of one frame
    ],
)
def test_the_angle_is_judged_once_it_is_certain(angle, sd_deg, provisional, advised):
    said = {each.topic: each for each in placement(a_calibration(angle, sd_deg, provisional=provisional))}
    assert ("angle" in said) == advised


@pytest.mark.parametrize("sd_deg", [0.5, 3.2])
def test_a_calibration_whose_rotation_is_uncertain_is_not_good(sd_deg):
    said = calibration_advice(a_calibration(90.0, sd_deg)).text
    assert ("Calibration good" in said) == (sd_deg < 2.0)
    assert ("walk a few steps" in said) == (sd_deg > 2.0)


def test_a_calibration_of_one_frame_says_that_it_is_provisional():
    said = calibration_advice(a_calibration(90.0, 3.2, provisional=True, frames=1)).text
    assert said.startswith("Provisional calibration usable: the views differ by 30 mm (of one frame;")
    assert said.endswith("certain to 3.2° only (limit 2°).")  # who holds the start-up pose is not to walk


def test_a_single_pose_is_never_good():
    for body in BODIES.values():
        pose = [pair_of(body, standing(body))]
        assert calibration_advice(calibrate(body, pose, "start-up pose", frontal=True)).text.startswith(
            "Calibration usable"
        )
