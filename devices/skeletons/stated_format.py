"""What is stated about a file of skeletons: unit, axes and orientation, names; and what they are called."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from devices.sensor import DeviceError, Orientation
from fusion.support.types import Array

_EYE = np.eye(3)
MATRICES = np.array(
    [np.diag(s) @ _EYE[list(p)] for p in permutations(range(3)) for s in product((1, -1), repeat=3)]
)
"""(48, 3, 3) from a file's axes to the sensor's."""
SIGNED = tuple(
    ",".join("-" * int(row.sum() < 0) + "xyz"[np.abs(row).argmax()] for row in axes) for axes in MATRICES
)
"""Their names: which axes of a file are x (right), y (down) and z (forward), such as ``-x,-y,z``."""
Unit = Literal["auto", "m", "cm", "mm", "ft", "in"]
"""Unit of a file's positions; auto: found from the size of the person."""
METRES = MappingProxyType(
    {
        "m": (1.0, "metres"), "cm": (0.01, "centimetres"), "mm": (0.001, "millimetres"),
        "ft": (0.3048, "feet"), "in": (0.0254, "inches"),
    }
)  # fmt: skip
"""Metres per unit, and the unit's name."""
AXES = MappingProxyType({"kinect": "-x,-y,z", "unity": "x,-y,z", "opengl": "x,-y,-z", "ros": "-y,-z,x"})
"""The axes of other programs by name: which axes of a file are x (right), y (down) and z (forward).

Kinect is the SDK of Kinect v1 and v2. Unity's axes are left-handed, so that one changes its sign.
"""
OWN_AXES = "x,y,z"
ROLLED: MappingProxyType[str, Orientation] = MappingProxyType(
    {OWN_AXES: 0, "-y,x,z": 90, "-x,-y,z": 180, "y,-x,z": 270}
)
"""Degrees by which a sensor is turned clockwise that gives such axes."""


def matrix_of(axes: str) -> Array:
    return np.asarray(MATRICES[SIGNED.index(axes)])


def index_of(matrix: Array) -> int:
    return int(np.argmax((matrix == MATRICES).all(axis=(1, 2))))


def called_axes(axes: str) -> str:
    """The name of axes if they have one."""
    return next((name for name, signed in AXES.items() if signed == axes), axes)


def axes_in_words(axes: str) -> str:
    """Axes as a user states them, and what they are."""
    if axes == OWN_AXES:
        return "x right, y down, z forward, as seen from the sensor"
    rolled = f" (or a sensor that is turned clockwise by {ROLLED[axes]}°)" if axes in ROLLED else ""
    return f"the axes {called_axes(axes)}{rolled}"


@dataclass(frozen=True)
class StatedFormat:
    """What is stated about a file.

    Attributes:
        unit: Unit of the positions; found where ``auto``.
        axes: A name of :data:`AXES`, or three axes of the file such as ``x,-y,z``; found where empty.
        names: A ready-made table of names, or a TOML file; see :mod:`devices.skeletons.name_tables`.
            Found where empty.
        orientation: How the sensor is turned clockwise, in degrees; found with the axes where None.
        of_images: Whether these skeletons belong to images, in whose frame they are.
        side: Which of two files this is, ``a`` or ``b``, for messages; empty for a single one.
    """

    unit: Unit = "auto"
    axes: str = ""
    names: str = ""
    orientation: Orientation | None = None
    of_images: bool = False
    side: str = ""

    @property
    def about(self) -> dict[str, str]:
        """What a session records about its files."""
        about = {"axes": self.axes} if self.axes else {}
        if self.names:
            from devices.skeletons.name_tables import name_table

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

    @property
    def signed_axes(self) -> str:
        """The stated axes and orientation as one of :data:`.likelihood.SIGNED`; empty where not stated.

        Raises:
            DeviceError: The axes are neither a name nor three different axes.
        """
        if not self.axes and self.orientation is None:
            return OWN_AXES if self.of_images else ""
        signed = AXES.get(self.axes.lower(), self.axes.lower() or OWN_AXES).replace(" ", "").replace("+", "")
        if not re.fullmatch(r"-?[xyz],-?[xyz],-?[xyz]", signed):
            raise DeviceError(
                f"`axes={self.axes}`: neither {', '.join(AXES)}, nor three axes of the file such as x,-y,z, "
                "which are x (right), y (down) and z (forward)."
            )
        if signed not in SIGNED:
            twice = next(axis for axis in "xyz" if signed.count(axis) > 1)
            raise DeviceError(f"`axes={self.axes}` has {twice} twice: each of x, y and z is needed once.")
        rolled = next(axes for axes, degrees in ROLLED.items() if degrees == (self.orientation or 0))
        return SIGNED[index_of(matrix_of(rolled) @ matrix_of(signed))]

    def option(self, name: str, value: str = "") -> str:
        """An option of this file in a message."""
        return f"`{name}{self.side and '_'}{self.side}{value and '='}{value}`"


UNSTATED = StatedFormat()
"""A file of which nothing is stated."""
Units = Unit | tuple[Unit, Unit]
"""A unit of both files, or that of each."""
Texts = str | Path | tuple[str | Path, str | Path]
"""A text or file for both files, or that of each."""


def stated_of_both(unit: Units, axes: Texts, names: Texts) -> list[StatedFormat]:
    """What is stated about two files."""
    each = [of if isinstance(of, tuple) else (of, of) for of in (unit, axes, names)]
    return [StatedFormat(*map(str, of)) for of in zip(*each, strict=True)]  # type: ignore[arg-type]
