"""Orbbec sensors, through a stand-in for pyorbbecsdk with the real module's names."""

import itertools
import sys
import time

import numpy as np
import pytest

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.orbbec.playback import OrbbecRecording
from devices.orbbec.sdk_access import connected_orbbecs, how_to_install
from devices.orbbec.sensor import OrbbecSensor
from devices.recorded.files import open_source
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice
from fusion.body import BLAZEPOSE
from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin import JPEG, Bag, Orbbec
from tests.helpers.orbbec.standin_values import OBError
from tests.helpers.standin_camera import VirtualTime

A, B = "CL8H741005K", "CL8H7410123"
MODES = values.OBMultiDeviceSyncMode


@pytest.fixture
def two(orbbecs):
    orbbecs.devices = [Orbbec(A), Orbbec(B)]
    return orbbecs


def _sensor(serial=A, **settings):
    return OrbbecSensor(serial, CaptureSettings(**settings))


def test_listing_opens_nothing_and_takes_one_context(two):
    two.devices[1].busy = True
    of_each = {"sdk": "orbbec", "description": "Orbbec Femto Bolt, USB3.2", "tells_jacks": False}
    expected = [
        ConnectedSensor(index, serial, False, False, **of_each) for index, serial in enumerate((A, B))
    ]
    assert connected_orbbecs() == connected_orbbecs() == expected
    assert two.contexts == 1, "each context searches the buses with threads of its own"
    assert two.log_level is values.TYPES["OBLogLevel"].NONE
    assert two.open_serials == []


def test_frames_carry_depth_infrared_and_the_sensors_own_time(two):
    before_ns = time.perf_counter_ns() - 1000  # the SDK's times are whole microseconds
    with _sensor() as sensor:
        assert two.open_serials == [A]
        first, second = itertools.islice(sensor.frames(), 2)
    assert (first.time_ns, second.time_ns) == (1_033_333_000, 1_066_666_000)
    assert (first.depth.shape, first.depth.dtype, int(first.depth[0, 0])) == ((576, 640), np.uint16, 2001)
    assert (first.ir.shape, first.ir.dtype, int(first.ir[0, 0])) == ((576, 640), np.uint16, 90)
    assert first.people == {}
    assert before_ns <= first.host_ns <= time.perf_counter_ns()
    assert two.devices[0].synced_with_host == 1
    assert (two.open_serials, two.running) == ([], [])


def test_intrinsics_are_the_sdks_in_opencvs_order(two):
    with _sensor() as sensor:
        lens = sensor.intrinsics
    assert (lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy) == (640, 576, 504, 505, 332, 348)
    assert lens.distortion == (0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)
    assert sensor.warnings == []
    two.devices[0].distortion = "KANNALA_BRANDT4"
    with _sensor() as sensor:
        assert sensor.intrinsics.distortion == (), "not OpenCV's model"
        assert "KANNALA_BRANDT4 is not known" in sensor.warnings[0]
    with _sensor(depth_mode="WFOV_2X2BINNED", fps=15) as sensor:
        assert (sensor.intrinsics.width, sensor.intrinsics.height) == (512, 512)
    assert {profile.get_fps() for profile in two.configurations[-1].profiles} == {15}


def test_colour_comes_as_the_camera_compressed_it_with_lens_and_place(two):
    with _sensor(color="720P") as sensor:
        frame = next(sensor.frames())
    assert frame.color.jpeg == JPEG
    assert frame.color.camera.intrinsics.width == 1280
    assert frame.color.camera.color_from_depth.translation.tolist() == pytest.approx([-0.032, 0.0, 0.004])
    two.devices[0].color = False  # the camera fails
    with _sensor(color="720P") as sensor:
        frame = next(sensor.frames())
    assert frame.color is None
    assert frame.depth is not None


def test_a_stereo_sensor_gives_millimetres_and_8_bit_infrared(orbbecs):
    orbbecs.devices = [Orbbec.gemini("AY8T43E0031", scale=0.5, stereo=True)]
    with _sensor("AY8T43E0031") as sensor:
        assert (sensor.intrinsics.width, sensor.intrinsics.height) == (640, 400), "nearest to 640 wide"
        frame = next(sensor.frames())
    assert int(frame.depth[0, 0]) == round(2001 * 0.5)
    assert int(frame.ir[0, 0]) == 90
    with pytest.raises(DeviceError, match=r"no depth mode WFOV_2X2BINNED.*640×400; leave `depth_mode` out"):
        _sensor("AY8T43E0031", depth_mode="WFOV_2X2BINNED").__enter__()


