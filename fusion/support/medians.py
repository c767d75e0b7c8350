"""The median of what is known of an array, without the masked arrays of ``np.nanmedian``, which are slow."""

import numpy as np
from numpy.typing import NDArray


def median_of_known(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, …) medians over the second axis of (N, M, …), without NaN; NaN where all are NaN."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    known = np.count_nonzero(~np.isnan(ordered), axis=1, keepdims=True)
    low = np.take_along_axis(ordered, (known - 1) // 2, axis=1)
    high = np.take_along_axis(ordered, known // 2, axis=1)
    return np.asarray((low + high) / 2.0, dtype=np.float64)[:, 0]
