"""Fits the constants of ``devices.blazepose.landmark_kinds`` on the simulated person.

``python -m tests.experiments.fit_blazepose`` prints, for each kind of landmark, the depth beneath the surface
(the median over landmarks in plain view) and the limits of a seen landmark: those that keep most landmarks in
plain view, where letting hidden ones through and errors above 10 cm cost. The constants in use are rounded.
Limits of kinds that are rarely hidden, or that the simulated person has no truth for (mouth, knuckles), are
those of their neighbours.
"""

import argparse
import itertools

import numpy as np
from numpy.typing import NDArray

from devices.blazepose import blazepose
from devices.blazepose.blazepose import BlazePose
from devices.blazepose.landmark_kinds import CONSTANTS, INDEX, column
from devices.blazepose.lifting import _outward, lay_body
from devices.blazepose.regions import Region
from devices.depth.camera import project
from devices.simulated.kinect import simulated_pair
from devices.simulated.person import anatomy
from fusion.body import BLAZEPOSE
from tests.helpers.rendered_people import CAMERA, images_of, share_seen

MOTIONS = ("walk", "steps", "turn", "arms", "badminton", "basketball", "squat", "sit")
ANGLES = (45.0, 90.0, 135.0)
HIDDEN, PLAIN = 0.12, 0.5  # share of a joint's surface that the sensor sees
LARGEST_ERROR = 0.1  # metres along the ray, of a seen landmark
HIDDEN_SEEN = 0.04

Array = NDArray[np.float64]


def observe(seconds, every, seed):
    """(N, 7): landmark, share seen, visibility, outward, surface minus body, truth minus reading, size."""
    rows = []
    inputs = []
    lift = blazepose.lift
    blazepose.lift = lambda *given: (inputs.append(given), lift(*given))[1]
    try:
        with BlazePose() as tracker:
            for motion, angle in itertools.product(MOTIONS, ANGLES):
                _, _, truth = simulated_pair(motion=motion, angle_deg=angle)
                sensor_from_world = truth.rig.world_from_sensor(0).inverse()
                for k, marks in enumerate(truth.scene.motion.landmarks(np.arange(0.0, seconds, every))):
                    there = sensor_from_world.apply(marks)
                    tracker.forget()
                    tracker.region = _region_of(there)
                    inputs.clear()
                    tracker.track(*images_of([there], seed + k, angle_deg=angle), CAMERA, 0)
                    if inputs:
                        rows += _rows(inputs[0], there)
    finally:
        blazepose.lift = lift
    return np.array(rows)


def _region_of(landmarks):
    """Where a person is followed, from the truth, so that images need not follow each other."""
    pixels = project(CAMERA, landmarks)
    centre = 0.5 * (pixels[anatomy.INDEX["HIP_LEFT"]] + pixels[anatomy.INDEX["HIP_RIGHT"]])
    radius = 1.05 * float(np.linalg.norm(pixels - centre, axis=1).max())
    return Region.around(centre, centre - (0.0, radius))


def _rows(given, landmarks):
    laid = lay_body(*given)
    if laid is None:
        return []
    body, size, reading = laid
    surface, outward = reading + size * column("beneath"), _outward(body)
    share = dict(zip(BLAZEPOSE.joints, share_seen(landmarks), strict=True))
    rows = []
    for name, j in INDEX.items():
        if name in share and np.isfinite(reading[j]):
            z = landmarks[anatomy.INDEX[name], 2]
            gap = surface[j] - body[j, 2]
            rows.append((j, share[name], given[1][j], outward[j], gap, z - reading[j], size))
    return rows


def fit(rows):
    """Prints the constants of each kind."""
    for kind in CONSTANTS:
        landmarks = [j for name, j in INDEX.items() if name.split("_")[0] == kind]
        of = rows[np.isin(rows[:, 0], landmarks)]
        if not len(of):
            continue
        plain, hidden = of[:, 1] > PLAIN, of[:, 1] < HIDDEN
        beneath = float(np.median((of[:, 5] / of[:, 6])[plain & (np.abs(of[:, 5]) < 0.2)]))
        wrong = np.abs(of[:, 5] - beneath * of[:, 6]) > LARGEST_ERROR
        best = (-np.inf,)
        for visible, turned, front, back in itertools.product(
            (0.3, 0.5, 0.7, 0.8, 0.9),
            (-0.1, 0.0, 0.1, 0.3, 0.5, 1.0),
            (0.06, 0.08, 0.1, 0.15, 0.25),
            (0.1, 0.2),
        ):
            seen = (of[:, 2] >= visible) & (of[:, 3] <= turned) & (of[:, 4] >= -front) & (of[:, 4] <= back)
            through = seen[hidden].mean() if hidden.any() else 0.0
            error_cost = 4.0 * (seen & wrong).sum() / (seen.sum() + 1)
            score = seen[plain].mean() - 2.0 * max(0.0, through - HIDDEN_SEEN) - error_cost
            best = max(best, (score, visible, turned, front, back, seen[plain].mean(), through))
        _, visible, turned, front, back, kept, through = best
        print(
            f"{kind:9s} {beneath:.3f}, {visible:.1f}, {turned:.1f}, {front:.2f}, {back:.2f}: seen {kept:.2f} "
            f"of {plain.sum()} in plain view, {through:.3f} of {hidden.sum()} hidden"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=9.0)
    parser.add_argument("--every", type=float, default=0.4)
    parser.add_argument("--seed", type=int, default=3)
    asked = parser.parse_args()
    fit(observe(asked.seconds, asked.every, asked.seed))
