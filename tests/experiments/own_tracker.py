"""The program's own tracker on simulated images: ``python -m tests.experiments.own_tracker``.

Prints for each scene how often the person was found, the error of tracked joints, the share of hidden joints
reported as tracked (also of those of which nothing is visible), S* beside that of the simulated Azure
tracker, and the CPU time of an image. Its figures describe the tracker and the simulator, not the machine.
"""

import argparse
import time
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.settings import BlazePoseSettings
from devices.depth.camera import project
from devices.depth.witness import with_witness
from devices.sensor import SensorFrame
from devices.simulated.imaging.body_surface import capsules, flesh_over, visibility
from devices.simulated.kinect import PERSON, Truth, simulated_pair
from devices.simulated.person import anatomy
from fusion.body import AZURE_KINECT, BLAZEPOSE
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.errors import FusionError
from fusion.setup import FuserSettings
from fusion.skeleton import TrackingState
from tests.benchmarks.accuracy import ANGLES, MOTIONS
from tests.benchmarks.methods import RecordedPair, as_recorded
from tests.helpers.frame_pairs import paired

Array = NDArray[np.float64]
SEED = 5000
HIDDEN = 0.35
"""Visible share of a joint's surface below which it counts as hidden: the simulated trackers' own limit."""
COVERED = 0.05
"""Visible share below which nothing of a joint is seen."""
COMMON = tuple(name for name in BLAZEPOSE.joints if name in AZURE_KINECT.joints)
"""Joints of both bodies, over which S* is compared."""


@dataclass(frozen=True, eq=False)
class View:
    """What the tracker reported in T frames of one sensor after the start-up pose, beside the truth.

    Attributes:
        found: (T,) whether a person was reported.
        half_visible: (T,) whether half of the joints are in the image.
        errors: (T, J) metres; NaN where the joint has no position.
        states: (T, J) tracking states.
        visible: (T, J) visible share of each joint's surface.
        milliseconds: (T,) CPU time of the tracker.
    """

    found: NDArray[np.bool_]
    half_visible: NDArray[np.bool_]
    errors: Array
    states: NDArray[np.uint8]
    visible: Array
    milliseconds: Array


@dataclass(frozen=True, eq=False)
class SceneFigures:
    """One scene: both views, and MPJPE of S* of both trackers over the common joints, metres."""

    motion: str
    views: tuple[View, View]
    fused_own: float
    fused_azure: float


def measure(motion, angle, seconds, depth, settings):
    """Runs both trackers on one scene."""
    *sensors, truth = simulated_pair(
        motion=motion, angle_deg=angle, seed=SEED, seconds=seconds, depth=depth, infrared=True
    )
    azure = [list(sensor.frames()) for sensor in sensors]
    tracked = [track(sensor, k, azure[k], truth, settings) for k, sensor in enumerate(sensors)]
    own, views = zip(*tracked, strict=True)
    own_truth = Truth(replace(truth.scene, body=BLAZEPOSE), truth.rig)
    errors = fused_error(BLAZEPOSE, *own, own_truth), fused_error(AZURE_KINECT, *azure, truth)
    return SceneFigures(motion, views, *errors)


