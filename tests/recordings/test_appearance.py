"""The capsules of S*, colours that people with red-green colour blindness tell apart, and the floor."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from skimage.color import deltaE_ciede2000, rgb2lab

from fusion.body import BODIES, KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import NO_FRAME, TrackingState
from recordings.appearance.body_shape import (
    bone_vectors,
    capsule_lengths,
    capsule_rotations,
    nose_vectors,
    pelvis_rotations,
)
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.colors import (
    MARK_COLORS,
    PREDICTED_COLOR,
    SIDE_COLORS,
    SKELETON_COLORS,
    STATE_COLORS,
    VIEW_COLORS,
)
from recordings.appearance.floor import ANKLE, CAMERA_HEIGHT, FloorFinder, find_floor, floor_frame
from recordings.appearance.joint_trust import LIMBS, LimbSources, TrustColors, _RunningMean
from recordings.appearance.state_card import LOOKS, State, fits, state_card
from recordings.data import layout
from recordings.data.frame_noise import FrameDeviations, frame_noise_of, noise_of
from recordings.data.session_arrays import SessionArrays
from recordings.writing.changes import Lanes
from recordings.writing.frame_columns import frame_columns
from tests.helpers.live_frames import frames
from tests.helpers.pictures import contrast, linear
from tests.helpers.recalibrated import recorder_to
from tests.helpers.session_text import logged_in
from tests.helpers.two_views import A_FROM_B, standing

STEP = 1.0 / 256.0
"""Of the stored values; each is off by half of it at most."""


@pytest.fixture
def poses():
    """(200, J, 3): joints anywhere, so that bones point anywhere."""
    return np.random.default_rng(0).normal(size=(200, len(KINECT_V2), 3))


def test_a_rotation_turns_the_z_axis_towards_the_parent(poses):
    rotations = capsule_rotations(KINECT_V2, poses)
    child = KINECT_V2.bone_joints
    bones = poses[:, KINECT_V2.parent_indices[child]] - poses[:, child]
    bones /= np.linalg.norm(bones, axis=2, keepdims=True)
    turned = Rotation.from_quat(rotations[:, child].reshape(-1, 4)).apply([0.0, 0.0, 1.0])
    # a quaternion off by √3 · STEP / 2 turns by twice that; −z is replaced within 0.8°
    off = np.arccos(np.clip((turned * bones.reshape(-1, 3)).sum(axis=1), -1.0, 1.0))
    assert off.max() <= 2.0 * np.sqrt(3.0) * STEP / 2.0 + 0.015


def test_straight_down_the_axis_is_turned_round():
    poses = np.zeros((1, len(KINECT_V2), 3))
    poses[0, KINECT_V2.root] = (0.0, 0.0, -1.0)
    child = KINECT_V2.joint("hip left")
    rotation = Rotation.from_quat(capsule_rotations(KINECT_V2, poses)[0, child])
    np.testing.assert_allclose(rotation.apply([0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], atol=1e-6)


def test_a_missing_joint_gets_finite_values():
    poses = np.full((2, len(KINECT_V2), 3), np.nan)
    assert np.isfinite(capsule_rotations(KINECT_V2, poses)).all()
    assert np.isfinite(bone_vectors(KINECT_V2, poses)).all()
    np.testing.assert_array_equal(pelvis_rotations(KINECT_V2, poses), [np.eye(3)] * 2)


def test_vectors_lead_to_the_parent(poses):
    reached = poses + bone_vectors(KINECT_V2, poses)
    child = KINECT_V2.bone_joints
    parents = poses[:, KINECT_V2.parent_indices[child]]
    np.testing.assert_allclose(reached[:, child], parents, rtol=0, atol=0.51 * STEP)


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_capsules_have_the_lengths_of_their_bones_except_head_and_face(body):
    lengths = capsule_lengths(body, body.nominal_lengths)
    face = [j for j, bone in enumerate(body.bones) if bone.split("_")[0] in ("nose", "eye", "ear")]
    assert (lengths[face] == 0.0).all()
    assert lengths[body.root] == 0.0
    head = body.joint("head")
    assert 0.0 < lengths[head] < body.nominal_lengths[head]
    others = np.delete(np.arange(len(body)), [*face, head])
    np.testing.assert_allclose(lengths[others], body.nominal_lengths[others], rtol=1e-6)


def test_pelvis_and_nose_point_forward():
    """The standing person is turned 45° from K_A: their front is half-way between −z and −x."""
    frame = pelvis_rotations(KINECT_V2, standing(KINECT_V2)[None])[0]
    c = np.sqrt(0.5)
    np.testing.assert_allclose(frame, [[-c, 0.0, -c], [0.0, 1.0, 0.0], [c, 0.0, -c]], atol=STEP)
    for body in BODIES.values():
        (nose,) = nose_vectors(body, standing(body)[None])[0]
        np.testing.assert_allclose(nose, 0.15 * np.array([-c, 0.0, -c]), atol=0.02)  # the neck may lean by 8°


PROTAN = (0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)
DEUTAN = (0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)
VISION = np.eye(3), np.array(PROTAN), np.array(DEUTAN)
"""Linear RGB as seen without colour blindness, with protanopia and with deuteranopia: Machado et al. 2009."""
BODY = {**{key: SKELETON_COLORS[key] for key in ("a", "b", "fused")}, "predicted": PREDICTED_COLOR}
DARK, LIGHT = (13, 16, 17), (255, 255, 255)
"""Backgrounds of the viewer's themes and of the page."""


