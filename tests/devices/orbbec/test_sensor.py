"""Orbbec sensors, through a stand-in for pyorbbecsdk with the real module's names."""

import itertools
import sys
import time

import numpy as np
import pytest

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.orbbec.sdk_access import connected_orbbecs, how_to_install
from devices.orbbec.sensor import OrbbecSensor
from devices.sensor import DeviceError
from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin import JPEG, Orbbec

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
    expected = [
        ConnectedSensor(
            index,
            serial,
            False,
            False,
            sdk="orbbec",
            description="Orbbec Femto Bolt, USB3.2",
            tells_jacks=False,
        )
        for index, serial in enumerate((A, B))
    ]
    assert connected_orbbecs() == connected_orbbecs() == expected
    assert two.contexts == 1, "each context searches the buses with threads of its own"
    assert two.log_level is values.OBLogLevel.NONE
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
    assert {profile.get_fps() for profile in two.configurations[-1]._profiles} == {15}


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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"depth_mode": "PASSIVE_IR"}, "No depth mode PASSIVE_IR. There are NFOV_UNBINNED"),
        ({"color": "3072P"}, "have no colour 3072P: 720P"),
        ({"color": "1440P"}, r"no colour 1440P \(MJPG\) at 30 fps\. It has 1080P, 720P"),
    ],
)
def test_a_mode_the_sensor_lacks_is_refused(two, settings, message):
    with pytest.raises(DeviceError, match=message):
        _sensor(**settings).__enter__()
    assert two.open_serials == []


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
