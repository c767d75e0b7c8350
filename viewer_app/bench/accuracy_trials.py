"""The trials of ``duplex bench accuracy``: every method on the same simulated recordings."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair, pair_recordings
from devices.sensor import DeviceError
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate, find_start_up_pose
from fusion.evaluation import baselines
from fusion.evaluation.accuracy import accuracy
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from recordings.session_arrays import SessionArrays
from viewer_app.loop.fusing import fuse_one

METHODS = ("A alone", "B alone", "mean", "tracked wins", "Kalman", "paper", "ours")
"""In the order of the tables. ``paper`` is eqs. (3)-(11) as published, ``ours`` the default."""


@dataclass(frozen=True)
class Trial:
    """One simulated recording.

    Attributes:
        motion: Which movement.
        angle: Degrees between the sensors.
        seed: Of all errors.
    """

    motion: str
    angle: float
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What one method did on one trial: figures by name, in SI; ``fuse_us`` in microseconds a frame."""

    trial: Trial
    method: str
    figures: dict[str, float]


def run_trials(trials: list[Trial], body: Body, seconds: float) -> Iterator[list[Outcome]]:
    """All methods on each trial in turn.

    Raises:
        DeviceError: There is no such movement, or it is too short to hold the start-up pose.
        CalibrationError: The start-up pose of a trial cannot be calibrated on.
    """
    for trial in trials:
        yield _run(trial, body, seconds)


def _run(trial: Trial, body: Body, seconds: float) -> list[Outcome]:
    a, b, truth = simulated_pair(
        motion=trial.motion, seed=trial.seed, body=body, angle_deg=trial.angle, seconds=seconds
    )
    frame_seconds = truth.rig.frame_seconds
    pairs = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
    skeletons = [pair.skeletons for pair in pairs]
    calibration = calibrate(body, *find_start_up_pose(body, skeletons))
    # what the start-up pose was is not measured on: there all methods are at their best
    begins = getattr(truth.scene.motion, "begins", 0.0)
    first = int(np.searchsorted([pair.time_ns * 1e-9 for pair in pairs], begins))
    if len(pairs) - first < 30:
        raise DeviceError(
            f"{seconds:g} s of {trial.motion} leave less than a second after the start-up pose."
        )
    fused = {
        "ours": _fuse(pairs, calibration, FuserSettings()),
        "paper": _fuse(pairs, calibration, FuserSettings(method="published")),
    }
    rows = fused["ours"]
    p, q = rows.positions_a.astype(np.float64), rows.b_in_a
    states = rows.states_a, rows.states_b
    found: dict[str, Callable[[], NDArray[np.float64]]] = {
        "A alone": lambda: baselines.alone(p),
        "B alone": lambda: baselines.alone(q),
        "mean": lambda: baselines.mean(p, q),
        "tracked wins": lambda: baselines.tracked_wins(p, q, *states),
        "Kalman": lambda: baselines.kalman(p, q, *states, frame_seconds),
    }
    true_joints = np.array([truth.positions_at(pair.time_ns) for pair in pairs[first:]])
    outcomes = []
    for method in METHODS:
        if method in fused:
            joints, each_us = fused[method].fused, float(np.median(fused[method].fuse_ms)) * 1e3
        else:
            before = time.perf_counter()
            joints = found[method]()
            each_us = (time.perf_counter() - before) / len(pairs) * 1e6
        figures = accuracy(
            body, joints[first:], true_joints, states[0][first:], states[1][first:], frame_seconds
        )
        outcomes.append(Outcome(trial, method, {**asdict(figures), "fuse_us": each_us}))
    return outcomes


def _fuse(pairs: list[FramePair], calibration: Calibration, settings: FuserSettings) -> SessionArrays:
    fuser = Fuser(FusionSetup(calibration, settings))
    fuser.warm_up()
    frames = [fuse_one(fuser, pair) for pair in pairs]
    return SessionArrays.stack(calibration.body, calibration.bone_lengths, frames)
