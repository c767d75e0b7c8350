"""Calls Microsoft's body tracker, libk4abt 1.1, through its C interface.

The tracker takes pointers to captures of the libk4a in the same process. For a live sensor they come from
pyk4a (``devices.azure.kinect``); for a recording they are made from its images
(``devices.azure.tracking.recorded_captures``).
"""

import ctypes
from ctypes import POINTER, byref, c_char_p, c_float, c_int, c_int32, c_uint32, c_uint64, c_void_p

import numpy as np

from devices.azure.tracking.native_library import Prototypes, declare, load_library
from devices.azure.tracking.settings import TrackerSettings
from devices.capture.causes import Cause
from devices.sensor import DeviceError, SensorFrame
from fusion.body import AZURE_KINECT
from fusion.skeleton import Skeleton, TrackingState

INSTALL = (
    "Install Microsoft's Azure Kinect Body Tracking SDK 1.1 (Windows, or Ubuntu 18.04/20.04: libk4abt1.1), "
    "or name its library with `k4abt=PATH`."
)
_PROCESSING = {"gpu": 0, "cpu": 1, "cuda": 2, "tensorrt": 3, "directml": 4}
_ORIENTATIONS = {0: 0, 90: 2, 180: 3, 270: 1}
"""k4abt's, which are seen from before the sensor: default, counter-clockwise, upside down, clockwise."""
_SUCCEEDED, _TIMEOUT = 0, 2
_NO_BODY = 0xFFFFFFFF
_JOINT = np.dtype([("position", "<f4", 3), ("orientation", "<f4", 4), ("confidence", "<i4")])
# Confidence none, low, medium, high: none is out of range; low is predicted, not observed.
_STATES = np.array(
    [TrackingState.NOT_TRACKED, TrackingState.INFERRED, *[TrackingState.TRACKED] * 2], np.uint8
)


class _Configuration(ctypes.Structure):
    _fields_ = (
        ("sensor_orientation", c_int),
        ("processing_mode", c_int),
        ("gpu_device_id", c_int32),
        ("model_path", c_char_p),
    )


_PROTOTYPES: Prototypes = {
    "k4abt_tracker_create": (c_int, [c_void_p, _Configuration, POINTER(c_void_p)]),
    "k4abt_tracker_shutdown": (None, [c_void_p]),
    "k4abt_tracker_destroy": (None, [c_void_p]),
    "k4abt_tracker_set_temporal_smoothing": (None, [c_void_p, c_float]),
    "k4abt_tracker_enqueue_capture": (c_int, [c_void_p, c_void_p, c_int32]),
    "k4abt_tracker_pop_result": (c_int, [c_void_p, POINTER(c_void_p), c_int32]),
    "k4abt_frame_get_num_bodies": (c_uint32, [c_void_p]),
    "k4abt_frame_get_body_skeleton": (c_int, [c_void_p, c_uint32, c_void_p]),
    "k4abt_frame_get_body_id": (c_uint32, [c_void_p, c_uint32]),
    "k4abt_frame_get_device_timestamp_usec": (c_uint64, [c_void_p]),
    "k4abt_frame_release": (None, [c_void_p]),
}


