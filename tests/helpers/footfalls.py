"""A simulated person who walks: when the feet touch the floor and leave it, and a session."""

from dataclasses import replace

import numpy as np

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.person import anatomy
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from recordings.gait import SIDES
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.two_views import calibration_of

_TOUCHING = 0.01  # metres


def contacts(name, seconds):
    """Seconds at which a heel reaches the floor and at which toes leave it, of each side, after the start-up
    pose."""
    t = np.arange(0.0, seconds, 1e-3)
    moving = movement(name)
    heights = -moving.landmarks(t)[..., 1]
    found = {}
    for side in SIDES:
        heel, toes = (heights[:, anatomy.INDEX[f"{part}_{side.upper()}"]] for part in ("HEEL", "FOOT"))
        down = heel < np.percentile(heel, 5.0) + _TOUCHING
        off = toes > anatomy.FOOT_HEIGHT + _TOUCHING
        strikes, offs = (t[1:][of[1:] & ~of[:-1]] for of in (down, off))
        found[side] = strikes[strikes > moving.begins], offs[offs > moving.begins]
    return found


def walking_session(path):
    """Ten seconds whose S* is the true place of a person who walks."""
    times = np.arange(300) * 33_333_333
    walk = Truth(Scene(movement("walk"), AZURE_KINECT), Rig()).positions_at(times + 3_000_000_000)
    session = record_fused(path, frame_pairs(AZURE_KINECT, 300), calibration_of(AZURE_KINECT))
    return replace(session, rows=replace(session.rows, fused=walk, time_ns=times))
