"""Where the estimator's tables come from: ``python -m tests.experiments.fit_estimator [FOLDER…]``.

Prints the tables of :mod:`fusion.estimator.constants` from simulated recordings and from the real pairs of
the folders (each with a.csv and b.csv): medians over recordings, by kind of joint.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.simulated.kinect import simulated_pair
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import AZURE_KINECT, KINECT_V2, Body
from fusion.calibration.calibration import calibrate
from fusion.joint_kinds import KINDS, kind_of
from fusion.skeleton import TrackingState
from tests.helpers.frame_pairs import paired

Array = NDArray[np.float64]
MOTIONS = ("walk", "arms", "badminton", "basketball", "squat", "sit")
MAXWELL = 1.538
"""Median length of a vector of three independent standard normal numbers."""


@dataclass(frozen=True)
class Recording:
    """Both views: (T, J, 3) in K_A's frame; NaN where not tracked."""

    body: Body
    a: Array
    b: Array


def simulated(body, motion, seed):
    """A simulated recording of 20 s."""
    a, b, _ = simulated_pair(motion=motion, seed=seed, body=body, angle_deg=90.0, seconds=20.0)
    return recording_of(a.frames(), b.frames())


def real(folder):
    """A pair of CSV files."""
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        return recording_of(a.frames(), b.frames())


def recording_of(frames_a, frames_b):
    """Both views of one person, registered over the whole recording."""
    pairs = [pair.skeletons for pair in paired(frames_a, frames_b).pairs]
    body = next(pair.a.body for pair in pairs if pair.a is not None)
    calibration = calibrate(body, [pair for pair in pairs if pair.a and pair.b], "all pairs")

    def tracked(skeleton):
        if skeleton is None:
            return np.full((len(body), 3), np.nan)
        seen = (skeleton.states == TrackingState.TRACKED)[:, None]
        return np.where(seen, skeleton.positions.astype(np.float64), np.nan)

    b = calibration.a_from_b.apply(np.array([tracked(pair.b) for pair in pairs]))
    return Recording(body, np.array([tracked(pair.a) for pair in pairs]), b)


def error_tables(recordings):
    """The slow and fast errors and the accelerations by kind, metres and m/s²; means over recordings."""
    found = {name: {kind: [] for kind in KINDS} for name in ("slow", "fast", "acceleration")}
    for recording in recordings:
        apart = np.linalg.norm(recording.a - recording.b, axis=2)
        for j, joint in enumerate(recording.body.joints):
            kind = kind_of(joint)
            if np.isfinite(apart[:, j]).any():
                found["slow"][kind].append(float(np.nanmedian(apart[:, j])) / MAXWELL / np.sqrt(2.0))
            for view in (recording.a, recording.b):
                change = np.linalg.norm(np.diff(view[:, j], 2, axis=0), axis=1)
                change = change[np.isfinite(change) & (change > 0.0)]
                if len(change) > 20:
                    found["fast"][kind].append(float(np.percentile(change, 20)) / np.sqrt(6.0))
                    found["acceleration"][kind].append(
                        float(np.sqrt(np.mean(np.minimum(change, 0.1) ** 2) / 3.0)) * 900.0
                    )
    return {name: {kind: float(np.mean(v)) for kind, v in of.items() if v} for name, of in found.items()}


def main():
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--seed", type=int, default=3000, help="of the simulated recordings")
    options = parser.parse_args()
    sets = {"real": [real(folder) for folder in options.folders]} if options.folders else {}
    for body in (AZURE_KINECT, KINECT_V2):
        sets[body.name] = [simulated(body, motion, options.seed) for motion in MOTIONS]
    for name, recordings in sets.items():
        for table, of in error_tables(recordings).items():
            print(name, table, {kind: round(value, 4) for kind, value in of.items()})


if __name__ == "__main__":
    main()
