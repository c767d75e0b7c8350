"""Kinects v1, on the real fakenect, which plays dumps of simulated images."""

import ctypes
import os
import shutil
import sys
import time

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.capture.sensor_choice import cable_notes, choose_two, sync_master
from devices.capture.settings import CaptureSettings
from devices.freenect import libfreenect
from devices.freenect.libfreenect import Context, connected_freenects, how_to_install
from devices.freenect.sensor import INTRINSICS, VENDOR, FreenectSensor, TickCounter
from devices.live.sensors import connected_sensors
from devices.sensor import AbsentError, DeviceError
from devices.tracker_choice import choose_tracker
from tests.helpers.freenect import PERIOD, film, numbered, typed, write_dump
from tests.helpers.usb_tree import plug_in

A, B = "A00366A02534111A", "B00362721456043B"
PERIOD_NS = 33_333_333


@pytest.fixture
def dump(fakenect, tmp_path):
    """Connects a sensor with a dump of numbered images; returns its serial number."""

    def connect(serial=A, first_ticks=0):
        fakenect.dumps[serial] = write_dump(tmp_path / serial, film(*numbered(4), first_ticks=first_ticks))
        return serial

    return connect


def _sensor(serial=A, **settings):
    return FreenectSensor(serial, CaptureSettings(**settings))


def _frames(sensor):
    """The frames until the dump ends, with the colour images; on a busy machine not all of them."""
    found = []

    def take_all():
        for frame in sensor.frames():
            found.append((frame, sensor.rgb))

    with pytest.raises(DeviceError, match="stopped giving frames"):
        take_all()
    return found


def test_frames_carry_registered_depth_and_the_sensors_own_time(fakenect, dump):
    begun_ns = time.perf_counter_ns()
    with _sensor(dump(first_ticks=600_000_000)) as sensor:
        assert (fakenect.open, fakenect.streams[A]) == ([A], {"depth", "video"})
        found = _frames(sensor)
    assert found
    for frame, rgb in found:
        assert (frame.depth.dtype, frame.depth.shape) == (np.uint16, (480, 640))
        number = int(frame.depth[0, 0]) - 1000
        assert np.unique(frame.depth).tolist() == [1000 + number]
        assert frame.time_ns == pytest.approx(10**10 + number * PERIOD_NS, abs=2)
        assert (rgb.shape, np.unique(rgb).tolist()) == ((480, 640, 3), [number])
        assert begun_ns < frame.host_ns < time.perf_counter_ns()
        assert (frame.people, frame.color, frame.ir) == ({}, None, None)
    assert (fakenect.open, fakenect.streams[A], fakenect._copies) == ([], set(), {})
    assert sensor.intrinsics == INTRINSICS
    assert "counts as ideal, with 525 pixels" in sensor.warnings[0]


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.tuples(st.integers(-PERIOD, 10**11), st.integers(-(10**9), 10**9)), max_size=20),
)
def test_ticks_are_counted_through_any_silence(first, steps):
    """Within half a wrap (35 s) of error and delay of this machine's clock, here one second."""
    counter, now_ns, total, late_ns = TickCounter(), 10**12, first, 0
    assert counter.total(first, now_ns) == first
    for ticks, delay_ns in steps:
        total += ticks
        now_ns += ticks * 50 // 3
        late_ns = delay_ns
        assert counter.total(total % 2**32, now_ns + late_ns) == total


