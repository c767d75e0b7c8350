"""Tables of names: which points of a file are the joints of a body, as TOML.

A table has one section, ``[joints]``. Its keys are joints of any body, in any spelling. A value is the name
of a point in the file, a list of points whose mean is the joint (a point that is named twice counts twice),
or a list of such lists, of which the first counts that the file has whole.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.input_file import input_text
from devices.sensor import DeviceError, MissingRecordingError
from fusion.body import BODIES, Body, body_of
from fusion.errors import FusionError

READY_MADE = (
    "bodies", "plug-in-gait", "gait2392", "mixamo", "nuitrack", "openpose", "mediapipe", "motive",
)  # fmt: skip
"""Tables that the program brings along, in the order in which they are tried."""
_FOLDER = Path(__file__).parent / "names"
_MOST_LISTED = 12
_FEWEST = 5  # joints; fewer may be those of another table
Points = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class NameTable:
    """The points that make up each joint.

    Attributes:
        name: What the table is called in messages.
        joints: By the joint's name in any body's spelling, the alternatives in their order.
        ready_made: Whether joints whose points a file lacks are left out instead of being an error.
    """

    name: str
    joints: Mapping[str, Sequence[Points]]
    ready_made: bool = False

    def points_of(self, body: Body, labels: Sequence[str]) -> dict[int, list[int]]:
        """The points of each joint of a body: joint → indices of the labels.

        Joints that the table does not have are found by their own names. A label's prefix up to the last
        colon, a subject's name, its case and its punctuation do not count.

        Raises:
            DeviceError: The table names a point that the file does not have.
        """
        index = _by_plain_name(labels)
        found = {}
        for name, alternatives in self.joints.items():
            joint = body.find(name)
            if joint is None:
                continue
            whole = [points for points in alternatives if all(_find(index, p) is not None for p in points)]
            if whole:
                found[joint] = [k for k in (_find(index, point) for point in whole[0]) if k is not None]
            elif not self.ready_made:
                missing = next(p for p in alternatives[0] if _find(index, p) is None)
                there = listed(labels)
                raise DeviceError(f"{self.name}: {name} needs one point {missing!r}; the file has {there}.")
        for joint, name in enumerate(body.joints):
            own = _find(index, name)
            if joint not in found and own is not None:
                found[joint] = [own]
        return dict(sorted(found.items()))


def name_table(name: str | Path) -> NameTable:
    """A table of :data:`READY_MADE` by its name, or one from a TOML file.

    Raises:
        DeviceError: There is no such table or file, it is not TOML, or a joint or value in it is wrong.
    """
    ready_made = str(name) in READY_MADE
    path = _FOLDER / f"{name}.toml" if ready_made else Path(name)
    try:
        document = tomllib.loads(input_text(path))
    except FileNotFoundError:
        known = f"Give a .toml file, or one of {', '.join(READY_MADE)}."
        raise MissingRecordingError(f"No table of names {str(name)!r}. {known}") from None
    except OSError as error:
        raise DeviceError(f"{name} cannot be read: {error.strerror or error}.") from None
    except (ValueError, RecursionError) as error:
        raise DeviceError(f"{name} is not TOML: {error}.") from None
    joints = document.get("joints")
    if not isinstance(joints, dict) or not joints or len(document) > 1:
        raise DeviceError(f'{name} needs one section, [joints], with lines such as HIP_LEFT = "LASI".')
    spelled: dict[tuple[int | None, ...], str] = {}
    for joint in joints:
        found = tuple(body.find(joint) for body in BODIES.values())
        if set(found) == {None}:
            names = ", ".join(BODIES["azure_kinect"].joints)
            raise DeviceError(f"{name}: no body has a joint {joint!r}. Joints are {names}.")
        if spelled.setdefault(found, joint) != joint:
            raise DeviceError(f"{name}: {joint} is there twice, also as {spelled[found]}.")
    return NameTable(str(name), {j: _alternatives(name, j, value) for j, value in joints.items()}, ready_made)


def fitting_table(body: Body, labels: Sequence[str]) -> NameTable:
    """The ready-made table by which most joints of a body are found among the labels of a file."""
    return max(map(name_table, READY_MADE), key=lambda table: len(table.points_of(body, labels)))


def listed(labels: Sequence[str]) -> str:
    """Names of points in a message; only the first ones of many."""
    more = len(labels) - _MOST_LISTED
    return ", ".join(labels[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else "")


def _alternatives(table: str | Path, joint: str, value: Any) -> list[Points]:
    points = [value] if isinstance(value, str) else value
    if isinstance(points, list) and points and all(isinstance(each, str) for each in points):
        points = [points]
    if isinstance(points, list) and points and all(isinstance(each, list) and each for each in points):
        found = [tuple(each) for each in points]
        if all(isinstance(point, str) for each in found for point in each):
            return found
    raise DeviceError(f"{table}: {joint} must be the name of a point or a list of names; it is {value!r}.")


def plain(name: str) -> str:
    """A name without case and punctuation."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _by_plain_name(labels: Iterable[str]) -> dict[str, int]:
    """By whole label, and by the part after a subject's name or Mixamo's prefix where only one has it."""
    index: dict[str, int] = {}
    for short in (False, True):
        names = [
            re.sub(r"^(?:mixamorig\d*|joint)", "", plain(label.rpartition(":")[2])) if short else plain(label)
            for label in labels
        ]
        for k, name in enumerate(names):
            if name and (not short or names.count(name) == 1):
                index.setdefault(name, k)
    return index


