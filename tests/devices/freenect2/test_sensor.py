"""Kinects v2, on the stand-in for libfreenect2."""

import shutil
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.capture.settings import CaptureSettings
from devices.freenect2 import library
from devices.freenect2.sensor import Freenect2Sensor, unmirrored, unmirrored_lens
from devices.live.checks import device_checks
from devices.sensor import DeviceError
from devices.tracker_choice import choose_tracker
from tests.helpers.freenect2.contract import DEPTH, INFRARED
from tests.helpers.freenect2.standin import give
from tests.helpers.usb_tree import plug_in

A, B = "012345670", "012345671"
PERIOD_NS = 33_333_333


def _sensor(serial=A, **settings):
    return Freenect2Sensor(serial, CaptureSettings(**settings))


def _flat(value):
    return np.full((424, 512), value, np.float32)


def _numbered(standin, *numbers, **fields):
    for number in numbers:
        assert give(standin, number, _flat(1000 + number), _flat(100 + number), **fields)


def test_frames_carry_depth_and_infrared_and_the_sensors_own_time(freenect2):
    begun_ns = time.perf_counter_ns()
    with _sensor() as sensor:
        frames = sensor.frames()
        for number in range(3):
            _numbered(freenect2, number)
            frame = next(frames)
            assert (frame.depth.dtype, frame.depth.shape) == (np.uint16, (424, 512))
            assert (frame.ir.dtype, frame.ir.shape) == (np.uint16, (424, 512))
            assert (np.unique(frame.depth), np.unique(frame.ir)) == ([1000 + number], [100 + number])
            assert frame.time_ns == pytest.approx(1000 * 125_000 + number * PERIOD_NS, abs=125_000)
            assert begun_ns < frame.host_ns < time.perf_counter_ns()
            assert (frame.people, frame.color) == ({}, None)
    assert (sensor.missed, sensor.lost) == (0, 0)


def test_numbers_that_are_no_reading_are_0_and_left_and_right_are_exchanged():
    image = np.array([[1.4, 1.6, np.nan, -3.0], [np.inf, -np.inf, 65535.0, 65536.0]], np.float32)
    assert unmirrored(image).tolist() == [[0, 0, 2, 1], [0, 65535, 0, 0]]


@given(
    st.tuples(*[st.floats(-1.2, 1.2)] * 2, st.floats(0.5, 4.5)).map(np.array),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    st.tuples(*[st.floats(-0.01, 0.01)] * 2),
)
def test_the_lens_shows_a_point_where_the_mirrored_image_has_it(point, radial, tangential):
    """By the formulas of registration.cpp: pixels count from the corner of the first."""
    fx, fy, cx, cy = 365.0, 367.0, 260.5, 205.25
    (k1, k2, k3), (p1, p2) = radial, tangential
    x, y = -point[0] / point[2], point[1] / point[2]
    r2 = x * x + y * y
    along = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
    column = fx * (x * along + p2 * (r2 + 2 * x * x) + p1 * 2 * x * y) + cx - 0.5
    row = fy * (y * along + p1 * (r2 + 2 * y * y) + p2 * 2 * x * y) + cy - 0.5
    camera = unmirrored_lens((fx, fy, cx, cy, k1, k2, p1, p2, k3))
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    shown, _ = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion))
    assert shown.ravel() == pytest.approx([511 - column, row], abs=1e-6)


def test_times_go_on_where_the_32_bit_clock_wraps(freenect2):
    with _sensor() as sensor:
        frames, times = sensor.frames(), []
        for number, ticks in enumerate((2**32 - 300, 2**32 - 33, 234, 500)):
            give(freenect2, number, _flat(1), _flat(1), ticks=ticks)
            times.append(next(frames).time_ns)
    assert np.diff(times).tolist() == [267 * 125_000, 267 * 125_000, 266 * 125_000]


def test_images_of_different_packets_and_damaged_ones_are_left_out(freenect2):
    captured = []
    with _sensor(timeout_ms=1, stall_s=0.4) as sensor:
        sensor.on_capture = captured.append
        frames = sensor.frames()
        freenect2.give(0, DEPTH, 0, _flat(1))
        freenect2.give(0, INFRARED, 1, _flat(1))
        freenect2.give(0, DEPTH, 2, _flat(1))
        freenect2.give(0, INFRARED, 3, _flat(1))
        freenect2.give(0, DEPTH, 3, _flat(1), status=1)
        freenect2.give(0, DEPTH, 4, _flat(1))
        _numbered(freenect2, 5)
        next(frames)
        assert [int(frame.depth[0, 0]) for frame in captured] == [1005]
        with pytest.raises(DeviceError, match=rf"Kinect v2 {A} stalls: no depth for 0 s"):
            next(frames)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"depth_mode": "WFOV_2X2BINNED"}, r"has one depth mode, 512 × 424\. Leave `depth_mode` out"),
        ({"fps": 15}, r"runs at 30 fps, not 15\. Leave `fps` out"),
        ({"sync": "master"}, r"no port for a sync cable\. Leave `sync_master` out"),
        ({"color": "720P"}, r"colour is not read\. Leave `color` out"),
    ],
)
def test_a_mode_the_sensor_lacks_is_refused(freenect2, settings, message):
    with pytest.raises(DeviceError, match=message):
        _sensor(**settings).__enter__()
    assert freenect2.counts() == [0]


