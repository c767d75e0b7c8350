"""Writes recordings in the Azure Kinect's layout, for tests: as long and as broken as they need."""

import json
import struct
from fractions import Fraction

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from devices.azure.calibration import DEPTH_MODES

INTERVAL_US = 33_000  # whole milliseconds: the muxer's own time scale
_MICROSECONDS = Fraction(1, 1_000_000)
Images = tuple[NDArray[np.uint16], NDArray[np.uint16]]


def calibration_json(middle=(0.5, 0.5)):
    """A calibration as a sensor stores it: an ideal lens of the nominal focal length, colour 32 mm aside.

    Args:
        middle: Principal point as shares of the whole 1024 × 1024 sensor.
    """
    ideal = [*middle, 0.4921875, 0.4921875, *[0.0] * 10]

    def camera(purpose, size, translation):
        return {
            "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
            "Intrinsics": {"ModelParameters": ideal, "ModelParameterCount": 14},
            "Rt": {"Rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "Translation": translation},
            "SensorWidth": size[0],
            "SensorHeight": size[1],
        }

    cameras = [camera("Depth", (1024, 1024), [0, 0, 0]), camera("PhotoVideo", (4096, 3072), [-0.032, 0, 0])]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode()


def depth_image(index, mode="NFOV_2X2BINNED"):
    """The depth image of a frame: a slope that names its frame."""
    shape = DEPTH_MODES[mode].height, DEPTH_MODES[mode].width
    return (np.arange(shape[0] * shape[1]) % 4000 + index + 1).astype(np.uint16).reshape(shape)


def write_mkv(
    path,
    frames,
    mode="NFOV_2X2BINNED",
    start_offset_ns=336_277_000,
    serial="000123",
    color=False,
    calibration=None,
    size=None,
    sync="SUBORDINATE",
    images=None,
):
    """Writes a recording; colour is one grey, and every frame has one IMU sample.

    Args:
        path: The file.
        frames: How many frames.
        mode: A key of ``DEPTH_MODES``.
        start_offset_ns: Device time of the first frame.
        serial: Of the sensor.
        color: Whether there is colour.
        calibration: The sensor's JSON; None: an ideal lens.
        size: Width and height of the images, where they contradict the mode.
        sync: ``MASTER``, ``SUBORDINATE`` or ``STANDALONE``.
        images: Depth and infrared of each frame; None: :func:`depth_image`, and infrared is depth + 1.
    """
    width, height = size or (DEPTH_MODES[mode].width, DEPTH_MODES[mode].height)
    with av.open(str(path), "w", options={"allow_raw_vfw": "1"}) as container:
        container.metadata.update(
            K4A_START_OFFSET_NS=str(start_offset_ns),
            K4A_DEVICE_SERIAL_NUMBER=serial,
            K4A_WIRED_SYNC_MODE=sync,
            K4A_SUBORDINATE_DELAY_NS="160000" if sync == "SUBORDINATE" else "0",
        )
        streams = {}
        for title in ("DEPTH", "IR"):
            streams[title] = container.add_stream("rawvideo", rate=30)
            streams[title].width, streams[title].height = width, height
            streams[title].pix_fmt, streams[title].time_base = "gray16be", _MICROSECONDS
            streams[title].metadata["title"] = title
        streams["DEPTH"].metadata["K4A_DEPTH_MODE"] = mode
        if color:
            streams["COLOR"] = container.add_stream("mjpeg", rate=30)
            streams["COLOR"].width, streams["COLOR"].height = 1280, 720
            streams["COLOR"].pix_fmt, streams["COLOR"].time_base = "yuvj422p", _MICROSECONDS
            streams["COLOR"].metadata.update(title="COLOR", K4A_COLOR_MODE="MJPG_720P")
        streams["IMU"] = container.add_mux_stream("subrip")
        streams["IMU"].metadata["title"] = "IMU"
        container.add_attachment(
            "calibration.json", "application/octet-stream", calibration or calibration_json()
        )
        container.start_encoding()
        grey = cv2.imencode(".jpg", np.full((720, 1280, 3), 100, np.uint8))[1].tobytes()
        for index in range(frames):
            if images is not None:
                depth, infrared = images[index]
            else:
                depth = np.resize(depth_image(index, mode), (height, width))
                infrared = depth + 1
            sample = struct.pack("<Q3fQ3f", index * 1000, 0.0, 0.0, -9.81, index * 1000 + 1, 0.1, 0.2, 0.3)
            raw = {"DEPTH": depth, "IR": infrared}
            content = {title: image.astype(">u2").tobytes() for title, image in raw.items()}
            content |= {"COLOR": grey, "IMU": sample}
            for title in streams:
                packet = av.Packet(content[title])
                packet.stream, packet.time_base = streams[title], _MICROSECONDS
                # Colour exposes a little later than depth, as real sensors do.
                packet.pts = packet.dts = index * INTERVAL_US + (3000 if title == "COLOR" else 0)
                packet.duration = INTERVAL_US
                container.mux(packet)
    return path


def write_simulated(path, sensor, start_offset_ns, sync):
    """Writes the depth and infrared images of a simulated Azure Kinect with binned images.

    The scene's frame interval must be :data:`INTERVAL_US`, and every frame must have both images.
    """
    images = []
    for frame in sensor.frames():
        images.append((frame.depth, frame.ir))
    # The simulator's principal point is the middle of the image, which is not the middle of the sensor.
    mode, lens = DEPTH_MODES["NFOV_2X2BINNED"], sensor.intrinsics
    middle = (
        (lens.cx + 0.5 + mode.crop[0]) / mode.binned[0],
        (lens.cy + 0.5 + mode.crop[1]) / mode.binned[1],
    )
    assert (mode.width, mode.height) == (lens.width, lens.height)
    calibration = calibration_json(middle)
    return write_mkv(
        path, len(images), start_offset_ns=start_offset_ns, sync=sync, images=images, calibration=calibration
    )
