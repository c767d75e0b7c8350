"""What a sensor shows the body tracker while it is recorded is what its recording shows it later."""

from contextlib import contextmanager
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from devices.azure.kinect import KinectSensor
from devices.azure.mkv import MkvRecording
from devices.azure.settings import KinectSettings
from devices.blazepose.tracked_images import TrackedImages, registered_color
from devices.freenect.sensor import INTRINSICS, FreenectSensor
from devices.sensor import SensorWrapper
from devices.simulated.kinect import simulated_pair
from fusion.body import BLAZEPOSE
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from tests.helpers.freenect import PERIOD, film, write_dump
from tests.helpers.machine import need_networks
from tests.helpers.rendered_people import images_of
from tests.helpers.standin_pyk4a import Device
from viewer_app.sinks.raw_recording import RawRecorder, record_images

COUNT = 12


@contextmanager
def azure(request, _):
    bus = request.getfixturevalue("bus")
    bus.devices = [Device("000123")]
    yield KinectSensor("000123", KinectSettings(infrared=True), track=False)


@contextmanager
def freenect(request, folder):
    fakenect = request.getfixturevalue("fakenect")
    fakenect.dumps["A1"] = write_dump(folder / "dump", film(*noise((480, 640)), period=4 * PERIOD))
    yield FreenectSensor("A1")


def noise(shape):
    """Depth and colour images that no compression with loss keeps."""
    random = np.random.default_rng(1)
    depths = [random.integers(500, 4000, shape, dtype=np.uint16) for _ in range(COUNT)]
    return depths, [random.integers(0, 256, (*shape, 3), dtype=np.uint8) for _ in range(COUNT)]


@pytest.mark.parametrize("vendor", [azure, freenect])
def test_the_tracker_gets_the_images_that_are_recorded(vendor, request, tmp_path):
    with vendor(request, tmp_path) as sensor:
        check_images(sensor, tmp_path / "a.mkv")


def check_images(sensor, path):
    """Records a sensor that is not open yet, and compares the images."""
    live = {}
    with RawRecorder(path, sensor) as recorder:
        record_images(sensor, recorder)
        with sensor:
            for frame in sensor.frames():
                image = image_of(frame, sensor.registered)
                if image is not None:  # a busy machine's colour may be late
                    live[frame.time_ns // 1000] = frame.depth, image
                if len(live) == 4:
                    break
            lens = sensor.intrinsics
    assert recorder.failure is None
    with MkvRecording(path) as recording:
        again = {frame.time_ns // 1000: frame for frame in recording.frames()}
    assert len(live) == 4
    for time_us, (depth, image) in live.items():
        np.testing.assert_array_equal(again[time_us].depth, depth)
        np.testing.assert_array_equal(image_of(again[time_us]), image)
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(recording.intrinsics, name) == pytest.approx(getattr(lens, name), rel=1e-12)


def image_of(frame, registered=None):
    """The image in which the tracker looks for people; None without colour."""
    return frame.ir if frame.ir is not None else (registered or registered_color)(frame)


class Only(SensorWrapper):
    """Another sensor's frames of some times."""

    def __init__(self, source, times_us):
        super().__init__(source)
        self._times_us = times_us

    def frames(self):
        return (frame for frame in self.source.frames() if frame.time_ns // 1000 in self._times_us)


class WholeMicroseconds(FreenectSensor):
    """Gives the tracker the times that a recording keeps."""

    def frames(self):
        return (replace(frame, time_ns=frame.time_ns // 1000 * 1000) for frame in super().frames())


def test_a_recording_that_is_tracked_again_gives_the_same_s(fakenect, tmp_path):
    """Of the frames that live tracked. Kinects v1 record colour with loss, and the tracker is given that."""
    need_networks()
    *_, truth = simulated_pair(motion="startup", body=BLAZEPOSE, seconds=2.0)
    live, again = [], []
    for number, serial in enumerate(("A1", "B1")):
        fakenect.dumps[serial] = write_dump(tmp_path / serial, film(*seen(truth, number), period=8 * PERIOD))
        tracked = TrackedImages(sensor := WholeMicroseconds(serial), registered=sensor.registered)
        with RawRecorder(tmp_path / f"{serial}.mkv", sensor) as recorder:
            record_images(tracked, recorder)
            with tracked:
                live.append(list(islice(tracked.frames(), COUNT)))
        times_us = {frame.time_ns // 1000 for frame in live[-1]}
        with TrackedImages(Only(MkvRecording(recorder.path), times_us)) as tracked:
            again.append(list(tracked.frames()))
    once, twice = fused(*live), fused(*again)
    assert len(once) == COUNT
    assert np.isfinite(once).any(axis=2).all()
    np.testing.assert_array_equal(once, twice)


def seen(truth, number):
    """Depth and RGB images of the person from a sensor of the rig."""
    sensor_from_world = truth.rig.world_from_sensor(number).inverse()
    depths, rgbs = [], []
    for seed in range(4 * COUNT):
        marks = truth.scene.motion.landmarks([seed / 30])[0]
        infrared, depth = images_of([sensor_from_world.apply(marks)], seed, camera=INTRINSICS)
        bright = np.sqrt(infrared / max(1.0, np.percentile(infrared, 99.0)))
        depths.append(depth)
        rgbs.append(np.repeat((255 * np.clip(bright, 0.0, 1.0)).astype(np.uint8)[..., None], 3, axis=2))
    return depths, rgbs


def fused(a, b):
    """(N, J, 3) S* of the frames of two sensors, one with one."""
    fuser = Fuser(FusionSetup(nominal_calibration(BLAZEPOSE)))
    positions = []
    for one, other in zip(a, b, strict=True):
        views = [next(iter(frame.people.values()), None) for frame in (one, other)]
        positions.append(fuser.update(SkeletonPair(*views, one.time_ns)).positions)
    return np.array(positions)
