"""What this program needs of libfreenect2, on the stand-in and, with simulated USB, on the real library."""

import json

import pytest

from tests.helpers.freenect2.contract import FAR
from tests.helpers.freenect2.standin import run

A, B = "012345670", "012345671"


@pytest.fixture(scope="module", params=["stand-in", "real library"])
def found(request, tmp_path_factory):
    """What happened, once for all tests."""
    usb = None
    if request.param == "stand-in":
        prefix = request.getfixturevalue("standin_prefix")
    else:
        prefix, usb = request.getfixturevalue("real_freenect2")
    cache = tmp_path_factory.mktemp("cache")
    # Compiled first, because the compiler is not to meet the simulated USB.
    run(prefix, cache, "-c", "from devices.freenect2.library import load_library; load_library()")
    out = run(prefix, cache, "-m", "tests.helpers.freenect2.contract", usb=usb)
    happened = json.loads(out.splitlines()[-1])
    assert happened["real"] == (request.param == "real library")
    assert len(out.splitlines()) == 1, "the library's log is not shown"
    return happened


def test_sensors_are_listed_and_opened_by_their_serial_numbers(found):
    assert found["listed"] == [A, B]
    assert found["absent"] == (
        f"AbsentError: No Kinect v2 with serial 999. Connected: {A}, {B}. Check its USB 3 port and power "
        "supply."
    )


def test_a_sensor_without_permission_is_left_out_and_told(found):
    (first, none), (serial, fault) = found["forbidden"]
    assert (first, none, serial) == (A, "", None)
    assert fault.startswith("Kinect v2 at place 1 cannot be opened: ")
    assert "failed to open Kinect v2: @2:6 LIBUSB_ERROR_ACCESS" in fault
    assert f"Connected: {A}. Another cannot be opened: " in found["forbidden opened"]


def test_a_sensor_that_another_program_uses_is_listed_but_does_not_open(found):
    assert found["busy"] == [[A, ""], [B, ""]]
    assert found["busy opened"].startswith(f"DeviceError: Kinect v2 {B} cannot be opened: it is busy or")
    assert "(failed to claim interface with ControlAndRgbInterfaceId(=0)! LIBUSB_ERR" in found["busy opened"]
    assert "Try debugging" not in found["busy opened"]


def test_too_little_memory_for_usb_is_told_with_the_command(found):
    assert f"Kinect v2 {A} did not start its camera (failed to submit transfer: LIBUSB" in found["no memory"]
    assert "usbcore/parameters/usbfs_memory_mb. Check that" in found["no memory"]
    warning, _ = found["little memory"]
    assert warning.startswith("Give USB more memory: ")
    assert found["left after faults"][0] == 0


@pytest.mark.parametrize("sensor", [0, 1])
def test_both_at_once_give_images_that_are_no_longer_mirrored(found, sensor):
    """The real library's edges lack a pixel, its distances some per cent: it leaves out the baseline's square
    and looks rows up upside down."""
    images, real = found["images"][sensor], found["real"]
    assert images["types"] == ["uint16", "uint16", 424, 512, 424, 512]
    assert images["near"] == pytest.approx([50, 149, 511 - 199, 511 - 100], abs=1 if real else 0)
    low, middle, high = images["far"]
    assert (low, high) == (pytest.approx(FAR, rel=0.02), pytest.approx(FAR, rel=0.02))
    assert middle == pytest.approx(FAR, rel=0.001)
    assert images["seen"] > 0.98
    assert images["infrared"] == pytest.approx(6300, rel=0.01)
    (warning,) = images["warnings"]
    assert warning.startswith("libfreenect2 computes depth on the CPU, too slowly for 30 fps. OpenGL")
    assert images["twice"].endswith("is already open in this program.")


@pytest.mark.parametrize("sensor", [0, 1])
def test_the_lens_is_that_which_the_sensor_stores_with_right_and_left_exchanged(found, sensor):
    lens = [512 - 300.5 - 0.5, 205.5 - 0.5, 0.09, -0.27, 0.001, -0.002, 0.08]
    assert found["images"][sensor]["lens"] == pytest.approx(lens, abs=1e-6)


@pytest.mark.parametrize("sensor", [0, 1])
def test_times_are_those_of_the_sensors_clock(found, sensor):
    steps = found["images"][sensor]["steps"]
    assert steps == pytest.approx([max(1, round(step)) for step in steps], abs=0.002), "a tick is 0.125 ms"


def test_an_unplugged_sensor_is_taken_back(found):
    assert found["unplugged"]["states"] == [True, True, True]
    assert found["unplugged"]["listed"] == [A]
    assert f"Kinect v2 {B} was unplugged or lost its power. Plug it" in " ".join(found["unplugged"]["said"])
    assert f"{B} is back." in found["unplugged"]["said"]


def test_everything_that_was_opened_is_closed(found):
    assert not any(found["left in the end"])
