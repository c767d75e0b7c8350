"""What this program uses of pyk4a, as clauses for the stand-in and the real library.

Needs numpy only. ``python pyk4a_contract.py RECORDING`` holds the pyk4a of that interpreter to every clause,
each in a process of its own, and prints the results as JSON: the library may crash in one of them.
"""

import ctypes
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

DEPTH = ("NFOV_2X2BINNED", "NFOV_UNBINNED", "WFOV_2X2BINNED", "WFOV_UNBINNED")
COLOR = ("720P", "1080P", "1440P", "1536P", "2160P", "3072P")
CRASHES = "crashes"


def images(sdk, recording):
    """Depth and infrared are (height, width) uint16, colour the JPEG's bytes, all over the SDK's memory."""
    playback = _open(sdk, recording)
    capture = playback.get_next_capture()
    depth, ir, color = capture.depth, capture.ir, capture.color
    assert (depth.shape, depth.dtype) == ((576, 640), np.uint16)
    assert (ir.shape, ir.dtype) == ((576, 640), np.uint16)
    assert (color.ndim, color.dtype) == (1, np.uint8)
    assert not any(image.flags.owndata for image in (depth, ir, color))
    assert color.tobytes().startswith(b"\xff\xd8")
    return {
        name: int(image.astype(np.int64).sum())
        for name, image in (("depth", depth), ("ir", ir), ("color", color))
    }


def times(sdk, recording):
    """Device times are integer microseconds; a recording has no host times."""
    capture = _open(sdk, recording).get_next_capture()
    assert isinstance(capture.depth_timestamp_usec, int)
    assert capture.depth_system_timestamp_nsec == 0
    return {"depth_usec": capture.depth_timestamp_usec}


def configuration(sdk, recording):
    """The configuration's values are pyk4a's own enums; delays and offsets are microseconds."""
    said = _open(sdk, recording).configuration
    assert said["depth_mode"] is sdk.DepthMode.NFOV_UNBINNED
    assert said["color_resolution"] is sdk.ColorResolution.RES_720P
    assert said["color_format"] is sdk.ImageFormat.COLOR_MJPG
    assert said["wired_sync_mode"] is sdk.WiredSyncMode.STANDALONE
    names = ("camera_fps", "subordinate_delay_off_master_usec", "start_timestamp_offset_usec")
    return {name: int(said[name]) for name in names}


def capsules(sdk, recording):
    """Captures hold the address of their handle, calibrations 1032 bytes, in capsules of these names."""
    playback = _open(sdk, recording)
    capture, calibration = playback.get_next_capture(), playback.calibration
    assert _address(capture._capture_handle, b"pyk4a capture handle")
    assert _address(calibration._calibration_handle, b"pyk4a calibration handle")
    fault_of(ValueError, lambda: _address(capture._capture_handle, b"pyk4a calibration handle"))


def calibration(sdk, recording):
    """Matrices are (3, 3), lenses 8 numbers; the translation is (1, 3) metres, in every mode."""
    raw = _open(sdk, recording).calibration_raw
    assert isinstance(raw, str)
    cameras, found = sdk.CalibrationType, {}
    for depth in DEPTH:
        both = sdk.Calibration.from_raw(raw, sdk.DepthMode[depth], sdk.ColorResolution.RES_720P, False)
        rotation, translation = both.get_extrinsic_parameters(cameras.DEPTH, cameras.COLOR)
        assert (rotation.shape, translation.shape) == ((3, 3), (1, 3))
        for camera in (cameras.COLOR, cameras.DEPTH):
            matrix, lens = both.get_camera_matrix(camera), both.get_distortion_coefficients(camera)
            assert (matrix.shape, lens.shape) == ((3, 3), (8,))
        found[depth] = [*matrix.ravel().tolist(), *lens.tolist()]
    return found


def enums(sdk, recording):  # noqa: ARG001
    """The members that this program names, and their numbers, which libk4a gets."""
    names = {
        "DepthMode": ("OFF", *DEPTH, "PASSIVE_IR"),
        "ColorResolution": ("OFF", *(f"RES_{name}" for name in COLOR)),
        "FPS": ("FPS_5", "FPS_15", "FPS_30"),
        "WiredSyncMode": ("STANDALONE", "MASTER", "SUBORDINATE"),
        "ImageFormat": ("COLOR_MJPG", "COLOR_NV12", "COLOR_YUY2", "COLOR_BGRA32"),
        "CalibrationType": ("DEPTH", "COLOR"),
    }
    return {f"{enum}.{name}": int(getattr(sdk, enum)[name]) for enum, all_ in names.items() for name in all_}


