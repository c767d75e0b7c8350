"""Recordings with people: tracked by the stand-in, or joined with skeletons saved before."""

import numpy as np
import pytest

from devices.azure.mkv import MkvRecording
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.azure.tracking.tracked_recording import RecordingWithSkeletons, TrackedRecording
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import KINECT_V2
from fusion.skeleton import Skeleton
from tests.helpers.mkv_writer import INTERVAL_US, write_mkv

FRAMES = 6
START_NS = 336_277_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_mkv(tmp_path_factory.mktemp("mkv") / "b.mkv", FRAMES, mode="NFOV_UNBINNED")


def _times():
    return [START_NS + index * INTERVAL_US * 1000 for index in range(FRAMES)]


def test_every_recorded_frame_is_tracked(standin, path):
    source = TrackedRecording(MkvRecording(path), TrackerSettings(library=standin.path), standin.path)
    with source:
        frames = list(source.frames())
    assert [frame.time_ns for frame in frames] == _times()
    for frame in frames:
        skeleton = frame.people["7"]
        # The stand-in puts every joint at the depth of the image's first pixel.
        assert skeleton.positions[1, 2] == np.float32(frame.depth[0, 0] / 1000)
        assert skeleton.time_ns == frame.time_ns


def test_a_tracker_that_fails_midway_gives_the_frames_before(standin, path):
    source = TrackedRecording(MkvRecording(path), TrackerSettings(library=standin.path), standin.path)
    with source:
        frames = source.frames()
        assert [next(frames).time_ns for _ in range(3)] == _times()[:3]
        standin.pop_status = 1
        with pytest.raises(DeviceError, match="failed"):
            list(frames)


def test_a_missing_sdk_closes_the_recording_again(path, tmp_path):
    source = TrackedRecording(MkvRecording(path), libk4a=tmp_path / "libk4a.so")
    with pytest.raises(DeviceError, match=r"No library.*Sensor SDK 1\.4"):
        source.__enter__()
    with pytest.raises(DeviceError, match="not open"):
        next(source.recording.frames())


class _Saved(Sensor):
    name, body = "saved.csv", KINECT_V2

    def __init__(self, times):
        self.times = times

    def frames(self):
        for index, time_ns in enumerate(self.times):
            person = Skeleton.of(KINECT_V2, np.full((25, 3), index), time_ns=time_ns)
            yield SensorFrame(time_ns, {str(index): person})


def test_saved_skeletons_join_the_frame_of_their_time(path):
    times = [time_ns + 400_000 for time_ns in _times()]
    del times[2]
    with RecordingWithSkeletons(MkvRecording(path), _Saved(times)) as source:
        frames = list(source.frames())
        assert source.body is KINECT_V2
        assert source.warnings == ["b.mkv: 1 of 6 frames have no saved skeleton."]
    assert [list(frame.people) for frame in frames] == [["0"], ["1"], [], ["2"], ["3"], ["4"]]
    assert all(frame.depth is not None for frame in frames)


def test_skeletons_saved_to_a_file_join_too(path, tmp_path):
    # a file's body is known only once it is open
    rows = [f"{time_ns // 1000},0,SPINE_BASE,0,0,2" for time_ns in _times()]
    saved = tmp_path / "b.csv"
    saved.write_text("\n".join(["time_us,body,joint,x,y,z", *rows]) + "\n", encoding="utf-8")
    with RecordingWithSkeletons(MkvRecording(path), SkeletonRecording(saved)) as source:
        assert [list(frame.people) for frame in source.frames()] == [["0"]] * FRAMES
        assert source.body is KINECT_V2


def test_skeletons_of_another_recording_are_refused(path):
    with (
        RecordingWithSkeletons(MkvRecording(path), _Saved([5_000_000_000])) as source,
        pytest.raises(DeviceError, match=r"No skeleton of saved\.csv falls on a frame of b\.mkv"),
    ):
        list(source.frames())
