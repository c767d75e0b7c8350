"""Where a joint of S* came from, as colours, data, a matrix and lanes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr
from numpy.typing import NDArray

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance.colors import PREDICTED_COLOR, SKELETON_COLORS
from recordings.appearance.joint_trust import StateLanes, TrustMatrix, trust_colors
from recordings.file.rrd_file import RrdFile
from recordings.session_arrays import SessionArrays
from recordings.writing.frame_columns import frame_columns
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames
from tests.helpers.pictures import pixels_near
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import A_FROM_B

BODY = KINECT_V2
ELBOW = BODY.joint("ELBOW_RIGHT")


@pytest.fixture
def rows() -> SessionArrays:
    """Four seconds of both views."""
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    return SessionArrays.stack(BODY, BODY.nominal_lengths, frames(fuser, 120))


def trusting(rows: SessionArrays, in_a: float) -> SessionArrays:
    weights = np.full_like(rows.weights_a, in_a)
    return replace(rows, weights_a=weights, weights_b=1.0 - weights)


def decoded(png: bytes) -> NDArray[np.uint8]:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture[..., ::-1])


def test_a_joint_has_the_colour_of_the_sensor_it_came_from(rows: SessionArrays) -> None:
    a, b = (np.array(SKELETON_COLORS[side]) for side in layout.SIDES)
    assert (trust_colors(trusting(rows, 1.0)) == a).all()
    assert (trust_colors(trusting(rows, 0.0)) == b).all()
    assert (trust_colors(trusting(rows, 0.5)) == SKELETON_COLORS["fused"]).all()
    mostly_a = trust_colors(trusting(rows, 0.75))[0, 0]
    assert np.abs(mostly_a - (a + SKELETON_COLORS["fused"]) / 2.0).max() <= 1.0
    nothing = replace(rows, predicted=np.ones_like(rows.predicted))
    assert (trust_colors(nothing) == PREDICTED_COLOR).all()


def test_the_data_beside_a_joint_names_states_and_the_misleading_joint(rows: SessionArrays) -> None:
    states, misleading = rows.states_b.copy(), rows.misleading.copy()
    states[3, ELBOW] = TrackingState.INFERRED
    misleading[3, ELBOW] = BODY.joint("WRIST_RIGHT")
    misleading[4, ELBOW] = -1
    apart = rows.positions_a.copy()
    apart[3, ELBOW] += np.array([0.03, 0.04, 0.0], dtype=np.float32)
    told = replace(rows, states_b=states, misleading=misleading, positions_a=apart)
    columns = next(columns for entity, _, columns in frame_columns(told) if entity == layout.FUSED_SKELETON)
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


SECOND = 10**9


def pages_of(matrix: TrustMatrix, *blocks: SessionArrays) -> dict[int, bytes]:
    """The pages by the time from which on each is shown, as a reader of the whole file finds them."""
    drawn = [page for block in blocks for page in matrix.add(block)]
    return {time_ns: png for _, time_ns, png in (*drawn, *matrix.rest())}


def column(png: bytes, first_s: float, at_s: float) -> NDArray[np.uint8]:
    """(height, 3) RGB of a moment in a page that begins at `first_s`: 25 pixels a second."""
    return decoded(png)[: 25 * 20, int((at_s - first_s) * 25.0)]


def seconds_of(rows: SessionArrays, seconds: int) -> SessionArrays:
    """A trust history of this length with a frame every 100 ms, all from A."""
    count = seconds * 10
    picked = trusting(rows[np.arange(count) % len(rows)], 1.0)
    index = np.arange(count)
    return replace(picked, frame=index, time_ns=index * (SECOND // 10))


def test_each_moment_of_a_file_is_in_the_page_that_is_shown_at_that_time(rows: SessionArrays) -> None:
    pages = pages_of(TrustMatrix(BODY, 5 * SECOND), seconds_of(rows, 70))
    assert list(pages) == [0, 15 * SECOND, 30 * SECOND, 45 * SECOND, 60 * SECOND]
    for at in range(70):
        shown_from = max(t for t in pages if t <= at * SECOND)
        first = max(0, shown_from // SECOND - 10)
        seen = column(pages[shown_from], first, at + 0.1)
        assert (seen[5] == SKELETON_COLORS["a"]).all(), at
        if first:  # and the ten seconds before the page
            assert (column(pages[shown_from], first, first + 0.1)[5] == SKELETON_COLORS["a"]).all()


def test_pages_are_drawn_while_they_grow(rows: SessionArrays) -> None:
    drawn = list(TrustMatrix(BODY, 5 * SECOND).add(seconds_of(rows, 28)))
    # page 0 after 5, 10, 15 and 20 s, when it still lacks 10 s; the next after 20 and 25 s
    assert [t // SECOND for _, t, _ in drawn] == [0, 0, 0, 15, 15]
    amber = [pixels_near(decoded(png), SKELETON_COLORS["a"], 2) for _, _, png in drawn]
    assert amber[0] < amber[1] < amber[2]


def test_without_drafts_each_page_is_drawn_once_and_is_the_last_draft(rows: SessionArrays) -> None:
    minute = seconds_of(rows, 60)
    sparing = TrustMatrix(rows.body, None)
    once = [*sparing.add(minute), *sparing.rest()]
    drawn = {time_ns: png for _, time_ns, png in once}
    assert len(drawn) == len(once) == 4  # a page begins every 15 s
    assert drawn == pages_of(TrustMatrix(rows.body, 1_000_000_000), minute)


def test_the_matrix_shows_who_was_trusted(rows: SessionArrays) -> None:
    (page,) = pages_of(TrustMatrix(BODY, SECOND), trusting(rows, 1.0)).values()
    a, b = (SKELETON_COLORS[side] for side in layout.SIDES)
    assert pixels_near(decoded(page), a, 2) > 25 * 95 * 15  # 4 s of 25 joints, less the lines between them
    assert pixels_near(decoded(page), b, 2) == 0


def test_a_gap_stays_empty(rows: SessionArrays) -> None:
    all_of = seconds_of(rows, 100)
    with_gap = all_of[np.flatnonzero((all_of.frame < 120) | (all_of.frame >= 800))]
    pages = pages_of(TrustMatrix(BODY, SECOND), with_gap)
    assert list(pages) == [0, 80 * SECOND, 90 * SECOND]
    assert not (column(pages[80 * SECOND], 65, 70.0)[5] == SKELETON_COLORS["a"]).all()
    assert (column(pages[80 * SECOND], 65, 81.0)[5] == SKELETON_COLORS["a"]).all()


def test_the_matrix_is_the_same_frame_by_frame_and_at_once(rows: SessionArrays) -> None:
    at_once = pages_of(TrustMatrix(BODY, SECOND), rows)
    assert pages_of(TrustMatrix(BODY, SECOND), *(rows[[t]] for t in range(len(rows)))) == at_once


def test_a_file_of_ten_seconds_has_lanes_and_a_matrix_to_its_end(rows: SessionArrays, tmp_path: Path) -> None:
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    ten = seconds_of(rows, 10)
    ten.states_a[90:, ELBOW] = TrackingState.INFERRED
    file = tmp_path / "s.rrd"
    stream = rr.RecordingStream(layout.APPLICATION_ID)
    stream.save(file)
    recorder = Recorder(stream, fuser.setup, ("a", "b"))
    recorder.record_rows(ten)
    recorder.finish()
    stream.flush()
    stream.disconnect()
    assert rows_of(file, layout.state_lane("a", BODY.joints[ELBOW])) == 2
    with RrdFile(file) as read:
        drawn = [
            bytes(blob[0])
            for entity, batch in read.chunks(images=True)
            if entity == layout.TRUST_MATRIX
            for blob in batch.column("EncodedImage:blob").to_pylist()
        ]
    filled = [
        (column(drawn[-1], 0, tenth / 10 + 0.05)[5] == SKELETON_COLORS["a"]).all() for tenth in range(100)
    ]
    assert sum(filled) / 10 > 9.0


def test_lanes_are_the_same_frame_by_frame_and_at_once(rows: SessionArrays, tmp_path: Path) -> None:
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
        lane: list[tuple[int, int, list[str]]] = []
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


def test_only_joints_that_change_have_a_lane_and_it_begins_at_the_beginning(rows: SessionArrays) -> None:
    states = rows.states_a.copy()
    states[40:50, ELBOW] = TrackingState.INFERRED
    lanes = StateLanes()
    news = list(lanes.add(replace(rows, states_a=states)))
    assert news == [("a", ELBOW, [(None, 2), (40, 1), (50, 2)])]
    states[:, ELBOW] = TrackingState.NOT_TRACKED
    assert list(lanes.add(replace(rows, states_a=states))) == [("a", ELBOW, [(0, 0)])]
    assert list(lanes.add(replace(rows, states_a=states))) == []