def least_distance(first, second):
    """CIEDE2000 between two colours, the least of all kinds of colour vision."""
    found = []
    for matrix in VISION:
        seen = [np.clip(matrix @ linear(each), 0.0, 1.0) for each in (first, second)]
        srgb = [np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055) for rgb in seen]
        found.append(float(deltaE_ciede2000(*(rgb2lab(rgb) for rgb in srgb))))
    return min(found)


@pytest.mark.parametrize(
    "colors",
    [{"truth": SKELETON_COLORS["truth"], **BODY}, MARK_COLORS, dict(enumerate(STATE_COLORS)), SIDE_COLORS],
    ids=["body and truth", "marks", "states", "sides"],
)
def test_colors_that_stand_side_by_side_differ_for_everyone(colors):
    for one, other in itertools.combinations(colors, 2):
        assert least_distance(colors[one], colors[other]) > 20.0, (one, other)


@pytest.mark.parametrize("side", "ab")
def test_an_exchanged_view_differs_from_its_own_and_from_the_other(side):
    for exchanged in (VIEW_COLORS[side][2], SKELETON_COLORS[f"exchanged_{side}"]):
        assert all(least_distance(exchanged, VIEW_COLORS[other][0]) > 12.0 for other in "ab")


@pytest.mark.parametrize("name", MARK_COLORS)
def test_a_mark_differs_from_the_body(name):
    assert all(least_distance(MARK_COLORS[name], color) > 10.0 for color in BODY.values())


@pytest.mark.parametrize("name", [*BODY, *SIDE_COLORS])
def test_a_color_is_seen_on_dark_and_on_light(name):
    color = {**BODY, **SIDE_COLORS}[name]
    assert contrast(color, DARK) > 3.0
    assert contrast(color, LIGHT) > 2.0


ANKLES = [KINECT_V2.joint("ankle left"), KINECT_V2.joint("ankle right")]


def seen_by(tilt_deg, count=60):
    """(T, J, 3) a standing person as a sensor sees them that is turned about its x axis, and that turn."""
    turn = Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix()
    tilted = RigidTransform.of(turn, np.zeros(3))
    return tilted.apply(np.repeat(standing(KINECT_V2)[None], count, axis=0)), tilted


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0, -20.0])
def test_the_ankles_are_above_the_floor_and_down_is_down(tilt_deg):
    fused, tilted = seen_by(tilt_deg)
    floor = find_floor(KINECT_V2, fused)
    down = tilted.rotation @ [0.0, 1.0, 0.0]
    # trunk and legs of the standing person lean by less than 1°
    assert math.degrees(math.acos(min(1.0, float(floor.rotation[:, 1] @ down)))) < 1.0
    heights = floor.inverse().apply(fused[0, ANKLES])[:, 1]  # y is down: above the floor is negative
    # rounded to centimetres; 1° of lean at 2.6 m moves the floor by 45 mm at most
    np.testing.assert_allclose(heights.max(), -ANKLE, atol=0.005 + 0.045)


