"""Where the estimator's numbers come from: ``python -m tests.experiments.fit_estimator errors [FOLDER…]``.

``errors`` prints the tables of :mod:`fusion.estimator.constants`: medians over recordings, by kind of joint.
``constants`` searches for better constants, one coordinate at a time, on simulated recordings and the real
pairs of the folders (each with a.csv and b.csv), and prints each gain.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.pairing import pair_recordings
from devices.people import choose_person
from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.person.movements import MOTIONS
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import AZURE_KINECT, KINECT_V2, Body
from fusion.calibration.calibration import calibrate
from fusion.estimator.constants import KINDS, Constants, kind_of
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair, TrackingState

Array = NDArray[np.float64]
MAXWELL = 1.538
"""Median length of a vector of three independent standard normal numbers."""


@dataclass(frozen=True)
class Recording:
    """One recording with its calibration, and the truth where it is simulated."""

    name: str
    pairs: list[SkeletonPair]
    setup: FusionSetup
    a: Array  # (T, J, 3) in K_A's frame; NaN where not tracked
    b: Array
    truth: Array | None = None


def simulated(body: Body, motion: str, angle: float, seed: int) -> Recording:
    """A simulated recording of 20 s."""
    a, b, truth = simulated_pair(motion=motion, seed=seed, body=body, angle_deg=angle, seconds=20.0)
    frames = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
    pairs = [frame.skeletons for frame in frames]
    joints = truth.positions_at([pair.time_ns for pair in pairs])
    return _recording(f"{motion} {angle:g}° {seed}", body, pairs, joints)


def real(folder: Path) -> Recording:
    """A pair of CSV files."""
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        frames_a, frames_b = list(a.frames()), list(b.frames())
    people = choose_person(frames_a, None, "A", ""), choose_person(frames_b, None, "B", "")
    pairs = [pair.skeletons for pair in pair_recordings(frames_a, frames_b, *people).pairs]
    body = next(pair.a.body for pair in pairs if pair.a is not None)
    return _recording(folder.name, body, pairs, None)


def _recording(name: str, body: Body, pairs: list[SkeletonPair], truth: Array | None) -> Recording:
    calibration = calibrate(body, [pair for pair in pairs if pair.a and pair.b], "all pairs")
    setup = FusionSetup(calibration)
    nothing = np.full((len(body), 3), np.nan)

    def tracked(pair: SkeletonPair, side: str) -> Array:
        skeleton = getattr(pair, side)
        if skeleton is None:
            return nothing
        seen = (skeleton.states == TrackingState.TRACKED)[:, None]
        return np.where(seen, skeleton.positions.astype(np.float64), np.nan)

    a = np.array([tracked(pair, "a") for pair in pairs])
    b = calibration.a_from_b.apply(np.array([tracked(pair, "b") for pair in pairs]))
    return Recording(name, pairs, setup, a, b, truth)


def error_tables(recordings: Sequence[Recording]) -> dict[str, dict[str, float]]:
    """The slow and fast errors and the accelerations by kind, metres and m/s²; means over recordings."""
    found: dict[str, dict[str, list[float]]] = {
        name: {kind: [] for kind in KINDS} for name in ("slow", "fast", "acceleration")
    }
    for recording in recordings:
        apart = np.linalg.norm(recording.a - recording.b, axis=2)
        for j, joint in enumerate(recording.setup.body.joints):
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


def cost(recordings: Sequence[Recording], constants: Constants) -> float:
    """What the search minimises: MPJPE and 95 % where the truth is known, else the roughness of S*."""
    total = 0.0
    for recording in recordings:
        fuser = Fuser(recording.setup)
        fuser._fusion = DuplexFusion(recording.setup, constants)
        found = np.array([frame.positions for frame in fuser.fuse_sequence(recording.pairs)])
        if recording.truth is not None:
            off = np.linalg.norm(found - recording.truth, axis=2)
            jerk = np.linalg.norm(np.diff(found - recording.truth, 2, axis=0), axis=2)
            total += float(np.nanmean(off) + 0.2 * np.nanpercentile(off, 95) + 0.4 * np.nanmean(jerk))
        else:
            views = 0.5 * sum(_roughness(view) for view in (recording.a, recording.b))
            total += 0.01 * _roughness(found) / views
    return total / len(recordings)


def _roughness(at: Array) -> float:
    return float(np.nanmean(np.linalg.norm(np.diff(at, 2, axis=0), axis=2)))


def search(recordings: Sequence[Recording], seconds: float, seed: int) -> Constants:
    """A coordinate search from the present constants, with steps that shrink where they do not help."""
    random = np.random.default_rng(seed)
    best = Constants()
    lowest = cost(recordings, best)
    print(f"{lowest * 1e3:.3f} at first", flush=True)
    steps = dict.fromkeys(set(Constants._fields) - {"spread", "before", "sides_doubted", "bones"}, 0.35)
    names = sorted(steps)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        name = names[random.integers(len(names))]
        value = getattr(best, name) * float(np.exp(random.choice((-1.0, 1.0)) * steps[name]))
        if name in ("outlier", "inferred_outlier", "outlier_lasts", "surprise"):
            value = min(value, 0.97)
        candidate = best._replace(**{name: value})
        reached = cost(recordings, candidate)
        if reached < lowest:
            best, lowest = candidate, reached
            steps[name] = min(1.2 * steps[name], 0.6)
            print(f"{lowest * 1e3:.3f} with {name} = {value:.4g}", flush=True)
        else:
            steps[name] = max(0.7 * steps[name], 0.05)
    return best


def main(arguments: Sequence[str]) -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=("errors", "constants"))
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--seconds", type=float, default=1800.0, help="how long to search")
    parser.add_argument("--seed", type=int, default=3000, help="of the first simulated recordings")
    options = parser.parse_args(arguments)
    pairs = [real(folder) for folder in options.folders]
    motions = [
        name for name in MOTIONS if name in ("walk", "arms", "badminton", "basketball", "squat", "sit")
    ]
    if options.what == "errors":
        sets = {"real": pairs} if pairs else {}
        for body in (AZURE_KINECT, KINECT_V2):
            sets[body.name] = [simulated(body, motion, 90.0, options.seed) for motion in motions]
        for name, recordings in sets.items():
            for table, of in error_tables(recordings).items():
                print(name, table, {kind: round(value, 4) for kind, value in of.items()})
        return
    for body in (AZURE_KINECT, KINECT_V2):
        pairs += [
            simulated(body, motion, angle, options.seed + k)
            for k, angle in enumerate((45.0, 90.0, 135.0))
            for motion in motions
        ]
    print(search(pairs, options.seconds, options.seed))


if __name__ == "__main__":
    main(sys.argv[1:])
