"""Colour images in a session: read as given, and damage is always reported."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import rerun as rr

from devices.sensor import ColorCamera, ColorImage
from fusion.body import KINECT_V2
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.file.rrd_file import RrdFile
from recordings.file.stored_images import FileImages
from recordings.fusing.pairs import fuse_one
from recordings.writing.recorder import Recorder
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

ALL = range(100)
_TURN = RigidTransform.of([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [-0.032, 0.002, 0.004])
_CAMERA = ColorCamera(Intrinsics(64, 48, 60.5, 61.5, 31.5, 24.5, (0.1, -0.2, 0.3)), _TURN)


@pytest.fixture
def images():
    """Noise, which nothing can compress: the file holds these very bytes."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (4, 48, 64, 3), dtype=np.uint8)
    return [ColorImage(cv2.imencode(".jpg", image)[1].tobytes(), _CAMERA) for image in noise]


@pytest.fixture
def session(images, tmp_path):
    """Four frames, of which A has colour in all and B in none."""
    return written(tmp_path / "s.rrd", images)


def written(path, images):
    """A session with these images of A, one for each frame."""
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V2)))
    made = []
    for pair, image in zip(frame_pairs(KINECT_V2, len(images)), images, strict=True):
        made.append(fuse_one(fuser, replace(pair, a=replace(pair.a, color=image))))
    stream = rr.RecordingStream(layout.APPLICATION_ID)
    stream.set_sinks(rr.FileSink(str(path)))
    recorder = Recorder(stream, fuser.setup, ("a", "b"), depth_every=1)
    recorder.record_all(made)
    recorder.finish()
    stream.flush()
    stream.disconnect()
    return path


def images_of(path):
    with RrdFile(path) as file:
        return FileImages(path, file.identity())


def test_images_come_back_with_lens_and_place(session, images):
    read = list(images_of(session).color("a", ALL))
    assert [(frame, image.jpeg) for frame, image in read] == [(k, i.jpeg) for k, i in enumerate(images)]
    for _, image in read:
        assert image.camera.intrinsics == _CAMERA.intrinsics
        np.testing.assert_array_equal(image.camera.color_from_depth.rotation, _TURN.rotation)
        np.testing.assert_array_equal(image.camera.color_from_depth.translation, _TURN.translation)
    assert list(images_of(session).color("b", ALL)) == []


def test_a_gap_in_the_images_is_no_damage(images, tmp_path):
    given = [images[0], *[None] * 12, images[1]]
    read = images_of(written(tmp_path / "s.rrd", given)).color("a", ALL)
    assert [frame for frame, _ in read] == [0, 13]
    assert read.damaged == 0