def _find(index: Mapping[str, int], point: str) -> int | None:
    whole = index.get(plain(point))
    return index.get(plain(point.rpartition(":")[2])) if whole is None else whole


def points_of(name: object, labels: Sequence[str], table: str = "") -> tuple[FilePoints, str]:
    """The joints that the points of a file are, and the ready-made table by which they were found, if any.

    Args:
        table: A name of :data:`READY_MADE`, or a TOML file. Empty: the names are those of a body's joints, or
            those of the ready-made table by which most joints are found.

    Raises:
        DeviceError: A name is no joint's, or the file lacks a point of the table.
    """
    bodies = BODIES.values()

    def count(of: NameTable) -> int:
        return max(len(of.points_of(body, labels)) for body in bodies)

    try:
        if table:
            best = name_table(table)
        else:
            own = max(sum(body.find(label) is not None for label in labels) for body in bodies)
            best = max(map(name_table, READY_MADE[1:] if own < len(labels) else READY_MADE[:1]), key=count)
            if own == len(labels) or count(best) < max(_FEWEST, own + 1):
                body = body_of(set(labels))
                labels = sorted(labels, key=body.joint)
                return FilePoints(
                    body, labels, {body.joint(label): [k] for k, label in enumerate(labels)}
                ), ""
        named = () if best.ready_made else best.joints  # a ready-made table has the joints of several bodies
        fitting = [body for body in bodies if all(body.find(joint) is not None for joint in named)]
        body = max(fitting or [body_of(set(named))], key=lambda body: len(best.points_of(body, labels)))
    except FusionError as error:
        raise DeviceError(f"{name}: {error}") from None
    groups = best.points_of(body, labels)
    if not groups:
        raise DeviceError(f"{name}: by {best.name} none of its points is a joint: {listed(labels)}.")
    return FilePoints(body, labels, groups), "" if table else best.name


def named_points(
    path: Path, labels: Sequence[str], stated: str
) -> tuple[FilePoints, Sequence[str], str, str, list[str]]:
    """What the points of a file are, their names, how and by which table they were found, and lines."""
    first, last = min(labels), max(labels)
    common = next((k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    before = re.sub(r"[A-Za-z0-9]*$", "", first[:common])  # a subject's name, or Body0_
    labels = [label.removeprefix(before) for label in labels]
    ends = [re.fullmatch(r"(.*?)(\d+)", label) for label in labels]
    same = len({end and end[1] for end in ends}) == 1 and not re.match(r"keypoint|landmark", labels[0], re.I)
    numbers = [int(end[2]) for end in ends if end and same and not stated]
    for body in BODIES.values():
        if numbers and len(body) == 1 + max(numbers):
            labels = [body.joints[number] for number in numbers]
            words = f"the numbers of joints as those of {body.name}, from 0 on"
            return points_of(path, labels)[0], labels, words, "", []
    points, table = points_of(path, labels, stated)
    used = {k for of in points.groups.values() for k in of}
    left_out = [label for k, label in enumerate(points.labels) if k not in used]
    told = f"{path}: by {stated or table} these points are no joints: {listed(left_out)}."
    return points, labels, f"the names of {table}" if table else "", table, [told] if left_out else []


@dataclass(frozen=True, eq=False)
class FilePoints:
    """The points of a file, and the joints of a body that they are.

    Attributes:
        body: The body.
        labels: The names of the points in the file.
        groups: The points whose mean is a joint, by joint.
    """

    body: Body
    labels: Sequence[str]
    groups: Mapping[int, list[int]]

    def __len__(self) -> int:
        return len(self.labels)

    def joints(
        self, positions: NDArray[np.float64], states: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Positions (N, J, 3) and states (N, J) of the joints from those of the points.

        A joint is tracked as its worst point is, and has no position where one of its points has none.
        """
        if [*self.groups.items()] == [(k, [k]) for k in range(len(self.body))]:
            return positions, states
        at = np.full((len(positions), len(self.body), 3), np.nan)
        state = np.zeros((len(positions), len(self.body)), dtype=np.uint8)
        for joint, points in self.groups.items():
            at[:, joint] = positions[:, points].mean(axis=1)
            state[:, joint] = states[:, points].min(axis=1)
        return at, state
