"""One driver per vendor for the contract of live sensors: each plays the same faults, in virtual time.

Azure and Orbbec stand on stand-ins of their Python modules. RealSense is the real pyrealsense2 with software
devices. Kinect v1 and v2 have scripted cameras in place of ``_Camera`` and ``Camera``: their libraries' own
calls are tested beside.
"""

import heapq
from collections import deque
from ctypes import POINTER, cast
from itertools import count, pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from devices.azure import pyk4a_access
from devices.azure.kinect import KinectSensor
from devices.azure.settings import KinectSettings
from devices.capture.settings import CaptureSettings
from devices.capture.usb import UsbKinect
from devices.freenect import libfreenect
from devices.freenect import sensor as freenect
from devices.freenect.sensor import FreenectSensor
from devices.freenect2 import sensor as freenect2
from devices.freenect2.library import Images
from devices.freenect2.sensor import Freenect2Sensor
from devices.orbbec.sensor import OrbbecSensor
from devices.realsense import images as realsense_images
from devices.realsense import sdk_access as realsense_access
from devices.realsense.sensors import RealSenseSensor
from devices.sensor import AbsentError
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.realsense import LENS, Software
from tests.helpers.standin_camera import Device, VirtualTime

PERIOD_NS = 33_333_333
A, B = "000123", "000456"
SMALL = (4, 4)


def never(_number):
    """No frame of these."""
    return False


class Schedule:
    """Exposures of one sensor in virtual time: what comes when.

    Attributes:
        depth_lost: Of an exposure, whether depth is lost on USB.
        color_lost: The same of the image beside depth, whatever it is.
        color_latency_ns: From exposure until that image comes.
    """

    def __init__(self, time):
        self.time, self.silent, self.blind = time, False, False
        self.depth_lost, self.color_lost = never, never
        self.depth_ns, self.color_latency_ns = 15_000_000, 40_000_000
        self._begun_ns, self._count, self._due, self._order = time.now_ns(), 0, [], count()

    def next(self, until_ns):
        """The next ``(is_depth, number, clock_ns, arrived_ns)``; None if none comes, at that time."""
        while True:
            exposed_ns = self._begun_ns + (self._count + 1) * PERIOD_NS
            due_ns = self._due[0][0] if self._due else exposed_ns + 10**9
            if min(exposed_ns, due_ns) > until_ns:
                self.time.wait_until(until_ns)
                return None
            if due_ns <= exposed_ns:
                self.time.wait_until(due_ns)
                return heapq.heappop(self._due)[2:]
            self._count += 1
            if not self.silent:
                self._expose(exposed_ns)

    def waits(self):
        """Whether something has come by now that was not taken."""
        exposed_ns = self._begun_ns + (self._count + 1) * PERIOD_NS
        return min([exposed_ns, *(due[0] for due in self._due[:1])]) <= self.time.now_ns()

    def _expose(self, exposed_ns):
        number, clock_ns = self._count, self._count * PERIOD_NS
        for is_depth, here, after_ns in (
            (True, not self.blind and not self.depth_lost(number), self.depth_ns),
            (False, not self.color_lost(number), self.color_latency_ns),
        ):
            if here:
                due_ns = exposed_ns + after_ns
                heapq.heappush(self._due, (due_ns, next(self._order), is_depth, number, clock_ns, due_ns))


class Queue:
    """The queue of an SDK, which drops the oldest where it is full."""

    def __init__(self, source, size):
        self.source, self._items = source, deque(maxlen=size)

    def take(self, timeout_s):
        """The oldest that waits."""
        time = self.source.time
        until_ns = time.now_ns() + round(1e9 * timeout_s)
        while self.source.waits():
            self._put(self.source.next(time.now_ns()))
        if not self._items:
            self._put(self.source.next(until_ns))
        return self._items.popleft() if self._items else None

    def _put(self, item):
        if item is not None:
            self._items.append(item)


class Driver:
    """What the contract sets and reads of one vendor's sensor.

    Attributes:
        color: Keywords of the settings that ask for the image which may be missing; None where there is none.
        source: What gives the images: a stand-in of a device, or a :class:`Schedule`.
        programs: What a busy sensor's message names.
    """

    color: dict | None = None
    programs = ""

    def __init__(self, source=None):
        self.time = VirtualTime()
        self.source = source or Schedule(self.time)

    def settings(self, **settings):
        return CaptureSettings(**settings)

    def sensor(self, serial=A, **settings):
        """A sensor, not opened."""
        return self.kind(serial, self.settings(**settings), clock=self.time.now_ns)

    def image_lost(self, lost):
        """Which exposures have no image beside depth, from now on."""
        self.source.color_lost = lost

    def late_image(self, ns):
        """How long after exposure the image beside depth comes."""
        self.source.color_latency_ns = ns

    def depth_lost(self, lost):
        """Which exposures' depth is lost on USB."""
        self.source.depth_lost = lost

    def infrared_lost(self, lost):
        """Which exposures have no infrared image."""
        self.source.infrared_lost = lost

    def set(self, *, silent=False, blind=False):
        """Nothing comes; images come but no depth."""
        self.source.silent, self.source.blind = silent, blind

    def number(self, frame):
        """Which exposure a frame is of, from 1."""
        return int(frame.depth.flat[0]) - 2000


