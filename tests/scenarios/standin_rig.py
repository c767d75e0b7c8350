"""Two stand-in Kinects with a stand-in libk4abt, told by a file ``rig.conf`` what happens, as the rig is.

The keys are those of ``../shared/rig/README.md``; the file is read again when it changes. All runs in one
process without a compiler: libk4abt is of Python here, and its ABI is tested elsewhere.
"""

import ctypes
import itertools
import random
import sys
import threading
import time
from collections import deque
from types import SimpleNamespace

import numpy as np

from devices.azure import checks, pyk4a_internals
from devices.azure.tracking import body_tracker
from fusion.body import AZURE_KINECT
from tests.helpers.standin_camera import Device
from tests.helpers.standin_pyk4a import Bus, make_module
from tests.helpers.two_views import A_FROM_B, standing

SERIALS = ("000001111111", "000002222222")
_STANDING = standing(AZURE_KINECT)
_SEEN = {SERIALS[0]: _STANDING, SERIALS[1]: A_FROM_B.inverse().apply(_STANDING)}
_OK, _FAILED, _TIMEOUT = 0, 1, 2
_JOINT = body_tracker._JOINT


class Rig:
    """The bus and the body tracker of a running program."""

    def __init__(self, conf):
        self._conf, self._read_at, self._values = conf, 0, dict[str, str]()
        self.bus = Bus(None)
        self.bus.devices = [Device(serial, paced=True) for serial in SERIALS]
        self.gpu = threading.Lock()
        self.follow()

    def get(self, key, default=0.0):
        """The number of a key."""
        return float(self._values.get(key, default))

    def follow(self):
        """Reads the file again if it changed, and sets the devices."""
        changed = self._conf.stat().st_mtime_ns
        if changed == self._read_at:
            return
        self._read_at = changed
        self._values = dict(line.split("=", 1) for line in self._conf.read_text().splitlines())
        for side, device in zip("ab", self.bus.devices, strict=True):
            self._set(device, f"{side}.")

    def _set(self, device, of):
        jack, get = int(self.get(of + "jack")), self.get
        device.jacks = bool(jack & 1), bool(jack & 2)
        device.plugged, device.silent = bool(get(of + "present", 1)), bool(get(of + "stall"))
        device.busy = any(get(of + key) for key in ("busy", "uvc_busy", "denied"))
        device.depth_latency_ns = round(1e6 * get(of + "depth_latency_ms", 25))
        device.color_latency_ns = round(1e6 * get(of + "color_latency_ms", 60))
        device.color, device.lost_on_usb = not get(of + "color_dead"), get(of + "drop")
        device.first_usec = round(1000 * get(of + "first_pts_ms"))
        device.open_s, device.stop_s = get("open_ms", 200) / 1000, get("stop_ms", 100) / 1000
        device.start_s = (get("start_ms", 250) + get("color_start_ms", 300)) / 1000
        device.firmware = tuple(map(int, self._values.get(of + "fw", "1.6.110").split(".")))
        device.log.clear()
        device.starts = not (get(of + "color_fails") or get("engine_fails"))
        if device.firmware < (1, 5, 92):
            number = self._values[of + "fw"]
            said = f"Firmware version for RGB is {number} is not current enough. Use 1.5.92 or newer."
            device.log["open"] = f"is_fw_version_compatable(). {said}"
        if get(of + "color_fails"):
            device.log["start"] = "color_start(device->color, config) returned failure"
        if get("engine_fails"):
            device.log["start"] = "dewrapper_start(). Depth Engine thread failed to start"

    def keep_following(self):
        """Follows the file on a thread."""

        def run():
            while True:
                time.sleep(0.01)
                self.follow()

        threading.Thread(target=run, daemon=True).start()

    def libk4a(self):
        """What the program calls of libk4a itself."""

        def listen(handler, _context, _level):
            self.bus.log_handler = handler

        def version_of(handle, version):
            version._obj.rgb[:] = self.bus.devices[handle - 1].firmware
            return _OK

        return SimpleNamespace(
            k4a_set_debug_message_handler=listen, k4a_device_get_version=version_of, _name="libk4a"
        )


