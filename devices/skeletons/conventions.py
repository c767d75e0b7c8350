"""Notices recorded skeletons whose units or axes are not those of this program."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from fusion.body import Body
from fusion.skeleton import FARTHEST

Unit = Literal["auto", "m", "cm", "mm", "ft", "in"]
"""Unit of a file's positions; auto: found from the size of the person."""
METRES: MappingProxyType[str, tuple[float, str]] = MappingProxyType(
    {
        "m": (1.0, "metres"),
        "cm": (0.01, "centimetres"),
        "mm": (0.001, "millimetres"),
        "ft": (0.3048, "feet"),
        "in": (0.0254, "inches"),
    }
)
"""Metres per unit, and the unit's name."""

_STATURE = 1.75  # metres, of Body.nominal_lengths
_PEOPLE = (1.1, 2.2)
"""Metres: how tall people are, as far as another unit is accepted without a question. Read in these units,
the ranges of a file's numbers do not overlap: 1.1 to 2.2, 3.6 to 7.2, 43 to 87, 110 to 220, 1100 to 2200."""
_PEOPLE_IN_METRES = (0.5, 3.0)
"""Metres is the documented unit, so that it is accepted for odd or noisy people, too. No other unit's range
comes near."""
_FEWEST_BONES = 3
FEWEST_TIMES = 3
"""Of a file or of a part of it; fewer tell no unit."""
_SHORTEST_US, _LONGEST_US = 2_000.0, 5_000_000.0
"""The interval of frames for which the unit that a column names is taken without a question."""
_TRACKER_US = 6_000.0, 250_000.0
"""Body trackers give 5 to 120 frames per second. An interval in a file lies in this range in one unit, or in
none, and never in the range above in another one."""
TIME_COLUMNS: MappingProxyType[str, tuple[float, str]] = MappingProxyType(
    {
        "time_us": (1.0, "microseconds"),
        "time_ms": (1e3, "milliseconds"),
        "time_s": (1e6, "seconds"),
        "time_ns": (1e-3, "nanoseconds"),
        "time": (1.0, "microseconds"),
    }
)
"""Microseconds per unit, and the unit's name, by the name of a column of times; ``time`` names no unit."""
_LARGEST = 1e9  # in any unit; a larger number is an error
_FROZEN_FRAMES = 15  # a person can be seen as standing still for some frames
_UPSIDE_DOWN_M = 0.3
_ALMOST_ALWAYS = 0.9
_SAMPLES = 200


def find_unit(
    name: object, body: Body, positions: NDArray[np.float64], unit: Unit = "auto"
) -> tuple[float, str]:
    """Finds the unit of positions from the lengths of the person's bones.

    Args:
        positions: (N, J, 3) as the file has them; NaN where there is none.

    Returns:
        Metres per unit, and a line for the user if the unit was found and is not metres; else empty.

    Raises:
        DeviceError: The person has no human size in any unit.
    """
    if unit != "auto":
        return METRES[unit][0], ""
    stature = stature_of(body, positions)
    if stature is None or _PEOPLE_IN_METRES[0] <= stature <= _PEOPLE_IN_METRES[1]:
        return 1.0, ""
    for metres, words in METRES.values():
        if _PEOPLE[0] <= stature * metres <= _PEOPLE[1]:
            warning = (
                f"{name}: the positions are taken as {words}, so that the person is {stature * metres:.2f} m "
                "tall. State another unit with --unit."
            )
            return metres, warning
    raise DeviceError(
        f"{name}: the unit of the positions is unclear; in metres the person would be {stature:.3g} m tall. "
        "State the unit with --unit (m, cm, mm, ft or in)."
    )


def check_metres_forward(name: object, xyz: NDArray[np.float64]) -> None:
    """Refuses positions that are too far away, or with a z axis that points backward.

    Raises:
        DeviceError: Most joints are farther away than any sensor sees, or behind the sensor.
    """
    x, y, z = np.abs(xyz).reshape(-1, 3).T
    largest = np.maximum(np.maximum(x, y), z)
    known = np.isfinite(largest)
    if not known.any():
        return
    distance = float(np.median(largest[known]))
    if distance > FARTHEST:
        raise DeviceError(
            f"{name}: the joints are {distance:.3g} m away (median); no sensor sees beyond {FARTHEST:.0f} m. "
            "Positions must be in the frame of the sensor; state another unit than metres with --unit."
        )
    if np.median(xyz[..., 2].ravel()[known]) < 0.0:
        raise DeviceError(
            f"{name}: most joints have a negative z. The z axis must point forward, towards the person; "
            "state the file's axes with --axes."
        )


