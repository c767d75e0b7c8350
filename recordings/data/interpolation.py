"""S* between the moments of a session, with bones as long as in its frames."""

from datetime import timedelta

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.support.types import Array
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError

Ints = NDArray[np.int64]
_DAY_NS, _NEVER_NS = 8.64e13, -9.0e18
_SAME_M = 1e-5  # lengths that differ by rounding
_LONGEST = 0.3  # seconds: S* is not interpolated across a longer interval


def positions_at(rows: SessionArrays, time_ns: Ints, longest: float = _LONGEST) -> Array:
    """S* at (N,) times since the first pair, ns, from the frames before and after.

    The root moves in a straight line. Each bone turns at a constant rate about the axis across both of its
    directions (spherical linear interpolation). Its length is the one that both frames were fused with; with
    method ``published``, whose bones are nearly right, it changes from that of one frame to that of the next.
    Where a new calibration changes the lengths, it is that of the frame before.

    Args:
        longest: Seconds between frames that are interpolated at most.

    Returns:
        (N, J, 3) metres in K_A's frame; the recorded S* at the times of frames. NaN before the first and
        after the last frame, in longer intervals, and where a frame has no S*.
    """
    times, fused, body = rows.time_ns, rows.fused, rows.body
    if len(times) == 0:
        return np.full((len(time_ns), len(body), 3), np.nan)
    before, after, seconds, share = _neighbours(times, time_ns)
    start, end = fused[before], fused[after]
    first, last = (_bone_lengths(rows, at) for at in (before, after))
    same = rows.bone_lengths[before] == rows.bone_lengths[after]
    lengths = first + share[:, None] * np.where(same, last - first, 0.0)
    found = np.empty((len(time_ns), len(body), 3))
    found[:, body.root] = start[:, body.root] + share[:, None] * (end[:, body.root] - start[:, body.root])
    for joint in body.order[1:]:
        parent = body.parents[joint]
        direction = _between(start[:, joint] - start[:, parent], end[:, joint] - end[:, parent], share)
        found[:, joint] = found[:, parent] + lengths[:, joint, None] * direction
    exact = share == 0.0
    found[exact] = start[exact]
    outside = (time_ns < times[0]) | (time_ns > times[-1]) | (~exact & (seconds > longest))
    found[outside] = np.nan
    return found


def sigma_at(rows: SessionArrays, time_ns: Ints) -> Array:
    """Uncertainty of :func:`positions_at`: that of the frames, and what the motion between them adds.

    Between two frames Δ apart, an acceleration a moves a joint by a Δ² s (1 − s) / 2 off the straight line at
    the share s of the interval. a is taken from the velocities of S* before and after the interval.

    Returns:
        (N, J) metres, one standard deviation of a joint's distance to the truth; NaN where there is no S*,
        and with the paper's methods.
    """
    found = np.full((len(time_ns), len(rows.body)), np.nan)
    if rows.sigma is None or len(rows) == 0:
        return found
    before, after, seconds, share = _neighbours(rows.time_ns, time_ns)
    s, last = share[:, None], max(len(rows) - 2, 0)
    earlier, later = np.maximum(before - 1, 0), np.minimum(after, last)
    (first, first_s), (second, second_s) = (_velocity(rows, start) for start in (earlier, later))
    change, elapsed = np.linalg.norm(second - first, axis=2), second_s - first_s
    off = 0.5 * change / np.maximum(elapsed, 1e-3)[:, None] * (seconds**2)[:, None] * s * (1.0 - s)
    squared = np.asarray(rows.sigma, dtype=np.float64) ** 2
    known = np.isfinite(positions_at(rows, time_ns))[..., 0]
    of_next = np.where(s > 0.0, s * squared[after], 0.0)  # at a frame, the next one does not matter
    variance = (1.0 - s) * squared[before] + of_next + np.nan_to_num(off) ** 2
    found[known] = np.sqrt(variance[known])
    return found


