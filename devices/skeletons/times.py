"""Capture times as files have them: their unit by the frame rate, midnight, and times of text."""

import math
import re
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError

TIME_COLUMNS: MappingProxyType[str, tuple[float, str]] = MappingProxyType(
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
_EPOCHS_S = (62_135_596_800, 11_644_473_600)
"""Seconds from the year 1 and from 1601, where .NET and Windows begin to count, to 1970."""
_FEWEST = 3  # times; fewer tell no unit
FEWEST = 15
"""Frames: a person can be seen as standing still for fewer."""
LOGGED_TWICE = 0.2  # of the frames: more repeat the one before where a program logs faster than its tracker
_TRACKER_US = 8_000.0, 205_000.0
"""Body trackers give 5 to 120 frames per second; with a tolerance."""
_SLOW_US, _ODD_US = 1e6 / 12.0, (2_000.0, 5_000_000.0)
"""The longest interval for which the unit that a column names is taken without a question, and those with
one: a recording may have few frames per second, or those of a sensor in another unit."""
_RATES, _RATE_WITHIN, _LOOSELY = (5.0, 30.0, 15.0, 60.0, 90.0), 0.02, 0.12
"""Usual rates of sensors, and how far their median interval may be from that."""
_WRAPS = (
    (8.64e10, "midnight"),
    (4.32e10, "noon"),
    (None, "the end of a counter of 32 bits"),  # of the file's own units
)
_PAUSE_US = 6e7  # the longest pause in which a wrap is recognised
_CLOCK = re.compile(
    r"(?:^|[ T])(?:(\d+)\.)?(\d+):(\d\d):(\d\d(?:[.,]\d*)?)\s*(?:([AaPp])[Mm])?"
    r"(?:Z|[+-]\d\d:?\d\d)?$"
)


def capture_times(
    name: object,
    column: str,
    times: NDArray[Any],
    shortest_us: float = _TRACKER_US[0],
    called: str = "",
    telling: NDArray[Any] | None = None,
) -> tuple[NDArray[np.int64], list[str]]:
    """Nanoseconds of the times of a file, in its order, and lines for the user.

    Args:
        column: A name of :data:`TIME_COLUMNS`, or :data:`FRAME_NUMBERS`.
        times: (N,) as the file has them, of rows or of frames.
        shortest_us: Interval of frames that is not unusual.
        called: The column's name in the file, if another.
        telling: (T,) those by which the unit is found, different and ascending. None: all.

    Raises:
        DeviceError: The interval is no body tracker's in any unit, or nanoseconds exceed 64 bits.
    """
    telling = np.unique(times) if telling is None else telling
    us, told = find_time_unit(name, column, telling, shortest_us, called)
    times, wrapped = _unwrapped(times, us)
    told = [*told, f"{name}: the times continue over {wrapped}."] if wrapped else told
    for epoch_s in _EPOCHS_S:
        if times.min() * us >= max(_LATEST_US, epoch_s * 1e6):
            times = times - times.dtype.type(epoch_s * 1e6 / us)
    if max(float(times.max()), -float(times.min())) * us >= _LATEST_US:
        raise DeviceError(f"{name}: {called or column} goes beyond {_LATEST_US} microseconds.")
    if times.dtype == np.int64 and (ns := round(1000.0 * us)) == 1000.0 * us:
        return times * ns, told
    return np.rint(times * us).astype(np.int64) * 1000, told


def digest(xyz: NDArray[Any], point: NDArray[Any] | int, person: NDArray[Any] | int) -> NDArray[np.float64]:
    """(…) a number of each (…, 3) place, point and person; those of a frame add up to one that tells it."""
    place = np.clip(np.nan_to_num(xyz), -1e9, 1e9) @ (1.0, 0.7, 0.3)
    return np.asarray(place * (1 + point + 97 * person))


def times_of_new_frames(times: NDArray[Any], digests: NDArray[Any]) -> NDArray[Any]:
    """The times; where a program logged many frames again, those of the tracker's own frames.

    Args:
        times: (T,) different and ascending.
        digests: (T,) of the frames.
    """
    new = np.append(True, np.diff(digests) != 0.0)
    return times[new] if new.sum() >= FEWEST and new.mean() < 1.0 - LOGGED_TWICE else times


def find_time_unit(
    name: object, column: str, times: NDArray[Any], shortest_us: float = _TRACKER_US[0], called: str = ""
) -> tuple[float, list[str]]:
    """Finds the unit of capture times from their interval.

    Args:
        column: The name of the column, of :data:`TIME_COLUMNS` or :data:`FRAME_NUMBERS`.
        times: (T,) different times as the file has them, ascending.

    Returns:
        Microseconds per unit, and a line for the user if it is not the unit that the column names, or an
        unusual one.

    Raises:
        DeviceError: The usual interval is no body tracker's in any unit.
    """
    called = called or column
    if column == FRAME_NUMBERS:
        return _FRAME_US, [_numbered(name, called)]
    own, _ = TIME_COLUMNS[column]
    if len(times) < _FEWEST:
        return own, []
    interval = float(np.median(np.diff(times)))
    own_us, stated = interval * own, column != "time"
    if stated and shortest_us <= own_us <= _SLOW_US:
        return own, []
    units = [unit for unit in _UNITS if unit.fits(interval)]
    sensors = [unit for unit in _UNITS if _is_usual(interval * unit.us, _RATES[1:])]
    odd = stated and _ODD_US[0] <= own_us <= _ODD_US[1]
    if odd and _TRACKER_US[0] <= own_us <= _TRACKER_US[1]:
        units = [unit for unit in units if unit in sensors]
    elif odd:  # no tracker's: those of a sensor whose frames come late and early, too
        units = [unit for unit in _UNITS if _is_usual(interval * unit.us, _RATES[1:2], _LOOSELY)]
    by_own = f"{name}: by {called} there are {1e6 / own_us:.3g} frames per second; "
    if odd and _TRACKER_US[0] <= own_us <= _TRACKER_US[1]:
        return own, [
            f"{by_own}if it holds {unit.words}, there are {unit.rate(interval)}. State times by a column "
            f"{unit.column or 'time_s'} then."
            for unit in sensors[:1]
        ]
    if units:
        unit = min(units, key=lambda one: one.oddness(interval))
        way = f" Name the column {unit.column} to state this unit." if unit.column else ""
        per_second = f"{unit.rate(interval)} frames per second"
        return unit.us, [f"{name}: {called} is read as {unit.words}, so that there are {per_second}.{way}"]
    if interval == 1.0 and (times == np.rint(times)).all():
        return _FRAME_US, [_numbered(name, called)]
    if odd:
        return own, [f"{by_own}body trackers give 5 to 120. Check its unit."]
    raise DeviceError(
        f"{name}: the unit of {called} is unclear; in no unit is its usual interval of {interval:.6g} "
        "that of 5 to 120 frames per second. Name the column time_s, time_ms, time_us or time_ns by its unit."
    )


class _Unit(NamedTuple):
    """A unit of times; an interval is the number of units between two frames."""

    us: float  # microseconds
    words: str
    column: str = ""  # that states it, if any

    def fits(self, interval: float) -> bool:
        """Whether it is a body tracker's; in a unit that is seldom used, whether it is just a sensor's."""
        trackers = _TRACKER_US[0] <= interval * self.us <= _TRACKER_US[1]
        return trackers and (self.column != "" or _is_usual(interval * self.us, _RATES[1:3]))

    def oddness(self, interval: float) -> tuple[bool, float]:
        """Less for the rate of a sensor, then for one nearer to 30 per second."""
        us = interval * self.us
        return not _is_usual(us, _RATES), abs(math.log(us / _FRAME_US))

    def rate(self, interval: float) -> str:
        """Frames per second in words."""
        return f"{1e6 / (interval * self.us):.3g}"


_UNITS = (
    *(_Unit(us, words, column) for column, (us, words) in TIME_COLUMNS.items() if column != "time"),
    _Unit(125.0, "eighths of a millisecond"),
    _Unit(1.0 / 60.0, "ticks of 60 MHz"),
    _Unit(8.64e10, "days"),
)


def _is_usual(interval_us: float, rates: tuple[float, ...], within: float = _RATE_WITHIN) -> bool:
    return any(abs(interval_us * rate * 1e-6 - 1.0) <= within for rate in rates)


def _numbered(name: object, column: str) -> str:
    return f"{name}: {column} counts frames; 30 per second are assumed. A column time_s states the times."


def _unwrapped(times: NDArray[Any], us: float) -> tuple[NDArray[Any], str]:
    """Times that go on where a clock begins anew, as at midnight, and what was passed."""
    steps = np.diff(times)
    for period_us, words in _WRAPS if (steps < 0).any() else ():
        period = times.dtype.type(2**32 if period_us is None else period_us / us)
        reach = min(_PAUSE_US / us, period / 8)
        over = (np.abs(steps + period) < reach).astype(np.int64) - (np.abs(steps - period) < reach)
        if over.any() and over[over != 0][0] > 0:
            return times + period * np.append(0, np.cumsum(over)).astype(times.dtype), words
    return times, ""


def moments_of(texts: list[str]) -> NDArray[np.int64] | None:
    """Nanoseconds of times such as 2026-11-25T12:30:00.033, 12:30:00.033 or .NET's 00:00:01.0333333.

    A time of the day has no date, whatever stands before it. None if one of them is no time.
    """
    found = [_moment(text) for text in texts]
    return None if None in found else np.array(found, dtype=np.int64)


def _moment(text: str) -> int | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    days, hours, minutes, seconds, half = clock.groups()
    whole, _, decimals = seconds.replace(",", ".").partition(".")
    hour = int(hours) % 12 + 12 * (half.lower() == "p") if half else int(hours)
    of_day = (int(days or 0) * 24 + hour) * 3600 + int(minutes) * 60 + int(whole)
    if moment is not None:
        zone = moment.tzinfo or UTC
        midnight = datetime(moment.year, moment.month, moment.day, tzinfo=zone)
        of_day += round(midnight.timestamp())
    return of_day * 10**9 + int(decimals.ljust(9, "0")[:9])
