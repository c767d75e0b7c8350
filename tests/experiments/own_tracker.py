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
        along: (T, J) metres, error along the ray: positive is too far.
        milliseconds: (T,) CPU time of the tracker.
    """

    found: NDArray[np.bool_]
    half_visible: NDArray[np.bool_]
    errors: Array
    states: NDArray[np.uint8]
    visible: Array
    along: Array
    milliseconds: Array


@dataclass(frozen=True, eq=False)
class SceneFigures:
    """One scene: both views, and MPJPE of S* of both trackers over the common joints, metres."""

    motion: str
    angle: float
    views: tuple[View, View]
    fused_own: float
    fused_azure: float


def measure(motion, angle, seed, seconds, depth, settings):
    """Runs both trackers on one scene."""
    sensors = simulated_pair(
        motion=motion, angle_deg=angle, seed=seed, seconds=seconds, depth=depth, infrared=True
    )
    a, b, truth = sensors
    own_frames, azure_frames, views = [], [], []
    for which, sensor in enumerate((a, b)):
        azure = list(sensor.frames())
        own, view = track(sensor, which, azure, truth, settings)
        own_frames.append(own)
        azure_frames.append(azure)
        views.append(view)
    own_truth = Truth(replace(truth.scene, body=BLAZEPOSE), truth.rig)
    return SceneFigures(
        motion,
        angle,
        (views[0], views[1]),
        fused_error(BLAZEPOSE, *own_frames, own_truth),
        fused_error(AZURE_KINECT, *azure_frames, truth),
    )


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
            pixels = lens.project(true)
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
            ray = true / np.linalg.norm(true, axis=1, keepdims=True)
            rows.append(
                (
                    skeleton is not None,
                    inside.mean() >= 0.5,
                    np.linalg.norm(off, axis=1),
                    states,
                    visible,
                    np.sum(off * ray, axis=1),
                    spent,
                )
            )
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
    return {
        "images": float(len(found)),
        "found": float(found.mean()),
        "median": float(np.median(errors[tracked])),
        "p90": float(np.percentile(errors[tracked], 90)),
        "tracked": float(tracked.mean()),
        "hidden": float(hidden.mean()),
        "hidden_tracked": float(tracked[hidden].mean()),
        "covered_tracked": float(tracked[(visible < COVERED) & np.isfinite(errors)].mean()),
        "visible_tracked": float(tracked[visible > 0.9].mean()),
        "own": float(own),
        "azure": float(azure),
        "ratio": float(own / azure),
        "ms": float(np.median(np.concatenate([view.milliseconds for view in views]))),
    }


def by_joint(scenes):
    """Figures by joint, to see what limits the accuracy."""
    views = [view for scene in scenes for view in scene.views]
    errors, states, visible, along = (
        np.concatenate([getattr(view, name) for view in views])
        for name in ("errors", "states", "visible", "along")
    )
    table = {}
    for j, name in enumerate(BLAZEPOSE.joints):
        tracked = states[:, j] == TrackingState.TRACKED
        hidden = visible[:, j] < HIDDEN
        known = np.isfinite(errors[:, j])
        some = errors[tracked, j]
        table[name] = {
            "median": float(np.median(some)) if some.size else np.nan,
            "p90": float(np.percentile(some, 90)) if some.size else np.nan,
            "along": float(np.median(along[tracked, j])) if some.size else np.nan,
            "tracked": float(tracked.mean()),
            "hidden": float(hidden.mean()),
            "hidden_tracked": float(tracked[hidden & known].mean()) if (hidden & known).any() else np.nan,
            "inferred_median": float(np.median(errors[known & ~tracked, j]))
            if (known & ~tracked).any()
            else np.nan,
        }
    return table


def printed(figures):
    """Figures in a line."""
    return ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def main():
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", nargs="+", default=MOTIONS)
    parser.add_argument("--angles", nargs="+", type=float, default=ANGLES)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--depth", choices=("half", "full"), default="full", help="size of the images")
    parser.add_argument("--network", choices=("full", "lite"), default="full")
    parser.add_argument("--joints", action="store_true", help="figures by joint as well")
    o = parser.parse_args()
    settings = BlazePoseSettings(network=o.network)
    scenes = []
    for motion, angle in product(o.motions, o.angles):
        scenes.append(measure(motion, angle, o.seed, o.seconds, o.depth, settings))
        print(f"{motion} {angle:g}°: {printed(summary(scenes[-1:]))}", flush=True)
    for motion in o.motions:
        print(f"{motion}: {printed(summary([scene for scene in scenes if scene.motion == motion]))}")
    print(f"all: {printed(summary(scenes))}")
    if o.joints:
        for name, figures in by_joint(scenes).items():
            print(f"{name}: {printed(figures)}")


if __name__ == "__main__":
    main()
