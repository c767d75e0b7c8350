"""Which body tracker runs, and why: one rule for fuse, live and doctor."""

import sys

import pytest

from devices.azure import checks
from devices.azure.kinect import KinectSensor
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages
from devices.live_sensors import connected_sensors
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice, choose_tracker, tracker_name
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish

A, B = "CL8H741005K", "CL8H7410123"
OURS, MICROSOFTS = TrackerChoice("blazepose", "a test"), TrackerChoice("k4abt", "a test")


@pytest.fixture
def installed(standin, monkeypatch):
    """libk4abt where the system finds it."""
    load = checks.load_library
    monkeypatch.setattr(
        checks, "load_library", lambda name, path, advice: load(name, path or standin.path, advice)
    )
    monkeypatch.setattr(checks.shutil, "which", lambda _: None)
    return standin


@pytest.mark.usefixtures("installed")
def test_auto_is_k4abt_where_it_works(tmp_path):
    if sys.platform == "linux":
        choice = choose_tracker(root=tmp_path)
        assert (choice.name, choice.reason) == ("blazepose", "libk4abt finds no GPU driver")
    furnish(tmp_path)
    choice = choose_tracker(root=tmp_path)
    assert (choice.name, choice.full_name, choice.asked) == ("k4abt", "k4abt", False)
    slow = choose_tracker(k4abt=TrackerSettings(processing="cpu"), root=tmp_path)
    assert (slow.name, slow.reason) == ("blazepose", "libk4abt tracks about one frame per second on a CPU")


def test_auto_is_blazepose_without_libk4abt(monkeypatch, tmp_path):
    def missing(*_):
        raise DeviceError("The library k4abt cannot be loaded. Install it.")

    monkeypatch.setattr(checks, "load_library", missing)
    furnish(tmp_path)
    choice = choose_tracker(root=tmp_path, blazepose=BlazePoseSettings(network="lite"))
    assert (choice.full_name, choice.reason) == ("blazepose lite", "libk4abt is not installed")


def test_the_requested_tracker_runs(tmp_path):
    assert choose_tracker("k4abt", root=tmp_path).name == "k4abt"
    assert choose_tracker("blazepose", root=tmp_path).name == "blazepose"
    named = choose_tracker(k4abt=TrackerSettings(library=tmp_path / "libk4abt.so"), root=tmp_path)
    assert (named.name, named.asked) == ("k4abt", True)


def test_the_programs_tracker_takes_images_of_other_sensors():
    assert MICROSOFTS.for_images_of([]) is MICROSOFTS
    assert OURS.for_images_of([A]) is OURS
    changed = MICROSOFTS.for_images_of([A, B])
    assert (changed.name, changed.reason) == ("blazepose", f"k4abt does not take the images of {A} and {B}")
    with pytest.raises(DeviceError, match=f"{A}: k4abt takes images of libk4a only"):
        choose_tracker("k4abt").for_images_of([A])


def test_the_name_is_that_of_the_sensors_tracker():
    kinect = KinectSensor("000123", track=False)
    assert tracker_name(TrackedImages(kinect, BlazePoseSettings(network="lite"))) == "blazepose lite"
    assert tracker_name(KinectSensor("000123")) == "k4abt"


def test_sensors_of_both_vendors_are_listed(bus, orbbecs):
    bus.devices, orbbecs.devices = [Device("000123")], [Orbbec(A)]
    listed = connected_sensors(OURS)
    assert [(one.index, one.serial, one.sdk) for one in listed] == [(0, "000123", "k4a"), (1, A, "orbbec")]
    assert listed[1].description == "Orbbec Femto Bolt, USB3.2"
    assert listed[1].is_orbbec


def test_a_femto_in_both_lists_is_taken_once(bus, orbbecs):
    bus.devices, orbbecs.devices = [Device(A, orbbec=True)], [Orbbec(A)]
    assert [one.sdk for one in connected_sensors(OURS)] == ["orbbec"]
    assert [one.sdk for one in connected_sensors(MICROSOFTS)] == ["k4a"], "k4abt needs libk4a's captures"


def test_one_vendors_software_is_enough(bus, orbbecs, monkeypatch):
    bus.devices, orbbecs.devices = [Device("000123")], [Orbbec(A)]
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    assert [one.serial for one in connected_sensors(OURS)] == [A]
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    with pytest.raises(DeviceError, match=r"need pyk4a.*Or, for Orbbec's sensors: .*pyorbbecsdk2") as fault:
        connected_sensors(OURS)
    assert "\n" not in str(fault.value)