# ------------------------------------------------------------------ faults


def test_closing_waits_for_the_thread_that_computes_depth(freenect2):
    """Otherwise the library calls a listener that it has set to NULL, as the real one did with OpenGL."""
    with _sensor():
        freenect2.set("computing", 1, 0)
    assert freenect2.counts() == [0]


def test_on_windows_microsofts_driver_is_named():
    advice = library._why("[Freenect2Impl] failed to open Kinect v2: @1:5 LIBUSB_ERROR_NOT_SUPPORTED")
    assert "(failed to open Kinect v2: @1:5 LIBUSB_ERROR_NOT_SUPPORTED)" in advice
    assert advice.endswith("in place of Microsoft's.")


def test_a_binding_that_cannot_be_compiled_says_why(standin_prefix, tmp_path, monkeypatch):
    shutil.copytree(standin_prefix / "include", tmp_path / "include")
    monkeypatch.setattr(library, "installed_prefix", lambda: tmp_path)
    monkeypatch.setattr(library, "user_cache", lambda name: tmp_path / name)
    why = r"cannot be compiled or loaded \(.*LIBRARY.*\)\. It needs CMake and"
    with pytest.raises(DeviceError, match=why):
        library.load_library()
    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "run", None)
        with pytest.raises(DeviceError, match=why):
            library.load_library()  # it is not compiled a second time
    library._failed.clear()
    monkeypatch.setenv("PATH", "")
    check = library.library_check()
    assert (check.ok, "cmake" in check.detail) == (False, True)


@pytest.mark.usefixtures("freenect2")
@pytest.mark.parametrize(("display", "chosen"), [(":77", "gl"), (None, "cpu")])
def test_opengl_is_tried_first_by_a_process_that_the_library_may_end(display, chosen, monkeypatch):
    monkeypatch.delenv(library.PIPELINE)
    if display is None:
        monkeypatch.delenv("DISPLAY")
    assert library._pipeline(library.load_library()) == chosen
    with _sensor() as sensor:
        pass
    assert any("computes depth on the CPU" in warning for warning in sensor.warnings) == (chosen == "cpu")


def test_opengl_that_hangs_or_wants_the_main_thread_is_not_chosen(freenect2, monkeypatch):
    loaded = library.load_library()
    with monkeypatch.context() as patch:
        patch.setattr(library, "_OPENGL_S", 0.0)
        assert library._pipeline.__wrapped__(loaded) == "cpu"
    assert library._pipeline.__wrapped__(loaded) == "gl"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert library._pipeline.__wrapped__(loaded) == "cpu"
    assert freenect2.counts() == [0]


@pytest.mark.usefixtures("freenect2")
def test_the_binding_is_compiled_once(monkeypatch):
    library.load_library()
    library.load_library.cache_clear()
    monkeypatch.setattr(subprocess, "run", None)
    library.load_library()


@pytest.mark.usefixtures("freenect2")
@pytest.mark.parametrize("content", [b"", b"no library", None])
def test_a_damaged_binding_is_compiled_anew(standin_prefix, monkeypatch, tmp_path, content):
    cache = tmp_path / "freenect2"
    monkeypatch.setattr(library, "user_cache", lambda _: cache)
    file = library._compiled(standin_prefix)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)  # it would end by SIGBUS
    library.load_library.cache_clear()
    assert library.load_library().k2_pipelines()
    assert file.read_bytes() == whole or content is not None
    assert sorted(cache.iterdir()) == [file, file.with_suffix(".sha256")]


@pytest.mark.usefixtures("freenect2")
def test_a_cache_folder_that_cannot_be_written_is_named(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(library, "user_cache", lambda name: tmp_path / "file" / name)
    with pytest.raises(DeviceError, match=r"and writes to the folder \S+/file/freenect2\."):
        library.load_library()


def test_a_pipeline_that_the_library_lacks_is_refused(freenect2, monkeypatch):
    """It would compute on the CPU without a word."""
    monkeypatch.setenv(library.PIPELINE, "opengl")
    why = "LIBFREENECT2_PIPELINE is opengl, but libfreenect2 was built with gl, "
    with pytest.raises(DeviceError, match=why):
        _sensor().__enter__()
    check = library.library_check()
    assert (check.ok, check.detail.startswith(why)) == (False, True)
    assert freenect2.counts() == [0]
    monkeypatch.setenv(library.PIPELINE, "cpu")
    check = library.library_check()
    assert check.ok
    assert "on the CPU, too slowly for 30 fps" in check.advice


# ------------------------------------------------------------------ beside other vendors


@pytest.mark.usefixtures("freenect2")
def test_the_doctor_knows_them(standin_prefix, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    for number, serial in enumerate((A, B)):
        plug_in(tmp_path, serial, "02c4", number=number, vendor="045e", speed=480 if number else 5000)
    checks = device_checks(choose_tracker("blazepose"), tmp_path)
    named = {check.name: check for check in checks}
    assert named["libfreenect2 (Kinect v2)"].detail == f"{standin_prefix}, depth by gl"
    assert named["two sensors"].detail == "2 connected, 2 usable"
    assert named[f"Kinect v2 {A}"].detail == "no sync port"
    assert named["sync cable"].detail == f"No sync cable fits into {A} and {B}."
    assert named["USB speed"].detail == f"{B} runs at 480 Mbit/s"
    assert "never with a real sensor" in named["proven on hardware"].detail
