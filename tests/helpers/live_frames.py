"""Fused frames of a person, and a live session to write them to."""

import numpy as np

from devices.sensor import SensorFrame
from fusion.body import KINECT_V2
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.fusing.pairs import fuse_one
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pair
from tests.helpers.two_views import FRAME_NS, calibration_of, pair_of, standing
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.viewer_choice import LiveWindow, Viewing

BODY = KINECT_V2


def known_fuser():
    """A fuser that knows where both sensors are."""
    return Fuser(FusionSetup(calibration_of(BODY)))


def frames(fuser, count, depth=False):
    """A standing person who sways; with `depth`, each sensor has an image in every frame."""
    image = np.random.default_rng(0).integers(0, 4000, (424, 512)).astype(np.uint16) if depth else None
    made = []
    for k in range(count):
        joints = standing(BODY) + [0.1 * np.sin(k / 10), 0.0, 0.0]
        seen = pair_of(BODY, joints, k * FRAME_NS)
        a, b = (SensorFrame(k * FRAME_NS, {"1": skeleton}, image) for skeleton in (seen.a, seen.b))
        made.append(fuse_one(fuser, frame_pair(a, b, "1", k * FRAME_NS)))
    return made


def session(fuser, file=None, hub=None, window=False, active="inspect", headless=True):
    """A session into a file, a hub or both."""
    viewing = LiveWindow(hub, headless) if window else Viewing(hub)
    blueprint = session_blueprint(fuser.setup, np.array([0.0, 0.0, 2.6]), active)
    return LiveSession(fuser.setup, ("a", "b"), blueprint, file=file, viewing=viewing)


def numbers_in(file):
    """The numbers of the frames that a session's file holds."""
    read = Session.open(file)
    assert read.damage is None
    return [int(number) for number in read.rows.frame]
