"""Faults of a live Orbbec sensor: the same as those of an Azure Kinect."""

import pytest

from devices.capture.settings import CaptureSettings
from devices.orbbec.sdk_access import connected_orbbecs
from devices.orbbec.sensor import OrbbecSensor
from devices.sensor import DeviceError
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.orbbec.standin_values import OBError

A, B = "CL8H741005K", "CL8H7410123"


@pytest.fixture
def one(orbbecs):
    orbbecs.devices = [Orbbec(A)]
    return orbbecs.devices[0]


def _sensor(serial=A, **settings):
    return OrbbecSensor(serial, CaptureSettings(**settings))


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
