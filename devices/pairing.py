"""Puts two recorded streams on one clock, and pairs them by capture time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.frame_pairs import RecordedPairs
from devices.sensor import DeviceError
from fusion.body import Body
from fusion.pair_arrays import Pairs, View
from fusion.registration.clock_course import find_clock_course
from fusion.registration.clock_offset import ClockOffset
from fusion.registration.clock_search import find_clock_offset
from fusion.support.large_arrays import stored

ONE_RUN_NS = 60_000_000_000
"""Two sensors whose first frames arrived at most so far apart were recorded by one run of the program."""
_SECOND_NS, _STEADY_SECONDS = 1_000_000_000, 10  # from so many on, arrivals show a drift
_CERTAIN = 4.0  # standard deviations of the growth of an offset that is corrected
_GAP = 1.5
"""Frame intervals: if the nearest frame of the other recording is farther away, the other recording has a
gap."""


@dataclass(frozen=True, eq=False)
class Pairing:
    """All pairs of two recordings, and the number of frames left over.

    Attributes:
        pairs: In time order; one side is None if that recording has no frame for this moment.
        frames_a, frames_b: Number of frames in each recording.
        alone_a, alone_b: Frames without a partner that are among the pairs.
        dropped_a, dropped_b: Frames left out.
    """

    pairs: RecordedPairs
    frames_a: int
    frames_b: int
    dropped_a: int
    dropped_b: int
    alone_a: int = 0
    alone_b: int = 0


def pair_views(
    body: Body,
    a: View,
    b: View,
    tolerance_ns: int | None = None,
    *,
    offset_ns: int | NDArray[np.int64] = 0,
    every_frame: bool = False,
) -> Pairing:
    """Pairs each frame of A with the nearest of B in time, each frame once.

    Two frames are a pair when each is the other's nearest and they lie within the tolerance. A frame that
    falls into a gap of the other recording (it saw no one, or lost frames there) is given alone.

    Args:
        a, b: The person in all frames of each recording.
        tolerance_ns: Half the slower stream's median frame interval if None.
        offset_ns: Added to the times of B, one or (T,), so that both are on A's clock.
        every_frame: Whether all other frames are also given alone: those without a partner because one
            sensor is faster, and those before or after the other recording. Otherwise they are left out,
            because the paper's methods fuse pairs.

    Raises:
        DeviceError: A recording is empty, or the two never overlap in time.
    """
    moments = _moments(a.time_ns, b.time_ns + offset_ns, tolerance_ns, every_frame)
    pairs = RecordedPairs(Pairs(body, (a, b), *stored(moments[:, 0], moments[:, 1], moments[:, 2:])))
    frames_a, frames_b = len(a.time_ns), len(b.time_ns)
    with_a, with_b = (moments[:, 2:] >= 0).T
    alone_a, alone_b = int((~with_b).sum()), int((~with_a).sum())
    dropped_a, dropped_b = frames_a - int(with_a.sum()), frames_b - int(with_b.sum())
    return Pairing(pairs, frames_a, frames_b, dropped_a, dropped_b, alone_a, alone_b)


def _moments(
    time_a: NDArray[np.int64], time_b: NDArray[np.int64], tolerance_ns: int | None, every_frame: bool
) -> NDArray[np.int64]:
    """(T, 4) time, skew, frame of A, frame of B of each pair; -1 for no frame."""
    if len(time_a) == 0 or len(time_b) == 0:
        raise DeviceError("A recording without frames cannot be paired.")
    if tolerance_ns is None:
        tolerance_ns = max(median_interval(time_a), median_interval(time_b)) // 2
    nearest_b = nearest_of(time_a, time_b)
    mutual = nearest_of(time_b, time_a)[nearest_b] == np.arange(len(time_a))
    skew = time_b[nearest_b] - time_a
    chosen = np.flatnonzero(mutual & (np.abs(skew) <= tolerance_ns))
    if len(chosen) == 0:
        raise DeviceError(
            f"The two recordings never overlap in time: A runs from {_span(time_a)}, B from {_span(time_b)}. "
            "They must be of the same capture, on one clock."
        )
    alone_a, alone_b = (
        _without(len(times), paired) if every_frame else np.setdiff1d(_in_gaps(times, others), paired)
        for times, others, paired in ((time_a, time_b, chosen), (time_b, time_a, nearest_b[chosen]))
    )
    moments = np.concatenate(
        [
            np.stack([time_a[chosen], skew[chosen], chosen, nearest_b[chosen]], axis=1),
            np.stack([time_a[alone_a], 0 * alone_a, alone_a, 0 * alone_a - 1], axis=1),
            np.stack([time_b[alone_b], 0 * alone_b, 0 * alone_b - 1, alone_b], axis=1),
        ]
    )
    return moments[np.argsort(moments[:, 0], kind="stable")]


def _without(count: int, some: NDArray[np.int64]) -> NDArray[np.int64]:
    """The other numbers below a count."""
    others = np.ones(count, dtype=np.bool_)
    others[some] = False
    return np.flatnonzero(others)


def _in_gaps(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """The frames, by index, that lie in a gap of the other recording, and not before or after all of it."""
    apart = np.abs(others[nearest_of(times, others)] - times)
    within = (times > others[0]) & (times < others[-1])
    return np.flatnonzero(within & (apart > _GAP * median_interval(others)))


def nearest_of(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each time the index of the nearest of the others, the earlier where two are as near."""
    after = np.minimum(np.searchsorted(others, times), len(others) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(others[before] - times) <= np.abs(others[after] - times), before, after)


