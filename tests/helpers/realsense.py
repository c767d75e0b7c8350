"""RealSense sensors without hardware: software devices of the real pyrealsense2, and its recorder."""

import gc
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from devices.realsense.sdk_access import context_of
from fusion.intrinsics import Intrinsics
from tests.helpers.machine import lacks

LENS = Intrinsics(320, 240, 200.0, 200.0, 160.0, 120.0)
FPS = 30
BASELINE = 0.1  # metres, from the depth camera to the colour camera, to the right


@pytest.fixture(autouse=True)
def without_pyrealsense2(request, monkeypatch):
    """Hides an installed pyrealsense2 from tests that do not ask for it."""
    if not {"rs", "driver"} & set(request.fixturenames):
        monkeypatch.setitem(sys.modules, "pyrealsense2", None)


@pytest.fixture(scope="session")
def rs():
    """The real library; skips the running test where it is not installed."""
    try:
        import pyrealsense2
    except ImportError:
        lacks("pyrealsense2", "pip install pyrealsense2")
    return pyrealsense2


class Software:
    """A software device with depth and infrared, or with depth and colour, of one lens."""

    def __init__(
        self,
        rs,
        serial="1001",
        lens=LENS,
        *,
        color=False,
        sync=True,
        units=0.001,
        line="D400",
        fps=FPS,
        baseline=BASELINE,
    ):
        self.rs, self.units, self.color = rs, units, color
        self.device = device = rs.software_device()
        info = {rs.camera_info.name: "Software D455", rs.camera_info.serial_number: serial}
        info |= {rs.camera_info.product_line: line, rs.camera_info.usb_type_descriptor: "3.2"}
        for kind, value in info.items():
            device.register_info(kind, value)
        self.stereo = device.add_sensor("Stereo Module")
        self.stereo.add_read_only_option(rs.option.depth_units, units)
        if sync:
            modes = rs.option_range()
            modes.min, modes.max, modes.step, modes.default = 0, 260, 1, 0
            self.stereo.add_option(rs.option.inter_cam_sync_mode, modes, True)
        self.depth = self.add(self.stereo, rs.stream.depth, rs.format.z16, 2, lens, fps)
        if color:
            self.camera = device.add_sensor("RGB Camera")
            self.image = self.add(self.camera, rs.stream.color, rs.format.rgb8, 3, lens, fps)
            beside = rs.extrinsics()
            beside.rotation, beside.translation = np.eye(3).ravel().tolist(), [-baseline, 0.0, 0.0]
            self.depth.register_extrinsics_to(self.image, beside)
        else:
            self.camera = self.stereo
            self.image = self.add(self.camera, rs.stream.infrared, rs.format.y8, 1, lens, fps)

    def add(self, sensor, kind, form, size, lens, fps, index=1, uid=0):
        stream, lenses = self.rs.video_stream(), self.rs.intrinsics()
        lenses.width, lenses.height, lenses.fx, lenses.fy = lens.width, lens.height, lens.fx, lens.fy
        lenses.ppx, lenses.ppy, lenses.model = lens.cx, lens.cy, self.rs.distortion.brown_conrady
        lenses.coeffs = [0.0] * 5
        stream.type, stream.fmt, stream.bpp, stream.fps = kind, form, size, fps
        stream.index = index * int(kind == self.rs.stream.infrared)
        stream.uid = uid + 10 * index + int(kind != self.rs.stream.depth)
        stream.width, stream.height, stream.intrinsics = lens.width, lens.height, lenses
        return sensor.add_video_stream(stream).as_video_stream_profile()

    def put(self, number, time_ns, depth, image):
        """The device exposes once; None for what does not come."""
        pairs = ((self.stereo, self.depth, depth), (self.camera, self.image, image))
        for sensor, profile, pixels in pairs:
            if pixels is None:
                continue
            frame, size = self.rs.software_video_frame(), pixels.nbytes // (pixels.shape[0] * pixels.shape[1])
            frame.pixels, frame.bpp, frame.stride = np.ascontiguousarray(pixels), size, pixels.shape[1] * size
            frame.timestamp, frame.frame_number, frame.profile = time_ns * 1e-6, number, profile
            frame.domain, frame.depth_units = self.rs.timestamp_domain.hardware_clock, self.units
            sensor.on_video_frame(frame)


def numbered(count, lens=LENS, first_ns=1_000_000_000, fps=FPS):
    """Frames whose pixels tell their number: (time in ns, depth, infrared)."""
    size = (lens.height, lens.width)
    for k in range(count):
        time_ns = first_ns + round(k * 1e9 / fps)
        yield time_ns, np.full(size, 2001 + k, np.uint16), np.full(size, k % 251, np.uint8)


def as_exposed(frames):
    """The images of a simulated sensor: (time in ns, depth, infrared with 8 bits, as a D400 has it)."""
    for frame in frames:
        yield frame.time_ns, frame.depth, np.clip(np.sqrt(frame.ir) * 5.0, 0, 255).astype(np.uint8)


def record(rs, path, frames, *, pause_s=0.0, **of):
    """Writes a recording with the library's own recorder, and returns its path.

    Args:
        pause_s: Between two frames; what is to be played in real time is recorded in real time.
        of: See :class:`Software`.
    """
    software = Software(rs, **of)
    recorder = rs.recorder(str(path), software.device)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda _: None)
    for number, (time_ns, depth, image) in enumerate(frames):
        software.put(number, time_ns, depth, image)
        time.sleep(pause_s)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del sensor, sensors, recorder
    gc.collect()  # the recorder closes its file when nothing refers to it
    return path


@contextmanager
def plugged(rs, *paths):
    """Recordings that the process's context lists as connected sensors, which play in real time."""
    context = context_of(rs)
    devices = [context.load_device(str(path)) for path in paths]
    try:
        yield devices
    finally:
        del devices
        for path in paths:
            context.unload_device(str(path))