@given(roll=st.floats(-180.0, 180.0), tilt=st.floats(-75.0, 75.0))
def test_the_floor_of_a_rolled_sensor_lies_as_that_of_one_that_stands(roll, tilt):
    turn = Rotation.from_euler("z", roll, degrees=True).as_matrix()
    fused, _ = seen_by(tilt)
    rolled = RigidTransform.of(turn, np.zeros(3)).apply(fused)
    upright, found = find_floor(KINECT_V2, fused), find_floor(KINECT_V2, rolled)
    # heights are rounded to centimetres
    np.testing.assert_allclose(found.inverse().apply(rolled), upright.inverse().apply(fused), atol=0.0101)
    assert found.rotation[2, 2] > 0.0  # z is where the sensor looks


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.02, -0.9998)])
def test_a_sensor_that_looks_straight_down_or_up_has_a_floor(up):
    up = np.array(up) / np.linalg.norm(up)
    floor = floor_frame(up, 2.0)
    np.testing.assert_allclose(floor.rotation.T @ floor.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(floor.rotation[:, 1], -up, atol=1e-12)


def test_the_origin_is_below_the_sensor():
    fused, _ = seen_by(12.0)
    floor = find_floor(KINECT_V2, fused)
    below = floor.inverse().apply(np.zeros(3))
    np.testing.assert_allclose(below[[0, 2]], 0.0, atol=1e-9)
    assert below[1] < 0.0


def test_a_floor_is_assumed_found_once_and_reported_again_when_the_sensor_moves():
    finder = FloorFinder(KINECT_V2)
    assert finder.a_from_floor.translation[1] == CAMERA_HEIGHT
    fused, _ = seen_by(0.0, 300)
    assert not finder.add(fused[:5])
    assert finder.add(fused[5:40])
    assert not any(finder.add(fused[k : k + 1]) for k in range(40, 240))
    assert not finder.add(fused[..., [1, 0, 2]])  # the person lies
    tilted, _ = seen_by(10.0, 300)
    assert any(finder.add(tilted[k : k + 1]) for k in range(300))


def test_frames_without_feet_tell_nothing():
    finder = FloorFinder(KINECT_V2)
    fused, _ = seen_by(0.0)
    fused[:, ANKLES[0]] = np.nan
    assert not finder.add(fused)
    assert finder.a_from_floor.translation[1] == CAMERA_HEIGHT


# --- The picture of a set-up's state: told apart by everyone.


def inked(picture, state):
    """Where a picture has more of the ink than of the ground."""
    ink, ground = (np.abs(picture.astype(int) - color).sum(axis=2) for color in LOOKS[state][::-1])
    return ink < ground


@pytest.mark.parametrize("state", State)
def test_ink_stands_out_from_its_ground(state):
    assert contrast(*LOOKS[state]) >= 4.5


def test_states_differ_in_shape_too():
    shapes = [inked(state_card(state, ""), state)[:130, :140] for state in State]
    for k, shape in enumerate(shapes):
        for other in shapes[:k]:
            assert (shape != other).mean() > 0.1


def test_a_long_step_is_drawn_smaller_and_stays_inside():
    long = "Only 30 degrees apart: " * 4
    assert not fits(long)
    assert fits(long[:50])
    picture = inked(state_card(State.NOT_YET, long), State.NOT_YET)
    assert not picture[[0, -1]].any()
    assert not picture[:, [0, -1]].any()


def test_a_file_has_the_state_as_text():
    page = CoachPage("B: mirror image", card=(State.NOT_YET, "Turn mirroring off in B"))
    of_file, of_viewer = (dict(page.entities(card)) for card in (False, True))
    assert layout.COACH_CARD in of_viewer
    assert layout.COACH_CARD not in of_file
    texts = [each[layout.COACH][0].text.as_arrow_array().to_pylist()[0] for each in (of_file, of_viewer)]
    assert texts == ["## NOT YET: Turn mirroring off in B\n\nB: mirror image", "B: mirror image"]


# --- Where a joint of S* came from, as colours, data and lanes.


V2 = KINECT_V2
ELBOW = V2.joint("ELBOW_RIGHT")


@pytest.fixture(scope="module")
def rows():
    """Four seconds of both views."""
    fuser = Fuser(FusionSetup(Calibration(V2, A_FROM_B, V2.nominal_lengths, "known")))
    return SessionArrays.stack(V2, V2.nominal_lengths, frames(fuser, 120))


def trusting(rows, in_a):
    weights = np.full_like(rows.weights_a, in_a)
    return replace(rows, weights_a=weights, weights_b=1.0 - weights)


def test_a_joint_has_the_colour_of_the_sensor_it_came_from(rows):
    a, b = (np.array(SKELETON_COLORS[side]) for side in layout.VIEWS)
    assert (TrustColors().add(trusting(rows, 1.0)) == a).all()
    assert (TrustColors().add(trusting(rows, 0.0)) == b).all()
    assert (TrustColors().add(trusting(rows, 0.5)) == SKELETON_COLORS["fused"]).all()
    mostly_a = TrustColors().add(trusting(rows, 0.75))[0, 0]
    assert np.abs(mostly_a - (a + SKELETON_COLORS["fused"]) / 2.0).max() <= 1.0
    none = np.zeros_like(rows.states_a)
    nothing = replace(rows, states_a=none, states_b=none)
    assert (TrustColors().add(nothing) == PREDICTED_COLOR).all()


def test_frames_of_one_view_in_turn_share_the_trust(rows):
    weights = np.zeros_like(rows.weights_a)
    weights[::2] = 1.0
    told = replace(rows, weights_a=weights, weights_b=1.0 - weights)
    np.testing.assert_allclose(TrustColors().shares(told)[90:], 0.5, atol=0.06)


def test_a_frame_that_a_sensor_repeats_does_not_flash(rows):
    even = trusting(rows, 0.5)
    weights_a, weights_b = even.weights_a.copy(), even.weights_b.copy()
    weights_a[60], weights_b[60] = 0.0, 1.0  # A repeats its frame
    weights_a[90] = weights_b[90] = 0.0  # both do
    predicted = even.predicted.copy()
    predicted[90] = True
    told = replace(even, weights_a=weights_a, weights_b=weights_b, predicted=predicted)
    assert (TrustColors().add(told) == SKELETON_COLORS["fused"]).all()


def test_a_frame_that_the_other_sensor_has_none_for_does_not_flash(rows):
    """A sees no one; B sees the person in every second frame, until it is gone."""
    states_b, clock_b = rows.states_b.copy(), rows.clock_b.copy()
    states_b[1::2], clock_b[1::2] = 0, NO_FRAME
    states_b[60:], clock_b[60:] = 0, NO_FRAME
    told = replace(rows, states_a=np.zeros_like(rows.states_a), states_b=states_b, clock_b=clock_b)
    grey = (TrustColors().add(told) == PREDICTED_COLOR).all(axis=(1, 2))
    assert not grey[:60].any()
    assert grey[67:].all()  # 0.2 s later
    parts = TrustColors()
    each = [parts.add(told[slice(k, k + 7)]) for k in range(0, len(told), 7)]
    np.testing.assert_array_equal(np.concatenate(each), TrustColors().add(told))


def test_the_colours_follow_the_trust_of_the_last_second(rows):
    weights = np.zeros_like(rows.weights_a)
    weights[60:] = 1.0  # B until frame 60, then A
    colors = TrustColors().add(replace(rows, weights_a=weights, weights_b=1.0 - weights))
    assert (colors[59] == SKELETON_COLORS["b"]).all()
    # after a second exp(-1) of the mean is of B, after another 14 %
    near_a = np.abs(colors[[62, 75, 90, 119]].astype(float) - SKELETON_COLORS["a"]).sum(axis=-1).mean(axis=-1)
    assert (np.diff(near_a) < 0.0).all()


def test_the_data_beside_a_joint_names_states_and_the_misleading_joint(rows):
    states, misleading = rows.states_b.copy(), rows.misleading.copy()
    states[3, ELBOW] = TrackingState.INFERRED
    misleading[3, ELBOW] = V2.joint("WRIST_RIGHT")
    misleading[4, ELBOW] = -1
    apart = rows.positions_a.copy()
    apart[3, ELBOW] += np.array([0.03, 0.04, 0.0], dtype=np.float32)
    told = replace(rows, states_b=states, misleading=misleading, positions_a=apart)
    entities = frame_columns(told, colors=TrustColors().add(told))
    columns = next(columns for entity, _, columns in entities if entity == layout.FUSED_SKELETON)
    said = {
        column.component_descriptor().component: np.array(column.as_arrow_array().to_pylist())
        for column in columns
    }
    assert said["state_a"][3, ELBOW] == "tracked"
    assert said["state_b"][3, ELBOW] == "inferred"
    assert said["misleading_joint"][3, ELBOW] == V2.joints[V2.joint("WRIST_RIGHT")]
    assert said["misleading_joint"][4, ELBOW] == "none"
    # the views agree, and then one is moved by 50 mm; whole millimetres
    assert said["view_difference_mm"][2, ELBOW] == 0.0
    assert said["view_difference_mm"][3, ELBOW] == 50.0
    assert said["weight_a"][3, ELBOW] == np.float16(rows.weights_a[3, ELBOW])


def test_a_limb_follows_the_view_that_most_of_its_weight_comes_from(rows):
    for in_a, source in ((1.0, 0), (0.0, 1), (0.5, 2)):
        assert (LimbSources(V2).add(trusting(rows, in_a)) == source).all()
    arm = [V2.joint(f"{n}_RIGHT") for n in ("SHOULDER", "ELBOW", "WRIST", "HAND", "HAND_TIP", "THUMB")]
    predicted = np.zeros_like(rows.predicted)
    predicted[60:, arm] = True
    sources = LimbSources(V2).add(replace(trusting(rows, 1.0), predicted=predicted))
    assert (np.delete(sources, LIMBS.index("right arm"), axis=1) == 0).all()
    lane = sources[:, LIMBS.index("right arm")]
    assert lane[59] == 0
    assert (lane[75:] == 3).all()
    changes = np.flatnonzero(np.diff(lane))
    assert changes.tolist() == [65]  # 1 - 0.9^7 is the first share above a half


def test_sources_of_limbs_are_the_same_frame_by_frame_and_at_once(rows):
    at_once, each = LimbSources(V2), LimbSources(V2)
    by_frame = np.concatenate([each.add(rows[[t]]) for t in range(len(rows))])
    np.testing.assert_array_equal(at_once.add(rows), by_frame)


def test_lanes_are_the_same_frame_by_frame_and_at_once(rows, tmp_path):
    states = np.full_like(rows.states_a, TrackingState.TRACKED)
    states[40:45, ELBOW], states[90:, ELBOW] = TrackingState.INFERRED, TrackingState.NOT_TRACKED
    changing = replace(rows, states_a=states, states_b=np.full_like(states, TrackingState.TRACKED))
    fuser = Fuser(FusionSetup(Calibration(V2, A_FROM_B, V2.nominal_lengths, "known")))
    for parts in ([changing], [changing[[t]] for t in range(len(rows))]):
        file = tmp_path / f"{len(parts)}.rrd"
        with recorder_to(file, fuser.setup) as recorder:
            for part in parts:
                recorder.record_rows(part)
        lane = layout.state_lane("a", V2.joints[ELBOW])
        assert logged_in(file, lane, "StateChange:state") == [
            (0, ["tracked"]),
            (40, ["inferred"]),
            (45, ["tracked"]),
            (90, ["not tracked"]),
        ]
        times = [at / np.timedelta64(1, "ns") for _, at in logged_in(file, lane, "time")]
        assert times[1:] == list(rows.time_ns[[40, 45, 90]])


def test_only_joints_that_change_have_a_lane_and_it_begins_at_the_beginning(rows):
    states = rows.states_a.copy()
    states[40:50, ELBOW] = TrackingState.INFERRED
    lanes = Lanes()
    assert list(lanes.add(states)) == [(ELBOW, [(None, 2), (40, 1), (50, 2)])]
    states[:, ELBOW] = TrackingState.NOT_TRACKED
    assert list(lanes.add(states)) == [(ELBOW, [(0, 0)])]
    assert list(lanes.add(states)) == []
    steady = Lanes(steady=True)
    assert dict(steady.add(states))[ELBOW] == [(None, 0)]
    assert list(steady.add(states)) == []


# --- Noise and what is shown of the last second, at any frame rate.


SPEED = np.array([0.6, -0.5, 0.9])  # m/s


def times_of(rng, rate, uneven, count):
    """Nanoseconds of frames whose intervals differ by up to a share of the usual one."""
    return (np.cumsum(1.0 + rng.uniform(-uneven, uneven, count)) * 1e9 / rate).astype(np.int64)


@given(
    rate=st.sampled_from([8, 10, 15, 30, 60, 90]),
    uneven=st.sampled_from([0.0, 0.1, 0.45]),
    every=st.sampled_from([1, 2]),
    sigma=st.sampled_from([0.0, 0.002, 0.02]),
    seed=st.integers(0, 99),
)
def test_noise_is_its_own_size_and_even_movement_is_none(rate, uneven, every, sigma, seed):
    """Whatever the rate, the times, and whether a sensor gives every second frame only."""
    rng, count = np.random.default_rng(seed), 3000
    time_ns = times_of(rng, rate * every, uneven, count)
    at = SPEED * (time_ns * 1e-9)[:, None, None] + rng.normal(0.0, sigma, (count, 2, 3))
    at[np.arange(count) % every != 0] = np.nan
    # The median of 1,500 correlated lengths has a standard error of 2 %.
    expected = pytest.approx(np.sqrt(3.0) * sigma, rel=0.08, abs=1e-9)
    assert frame_noise_of(at, time_ns).tolist() == [expected, expected]
    parts = FrameDeviations()
    each = [parts.add(at[k : k + 7], time_ns[k : k + 7]) for k in range(0, count, 7)]
    np.testing.assert_array_equal(np.concatenate(each), FrameDeviations().add(at, time_ns))


def test_no_noise_is_told_across_a_gap_or_below_seven_frames_per_second():
    still = np.zeros((9, 1, 3))
    still[5:] += 0.3
    time_ns = np.array([0, 1, 2, 3, 4, 19, 20, 21, 22]) * 33_333_333
    assert frame_noise_of(still, time_ns)[0] == 0.0
    assert np.isnan(frame_noise_of(still, np.arange(9) * 200_000_000)[0])
    still[3] = np.nan
    assert np.isnan(noise_of(FrameDeviations().add(np.full((10, 5, 3), np.nan), np.arange(10)))).all()


@given(rate=st.sampled_from([5, 10, 30, 90]), uneven=st.sampled_from([0.0, 0.45]), seed=st.integers(0, 99))
def test_what_is_shown_of_the_last_second_does_not_depend_on_the_rate(rate, uneven, seed):
    """The answer to a step from 1 to 0 is an exponential in seconds: e⁻¹ remains after the time constant."""
    time_ns = times_of(np.random.default_rng(seed), rate, uneven, 4 * rate)
    values = np.concatenate(([1.0], np.zeros(len(time_ns))))
    mean = _RunningMean(0.5).add(values, np.concatenate(([0], time_ns)))[1:]
    np.testing.assert_allclose(mean, np.exp(-time_ns * 2e-9), rtol=1e-9)
