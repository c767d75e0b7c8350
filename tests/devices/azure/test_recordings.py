"""``.mkv`` recordings: images, calibration, damage, and the people in them by a tracker or from a file."""

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.azure.kinect import KinectSensor
from devices.azure.mkv import MkvRecording
from devices.azure.tracking.settings import TrackerSettings
from devices.azure.tracking.tracked_recording import RecordingWithSkeletons, TrackedRecording
from devices.freenect2.sensor import Freenect2Sensor
from devices.recorded.files import depth_offset
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.upright import UprightSensor
from fusion.body import KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from tests.helpers.mkv_writer import INTERVAL_US, depth_image, write_mkv

FRAMES = 12


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_mkv(tmp_path_factory.mktemp("mkv") / "whole.mkv", FRAMES, color=True)


def test_real_recording_gives_its_one_capture(shared):
    with MkvRecording(shared / "azure" / "recording.mkv") as recording:
        (frame,) = recording.frames()
        info = recording.info
        assert recording.warnings == []
    # Start offset 336.277 ms and packet time 463.945 ms, both in the file's own metadata.
    assert frame.time_ns == 336_277_000 + 463_945_000
    assert (frame.depth.shape, frame.ir.shape) == ((576, 640), (576, 640))
    # A room: most pixels have a reading, none beyond the sensor's 5.5 m; a wrong byte order gives 65 m.
    assert (frame.depth > 0).mean() > 0.5
    assert frame.depth.max() < 5500
    assert (info.serial, info.sync_mode, info.depth_mode) == ("001514394512", "STANDALONE", "NFOV_UNBINNED")
    assert info.recorded == "2020-08-31T15:20:37.000000Z"


def test_real_calibration_is_that_of_its_mode(shared):
    with MkvRecording(shared / "azure" / "recording.mkv") as recording:
        depth = recording.info.intrinsics
    # The rule that was checked against the SDK, with the numbers in the file.
    assert depth.fx == pytest.approx(0.4927808940410614 * 1024)
    assert depth.cx == pytest.approx(0.51296979188919067 * 1024 - 192.5)
    assert depth.cy == pytest.approx(0.51692354679107666 * 1024 - 180.5)
    # The file orders k1..k6, codx, cody, p2, p1; OpenCV k1, k2, p1, p2, k3..k6.
    first = (0.54793977737426758, -0.020971370860934258, 2.0557534298859537e-05, -7.2104157879948616e-05)
    last = (-0.00265223, 0.88967907428741455, 0.086130209267139435, -0.013910384848714)
    assert depth.distortion == pytest.approx(first + last)


@pytest.mark.parametrize(
    ("serial", "size", "offset"),
    [("000123", None, 0.010), ("simulated a", None, 0.0), ("7", (512, 424), 0.024)],
)
def test_the_depth_offset_is_that_of_the_sensor(tmp_path, serial, size, offset):
    path, how = tmp_path / "a.mkv", {}
    if size:
        image = np.ones(size[::-1], np.uint16)
        how = {"images": [(image, image)], "lens": Intrinsics(*size, 365.0, 365.0, 256.0, 212.0)}
    write_mkv(path, 1, serial=serial, **how)
    with UprightSensor(MkvRecording(path), 90) as recording:
        assert recording.depth_offset == offset
    assert depth_offset(path) == offset
    assert KinectSensor.depth_offset == 0.010
    assert Freenect2Sensor.depth_offset == 0.024


def test_frames_come_in_order_with_their_images(recording):
    with MkvRecording(recording) as source:
        begun = source.frames()
        next(begun)
        frames = list(source.frames())
        assert len(list(begun)) == FRAMES - 1, "frames can be read again"
        assert source.warnings == []
        assert (source.info.sync_mode, source.info.subordinate_delay_ns) == ("SUBORDINATE", 160_000)
    assert [f.time_ns for f in frames] == [336_277_000 + i * INTERVAL_US * 1000 for i in range(FRAMES)]
    for index, frame in enumerate(frames):
        assert frame.ir is not None
        np.testing.assert_array_equal(frame.depth, depth_image(index))
        np.testing.assert_array_equal(frame.ir, depth_image(index) + 1)


