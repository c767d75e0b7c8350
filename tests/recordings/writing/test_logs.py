"""Quality and places in a session: jitter is noise and not motion; a recalibration is one message."""

from dataclasses import replace
from uuid import uuid4

import numpy as np
import pytest
import rerun as rr
from scipy.spatial.transform import Rotation

from fusion.calibration.calibration import Calibration
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.file.rrd_file import RrdFile
from recordings.session import Session
from recordings.writing import changes
from recordings.writing.other_people import OthersLog
from recordings.writing.recorder import Recorder
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.live_frames import BODY, frames, known_fuser, session
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.two_views import A_FROM_B


def logged(path, entity):
    """The scalars of an entity, by frame."""
    found = {}
    with RrdFile(path) as file:
        for of_entity, batch in file.chunks(images=False):
            names = batch.schema.names
            if of_entity == entity and layout.FRAME in names and "Scalars:scalars" in names:
                columns = (batch.column(layout.FRAME), batch.column("Scalars:scalars"))
                found |= dict(zip(*(column.to_pylist() for column in columns), strict=True))
    return found


def test_a_moved_sensor_is_seen_in_millimetres_and_degrees(tmp_path):
    turned = Rotation.from_euler("y", 3.0, degrees=True).as_matrix()
    # 120 mm in all, along each axis
    shift = np.array([0.04, -0.08, 0.08])
    moved = RigidTransform.of(A_FROM_B.rotation @ turned, A_FROM_B.translation + shift)
    calibrations = [
        (0, Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "first")),
        (40, Calibration(BODY, moved, BODY.nominal_lengths, "second")),
    ]
    file = tmp_path / "s.rrd"
    record_recalibrated(file, frame_pairs(BODY, 90), calibrations)
    placement = logged(file, layout.stream_figure("placement"))
    assert sorted(placement) == [2, *range(17, 90, 15)]  # jitter needs three frames
    before = [figures for frame, figures in placement.items() if frame < 40]
    assert len(before) >= 2
    # arccos near 1 magnifies float64 rounding of the trace to sqrt(2 * 1e-15) rad
    np.testing.assert_allclose(before, 0.0, atol=1e-5)
    np.testing.assert_allclose(placement[max(placement)], [120.0, 3.0], rtol=1e-6)


def poses(path, entity):
    """The frames at which a pose was logged."""
    component = "Transform3D:translation"
    found = []
    with RrdFile(path) as file:
        for of_entity, batch in file.chunks(images=False):
            if of_entity == entity and component in batch.schema.names and layout.FRAME in batch.schema.names:
                numbers = batch.column(layout.FRAME).to_pylist()
                values = batch.column(component).to_pylist()
                found += [number for number, value in zip(numbers, values, strict=True) if value]
    return sorted(found)


def written_live(path, count):
    fuser = known_fuser()
    with session(fuser, path) as live:
        for frame in frames(fuser, count):
            live.write(frame)
    return path


def test_a_recalibration_is_one_message(tmp_path):
    moved = RigidTransform.of(A_FROM_B.rotation, A_FROM_B.translation + [0.1, 0.0, 0.0])
    calibrations = [
        (0, Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "first")),
        (40, Calibration(BODY, moved, BODY.nominal_lengths, "second")),
    ]
    file = tmp_path / "s.rrd"
    recorded = record_recalibrated(file, frame_pairs(BODY, 90), calibrations)
    changes = np.flatnonzero((np.diff(recorded.translation, axis=0) != 0.0).any(axis=1)) + 1
    assert poses(file, layout.kinect("b")) == [0, *changes.tolist()]
    assert len(changes) == 1


def test_live_and_saved_sessions_log_the_same_poses(tmp_path):
    live = written_live(tmp_path / "live.rrd", 40)
    again = tmp_path / "again.rrd"
    Session.open(live).save(again)
    assert poses(live, layout.kinect("b")) == poses(again, layout.kinect("b")) == [0]
    assert poses(live, layout.PELVIS) == poses(again, layout.PELVIS) == list(range(40))
    assert poses(again, layout.FLOOR)[-1] == 0  # found in the whole recording, shown from its beginning
    assert len(poses(live, layout.FLOOR)) == 2  # assumed, then found