class OnBus(Driver):
    """A stand-in of a vendor's Python module: two devices on a bus, of which A is played."""

    color = {"color": "720P"}  # noqa: RUF012

    def __init__(self, bus, *devices):
        self.bus, bus.devices = bus, [*devices]
        super().__init__(devices[1])

    def busy(self, serial=A):
        next(device for device in self.bus.devices if device.serial == serial).busy = True

    def unplug(self):
        self.source.plugged = False

    def plug(self):
        self.source.plugged = True

    @property
    def open_serials(self):
        return self.bus.open_serials


class Azure(OnBus):
    """The stand-in for pyk4a."""

    kind, programs, usb = KinectSensor, "k4aviewer", ("045e", "097c")

    def __init__(self, bus, monkeypatch):
        monkeypatch.setattr(pyk4a_access, "usb_kinects", self._on_usb)
        super().__init__(bus, *(Device(serial, paced=True, jacks=(True, True)) for serial in (B, A)))
        for device in bus.devices:
            device.time = self.time

    def _on_usb(self):
        return [UsbKinect(device.serial, Path(), True, 5000) for device in self.bus.plugged()]

    def settings(self, **settings):
        return KinectSettings(**settings)

    def sensor(self, serial=A, **settings):
        return KinectSensor(serial, self.settings(**settings), track=False, clock=self.time.now_ns)


class OrbbecDriver(OnBus):
    """The stand-in for pyorbbecsdk, with the SDK's way of making sets of frames."""

    kind, programs, usb = OrbbecSensor, "OrbbecViewer", ("2bc5", "066b")

    def __init__(self, bus):
        super().__init__(bus, Orbbec(B), Orbbec(A, paced=True, interval_us=33_333))
        bus.time = self.time


class ByLibrary(Driver):
    """A library's list of two sensors, of which A is played by a schedule."""

    def __init__(self):
        super().__init__()
        self.there, self.in_use = [B, A], set()

    def busy(self, serial=A):
        self.in_use.add(serial)

    def unplug(self):
        self.there.remove(A)

    def plug(self):
        self.there.append(A)


class _Listed:
    """The library's list of devices; the busy one raises, as the library does."""

    def __init__(self, driver):
        self._driver = driver

    def __len__(self):
        return len(self._driver.there)

    def __getitem__(self, index):
        serial = self._driver.there[index]
        if serial in self._driver.in_use:
            raise RuntimeError("failed to open usb interface: 0, error: RS2_USB_STATUS_BUSY")
        return self._driver.software[serial].device

    def __iter__(self):
        return (self[index] for index in range(len(self)))


class RealSense(ByLibrary):
    """The real pyrealsense2: software devices, and its queue, which is fed in virtual time."""

    kind, color, programs = RealSenseSensor, {"color": "720P"}, "realsense-viewer"
    usb = ("8086", "0b07")

    def __init__(self, rs, monkeypatch):
        super().__init__()
        self.rs = rs
        self._make(colored=False)
        self._image = np.full((LENS.height, LENS.width), 7, np.uint8)
        queue = rs.frame_queue

        def fed(size, keep):
            return self._fed(queue(size, keep))

        fed.try_wait_for_frame = queue.try_wait_for_frame
        monkeypatch.setattr(rs, "frame_queue", fed)
        listed = SimpleNamespace(query_devices=lambda: _Listed(self))
        monkeypatch.setattr(realsense_access, "context_of", lambda _: listed)
        monkeypatch.setitem(realsense_images.COLOR_SIZES, "720P", (LENS.width, LENS.height))

    def _make(self, colored):
        self.software = {serial: Software(self.rs, serial, color=colored) for serial in (A, B)}

    def sensor(self, serial=A, **settings):
        self._make(colored="color" in settings)
        return super().sensor(serial, **settings)

    def _fed(self, queue):
        """The library's queue; the cameras' frames are put into it when they are due."""

        def try_wait_for_frame(timeout_ms):
            until_ns = self.time.now_ns() + 1_000_000 * timeout_ms
            while self.source.waits():
                self._expose(self.source.next(self.time.now_ns()))
            came, frame = queue.try_wait_for_frame(0)
            if not came and timeout_ms:
                self._expose(self.source.next(until_ns))
                came, frame = queue.try_wait_for_frame(0)
            return came, frame

        def put(frame):
            frame.keep()
            queue(frame)

        put.try_wait_for_frame = try_wait_for_frame
        return put

    def _expose(self, item):
        if item is None:
            return
        is_depth, number, clock_ns, _ = item
        software = self.software[A]
        depth = np.full((LENS.height, LENS.width), 2000 + number, np.uint16)
        image = np.dstack([self._image] * 3) if software.color else self._image
        software.put(number, 10**9 + clock_ns, depth if is_depth else None, None if is_depth else image)

    @property
    def open_serials(self):
        return [serial for serial, one in self.software.items() if one.stereo.get_active_streams()]

    def infrared_lost(self, lost):
        self.image_lost(lost)

    def unplug(self):
        super().unplug()
        self.source.silent = True

    def plug(self):
        super().plug()
        self.source.silent = False


