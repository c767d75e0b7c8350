"""Baselines: simpler ways to fuse two skeletons, on the same input.

Each takes both views of T frames in K_A's frame and gives (T, J, 3). None uses bone lengths. A joint
without a position keeps its last one, as in an application. How S_B is registered is the
caller's choice; see :mod:`fusion.registration.rigid_fit`.
"""

import numpy as np
from numpy.typing import NDArray

from fusion.skeleton import TrackingState

Array = NDArray[np.float64]


def alone(positions):
    """One sensor alone: its joints as reported; a missing joint keeps its last position.

    Args:
        positions: (T, J, 3) metres; NaN where not tracked.
    """
    held = np.array(positions)
    for t in range(1, len(held)):
        missing = np.isnan(held[t, :, 0])
        held[t, missing] = held[t - 1, missing]
    return held


def mean(a, b):
    """½(p + q'), or the one view that has the joint."""
    seen_a, seen_b = np.isfinite(a), np.isfinite(b)
    count = seen_a.astype(np.float64) + seen_b
    total = np.where(seen_a, a, 0.0) + np.where(seen_b, b, 0.0)
    return alone(np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan))


def tracked_wins(a, b, states_a, states_b):
    """The view that tracks a joint that the other only infers; the mean if both states are equal."""
    better_a = (states_a > states_b)[..., None]
    better_b = (states_b > states_a)[..., None]
    return alone(np.where(better_a, a, np.where(better_b, b, mean(a, b))))


def kalman(
    a, b, states_a, states_b, frame_seconds, *, tracked_sd=0.02, inferred_sd=0.08, acceleration_sd=8.0
):
    """One constant-velocity Kalman filter per joint; the tracking state sets the measurement noise.

    The usual choice for several Kinects (OpenPTrack and others). The axes are independent and share their
    variances, so one 2 × 2 covariance per joint holds for all three.

    Args:
        a, b: (T, J, 3) metres, K_A's frame; NaN where not tracked.
        states_a, states_b: (T, J) tracking states.
        frame_seconds: Between two frames.
        tracked_sd, inferred_sd: Metres, standard deviation of a measurement along one axis.
        acceleration_sd: m/s², of the white acceleration that moves a joint.
    """
    dt = frame_seconds
    F = np.array([[1.0, dt], [0.0, 1.0]])
    Q = acceleration_sd**2 * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
    joints = a.shape[1]
    x = np.zeros((joints, 2, 3))  # position and velocity
    P = np.tile(np.diag([1e6, 1e2]), (joints, 1, 1))
    out = np.empty_like(a)
    for t in range(len(a)):
        x = np.einsum("rs,jsc->jrc", F, x)
        P = F @ P @ F.T + Q
        for z, states in ((a[t], states_a[t]), (b[t], states_b[t])):
            seen = np.isfinite(z[:, 0])
            noise = np.where(states == TrackingState.TRACKED, tracked_sd, inferred_sd) ** 2
            gain = np.where(seen[:, None], P[:, :, 0] / (P[:, 0, 0] + noise)[:, None], 0.0)  # (J, 2)
            x = x + gain[:, :, None] * (np.where(seen[:, None], z, 0.0) - x[:, 0])[:, None, :]
            P = P - gain[:, :, None] * P[:, None, 0, :]
        out[t] = x[:, 0]
    return out


def oracle(a, b, truth):
    """The better view of every joint in every frame, chosen with the truth: a bound, not a method.

    No choice between the two views can be better; a fusion of them can.

    Args:
        a, b: (T, J, 3) metres, K_A's frame; NaN where not tracked.
        truth: (T, J, 3) where the joints are.
    """
    a, b = alone(a), alone(b)
    off_a, off_b = (np.nan_to_num(np.linalg.norm(at - truth, axis=2), nan=np.inf) for at in (a, b))  # (T, J)
    return np.where((off_a <= off_b)[..., None], a, b)
