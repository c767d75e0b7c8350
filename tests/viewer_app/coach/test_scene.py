"""Drawings of the coach: where to stand, which problem to solve, a better place for B."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.depth.camera import project
from devices.simulated.rig import Rig
from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.appearance.state_card import State
from recordings.quality.limits import FARTHEST_PERSON, nearest
from tests.helpers.two_views import A_FROM_B, calibrated_on, pair_of, standing, turned_around
from viewer_app.coach.advice import Advice
from viewer_app.coach.readiness import Headline
from viewer_app.coach.scene import CoachScene, places
from viewer_app.coach.setup_coach import HOLD, Situation
from viewer_app.coach.standing_spot import ARM, standing_spot
from viewer_app.viewer.blueprint import overview

BODY = KINECT_V2
CAMERA = NOMINAL_INTRINSICS[BODY.name]
CAMERAS = (CAMERA, CAMERA)
KNOWN = Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")
PERSON = standing(BODY)
FEET_GONE = Advice("feet B", "…", "WARN", "B", "feet out of view")


def fused(at=PERSON):
    return Fuser(FusionSetup(KNOWN)).update(pair_of(BODY, at))


def page(now=None, seen=None, *advice, state=State.NOT_YET, kind=""):
    now = now or Situation(KNOWN, final=False, held=0.0)
    return CoachScene(BODY, CAMERAS).page(advice, now, seen, Headline(state, "as advised", kind))


def marks(*given, **more):
    return dict(page(*given, **more).marks)


def middle_of_ring(mark):
    ring = np.array(mark.lines[0])
    assert mark.words_at[1] > ring[0, 1]
    assert ring[0] == pytest.approx(ring[-1])
    return np.asarray(ring[:-1].mean(axis=0))


@pytest.mark.parametrize("b", [None, A_FROM_B])
def test_a_person_with_arms_out_is_fully_in_view_at_the_advised_place(b):
    far = FARTHEST_PERSON[BODY.name]
    spot = standing_spot(b, CAMERAS, far, 1.0)
    assert spot.room > 0.0
    for sensor in (RigidTransform.identity(), b):
        if sensor is None:
            continue
        torso = sensor.inverse().apply([spot.x, 0.0, spot.z])
        assert nearest(CAMERA) <= torso[2] <= far
        for side in (-ARM, ARM):
            pixel = project(CAMERA, torso + [side, 0.0, 0.0])
            assert 0.0 <= pixel[0] <= CAMERA.width


def test_sensors_that_look_away_from_each_other_leave_no_place():
    back = RigidTransform.of(Rotation.from_euler("y", 180, degrees=True).as_matrix(), [0.0, 0.0, 0.0])
    assert standing_spot(back, CAMERAS, FARTHEST_PERSON[BODY.name], 1.0).room < 0.0


def test_the_circle_is_on_the_floor_and_an_arrow_leads_to_it():
    away = fused(PERSON + [1.5, 0.0, 0.3])
    mark = marks(seen=away)["spot"]
    floor = max(away.positions[BODY.joint(f"ANKLE_{side}"), 1] for side in ("LEFT", "RIGHT")) + 0.08
    assert middle_of_ring(mark)[1] == pytest.approx(floor, abs=0.051)  # drawn in steps of 0.1 m
    arrow = np.array(mark.lines[2])
    torso = away.positions[list(BODY.torso)].mean(axis=0)
    assert np.linalg.norm(arrow[0] - torso, axis=0) > 0.3  # on the floor, not in the body
    assert np.abs(arrow[0] - torso)[[0, 2]].max() < 0.051
    along, to_go = (each[[0, 2]] for each in (arrow[1] - arrow[0], middle_of_ring(mark) - arrow[0]))
    assert along / np.linalg.norm(along) == pytest.approx(to_go / np.linalg.norm(to_go), abs=1e-6)


def test_the_pose_is_counted_down_on_the_card_and_the_circle_stays_until_ready():
    spot = standing_spot(A_FROM_B, CAMERAS, FARTHEST_PERSON[BODY.name], 1.0)
    torso = PERSON[list(BODY.torso)].mean(axis=0)
    there = fused(PERSON + [spot.x - torso[0], 0.0, spot.z - torso[2]])
    assert page(seen=there, kind="pose").card == (State.NOT_YET, "as advised")
    now = Situation(KNOWN, final=False, held=HOLD - 1.4)
    assert page(now, there, kind="pose").card == (State.NOT_YET, "Hold still: 2 s")
    assert page(now, there, kind="feet").card == (State.NOT_YET, "as advised")
    for shown in (None, now, replace(now, final=True, held=0.0)):
        assert len(marks(shown, there)["spot"].lines) == 2  # no arrow
    assert "spot" not in marks(now, there, state=State.READY)


def test_before_the_first_person_a_circle_is_shown_in_front_of_a():
    mark = marks(Situation(nominal_calibration(BODY), final=False, held=0.0))["spot"]
    x, y, z = middle_of_ring(mark)
    assert (abs(x), y) == pytest.approx((0.0, 1.0), abs=0.1)
    assert nearest(CAMERA) < z < FARTHEST_PERSON[BODY.name]


def test_a_sensor_with_a_problem_is_marked_where_it_stands():
    problem = Advice("person B", "…", "WARN", "B", "sees no one")
    drawn = marks(None, None, problem, replace(problem, topic="x", level="INFO", sensors="A"))
    assert "sensor_a" not in drawn
    assert drawn["sensor_b"].meaning == "mend"
    edge, first, *_ = drawn["sensor_b"].lines
    assert first[0] == pytest.approx(A_FROM_B.translation)
    assert edge[0] == edge[-1]


@pytest.mark.parametrize("angle", [30.0, 150.0])
def test_b_is_shown_a_place_at_a_right_angle_and_as_far_from_the_person(angle):
    a_from_b = turned_around(angle)
    now = Situation(calibrated_on(BODY, a_from_b), final=True, held=0.0)
    mark = marks(now, fused())["better_b"]
    way = np.array(mark.lines[-1])
    assert way[0] == pytest.approx(a_from_b.translation, abs=1e-3)
    spot = standing_spot(a_from_b, CAMERAS, FARTHEST_PERSON[BODY.name], 1.0)
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
    shown = marks(Situation(calibration, final=known, held=0.0), fused(), FEET_GONE)
    drawn = np.concatenate([line for mark in shown.values() for line in mark.lines])
    for points in (places(setup), drawn if known else drawn[:0]):
        seen = points - eye
        depth = -seen @ back
        assert (depth > 0.0).all()
        # the viewer's eye sees 55° of the height; the scene is wider than high
        assert (np.abs(seen @ np.cross(right, back)) / depth < np.tan(np.radians(27.5))).all()
        assert (np.abs(seen @ right) / depth < 1.4 * np.tan(np.radians(27.5))).all()
