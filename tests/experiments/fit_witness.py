"""Fits the tables of ``fusion.witness`` on simulated sensors: ``python -m tests.experiments.fit_witness``.

Prints FLESH, SURFACE_SD and EVIDENCE as Python. The simulated person is made of capsules whose axes are the
bones; so real standard deviations are larger, and the evidence is limited to a factor of 20.
"""

import argparse
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.depth.witness import with_witness
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import AZURE_KINECT, Body
from fusion.compiling.references import by_reference
from fusion.joint_kinds import kind_of
from fusion.rigid import RigidTransform
from fusion.skeleton import TrackingState
from fusion.support.array_fields import new_arrays
from fusion.witness import (
    _GROUPS,
    FLESH,
    KNOTS,
    LARGEST,
    SURFACE_SD,
    JointEvidence,
    new_witness_model,
    weigh_witness,
)
from tests.benchmarks.accuracy import ANGLES, MOTIONS

GOOD, BAD = 0.050, 0.100  # metres: errors between them count for neither
_LARGEST_ERROR = 0.060  # metres: what the root mean square of a surface measurement is limited to
_FEWEST = 300  # measurements

Array = NDArray[np.float64]


class View(NamedTuple):
    """One sensor's recording: T frames of J joints in its frame."""

    body: Body
    positions: Array
    states: NDArray[np.uint8]
    witness: NDArray[np.float32]
    truth: Array


@dataclass
class Sums:
    """What is collected over all recordings, by kind or group of joints."""

    surface: dict[str, list[Array]] = field(default_factory=lambda: defaultdict(list))
    counts: dict[str, Array] = field(default_factory=lambda: defaultdict(lambda: np.ones((2, len(KNOTS)))))


def watch(sensor, a_to_sensor, truth_at, first_ns):
    """A sensor's frames with their witness, after the start-up pose."""
    skeletons = []
    for frame in sensor.frames():
        if frame.time_ns >= first_ns and PERSON in frame.people:
            skeletons.append(with_witness(frame, sensor.intrinsics).people[PERSON])
    times = np.array([skeleton.time_ns for skeleton in skeletons])
    return View(
        sensor.body,
        np.array([s.positions for s in skeletons], dtype=np.float64),
        np.array([s.states for s in skeletons]),
        np.array([s.witness for s in skeletons]),
        a_to_sensor.apply(truth_at(times)),
    )


def flesh_of(views):
    """Metres by kind of joint: how much deeper the true joint is than the surface before the reported one."""
    found = defaultdict(list)
    for view in views:
        known = (view.states == TrackingState.TRACKED) & (errors(view) < GOOD)
        reported, true = np.linalg.norm(view.positions, axis=2), np.linalg.norm(view.truth, axis=2)
        deeper = true - (reported + view.witness[..., 0])
        for j, joint in enumerate(view.body.joints):
            of_joint = deeper[known[:, j], j]
            found[kind_of(joint)].append(of_joint[np.isfinite(of_joint)])
    return {kind: round(float(np.median(np.concatenate(found[kind]))), 3) for kind in FLESH if found[kind]}


def errors(view):
    """(T, J) distance of each joint from its true place."""
    return np.asarray(np.linalg.norm(view.positions - view.truth, axis=2))


