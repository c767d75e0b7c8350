"""Two Kinects v1 on the real libfreenect and simulated USB; prints what happened as JSON.

Run with ``LD_PRELOAD`` naming ``simulated_usb.c``, compiled.
"""

import ctypes
import itertools
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.freenect.libfreenect import connected_freenects
from devices.freenect.sensor import FreenectSensor
from devices.sensor import DeviceError
from tests.helpers.waiting import eventually

COUNTS = ("usb_handles", "usb_claims", "usb_transfers", "usb_contexts")
USB = ctypes.CDLL(None)
GONE = (ctypes.c_int * 2).in_dll(USB, "usb_gone")


def counts():
    """What is open on the simulated USB."""
    return [ctypes.c_int.in_dll(USB, name).value for name in COUNTS]


def images(serial):
    """Figures of ten frames of a sensor."""
    with FreenectSensor(serial) as sensor:
        frames = [(frame, sensor.rgb) for frame in itertools.islice(sensor.frames(), 10)]
    depth, rgb = frames[-1][0].depth, frames[-1][1]
    rows, columns = np.nonzero(depth == depth[depth > 0].min())
    return {
        "depths": np.unique(depth).tolist(),
        "near": [int(edge) for edge in (rows.min(), rows.max(), columns.min(), columns.max())],
        "rgb": np.median(rgb, axis=(0, 1)).tolist(),
        "periods": np.unique(np.round(np.diff([f.time_ns for f, _ in frames]) / (1e9 / 30), 4)).tolist(),
        "lost": sensor.lost,
    }


def unplugged():
    """What a sensor says when it is unplugged, and whether the pair takes it back."""
    serials = [str(one.serial) for one in connected_freenects()]
    sensors = [FreenectSensor(serial, CaptureSettings(timeout_ms=50)) for serial in serials]
    with TwoSensors(*sensors, limits=TimeLimits(retry_s=0.05)) as two:

        def both():
            return any(pair.a is not None and pair.b is not None for pair in two.poll())

        def first_alone():
            return any(pair.a is not None and pair.b is None for pair in two.poll())

        states = [eventually(both)]
        GONE[1] = 1
        states.append(eventually(first_alone))
        listed = [one.serial for one in connected_freenects()]
        GONE[1] = 0
        states.append(eventually(both))
        said = [event.text for event in two.events()]
    return {"states": states, "listed": listed, "said": said}


def absent():
    """What opening says if the sensor is not there."""
    try:
        FreenectSensor("A00369").__enter__()
    except DeviceError as fault:
        return str(fault)
    return ""


def main():
    """The program."""
    found = {"listed": [one.serial for one in connected_freenects()], "absent": absent()}
    ctypes.c_uint32.in_dll(USB, "usb_first_ticks").value = 2**32 - 9_000_000  # wraps after four frames
    with ThreadPoolExecutor(2) as both:
        found["images"] = list(both.map(images, found["listed"]))
    found["left"] = counts()
    found["unplugged"] = unplugged()
    found["left in the end"] = counts()
    print(json.dumps(found))


if __name__ == "__main__":
    main()
