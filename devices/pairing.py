"""Puts two recorded streams on one clock, and pairs them by capture time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.frame_pairs import RecordedPairs, lone_side
from devices.sensor import DeviceError
from fusion.body import Body
from fusion.clocks import Clock, median_interval, nearest_of, with_partners
from fusion.clocks.course import find_clock_course
from fusion.clocks.search import COMPARED, FEWEST, agreement, candidates, find_clock_offset, is_better
from fusion.pair_arrays import Pairs, View
from fusion.support.large_arrays import stored

ONE_RUN_NS = 60_000_000_000
"""Two sensors whose first frames arrived at most so far apart were recorded by one run of the program."""
_BETTER, _ALIKE, _NAMED = 0.8, 1.1, 3  # of the distances of views at offsets that are named, and how many
_JUMP, _MOST_JUMPS = 2.5, 8  # frame intervals, and jumps
_CERTAIN, _FEWEST_NEW, _AS_WELL = 2.0, 12, 1.25  # standard errors, frames, and mean penalties
_ONE_CLOCK = Clock()
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
    clock: Clock = _ONE_CLOCK,
    every_frame: bool = False,
) -> Pairing:
    """Pairs the frames of two recordings by :func:`devices.frame_pairs.lone_side`, each frame once.

    A frame that falls into a gap of the other recording (it saw no one, or lost frames there) is given alone.

    Args:
        a, b: The person in all frames of each recording.
        clock: B's on A's.
        every_frame: Whether all other lone frames are given, too, but those within half an interval of an
            earlier moment. The paper's methods fuse pairs.

    Raises:
        DeviceError: A recording is empty, or the two never overlap in time.
    """
    times = a.time_ns, b.time_ns + clock.at(b.time_ns)
    frames, time_ns, skew_ns = _moments(times, every_frame)
    pairs = RecordedPairs(Pairs(body, (a, b), *stored(time_ns, skew_ns, frames)))
    frames_a, frames_b = len(a.time_ns), len(b.time_ns)
    with_a, with_b = (frames >= 0).T
    alone_a, alone_b = int((~with_b).sum()), int((~with_a).sum())
    dropped_a, dropped_b = frames_a - int(with_a.sum()), frames_b - int(with_b.sum())
    return Pairing(pairs, frames_a, frames_b, dropped_a, dropped_b, alone_a, alone_b)


def _moments(
    times: tuple[NDArray[np.int64], NDArray[np.int64]], every_frame: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Of each moment: (T, 2) the frames of A and of B, -1 for none; its time; and its skew."""
    if min(map(len, times)) == 0:
        raise DeviceError("A recording without frames cannot be paired.")
    interval_ns = min(map(_least_interval, times))
    (a, b), rows, i, j = (each.tolist() for each in times), list[tuple[int, int]](), 0, 0
    while i < len(a) and j < len(b):
        side = lone_side(b[j] - a[i], interval_ns)
        rows.append((i if side >= 0 else -1, j if side <= 0 else -1))
        i, j = i + (side >= 0), j + (side <= 0)
    rows += [(k, -1) for k in range(i, len(a))] + [(-1, k) for k in range(j, len(b))]
    frames = np.array(rows, dtype=np.int64)
    at_a, at_b = (each[of] for each, of in zip(times, frames.T, strict=True))
    paired = np.asarray((frames >= 0).all(axis=1))
    if not paired.any():
        raise DeviceError(
            f"The two recordings never overlap in time: A runs from {_span(times[0])}, B from "
            f"{_span(times[1])}. They must be of the same capture, on one clock."
        )
    time_ns = np.where(frames[:, 0] >= 0, at_a, at_b)
    kept = np.full(len(frames), every_frame) | paired
    if not every_frame:
        for side, (own, other) in enumerate((times, times[::-1])):
            kept[np.isin(frames[:, side], _in_gaps(own, other))] = True
    order = np.flatnonzero(kept)[np.argsort(time_ns[kept], kind="stable")]
    crowded, last_ns = [], int(time_ns[order[0]]) - interval_ns
    if np.diff(time_ns[order]).min(initial=interval_ns) < interval_ns // 2:
        for k, (own_ns, is_pair) in enumerate(
            zip(time_ns[order].tolist(), paired[order].tolist(), strict=True)
        ):
            if is_pair or own_ns - last_ns >= interval_ns // 2:
                last_ns = own_ns
            else:
                crowded.append(k)  # it is of a moment that is there
    order = np.delete(order, crowded)
    return frames[order], time_ns[order], np.where(paired, at_b - at_a, 0)[order]


