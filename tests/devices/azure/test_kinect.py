"""Live sensors, through a stand-in for pyk4a with the real module's names and capsules."""

import ctypes
import gc
import itertools
import os
import re
import shutil
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from devices.azure import pyk4a_access, pyk4a_internals
from devices.azure.kinect import KinectSensor
from devices.azure.pyk4a_access import connected_kinects
from devices.azure.pyk4a_internals import capsule_pointer, loaded_libk4a
from devices.azure.settings import KinectSettings
from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.tracking.settings import TrackerSettings
from devices.blazepose.checks import networks_check
from devices.blazepose.settings import BlazePoseSettings
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.sensor_thread import SensorThread
from devices.capture.usb import permission_check, usb_kinects
from devices.live.checks import device_checks
from devices.live.sensors import NoLibraryError, connected_sensors, software
from devices.orbbec.sdk_access import connected_orbbecs, sdk_check, sensor_check
from devices.sensor import AbsentError, ColorCamera, ColorImage, DeviceError
from devices.tracker_choice import choose_tracker
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.standin_camera import VirtualTime
from tests.helpers.standin_pyk4a import JPEG, Device
from tests.helpers.usb_tree import furnish, plug_in


@pytest.fixture
def two(bus):
    bus.devices = [Device("000456", jacks=(True, False)), Device("000123", jacks=(False, True))]
    return bus


def _sensor(serial="000123", **settings):
    return KinectSensor(serial, KinectSettings(**settings), track=False)


def test_a_sensor_is_found_by_its_serial_not_its_place(two):
    with _sensor() as sensor:
        assert two.open_serials == ["000123"]
        assert two.started == ["000123"]
        assert sensor.name == "000123"
    assert two.open_serials == []


@pytest.mark.usefixtures("two")
def test_frames_carry_images_and_the_sensors_own_time_and_the_lens_is_in_opencvs_order():
    with _sensor(infrared=True) as sensor:
        first, second = itertools.islice(sensor.frames(), 2)
        lens = sensor.intrinsics
    assert (first.time_ns, second.time_ns) == (1_033_333_000, 1_066_666_000)
    assert first.depth.dtype == np.uint16
    assert (int(first.depth[0, 0]), int(second.ir[0, 0])) == (2001, 900)
    assert first.host_ns <= second.host_ns
    assert (lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy) == (640, 576, 504, 505, 332, 348)
    assert lens.distortion == (0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)


def test_the_gil_is_never_held_and_every_wait_is_finite(two):
    with _sensor(timeout_ms=400) as sensor:
        next(sensor.frames())
    connected_kinects()
    assert set(two.thread_safe) == {False}
    assert set(two.timeouts) == {400, 0}


def test_a_subordinate_captures_later_than_its_master_which_runs_its_colour_camera_unasked(two):
    with _sensor("000456", sync="subordinate"), _sensor("000123", sync="master") as leader:
        subordinate, master = two.configs
        frame = next(leader.frames())
    assert (subordinate.wired_sync_mode, subordinate.subordinate_delay_off_master_usec) == (2, 160)
    assert (master.wired_sync_mode, master.subordinate_delay_off_master_usec) == (1, 0)
    assert two.started == ["000456", "000123"]
    assert [int(config.color_resolution) for config in two.configs] == [1, 1], "720p on both"
    assert frame.color is None, "dropped at once"


def test_colour_comes_as_the_camera_compressed_it_with_lens_and_place(two):
    assert all(device.color for device in two.devices)
    with _sensor(color="720P") as sensor:
        frame = next(sensor.frames())
    assert frame.color.jpeg == JPEG
    lens = frame.color.camera.intrinsics
    assert (lens.width, lens.height, lens.fx, lens.cy) == (1280, 720, 610, 365)
    assert frame.color.camera.color_from_depth.translation.tolist() == [-0.032, 0.0, 0.004]


def test_a_thousand_openings_of_sensor_and_tracker_leak_nothing(bus, standin):
    bus.native, bus.devices = standin.library, [Device("000123")]
    descriptors = Path("/proc/self/fd")

    def cycle():
        sensor = KinectSensor("000123", tracker=TrackerSettings(library=standin.path))
        with SensorThread(sensor) as thread:
            while thread.received == 0:
                thread.arrival.wait(10.0)
                thread.arrival.clear()

    def held():
        gc.collect()
        open_files = len(list(descriptors.iterdir())) if descriptors.is_dir() else 0
        return threading.active_count(), open_files, standin.alive

    cycle()
    before = held()
    for _ in range(1000):
        cycle()
    assert held() == before == (*before[:2], 0)
    assert bus.open_serials == []


