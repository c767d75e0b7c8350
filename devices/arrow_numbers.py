"""Arrow's columns as arrays, without its own way there, which imports pandas wherever that is installed."""

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def numbers_of(column: pa.Array | pa.ChunkedArray) -> NDArray[Any]:
    """(N,) numbers or booleans; read-only where Arrow's memory is used.

    A column with gaps becomes floats with NaN, and objects with None if it has booleans.
    """
    if column.null_count:
        return np.asarray(column.to_numpy(zero_copy_only=False))
    if pa.types.is_boolean(column.type):
        return numbers_of(column.cast(pa.uint8())).view(np.bool_)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    return np.asarray(np.from_dlpack(column))
