"""What a user states about the ``.csv`` files of another program: unit, axes, and names of the joints."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError
from devices.skeletons.name_tables import NameTable, listed, name_table
from fusion.body import BODIES, Body, body_of
from fusion.errors import FusionError
from fusion.facing.handedness import mirrored_share

AXES: MappingProxyType[str, str] = MappingProxyType(
    {"kinect": "-x,-y,z", "unity": "x,-y,z", "opengl": "x,-y,-z", "ros": "-y,-z,x"}
)
"""The axes of other programs by name: which axes of a file are x (right), y (down) and z (forward).

Kinect is the SDK of Kinect v1 and v2. Unity's axes are left-handed, so that one changes its sign.
"""
MIRRORED = 0.5
"""The value of :func:`fusion.facing.handedness.mirrored_share` above which a person is a mirror image."""
Unit = Literal["auto", "m", "cm", "mm", "ft", "in"]
"""Unit of a file's positions; auto: found from the size of the person."""


@dataclass(frozen=True)
class StatedFormat:
    """What is stated about a file.

    Attributes:
        unit: Unit of the positions; found from the size of the person where ``auto``.
        axes: A name of :data:`AXES`, or three axes of the file such as ``x,-y,z``; this program's own where
            empty.
        names: A ready-made table of names, or a TOML file; see :mod:`devices.skeletons.name_tables`. Joints
            have this program's names where empty.
    """

    unit: Unit = "auto"
    axes: str = ""
    names: str = ""

    @property
    def about(self) -> dict[str, str]:
        """What a session records about its files."""
        about = {"axes": self.axes} if self.axes else {}
        if self.names:
            joints = {joint: list(map(list, of)) for joint, of in name_table(self.names).joints.items()}
            about["joint_names"] = json.dumps(joints)
        return about

    def refuse_for(self, path: Path) -> None:
        """Refuses axes and names for a file that is not a ``.csv``.

        Raises:
            DeviceError: Axes or names are stated; other formats define their own.
        """
        for option, stated in (("axes", self.axes), ("names", self.names)):
            if stated:
                raise DeviceError(f"{path}: --{option} {stated} is for .csv files; the format defines them.")

    def turned(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions (..., 3) of a file in the axes of a sensor.

        Raises:
            DeviceError: The axes are neither a name nor three different axes.
        """
        if not self.axes:
            return xyz
        parts = [part.strip() for part in AXES.get(self.axes.lower(), self.axes).lower().split(",")]
        found = [re.fullmatch(r"([+-]?)([xyz])", part) for part in parts]
        used = [match[2] for match in found if match is not None]
        if len(parts) != 3 or len(used) != 3:
            raise DeviceError(
                f"`axes={self.axes}`: neither {', '.join(AXES)}, nor three axes of the file such as x,-y,z, "
                "which are x (right), y (down) and z (forward)."
            )
        for axis in used:
            if used.count(axis) > 1:
                raise DeviceError(f"`axes={self.axes}` has {axis} twice: each of x, y and z is needed once.")
        signs = [-1.0 if part.startswith("-") else 1.0 for part in parts]
        return xyz[..., ["xyz".index(axis) for axis in used]] * signs

    def check_handed(self, name: object, body: Body, positions: NDArray[np.floating]) -> list[str]:
        """Refuses stated axes by which the person is a mirror image.

        Returns:
            A warning where nothing tells, because no frame of the (N, J, 3) positions has trunk and feet.

        Raises:
            DeviceError: The feet point to the wrong side in most frames.
        """
        share = mirrored_share(body, positions) if self.axes else 0.0
        if share is None:
            return [
                f"{name}: whether the person is a mirror image by `axes={self.axes}` is unknown, because it "
                "has no feet or no trunk. Raise the left arm, and see whether S* does."
            ]
        if share > MIRRORED:
            raise DeviceError(
                f"{name}: by `axes={self.axes}` the person is a mirror image, so the result is left-handed. "
                "Change the sign of one axis."
            )
        return []

    def points(self, name: object, labels: Sequence[str]) -> FilePoints:
        """The joints that the points of a file are.

        Raises:
            DeviceError: A name is no joint's, or the file lacks a point of the table.
        """
        try:
            if not self.names:
                body = body_of(set(labels))
                return FilePoints(body, {label: body.joint(label) for label in labels})
            table = name_table(self.names)
            body = _body_by(table, labels)
        except FusionError as error:
            raise DeviceError(f"{name}: {error}") from None
        groups = table.points_of(body, labels)
        if not groups:
            raise DeviceError(f"{name}: by {table.name} none of its points is a joint: {listed(labels)}.")
        return FilePoints(body, {label: k for k, label in enumerate(labels)}, groups)


UNSTATED = StatedFormat()
"""A file as this program defines it."""


def _body_by(table: NameTable, labels: Sequence[str]) -> Body:
    """Of the bodies that have all joints of a table, the one of which most are found in a file.

    A ready-made table has the joints of several bodies.
    """
    named = () if table.ready_made else table.joints
    fitting = [body for body in BODIES.values() if all(body.find(joint) is not None for joint in named)]
    return max(fitting or [body_of(set(named))], key=lambda body: len(table.points_of(body, labels)))


@dataclass(frozen=True, eq=False)
class FilePoints:
    """The points of a file, and the joints of a body that they are.

    Attributes:
        body: The body.
        index: Each point's index, by its name in the file.
        groups: The points whose mean is a joint, by joint; None if the points are the joints.
    """

    body: Body
    index: Mapping[str, int]
    groups: Mapping[int, Sequence[int]] | None = None

    def __len__(self) -> int:
        return len(self.body) if self.groups is None else len(self.index)

    def find(self, label: str) -> int | None:
        """The index of a point by its name in any spelling; None if it is none of these."""
        return self.body.find(label) if self.groups is None else self.index.get(label)

    def named(self, index: int) -> str:
        """The name of a point in messages."""
        return self.body.joints[index] if self.groups is None else list(self.index)[index]

    @property
    def left_out(self) -> list[str]:
        """Names of the points that are no joint's."""
        if self.groups is None:
            return []
        used = {k for points in self.groups.values() for k in points}
        return [label for label, k in self.index.items() if k not in used]

    def joints(
        self, positions: NDArray[np.float64], states: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Positions (N, J, 3) and states (N, J) of the joints from those of the points.

        A joint is tracked as its worst point is, and has no position where one of its points has none.
        """
        if self.groups is None:
            return positions, states
        at = np.full((len(positions), len(self.body), 3), np.nan)
        state = np.zeros((len(positions), len(self.body)), dtype=np.uint8)
        for joint, points in self.groups.items():
            at[:, joint] = positions[:, points].mean(axis=1)
            state[:, joint] = states[:, points].min(axis=1)
        return at, state
