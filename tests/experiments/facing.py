"""Where the tables of the facing filter come from: ``python -m tests.experiments.facing FOLDER…``.

Each folder holds a.csv and b.csv of a person who walks about before two Kinects. It prints the cues' means
and deviations by the cosine to the sensor, and the share of mirrored frames. ``python -m
tests.benchmarks.real FOLDER…`` measures the filter.
"""

import argparse
from pathlib import Path

import numpy as np

from fusion.facing.model import TRUNK, WHOLE, FacingConstants, new_facing_model
from tests.helpers.labelled_views import Floats, Views, real_views

NODES = (1.0, 0.5, 0.0, -0.5, -1.0)


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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    options = parser.parse_args()
    tables([real_views(folder) for folder in options.folders], FacingConstants())


if __name__ == "__main__":
    main()
