"""Errors of the angles and steps of S* on simulated recordings: ``python -m tests.benchmarks.angles``.

The figures are written to ``results/angles.json``; ``docs/angles.md`` states them.
"""

import argparse
from itertools import product

import numpy as np

from fusion.facing.evidence import upright_direction
from fusion.movement.angles import ANGLES, angle_sigma, joint_angles
from recordings.gait import SIDES
from recordings.gait.events import find_gait
from tests.benchmarks import results
from tests.benchmarks.accuracy import MOTIONS
from tests.benchmarks.methods import METHODS, OURS
from tests.benchmarks.trials import Simulation, Trial, record
from tests.helpers.footfalls import contacts

_FOLLOWED = 0.35  # seconds: a strike shows by what follows
_SAME = 0.2  # seconds between a strike and the contact that it is


def of_angles(recording, found, first):
    """(K,) squared errors of each angle, and (K,) variances that its uncertainty states; degrees²."""
    up = upright_direction(recording.body, found.joints)
    angles, truth = (joint_angles(recording.body, at[first:], up) for at in (found.joints, recording.truth))
    sigma = angle_sigma(recording.body, found.joints[first:], found.sd[first:], up)
    return [np.nanmean(of**2, axis=0) for of in (angles - truth, sigma)]


def of_strikes(recording, found, motion):
    """Seconds of each heel strike after the contact, missed and invented ones."""
    times = np.array([pair.time_ns for pair in recording.pairs])
    up = upright_direction(recording.body, found.joints)
    gait = find_gait(recording.body, times, found.joints, up, found.sd)
    last = times[-1] * 1e-9
    errors, missed, invented = [], 0, 0
    for side in SIDES:
        touches = contacts(motion, last)[side][0]
        met = set()
        for step in gait.of_side(side):
            nearest = int(np.abs(touches - step.strike).argmin())
            error = step.strike - touches[nearest]
            if abs(error) > _SAME or nearest in met:
                invented += 1
                continue
            met.add(nearest)
            errors.append(error)
        missed += len(set(np.flatnonzero(touches < last - _FOLLOWED).tolist()) - met)
    return errors, missed, invented


def main():
    """Measures all recordings and writes their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[7900, 7901, 7902])
    parser.add_argument("--walks", nargs="+", type=int, default=list(range(7900, 7910)))
    options = parser.parse_args()
    ours = next(method for method in METHODS if method.name == OURS)
    squared, errors, missed, invented = {}, [], 0, 0
    trials = [*product(options.motions, options.seeds), *(("walk", seed) for seed in options.walks)]
    for motion, seed in dict.fromkeys(trials):
        recording, first = record(Trial(motion, 90.0, seed), Simulation(), 20.0)
        found = ours.find(recording)
        if seed in options.seeds:
            squared.setdefault(motion, []).append(of_angles(recording, found, first))
        if motion == "walk" and seed in options.walks:
            off, lost, more = of_strikes(recording, found, motion)
            errors, missed, invented = errors + off, missed + lost, invented + more
    rmse = {}
    for name in dict.fromkeys(angle.removesuffix("_left").removesuffix("_right") for angle in ANGLES):
        of_name = [k for k, angle in enumerate(ANGLES) if angle.startswith(name)]
        by_motion = [np.mean(each, axis=0)[:, of_name].mean(axis=1) for each in squared.values()]
        error, stated = np.sqrt(np.mean(by_motion, axis=0))
        rmse[name] = {"rmse": float(error), "stated": float(stated)}
        print(f"{name:20s} {error:4.1f}° stated {stated:4.1f}°")
    strikes = {
        "found": len(errors),
        "missed": missed,
        "invented": invented,
        "rms": float(np.sqrt(np.mean(np.square(errors)))),
        "largest": float(np.abs(errors).max()),
    }
    print(strikes)
    results.write("angles", {"angles": rmse, "strikes": strikes})


if __name__ == "__main__":
    main()
