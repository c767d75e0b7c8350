"""``duplex`` with two sensors plugged in that the vendor's real library simulates.

``python -m tests.helpers.plugged_in realsense FOLDER ARGUMENTS…`` plays the recordings ``FOLDER/*.db3`` of
software devices as RealSenses, ``freenect`` the dumps ``FOLDER/*`` by fakenect as Kinects v1.
"""

import itertools
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

from devices.freenect import libfreenect
from devices.freenect.sensor import INTRINSICS
from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, KINECT_V1
from fusion.intrinsics import NOMINAL_INTRINSICS
from tests.helpers.freenect import Fakenect, fakenect_file, film, write_dump
from tests.helpers.realsense import FPS, as_exposed, plugged, record
from viewer_app.cli import script

_RENDERED = 15  # frames, of which a longer film is made
SERIALS = ("A1001", "A1002")


def record_realsenses(rs, folder, seconds):
    """Writes what two software devices of pyrealsense2 see of a person in the start-up pose."""
    pair = simulated_pair(motion="startup", body=AZURE_KINECT, depth="half", infrared=True, seconds=0.5)[:2]

    def write(serial, sensor):
        moments = ((1_000_000_000 + k * 10**9 // FPS, *shot) for k, shot in _to_and_fro(sensor, seconds))
        path = folder / f"{serial}.db3"
        return record(rs, path, moments, pause_s=1.0 / FPS, serial=serial, lens=sensor.intrinsics)

    with ThreadPoolExecutor() as pool:
        list(pool.map(write, SERIALS, pair))


def dump_freenects(folder, seconds):
    """Writes what two Kinects v1 see of a person in the start-up pose, as fakenect-record does."""
    with mock.patch.dict(NOMINAL_INTRINSICS, {KINECT_V1.name: INTRINSICS}):
        pair = simulated_pair(motion="startup", body=KINECT_V1, depth="full", infrared=True, seconds=0.5)[:2]
    for serial, sensor in zip(SERIALS, pair, strict=True):
        colored = {}

        def rgb(grey, colored=colored):
            return colored.setdefault(id(grey), np.repeat(grey[..., None], 3, axis=2))

        shots = [shot for _, shot in _to_and_fro(sensor, seconds)]
        write_dump(folder / serial, film([depth for depth, _ in shots], [rgb(grey) for _, grey in shots]))


def _to_and_fro(sensor, seconds):
    """Depth and 8-bit images of a sensor, which is played forwards and backwards, with their numbers."""
    shots = [shot for _, *shot in as_exposed(sensor.frames())][:_RENDERED]
    return enumerate(itertools.islice(itertools.cycle(shots + shots[::-1]), seconds * FPS))


@contextmanager
def _realsense(folder):
    import pyrealsense2 as rs

    with plugged(rs, *sorted(folder.glob("*.db3"))):
        yield


@contextmanager
def _freenect(folder):
    os.environ["FAKENECT_PATH"] = ""
    with tempfile.TemporaryDirectory() as copies:
        made = Fakenect(fakenect_file(), libfreenect.load_library(), Path(copies) / "fakenect")
        made.dumps.update({serial: folder / serial for serial in SERIALS})
        with mock.patch.object(libfreenect, "load_library", return_value=made):
            yield


if __name__ == "__main__":
    _, library, where, *arguments = sys.argv
    sys.argv = ["duplex", *arguments]
    with {"realsense": _realsense, "freenect": _freenect}[library](Path(where)):
        script()
