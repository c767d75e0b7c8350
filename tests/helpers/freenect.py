"""Kinects v1 without hardware: the real libfreenect, and fakenect, its player of dumps, on dumps of tests.

Fakenect 0.5 plays one sensor per process, lists none and knows no registered depth, though it hands on any
dump. So each opening here loads a copy of fakenect; the list of sensors and the modes, which the real library
gives without a sensor, are put beside it. Everything else is fakenect's: events, callbacks, images, times.
"""

import ctypes
import ctypes.util
import itertools
import os
import shutil
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from devices.freenect import libfreenect
from devices.freenect.libfreenect import SIGNATURES, Attributes
from tests.helpers.machine import lacks

PERIOD = 2_000_000  # ticks between two frames
_REMEDY = "Debian: apt install libfreenect0.5"


@pytest.fixture(autouse=True)
def without_libfreenect(monkeypatch):
    """Hides an installed libfreenect from tests that do not ask for it."""
    libfreenect.load_library.cache_clear()
    monkeypatch.setattr(libfreenect, "find_library", lambda _: None)


@pytest.fixture
def real_freenect(monkeypatch):
    """The real library, with the types of its functions; no sensor is connected."""
    if ctypes.util.find_library("freenect") is None:
        lacks("libfreenect", _REMEDY)
    monkeypatch.setattr(libfreenect, "find_library", ctypes.util.find_library)
    return libfreenect.load_library()


@pytest.fixture
def fakenect(real_freenect, tmp_path, monkeypatch):
    """Kinects v1, which a test puts into ``dumps`` by serial number."""
    made = Fakenect(fakenect_file(), real_freenect, tmp_path / "fakenect")
    monkeypatch.setenv("FAKENECT_PATH", "")
    monkeypatch.setattr(libfreenect, "load_library", lambda: made)
    return made


def fakenect_file():
    """The library fakenect; skips the running test where it is not installed."""
    debian = Path("/usr/lib").glob("*/fakenect/libfreenect.so.0.5")
    by_hand = Path("/usr/local/lib/fakenect").glob("libfreenect.so*")
    return next((file for files in (debian, by_hand) for file in files), None) or lacks("fakenect", _REMEDY)


def typed(library):
    """Gives the functions that a library has their types; returns those that it lacks."""
    missing = [name for name in SIGNATURES if not hasattr(library, name)]
    for name in SIGNATURES.keys() - set(missing):
        result, *arguments = SIGNATURES[name]
        getattr(library, name).restype, getattr(library, name).argtypes = result, arguments
    return missing


