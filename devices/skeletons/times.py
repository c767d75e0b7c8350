"""Capture times as files have them: their unit by the interval of frames, clocks set anew, times of text."""

import math
import re
from contextlib import suppress
from datetime import UTC, datetime, time, timedelta
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError

TIME_COLUMNS = MappingProxyType(
    {
        "time_us": (1.0, "microseconds"),
        "time_ms": (1e3, "milliseconds"),
        "time_s": (1e6, "seconds"),
        "time_ns": (1e-3, "nanoseconds"),
        "time_ticks": (0.1, "ticks of 100 ns"),
        "time": (1.0, "microseconds"),
    }
)
"""Microseconds per unit, and the unit's name, by the name of a column of times; ``time`` names no unit."""
FRAME_NUMBERS = "frame"
"""The name of a column that counts frames."""
_FRAME_US = 1e6 / 30.0
_LATEST_US = 9 * 10**15
"""Largest time, so that nanoseconds fit into 64 bits."""
FEWEST = 15
"""Frames: a person can be seen as standing still for fewer."""
LOGGED_TWICE = 0.2  # of the frames: more are no accident, as where a program logs faster than its tracker
_TRACKER_US, _ANY_US = (8_000.0, 205_000.0), (2_000.0, 5_000_000.0)
"""Body trackers give 5 to 120 frames per second; with a tolerance. Beyond, and what no recording has."""
_RATES, _RATE_WITHIN = (5.0, 15.0, 30.0, 60.0, 90.0), 0.02
_OWN, _NO_TRACKER, _CLEAR = 4.0, 5.0, 3.5
"""Log priors of the unit that the column names, and against a rate of no tracker; and what is clear."""
_LONGEST_NS = timedelta(hours=1) // timedelta(microseconds=1) * 1000  # a longer jump is no pause
_PAUSE = 8  # usual intervals: frames after it may be of another clock
_EVEN = 0.6  # of an interval: two runs that are sorted together have frames as near as half of one
_CLOCK = re.compile(
    r"(?:^|[ T])(?:(\d+)\.)?(\d+):(\d\d):(\d\d(?:[.,:]\d*)?)\s*(?:([AaPp])[Mm])?"
    r"(?:Z|[+-]\d\d:?\d\d)?$"
)


class CaptureTimes(NamedTuple):
    """The times of a file.

    Attributes:
        time_ns: Nanoseconds, in the file's order.
        clock: How they are read, in words, if otherwise than the column says.
        told: Lines for the user.
        sets: The times of the first frames after the clock was set.
    """

    time_ns: NDArray[np.int64]
    clock: str
    told: list[str]
    sets: list[int]