def median_interval(times: NDArray[np.int64]) -> int:
    """Nanoseconds between two frames; a thirtieth of a second for a single frame."""
    return int(np.median(np.diff(times))) if len(times) > 1 else 33_000_000


def _span(times: NDArray[np.int64]) -> str:
    return f"{times[0] * 1e-9:.3f} s to {times[-1] * 1e-9:.3f} s"


def clock_by_motion(body: Body, a: View, b: View) -> ClockOffset | None:
    """The offset of B's clock by the motion; None below 2/3 of a frame or with a deviation above two frames.

    It may be that large in a part of the recording only, where it grows or changes in steps.
    """
    if not min(len(a.time_ns), len(b.time_ns)):
        return None
    found = find_clock_offset(body, a, b)
    interval = median_interval(a.time_ns)
    if found is None or found.sd_ns > 2.0 * interval:
        found = ClockOffset(0.0, float("inf"))
    found = find_clock_course(a, b, found)
    if not abs(found.skew_ppm) > _CERTAIN * found.skew_sd_ppm:
        found = replace(found, skew_ppm=0.0)
    most = np.abs(found.at(b.time_ns)).max()
    changes = found.skew_ppm != 0.0 or bool(found.steps)
    return found if most >= 2 * interval / 3 and (changes or found.significant) else None


def clock_by_cable(
    arrival: ClockOffset, delay_ns: int, a_ns: NDArray[np.int64], b_ns: NDArray[np.int64]
) -> ClockOffset | None:
    """The offset, nearest to that by arrival times, at which B captures the cable's delay after A.

    None if it is within two frames of none: the master has then set the subordinate's clock.
    """
    if np.abs(arrival.at(b_ns)).max() < 2 * median_interval(a_ns):
        return None
    on_a = b_ns + arrival.at(b_ns) - delay_ns
    after = np.clip(np.searchsorted(a_ns, on_a), 1, max(1, len(a_ns) - 1))
    around = on_a[:, None] - a_ns[np.minimum(np.stack([after - 1, after], axis=1), len(a_ns) - 1)]
    off_ns = np.median(around[np.arange(len(around)), np.abs(around).argmin(axis=1)])
    return replace(arrival, offset_ns=arrival.offset_ns - float(off_ns))


def offset_by_arrival(a: NDArray[np.int64], b: NDArray[np.int64]) -> ClockOffset | None:
    """What to add to B's times so that they are on A's clock, from (T, 2) recorded capture and arrival times.

    As :class:`devices.capture.clock.host_clock.HostClock`, over the whole recording: least delays, with a
    drift from ten seconds on. None where the two did not arrive on one machine's clock.
    """
    if not (len(a) and len(b)) or abs(int(a[0, 1]) - int(b[0, 1])) > ONE_RUN_NS:
        return None
    fits = []
    for arrivals in (a, b):
        times, delays = arrivals[:, 0], (arrivals[:, 1] - arrivals[:, 0]).astype(np.float64)
        firsts = np.flatnonzero(np.diff((times - times[0]) // _SECOND_NS, prepend=-1))
        least = np.minimum.reduceat(delays, firsts)
        seconds = (times[firsts] - times[0]) * 1e-9
        slope = 0.0
        if len(firsts) >= _STEADY_SECONDS:
            i, j = np.triu_indices(len(firsts), 1)
            slope = float(np.median((least[j] - least[i]) / (seconds[j] - seconds[i])))  # ns per second
        residual = delays - slope * (times - times[0]) * 1e-9
        fits.append((int(times[0]), float(residual.min()), slope, float(np.std(least - slope * seconds))))
    (start_a, delay_a, slope_a, sd_a), (start_b, delay_b, slope_b, sd_b) = fits
    middle_ns = int(b[len(b) // 2, 0])
    host_ns = middle_ns + delay_b + slope_b * (middle_ns - start_b) * 1e-9
    on_a_ns = start_a + (host_ns - delay_a - start_a) / (1.0 + slope_a * 1e-9)
    skew_ppm = 1e-3 * (slope_b - slope_a)
    return ClockOffset(on_a_ns - middle_ns, float(np.hypot(sd_a, sd_b)), skew_ppm, middle_ns=middle_ns)