def impossible(xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(...) which positions (..., 3), in metres, no sensor can report.

    They are infinite, farther away than any sensor sees, or not before the sensor. A position of zeros and
    one with a NaN is a joint that was not seen.
    """
    x, y, z = np.moveaxis(xyz, -1, 0)
    stated = ~(np.isnan(x) | np.isnan(y) | np.isnan(z)) & ((x != 0.0) | (y != 0.0) | (z != 0.0))
    near = (np.abs(x) < FARTHEST) & (np.abs(y) < FARTHEST) & (z < FARTHEST) & (z > 0.0)
    return np.asarray(stated & ~near)


def impossible_in_words(name: object, count: int, where: str, value: NDArray[np.float64]) -> str:
    """The warning about so many impossible positions: where the first one is, and (3,) what it is."""
    axis = int(np.argmax(~(np.abs(value) < FARTHEST)))
    axis = axis if not abs(value[axis]) < FARTHEST else 2
    positions = "1 position is" if count == 1 else f"{count} positions are"
    return (
        f"{name}: {positions} impossible and count as not tracked, first {where}, {'xyz'[axis]} = "
        f"{value[axis]:.4g} m. Each coordinate must be within {FARTHEST:.0f} m, and z above 0."
    )


def find_time_unit(name: object, column: str, times: NDArray[np.number]) -> tuple[float, str]:
    """Finds the unit of capture times from their interval.

    Args:
        column: The name of the column, of :data:`TIME_COLUMNS`.
        times: (T,) different times as the file has them, ascending.

    Returns:
        Microseconds per unit, and a line for the user if it is not the unit that the column names.

    Raises:
        DeviceError: The median interval is no body tracker's in any unit.
    """
    stated, _ = TIME_COLUMNS[column]
    if len(times) < FEWEST_TIMES:
        return stated, ""
    interval = float(np.median(np.diff(times)))
    if _SHORTEST_US <= interval * stated <= _LONGEST_US:
        return stated, "" if column != "time" else _taken_as(name, column, "time_us", interval * stated)
    for found, (per_unit, _) in TIME_COLUMNS.items():
        if _TRACKER_US[0] <= interval * per_unit <= _TRACKER_US[1]:
            return per_unit, _taken_as(name, column, found, interval * per_unit)
    raise DeviceError(
        f"{name}: the unit of {column} is unclear; its median interval of {interval:g} is in no unit that of "
        "5 to 120 frames per second. Name the column time_s, time_ms, time_us or time_ns by its unit."
    )


def _taken_as(name: object, column: str, found: str, interval_us: float) -> str:
    return (
        f"{name}: {column} is taken as {TIME_COLUMNS[found][1]}, so that there are {1e6 / interval_us:.3g} "
        f"frames per second. Name the column {found} to state this unit."
    )


def upside_down(name: str, body: Body, frames: Sequence[SensorFrame]) -> list[str]:
    """A warning, if the person's head is below the feet in almost every frame."""
    people = [
        skeleton.positions
        for frame in frames[:: max(1, len(frames) // _SAMPLES)]
        for skeleton in frame.people.values()
    ]
    if not people:
        return []
    y = np.stack(people)[:, :, 1]
    below = y[:, body.joint("head")] - np.minimum(
        y[:, body.joint("ankle left")], y[:, body.joint("ankle right")]
    )
    known = below[np.isfinite(below)]
    if len(known) == 0 or np.mean(known > _UPSIDE_DOWN_M) <= _ALMOST_ALWAYS:
        return []
    return [
        f"{name}: the head is below the feet in almost every frame. The y axis must point down; state the "
        "file's axes with --axes (kinect, unity, opengl, ros, or a list)."
    ]


def frozen(name: str, frames: Sequence[SensorFrame]) -> list[str]:
    """A warning, if almost every frame repeats the one before."""
    if len(frames) < _FROZEN_FRAMES:
        return []
    some = range(1, len(frames), max(1, len(frames) // _SAMPLES))
    pairs = [(frames[k - 1].people, frames[k].people) for k in some]
    again = [any(after[one].repeats(before.get(one)) for one in after) for before, after in pairs if after]
    if not again or np.mean(again) <= _ALMOST_ALWAYS:
        return []
    return [f"{name}: almost every frame repeats the one before. Its body tracker did not follow the person."]


def stature_of(body: Body, positions: NDArray[np.float64]) -> float | None:
    """How tall the person is, in the unit of (N, J, 3) positions; None if too few bones were seen."""
    some = positions[:: max(1, len(positions) // _SAMPLES)].copy()
    some[~(np.abs(some) < _LARGEST)] = np.nan
    bones = body.bone_joints
    length = np.linalg.norm(some[:, bones] - some[:, body.parent_indices[bones]], axis=2)
    length[length == 0.0] = np.nan
    seen = np.isfinite(length).any(axis=0)
    if seen.sum() < _FEWEST_BONES:
        return None
    measured = np.nanmedian(length[:, seen], axis=0)
    return _STATURE * float(measured.sum() / body.nominal_lengths[bones[seen]].sum())
