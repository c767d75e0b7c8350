"""Values of the stand-in for pyk4a: captures, calibrations and errors."""

from __future__ import annotations

import ctypes
import json

import cv2
import numpy as np

from devices.azure.calibration import COLOR_SIZES, DEPTH_MODES, CameraMode, depth_intrinsics, intrinsics_of
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype = ctypes.py_object
_new_capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
DEVICE_NAME = ctypes.c_char_p(b"pyk4a device handle")
_CAPTURE_NAME = ctypes.c_char_p(b"pyk4a capture handle")
_CALIBRATION_NAME = ctypes.c_char_p(b"pyk4a calibration handle")
JPEG = cv2.imencode(".jpg", np.full((72, 128, 3), (40, 120, 200), np.uint8))[1].tobytes()


# Width and height of the colour image before it is cropped; the Sensor SDK's ``transformation`` source.
_COLOR_BINNED = {
    "720P": (1280, 960),
    "1080P": (1920, 1440),
    "1440P": (2560, 1920),
    "1536P": (2048, 1536),
    "2160P": (3840, 2880),
    "3072P": (4096, 3072),
}


def color_calibration(text: bytes, mode: str) -> tuple[Intrinsics, RigidTransform]:
    """The lens of the colour camera in the JSON of a sensor, and its frame from the depth camera's."""
    cameras = json.loads(text.strip(b"\0"))["CalibrationInformation"]["Cameras"]
    (camera,) = (one for one in cameras if one["Purpose"] == "CALIBRATION_CameraPurposePhotoVideo")
    (width, height), binned = COLOR_SIZES[mode], _COLOR_BINNED[mode]
    lens = intrinsics_of(camera, CameraMode(binned, (0, (binned[1] - height) // 2), width, height))
    pose = camera["Rt"]
    return lens, RigidTransform.of(np.reshape(pose["Rotation"], (3, 3)), pose["Translation"])


class WouldCrashError(BaseException):
    """The real library would end the process here with a segmentation fault."""


class K4AException(Exception):  # noqa: N818
    """Like the real one, it nearly always lacks a message."""


class K4ATimeoutException(K4AException):
    pass


def new_capsule(handle: ctypes.c_void_p, name: ctypes.c_char_p) -> object:
    """As in pyk4a: the capsule holds the address of the handle, not the handle."""
    return _new_capsule(ctypes.addressof(handle), name, None)


class PyK4ACapture:
    """A capture: depth and infrared, colour where it was in time, or only one of them."""

    def __init__(
        self,
        native: ctypes.CDLL | None,
        depth: np.ndarray | None,
        ir: np.ndarray | None,
        color: np.ndarray | None,
        time_usec: int,
        host_ns: int,
    ) -> None:
        self.depth, self.ir, self.color = depth, ir, color
        self.depth_timestamp_usec, self.depth_system_timestamp_nsec = (
            (0, 0) if depth is None else (time_usec, host_ns)
        )
        self._native = native
        # Without a libk4a beneath, the handle is the capture's time, for trackers that tests make up.
        self._handle = ctypes.c_void_p(None if native is not None else time_usec)
        if native is not None and depth is not None and ir is not None:
            self._fill(native, depth, ir)
        self._capture_handle = new_capsule(self._handle, _CAPTURE_NAME)

    def _fill(self, native: ctypes.CDLL, depth: np.ndarray, ir: np.ndarray) -> None:
        native.k4a_image_get_buffer.restype = ctypes.c_void_p
        native.k4a_capture_create(ctypes.byref(self._handle))
        for image, kind, attach in (
            (depth, 4, native.k4a_capture_set_depth_image),
            (ir, 5, native.k4a_capture_set_ir_image),
        ):
            handle = ctypes.c_void_p()
            height, width = image.shape
            native.k4a_image_create(kind, width, height, 2 * width, ctypes.byref(handle))
            address = native.k4a_image_get_buffer(handle)
            ctypes.memmove(address, image.ctypes.data, image.nbytes)
            native.k4a_image_set_device_timestamp_usec(handle, ctypes.c_uint64(self.depth_timestamp_usec))
            attach(self._handle, handle)
            native.k4a_image_release(handle)

    def __del__(self) -> None:
        if self._native is not None and self._handle:
            self._native.k4a_capture_release(self._handle)


def give_none_away() -> None:
    decrease = ctypes.pythonapi.Py_DecRef
    decrease.restype, decrease.argtypes = None, [ctypes.py_object]
    decrease(None)


class LeakyCapture(PyK4ACapture):
    """A capture that loses a reference to None for each image that it lacks, like pyk4a 1.5.0."""

    def __getattribute__(self, name: str) -> object:
        value = object.__getattribute__(self, name)
        if name in ("depth", "ir", "color") and value is None:
            give_none_away()
        return value


def borrowed(image: np.ndarray) -> np.ndarray:
    """An array over the SDK's memory, like that of pyk4a."""
    return np.frombuffer(bytearray(image.tobytes()), image.dtype).reshape(image.shape)


class Calibration:
    """Two made-up cameras, or those of a sensor's calibration JSON."""

    def __init__(self, depth_mode: int, color_resolution: int, raw: str | None = None) -> None:
        self._depth_mode, self._color_resolution, self._raw = int(depth_mode), int(color_resolution), raw
        self._struct = ctypes.create_string_buffer(1032)
        ctypes.c_int.from_buffer(self._struct, 1024).value = int(depth_mode)
        self._calibration_handle = _new_capsule(ctypes.addressof(self._struct), _CALIBRATION_NAME, None)

    @classmethod
    def from_raw(
        cls,
        value: str,
        depth_mode: int,
        color_resolution: int,
        thread_safe: bool = True,  # noqa: ARG003
    ) -> Calibration:
        if (int(depth_mode) == 0 and int(color_resolution) == 0) or "CalibrationInformation" not in value:
            raise K4AException
        return cls(depth_mode, color_resolution, value)

    def _lens(self, camera: int) -> tuple[float, float, float, float, tuple[float, ...]]:
        if camera not in (0, 1):
            raise ValueError("Camera matrix only available for color and depth cameras.")
        if (self._color_resolution if camera == 1 else self._depth_mode) == 0:
            raise ValueError("Unknown camera calibration type")
        if self._raw is None:
            lens = (0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)
            return (610.0, 611.0, 640.0, 365.0, lens) if camera == 1 else (504.0, 505.0, 332.0, 348.0, lens)
        raw = self._raw.encode()
        if camera == 0:
            read = depth_intrinsics(raw, [*DEPTH_MODES][max(0, min(self._depth_mode, 4) - 1)])
        else:
            read, _ = color_calibration(raw, [*COLOR_SIZES][self._color_resolution - 1])
        return read.fx, read.fy, read.cx, read.cy, read.distortion

    def get_camera_matrix(self, camera: int) -> np.ndarray:
        fx, fy, cx, cy, _ = self._lens(camera)
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def get_distortion_coefficients(self, camera: int) -> np.ndarray:
        return np.array(self._lens(camera)[4])

    def get_extrinsic_parameters(self, source: int, target: int) -> tuple[np.ndarray, np.ndarray]:
        if self._raw is None:
            return np.eye(3), np.array([[-0.032, 0.0, 0.004]])  # (1, 3) metres, from the SDK's millimetres
        assert (source, target) == (0, 1), "depth to colour"
        _, place = color_calibration(self._raw.encode(), "720P")
        return place.rotation.copy(), place.translation.reshape(1, 3)
