"""Infrared images in the viewer: shown with the skeleton over them, kept out of files."""

from dataclasses import replace

import numpy as np
import rerun as rr

from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings import layout
from recordings.session import Session
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import BODY, frames
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import calibration_of
from viewer_app.viewer.blueprint import session_blueprint


def with_infrared(frame):
    """The frame with infrared images of the size of its depth images."""
    pair = frame.pair
    assert pair.b is not None
    light = np.linspace(10, 2000, pair.a.depth.size).reshape(pair.a.depth.shape).astype(np.uint16)
    return replace(frame, pair=replace(pair, a=replace(pair.a, ir=light), b=replace(pair.b, ir=light)))


def written(path, *, for_viewer):
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


def test_a_viewer_gets_infrared_and_a_file_does_not(tmp_path):
    shown = written(tmp_path / "shown.rrd", for_viewer=True)
    kept = written(tmp_path / "kept.rrd", for_viewer=False)
    for side in layout.SIDES:
        assert rows_of(shown, layout.infrared(side)) == 10
        assert rows_of(kept, layout.infrared(side)) == 0
    session = Session.open(kept)
    assert session.damage is None
    assert len(list(session.depth("a"))) == 10
