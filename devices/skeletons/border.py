"""Checks of every file of recorded skeletons, by which its points become the joints of people."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from devices.people.recorded_people import RecordedPeople
from devices.sensor import DeviceError
from devices.skeletons.read_file import FoundPoints
from devices.skeletons.repetition import ALMOST_ALWAYS, kept_places, logged_again, repeats_of
from devices.skeletons.stated_format import UNSTATED, StatedFormat, Unit
from devices.skeletons.times import FEWEST
from fusion.body import Body
from fusion.pair_arrays import View, joined_views
from fusion.skeleton import FARTHEST_JOINT, checked_joints
from fusion.support.large_arrays import parts

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
_PEOPLE_IN_OWN = (0.5, 3.0)
"""Metres: the same in the unit that the format defines, so that it is accepted for odd or noisy people, too.
No other unit's range comes near."""
_FEWEST_BONES = 3
_LARGEST = 1e9  # in any unit; a larger number is an error
_UPSIDE_DOWN_M = 0.3
_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class ReadFile:
    """The content of a skeleton file.

    Attributes:
        body: Of the people; found by the names of the joints.
        people: Their frames.
        warnings: What the user should know about the file, a line each.
        unit: Name of the unit of its positions.
        ignored: Names of columns that are not read.
    """

    body: Body
    people: RecordedPeople
    warnings: tuple[str, ...] = ()
    unit: str = "metres"
    ignored: tuple[str, ...] = ()


