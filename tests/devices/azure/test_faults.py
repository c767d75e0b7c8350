"""Faults of Azure Kinects, from the bus to the frames."""

import gc
import sys
from itertools import islice
from pathlib import Path

import pytest

from devices.azure import pyk4a_access
from devices.azure.kinect import KinectSensor
from devices.azure.settings import KinectSettings
from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.tracking.settings import TrackerSettings
from devices.capture.usb import UsbKinect, usb_kinects
from devices.live.sensors import connected_sensors
from devices.sensor import AbsentError, DeviceError
from devices.tracker_choice import choose_tracker
from tests.helpers.standin_camera import VirtualTime
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import plug_in


@pytest.fixture
def device(bus):
    bus.devices = [Device("000123")]
    return bus.devices[0]


def _kinect(serial="000123", **settings):
    return KinectSensor(serial, KinectSettings(**settings), track=False)


@pytest.mark.usefixtures("orbbecs")
def test_a_pyk4a_that_cannot_be_imported_is_told_beside_orbbecs_sdk(monkeypatch, tmp_path):
    (tmp_path / "pyk4a.py").write_text("raise ImportError('libk4a.so.1.4: cannot open shared object file')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pyk4a", raising=False)
    with pytest.raises(DeviceError, match=r"cannot be imported \(libk4a\.so\.1\.4"):
        connected_sensors(choose_tracker("k4abt"))


def test_unplugged_at_open(device, monkeypatch):
    check_jack = KinectSensor._check_jack

    def pull_the_plug(self):
        device.plugged = False
        check_jack(self)

    monkeypatch.setattr(KinectSensor, "_check_jack", pull_the_plug)
    with pytest.raises(DeviceError, match="Kinect 000123"):
        _kinect().__enter__()
    assert device.opened_by is None


def test_unplugged_mid_stream_beside_another(bus, device, monkeypatch, tmp_path):
    bus.devices.append(Device("000456"))
    plug_in(tmp_path, "000456", number=8)
    plug_in(tmp_path, "000123", number=7)
    monkeypatch.setattr(pyk4a_access, "usb_kinects", lambda: usb_kinects(tmp_path))
    with _kinect() as sensor:
        frames = sensor.frames()
        next(frames)
        device.plugged = False
        (tmp_path / "sys/bus/usb/devices/2-7/serial").write_text("")
        with pytest.raises(DeviceError, match="unplugged"):
            next(frames)


def test_an_absent_sensor_offers_none_of_other_software(device, monkeypatch):
    listed = [UsbKinect("000123", Path(), True, 5000), UsbKinect("000456", Path(), True, 5000, "freenect2")]
    monkeypatch.setattr(pyk4a_access, "usb_kinects", lambda: listed)
    with _kinect():
        pass
    device.plugged = False
    del listed[0]
    with pytest.raises(DeviceError) as told:
        _kinect().__enter__()
    assert "000123" in str(told.value)
    assert "000456" not in str(told.value)


@pytest.mark.parametrize(
    ("status", "message"), [(2, "body tracker stalls"), (1, r"body tracker failed \(status 1\)")]
)
def test_tracker_stalls_or_crashes_to_an_error_code(bus, standin, status, message):
    bus.native, bus.devices = standin.library, [Device("000123")]
    with KinectSensor("000123", tracker=TrackerSettings(library=standin.path)) as sensor:
        frames = sensor.frames()
        assert len(list(islice(frames, 2))) == 2
        standin.pop_status = status
        with pytest.raises(DeviceError, match=message):
            list(islice(frames, 5))
        frames.close()


def test_unplugged_beside_another_without_a_usb_list(bus):
    # As on Windows: only the SDK's count of sensors shows that one is missing.
    bus.devices = [Device("000123"), Device("000456")]
    with _kinect("000456"), _kinect("000123") as sensor:
        frames = sensor.frames()
        next(frames)
        bus.devices[0].plugged = False
        with pytest.raises(DeviceError, match="000123 was unplugged or lost its power"):
            next(frames)


def test_an_orbbec_that_is_unplugged_shows_by_time_outs_and_is_called_so(bus):
    device = Device("CL8H741005K", orbbec=True)
    bus.devices = [device]
    device.time = VirtualTime()
    with _kinect("CL8H741005K", stall_s=3.0) as sensor:
        frames = sensor.frames()
        next(frames)
        device.plugged, since_ns = False, device.time.now_ns()
        with pytest.raises(AbsentError, match="was unplugged"):
            next(frames)
        assert device.time.now_ns() - since_ns <= 500_000_000, "at the first time-out"


@pytest.mark.parametrize("sync", ["standalone", "master"])
def test_a_busy_orbbec_shows_late_and_is_called_busy(bus, sync):
    bus.devices = [Device("CL8H741005K", orbbec=True, busy=True)]
    with pytest.raises(DeviceError, match="cannot be opened: it is busy"):
        _kinect("CL8H741005K", sync=sync, trust_jacks=False).__enter__()


def test_a_kinect_says_what_it_waits_for(bus, standin, monkeypatch):
    bus.native, bus.devices = standin.library, [Device("000123")]
    heard = []
    sensor = KinectSensor("000123", tracker=TrackerSettings(library=standin.path))
    open_tracker = BodyTracker.open

    def loading(tracker, calibration):
        heard.append(sensor.waits_for)
        open_tracker(tracker, calibration)

    monkeypatch.setattr(BodyTracker, "open", loading)
    with sensor:
        heard.append(sensor.waits_for)
        frames = sensor.frames()
        bus.devices[0].at[0] = lambda: heard.append("depth")
        pop = BodyTracker.pop
        monkeypatch.setattr(BodyTracker, "pop", lambda *given: heard.append(sensor.waits_for) or pop(*given))
        next(frames)
        frames.close()
    loads, result = "its body tracker, which loads its network", "its body tracker's result"
    assert list(dict.fromkeys(heard)) == [loads, "", "depth", result]
    assert sensor.waits_for == ""
    gc.collect()
