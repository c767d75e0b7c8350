"""One contract for opening, losing and closing the live sensors of all vendors, by their libraries."""

import os
from itertools import islice
from types import SimpleNamespace

import pytest

from devices.azure import pyk4a_access
from devices.azure.kinect import KinectSensor
from devices.azure.settings import KinectSettings
from devices.capture import usb
from devices.capture.causes import Cause
from devices.capture.settings import CaptureSettings
from devices.freenect.sensor import FreenectSensor
from devices.live.checks import device_checks
from devices.orbbec.sensor import OrbbecSensor
from devices.realsense import sdk_access as realsense_access
from devices.realsense.sensors import RealSenseSensor
from devices.sensor import AbsentError, DeviceError
from devices.tracker_choice import TrackerChoice
from tests.helpers.freenect import film, numbered, write_dump
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.realsense import Software
from tests.helpers.standin_camera import VirtualTime
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import plug_in

A, B = "000123", "000456"
OURS = TrackerChoice("blazepose", "a test")


class OnBus:
    """Two devices behind a stand-in of a vendor's Python module."""

    def __init__(self, bus, devices):
        self._bus, bus.devices = bus, devices

    def plug(self, *serials):
        """Connects these sensors and no others."""
        for device in self._bus.devices:
            device.plugged = device.serial in serials

    def busy(self):
        """Another program uses A."""
        self._bus.devices[1].busy = True

    def loses(self, image):
        """A gives this image no more."""
        self._bus.devices[1].color = image != "colour"
        self._bus.devices[1].infrared_lost = lambda _: image == "infrared"

    @property
    def open_serials(self):
        return self._bus.open_serials


class Azure(OnBus):
    programs, usb = "k4aviewer", ("045e", "097c")

    def __init__(self, request):
        bus, self._time = request.getfixturevalue("bus"), VirtualTime()
        super().__init__(bus, [Device(serial, time=self._time) for serial in (B, A)])
        listed = lambda: [usb.UsbKinect(one.serial, None, True, 5000) for one in bus.plugged()]  # noqa: E731
        request.getfixturevalue("monkeypatch").setattr(pyk4a_access, "usb_kinects", listed)

    def sensor(self, serial=A, **settings):
        settings = KinectSettings(**{"color": "720P", **settings})
        return KinectSensor(serial, settings, track=False, clock=self._time.now_ns)


class OrbbecDriver(OnBus):
    programs, usb = "OrbbecViewer", ("2bc5", "066b")

    def __init__(self, request):
        bus = request.getfixturevalue("orbbecs")
        bus.time = VirtualTime()
        super().__init__(bus, [Orbbec(B), Orbbec(A)])

    def sensor(self, serial=A, **settings):
        settings = CaptureSettings(**{"color": "720P", **settings})
        return OrbbecSensor(serial, settings, clock=self._bus.time.now_ns)


class RealSense:
    """Software devices of the real pyrealsense2, in a list that tests make."""

    programs, usb, open_serials = "realsense-viewer", ("8086", "0b07"), ()

    def __init__(self, request):
        rs = request.getfixturevalue("rs")
        self._software = {serial: Software(rs, serial) for serial in (A, B)}
        self._there, self._busy = [B, A], False
        context = SimpleNamespace(query_devices=lambda: self)
        request.getfixturevalue("monkeypatch").setattr(realsense_access, "context_of", lambda _: context)

    def __len__(self):
        return len(self._there)

    def __getitem__(self, index):
        if self._busy and self._there[index] == A:
            raise RuntimeError("failed to open usb interface: 0, error: RS2_USB_STATUS_BUSY")
        return self._software[self._there[index]].device

    def plug(self, *serials):
        self._there = list(serials)

    def busy(self):
        self._busy = True

    def sensor(self, serial=A):
        return RealSenseSensor(serial, CaptureSettings())


class KinectV1:
    """The real libfreenect's fakenect, with a film for each sensor."""

    programs, usb = "freenect-glview", ("045e", "02ae")

    def __init__(self, request):
        self._fakenect, folder = request.getfixturevalue("fakenect"), request.getfixturevalue("tmp_path")
        self._dumps = {serial: write_dump(folder / serial, film(*numbered(30))) for serial in (B, A)}
        self.plug(A, B)

    @property
    def open_serials(self):
        return self._fakenect.open

    def plug(self, *serials):
        self._fakenect.dumps = {serial: self._dumps[serial] for serial in serials}

    def busy(self):
        self._fakenect.busy.add(A)

    def sensor(self, serial=A, **settings):
        return FreenectSensor(serial, CaptureSettings(**settings))


DRIVERS = {"azure": Azure, "orbbec": OrbbecDriver, "realsense": RealSense, "freenect": KinectV1}
EVERY = pytest.mark.parametrize("driver", DRIVERS, indirect=True)
# realsense: test_live.py there; freenect2: test_contract.py there
RUNS = pytest.mark.parametrize("driver", ["azure", "orbbec", "freenect"], indirect=True)


@pytest.fixture
def driver(request):
    """Two sensors of the vendor that the test's parameter names."""
    return DRIVERS[request.param](request)


