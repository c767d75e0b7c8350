"""One registration for a whole recording, from the person's movement, for the baselines.

It uses later frames and is therefore not a live method. A comparison with baselines under a poor registration
would favour every other method.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.errors import CalibrationError
from fusion.rigid import RigidTransform

_STEPS = 12
_TUNING = 1.4826  # times the median distance: a larger residual counts less than a quarter


def fit_recording(p: NDArray[np.float64], q: NDArray[np.float64]) -> RigidTransform:
    """The robust rigid fit ``a_from_b`` of one view's joints to the other's.

    Iteratively re-weighted least squares (Geman–McClure weights 1 / (1 + (r / s)²)² with s from the median
    residual) over all joints of all frames with equal weight.

    Args:
        p, q: (…, 3) the same joints in K_A's and in K_B's frame, metres; NaN where unknown.

    Raises:
        CalibrationError: Fewer than three joints are known in both.
    """
    both = np.isfinite(p).all(axis=-1) & np.isfinite(q).all(axis=-1)
    target, source = p[both], q[both]
    if len(target) < 3:
        raise CalibrationError(f"A rigid fit needs at least 3 points; there are {len(target)}.")
    weights = np.ones(len(target))
    fit = RigidTransform.identity()
    for _ in range(_STEPS):
        fit = _weighted_fit(target, source, weights)
        residuals = np.linalg.norm(target - fit.apply(source), axis=1)
        scale = max(_TUNING * float(np.median(residuals)), 1e-9)
        weights = 1.0 / (1.0 + (residuals / scale) ** 2) ** 2
    return fit


def _weighted_fit(
    target: NDArray[np.float64], source: NDArray[np.float64], weights: NDArray[np.float64]
) -> RigidTransform:
    """Kabsch's fit with one weight per point."""
    share = weights / weights.sum()
    centre_t, centre_s = share @ target, share @ source
    U, _, Vt = np.linalg.svd((target - centre_t).T @ ((source - centre_s) * share[:, None]))
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    R = U @ Vt
    return RigidTransform.of(R, centre_t - R @ centre_s)
