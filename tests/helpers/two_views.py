"""A person of known truth and two sensors of known place."""

import numpy as np
from scipy.spatial.transform import Rotation

from fusion.calibration.calibration import Calibration, calibrate
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair

FRAME_NS = 33_333_333

A_FROM_B = RigidTransform.of(Rotation.from_euler("yx", [-85, 4], degrees=True).as_matrix(), [2.4, 0.1, 2.6])
"""K_B about 90° to K_A's right, slightly tilted."""


def calibration_of(body):
    """The true placement and the true bone lengths."""
    return Calibration(body, A_FROM_B, body.nominal_lengths, "known truth")


def turned_around(angle):
    """K_B turned by so many degrees round a person 2.6 m before both sensors."""
    rotation = Rotation.from_euler("y", -angle, degrees=True).as_matrix()
    person = np.array([0.0, 0.0, 2.6])
    return RigidTransform.of(rotation, person - rotation @ person)


def calibrated_on(body, a_from_b=A_FROM_B):
    """The calibration on a second of the start-up pose."""
    pairs = [pair_of(body, standing(body), k * FRAME_NS, a_from_b) for k in range(30)]
    return calibrate(body, pairs, "start-up pose")


def standing(body, lengths=None, arms_out=50.0, legs_out=14.0):
    """(J, 3) a person 2.6 m before K_A, turned 45° to both sensors, arms and legs apart."""
    lengths = body.nominal_lengths if lengths is None else lengths
    joints = np.zeros((len(body), 3))
    for joint in body.order[1:]:
        direction = body.rest[joint]
        bone = body.bones[joint]
        angle = 0.0
        if bone.startswith(("upper_arm", "forearm", "hand", "fingers")):
            angle = arms_out
        elif bone.startswith(("thigh", "shin")):
            angle = legs_out
        side = -1.0 if bone.endswith("left") else 1.0
        turned = Rotation.from_euler("z", side * angle, degrees=True).apply(direction.copy())
        joints[joint] = joints[body.parents[joint]] + lengths[joint] * turned
    return Rotation.from_euler("y", 45.0, degrees=True).apply(joints) + np.array([0.1, 0.05, 2.6])


def pair_of(body, truth, time_ns=0, a_from_b=A_FROM_B):
    """Both sensors' flawless view of (J, 3) joints given in K_A's frame."""
    return SkeletonPair(
        Skeleton.of(body, truth, None, time_ns),
        Skeleton.of(body, a_from_b.inverse().apply(truth), None, time_ns),
        time_ns,
    )


def noisy(pair, rng, sd):
    """The pair with Gaussian noise of `sd` metres on each axis."""

    def shaken(skeleton):
        if skeleton is None:
            return None
        moved = skeleton.positions + rng.normal(0.0, sd, skeleton.positions.shape)
        return Skeleton.of(skeleton.body, moved, skeleton.states, skeleton.time_ns)

    return SkeletonPair(shaken(pair.a), shaken(pair.b), pair.time_ns)


def moving(body, frames, seed=0):
    """(T, J, 3) a person who stands for 1.5 s, then turns, shifts and waves; bones exact."""
    rng = np.random.default_rng(seed)
    still = standing(body)
    axes = rng.normal(size=(len(body), 3)) * 0.5
    phase = rng.uniform(0.0, 2.0 * np.pi, len(body))
    out = np.empty((frames, len(body), 3))
    for t in range(frames):
        moved = max(0.0, t * FRAME_NS * 1e-9 - 1.5)
        swing = np.sin(2.0 * moved + phase) - np.sin(phase)
        turns = Rotation.from_rotvec(axes * swing[:, None])
        out[t] = still + 1e-5 * (t % 2)  # what is repeated to the bit is nobody
        for joint in body.order[1:]:
            parent = body.parents[joint]
            out[t, joint] = out[t, parent] + turns[int(joint)].apply(still[joint] - still[parent])
        out[t] += 0.2 * np.array([np.sin(0.7 * moved), 0.0, 1.0 - np.cos(0.9 * moved)])
    return out