def test_a_sensor_without_infrared_of_depths_size_is_refused(two):
    two.devices[0].infrared_sizes = ((1280, 800),)
    with pytest.raises(DeviceError, match="no infrared image of its depth image's size"):
        _sensor().__enter__()
    two.devices[0].infrared_sizes, two.devices[0].calibrated = None, False
    with pytest.raises(DeviceError, match="gives no calibration"):
        _sensor().__enter__()
    assert two.open_serials == []


def test_the_sensor_takes_its_place_on_the_sync_cable(orbbecs):
    orbbecs.devices = [Orbbec(A), Orbbec.gemini("AY8T43E0031"), Orbbec(B)]
    follower = _sensor("AY8T43E0031", sync="subordinate")
    with _sensor(A, sync="subordinate"), follower, _sensor(B, sync="master"):
        femto, gemini, primary = (device.sync for device in orbbecs.devices)
    assert (femto["mode"], femto["delay_us"], femto["color_delay_us"]) == (MODES.SECONDARY, 160, 160)
    assert (gemini["mode"], gemini["delay_us"]) == (MODES.SECONDARY_SYNCED, 160)
    assert (primary["mode"], primary["delay_us"], primary["out"]) == (MODES.PRIMARY, 0, True)
    assert orbbecs.started == [A, "AY8T43E0031", B]


def test_a_sensor_left_as_secondary_is_set_to_standalone_and_one_that_drops_its_delay_is_named(two):
    two.devices[0].sync = {"mode": MODES.SECONDARY, "delay_us": 160}
    with _sensor() as sensor:
        next(sensor.frames())
    assert two.devices[0].sync["mode"] is MODES.STANDALONE
    two.devices[0].keeps_delay = False
    with _sensor(sync="subordinate") as sensor:
        assert "captures 0 µs after the pulse instead of 160 µs" in sensor.warnings[0]


def test_a_sensor_without_a_sync_port_runs_alone_only(two):
    two.devices[0].modes = ()
    with _sensor() as sensor:
        next(sensor.frames())
    with pytest.raises(DeviceError, match="cannot be a sync cable's primary"):
        _sensor(sync="master").__enter__()
    assert two.open_serials == []


def test_frames_without_the_sensors_time_have_the_hosts_and_a_warning(two):
    two.devices[0].timed = False
    with _sensor() as sensor:
        frame = next(sensor.frames())
        assert frame.time_ns == frame.host_ns
        assert "gives no times of its own clock" in sensor.warnings[0]


def test_without_the_package_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    with pytest.raises(DeviceError, match=r"pyorbbecsdk2.*pip install --upgrade --no-deps pyorbbecsdk2"):
        connected_orbbecs()
    assert "3.11 to 3.13 only" in how_to_install((3, 14))


# --- Faults of a live Orbbec sensor: the same as those of an Azure Kinect.


A, B = "CL8H741005K", "CL8H7410123"


@pytest.fixture
def one(orbbecs):
    orbbecs.devices = [Orbbec(A)]
    return orbbecs.devices[0]


def test_the_search_for_sensors_fails(orbbecs):
    orbbecs.fault = OBError("libusb: no permission")
    with pytest.raises(DeviceError, match=r"cannot search for sensors \(libusb: no per.*99-obsensor"):
        connected_orbbecs()


def test_unplugged_at_open(one, orbbecs, monkeypatch):
    read = OrbbecSensor._read_calibration

    def pull_the_plug(self, *arguments):
        read(self, *arguments)
        one.plugged = False

    monkeypatch.setattr(OrbbecSensor, "_read_calibration", pull_the_plug)
    with pytest.raises(DeviceError, match=f"Orbbec {A} was unplugged or lost its power"):
        _sensor().__enter__()
    assert orbbecs.open_serials == []


