"""The point clouds of a saved session are computed when it is viewed."""

import shutil

import pytest

from devices.depth.point_cloud import depth_to_points, ray_table
from recordings import Session
from recordings.data import layout
from recordings.file.rrd_file import RrdFile
from tests.helpers.live_frames import frames, known_fuser, session
from tests.helpers.machine import need_viewer
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer import stored_clouds
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.stored_clouds import add_computed, clouds, has_depth
from viewer_app.viewer.window import start_viewer


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Two seconds with depth images of both sensors."""
    file = tmp_path_factory.mktemp("clouds") / "s.rrd"
    fuser = known_fuser()
    with session(fuser, file) as live:
        for frame in frames(fuser, 60, depth=True):
            live.write(frame)
    return file


@pytest.fixture
def saved(recorded, tmp_path):
    """A copy, which a test may delete."""
    return shutil.copy(recorded, tmp_path / "saved.rrd")


def test_clouds_come_by_turns_and_evenly_in_time(saved, monkeypatch):
    monkeypatch.setattr(stored_clouds, "_MOST", 20)
    made = [(side, frame) for side, frame, _ in clouds(Session.open(saved))]
    assert made == [(side, frame) for frame in range(0, 60, 6) for side in layout.VIEWS]


def test_a_cloud_is_a_part_of_the_points_of_its_image(saved):
    opened = Session.open(saved)
    side, frame, points = next(clouds(opened))
    _, image = next(iter(opened.depth(side, frame)))
    every = {tuple(p) for p in depth_to_points(image, ray_table(opened.intrinsics_a)).tolist()}
    assert 1000 < len(points) < len(every)
    assert {tuple(p) for p in points.tolist()} <= every


def test_only_a_session_with_images_has_clouds(saved, tmp_path):
    assert has_depth(Session.open(saved))
    file = tmp_path / "none.rrd"
    fuser = known_fuser()
    with session(fuser, file) as live:
        for frame in frames(fuser, 5):
            live.write(frame)
    assert not has_depth(Session.open(file))


def url_of(port):
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def test_the_viewer_gets_clouds_and_the_quality_of_seconds_into_the_session_although_the_file_is_deleted(
    saved,
):
    from rerun.experimental import ViewerClient

    need_viewer()
    with RrdFile(saved) as file:
        identity = file.identity()
    with saved.open("rb") as opened:
        viewer, port = start_viewer(["--headless", "-"], opened)
        program = add_computed(opened, url_of(port))
    saved.unlink()
    try:
        assert program.wait(timeout=60.0) == 0
        client = ViewerClient.connect(url_of(port))

        def arrived():
            ids = [recording.store_id for recording in client.get_state().recordings]
            if ids != [f"Recording:{identity[0]}:{identity[1]}"]:
                return False
            schema = client.get_recording_schema(store_id=ids[0])
            if layout.SECONDS_LANE not in str(schema):
                return False
            with_data = str(schema).split(layout.points("b"), 1)
            return len(with_data) == 2 and "Points3D:positions" in with_data[1][:1500]

        assert eventually(arrived, 30.0)
    finally:
        stop(viewer)
