"""Which tracker runs, which connected sensor is A, which is B, and which leads on the sync cable."""

import sys
from dataclasses import replace
from itertools import product

import pytest
from rich.console import Console

from devices.azure import checks
from devices.azure.settings import KinectSettings
from devices.azure.tracking.settings import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings
from devices.capture.capture_stream import LiveSensor
from devices.capture.sensor_choice import ConnectedSensor, NeedsChoiceError, choose_two, sync_master
from devices.live import sensors as live_sensors
from devices.live.sensors import connected_sensors
from devices.recorded.files import images_of
from devices.sensor import DeviceError, Sensor
from devices.tracker_choice import TrackerChoice, choose_tracker
from devices.upright import UprightSensor
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish
from viewer_app.options.sensing import LiveOptions
from viewer_app.sensors import local
from viewer_app.sensors.tracker import decimation_of
from viewer_app.sinks.raw_recording import camera_of

BOLT, SECOND = "CL8H741005K", "CL8H7410123"
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


def test_the_programs_tracker_takes_images_of_other_sensors():
    assert MICROSOFTS.for_images_of([]) is MICROSOFTS
    assert OURS.for_images_of([BOLT]) is OURS
    changed = MICROSOFTS.for_images_of([BOLT, SECOND])
    assert (changed.name, changed.reason) == (
        "blazepose",
        f"k4abt does not accept the images of {BOLT} and {SECOND}",
    )
    with pytest.raises(DeviceError, match=f"{BOLT}: k4abt accepts images of libk4a only"):
        choose_tracker("k4abt").for_images_of([BOLT])


@pytest.mark.parametrize(
    ("tracker", "sdk"),
    [*product([OURS], ["k4a", "orbbec", "freenect", "freenect2", "realsense"]), (MICROSOFTS, "k4a")],
)
def test_a_sensor_on_its_side_is_made_upright_before_the_own_tracker_and_after_microsofts(tracker, sdk):
    listed = ConnectedSensor(0, "000123", False, False, sdk=sdk)
    sensor = live_sensors.live_sensor(listed, KinectSettings(), tracker, decimation_of(tracker, 30.0), 270)
    turned = sensor.source if tracker is OURS else sensor
    assert isinstance(turned, UprightSensor)
    assert isinstance(camera_of(sensor), LiveSensor)
    assert images_of(sensor) is camera_of(sensor)
    assert turned.source is camera_of(sensor)
    assert sensor.tracked_by == tracker.full_name
    if tracker is MICROSOFTS:
        assert turned.source._tracker.settings.orientation == 270


def test_sensors_of_both_vendors_are_listed(bus, orbbecs):
    bus.devices, orbbecs.devices = [Device("000123")], [Orbbec(BOLT)]
    listed = connected_sensors(OURS)
    assert [(one.index, one.serial, one.sdk) for one in listed] == [(0, "000123", "k4a"), (1, BOLT, "orbbec")]
    assert listed[1].description == "Orbbec Femto Bolt, USB3.2"
    assert listed[1].hides_jacks


def test_a_femto_in_both_lists_is_taken_once(bus, orbbecs):
    bus.devices, orbbecs.devices = [Device(BOLT, orbbec=True)], [Orbbec(BOLT)]
    assert [one.sdk for one in connected_sensors(OURS)] == ["orbbec"]
    assert [one.sdk for one in connected_sensors(MICROSOFTS)] == ["k4a"], "k4abt needs libk4a's captures"


A, B = ConnectedSensor(0, "000123", False, False), ConnectedSensor(1, "000456", False, False)
C = ConnectedSensor(2, "000789", False, False)


def test_two_sensors_and_no_name_asks_which_is_which():
    with pytest.raises(NeedsChoiceError, match="`principal=000123` or `principal=000456`") as asked:
        choose_two([B, A])
    assert asked.value.serials == ("000123", "000456")


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        ({"principal": "000456"}, ("000456", "000123")),
        ({"a": "000456"}, ("000456", "000123")),
        ({"b": "000456"}, ("000123", "000456")),
        ({"a": "000123", "b": "000456"}, ("000123", "000456")),
    ],
)
def test_one_name_leaves_the_other_to_what_is_connected(names, chosen):
    assert choose_two([A, B], **names) == chosen