def test_colour_is_compressed_only_if_asked_for(dump):
    with _sensor(dump(), color="720P") as sensor:
        frame, rgb = _frames(sensor)[-1]
    image = cv2.imdecode(np.frombuffer(frame.color.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == rgb.shape
    assert np.abs(image.astype(int) - rgb).max() <= 1
    assert frame.color.camera.intrinsics == INTRINSICS
    assert "colour is 640 × 480, not 720P" in sensor.warnings[1]


def test_red_stays_red(fakenect, tmp_path):
    red = np.zeros((480, 640, 3), np.uint8)
    red[..., 0] = 200
    fakenect.dumps[A] = write_dump(tmp_path / "dump", film(numbered(2)[0], [red, red]))
    with _sensor(color="1080P") as sensor:
        frame = next(sensor.frames())
        assert sensor.rgb[0, 0].tolist() == [200, 0, 0]
    blue, _, most = cv2.imdecode(np.frombuffer(frame.color.jpeg, np.uint8), cv2.IMREAD_COLOR)[0, 0]
    assert (blue < 10, most > 190) == (True, True)


# ------------------------------------------------------------------ faults


def test_cameras_that_do_not_start_leave_the_sensor_closed(fakenect, dump):
    fakenect.still.add(dump())
    with pytest.raises(DeviceError, match=r"did not start its cameras\. Check that no other.*controllers"):
        _sensor().__enter__()
    assert (fakenect.open, fakenect._copies) == ([], {})


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux restricts USB devices")
def test_a_sensor_without_permission_is_named(fakenect, dump, tmp_path, monkeypatch):
    dump()
    fakenect.forbidden = 1
    plug_in(tmp_path, "", product="02ae", speed=480)
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = libfreenect.usb_kinects
    monkeypatch.setattr(libfreenect, "usb_kinects", lambda: found(tmp_path))
    usable, other = connected_freenects()
    assert (usable.serial, usable.fault) == (A, "")
    assert other.serial is None
    assert "no permission for" in other.fault
    assert "51-kinect.rules" in other.fault
    assert VENDOR.sensor_check(other).detail.startswith("Kinect v1 at place 1 cannot be opened")


# ------------------------------------------------------------------ beside other vendors


def test_they_are_listed_beside_the_others_and_have_no_sync_port(dump):
    dump(A)
    dump(B)
    ours = choose_tracker("blazepose")
    a, b = connected_sensors(ours)
    assert [(one.index, one.serial, one.sdk) for one in (a, b)] == [(0, A, "freenect"), (1, B, "freenect")]
    assert not a.hides_jacks, "though its serial number has letters"
    assert choose_two([a, b], principal=B) == (B, A)
    assert sync_master(a, b) is None
    assert cable_notes(a, b, None)[0].startswith(f"No sync cable fits into {A} and {B}. Pairs are up to half")
    with pytest.raises(DeviceError, match=rf"No sync cable fits into {A} and {B}\. Leave `sync_master` out"):
        sync_master(a, b, A)


@pytest.mark.parametrize(
    ("platform", "command"),
    [
        ("linux", "apt install libfreenect0.5"),
        ("darwin", "brew install libfreenect"),
        ("win32", "freenect.dll"),
    ],
)
def test_a_missing_library_names_its_command(platform, command):
    with pytest.raises(DeviceError, match=r"libfreenect, which is not installed\. Install it: "):
        connected_freenects()
    assert command in how_to_install(platform)


def test_a_library_of_another_kind_is_refused(real_freenect, monkeypatch):
    assert real_freenect
    libfreenect.load_library.cache_clear()
    monkeypatch.setattr(libfreenect, "find_library", lambda _: "libc.so.6")
    with pytest.raises(DeviceError, match=r"libc\.so\.6 is not libfreenect 0\.5 \(.*freenect_init"):
        libfreenect.load_library()


# --- What this program uses of libfreenect, held against the real library and its player fakenect.


def test_the_real_library_has_every_function_and_fakenect_all_but_the_list(real_freenect, fakenect, tmp_path):
    assert typed(real_freenect) == []
    copy = ctypes.CDLL(shutil.copy(fakenect._file, tmp_path / "copy.so"))
    assert typed(copy) == ["freenect_list_device_attributes", "freenect_free_device_attributes"]


def test_our_context_of_the_real_library(real_freenect):
    assert libfreenect.load_library() is real_freenect
    with Context() as context:
        assert (context.serials(), context.count()) == ([], 0)
        assert context.process(0.001)
        with pytest.raises(AbsentError, match=r"No Kinect v1 with serial A0036\. No other is connected\."):
            context.open("A0036")
    assert libfreenect.connected_freenects() == []
    assert VENDOR.sdk_check().ok