class ScriptedV1(freenect._Camera):
    """A Kinect v1's camera in virtual time, opened through the library."""

    driver = None

    def open(self):
        with libfreenect.Context() as context:
            context.open(self.serial)
        self.driver.open_serials.append(self.serial)

    def take(self, timeout_s):
        if self.lost:
            return None
        item = self.driver.queue.take(timeout_s)
        if item is None:
            return None
        is_depth, number, clock_ns, arrived_ns = item
        image = np.full(SMALL, 2000 + number, np.uint16) if is_depth else np.full((*SMALL, 3), 7, np.uint8)
        return clock_ns, arrived_ns, image

    @property
    def lost(self):
        return self.serial not in self.driver.there

    def close(self):
        self.driver.open_serials.remove(self.serial)


class FakeFreenect:
    """libfreenect's list of sensors, and opening one."""

    def __init__(self, driver):
        self._driver, self._log, self._kept = driver, None, []

    def __getattr__(self, name):
        return lambda *_: 0

    def freenect_set_log_callback(self, _context, log):
        self._log = log

    def freenect_num_devices(self, _):
        return len(self._driver.there)

    def freenect_list_device_attributes(self, _, first):
        items = [libfreenect.Attributes(camera_serial=serial.encode()) for serial in self._driver.there]
        for item, following in pairwise(items):
            item.next = cast(POINTER(libfreenect.Attributes)(following), type(item.next))
        self._kept = items
        if items:
            first.contents = items[0]
        return len(items)

    def freenect_open_device_by_camera_serial(self, _context, _device, serial):
        if serial.decode() in self._driver.in_use:
            self._log(None, 1, b"Failed to claim camera interface: LIBUSB_ERROR_BUSY\n")
            return -6
        return 0


class KinectV1(ByLibrary):
    """A scripted camera."""

    kind, color, programs, usb = FreenectSensor, {}, "freenect-glview", ("045e", "02ae")

    def __init__(self, monkeypatch):
        super().__init__()
        self.open_serials = []
        self.queue = Queue(self.source, freenect._QUEUE)
        monkeypatch.setattr(libfreenect, "load_library", lambda: FakeFreenect(self))
        monkeypatch.setattr(freenect, "_Camera", type("Camera", (ScriptedV1,), {"driver": self}))


class KinectV2(ByLibrary):
    """A scripted camera, whose library gives depth and infrared at once."""

    kind, programs, usb = Freenect2Sensor, "Protonect", ("045e", "02c4")

    def __init__(self, monkeypatch):
        super().__init__()
        self.open_serials = []
        self.source.color_lost = lambda _: True
        self.queue = Queue(self.source, 16)
        monkeypatch.setattr(freenect2, "Camera", self._camera)

    def _camera(self, serial):
        driver = self
        if serial not in self.there:
            raise AbsentError(f"No Kinect v2 with serial {serial}.")
        self.open_serials.append(serial)

        def take(timeout_ms):
            item = driver.queue.take(timeout_ms / 1000) if serial in driver.there else None
            if item is None:
                driver.time.wait_until(driver.time.now_ns() + 1_000_000 * timeout_ms)
                return None
            _, number, clock_ns, arrived_ns = item
            depth = np.full(SMALL, 2000.0 + number, np.float32)
            age_ns = driver.time.now_ns() - arrived_ns
            return Images(round(clock_ns / 125_000) + 1000, age_ns, depth, depth)

        return SimpleNamespace(
            take=take,
            close=lambda: self.open_serials.remove(serial),
            is_connected=lambda: serial in driver.there,
            warnings=[],
            lens=(365.0, 365.0, 256.0, 212.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        )


DRIVERS = {
    "azure": (Azure, "bus"),
    "orbbec": (OrbbecDriver, "orbbecs"),
    "realsense": (RealSense, "rs"),
    "freenect": (KinectV1, None),
    "freenect2": (KinectV2, None),
}