def test_a_colour_image_that_is_cut_off_is_left_out(two):
    camera = ColorCamera(Intrinsics(128, 72, 60, 60, 64, 36), RigidTransform.identity())
    assert ColorImage.of(JPEG, camera) is not None
    for damaged in (b"", JPEG[:-1], JPEG[1:], JPEG[: len(JPEG) // 2]):
        assert ColorImage.of(damaged, camera) is None
    for device in two.devices:
        device.color = False  # the camera gives none
    with _sensor(color="720P") as sensor:
        frame = next(sensor.frames())
    assert frame.color is None
    assert frame.depth is not None


@pytest.mark.parametrize(("sync", "jack"), [("master", "out"), ("subordinate", "in")])
def test_a_missing_sync_cable_is_explained(bus, sync, jack):
    bus.devices = [Device("000123")]
    with pytest.raises(DeviceError, match=rf"no cable is in its sync {jack} jack.*3\.5 mm"):
        _sensor(sync=sync).__enter__()
    assert bus.open_serials == []


def test_a_handle_of_another_pyk4a_is_refused(two):
    with _sensor() as sensor:
        calibration = sensor._device.calibration
        with pytest.raises(DeviceError, match=r"no 'pyk4a capture handle'.*another version"):
            capsule_pointer(calibration._calibration_handle, b"pyk4a capture handle")
    assert two.open_serials == []


def test_cameras_that_do_not_start_or_a_missing_tracker_leave_the_sensor_closed(two, tmp_path):
    with pytest.raises(DeviceError, match="No library at"):
        KinectSensor("000123", tracker=TrackerSettings(library=tmp_path / "libk4abt.so")).__enter__()
    assert two.open_serials == []
    two.devices[1].starts = False
    with pytest.raises(DeviceError, match=r"did not start its cameras.*two USB controllers"):
        _sensor().__enter__()
    assert two.open_serials == []


def test_without_pyk4a_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    with pytest.raises(DeviceError, match=r'pyk4a.*pip install "duplex-kinects\[kinect\]"'):
        connected_kinects()


def test_connected_sensors_are_listed_with_their_jacks(two):
    two.devices.append(Device("000789", busy=True))
    a, b, c = connected_kinects()
    assert a == ConnectedSensor(0, "000456", True, False)
    assert b == ConnectedSensor(1, "000123", False, True)
    assert c.serial is None
    assert "busy" in c.fault
    assert two.open_serials == []


def test_the_firmwares_version_is_read_from_libk4a(bus, wheel_library, monkeypatch):
    monkeypatch.setattr(pyk4a_internals, "loaded_libk4a", loaded_libk4a)
    version = (ctypes.c_uint32 * 3).in_dll(ctypes.CDLL(str(wheel_library)), "standin_firmware")
    version[:] = (1, 6, 102)
    bus.devices = [Device("000123")]
    (kinect,) = connected_kinects()
    version[:] = (1, 6, 110)  # the library stays loaded for later tests
    assert kinect.description == "firmware 1.6.102"


def test_the_bus_is_never_searched_while_frames_come(two):
    with _sensor() as sensor:
        searched = two.counts
        assert len(list(itertools.islice(sensor.frames(), 100))) == 100
        assert two.counts == searched, "pyk4a holds the GIL for it"


def test_a_sensor_that_is_gone_is_not_opened_again_and_again(two):
    with _sensor("000123"):
        two.devices[0].plugged = False
        for _ in range(100):
            with pytest.raises(AbsentError, match="No Kinect with serial 000456"):
                _sensor("000456").__enter__()
    assert two.failed_opens == 0, "pyk4a loses a reference to None at each"


def test_orbbecs_epoch_times_do_not_become_host_times(bus):
    bus.devices = [Device("CL8H741005K", orbbec=True)]
    with _sensor("CL8H741005K") as sensor:
        frame = next(sensor.frames())
    assert abs(time.perf_counter_ns() - (frame.host_ns or 0)) < 60_000_000_000


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="None is immortal from Python 3.12 on")
def test_references_to_none_that_pyk4a_gives_away_are_put_back(bus):
    bus.gives_none_away = True
    bus.devices = [Device("000123", color=False), Device("000456", busy=True)]
    gc.collect()
    before = sys.getrefcount(None)
    for _ in range(1000):
        connected_kinects()
    with _sensor(color="720P") as sensor:
        for _ in itertools.islice(sensor.frames(), 1000):
            pass
    assert bus.failed_opens >= 1000
    gc.collect()
    # the stand-in lost 2000 references; temporary objects hold some
    assert abs(sys.getrefcount(None) - before) < 1000


# --- Faults of Azure Kinects, from the bus to the frames.


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


# --- Checks of ``duplex doctor`` on made-up machines.


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


@pytest.mark.parametrize(("vendor", "product"), [("045e", "097c"), ("2bc5", "066b"), ("2bc5", "0669")])
def test_the_azure_kinect_and_its_successors_are_known(tmp_path, vendor, product):
    plug_in(tmp_path, product=product, vendor=vendor, number=1)
    plug_in(tmp_path, product="097d", number=2)  # the colour camera of the same Kinect
    (kinect,) = usb_kinects(tmp_path)
    assert (kinect.serial, kinect.megabits, kinect.allowed) == ("000123", 5000, True)
    assert kinect.node.name == "001"


THREE = {"1": (False, False), "2": (False, True), "3": (True, False)}


@pytest.mark.parametrize(
    ("jacks", "choice", "checks"),
    [
        ({"1": (False, False), "busy": (False, False)}, (), {"two sensors": "2 connected, 1 usable"}),
        ({"1": (False, False), "busy": (False, False)}, (), {"Kinect at place 1": "busy.*k4aviewer"}),
        (THREE, (), {"two sensors": "are connected: 1, 2, 3. Choose two: `kinect_a`, `kinect_b`"}),
        (THREE, ("3", "2", None), {"two sensors": None, "sync cable": None}),
        (THREE, ("3", "2", None), {"Kinect 2": None, "Kinect 3": None}),
        (THREE, (None, "1", "2"), {"sync cable": "joins no sync out to a sync in"}),
        (THREE, ("9", "2", None), {"two sensors": "No sensor with serial 9"}),
    ],
)
def test_kinects_that_cannot_be_used_are_told_as_by_live(bus, tmp_path, jacks, choice, checks):
    """Of each check what it says; None where all is well."""
    bus.devices = [Device(serial, jacks=of, busy=serial == "busy") for serial, of in jacks.items()]
    named = _by_name(device_checks(root=tmp_path, **({"choice": choice} if choice else {})))
    for name, said in checks.items():
        check = named[name]
        assert check.ok == (said is None)
        assert said is None or re.search(said, f"{check.detail} {check.advice}")


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