def capture_times(
    name: object,
    column: str,
    times: NDArray[Any],
    shortest_us: float = _TRACKER_US[0],
    called: str = "",
    telling: NDArray[Any] | None = None,
    key: NDArray[Any] | None = None,
    anonymous: bool = False,
) -> CaptureTimes:
    """The times of a file.

    Args:
        column: A name of :data:`TIME_COLUMNS`, or :data:`FRAME_NUMBERS`.
        times: (N,) as the file has them, of rows or of frames.
        shortest_us: Interval of frames that is not unusual.
        called: The column's name in the file, if another.
        telling: (T,) those by which the unit is found, different and ascending. None: all.
        key: (N,) which joint of which person a row is of. None: rows are frames.
        anonymous: Whether people have no ids: times that begin again may be another one's.

    Raises:
        DeviceError: The interval is no body tracker's in any unit, or nanoseconds exceed 64 bits.
    """
    telling = np.unique(times) if telling is None else telling
    us, clock, told = find_time_unit(name, column, telling, shortest_us, called)
    if times.min() * us >= _LATEST_US:  # since the year 1 or 1601: whole spans of 285 years go
        times = times - times.dtype.type(times.min() * us // _LATEST_US * _LATEST_US / us)
    if max(float(times.max()), -float(times.min())) * us >= _LATEST_US:
        raise DeviceError(f"{name}: {called or column} goes beyond {_LATEST_US} microseconds.")
    if times.dtype == np.int64 and (ns := round(1000.0 * us)) == 1000.0 * us:
        time_ns = times * ns
    else:
        time_ns = np.rint(times * us).astype(np.int64) * 1000
    time_ns, about_clock, sets = _going_on(name, time_ns, key, anonymous)
    return CaptureTimes(time_ns, clock, told + about_clock, sets)


def find_time_unit(
    name: object, column: str, times: NDArray[Any], shortest_us: float = _TRACKER_US[0], called: str = ""
) -> tuple[float, str, list[str]]:
    """Finds the unit of capture times by the likelihood of their interval.

    Args:
        column: The name of the column, of :data:`TIME_COLUMNS` or :data:`FRAME_NUMBERS`.
        times: (T,) different times as the file has them, ascending.

    Returns:
        Microseconds per unit; the unit in words if it is not the one that the column names; and a line for
        the user where another one is nearly as likely.

    Raises:
        DeviceError: The usual interval is no body tracker's in any unit.
    """
    called, own = called or column, TIME_COLUMNS.get(column, (_FRAME_US, ""))[0]
    interval = float(np.median(np.diff(times))) if len(times) > 2 else 0.0
    counts = interval == 1.0 and own < _ANY_US[0] and (times == np.rint(times)).all()
    if column == FRAME_NUMBERS or counts:
        return _FRAME_US, f"{called} as counted frames, 30 per second (a column time_s states times)", []
    if not interval:
        return own, "", []

    def likelihood(us: float, of: str) -> float:
        us = us * interval
        if not _ANY_US[0] <= us <= _ANY_US[1]:
            return -math.inf
        usual = any(abs(us * rate * 1e-6 - 1.0) <= _RATE_WITHIN for rate in _RATES)
        tracker = shortest_us <= us <= _TRACKER_US[1]
        prior = _OWN * (of == column) - (not of) - _NO_TRACKER * (not tracker)
        return prior + 2.0 * usual - abs(math.log(us / _FRAME_US))

    def rate(us: float) -> str:
        return f"{1e6 / (interval * us):.3g}"

    scores = {unit: likelihood(unit[0], unit[2]) for unit in _UNITS}
    best, other = sorted(_UNITS, key=lambda unit: -scores[unit])[:2]
    if scores[best] < -2.0 * _CLEAR:
        raise DeviceError(
            f"{name}: the unit of {called} is unclear; in no unit is its usual interval of {interval:.6g} "
            "that of 5 to 120 frames per second. Name the column time_s, time_ms, time_us or time_ns by its "
            "unit. If frames came at a constant rate, a column named frame that counts them is enough."
        )
    us, words, states = best
    if states != column:
        way = f" (a column {states} states this)" if states else ""
        return us, f"{called} in {words}, so that there are {rate(us)} frames per second{way}", []
    by_own = f"{name}: by {called} there are {rate(own)} frames per second; "
    if not shortest_us <= interval * own <= _TRACKER_US[1]:
        return own, "", [f"{by_own}body trackers give 5 to 120. Check its unit."]
    if scores[best] - scores[other] < _CLEAR:
        state = f"State times by a column {other[2] or 'time_s'} then."
        return own, "", [f"{by_own}if it holds {other[1]}, there are {rate(other[0])}. {state}"]
    return own, "", []


_UNITS = (
    *((us, words, column) for column, (us, words) in TIME_COLUMNS.items() if column != "time"),
    (125.0, "eighths of a millisecond", ""),
    (1.0 / 60.0, "ticks of 60 MHz", ""),
    (8.64e10, "days", ""),
)
"""Microseconds per unit, the unit in words, and the column that states it, if any."""


def _going_on(
    name: object, time_ns: NDArray[np.int64], key: NDArray[Any] | None, anonymous: bool
) -> tuple[NDArray[np.int64], list[str], list[int]]:
    """Times that go on where a clock is set between two parts in order, lines about it, and when it was.

    A part begins where the times go back, or step over several frames. One that begins before the end of the
    last one, or more than an hour after it, goes on after it; a pause remains. Few frames that fit neither
    what is before nor what is after them are put between these. Frames that are out of order here and there,
    and people one after the other, are left as they are: they can be sorted.

    Raises:
        DeviceError: Many frames fit no others.
    """
    rows = np.append(0, np.flatnonzero(np.diff(time_ns)) + 1)
    times = time_ns[rows]
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0) + 1
    if not len(steps) or (len(back) == 0 and steps.max() <= _LONGEST_NS):
        return time_ns, [], []
    if key is not None and not all((key[: rows[k]] == key[rows[k]]).any() for k in back.tolist()):
        return time_ns, [], []
    begins_again = anonymous and len(back) and times[back[-1]] <= times[0]
    if begins_again and np.isin(times[back[-1] :], times[: back[0]]).mean() > 1 / 2:
        return time_ns, [], []  # of another person, who has no id
    interval = int(np.median(steps[steps > 0])) if (steps > 0).any() else 0
    order = np.argsort(times, kind="stable")
    moved = np.abs(order - np.arange(len(order))).max()
    if 0 < moved < FEWEST and np.diff(times[order]).min() > _EVEN * interval:
        return time_ns, [], []
    begins = np.append(0, np.flatnonzero((steps < 0) | (steps > _PAUSE * interval)) + 1).tolist()
    parts = list(zip(begins, [*begins[1:], len(times)], strict=True))
    if max(end - begin for begin, end in parts) < FEWEST:
        return time_ns, [], []
    going, fits, shift, last, moves, sets = (
        times.copy(),
        np.zeros(len(times), np.bool_),
        0,
        None,
        list[str](),
        list[int](),
    )
    for begin, end in parts:
        gap = interval if last is None else int(times[begin]) + shift - last
        forward = 0 < gap <= _LONGEST_NS
        follows = last is not None and forward and (end == len(times) or times[end] > times[end - 1])
        if end - begin < FEWEST and not follows:
            continue
        if not forward:
            shift += interval - gap
            sets.append(int(times[begin]) + shift)
            moves.append(f"{'went back' if gap < 0 else 'jumped'} by {abs(interval - gap) * 1e-9:.3f} s")
        going[begin:end], fits[begin:end] = times[begin:end] + shift, True
        last = int(going[end - 1])
    told, kept, stray = [], np.flatnonzero(fits), np.flatnonzero(~fits)
    sizes = np.diff(np.append(rows, len(time_ns)))
    if (2 * sizes[stray] < np.median(sizes)).any():  # rows that are repeated, no frames
        return time_ns, [], []
    if len(stray) > LOGGED_TWICE * len(times):
        what = (
            f"the times of {len(stray)} of {len(times)} frames fit no others; they go back {len(back)} times"
        )
        raise DeviceError(
            f"{name}: {what}. If frames are in order, a column named frame that counts them is enough."
        )
    if len(stray):
        ends = going[kept[0]] - interval * (kept[0] + 1), last + interval * (len(times) - kept[-1])
        known = np.array([ends[0], *going[kept], ends[1]]) - ends[0]  # what a float holds exactly
        going[stray] = ends[0] + np.interp(stray, [-1, *kept, len(times)], known).astype(np.int64)
        count = "The time of 1 frame fits" if len(stray) == 1 else f"The times of {len(stray)} frames fit"
        told.append(f"{name}: {count} no others; from their order, they are put between these.")
    if moves:
        said = ", ".join(moves[:3]) + ", …" * (len(moves) > 3)
        told.append(
            f"{name}: the clock {said}, as one that is set or past midnight; from there, the times go on."
        )
    return going[np.cumsum(np.append(0, np.diff(time_ns) != 0))], told, sets


def moments_of(texts: list[str]) -> NDArray[np.int64] | None:
    """Nanoseconds of times such as 2026-11-25T12:30:00.033, 12:30:00.033 or .NET's 00:00:01.0333333.

    A time of the day has no date, whatever stands before it. Whole spans of 285 years go. None if one of them
    is no time.
    """
    found = [_moment(text) for text in texts]
    return None if None in found else np.array(found, dtype=np.int64)


def _moment(text: str) -> int | None:
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    days, hours, minutes, seconds, half = clock.groups()
    whole, _, decimals = re.sub("[,:]", ".", seconds).partition(".")
    hour = int(hours) % 12 + 12 * (half in "Pp") if half else int(hours)
    of_day = timedelta(int(days or 0), int(whole), hours=hour, minutes=int(minutes))
    with suppress(ValueError):
        date = datetime.fromisoformat(text)
        of_day += datetime.combine(date, time(), date.tzinfo or UTC) - datetime.fromtimestamp(0, UTC)
    ns = of_day // timedelta(seconds=1) * 10**9 + int(decimals.ljust(9, "0")[:9])
    return ns if abs(ns) < 1000 * _LATEST_US else ns % (1000 * _LATEST_US)  # such as .NET's year 1