class BodyTracker:
    """A tracker for one sensor. It returns the bodies of each capture, in the order of the captures.

    The constructor opens nothing. Use a tracker from one thread at a time. Each wait has a timeout and
    releases the GIL.
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        self.settings = settings or TrackerSettings()
        self._library: ctypes.CDLL | None = None
        self._tracker = c_void_p()
        self._results = 0

    def open(self, calibration: int) -> None:
        """Starts the tracker and loads its network: seconds; the first time with TensorRT, minutes.

        Args:
            calibration: Address of the sensor's ``k4a_calibration_t`` (1032 bytes).

        Raises:
            DeviceError: The library, network or GPU is missing.
        """
        self.close()
        settings = self.settings
        library = load_library("k4abt", settings.library, INSTALL)
        declare(library, _PROTOTYPES, f"it is not libk4abt 1.1. {INSTALL}")
        configuration = _Configuration(_ORIENTATIONS[settings.orientation], _PROCESSING[settings.processing])
        tracker = c_void_p()
        status = library.k4abt_tracker_create(calibration, configuration, byref(tracker))
        if status != _SUCCEEDED or not tracker:
            raise DeviceError(
                f"The body tracker did not start (status {status}, {settings.processing}). Its network "
                f"(dnn_model_2_0_op11.onnx) or a library of {settings.processing} is missing beside "
                f"libk4abt, or the depth mode is neither NFOV_UNBINNED nor WFOV_2X2BINNED. Try processing "
                f"cpu; K4ABT_ENABLE_LOG_TO_STDOUT=1 makes it say more."
            )
        library.k4abt_tracker_set_temporal_smoothing(tracker, 0.0)  # fusion needs what was measured
        self._library, self._tracker, self._results = library, tracker, 0

    def enqueue(self, capture: int) -> None:
        """Passes a ``k4a_capture_t`` with depth and infrared to the tracker, which takes its own reference.

        Raises:
            DeviceError: The tracker is closed, rejects the capture, or accepts none within ``timeout_s``.
        """
        library = self._opened()
        status = library.k4abt_tracker_enqueue_capture(self._tracker, capture, self._timeout_ms())
        if status == _TIMEOUT:
            raise self._stalled("took no capture")
        if status != _SUCCEEDED:
            raise (Cause.TRACKER_FAILED if self._results else Cause.CAPTURE_REFUSED).error(status=status)

    def pop(self, wait_s: float | None = None) -> SensorFrame | None:
        """Returns the people of the next capture by body id, without images.

        Args:
            wait_s: Longest wait, after which None is returned. None: wait ``timeout_s``, then raise.

        Raises:
            DeviceError: The tracker is closed, has failed, or stalls.
        """
        library, frame = self._opened(), c_void_p()
        wait_ms = self._timeout_ms() if wait_s is None else round(wait_s * 1000)
        status = library.k4abt_tracker_pop_result(self._tracker, byref(frame), wait_ms)
        if status == _TIMEOUT and wait_s is not None:
            return None
        if status == _TIMEOUT:
            raise self._stalled("gave no result")
        if status != _SUCCEEDED or not frame:
            raise Cause.TRACKER_FAILED.error(status=status)
        try:
            self._results += 1
            return _bodies(library, frame)
        finally:
            library.k4abt_frame_release(frame)

    def close(self) -> None:
        """Stops the tracker; closing twice is harmless."""
        if self._library is not None:
            self._library.k4abt_tracker_shutdown(self._tracker)
            self._library.k4abt_tracker_destroy(self._tracker)
            self._library, self._tracker = None, c_void_p()

    def _opened(self) -> ctypes.CDLL:
        if self._library is None:
            raise DeviceError("The body tracker is not open: open it with the sensor's calibration first.")
        return self._library

    @property
    def patience_s(self) -> float:
        """Time without a result after which the tracker counts as stalled."""
        return self.settings.timeout_s * (1 if self._results else 10)

    def _timeout_ms(self) -> int:
        return round(1000 * self.patience_s)

    def _stalled(self, what: str) -> DeviceError:
        return Cause.TRACKER_STALLS.error(what=what, seconds=self._timeout_ms() / 1000)


def _bodies(library: ctypes.CDLL, frame: c_void_p) -> SensorFrame:
    time_ns = 1000 * int(library.k4abt_frame_get_device_timestamp_usec(frame))
    people: dict[str, Skeleton] = {}
    joints = np.zeros(len(AZURE_KINECT), _JOINT)
    for index in range(library.k4abt_frame_get_num_bodies(frame)):
        status = library.k4abt_frame_get_body_skeleton(frame, index, joints.ctypes.data)
        identity = library.k4abt_frame_get_body_id(frame, index)
        if status != _SUCCEEDED or identity == _NO_BODY:
            continue
        confidence = np.clip(joints["confidence"], 0, len(_STATES) - 1)
        people[str(identity)] = Skeleton.of(
            AZURE_KINECT, joints["position"] / 1000.0, _STATES[confidence], time_ns
        )
    return SensorFrame(time_ns, people)
