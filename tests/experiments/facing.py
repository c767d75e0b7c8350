"""Where the numbers of the facing filter come from: ``python -m tests.experiments.facing FOLDER… --tables``.

Each folder holds a.csv and b.csv of a person who walks about before two Kinects. ``--tables`` prints the
cues' means and deviations by the cosine to the sensor, and the share of mirrored frames. ``--search S``
changes constants at random for S seconds and prints the best; people who really walk backwards count as
wrong, so look at the recording. ``python -m tests.benchmarks.real FOLDER…`` measures the filter.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from fusion.facing.model import TRUNK, WHOLE, FacingConstants, new_facing_model
from tests.helpers.labelled_views import Floats, Views, flips, heading, real_views, simulated_views, swapped

NODES = (1.0, 0.5, 0.0, -0.5, -1.0)
SIMULATED = [(motion, body) for body in ("kinect_v2", "azure_kinect") for motion in (
    "walk", "turn", "backwards", "squat@180", "bow@180")]  # fmt: skip
SEARCHED = {
    "axis_weight": (0.05, 1.0), "axis_floor": (2.0, 8.0), "cue_weight": (0.02, 0.3), "cue_floor": (2.0, 8.0),
    "motion_weight": (0.1, 1.5), "mirrored_seconds": (0.08, 1.0), "mirrored_width": (0.08, 0.3),
    "turning_sigma": (0.03, 0.1), "turning_sigma_fast": (0.1, 0.35), "turning_share": (0.1, 0.7),
    "continuity": (20.0, 300.0), "moving_speed": (0.15, 1.0), "still_weight": (0.03, 0.4),
    "change_from": (0.5, 0.9),
}  # fmt: skip


def walking(views: Views) -> tuple[Floats, Floats]:
    """(T, 3) unit direction of the trunk's motion, smoothed over 9 frames, and (T,) whether above 0.8 m/s."""
    body = views.body
    trunk = [body.joint(n) for n in ("ShoulderLeft", "ShoulderRight", "HipLeft", "HipRight")]
    centre = 0.5 * (views.a + views.b_in_a)[:, trunk].mean(axis=1) * (1.0, 0.0, 1.0)
    centre = np.stack([np.convolve(c, np.ones(9) / 9, "same") for c in centre.T], axis=1)
    velocity = np.gradient(centre, axis=0) / np.gradient(views.time_ns * 1e-9)[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    fast = speed > 0.8
    fast[:12] = fast[-12:] = False
    return velocity / np.maximum(speed, 1e-9)[:, None], fast


def against(views: Views, at: Floats) -> float:
    """Percentage of fast frames that face against the motion."""
    way, fast = walking(views)
    facing = np.sum(heading(views.body, at) * way, axis=1)[fast]
    return float(np.mean(facing < -0.5) * 100.0) if fast.any() else float("nan")


def tables(pairs: list[Views], constants: FacingConstants) -> None:
    """Prints cues of moving people and the share of mirrored frames, by the cosine to the sensor."""
    cosines, cues, mirrored = [], [], []
    for views in pairs:
        labels = views.relabel(model=new_facing_model(views.body, constants))
        trunk = ((labels.codes & WHOLE) == WHOLE) != ((labels.codes & TRUNK) != 0)
        moving = np.linalg.norm(np.gradient(views.a, axis=0), axis=2).mean(axis=1) > 0.4 / 30.0
        for view, (at, sensor) in enumerate(((views.a, np.zeros(3)), (views.b_in_a, views.sensor_b))):
            toward = (sensor - at[:, views.body.root]) * (1.0, 0.0, 1.0)
            toward /= np.linalg.norm(toward, axis=1, keepdims=True)
            cosines.append(np.sum(toward * labels.facing, axis=1))
            found = np.sum(_cues(views, at) * labels.facing[:, None], axis=2)
            cues.append(np.where(moving[:, None], found, np.nan))
            mirrored.append(trunk[:, view])
    cosine, cue, share = np.concatenate(cosines), np.concatenate(cues), np.concatenate(mirrored)
    for node in NODES:
        near = np.abs(cosine - node) < 0.25
        print(
            f"cosine {node:+.1f}: {near.sum():6d} frames, mirrored {share[near].mean() * 100:5.1f} %", end=""
        )
        for which, name in ((slice(0, 2), "knee"), (slice(2, 4), "elbow"), (slice(4, 5), "head")):
            low, middle, high = np.nanpercentile(cue[near][:, which], (16, 50, 84))
            print(f"; {name} {middle * 1e3:.0f} ± {(high - low) * 500:.0f} mm", end="")
        print()


def _cues(views: Views, at: Floats) -> Floats:
    """(T, 5, 3) knees before hip–ankle, elbows behind shoulder–wrist, head before the neck."""
    body, found = views.body, []
    for names, sign in ((("Hip", "Knee", "Ankle"), 1.0), (("Shoulder", "Elbow", "Wrist"), -1.0)):
        for side in ("Left", "Right"):
            first, middle, last = (at[:, body.joint(name + side)] for name in names)
            line = last - first
            share = np.sum((middle - first) * line, axis=1) / np.sum(line**2, axis=1)
            found.append(sign * (middle - first - share[:, None] * line))
    return np.stack([*found, at[:, body.joint("Head")] - at[:, body.joint("Neck")]], axis=1)


def cost(pairs: list[Views], constants: FacingConstants) -> float:
    """What ``--search`` makes small: real frames against the motion, flips, wrong simulated frames."""
    total = 0.0
    for views in pairs:
        model = new_facing_model(views.body, constants)
        for smooth in (False, True):
            fused = views.fused(views.relabel(smooth=smooth, model=model))
            total += (against(views, fused) + 0.7 * flips(heading(views.body, fused))) / len(pairs)
    for motion, body in SIMULATED:
        views = simulated_views(motion, body)
        own = constants if body == "kinect_v2" else constants._replace(
            mirrored_back=FacingConstants.of(views.body).mirrored_back)  # fmt: skip
        model = new_facing_model(views.body, own)
        for smooth in (False, True):
            fused = views.fused(views.relabel(smooth=smooth, model=model))
            wrong = swapped(views.body, fused, views.truth)[60:].mean() * 100.0
            total += (2.0 * wrong + 0.5 * flips(heading(views.body, fused)[60:])) / len(SIMULATED)
    return total


def search(pairs: list[Views], constants: FacingConstants, seconds: float) -> None:
    """A random walk downhill from the constants in force."""
    random, best, end = np.random.default_rng(0), cost(pairs, constants), time.monotonic() + seconds
    print(f"{best:.2f} at the start")
    while time.monotonic() < end:
        names = random.choice(list(SEARCHED), random.integers(1, 4), replace=False)
        changed = {
            name: float(np.clip(getattr(constants, name) * np.exp(random.normal(0.0, 0.4)), *SEARCHED[name]))
            for name in names
        }
        found = cost(pairs, constants._replace(**changed))
        if found < best:
            best, constants = found, constants._replace(**changed)
            print(f"{best:.2f} with {changed}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    wanted = parser.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--tables", action="store_true")
    wanted.add_argument("--search", type=float, metavar="S")
    options = parser.parse_args()
    constants = FacingConstants()
    pairs = [real_views(folder) for folder in options.folders]
    if options.tables:
        tables(pairs, constants)
    else:
        search(pairs, constants, options.search)


if __name__ == "__main__":
    main()