def _frames_of(path):
    with MkvRecording(path) as source:
        return len(list(source.frames())), source.warnings


@given(share=st.floats(0.0, 1.0))
def test_a_recording_cut_anywhere_gives_its_frames_or_says_why(recording, tmp_path, share):
    content = recording.read_bytes()
    length = int(share * len(content))
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(content[:length])
    # A frame is there if its depth image is: the file says where each one starts, and 32 bytes are more than
    # the head of a block takes.
    whole = _depth_images_within(recording, length)
    perhaps = _depth_images_within(recording, length + 32)
    if perhaps == 0:
        with pytest.raises(DeviceError, match=r"cut\.mkv"):
            _frames_of(cut)
    elif whole > 0:
        count, warnings = _frames_of(cut)
        assert whole <= count <= perhaps
        assert count == FRAMES or any("cut off" in warning for warning in warnings)


def _depth_images_within(path, length):
    with av.open(str(path)) as container:
        depth = next(stream for stream in container.streams if stream.metadata.get("title") == "DEPTH")
        return sum(packet.pos + packet.size <= length for packet in container.demux(depth) if packet.size)


@given(flips=st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 255)), min_size=1, max_size=12))
def test_a_damaged_head_gives_frames_or_a_device_error(recording, tmp_path, flips):
    content = bytearray(recording.read_bytes())
    for at, value in flips:
        content[at] = value
    damaged = tmp_path / "damaged.mkv"
    damaged.write_bytes(content)
    try:
        count, _ = _frames_of(damaged)
    except DeviceError:
        count = 0
    assert 0 <= count <= FRAMES


def test_passive_infrared_is_refused_by_name(tmp_path):
    path = write_mkv(tmp_path / "passive.mkv", 1)
    # Same length, so the file stays well-formed.
    path.write_bytes(path.read_bytes().replace(b"NFOV_2X2BINNED", b"PASSIVE_IR\0\0\0\0"))
    with pytest.raises(DeviceError, match=r"PASSIVE_IR.*Supported: NFOV_2X2BINNED, NFOV_UNBINNED"):
        MkvRecording(path).__enter__()


def test_a_mode_that_its_images_contradict_is_refused(tmp_path):
    path = write_mkv(tmp_path / "odd.mkv", 1, mode="NFOV_2X2BINNED")
    path.write_bytes(path.read_bytes().replace(b"NFOV_2X2BINNED", b"NFOV_UNBINNED\0"))
    with pytest.raises(DeviceError, match="640 x 576, but its images are 320 x 288"):
        MkvRecording(path).__enter__()


def test_damaged_calibration_is_reported(tmp_path):
    path = write_mkv(tmp_path / "bad.mkv", 1, calibration=b'{"CalibrationInformation": {}}')
    with pytest.raises(DeviceError, match="calibration cannot be read"):
        MkvRecording(path).__enter__()


@pytest.mark.parametrize("content", [b"", b"not a film", bytes(4096)])
def test_another_kind_of_file_is_refused(tmp_path, content):
    path = tmp_path / "other.mkv"
    path.write_bytes(content)
    with pytest.raises(DeviceError, match="cannot be opened"):
        MkvRecording(path).__enter__()
    with pytest.raises(DeviceError, match="No file"):
        MkvRecording(tmp_path / "none.mkv").__enter__()


TRACKED = 6
START_NS = 336_277_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_mkv(tmp_path_factory.mktemp("mkv") / "b.mkv", TRACKED, mode="NFOV_UNBINNED")


def _times():
    return [START_NS + index * INTERVAL_US * 1000 for index in range(TRACKED)]


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


def test_skeletons_of_another_recording_are_refused(path):
    with (
        RecordingWithSkeletons(MkvRecording(path), _Saved([5_000_000_000])) as source,
        pytest.raises(DeviceError, match=r"No skeleton of saved\.csv falls on a frame of b\.mkv"),
    ):
        list(source.frames())
