"""Where the tables of the facing filter come from: ``python -m tests.experiments.facing FOLDER…``.

Each folder holds a.csv and b.csv of a person who walks about before two Kinects. It prints the cues' means
and deviations by the cosine to the sensor, the share of mirrored frames, and the angle to the sensor that
shoulders and hips show, by the angle of a straight path. ``python -m tests.benchmarks.real FOLDER…`` measures
the filter.
"""

import argparse
from pathlib import Path

import numpy as np

from fusion.facing.model import TRUNK, WHOLE, FacingConstants, new_facing_model
from tests.helpers.labelled_views import heading, real_views

NODES = (1.0, 0.5, 0.0, -0.5, -1.0)


def tables(pairs, constants):
    """Prints cues of moving people and the share of mirrored frames, by the cosine to the sensor."""
    cosines, cues, mirrored = [], [], []
    for views in pairs:
        labels = views.relabel(model=new_facing_model(views.body, constants))
        trunk = ((labels.codes & WHOLE) == WHOLE) != ((labels.codes & TRUNK) != 0)
        moving = np.linalg.norm(np.gradient(views.a, axis=0), axis=2).mean(axis=1) > 0.4 / 30.0
        for view, (at, sensor) in enumerate(((views.a, np.zeros(3)), (views.b_in_a, views.sensor_b))):
            toward = (sensor - at[:, views.body.root]) * (1.0, 0.0, 1.0)
            toward /= np.linalg.norm(toward, axis=1, keepdims=True)
            facing = labels.heading / np.linalg.norm(labels.heading, axis=1, keepdims=True)
            cosines.append(np.sum(toward * facing, axis=1))
            found = np.sum(_cues(views, at) * facing[:, None], axis=2)
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


def reported_angles(pairs):
    """Prints percentiles of the angle to the sensor that the trunk shows, by that of a straight path."""
    true, shown = [], []
    for views in pairs:
        body, seconds = views.body, np.gradient(views.time_ns * 1e-9)
        trunk = [body.joint(n + side) for n in ("Shoulder", "Hip") for side in ("Left", "Right")]
        centre = 0.5 * (views.a + views.b_in_a)[:, trunk].mean(axis=1)
        centre = np.stack([np.convolve(c, np.ones(9) / 9, "same") for c in centre.T], axis=1)
        way = np.gradient(centre, axis=0) / seconds[:, None]
        path = np.unwrap(np.arctan2(way[:, 2], way[:, 0]))
        used = (np.hypot(way[:, 0], way[:, 2]) > 0.8) & (
            np.abs(np.gradient(path) / seconds) < np.radians(40.0)
        )
        used[:12] = used[-12:] = False
        for at, sensor in ((views.a, np.zeros(3)), (views.b_in_a, views.sensor_b)):
            to, front = sensor - at[:, body.root], heading(body, at)
            to_sensor, facing = (np.arctan2(x[used, 2], x[used, 0]) for x in (to, front))
            angle, seen = ((x - to_sensor + np.pi) % (2.0 * np.pi) - np.pi for x in (path[used], facing))
            true.append(np.degrees(np.abs(angle)))
            shown.append(np.degrees(seen * np.sign(angle)))
    angles, reported = np.concatenate(true), np.concatenate(shown)
    for low in range(0, 180, 20):
        here = reported[(angles >= low) & (angles < low + 20)]
        few, middle, most = np.nanpercentile(here, (16, 50, 84))
        print(
            f"{low}° to {low + 20}°: {len(here)} frames, reported {middle:.0f}° ({few:.0f}° to {most:.0f}°)"
        )


def _cues(views, at):
    """(T, 5, 3) knees before hip–ankle, elbows behind shoulder–wrist, head before the neck."""
    body, found = views.body, []
    for names, sign in ((("Hip", "Knee", "Ankle"), 1.0), (("Shoulder", "Elbow", "Wrist"), -1.0)):
        for side in ("Left", "Right"):
            first, middle, last = (at[:, body.joint(name + side)] for name in names)
            line = last - first
            share = np.sum((middle - first) * line, axis=1) / np.sum(line**2, axis=1)
            found.append(sign * (middle - first - share[:, None] * line))
    return np.stack([*found, at[:, body.joint("Head")] - at[:, body.joint("Neck")]], axis=1)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    options = parser.parse_args()
    pairs = [real_views(folder) for folder in options.folders]
    tables(pairs, FacingConstants())
    reported_angles(pairs)


if __name__ == "__main__":
    main()
