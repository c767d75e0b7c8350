"""People who walk: when the feet touch the floor and leave it, and a session."""

import json
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, files

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.person import anatomy
from devices.simulated.person.footsteps import smooth
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from recordings.gait import SIDES
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.two_views import calibration_of

_TOUCHING = 0.002  # metres


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


def stood(strikes, offs):
    """(C,) share of each cycle of a foot in which it stands, by seconds of its strikes and toe-offs."""
    after = offs[np.searchsorted(offs, strikes[:-1])]
    return (after - strikes[:-1]) / np.diff(strikes)


def walking_session(path):
    """Ten seconds whose S* is the true place of a person who walks."""
    times = np.arange(300) * 33_333_333
    walk = Truth(Scene(movement("walk"), AZURE_KINECT), Rig()).positions_at(times + 3_000_000_000)
    session = record_fused(path, frame_pairs(AZURE_KINECT, 300), calibration_of(AZURE_KINECT))
    return replace(session, rows=replace(session.rows, fused=walk, time_ns=times))


_PARTS = "Hip", "Shoulder", "Ankle", "Foot"


def walker(seconds, rate, *, speed=0.7, stride=1.2, stance=0.64, turning=0.0, weaving=(0.0, 0.0), rises=0.0):
    """A person who walks along a path at constant speed: (T,) ns and (T, J, 3) metres, with y down.

    Feet are planted on the path and swing with minimum jerk; all else that a gait has is left out.

    Args:
        speed: Metres per second.
        stride: Seconds.
        stance: Share of a stride that a foot stands.
        turning: Radians per metre.
        weaving: Radians by which the heading swings besides, and how often per metre.
        rises: Metres by which toes rise in a swing.
    """
    t = np.arange(0.0, seconds, 1.0 / rate)
    fine = np.arange(-3.0 * stride, seconds + 3.0 * stride, 0.01)
    way = speed * fine
    heading = turning * way + weaving[0] * np.sin(2.0 * np.pi * weaving[1] * way)
    path = [cumulative_simpson(to, x=way, initial=0.0) for to in (np.sin(heading), np.cos(heading))]

    def place(time, aside, ahead, height):
        at, facing = [np.interp(time, fine, along) for along in path], np.interp(time, fine, heading)
        x = at[0] + ahead * np.sin(facing) + aside * np.cos(facing)
        z = at[1] + ahead * np.cos(facing) - aside * np.sin(facing)
        return np.stack(np.broadcast_arrays(x, -height, z), axis=-1)

    joints = np.full((len(t), len(AZURE_KINECT), 3), np.nan)
    for sign, side, first in ((-1.0, "Left", 0.0), (1.0, "Right", 0.5 * stride)):
        swing = (1.0 - stance) * stride
        number = np.floor((t - first) / stride)
        done = smooth((t - first - number * stride) / swing)[:, None]
        # when the body passes above the foot
        planted = first + number * stride + swing + 0.5 * stance * stride
        for part, aside, ahead, height in (
            ("Hip", 0.1, 0.0, 0.85),
            ("Shoulder", 0.2, 0.0, 1.4),
            ("Ankle", 0.08, 0.0, 0.08),
            ("Foot", 0.08, 0.15, 0.0),
        ):
            now, before = (place(each, sign * aside, ahead, height) for each in (planted, planted - stride))
            joints[:, AZURE_KINECT.joint(part + side)] = (
                before + done * (now - before)
                if part in ("Ankle", "Foot")
                else place(t, sign * aside, ahead, height)
            )
        joints[:, AZURE_KINECT.joint("Foot" + side), 1] -= rises * np.sin(np.pi * done[:, 0])
    return np.rint(t * 1e9).astype(np.int64), joints


def laboratory_walk():
    """A walk of a person with Parkinson's disease: (T,) seconds, (T, J, 3) metres with y up, labelled events.

    The events are seconds of heel strikes and toe-offs of each side. They are of PhysioNet's Gait in
    Parkinson's Disease (ODC-By 1.0), in the package gaitkit 1.5.0.
    """
    try:
        (path,) = [each for each in files("gaitkit") or () if each.name == "example_parkinson.json"]
    except PackageNotFoundError:
        pytest.skip("gaitkit is not installed: pip install gaitkit==1.5.0")
    walk = json.loads(path.locate().read_text())
    marks = [frame["landmark_positions"] for frame in walk["angle_frames"]]
    joints = np.full((len(marks), len(AZURE_KINECT), 3), np.nan)
    for part in _PARTS:
        for side in SIDES:
            mark = f"{side}_{'toe' if part == 'Foot' else part.lower()}"
            joints[:, AZURE_KINECT.joint(part + side.title())] = [1e-3 * np.array(at[mark]) for at in marks]
    told = walk["ground_truth"]
    return (
        np.arange(len(marks)) / walk["fps"],
        joints,
        {
            side: [np.array(told[f"{kind}_frames"][side]) / walk["fps"] for kind in ("hs", "to")]
            for side in SIDES
        },
    )
