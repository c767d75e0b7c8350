"""Checks of ``duplex doctor`` on made-up machines."""

import os
import re
import shutil
import sys

import pytest

from devices.azure import pyk4a_access
from devices.azure.tracking.settings import TrackerSettings
from devices.blazepose.checks import networks_check
from devices.blazepose.settings import BlazePoseSettings
from devices.capture.usb import permission_check, usb_kinects
from devices.live.checks import device_checks
from devices.live.sensors import NoLibraryError, connected_sensors, software
from devices.orbbec.sdk_access import connected_orbbecs, sdk_check, sensor_check
from devices.sensor import DeviceError
from devices.tracker_choice import choose_tracker
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish, plug_in


def _by_name(checks):
    named = {check.name: check for check in checks}
    assert len(named) == len(checks)
    return named


@pytest.mark.usefixtures("no_libraries")
def test_a_bare_machine_needs_everything_and_every_failure_has_advice(monkeypatch, tmp_path):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    checks = device_checks(
        choose_tracker("k4abt", TrackerSettings(library=tmp_path / "libk4abt.so")), tmp_path
    )
    named = _by_name(checks)
    lacking = {"two sensors", "k4abt", "k4abt's network", "GPU"}
    assert {name for name, check in named.items() if check.needed and not check.ok} >= lacking
    assert "depth engine" not in named, "only libk4a needs it"
    libraries = [check for check in checks if check.about == "library"]
    assert len(libraries) == 5
    assert all(check.missing and check.serves and check.install and not check.needed for check in libraries)
    assert all(check.advice for check in checks if not check.ok)
    assert 'pip install "duplex-kinects[kinect]"' in named["pyk4a and the Sensor SDK"].advice
    assert named["two sensors"].detail == "none found: the library for them is not installed"


def test_a_machine_with_all_of_it_can_start(bus, standin, monkeypatch, tmp_path):
    monkeypatch.setenv("DISPLAY", ":0")
    furnish(tmp_path)
    bus.devices = [Device("000123", jacks=(False, True)), Device("000456", jacks=(True, False))]
    for number, serial in enumerate(("000123", "000456")):
        plug_in(tmp_path, serial, number=number)
    checks = device_checks(choose_tracker("k4abt", TrackerSettings(library=standin.path)), tmp_path)
    assert [check.name for check in checks if check.needed and not check.ok] == []
    named = _by_name(checks)
    assert named["Kinect 000123"].detail == "sync in empty, sync out connected"
    assert named["Kinect 000456"].detail == "sync in connected, sync out empty"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere no display is asked for")
@pytest.mark.parametrize(
    ("lacks", "check", "needed"),
    [
        ("DISPLAY", "depth engine", True),
        ("libdepthengine", "depth engine", False),
        ("nvidia", "GPU", True),
        ("onnx", "k4abt's network", True),
    ],
)
@pytest.mark.usefixtures("bus")
def test_the_one_thing_that_is_missing_fails(standin, monkeypatch, tmp_path, lacks, check, needed):
    monkeypatch.setenv("DISPLAY", "" if lacks == "DISPLAY" else ":0")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    furnish(tmp_path)
    for file in tmp_path.rglob("*"):
        if lacks in str(file.relative_to(tmp_path)) and file.is_file():
            file.unlink()
    named = _by_name(device_checks(choose_tracker("k4abt", TrackerSettings(library=standin.path)), tmp_path))
    wanted = {"depth engine", "GPU", "k4abt's network", "k4abt"}
    assert [name for name in named if name in wanted and not named[name].ok] == [check]
    assert named[check].needed == needed
    assert named[check].advice


def test_a_tracker_on_the_cpu_needs_no_gpu(monkeypatch, tmp_path):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    gpu = _by_name(device_checks(choose_tracker("k4abt", TrackerSettings(processing="cpu")), tmp_path))["GPU"]
    assert (gpu.ok, gpu.needed) == (False, False)
    assert "about one frame per second" in gpu.advice
    assert "duplex fuse" in gpu.advice


