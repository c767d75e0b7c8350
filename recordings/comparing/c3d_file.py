"""Reads a .c3d in a process of its own, because ezc3d crashes at damaged files, or never ends."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.check import extra_command
from devices.recorded.apart import ApartError, items_of
from recordings.errors import RecordingError

_SECONDS, _BYTES_PER_S = 20.0, 2e6
_MEMORY, _BYTES_PER_BYTE = 2 << 30, 40


def read_c3d(path: Path) -> dict[str, NDArray[Any]]:
    """``labels``, ``rate``, ``points`` (N, M, 3) and ``residuals`` (N, M) of a regular file.

    Raises:
        RecordingError: ezc3d is not installed, or cannot read the file.
    """
    if importlib.util.find_spec("ezc3d") is None:
        raise RecordingError(f"Reading .c3d needs the package ezc3d: {extra_command('export')}.")
    size = path.stat().st_size
    seconds, memory = _SECONDS + size / _BYTES_PER_S, _MEMORY + _BYTES_PER_BYTE * size
    try:
        (read,) = items_of(content, path.absolute(), seconds=seconds, memory=memory)
    except ApartError as fault:
        raise RecordingError(f"{path} is not a .c3d that ezc3d can read: {fault}.") from None
    return dict(read)


def content(path: Path) -> Iterator[dict[str, NDArray[Any]]]:
    """What :func:`read_c3d` returns."""
    import ezc3d

    try:
        read = ezc3d.c3d(str(path))
        parameters, data = read["parameters"]["POINT"], read["data"]
        labels = [label for name in sorted(parameters) if name.startswith("LABELS")
                  for label in parameters[name]["value"]]  # fmt: skip
        yield {
            "labels": np.array(labels, dtype=str),
            "rate": np.array(float(parameters["RATE"]["value"][0])),
            "points": data["points"][:3].transpose(2, 1, 0).astype(np.float64),
            "residuals": data["meta_points"]["residuals"][0].T,
        }
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise ApartError(str(error)) from None