class _Tracker:
    """A body tracker on a thread of its own, with bounded queues."""

    def __init__(self, rig, serial):
        self.rig, self.serial, self.side = rig, serial, "ab"[SERIALS.index(serial)]
        self.room = threading.Condition()
        self.waiting = deque()
        self.results = deque()
        self.stopped = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        while True:
            with self.room:
                self.room.wait_for(lambda: self.stopped or self.waiting)
                if self.stopped:
                    return
                usec = self.waiting.popleft()
                self.room.notify_all()
            get = self.rig.get
            while get(f"bt.hang_{self.side}") and not self.stopped:
                time.sleep(0.01)
            ms = get(f"bt.ms_{self.side}", get("bt.ms", 15)) + get("bt.jitter_ms") * random.random()
            with self.rig.gpu if get("bt.one_gpu") else threading.Lock():
                time.sleep(ms / 1000)
            with self.room:
                self.results.append(usec)
                self.room.notify_all()


def libk4abt(rig):
    """The functions of libk4abt, which take what ``ctypes`` passes."""
    trackers = {}
    frames = {}
    handles = itertools.count(1)

    def create(calibration, _configuration, out):
        time.sleep(rig.get("bt.load_ms", 800) / 1000)
        if rig.get("bt.create_fails"):
            return _FAILED
        serial = SERIALS[ctypes.c_int.from_address(calibration).value]
        out._obj.value = next(handles)
        trackers[out._obj.value] = _Tracker(rig, serial)
        return _OK

    def shut_down(tracker):
        mine = trackers[tracker.value or 0]
        with mine.room:
            mine.stopped = True
            mine.room.notify_all()

    def destroy(tracker):
        mine = trackers.pop(tracker.value or 0)
        mine.thread.join()
        time.sleep(rig.get("bt.destroy_ms", 200) / 1000)

    def enqueue(tracker, capture, timeout_ms):
        mine = trackers[tracker.value or 0]
        if rig.get(f"bt.fail_{mine.side}"):
            return _FAILED
        with mine.room:
            if not mine.room.wait_for(lambda: len(mine.waiting) < 3, timeout_ms / 1000):
                return _TIMEOUT
            mine.waiting.append(capture)
            mine.room.notify_all()
        return _OK

    def pop(tracker, out, timeout_ms):
        mine = trackers[tracker.value or 0]
        with mine.room:
            if not mine.room.wait_for(lambda: mine.results, timeout_ms / 1000):
                return _TIMEOUT
            out._obj.value = next(handles)
            frames[out._obj.value] = mine.results.popleft(), mine.serial
        return _OK

    def skeleton(frame, _index, address):
        joints = np.zeros(len(AZURE_KINECT), _JOINT)
        joints["position"], joints["confidence"] = 1000.0 * _SEEN[frames[frame.value or 0][1]], 2
        ctypes.memmove(address, joints.ctypes.data, joints.nbytes)
        return _OK

    functions = {
        "tracker_create": create,
        "tracker_shutdown": shut_down,
        "tracker_destroy": destroy,
        "tracker_set_temporal_smoothing": lambda *_: None,
        "tracker_enqueue_capture": enqueue,
        "tracker_pop_result": pop,
        "frame_get_num_bodies": lambda frame: 0 if rig.get("bt.nobody") else 1,
        "frame_get_body_skeleton": skeleton,
        "frame_get_body_id": lambda *_: 1,
        "frame_get_device_timestamp_usec": lambda frame: frames[frame.value or 0][0],
        "frame_release": lambda frame: frames.pop(frame.value or 0) and None,
    }
    named = {f"k4abt_{name}": function for name, function in functions.items()}
    return SimpleNamespace(_name="libk4abt of the stand-in", **named)


def install(folder):
    """Puts the stand-ins in the place of pyk4a and libk4abt, as ``folder/rig.conf`` says."""
    rig = Rig(folder / "rig.conf")
    sdk = make_module(rig.bus)
    sdk.__spec__ = SimpleNamespace(name="pyk4a")
    sys.modules["pyk4a"] = sdk
    libk4a, tracker = rig.libk4a(), libk4abt(rig)
    pyk4a_internals.loaded_libk4a = lambda: libk4a
    body_tracker.load_library = checks.load_library = lambda *_: tracker
    rig.keep_following()
    return rig