@pytest.mark.parametrize(("vendor", "product"), [("045e", "097c"), ("2bc5", "066b"), ("2bc5", "0669")])
def test_the_azure_kinect_and_its_successors_are_known(tmp_path, vendor, product):
    plug_in(tmp_path, product=product, vendor=vendor, number=1)
    plug_in(tmp_path, product="097d", number=2)  # the colour camera of the same Kinect
    (kinect,) = usb_kinects(tmp_path)
    assert (kinect.serial, kinect.megabits, kinect.allowed) == ("000123", 5000, True)
    assert kinect.node.name == "001"


def test_one_kinect_is_not_enough(bus, tmp_path):
    bus.devices = [Device("000123"), Device("000456", busy=True)]
    named = _by_name(device_checks(root=tmp_path))
    assert not named["two sensors"].ok
    assert named["two sensors"].detail == "2 connected, 1 usable"
    assert "busy" in named["Kinect at place 1"].detail
    assert "k4aviewer" in named["Kinect at place 1"].advice


def test_two_of_three_kinects_must_be_chosen_as_for_live(bus, tmp_path):
    bus.devices = [Device("1"), Device("2", jacks=(False, True)), Device("3", jacks=(True, False))]
    named = _by_name(device_checks(root=tmp_path))
    assert (named["two sensors"].ok, named["two sensors"].needed) == (False, True)
    assert (
        named["two sensors"].advice == "3 sensors are connected: 1, 2, 3. Choose two: `kinect_a`, `kinect_b`."
    )
    named = _by_name(device_checks(root=tmp_path, choice=("3", "2", None)))
    assert named["two sensors"].ok
    assert named["sync cable"].detail == "from 2 to 3"
    named = _by_name(device_checks(root=tmp_path, choice=(None, "1", "2")))
    assert (named["sync cable"].ok, named["sync cable"].needed) == (False, True)
    named = _by_name(device_checks(root=tmp_path, choice=("9", "2", None)))
    assert "No sensor with serial 9" in named["two sensors"].advice


