"""Infrared images in the viewer: shown with the skeleton over them, kept out of files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance.colors import SKELETON_COLORS
from recordings.session import Session
from recordings.session_arrays import SessionFrame
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import BODY, frames
from tests.helpers.pictures import headless_viewer, pixels_near
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import calibration_of
from tests.helpers.waiting import eventually
from viewer_app.viewer.blueprint import session_blueprint


def with_infrared(frame: SessionFrame) -> SessionFrame:
    """The frame with infrared images of the size of its depth images."""
    pair = frame.pair
    assert pair.a is not None
    assert pair.b is not None
    assert pair.a.depth is not None
    light = np.linspace(10, 2000, pair.a.depth.size).reshape(pair.a.depth.shape).astype(np.uint16)
    return replace(frame, pair=replace(pair, a=replace(pair.a, ir=light), b=replace(pair.b, ir=light)))


def written(path: Path, *, for_viewer: bool) -> Path:
    """Ten frames with depth and infrared, as a viewer gets them or as a file does."""
    setup = FusionSetup(calibration_of(BODY))
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=path.stem)
    stream.save(str(path))
    recorder = Recorder(stream, setup, ("a", "b"), depth_every=1, points=for_viewer)
    stream.send_blueprint(session_blueprint(setup, np.array([0.1, 0.1, 2.6]), "setup", infrared=for_viewer))
    for frame in frames(Fuser(setup), 10, depth=True):
        recorder.record_all([with_infrared(frame)])
    recorder.finish()
    stream.flush()
    stream.disconnect()
    return path


def test_a_viewer_gets_infrared_and_a_file_does_not(tmp_path: Path) -> None:
    shown = written(tmp_path / "shown.rrd", for_viewer=True)
    kept = written(tmp_path / "kept.rrd", for_viewer=False)
    for side in layout.SIDES:
        assert rows_of(shown, layout.infrared(side)) == 10
        assert rows_of(kept, layout.infrared(side)) == 0
    session = Session.open(kept)
    assert session.damage is None
    assert len(list(session.depth("a"))) == 10


def test_setup_shows_infrared_with_the_skeleton_over_it(tmp_path: Path) -> None:
    with headless_viewer(str(written(tmp_path / "s.rrd", for_viewer=True))) as viewer:

        def drawn() -> bool:
            # the viewer lists views in no fixed order
            found = sorted(
                (view.name, view.view_id) for view in viewer.get_state().views if view.name in NAMES
            )
            pictures = [view_of(viewer, view_id, tmp_path / "view.png") for _, view_id in found]
            return len(pictures) == 2 and all(
                picture is not None and is_grey_ramp(picture) and pixels_near(picture, color) > 20
                for picture, color in zip(pictures, SKELETONS, strict=True)
            )

        assert eventually(drawn)
        complaints = [
            report.summary
            for view in viewer.get_state().views
            if view.name.endswith("infrared")
            for report in view.reports
        ]
        assert complaints == []


NAMES = "Kinect A, infrared", "Kinect B, infrared"
SKELETONS = SKELETON_COLORS["a"], SKELETON_COLORS["b"]


def view_of(viewer: ViewerClient, view_id: object, path: Path) -> NDArray[np.uint8] | None:
    """(height, width, 3) RGB of a view; None while it is not drawn."""
    try:
        viewer.save_screenshot(str(path), view_id)
    except ConnectionError:
        return None
    picture = cv2.imread(str(path))
    return None if picture is None else np.asarray(picture[..., ::-1], np.uint8)


def is_grey_ramp(picture: NDArray[np.uint8]) -> bool:
    """Whether grey pixels of all levels from dark to bright make up a good part of a view."""
    grey = picture[(picture.max(axis=2) - picture.min(axis=2)) < 12][:, 0]
    counts = np.histogram(grey, bins=4, range=(64, 256))[0]
    return bool((counts > 0.03 * picture[..., 0].size).all())