@EVERY
def test_a_sensor_that_is_not_there_is_named_with_those_that_are(driver):
    for there in ([B], []):
        driver.plug(*there)
        with pytest.raises(DeviceError) as told:
            driver.sensor().__enter__()
        assert f"with serial {A}" in str(told.value)
        assert (f" Connected: {B}." in str(told.value)) == bool(there)
        assert list(driver.open_serials) == []


@EVERY
def test_a_busy_sensor_is_called_busy_and_the_other_one_opens(driver, monkeypatch):
    driver.busy()
    _on_bus(monkeypatch, [])
    with pytest.raises(DeviceError) as told:
        driver.sensor().__enter__()
    assert "it is busy" in str(told.value)
    assert driver.programs in str(told.value)
    assert list(driver.open_serials) == []
    with driver.sensor(B):
        pass


@EVERY
@pytest.mark.parametrize("other", [("045e", "02ae"), ("045e", "097c"), ("8086", "0b07"), ("2bc5", "066b")])
def test_only_its_own_device_file_is_blamed(driver, monkeypatch, tmp_path, other):
    driver.busy()
    root, found = tmp_path / "root", usb.usb_kinects
    own, others = (
        plug_in(root, "", product=ids[1], vendor=ids[0], number=number)
        for number, ids in enumerate((driver.usb, other), 7)
    )
    # Microsoft's wrapper opens Orbbec's sensors, not the other way round
    of_it = {driver.usb} | ({("2bc5", "066b")} if isinstance(driver, Azure) else set())
    for forbidden, related in ((own, True), (others, other in of_it)):
        monkeypatch.setattr(os, "access", lambda path, _, forbidden=forbidden: path != forbidden)
        _on_bus(monkeypatch, found(root))
        with pytest.raises(DeviceError) as told:
            driver.sensor().__enter__()
        assert (f"no permission for {forbidden}" in str(told.value)) == related


@RUNS
def test_unplugged_while_frames_come_it_is_told_closes_and_opens_again(driver):
    sensor = driver.sensor()
    with sensor:
        frames = sensor.frames()
        next(frames)
        driver.plug(B)
        with pytest.raises(AbsentError) as told:
            list(frames)
        label = str(told.value).partition(A)[0] + A
        assert str(told.value) == Cause.UNPLUGGED.says(label=label)
        del told, frames  # the traceback keeps what it saw
    assert list(driver.open_serials) == []
    with pytest.raises(AbsentError):
        sensor.__enter__()
    driver.plug(A, B)
    sensor.interrupt()  # opening resets it
    with sensor:
        next(sensor.frames())
    assert list(driver.open_serials) == []


@pytest.mark.parametrize("driver", ["azure", "orbbec"], indirect=True)
@pytest.mark.parametrize("image", ["infrared", "colour"])
def test_an_image_that_does_not_come_with_depth_is_named(driver, image):
    driver.loses(image)
    with driver.sensor() as sensor:
        depths = [int(frame.depth[0, 0]) for frame in islice(sensor.frames(), 180)]
    assert depths == list(range(depths[0], depths[0] + 180))
    (told,) = sensor.take_news()
    assert f"{image} images" in told


@EVERY
def test_the_doctor_finds_both(driver, tmp_path):
    for number, serial in enumerate((A, B)):
        plug_in(tmp_path / "root", serial, driver.usb[1], number=number, vendor=driver.usb[0])
    named = {check.name: check for check in device_checks(OURS, tmp_path / "root")}
    assert named["two sensors"].detail == "2 connected, 2 usable"
    assert sum(check.ok for name, check in named.items() if name.endswith((A, B))) == 2
    assert named["USB speed"].ok


@pytest.mark.parametrize(
    ("driver", "settings", "said"),
    [
        ("azure", {"depth_mode": "PASSIVE_IR"}, r"PASSIVE_IR is not supported\. Supported: NFOV"),
        ("azure", {"depth_mode": "WFOV_UNBINNED"}, "at most, not 30"),
        ("azure", {"color": "4K"}, "No colour mode 4K"),
        ("orbbec", {"depth_mode": "PASSIVE_IR"}, "No depth mode PASSIVE_IR. There are NFOV_UNBINNED"),
        ("orbbec", {"color": "3072P"}, "have no colour 3072P: 720P"),
        ("orbbec", {"color": "1440P"}, r"no colour 1440P \(MJPG\) at 30 fps\. It has 1080P, 720P"),
        ("freenect", {"depth_mode": "WFOV_2X2BINNED"}, r"one depth mode, 640 × 480\. Leave `depth_mode` out"),
        ("freenect", {"fps": 15}, r"runs at 30 fps, not 15\. Leave `fps` out"),
        ("freenect", {"sync": "master"}, r"no port for a sync cable\. Leave `sync_master` out"),
    ],
    indirect=["driver"],
)
def test_a_mode_that_the_sensor_lacks_is_refused(driver, settings, said):
    with pytest.raises(DeviceError, match=said):
        driver.sensor(**settings).__enter__()
    assert list(driver.open_serials) == []


def _on_bus(monkeypatch, devices):
    """What Linux lists."""
    for module in ("azure.pyk4a_access", "orbbec.sdk_access", "realsense.sdk_access", "freenect.libfreenect"):
        monkeypatch.setattr(f"devices.{module}.usb_kinects", lambda: devices)
