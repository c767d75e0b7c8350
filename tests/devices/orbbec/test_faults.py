"""Faults of a live Orbbec sensor: the same as those of an Azure Kinect."""

import pytest

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.orbbec.sdk_access import connected_orbbecs
from devices.orbbec.sensor import OrbbecSensor
from devices.sensor import AbsentError, DeviceError
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.orbbec.standin_values import OBError
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