def _bone_lengths(rows: SessionArrays, frames: Ints) -> Array:
    """(N, J) metres, the bones of S*: the lengths that they were fused with, or their own if they differ."""
    wanted = rows.bone_lengths[frames]
    own = bone_lengths_of(rows.body, rows.fused[frames])
    return np.where(np.abs(own - wanted) > _SAME_M, own, wanted)


def nanoseconds(rows: SessionArrays, time: ArrayLike | timedelta) -> Ints:
    """(N,) nanoseconds since the first frame; times that are NaN become one before every session.

    Args:
        time: One or (N,) seconds, or durations of numpy, pandas or ``datetime``.

    Raises:
        RecordingError: They are neither, have more than one dimension, or are a day or more from the session.
    """
    given = np.asarray(time)
    if given.dtype.kind == "O" and all(isinstance(each, timedelta) for each in given.ravel()):
        given = given.astype("timedelta64[ns]")
    if given.dtype.kind == "m":
        wanted = np.where(np.isnat(given), np.nan, given / np.timedelta64(1, "ns"))
    elif given.dtype.kind in "iuf":
        with np.errstate(over="ignore"):
            wanted = np.rint(1e9 * given.astype(np.float64))
    else:
        raise RecordingError(f"Times are seconds since the first frame; got an array of {given.dtype}.")
    if wanted.ndim > 1:
        raise RecordingError(f"Times are one number or (N,) seconds; got an array of {given.shape}.")
    beyond = wanted[(wanted < -_DAY_NS) | (wanted > rows.time_ns[-1] + _DAY_NS)]
    for far in beyond.ravel()[:1]:
        raise RecordingError(
            f"Times are seconds since the first frame; {1e-9 * far:g} s is days away from a session of "
            f"{1e-9 * rows.time_ns[-1]:.3g} s. Nanoseconds are np.timedelta64(…, 'ns')."
        )
    return np.atleast_1d(np.where(np.isnan(wanted), _NEVER_NS, wanted)).astype(np.int64)


def _velocity(rows: SessionArrays, start: Ints) -> tuple[Array, Array]:
    """(N, J, 3) m/s of S* from these frames to the next ones, and (N,) the middles of the intervals, s."""
    end = np.minimum(start + 1, len(rows) - 1)
    seconds = 1e-9 * np.maximum(rows.time_ns[end] - rows.time_ns[start], 1)
    velocity = (rows.fused[end] - rows.fused[start]) / seconds[:, None, None]
    return np.asarray(velocity), np.asarray(0.5e-9 * (rows.time_ns[end] + rows.time_ns[start]))


def _neighbours(times: Ints, wanted: Ints) -> tuple[Ints, Ints, Array, Array]:
    """The frames before and after, the seconds between them, and the share of it that has passed."""
    before: Ints = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, len(times) - 1)
    after: Ints = np.minimum(before + 1, len(times) - 1)
    step = times[after] - times[before]
    return before, after, np.asarray(1e-9 * step), (wanted - times[before]) / np.maximum(step, 1)


def _between(start: Array, end: Array, share: Array) -> Array:
    """(N, 3) unit vectors from the direction of ``start`` to that of ``end``."""
    u, v = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (start, end))
    angle = np.arccos(np.clip(np.sum(u * v, axis=1), -1.0, 1.0))[:, None]
    sine = np.sin(angle)
    small = sine < 1e-6  # (almost) parallel, where straight and spherical interpolation agree
    divisor = np.where(small, 1.0, sine)
    of_u = np.where(small, 1.0 - share[:, None], np.sin((1.0 - share[:, None]) * angle) / divisor)
    of_v = np.where(small, share[:, None], np.sin(share[:, None] * angle) / divisor)
    mixed = of_u * u + of_v * v
    size = np.linalg.norm(mixed, axis=1, keepdims=True)
    # half-way between opposite directions the mean is zero: take the first
    return np.asarray(np.where(size > 1e-9, mixed / np.maximum(size, 1e-9), u))