@pytest.mark.parametrize(
    ("connected", "names", "message"),
    [
        ([A, B], {"a": "000999"}, r"No sensor with serial 000999\. Connected: 000123, 000456"),
        ([A, B], {"a": "000123", "b": "000123"}, "both 000123"),
        ([A, B, C], {}, "3 sensors are connected"),
        ([A], {}, "Only one sensor is connected, 000123; fusion needs two"),
        ([], {}, r"No sensor is connected\. Plug in two.*duplex doctor names the sensor libraries"),
        ([A, B], {"a": "000123", "principal": "000456"}, "`kinect_a=000123` and `principal=000456` both"),
    ],
)
def test_a_choice_that_cannot_be_made_is_explained(connected, names, message):
    with pytest.raises(DeviceError, match=message):
        choose_two(connected, **names)


def _jacks(serial, sync_in, sync_out):
    return ConnectedSensor(0, serial, sync_in, sync_out)


@pytest.mark.parametrize(
    ("other", "words", "not_said"),
    [
        ({"sdk": "orbbec", "tells_jacks": False}, "`sync_master=000123` or CL8F", "CL8F: in empty"),
        ({"sdk": "freenect2", "has_port": False}, "No sync cable fits into CL8F. Unplug it", "Lead it"),
    ],
)
def test_a_cable_that_seems_to_lead_nowhere_beside_a_sensor_of_another_vendor(other, words, not_said):
    azure = ConnectedSensor(0, "000123", sync_in=False, sync_out=True)
    with pytest.raises(DeviceError) as told:
        sync_master(azure, ConnectedSensor(1, "CL8F", False, False, **other))
    assert words in str(told.value)
    assert not_said not in str(told.value)
    assert "000123: in empty, out connected" in str(told.value)


@pytest.mark.parametrize("jacks", list(product([False, True], repeat=4)))
def test_a_cable_needs_both_of_its_ends(jacks):
    in_a, out_a, in_b, out_b = jacks
    a, b = _jacks("000123", in_a, out_a), _jacks("000456", in_b, out_b)
    leads = {"000123": out_a and in_b, "000456": out_b and in_a}
    for named in (None, *leads):
        if named is None and not any(jacks):
            assert sync_master(a, b) is None
        elif leads[named] if named else any(leads.values()):
            assert leads[sync_master(a, b, named)]
        else:
            with pytest.raises(DeviceError, match="sync out"):
                sync_master(a, b, named)


def test_a_master_that_is_named_against_the_jacks_is_explained():
    leads, follows = _jacks("000456", False, True), _jacks("000123", True, False)
    assert sync_master(follows, leads, "000456") == "000456"
    for pair in ((follows, leads), (A, B)):
        with pytest.raises(DeviceError, match="`sync_master=000123`: no cable leads from its sync out"):
            sync_master(*pair, "000123")
    assert sync_master(_jacks("CL1", False, False), _jacks("CL2", False, False), "CL2") == "CL2"


def test_a_femto_is_opened_by_the_library_that_the_tracker_in_use_needs(monkeypatch):
    """k4abt is installed, but a RealSense beside the Femto needs the program's own tracker."""
    hidden = {"tells_jacks": False}
    listed = {
        "k4a": [ConnectedSensor(0, "CL8F", False, False)],
        "orbbec": [ConnectedSensor(0, "CL8F", False, False, sdk="orbbec", **hidden)],
        "realsense": [ConnectedSensor(0, "1001", False, False, sdk="realsense", **hidden)],
    }
    vendors = {
        name: replace(vendor, connected=lambda name=name: listed.get(name, []))
        for name, vendor in live_sensors.VENDORS.items()
    }
    monkeypatch.setattr(live_sensors, "VENDORS", vendors)
    monkeypatch.setattr(local, "tracker_of", lambda _: MICROSOFTS)
    opened = []
    monkeypatch.setattr(
        live_sensors,
        "live_sensor",
        lambda sensor, *rest: opened.append((sensor.serial, sensor.sdk, rest[-1])) or _Nothing(),
    )
    options = LiveOptions(kinect_a="CL8F", kinect_b="1001", orientation="90,0")
    local.two_connected_sensors(options, Console(quiet=True))
    assert opened == [("CL8F", "orbbec", 90), ("1001", "realsense", 0)]


class _Nothing(Sensor):
    name = "nothing"