def no_device(sdk, recording):  # noqa: ARG001
    """Without a device there are none; opening, starting and every question to one that is closed fail."""
    assert sdk.connected_device_count() == 0
    device = sdk.PyK4A(device_id=0, thread_safe=False)
    for action in (device.open, device.start):
        assert str(fault_of(sdk.K4AException, action)) == "", "without a word"
        assert not device.opened
        assert not device.is_running
    for question in ("serial", "sync_jack_status", "calibration"):
        said = fault_of(sdk.K4AException, lambda question=question: getattr(device, question))
        assert "not opened" in str(said)
    assert "not opened" in str(fault_of(sdk.K4AException, lambda: device.get_capture(timeout=10)))
    assert "not opened" in str(fault_of(sdk.K4AException, device.close))


def errors(sdk, recording):  # noqa: ARG001
    """A time-out is a K4AException too, so that it must be caught first."""
    assert issubclass(sdk.K4ATimeoutException, sdk.K4AException)
    assert not issubclass(sdk.K4AException, OSError)


def configurations(sdk, recording):  # noqa: ARG001
    """A configuration is not looked at before the cameras start, but for a negative delay."""
    plain = sdk.Config(
        color_resolution=sdk.ColorResolution.OFF,
        synchronized_images_only=True,  # libk4a refuses this, when it starts
        wired_sync_mode=sdk.WiredSyncMode.MASTER,
    )
    assert plain.synchronized_images_only is True
    fault_of(AssertionError, lambda: sdk.Config(subordinate_delay_off_master_usec=-1))


def stop_before_open(sdk, recording):  # noqa: ARG001
    """Stopping a device that is not open crashes the process: this program must never do it."""
    sdk.PyK4A(thread_safe=False).stop()


def none_references(sdk, recording):  # noqa: ARG001
    """An opening that fails loses at most one reference to None, which can be put back."""
    increase = ctypes.pythonapi.Py_IncRef
    increase.restype, increase.argtypes = None, [ctypes.py_object]
    device = sdk.PyK4A(device_id=0, thread_safe=False)
    before = sys.getrefcount(None)
    for _ in range(1000):
        fault_of(sdk.K4AException, device.open)
        increase(None)
    assert sys.getrefcount(None) >= before - 100


def host_clock(sdk, recording):  # noqa: ARG001
    """perf_counter is the monotonic clock on Linux, which is what libk4a's host times are of."""
    assert abs(time.perf_counter_ns() - time.clock_gettime_ns(time.CLOCK_MONOTONIC)) < 1_000_000_000


RECORDING_CLAUSES = (images, times, configuration, capsules, calibration)
"""Of recordings, which the stand-in has none of: this program reads them itself."""
CLAUSES = (enums, no_device, errors, configurations, stop_before_open, none_references, host_clock)


def _open(sdk, recording):
    playback = sdk.PyK4APlayback(recording, thread_safe=False)
    playback.open()
    return playback


def fault_of(kind, action):
    """The exception of this kind that an action raises; an AssertionError if it raises none."""
    try:
        given = action()
    except kind as fault:
        return fault
    raise AssertionError(f"no {kind.__name__}, but {given!r}")


def _address(capsule, name):
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(get_pointer(capsule, name))


def main():
    """The program."""
    if len(sys.argv) == 3:
        import pyk4a

        (clause,) = (clause for clause in RECORDING_CLAUSES + CLAUSES if clause.__name__ == sys.argv[2])
        print(json.dumps({"said": clause(pyk4a, sys.argv[1])}))
        return
    results = {}
    for clause in RECORDING_CLAUSES + CLAUSES:
        command = [sys.executable, str(Path(__file__)), sys.argv[1], clause.__name__]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
        if done.returncode < 0:
            results[clause.__name__] = {"fault": CRASHES}
        elif done.returncode > 0:
            results[clause.__name__] = {"fault": done.stderr.strip().splitlines()[-1]}
        else:
            results[clause.__name__] = json.loads(done.stdout.strip().splitlines()[-1])
    print(json.dumps(results))


if __name__ == "__main__":
    main()
