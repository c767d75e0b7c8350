"""Frames of two recordings that are nearest in time, and the rhythm by which they belong together."""

import numpy as np
from numpy.typing import NDArray

_NEIGHBOURS, _RHYTHM = 2, 0.25  # frames, and the scatter of their skews compared with others
_EVEN = 0.25  # of an interval: the scatter of frames at even intervals
_COUNTED, _ENOUGH = 3000, 0.995  # frames, and their share


def nearest_of(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each time the index of the nearest of the others, the earlier where two are as near."""
    after = np.minimum(np.searchsorted(others, times), len(others) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(others[before] - times) <= np.abs(others[after] - times), before, after)


def median_interval(times: NDArray[np.int64]) -> int:
    """Nanoseconds between two frames; a thirtieth of a second for a single frame."""
    return int(np.median(np.diff(times))) if len(times) > 1 else 33_000_000


def rhythm(a_ns: NDArray[np.int64], b_ns: NDArray[np.int64]) -> tuple[float, bool]:
    """How much later B's frames are than those of A that belong to them, and whether that tells them apart.

    Both have one rhythm where one computer took their frames in turns. Frames at even intervals tell the same
    but for whole intervals. NaN where neither is so.
    """
    nearest = nearest_of(b_ns, a_ns)
    skews = [
        b_ns - a_ns[np.clip(nearest + k, 0, len(a_ns) - 1)] for k in range(-_NEIGHBOURS, _NEIGHBOURS + 1)
    ]
    middles = [float(np.median(skew)) for skew in skews]
    scatter = [float(np.median(np.abs(skew - middle))) for skew, middle in zip(skews, middles, strict=True)]
    first, second = np.argsort(scatter, kind="stable")[:2].tolist()
    even = scatter[first] < _EVEN * median_interval(a_ns)
    return middles[first] if even else float("nan"), scatter[first] < _RHYTHM * scatter[second]


def with_partners(a_ns: NDArray[np.int64], b_ns: NDArray[np.int64]) -> float:
    """What to add to B's times, up to some frames' certainty right, so that its frames have partners.

    A common rhythm tells it. Else it is the least with which hardly a frame loses its partner.
    """
    skew, known = rhythm(a_ns, b_ns)
    if known:
        return -skew
    interval = median_interval(a_ns)
    some = slice(max(len(b_ns) - _COUNTED, 0) // 2, None)
    b_ns = b_ns[some][:_COUNTED]
    shifts = interval // 16 * np.arange(-8, 9)
    counts = []
    for shift in shifts.tolist():
        near = nearest_of(b_ns + shift, a_ns)
        paired = np.abs(a_ns[near] - b_ns - shift) <= interval // 2
        counts.append(len(np.unique(near[paired])))
    enough = shifts[np.array(counts) >= _ENOUGH * max(counts)]
    return float(min(enough, key=abs))
