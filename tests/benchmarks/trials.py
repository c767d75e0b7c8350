"""Simulated recordings with known truth, and every method on each of them."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Literal

import numpy as np

from devices.depth.image_thinning import Depth
from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import BODIES
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from tests.benchmarks.harsher_errors import heavy_tailed, scaled
from tests.benchmarks.methods import METHODS, RecordedPair
from tests.benchmarks.scores import accuracy
from tests.helpers.frame_pairs import paired

TrackerShape = Literal["fitted", "heavy-tailed"]


@dataclass(frozen=True)
class Trial:
    """One simulated recording.

    Attributes:
        motion: Name of the movement.
        angle: Degrees between the sensors.
        seed: Seed of all errors.
    """

    motion: str
    angle: float
    seed: int


@dataclass(frozen=True)
class Simulation:
    """Settings shared by all trials.

    Attributes:
        body: The name of the body that the trackers report.
        errors: Factor for all tracker errors.
        tracker_errors: Error model: fitted to real recordings, or heavy-tailed, which no method is fitted to.
        depth: Size of the depth images, which S* uses as evidence.
    """

    body: str = "azure_kinect"
    errors: float = 1.0
    tracker_errors: TrackerShape = "fitted"
    depth: Depth = "none"

    def errors_of_tracker(self):
        """The errors of both trackers."""
        errors = TrackerErrors.of(BODIES[self.body])
        if self.tracker_errors == "heavy-tailed":
            errors = heavy_tailed(errors)
        return errors if self.errors == 1.0 else scaled(errors, self.errors)


@dataclass(frozen=True)
class Outcome:
    """What one method did on one trial: figures by name, in SI."""

    trial: Trial
    method: str
    figures: dict[str, float]


def run_trials(trials, simulation, seconds, names, processes=1):
    """The named methods on each trial, in the trials' order."""
    if processes < 2:
        yield from (run_trial(trial, simulation, seconds, names) for trial in trials)
        return
    # Spawned, not forked: the threads of numba and OpenBLAS do not survive a fork.
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        run = partial(run_trial, simulation=simulation, seconds=seconds, names=tuple(names))
        yield from pool.map(run, trials)


def chosen_methods(names):
    """The rows of these names, in the tables' order."""
    return [method for method in METHODS if method.name in names]


def run_trial(trial, simulation, seconds, names):
    """The named methods on one trial; see :func:`run_trials`."""
    recording, first = record(trial, simulation, seconds)
    states_a, states_b = recording.states
    outcomes = []
    for method in chosen_methods(names):
        found = method.find(recording)
        measured = (at[first:] for at in (found.joints, recording.truth, states_a, states_b))
        sd = None if found.sd is None else found.sd[first:]
        figures = accuracy(recording.body, *measured, recording.frame_seconds, sd)
        outcomes.append(Outcome(trial, method.name, figures))
    return outcomes


def record(trial, simulation, seconds):
    """A simulated recording, and its first frame after the start-up pose, where the measurement starts.

    The start-up pose is excluded, because all methods perform best in it.
    """
    body = BODIES[simulation.body]
    scene = {"motion": trial.motion, "angle_deg": trial.angle, "seed": trial.seed, "seconds": seconds}
    errors = simulation.errors_of_tracker()
    a, b, truth = simulated_pair(**scene, body=body, errors=errors, depth=simulation.depth)
    # only the few figures per joint that each image gave are kept
    frames_a, frames_b = ([replace(f, depth=None) for f in sensor.frames()] for sensor in (a, b))
    pairs = paired(frames_a, frames_b).pairs
    times = np.array([pair.time_ns for pair in pairs])
    calibration = calibrate(body, *find_start_up_pose(body, [pair.skeletons for pair in pairs]))
    first = int(np.searchsorted(times * 1e-9, getattr(truth.scene.motion, "begins", 0.0)))
    if len(pairs) - first < 30:
        raise DeviceError(f"{seconds:g} s of {trial.motion} leave no second after the start-up pose.")
    joints = truth.positions_at(times)
    return RecordedPair(body, pairs, calibration, truth.rig.frame_seconds, joints), first