def collect(view, flesh, sums):
    """Adds a recording."""
    tracked = (view.states == TrackingState.TRACKED) & np.isfinite(view.witness[..., 0])
    error = errors(view)
    kinds = np.array([kind_of(joint) for joint in view.body.joints])
    model = new_witness_model(view.body)._replace(flesh=np.array([flesh[kind] for kind in kinds]))
    joints = len(view.body)
    free = np.minimum(view.witness[..., 0], -view.witness[..., 1])
    clearance = np.where(free > 0.0, free, np.minimum(view.witness[..., 0] + model.flesh, 0.0))
    for kind, group in _GROUPS.items():
        for row, of_it in enumerate((error < GOOD, error > BAD)):
            sums.counts[group][row] += hats(clearance[tracked & of_it & (kinds == kind)])
    result = by_reference(new_arrays(JointEvidence, J=joints))
    everywhere = by_reference(model._replace(information=np.ones((joints, 3))))
    for at, states, witness, truth in zip(view.positions, view.states, view.witness, view.truth, strict=True):
        weigh_witness(everywhere, np.eye(3), np.zeros(3), at, states, witness, result)
        ray = at / np.linalg.norm(at, axis=1, keepdims=True)
        bone = at - at[model.neighbours]
        bone -= (bone * ray).sum(axis=1, keepdims=True) * ray
        bone /= np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)
        off = truth - result.places
        axes = np.stack([np.cross(ray, bone), bone, ray], axis=1)  # (J, 3 axes, 3)
        components = np.einsum("jki,ji->jk", axes, off)
        known = np.isfinite(components).all(axis=1) & (np.linalg.norm(at - truth, axis=1) < BAD)
        for j in np.flatnonzero(known):
            sums.surface[kinds[j]].append(components[j])


def hats(values):
    """(len(KNOTS),) how many values lie at each knot, each shared between its two neighbours."""
    values = np.clip(values[np.isfinite(values)], KNOTS[0], KNOTS[-1])
    upper = np.clip(np.searchsorted(KNOTS, values), 1, len(KNOTS) - 1)
    share = (values - KNOTS[upper - 1]) / (KNOTS[upper] - KNOTS[upper - 1])
    found = np.zeros(len(KNOTS))
    np.add.at(found, upper, share)
    np.add.at(found, upper - 1, 1.0 - share)
    return found


def log_ratios(counts):
    """(len(KNOTS),) log P(knot | good) / P(knot | outlier): falls away from its highest, within ±LARGEST."""
    shares = counts / counts.sum(axis=1, keepdims=True)
    ratios = np.log(shares[0] / shares[1])
    # the highest knot is one with data, not one that neither has
    top = int(np.argmax(np.where(counts[0] > _FEWEST, ratios, -np.inf)))
    ratios[top:] = np.minimum.accumulate(ratios[top:])
    ratios[: top + 1] = np.minimum.accumulate(ratios[: top + 1][::-1])[::-1]
    return np.clip(ratios, -LARGEST, LARGEST)


def main():
    """Simulates, fits and prints."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--seeds", type=int, nargs="+", default=[3000, 3001, 3002, 3003, 3004])
    p.add_argument("--seconds", type=float, default=12.0)
    o = p.parse_args()
    sums, views = Sums(), []
    for seed, motion, angle in product(o.seeds, MOTIONS, ANGLES):
        scene = {"motion": motion, "seed": seed, "angle_deg": angle, "seconds": o.seconds}
        a, b, truth = simulated_pair(**scene, body=AZURE_KINECT, depth="half")
        begins = round(getattr(truth.scene.motion, "begins", 0.0) * 1e9)
        views.append(watch(a, RigidTransform.identity(), truth.positions_at, begins))
        views.append(watch(b, truth.a_from_b.inverse(), truth.positions_at, begins))
    flesh = flesh_of(views)
    for view in views:
        collect(view, flesh, sums)
    print(f"FLESH = {flesh}")
    print("SURFACE_SD = {")
    for kind in FLESH:
        if len(of := sums.surface[kind]) > _FEWEST:
            off = np.clip(np.abs(of), 0.0, _LARGEST_ERROR)
            sd = tuple(np.round(np.sqrt(np.mean(off**2, axis=0)), 3).tolist())
            print(f"  {kind!r}: {sd},  # {len(of)} of them; {'used' if kind in SURFACE_SD else 'not used'}")
    print("}\nEVIDENCE = {")
    for group, counts in sums.counts.items():
        ratios = tuple(np.round(log_ratios(counts), 1).tolist())
        print(f"  {group!r}: {ratios},  # {counts[1].sum():.0f} outliers")
    print("}")


if __name__ == "__main__":
    main()
