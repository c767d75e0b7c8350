"""Writes recordings in the Azure Kinect's layout, for tests: as long and as broken as they need."""

import cv2
import numpy as np

from devices.azure.calibration import DEPTH_MODES
from devices.azure.mkv_writer import MkvWriter
from devices.capture.settings import LASER_GAP_US, CaptureSettings
from devices.sensor import ColorCamera, ColorImage, SensorFrame
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

INTERVAL_US = 33_000


def lens_of(mode):
    """An ideal lens of the nominal focal length in a depth mode; its axis is in the middle of the sensor."""
    (width, height), (left, top) = DEPTH_MODES[mode].binned, DEPTH_MODES[mode].crop
    size = DEPTH_MODES[mode].width, DEPTH_MODES[mode].height
    focal = 0.4921875 * width, 0.4921875 * height
    return Intrinsics(*size, *focal, width / 2 - left - 0.5, height / 2 - top - 0.5)


def depth_image(index, mode="NFOV_2X2BINNED"):
    """The depth image of a frame: a slope that names its frame."""
    shape = DEPTH_MODES[mode].height, DEPTH_MODES[mode].width
    return (np.arange(shape[0] * shape[1]) % 4000 + index + 1).astype(np.uint16).reshape(shape)


def grey_color():
    """A colour image of one grey, of a camera 32 mm aside."""
    jpeg = cv2.imencode(".jpg", np.full((720, 1280, 3), 100, np.uint8))[1].tobytes()
    place = RigidTransform.of(np.eye(3), (-0.032, 0.0, 0.0))
    return ColorImage(jpeg, ColorCamera(Intrinsics(1280, 720, 630.0, 630.0, 639.5, 359.5), place))


def write_mkv(
    path,
    frames,
    mode="NFOV_2X2BINNED",
    start_offset_ns=336_277_000,
    serial="000123",
    color=False,
    calibration=b"",
    sync="SUBORDINATE",
    images=None,
    lens=None,
    compress=False,
):
    """Writes a recording; colour is one grey.

    Args:
        path: The file.
        frames: How many frames.
        mode: A key of ``DEPTH_MODES``.
        start_offset_ns: Device time of the first frame.
        serial: Of the sensor.
        color: Whether there is colour.
        calibration: The sensor's JSON; empty: that of the lens.
        sync: ``MASTER``, ``SUBORDINATE`` or ``STANDALONE``.
        images: Depth and infrared of each frame; None: :func:`depth_image`, and infrared is depth + 1.
        lens: Of the depth camera; None: :func:`lens_of` the mode.
        compress: Whether depth and infrared are compressed.
    """
    grey = grey_color() if color else None

    def frame(index):
        depth, infrared = (
            images[index] if images is not None else [depth_image(index, mode) + k for k in (0, 1)]
        )
        return SensorFrame(start_offset_ns + 1000 * index * INTERVAL_US, depth=depth, ir=infrared, color=grey)

    settings = CaptureSettings(mode, sync=sync.lower(), delay_us=LASER_GAP_US)
    about = serial, settings, lens or lens_of(mode), frame(0)
    with MkvWriter(path, *about, calibration=calibration, compress=compress) as writer:
        for index in range(frames):
            writer.write(frame(index))
    return path


def write_simulated(path, sensor, start_offset_ns, sync):
    """Writes the depth and infrared images of a simulated Azure Kinect with binned images.

    The scene's frame interval must be :data:`INTERVAL_US`, and every frame must have both images.
    """
    images = [(frame.depth, frame.ir) for frame in sensor.frames()]
    more = {"start_offset_ns": start_offset_ns, "sync": sync, "images": images, "lens": sensor.intrinsics}
    return write_mkv(path, len(images), **more)
