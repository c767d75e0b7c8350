"""Faults of a live Orbbec sensor: the same as those of an Azure Kinect."""

import os

import pytest

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.orbbec import sdk_access
from devices.orbbec.sdk_access import connected_orbbecs
from devices.orbbec.sensor import OrbbecSensor
from devices.sensor import AbsentError, DeviceError
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.orbbec.standin_values import OBError
from tests.helpers.usb_tree import plug_in
from tests.helpers.waiting import eventually

A, B = "CL8H741005K", "CL8H7410123"


@pytest.fixture
def one(orbbecs):
    orbbecs.devices = [Orbbec(A)]
    return orbbecs.devices[0]


def _sensor(serial=A, **settings):
    return OrbbecSensor(serial, CaptureSettings(**settings))


def test_no_device(orbbecs):
    assert orbbecs.devices == []
    assert connected_orbbecs() == []
    with pytest.raises(AbsentError, match=rf"No Orbbec sensor with serial {A}\. No other is connected\."):
        _sensor().__enter__()
    orbbecs.devices = [Orbbec(B)]
    with pytest.raises(AbsentError, match=rf"No Orbbec sensor with serial {A}\. Connected: {B}"):
        _sensor().__enter__()


def test_the_search_for_sensors_fails(orbbecs):
    orbbecs.fault = OBError("libusb: no permission")
    with pytest.raises(DeviceError, match=r"cannot search for sensors \(libusb: no per.*99-obsensor"):
        connected_orbbecs()


def test_device_busy(one):
    one.busy = True
    with pytest.raises(DeviceError, match=r"cannot be opened: it is busy.*libusb error -6.*OrbbecViewer"):
        _sensor().__enter__()
    assert len(one.opened) == 0


def test_no_permission(one, monkeypatch, tmp_path):
    one.busy = True
    plug_in(tmp_path, A, product="066b", vendor="2bc5")
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = sdk_access.usb_kinects
    monkeypatch.setattr(sdk_access, "usb_kinects", lambda: found(tmp_path))
    with pytest.raises(DeviceError, match=r"no permission for .*007.*99-obsensor-libusb\.rules"):
        _sensor().__enter__()


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


def test_unplugged_mid_stream(one, orbbecs):
    with _sensor(stall_s=3.0) as sensor:
        frames = sensor.frames()
        next(frames)
        one.plugged = False  # frames stop, without an error
        with pytest.raises(DeviceError, match=rf"Orbbec {A} was unplugged or lost its power\. Plug it"):
            next(frames)
    assert orbbecs.open_serials == []


def test_unplugged_at_close(one, orbbecs):
    sensor = _sensor().__enter__()
    one.plugged = False
    sensor.__exit__()
    assert sensor.warnings == [], "a sensor that is gone cannot close cleanly"
    assert orbbecs.open_serials == []
    one.plugged = True
    with sensor:  # the same sensor can be opened again
        next(sensor.frames())


@pytest.mark.parametrize("fault", ["silent", "blind"])
def test_stream_stalls(one, fault):
    with _sensor(stall_s=5.0) as sensor:
        frames = sensor.frames()
        next(frames)
        setattr(one, fault, True)
        with pytest.raises(DeviceError, match=r"stalls: no depth for 5 s.*USB 3"):
            next(frames)


def test_stream_of_a_secondary_stalls_without_its_primary(orbbecs):
    orbbecs.devices = [Orbbec(A), Orbbec(B)]
    with _sensor(A, sync="subordinate", start_s=30.0, stall_s=5.0) as secondary:
        with pytest.raises(DeviceError, match=r"no depth for 30 s.*check the primary, the sync hub"):
            next(secondary.frames())
        with _sensor(B, sync="master"):
            frames = secondary.frames()
            next(frames)
        with pytest.raises(DeviceError, match="no depth for 5 s"):
            next(frames)


def test_a_fault_of_the_sdk_mid_stream(one):
    def fails():
        raise OBError("frame queue overflow")

    one.at[1] = fails
    with _sensor() as sensor:
        frames = sensor.frames()
        with pytest.raises(DeviceError, match=r"stopped giving frames \(frame queue overflow\)\. Unplug it"):
            next(frames)


def test_a_lost_sensor_is_taken_back(orbbecs):
    orbbecs.devices = [Orbbec(A, paced=True), Orbbec(B, paced=True)]
    lost = orbbecs.devices[1]
    sensors = [_sensor(serial, timeout_ms=20, stall_s=0.1) for serial in (A, B)]
    with TwoSensors(*sensors, limits=TimeLimits(retry_s=0.02)) as two:

        def alone_now():
            return any(pair.a is not None and pair.b is None for pair in two.poll())

        def paired_now():
            return any(pair.a is not None and pair.b is not None for pair in two.poll())

        assert eventually(paired_now)
        lost.plugged = False
        assert eventually(alone_now)
        lost.plugged, lost.clock_us = True, 0  # its clock starts anew
        assert eventually(paired_now)
        told = " ".join(event.text for event in two.events())
    assert f"Orbbec {B} was unplugged" in told
    assert f"{B} is back" in told
    assert orbbecs.open_serials == []