ONE_OF_EACH = {
    ("045e", "097c"): "k4a",
    ("2bc5", "066b"): "orbbec",
    ("045e", "02ae"): "freenect",
    ("045e", "02c4"): "freenect2",
    ("8086", "0b07"): "realsense",
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux restricts USB devices")
@pytest.mark.parametrize("camera", ONE_OF_EACH)
def test_the_rule_that_is_named_for_a_sensor_is_a_rule_that_counts(monkeypatch, tmp_path, camera):
    monkeypatch.setattr(os, "access", lambda *_: False)  # also root's
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    bare, plugged = tmp_path / "bare", tmp_path / "plugged"
    node = plug_in(plugged, vendor=camera[0], product=camera[1])
    check = permission_check(plugged)
    assert (check.ok, check.needed) == (False, True)
    assert str(node) in check.detail
    (rule,) = re.findall(r"\S+\.rules", check.advice)
    assert not permission_check(bare).ok
    (bare / "etc/udev/rules.d").mkdir(parents=True)
    (bare / "etc/udev/rules.d" / rule).touch()
    assert permission_check(bare).ok


@pytest.mark.usefixtures("no_libraries")
@pytest.mark.parametrize(("camera", "sdk"), ONE_OF_EACH.items())
def test_a_sensor_on_usb_names_its_library_first(tmp_path, camera, sdk):
    plug_in(tmp_path, vendor=camera[0], product=camera[1])
    sensors, install = software()[sdk]
    with pytest.raises(NoLibraryError) as fault:
        connected_sensors(choose_tracker("blazepose"), tmp_path)
    for said in (str(fault.value), _by_name(device_checks(root=tmp_path))["two sensors"].advice):
        assert f"the library of {sensors}, which is not installed: {install}." in said


def test_a_broken_library_is_told_where_no_sensor_is_found(monkeypatch, no_libraries, tmp_path):
    del no_libraries
    (tmp_path / "pyrealsense2.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pyrealsense2")
    with pytest.raises(DeviceError, match=r"pyrealsense2, which cannot be imported \(libusb"):
        connected_sensors(choose_tracker("blazepose"))
    named = _by_name(device_checks(root=tmp_path))
    assert "libusb" in named["two sensors"].detail
    assert not named["pyrealsense2"].missing


def test_a_usb_2_port_is_reported(tmp_path):
    plug_in(tmp_path, speed=480)
    check = _by_name(device_checks(root=tmp_path))["USB speed"]
    assert (check.ok, check.detail) == (False, "000123 runs at 480 Mbit/s")


@pytest.mark.usefixtures("bus")
def test_the_depth_engine_beside_a_wheels_library_is_found(monkeypatch, wheel_library, tmp_path):
    monkeypatch.setenv("DISPLAY", ":0")
    engine = wheel_library.with_name("libdepthengine.so.2.0")
    engine.touch()
    check = _by_name(device_checks(root=tmp_path))["depth engine"]
    engine.unlink()
    assert check.ok
    assert str(engine) in check.detail


@pytest.mark.parametrize(
    ("version", "ok"), [((1, 6, 102), False), ((1, 6, 110), True), ((1, 7, 0), True), (None, True)]
)
def test_firmware_that_is_too_old_for_a_subordinate_is_reported(bus, monkeypatch, tmp_path, version, ok):
    monkeypatch.setattr(pyk4a_access, "firmware_version", lambda _: version)
    bus.devices = [Device("000123"), Device("CL8H741005K")]
    named = _by_name(device_checks(root=tmp_path))
    kinect = named["Kinect 000123"]
    assert kinect.ok == ok
    assert ("AzureKinectFirmwareTool" in kinect.advice) == (not ok)
    assert named["Kinect CL8H741005K"].ok, "Orbbec counts its firmware otherwise"


# ------------------------------------------------------------------ Orbbec's SDK v2, and our own tracker


def test_orbbecs_software_and_our_tracker_are_enough(orbbecs, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    orbbecs.devices = [Orbbec("CL8H741005K"), Orbbec.gemini("AY8T43E0031", firmware="1.4.60")]
    for number, device in enumerate(orbbecs.devices):
        plug_in(tmp_path, device.serial, "066b", number=number, vendor="2bc5")
    checks = device_checks(choose_tracker("blazepose"), tmp_path)
    named = _by_name(checks)
    assert [c.name for c in checks if c.needed and not c.ok and c.name != "blazepose"] == []
    assert named["body tracker in use"].detail == "blazepose full (asked for with `tracker`)"
    bolt, gemini = named["Orbbec CL8H741005K"], named["Orbbec AY8T43E0031"]
    assert bolt.ok
    assert bolt.detail == "Orbbec Femto Bolt, USB3.2, firmware 1.1.3, sync jacks not known"
    assert "recommends firmware 1.4.98" in gemini.advice
    assert "`sync_master=" in named["sync cable"].advice
    assert "never with a real sensor" in named["proven on hardware"].detail
    assert not named["proven on hardware"].needed
    assert orbbecs.open_serials == [], "each is opened briefly"


def test_problems_of_an_orbbec_sensor_are_reported(orbbecs):
    orbbecs.devices = [
        Orbbec("CL8H741005K", busy=True),
        Orbbec("CL8H7410123", connection="USB2.1"),
        Orbbec("CL8H7410456"),
    ]
    busy, slow = (sensor_check(one) for one in connected_orbbecs()[:2])
    assert not busy.ok
    assert "it is busy or starting up" in busy.detail + busy.advice
    assert "USB 3 port" in slow.advice
    assert "no depth from Femto Bolt" in sdk_check("darwin").detail


def test_networks_that_can_be_fetched_are_not_needed(monkeypatch, tmp_path):
    monkeypatch.setenv("DUPLEX_TRACKER_MODELS", str(tmp_path))
    monkeypatch.setattr("devices.blazepose.checks.find_spec", lambda _: True)
    check = networks_check(BlazePoseSettings())
    assert (check.ok, check.needed) == (False, False)
    assert "duplex tracker fetch" in check.advice
    named = networks_check(BlazePoseSettings(models=tmp_path))
    assert (named.ok, named.needed) == (False, True), "a folder that the user names is not written"
    monkeypatch.setattr("devices.blazepose.checks.find_spec", lambda _: None)
    assert networks_check(BlazePoseSettings()).needed
