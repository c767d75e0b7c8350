"""Time series of a session, named as in the method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SkeletonSeries:
    """S_A or S_B over T frames of J joints, as given by the sensor.

    Attributes:
        positions: (T, J, 3) float32 metres in the sensor's own frame; NaN without a skeleton.
        states: (T, J) uint8, 0 not tracked, 1 inferred, 2 tracked.
        weights: (T, J) float32, w of eq. (11).
        captured_ns: (T,) time on the sensor's clock; :data:`recordings.layout.NO_FRAME` if it gave no frame.
        stale: (T,) whether the sensor repeated its last skeleton.
    """

    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
    weights: NDArray[np.float32]
    captured_ns: NDArray[np.int64]
    stale: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class QualitySeries:
    """Quality figures of T frames.

    Attributes:
        bone_error: (T,) largest absolute error of a bone length of S*, metres; NaN without S*.
        disagreement: (T,) median distance between p and R q + t, metres; NaN if no joint is in both views.
        skew_ns: (T,) capture time of B minus capture time of A.
        fuse_ms: (T,) duration of the fusion, milliseconds.
        iterations: (T,) iterations of the solver.
        predicted: (T, J) whether a joint of S* has no data.
    """

    bone_error: NDArray[np.float64]
    disagreement: NDArray[np.float64]
    skew_ns: NDArray[np.int64]
    fuse_ms: NDArray[np.float64]
    iterations: NDArray[np.int64]
    predicted: NDArray[np.bool_]