def test_cameras_that_do_not_start_leave_the_sensor_closed(one, orbbecs):
    one.starts = False
    with pytest.raises(DeviceError, match=r"did not start its cameras \(Failed.*two USB controllers"):
        _sensor().__enter__()
    assert orbbecs.open_serials == []


def test_a_fault_of_the_sdk_mid_stream(one):
    def fails():
        raise OBError("frame queue overflow")

    one.at[1] = fails
    with _sensor() as sensor:
        frames = sensor.frames()
        with pytest.raises(DeviceError, match=r"stopped giving frames \(frame queue overflow\)\. Unplug it"):
            next(frames)


# --- Recordings of Orbbec's SDK v2, through the stand-in's ``PlaybackDevice``.


OURS = TrackerChoice("blazepose", "a test")


def _bag(bus, path, frames=5, **faults):
    path.touch()
    ends = bool(faults.pop("ends", True))
    bus.bags[str(path)] = Bag(Orbbec(path.stem, **faults), frames, ends)
    return path


def test_a_recording_gives_its_frames_and_ends(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with OrbbecRecording(path) as recording:
        frames = list(recording.frames())
        assert (recording.intrinsics.width, recording.intrinsics.fx) == (640, 504)
        assert (recording.duration_ns, recording.interval_ns) == (166_000_000, 33_333_333)
    assert [frame.time_ns for frame in frames] == [1_000_000_000 + 33_333_000 * k for k in range(1, 6)]
    assert all(frame.depth is not None and frame.ir is not None for frame in frames)
    assert recording.warnings == []
    assert orbbecs.running == []
    with OrbbecRecording(_bag(orbbecs, tmp_path / "b.bag", skips=2)) as recording:
        assert len(list(recording.frames())) == 5
    assert "frames are missing: 8;" in recording.warnings[0]


def _recording(bus, path):
    """A recording that is played in virtual time."""
    bus.time = VirtualTime()
    return OrbbecRecording(path, lambda: 1e-9 * bus.time.now_ns())


def test_a_recording_that_never_reports_its_end_is_abandoned(orbbecs, tmp_path):
    with _recording(orbbecs, _bag(orbbecs, tmp_path / "a.bag", ends=False)) as recording:
        assert len(list(recording.frames())) == 5


@pytest.mark.parametrize("ends", [True, False])
def test_a_recording_that_ends_early_is_told(orbbecs, tmp_path, ends):
    with _recording(orbbecs, _bag(orbbecs, tmp_path / "a.bag", 90, ends=ends)) as recording:
        orbbecs.bags[str(recording.path)].frames = 30
        assert len(list(recording.frames())) == 30
    (said,) = recording.warnings
    assert "depth ended early: 30 frames of the first 1.0 of 3.0 s could be read" in said
    with (
        _recording(orbbecs, _bag(orbbecs, tmp_path / "b.bag", 0)) as recording,
        pytest.raises(DeviceError, match="holds no complete frame"),
    ):
        list(recording.frames())


def test_a_fault_of_closing_does_not_hide_what_was_read(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with OrbbecRecording(path) as recording:
        frames = recording.frames()
        next(frames)
        orbbecs.bags[str(path)].sensor.plugged = False  # the stand-in's stop now fails
        frames.close()


def test_a_file_that_is_not_a_recording_is_refused(orbbecs, tmp_path):
    other = tmp_path / "other.bag"
    with pytest.raises(DeviceError, match="No file"):
        OrbbecRecording(other).__enter__()
    other.write_bytes(b"something else")
    with pytest.raises(DeviceError, match=r"other\.bag cannot be read \(Error reading.*OrbbecViewer"):
        OrbbecRecording(other).__enter__()
    blind = _bag(orbbecs, tmp_path / "blind.bag", sizes=())
    with pytest.raises(DeviceError, match=r"blind\.bag has no depth stream"):
        OrbbecRecording(blind).__enter__()


def test_k4abt_cannot_be_asked_for(orbbecs, tmp_path):
    path = _bag(orbbecs, tmp_path / "a.bag")
    with pytest.raises(DeviceError, match=r"a\.bag: k4abt accepts images of libk4a only"):
        open_source(path, tracker=TrackerChoice("k4abt", "asked for with --tracker", asked=True))
    assert open_source(path, tracker=TrackerChoice("k4abt", "it works")).body is BLAZEPOSE