def _in_gaps(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """The frames, by index, that lie in a gap of the other recording, and not before or after all of it."""
    apart = np.abs(others[nearest_of(times, others)] - times)
    within = (times > others[0]) & (times < others[-1])
    return np.flatnonzero(within & (apart > _GAP * median_interval(others)))


def _least_interval(times: NDArray[np.int64]) -> int:
    """The median interval of frames without one missing between them, though half are missing.

    It is the mean of two in a row, which jitter, and frames that are logged in twos, change less.
    """
    steps = (times[2:] - times[:-2]) // 2
    if not len(steps):
        return median_interval(times)
    return int(np.median(steps[steps <= _GAP * np.quantile(steps, 0.25)]))


def _span(times: NDArray[np.int64]) -> str:
    return f"{times[0] * 1e-9:.3f} s to {times[-1] * 1e-9:.3f} s"


def clock_by_motion(body: Body, a: View, b: View) -> Clock | None:
    """The offset of B's clock by the motion; None below 2/3 of a frame everywhere, or if it is not certain to
    two frames."""
    if not min(len(a.time_ns), len(b.time_ns)):
        return None
    found = find_clock_offset(body, a, b)
    interval = median_interval(a.time_ns)
    if found is None or found.sd_ns > 2.0 * interval:
        found = Clock(0.0, float("inf"))
    found = find_clock_course(a, b, found)
    most = np.abs(found.at(b.time_ns)).max()
    changes = found.rate_ppm != 0.0 or bool(found.steps)
    if most < 2 * interval / 3 or not (changes or found.significant):
        return None
    return replace(
        found, offset_ns=found.offset_ns + with_partners(a.time_ns, b.time_ns + found.at(b.time_ns))
    )


def clock_in_question(body: Body, a: View, b: View) -> str:
    """A line with the offsets that may be right, where the motion does not tell; empty where none is."""
    before, offered = candidates(body, a, b)
    limit = np.inf if np.isnan(before) else _BETTER * before
    best = [(ns, metres) for ns, metres in offered if metres < limit and metres < _ALIKE * offered[0][1]]
    if not best or (abs(best[0][0]) < median_interval(a.time_ns) and not np.isnan(before)):
        return ""
    places = " or ".join(f"{ns * 1e-9:+.2f} s ({1e3 * metres:.0f} mm)" for ns, metres in best[:_NAMED])
    instead = "" if np.isnan(before) else f", instead of {1e3 * before:.0f} mm as they are"
    return (
        f"The views agree best with B's clock at {places}{instead}; they are too short, or too alike, to be "
        f"sure: `offset_ms={best[0][0] * 1e-6:.0f}` takes the first."
    )


def jumps_closed(body: Body, a: View, b: View) -> tuple[View, View]:
    """The person in all frames of two recordings, with times that go on where one clock jumps ahead.

    A jump may be a pause, or a clock that was set. Where only one recording has it, the motion tells which.
    """
    views, jumps = [a, b], []
    for side, (view, other) in enumerate(((a, b), (b, a))):
        steps, usual = np.diff(view.time_ns), median_interval(view.time_ns)
        for k in np.flatnonzero(steps > _JUMP * usual).tolist():
            first, end = np.searchsorted(other.time_ns, view.time_ns[k : k + 2])
            if end - first > _JUMP:
                jumps.append((int(steps[k]) - usual, side, int(k) + 1))
    least = _penalties(body, a, b) if jumps else np.zeros(0)
    for longer_ns, side, k in sorted(jumps, reverse=True)[:_MOST_JUMPS]:
        tried = list(views)
        later = np.arange(len(views[side].time_ns)) >= k
        tried[side] = views[side]._replace(time_ns=views[side].time_ns - longer_ns * later)
        costs = _penalties(body, *tried)
        if _agrees(costs, least):
            views, least = tried, costs
    return views[0], views[1]


def _penalties(body: Body, a: View, b: View) -> NDArray[np.float64]:
    """Of frames, where the registered views agree best; NaN where too little is seen."""
    a, b = (view.chosen(np.flatnonzero(view.states.any(axis=1))) for view in (a, b))
    if min(len(a.time_ns), len(b.time_ns)) < FEWEST:
        return np.full(COMPARED, np.nan)
    return agreement(body, a, b)[1]


def _agrees(costs: NDArray[np.float64], before: NDArray[np.float64]) -> bool:
    """Whether views agree better than before, or in more frames as well."""
    more = int(np.isfinite(costs).sum() - np.isfinite(before).sum())
    as_well = np.nanmean(costs) < _AS_WELL * np.nanmean(before)
    return is_better(costs, before, _CERTAIN) or bool(more > _FEWEST_NEW and as_well)


def clock_by_cable(
    arrival: Clock, delay_ns: int, a_ns: NDArray[np.int64], b_ns: NDArray[np.int64]
) -> Clock | None:
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


def clock_by_arrival(a: NDArray[np.int64], b: NDArray[np.int64]) -> Clock | None:
    """B's clock on A's, from (T, 2) recorded capture and arrival times of each.

    None where the two did not arrive on one machine's clock.
    """
    if not (len(a) and len(b)) or abs(int(a[0, 1]) - int(b[0, 1])) > ONE_RUN_NS:
        return None
    on_host_a, on_host_b = (Clock.of_arrivals(*each.T) for each in (a, b))
    return on_host_b.on(on_host_a, int(b[len(b) // 2, 0]))
