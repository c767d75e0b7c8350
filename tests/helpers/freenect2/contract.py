"""Two Kinects v2 on libfreenect2; prints what happened as JSON.

On the real library, run it with ``LD_PRELOAD`` naming ``simulated_usb_v2.c``, compiled. Else libfreenect2 is
the stand-in, and its images come from here.
"""

import ctypes
import itertools
import json
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.freenect2.library import PREFIX, connected_freenect2s
from devices.freenect2.sensor import Freenect2Sensor, unmirrored_lens
from devices.sensor import DeviceError
from tests.helpers.waiting import eventually

FPS = 3  # the real library's images take a processor 150 ms or more
FAR, NEAR, ROWS, COLUMNS = (
    2500.0,
    1875.0,
    slice(50, 150),
    slice(100, 200),
)  # the scene, from the camera, mirrored
DEPTH, INFRARED = 4, 2
COUNTS = ("usb_handles", "usb_claims", "usb_transfers")
SETTINGS = CaptureSettings(timeout_ms=500)


def rays(camera):
    """The length of the ray through each pixel to the plane one metre away."""
    pixels = np.stack(np.meshgrid(np.arange(512.0), np.arange(424.0)), axis=-1).reshape(-1, 1, 2)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    at = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion)).reshape(424, 512, 2)
    return np.sqrt(1.0 + (at**2).sum(axis=2))


class Library:
    """What a test sets and reads of the simulated USB or of the stand-in."""

    def __init__(self):
        self._loaded = ctypes.CDLL(None)
        self.real = hasattr(self._loaded, "usb_fps")
        if self.real:
            ctypes.c_int.in_dll(self._loaded, "usb_fps").value = FPS
        else:
            self._loaded = ctypes.CDLL(str(Path(os.environ[PREFIX]) / "lib" / "libfreenect2.so"))
            self._frame = self._loaded.standin_frame
            self._frame.argtypes = (*[ctypes.c_int] * 2, *[ctypes.c_uint32] * 3, ctypes.c_void_p)

    def set(self, name, value, kinect=None):
        """Sets what a sensor, or all of USB, does."""
        if kinect is None:
            ctypes.c_int.in_dll(self._loaded, f"usb_{name}").value = value
        else:
            (ctypes.c_int * 2).in_dll(self._loaded, f"usb_{name}")[kinect] = value

    def counts(self):
        """What is open."""
        return [
            ctypes.c_int.in_dll(self._loaded, name).value for name in COUNTS if hasattr(self._loaded, name)
        ]

    def lens(self):
        """The lens that each sensor stores, in the order of ``Camera.lens``."""
        fx, fy, _, *rest = (ctypes.c_float * 10).in_dll(self._loaded, "usb_lens")
        return fx, fy, *rest

    def give(self, kinect, kind, number, image, status=0, ticks=None):
        """Gives a frame of the stand-in; returns whether the sensor runs."""
        assert image.dtype == np.float32
        ticks = (1000 + number * 800 // 3) % 2**32 if ticks is None else ticks
        given = self._frame(kinect, kind, number, ticks, status, np.ascontiguousarray(image).ctypes.data)
        assert given >= 0
        return bool(given)

    def run(self, ending):
        """Gives images of the scene in real time."""
        camera = unmirrored_lens(self.lens())
        ranges = np.full((424, 512), FAR)
        ranges[ROWS, COLUMNS] = NEAR
        depth = (ranges / rays(camera)[:, ::-1]).astype(np.float32)
        depth[:, 0], depth[:, -1] = np.nan, -np.inf
        infrared = np.full((424, 512), 6300.0, np.float32)
        begun = time.monotonic()
        for number in itertools.count(1):
            if ending.wait(max(0.0, begun + number / FPS - time.monotonic())):
                return
            for kinect, kind in itertools.product((0, 1), (INFRARED, DEPTH)):
                ticks = 1000 + number * 8000 // FPS
                self.give(kinect, kind, number, depth if kind == DEPTH else infrared, ticks=ticks)


def said(serial):
    """What opening a sensor says; empty if it opens."""
    try:
        with Freenect2Sensor(serial):
            return ""
    except DeviceError as fault:
        return f"{type(fault).__name__}: {fault}"


def images(serial):
    """Figures of some frames of a sensor."""
    with Freenect2Sensor(serial, SETTINGS) as sensor:
        frames = list(itertools.islice(sensor.frames(), 4))
        twice = said(serial)
    depth, infrared = frames[-1].depth, frames[-1].ir
    ranges = depth * rays(sensor.intrinsics)
    rows, columns = np.nonzero((ranges > 0) & (ranges < (FAR + NEAR) / 2))
    far = ranges[ranges > (FAR + NEAR) / 2]
    steps = np.diff([frame.time_ns for frame in frames]) / 1e9 * FPS
    return {
        "types": [str(depth.dtype), str(infrared.dtype), *depth.shape, *infrared.shape],
        "near": [int(edge) for edge in (rows.min(), rows.max(), columns.min(), columns.max())],
        "far": np.quantile(far, (0.02, 0.5, 0.98)).tolist(),
        "seen": float(np.mean(depth > 0)),
        "infrared": float(np.median(infrared)),
        "steps": steps.tolist(),
        "lens": [sensor.intrinsics.cx, sensor.intrinsics.cy, *sensor.intrinsics.distortion],
        "warnings": sensor.warnings,
        "twice": twice,
    }


def unplugged(library, serials):
    """Whether a pair takes an unplugged sensor back, and what it says."""
    sensors = [Freenect2Sensor(serial, SETTINGS) for serial in serials]
    told = []
    with TwoSensors(*sensors, limits=TimeLimits(retry_s=0.2)) as two:

        def given():
            told.extend(event.text for event in two.events())
            return {(pair.a is not None, pair.b is not None) for pair in two.poll()}

        states = [eventually(lambda: (True, True) in given())]
        library.set("gone", 1, 1)
        states.append(eventually(lambda: (True, False) in given() and "unplugged" in " ".join(told)))
        listed = [one.serial for one in connected_freenect2s()]
        library.set("replugged", 1, 1)
        library.set("gone", 0, 1)
        states.append(eventually(lambda: (True, True) in given()))
    return {"states": states, "listed": listed, "said": told}


def main():
    """The program."""
    library, ending = Library(), threading.Event()
    serials = [one.serial for one in connected_freenect2s()]
    found = {"real": library.real, "listed": serials, "absent": said("999")}
    if not library.real:
        threading.Thread(target=library.run, args=(ending,), daemon=True).start()
    for name in ("forbidden", "busy"):
        library.set(name, 1, 1)
        found[name] = [[one.serial, one.fault] for one in connected_freenect2s()]
        found[f"{name} opened"] = said(serials[1])
        library.set(name, 0, 1)
    library.set("submissions", 0)
    found["no memory"] = said(serials[0])
    library.set("submissions", 20)
    with Freenect2Sensor(serials[0]) as sensor:
        found["little memory"] = sensor.warnings
    library.set("submissions", -1)
    found["left after faults"] = library.counts()
    with ThreadPoolExecutor(2) as both:
        found["images"] = list(both.map(images, serials))
    found["unplugged"] = unplugged(library, serials)
    found["left in the end"] = library.counts()
    ending.set()
    print(json.dumps(found))


if __name__ == "__main__":
    main()
