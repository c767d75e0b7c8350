"""Values of the stand-in for pyk4a: captures, calibrations and errors."""

import ctypes

import cv2
import numpy as np

_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype = ctypes.py_object
_new_capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
DEVICE_NAME = ctypes.c_char_p(b"pyk4a device handle")
_CAPTURE_NAME = ctypes.c_char_p(b"pyk4a capture handle")
_CALIBRATION_NAME = ctypes.c_char_p(b"pyk4a calibration handle")
JPEG = cv2.imencode(".jpg", np.full((72, 128, 3), (40, 120, 200), np.uint8))[1].tobytes()


class WouldCrashError(BaseException):
    """The real library would end the process here with a segmentation fault."""


class K4AException(Exception):  # noqa: N818
    """Like the real one, it nearly always lacks a message."""


class K4ATimeoutException(K4AException):
    pass


def new_capsule(handle, name):
    """As in pyk4a: the capsule holds the address of the handle, not the handle."""
    return _new_capsule(ctypes.addressof(handle), name, None)


class PyK4ACapture:
    """A capture: depth and infrared, colour where it was in time, or only one of them."""

    def __init__(self, native, depth, ir, color, time_usec, host_ns):
        self.depth, self.ir, self.color = depth, ir, color
        self.color_timestamp_usec = 0 if color is None else time_usec
        self.depth_timestamp_usec, self.depth_system_timestamp_nsec = (
            (0, 0) if depth is None else (time_usec, host_ns)
        )
        self._native = native
        # Without a libk4a beneath, the handle is the capture's time, for trackers that tests make up.
        self._handle = ctypes.c_void_p(None if native is not None else time_usec)
        if native is not None and depth is not None and ir is not None:
            self._fill(native, depth, ir)
        self._capture_handle = new_capsule(self._handle, _CAPTURE_NAME)

    def _fill(self, native, depth, ir):
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

    def __del__(self):
        if self._native is not None and self._handle:
            self._native.k4a_capture_release(self._handle)


def give_none_away():
    decrease = ctypes.pythonapi.Py_DecRef
    decrease.restype, decrease.argtypes = None, [ctypes.py_object]
    decrease(None)


class LeakyCapture(PyK4ACapture):
    """A capture that loses a reference to None for each image that it lacks, like pyk4a 1.5.0."""

    def __getattribute__(self, name):
        value = object.__getattribute__(self, name)
        if name in ("depth", "ir", "color") and value is None:
            give_none_away()
        return value


class Calibration:
    """Two made-up cameras."""

    def __init__(self, depth_mode, device=0):
        self._struct = ctypes.create_string_buffer(1032)
        ctypes.c_int.from_buffer(self._struct, 0).value = device
        ctypes.c_int.from_buffer(self._struct, 1024).value = int(depth_mode)
        self._calibration_handle = _new_capsule(ctypes.addressof(self._struct), _CALIBRATION_NAME, None)

    def _lens(self, camera):
        lens = (0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)
        return (610.0, 611.0, 640.0, 365.0, lens) if camera == 1 else (504.0, 505.0, 332.0, 348.0, lens)

    def get_camera_matrix(self, camera):
        fx, fy, cx, cy, _ = self._lens(camera)
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def get_distortion_coefficients(self, camera):
        return np.array(self._lens(camera)[4])

    def get_extrinsic_parameters(self, source, target):
        assert (source, target) == (0, 1), "depth to colour"
        return np.eye(3), np.array([[-0.032, 0.0, 0.004]])  # (1, 3) metres, from the SDK's millimetres
