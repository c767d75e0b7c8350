"""What this program uses of libfreenect, held against the real library and its player fakenect."""

import ctypes
import shutil
from ctypes import POINTER, c_void_p

import pytest

from devices.freenect import libfreenect
from devices.freenect.libfreenect import FRAME_CALLBACK, Attributes, Context, FrameMode
from devices.freenect.sensor import VENDOR
from devices.sensor import AbsentError
from tests.helpers.freenect import film, numbered, typed, write_dump

MEDIUM, HIGH, REGISTERED, RGB = 1, 2, 4, 0


def _fields(mode):
    return {name: getattr(mode, name) for name, _ in mode._fields_}


def test_the_real_library_has_every_function_and_fakenect_all_but_the_list(real_freenect, fakenect, tmp_path):
    assert typed(real_freenect) == []
    copy = ctypes.CDLL(shutil.copy(fakenect._file, tmp_path / "copy.so"))
    assert typed(copy) == ["freenect_list_device_attributes", "freenect_free_device_attributes"]


def test_modes_are_structures_returned_by_value(real_freenect):
    assert ctypes.sizeof(FrameMode) == 24
    depth = real_freenect.freenect_find_depth_mode(MEDIUM, REGISTERED)
    expected = {"resolution": MEDIUM, "format": REGISTERED, "bytes": 614_400, "width": 640, "height": 480}
    expected |= {"data_bits_per_pixel": 16, "padding_bits_per_pixel": 0, "framerate": 30, "is_valid": 1}
    assert _fields(depth).items() >= expected.items()
    color = _fields(real_freenect.freenect_find_video_mode(MEDIUM, RGB))
    assert color.items() >= {"format": RGB, "bytes": 921_600, "data_bits_per_pixel": 24}.items()
    assert not real_freenect.freenect_find_depth_mode(HIGH, REGISTERED).is_valid


def test_fakenect_gives_the_same_structure(real_freenect, fakenect, tmp_path):
    copy = ctypes.CDLL(shutil.copy(fakenect._file, tmp_path / "copy.so"))
    typed(copy)
    real, played = (
        _fields(library.freenect_find_video_mode(MEDIUM, RGB)) for library in (real_freenect, copy)
    )
    assert played == real


def test_without_a_sensor(real_freenect):
    context, device, first = c_void_p(), c_void_p(), POINTER(Attributes)()
    assert real_freenect.freenect_init(context, None) == 0
    try:
        assert real_freenect.freenect_num_devices(context) == 0
        assert real_freenect.freenect_list_device_attributes(context, first) == 0
        assert not first
        real_freenect.freenect_free_device_attributes(first)  # of an empty list
        said = []
        log = libfreenect._LOG_CALLBACK(lambda _, level, message: said.append((level, message)))
        real_freenect.freenect_set_log_callback(context, log)
        assert real_freenect.freenect_open_device_by_camera_serial(context, device, b"A0036") == -1
        assert not device
        assert [level for level, _ in said] == [1]
        assert said[0][1].endswith(b"Couldn't find a device with serial A0036\n")
        assert real_freenect.freenect_process_events_timeout(context, libfreenect._Timeval(0, 1000)) == 0
    finally:
        assert real_freenect.freenect_shutdown(context) == 0


def test_our_context_of_the_real_library(real_freenect):
    assert libfreenect.load_library() is real_freenect
    with Context() as context:
        assert (context.serials(), context.count()) == ([], 0)
        assert context.process(0.001)
        with pytest.raises(AbsentError, match=r"No Kinect v1 with serial A0036\. No other is connected\."):
            context.open("A0036")
    assert libfreenect.connected_freenects() == []
    assert VENDOR.sdk_check().ok


def test_events_call_back_with_images_and_ticks_until_the_device_is_lost(fakenect, tmp_path):
    depths, rgbs = numbered(2)
    events = film(depths, rgbs, first_ticks=2**32 - 1_000_000)
    copy = ctypes.CDLL(shutil.copy(fakenect._file, tmp_path / "copy.so"))
    typed(copy)
    context, device, given = c_void_p(), c_void_p(), []
    fakenect.dumps["A"] = write_dump(tmp_path / "dump", events, pace=0.1)
    assert fakenect.freenect_init(context, None) == 0
    assert fakenect.freenect_open_device_by_camera_serial(context, device, b"A") == 0
    kept = []
    for name, shape in (("depth", ctypes.c_uint16), ("video", ctypes.c_uint8)):
        read = lambda _, image, ticks, shape=shape: given.append((ticks, shape.from_address(image).value))  # noqa: E731
        kept.append(FRAME_CALLBACK(read))
        getattr(fakenect, f"freenect_set_{name}_callback")(device, kept[-1])
        assert getattr(fakenect, f"freenect_start_{name}")(device) == 0
    while fakenect.freenect_process_events_timeout(context, libfreenect._Timeval(0, 1000)) == 0:
        pass
    assert given == [(2**32 - 1_000_000, 1000), (2**32 - 600_000, 0), (1_000_000, 1001), (1_400_000, 1)]
    for end in ("freenect_stop_video", "freenect_stop_depth", "freenect_close_device"):
        assert getattr(fakenect, end)(device) == 0
    assert fakenect.freenect_shutdown(context) == 0