class Fakenect:
    """What ``load_library`` gives: a copy of fakenect behind each context.

    Attributes:
        dumps: The connected sensors' dumps, by serial number.
        forbidden: How many more sensors are connected that this user may not open.
        busy: Sensors that do not open.
        still: Sensors whose cameras do not start.
        open: Serial numbers of the sensors that are open.
        streams: Names of the running streams, by serial number.
    """

    _name = "libfreenect.so.0.5"

    def __init__(self, file, real, folder):
        self._file, self._real, self._folder = file, real, folder
        self.dumps, self.forbidden, self.busy, self.still = {}, 0, set(), set()
        self.open, self.streams = [], {}
        self._copies, self._serials, self._logs, self._lock = {}, {}, {}, threading.Lock()
        self._numbers = itertools.count(1)
        folder.mkdir()
        self.freenect_find_depth_mode = real.freenect_find_depth_mode
        self.freenect_find_video_mode = real.freenect_find_video_mode

    def __getattr__(self, name):
        """A function of the copy that its first argument, a context or a device, belongs to."""
        if name not in SIGNATURES:
            raise AttributeError(name)
        return lambda handle, *arguments: getattr(self._copies[handle.value], name)(handle, *arguments)

    def freenect_init(self, context, usb):
        number = next(self._numbers)
        copy = ctypes.CDLL(shutil.copy(self._file, self._folder / f"{number}.so"))
        typed(copy)
        code = copy.freenect_init(context, usb)
        self._copies[number], context.value = copy, number
        return code

    def freenect_shutdown(self, context):
        return self._copies.pop(context.value).freenect_shutdown(context)

    def freenect_set_log_callback(self, context, callback):
        self._logs[context.value] = callback

    def freenect_num_devices(self, _):
        return len(self.dumps) + self.forbidden

    def freenect_list_device_attributes(self, _, first):
        items = [Attributes(camera_serial=serial.encode()) for serial in self.dumps]
        for item, following in itertools.pairwise(items):
            item.next = ctypes.pointer(following)
        if items:
            first.contents = items[0]
        return len(items)

    def freenect_free_device_attributes(self, first):
        assert isinstance(first, ctypes.POINTER(Attributes))

    def freenect_open_device_by_camera_serial(self, context, device, serial):
        name, copy = serial.decode(), self._copies[context.value]
        if name in self.busy:
            self._logs[context.value](context, 1, b"Failed to claim camera interface: LIBUSB_ERROR_BUSY\n")
            return -6
        with self._lock:  # fakenect reads the variable at its first event
            os.environ["FAKENECT_PATH"] = str(self.dumps[name])
            code = copy.freenect_open_device_by_camera_serial(context, device, serial)
            assert copy.freenect_process_events_timeout(context, libfreenect._Timeval()) == 0
        device.value = context.value
        self._serials[context.value] = name
        self.open.append(name)
        self.streams[name] = set()
        return code

    def freenect_close_device(self, device):
        self.open.remove(self._serials[device.value])
        return self._copies[device.value].freenect_close_device(device)

    def freenect_process_events_timeout(self, context, timeout):
        if self._serials[context.value] not in self.dumps:
            return -1  # as the real library does when USB lost the device
        return self._copies[context.value].freenect_process_events_timeout(context, timeout)

    def freenect_start_depth(self, device):
        return self._start("depth", device)

    def freenect_start_video(self, device):
        return self._start("video", device)

    def freenect_stop_depth(self, device):
        return self._stop("depth", device)

    def freenect_stop_video(self, device):
        return self._stop("video", device)

    def _start(self, stream, device):
        name = self._serials[device.value]
        if name in self.still:
            return -1
        self.streams[name].add(stream)
        return getattr(self._copies[device.value], f"freenect_start_{stream}")(device)

    def _stop(self, stream, device):
        self.streams[self._serials[device.value]].discard(stream)
        return getattr(self._copies[device.value], f"freenect_stop_{stream}")(device)


def write_dump(folder, events, pace=1.0):
    """Writes a folder as fakenect-record does.

    Args:
        events: (seconds, ticks, image) in order; depth is (480, 640) uint16 millimetres, colour
            (480, 640, 3) uint8.
        pace: How long fakenect takes for a second.
    """
    folder.mkdir(parents=True)
    begun = time.time()
    names, files = [f"a-{begun:.6f}-0.dump"], {}
    (folder / names[0]).write_bytes(bytes(12))  # a freenect_raw_tilt_state
    for seconds, ticks, image in events:
        kind, extension, header = ("d", "pgm", "P5 640 480 65535\n")
        if image.ndim == 3:
            kind, extension, header = ("r", "ppm", "P6 640 480 255\n")
        names.append(f"{kind}-{begun + seconds * pace:.6f}-{ticks % 2**32}.{extension}")
        path = folder / names[-1]
        if id(image) in files:  # the same image once more
            path.hardlink_to(files[id(image)])
        else:
            path.write_bytes(header.encode() + image.tobytes())
            files[id(image)] = path
    (folder / "INDEX.txt").write_text("".join(f"{name}\n" for name in names))
    return folder


def film(depths, rgbs, first_ticks=0, color_late=400_000, period=PERIOD):
    """Events of depth images, each with a colour image so many ticks later."""
    events = []
    for number, (depth, rgb) in enumerate(zip(depths, rgbs, strict=True)):
        ticks = number * period
        events += [(ticks / 60e6, first_ticks + ticks, depth)] if depth is not None else []
        late = ticks + color_late
        events += [(late / 60e6, first_ticks + late, rgb)] if rgb is not None else []
    return sorted(events, key=lambda event: event[0])


def numbered(count):
    """Depth and colour images that hold their number."""
    depths = [np.full((480, 640), 1000 + number, np.uint16) for number in range(count)]
    return depths, [np.full((480, 640, 3), number, np.uint8) for number in range(count)]
