"""Where a joint of S* came from, as colours, data and lanes."""

from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import NO_FRAME, TrackingState
from recordings.appearance.colors import PREDICTED_COLOR, SKELETON_COLORS
from recordings.appearance.joint_trust import LIMBS, LimbSources, TrustColors
from recordings.data import layout
from recordings.data.session_arrays import SessionArrays
from recordings.file.rrd_file import RrdFile
from recordings.writing.changes import Lanes
from recordings.writing.frame_columns import frame_columns
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames
from tests.helpers.two_views import A_FROM_B

BODY = KINECT_V2
ELBOW = BODY.joint("ELBOW_RIGHT")


@pytest.fixture
def rows():
    """Four seconds of both views."""
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    return SessionArrays.stack(BODY, BODY.nominal_lengths, frames(fuser, 120))


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
    misleading[3, ELBOW] = BODY.joint("WRIST_RIGHT")
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
    assert said["misleading_joint"][3, ELBOW] == BODY.joints[BODY.joint("WRIST_RIGHT")]
    assert said["misleading_joint"][4, ELBOW] == "none"
    # the views agree, and then one is moved by 50 mm; whole millimetres
    assert said["view_difference_mm"][2, ELBOW] == 0.0
    assert said["view_difference_mm"][3, ELBOW] == 50.0
    assert said["weight_a"][3, ELBOW] == np.float16(rows.weights_a[3, ELBOW])


def test_a_limb_follows_the_view_that_most_of_its_weight_comes_from(rows):
    for in_a, source in ((1.0, 0), (0.0, 1), (0.5, 2)):
        assert (LimbSources(BODY).add(trusting(rows, in_a)) == source).all()
    arm = [BODY.joint(f"{n}_RIGHT") for n in ("SHOULDER", "ELBOW", "WRIST", "HAND", "HAND_TIP", "THUMB")]
    predicted = np.zeros_like(rows.predicted)
    predicted[60:, arm] = True
    sources = LimbSources(BODY).add(replace(trusting(rows, 1.0), predicted=predicted))
    assert (np.delete(sources, LIMBS.index("right arm"), axis=1) == 0).all()
    lane = sources[:, LIMBS.index("right arm")]
    assert lane[59] == 0
    assert (lane[75:] == 3).all()
    changes = np.flatnonzero(np.diff(lane))
    assert changes.tolist() == [65]  # 1 - 0.9^7 is the first share above a half


def test_sources_of_limbs_are_the_same_frame_by_frame_and_at_once(rows):
    at_once, each = LimbSources(BODY), LimbSources(BODY)
    by_frame = np.concatenate([each.add(rows[[t]]) for t in range(len(rows))])
    np.testing.assert_array_equal(at_once.add(rows), by_frame)


def test_lanes_are_the_same_frame_by_frame_and_at_once(rows, tmp_path):
    states = np.full_like(rows.states_a, TrackingState.TRACKED)
    states[40:45, ELBOW], states[90:, ELBOW] = TrackingState.INFERRED, TrackingState.NOT_TRACKED
    changing = replace(rows, states_a=states, states_b=np.full_like(states, TrackingState.TRACKED))
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    for parts in ([changing], [changing[[t]] for t in range(len(rows))]):
        file = tmp_path / f"{len(parts)}.rrd"
        stream = rr.RecordingStream(layout.APPLICATION_ID)
        stream.save(file)
        recorder = Recorder(stream, fuser.setup, ("a", "b"))
        for part in parts:
            recorder.record_rows(part)
        stream.flush()
        stream.disconnect()
        lane = []
        with RrdFile(file) as read:
            for entity, batch in read.chunks(images=False):
                if entity == layout.state_lane("a", BODY.joints[ELBOW]) and "frame" in batch.schema.names:
                    columns = (
                        batch.column(name).to_pylist() for name in ("frame", "time", "StateChange:state")
                    )
                    lane += [(frame, time, state) for frame, time, state in zip(*columns, strict=True)]
        names = [(frame, states) for frame, _, states in lane]
        assert names == [(0, ["tracked"]), (40, ["inferred"]), (45, ["tracked"]), (90, ["not tracked"])]
        assert [at / np.timedelta64(1, "ns") for _, at, _ in lane][1:] == list(rows.time_ns[[40, 45, 90]])


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
