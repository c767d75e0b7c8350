"""What a session gives over time, under the names of the method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SkeletonSeries:
    """S_A or S_B over T frames of J joints, as the sensor gave it.

    Attributes:
        positions: (T, J, 3) float32 metres in the sensor's own frame; NaN where there is no skeleton.
        states: (T, J) uint8, 0 not tracked, 1 inferred, 2 tracked.
        weights: (T, J) float32, w of eq. (11).
        captured_ns: (T,) the sensor's own time; :data:`recordings.layout.NO_FRAME` where it gave no frame.
        stale: (T,) whether the sensor repeated its last skeleton.
    """

    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
    weights: NDArray[np.float32]
    captured_ns: NDArray[np.int64]
    stale: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class QualitySeries:
    """How good each of T frames is.

    Attributes:
        bone_error: (T,) metres, the largest difference of a bone of S* from its length; NaN without S*.
        disagreement: (T,) metres between p and R q + t, the median joint; NaN where none is in both.
        skew_ns: (T,) capture time of B less that of A.
        fuse_ms: (T,) what the fusion took.
        iterations: (T,) of the solver.
        predicted: (T, J) whether a joint of S* has no data.
    """

    bone_error: NDArray[np.float64]
    disagreement: NDArray[np.float64]
    skew_ns: NDArray[np.int64]
    fuse_ms: NDArray[np.float64]
    iterations: NDArray[np.int64]
    predicted: NDArray[np.bool_]