def track(sensor, which, frames, truth, settings):
    """The frames with the people of our own tracker, and their figures."""
    rig, scene, lens = truth.rig, truth.scene, sensor.intrinsics
    sensor_from_world = rig.world_from_sensor(which).inverse()
    flesh = flesh_over(BLAZEPOSE) * (scene.height / anatomy.REFERENCE_HEIGHT)
    tracked = []
    rows = []
    with BlazePose(settings) as tracker:
        for k, frame in enumerate(frames):
            marks = sensor_from_world.apply(
                scene.motion.landmarks([rig.captured_at(which, k)], scene.height)[0]
            )
            true = marks[anatomy.landmarks_of(BLAZEPOSE)]
            visible = visibility(true, capsules(marks, scene.height), flesh, lens)
            pixels = project(lens, true)
            inside = (pixels >= 0.0).all(axis=1) & (pixels < (lens.width, lens.height)).all(axis=1)
            before = time.process_time()
            people = tracker.track(frame.ir, frame.depth, lens, frame.time_ns)
            spent = 1e3 * (time.process_time() - before)
            skeleton = next(iter(people.values()), None)
            people = {} if skeleton is None else {PERSON: skeleton}
            tracked.append(with_witness(SensorFrame(frame.time_ns, people, frame.depth), lens))
            if len(tracked) > 1:  # fusion needs no images
                tracked[-2] = replace(tracked[-2], depth=None)
            if rig.captured_at(which, k) < getattr(scene.motion, "begins", 0.0):
                continue  # the start-up pose, in which every tracker is at its best
            off = np.full((len(BLAZEPOSE), 3), np.nan) if skeleton is None else skeleton.positions - true
            states = np.zeros(len(BLAZEPOSE), np.uint8) if skeleton is None else skeleton.states
            error, half = np.linalg.norm(off, axis=1), inside.mean() >= 0.5
            rows.append((skeleton is not None, half, error, states, visible, spent))
    return tracked, View(*(np.array(column) for column in zip(*rows, strict=True)))


def fused_error(body, a, b, truth):
    """MPJPE of S*, as ``duplex fuse`` makes it, over the common joints after the start-up pose; metres."""
    pairs = paired(a, b).pairs
    times = np.array([pair.time_ns for pair in pairs])
    skeletons = [pair.skeletons for pair in pairs]
    try:
        calibration = calibrate(body, *find_start_up_pose(body, skeletons))
    except FusionError:
        calibration = calibrate(body, [pair for pair in skeletons if pair.a and pair.b], "all pairs")
    joints = truth.positions_at(times)
    recording = RecordedPair(body, pairs, calibration, truth.rig.frame_seconds, joints)
    found = as_recorded(FuserSettings(hindsight="labels"))(recording).joints
    first = int(np.searchsorted(times * 1e-9, getattr(truth.scene.motion, "begins", 0.0)))
    common = [body.joint(name) for name in COMMON]
    return float(np.nanmean(np.linalg.norm(found - joints, axis=2)[first:, common]))


def summary(scenes):
    """The figures of some scenes; metres, shares and milliseconds."""
    views = [view for scene in scenes for view in scene.views]
    found = np.concatenate([view.found[view.half_visible] for view in views])
    errors, states, visible = (
        np.concatenate([getattr(view, name) for view in views]) for name in ("errors", "states", "visible")
    )
    tracked = states == TrackingState.TRACKED
    hidden = (visible < HIDDEN) & np.isfinite(errors)
    own, azure = (np.mean([getattr(one, name) for one in scenes]) for name in ("fused_own", "fused_azure"))
    some = np.isfinite(errors)
    shares = {"tracked": tracked, "hidden": hidden, "hidden_tracked": tracked[hidden]}
    shares |= {"covered_tracked": tracked[(visible < COVERED) & some]}
    shares |= {"visible_tracked": tracked[visible > 0.9]}
    figures = {"images": len(found), "found": found.mean(), "median": np.median(errors[tracked])}
    figures |= {"p90": np.percentile(errors[tracked], 90)}
    figures |= {name: flags.mean() for name, flags in shares.items()}
    milliseconds = np.median(np.concatenate([view.milliseconds for view in views]))
    return figures | {"own": own, "azure": azure, "ratio": own / azure, "ms": milliseconds}


def printed(figures):
    """Figures in a line."""
    return ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def main():
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--depth", choices=("half", "full"), default="full", help="size of the images")
    options = parser.parse_args()
    scenes = []
    for motion, angle in product(MOTIONS, ANGLES):
        scenes.append(measure(motion, angle, options.seconds, options.depth, BlazePoseSettings()))
        print(f"{motion} {angle:g}°: {printed(summary(scenes[-1:]))}", flush=True)
    for motion in MOTIONS:
        print(f"{motion}: {printed(summary([scene for scene in scenes if scene.motion == motion]))}")
    print(f"all: {printed(summary(scenes))}")


if __name__ == "__main__":
    main()