def checked(path: Path, found: FoundPoints, stated: StatedFormat = UNSTATED) -> ReadFile:
    """The joints of a file: only what a sensor can have seen, in metres.

    A point is not seen where its state says so, where a coordinate is NaN or all are 0, where it keeps its
    place to the last digit while the others move, and where no sensor can see it. Frames that repeat the one
    before, as where a program logs faster than its tracker gives frames, are left out.

    Raises:
        DeviceError: No joint has a position, the unit is unclear, or most joints are too far away or
            behind the sensor; or by the stated axes the person is a mirror image.
    """
    repeats = repeats_of(found)
    drop, told = logged_again(path, found, repeats)
    keeps, about_places = kept_places(path, found, repeats)
    body, view = found.points.body, found.view
    some = np.linspace(0, len(view.states) - 1, min(_SAMPLES, len(view.states))).astype(np.int64)
    sample, _ = found.points.joints(_seen(view, keeps, some), view.states[some])
    metres, about_unit = find_unit(path, body, sample, stated.unit, found.unit)
    check_metres_forward(path, sample * metres)
    rows = np.flatnonzero(~drop[found.frame])
    skeletons, about_positions = _possible(path, found, keeps, rows, metres)
    there = skeletons.states.any(axis=1)
    if len(rows) and there.any() and not there.all():  # bodies that a program logs although nobody is there
        rows, skeletons = rows[there], skeletons.chosen_whole(np.flatnonzero(there))
    about_hands = stated.check_handed(path, body, skeletons.positions)
    frame = (np.cumsum(~drop) - 1)[found.frame[rows]]
    seen, person = np.unique(found.person[rows], return_inverse=True)
    ids = [found.ids[k] for k in seen]
    people = RecordedPeople(body, found.time_ns[~drop], ids, frame, person, skeletons)
    if people.ids and not skeletons.states.any():
        raise DeviceError(f"{path}: no joint has a position in any frame.")
    lines = [*found.warnings, *told, *about_places, *about_unit, *about_positions, *about_hands]
    if people.ids:
        first = people.ids.index(people.choose_person(None, str(path), ""))
        of = person == first
        lines += upside_down(
            path, body, skeletons.positions[np.flatnonzero(of)[:: max(1, of.sum() // _SAMPLES)]]
        )
        if of.sum() >= FEWEST and repeats[rows][of][1:].mean() > ALMOST_ALWAYS:
            lines.append(
                f"{path}: almost every frame repeats the one before. Its body tracker did not follow the "
                "person."
            )
    unit = next(words for scale, words in METRES.values() if scale == metres)
    return ReadFile(body, people, tuple(lines), unit, found.ignored)


def _seen(view: View, keeps: NDArray[np.bool_], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, P, 3) points of some skeletons, in the file's unit; NaN where one was not seen."""
    at = np.array(view.positions[rows], dtype=np.float64)
    at[keeps[rows] | (view.states[rows] == 0) | (at == 0.0).all(axis=2) | np.isnan(at).any(axis=2)] = np.nan
    return at


def _possible(
    path: Path, found: FoundPoints, keeps: NDArray[np.bool_], rows: NDArray[np.int64], metres: float
) -> tuple[View, list[str]]:
    """The joints of some skeletons in metres, and a line about positions that no sensor can report."""
    body, count = found.points.body, 0
    first: tuple[int, int, NDArray[np.float64]] | None = None

    def blocks() -> Iterator[View]:
        nonlocal count, first
        for part in parts(len(rows)):
            of = rows[part]
            at = _seen(found.view, keeps, of) * metres
            wrong = np.argwhere(impossible(at))
            count += len(wrong)
            if len(wrong) and first is None:
                k, point = wrong[0].tolist()
                first = int(of[k]), point, at[k, point].copy()
            at[wrong[:, 0], wrong[:, 1]] = np.nan
            joints = checked_joints(body, *found.points.joints(at, found.view.states[of]), (len(of),))
            yield View(found.view.time_ns[of], *joints)
        if not len(rows):  # nobody is seen
            yield View(
                np.zeros(1, np.int64), *checked_joints(body, np.full((1, len(body), 3), np.nan), None, (1,))
            )

    skeletons = joined_views(blocks())
    if first is None:
        return skeletons, []
    k, point, place = first
    where = found.where(k, point) if found.where else f"in frame {found.frame[k]}"
    return skeletons, [impossible_in_words(path, count, where, place)]


def find_unit(
    name: object, body: Body, positions: NDArray[np.float64], unit: Unit = "auto", own: Unit = "m"
) -> tuple[float, list[str]]:
    """Finds the unit of positions from the lengths of the person's bones.

    Args:
        positions: (N, J, 3) as the file has them; NaN where a joint was not seen.
        unit: The one stated.
        own: The unit that the format defines.

    Returns:
        Metres per unit, and a line for the user if the unit was found and is not the format's.

    Raises:
        DeviceError: The person has no human size in any unit.
    """
    if unit != "auto":
        return METRES[unit][0], []
    stature, defined = stature_of(body, positions), METRES[own][0]
    if stature is None or _PEOPLE_IN_OWN[0] <= stature * defined <= _PEOPLE_IN_OWN[1]:
        return defined, []
    for metres, words in METRES.values():
        if _PEOPLE[0] <= stature * metres <= _PEOPLE[1]:
            return metres, [
                f"{name}: the positions are read as {words}, so that the person is {stature * metres:.2f} m "
                "tall. State another unit with `unit`."
            ]
    raise DeviceError(
        f"{name}: the unit of the positions is unclear; in metres the person would be {stature:.3g} m tall. "
        "State the unit with `unit` (m, cm, mm, ft or in)."
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
    if distance > FARTHEST_JOINT:
        raise DeviceError(
            f"{name}: the joints are {distance:.3g} m away (median); no sensor sees beyond "
            f"{FARTHEST_JOINT:.0f} m. "
            "Positions must be in the frame of the sensor; state another unit than metres with `unit`."
        )
    if np.median(xyz[..., 2].ravel()[known]) < 0.0:
        raise DeviceError(
            f"{name}: most joints have a negative z. The z axis must point forward, towards the person; "
            "state the file's axes with `axes`."
        )


def impossible(xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(...) which positions (..., 3), in metres, no sensor can report.

    They are infinite, farther away than any sensor sees, or not before the sensor. A position of zeros and
    one with a NaN is a joint that was not seen.
    """
    x, y, z = np.moveaxis(xyz, -1, 0)
    stated = ~(np.isnan(x) | np.isnan(y) | np.isnan(z)) & ((x != 0.0) | (y != 0.0) | (z != 0.0))
    near = (np.abs(x) < FARTHEST_JOINT) & (np.abs(y) < FARTHEST_JOINT) & (z < FARTHEST_JOINT) & (z > 0.0)
    return np.asarray(stated & ~near)


def impossible_in_words(name: object, count: int, where: str, value: NDArray[np.float64]) -> str:
    """The warning about so many impossible positions: where the first one is, and (3,) what it is."""
    axis = int(np.argmax(~(np.abs(value) < FARTHEST_JOINT)))
    axis = axis if not abs(value[axis]) < FARTHEST_JOINT else 2
    positions = "1 position is" if count == 1 else f"{count} positions are"
    return (
        f"{name}: {positions} impossible and count as not tracked, first {where}, {'xyz'[axis]} = "
        f"{value[axis]:.4g} m. Each coordinate must be within {FARTHEST_JOINT:.0f} m, and z above 0."
    )


def upside_down(name: object, body: Body, positions: NDArray[np.floating]) -> list[str]:
    """A warning, if the person's head is below the feet in almost every one of (N, J, 3) frames."""
    y = positions[:, :, 1]
    below = y[:, body.joint("head")] - np.minimum(
        y[:, body.joint("ankle left")], y[:, body.joint("ankle right")]
    )
    known = below[np.isfinite(below)]
    if len(known) == 0 or np.mean(known > _UPSIDE_DOWN_M) <= ALMOST_ALWAYS:
        return []
    return [
        f"{name}: the head is below the feet in almost every frame. The y axis must point down; state the "
        "file's axes with `axes` (kinect, unity, opengl, ros, or a list)."
    ]


def stature_of(body: Body, positions: NDArray[np.float64]) -> float | None:
    """How tall the person is, in the unit of (N, J, 3) positions; None if too few bones were seen.

    It is the median over the bones, so that some joints may have any place.
    """
    bones = body.bone_joints
    at = np.where(np.abs(positions) < _LARGEST, positions, np.nan)
    length = np.linalg.norm(at[:, bones] - at[:, body.parent_indices[bones]], axis=2)
    length[length == 0.0] = np.nan
    seen = np.isfinite(length).any(axis=0)
    if seen.sum() < _FEWEST_BONES:
        return None
    nominal = body.nominal_lengths[bones[seen]]
    ratio = np.nanmedian(length[:, seen], axis=0) / nominal
    order = np.argsort(ratio)
    middle = np.searchsorted(np.cumsum(nominal[order]), 0.5 * nominal.sum())
    return _STATURE * float(ratio[order[middle]])
