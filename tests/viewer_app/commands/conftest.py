"""Fixtures of the commands' tests."""

import ctypes
import sys
from pathlib import Path

import pytest

from devices.azure import pyk4a_access
from devices.capture.usb import UsbKinect
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from tests.helpers.live_program import Live
from tests.helpers.standin_pyk4a import Bus, Device, make_module


@pytest.fixture
def kinects(standin, monkeypatch):
    """Two sensors on a sync cable at a real sensor's pace, tracked by the stand-in; 000456 is the master."""
    bus = Bus(ctypes.CDLL(str(standin.path)))
    bus.devices = [
        Device("000123", jacks=(True, False), paced=True),
        Device("000456", jacks=(False, True), paced=True),
    ]
    monkeypatch.setitem(sys.modules, "pyk4a", make_module(bus))

    def on_usb():
        return [UsbKinect(device.serial, Path("usb"), True, 5000) for device in bus.plugged()]

    monkeypatch.setattr(pyk4a_access, "usb_kinects", on_usb)
    # Compilation takes longer than these sessions.
    Fuser(FusionSetup(nominal_calibration(AZURE_KINECT))).warm_up()
    return bus


@pytest.fixture
def live(kinects, standin, tmp_path, capsys):
    """``duplex live`` on both sensors."""
    assert len(kinects.devices) == 2
    return Live(standin, tmp_path / "s.rrd", capsys)
