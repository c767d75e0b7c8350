"""Two Kinects v1 on the real libfreenect, whose USB is simulated: all but the hardware."""

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.machine import lacks, need_compiler

ROOT = Path(__file__).resolve().parents[3]
A, B = "A00360", "A00361"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What happened, once for all tests."""
    if not sys.platform.startswith("linux"):
        pytest.skip("libusb is replaced on Linux only")
    if ctypes.util.find_library("freenect") is None:
        lacks("libfreenect", "Debian: apt install libfreenect0.5")
    usb = tmp_path_factory.mktemp("usb") / "usb.so"
    source = ROOT / "tests/helpers/simulated_usb.c"
    command = [need_compiler(), "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(usb), str(source)]
    subprocess.run(command, check=True)
    done = subprocess.run(
        [sys.executable, "-m", "tests.helpers.freenect_on_simulated_usb"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "LD_PRELOAD": str(usb)},
        timeout=120.0,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_sensors_are_listed_and_opened_by_their_serial_numbers(found):
    assert found["listed"] == [A, B]
    assert found["absent"].startswith(f"No Kinect v1 with serial A00369. Connected: {A}, {B}.")


@pytest.mark.parametrize("sensor", [0, 1])
def test_both_at_once_give_depth_registered_to_colour(found, sensor):
    """By the formulas of the depth camera: raw values are disparities of the projected pattern."""

    def millimetres(raw):
        metric = ((raw - 4 * 200) / 4 - 0.375) * 0.1042
        return int(10 * (metric * 120.0 / (7.5 - metric) + 120.0))

    images = found["images"][sensor]
    assert images["depths"] == [0, millimetres(800), millimetres(900)]
    shift = 2.4 / (2 * 0.1042) * (1 - 1200 / millimetres(800)) + 0.375  # pixels, of which the table adds one
    first = int(200 + 1 + shift)
    assert images["near"] == [101, 200, first, first + 99]
    assert images["rgb"] == [200.0, 0.0, 0.0]


@pytest.mark.parametrize("sensor", [0, 1])
def test_times_go_on_where_the_clock_wraps(found, sensor):
    periods = found["images"][sensor]["periods"]
    assert min(periods) == 1.0
    assert all(period == round(period) for period in periods), "a busy machine may leave out frames"


def test_an_unplugged_sensor_is_taken_back(found):
    assert found["unplugged"]["states"] == [True, True, True]
    assert found["unplugged"]["listed"] == [A]
    said = " ".join(found["unplugged"]["said"])
    assert f"Kinect v1 {B} was unplugged or lost its power" in said
    assert f"{B} is back." in said


def test_everything_that_was_opened_is_closed(found):
    assert found["left"] == found["left in the end"] == [0, 0, 0, 0]