def test_the_pelvis_keeps_its_place_while_nobody_is_seen(tmp_path):
    made = frames(fuser := known_fuser(), 20)
    for nobody in ([3, 4], range(20)):
        for number in nobody:
            gone = np.full_like(made[number].fused.positions, np.nan)
            made[number] = replace(made[number], fused=replace(made[number].fused, positions=gone))
        file = tmp_path / f"{len(nobody)}.rrd"
        with session(fuser, file) as live:
            for frame in made:
                live.write(frame)
        assert poses(file, layout.PELVIS) == sorted({*range(20)} - {*nobody})


def test_the_others_are_drawn_while_they_are_there(tmp_path):
    pairs = frame_pairs(BODY, 12, noise=0.0)
    fuser = known_fuser()
    for t in range(4, 8):
        a = pairs[t].a
        other = Skeleton.of(BODY, a.people["7"].positions + np.float32(1.0), a.people["7"].states)
        pairs[t] = replace(pairs[t], a=replace(a, people={**a.people, "8": other}))
    path = tmp_path / "s.rrd"
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(path)
    recorder = Recorder(stream, fuser.setup, ("a", "b"))
    recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs])
    recorder.finish()
    stream.disconnect()
    drawn = {}
    with RrdFile(path) as file:
        for entity, batch in file.chunks(images=False):
            if entity in map(layout.others, "ab") and layout.FRAME in batch.schema.names:
                origins = batch.column("Arrows3D:origins").to_pylist()
                for frame, of in zip(batch.column(layout.FRAME).to_pylist(), origins, strict=True):
                    drawn[entity, frame] = len(of)
    assert drawn.keys() == {(layout.others("a"), t) for t in range(4, 9)}  # the last one clears them
    assert drawn.pop((layout.others("a"), 8)) == 0
    assert all(0.5 * len(BODY) < count < len(BODY) for count in drawn.values())
    assert len(Session.open(path)) == 12


def test_a_viewer_s_stream_gets_the_poses_again_and_again(tmp_path, monkeypatch):
    """A hub drops its oldest messages: whoever connects later must find K_B and the floor all the same."""
    monkeypatch.setattr(changes, "_POSE_AGAIN_NS", 990_000_000)  # 30 frames
    fuser = known_fuser()
    made = frames(fuser, 70)
    for points, expected in ((True, [0, 30, 60]), (False, [0])):
        path = tmp_path / f"{points}.rrd"
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
        stream.save(path)
        recorder = Recorder(stream, fuser.setup, ("a", "b"), points=points)
        for frame in made:
            recorder.record_all([frame])
        recorder.finish()
        stream.disconnect()
        assert poses(path, layout.kinect("b")) == expected
        assert set(expected[1:]) <= set(poses(path, layout.FLOOR))


@pytest.mark.parametrize("gap", [10, 60])
def test_the_others_of_a_sensor_that_gives_no_frames_go_after_half_a_second(gap, monkeypatch):
    logged = []
    monkeypatch.setattr(
        OthersLog, "_log", lambda _, side, number, *rest: logged.append((side, number, len(rest[-1])))
    )
    log = OthersLog(rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4()))
    pairs = frame_pairs(BODY, 5, noise=0.0)
    for t in range(5 + gap):
        pair = pairs[min(t, 4)]
        log.record(
            t,
            t * 33_333_333,
            replace(pair, a=pair.a if t < 5 else None, skeletons=replace(pair.skeletons, a=None)),
        )
    of_a = [(number, count > 0) for side, number, count in logged if side == "a"]
    assert of_a == [*((t, True) for t in range(5)), *([(20, False)] if gap > 15 else [])]
