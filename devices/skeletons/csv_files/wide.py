"""Files with one row per person and frame, and columns such as HEAD_x, HEAD_y and HEAD_z for each joint."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from devices.skeletons.csv_files.states import StateColumn
from devices.skeletons.name_tables import name_table, plain
from fusion.body import BODIES

_SPACE = r"(?:joint|position|pos|camera|world|p)*"
_LENGTH = r"(?:m|cm|mm|metres?|meters?)?"
AXES = {axis: rf"{_SPACE}{axis}{_LENGTH}" for axis in "xyz"}
"""Spellings of a column of coordinates, without case and punctuation."""
_FEWEST = 5  # joints; fewer may be those of another table


class Wide(NamedTuple):
    """The columns of a file that contain joints, by number.

    Attributes:
        names: Of all columns, as in the file.
        joints: In the order of their last columns.
        numbers: By the column that they become, x, y, z or a column of states: each joint's column.
    """

    names: Sequence[str]
    joints: Sequence[str]
    numbers: Mapping[str, Sequence[int]]

    def long(self, table: pa.Table, shared: Sequence[str]) -> pa.Table:
        """One row per joint: those of the first row of a table come first.

        The last column of the file stays the last one, so that a file that is cut off can be recognised.

        Args:
            table: All columns of the file, of any number of rows.
            shared: Names of the columns that each joint repeats.
        """
        rows, joints = table.num_rows, len(self.joints)
        row = np.repeat(np.arange(rows), joints)
        by_row = np.arange(joints * rows).reshape(joints, rows).T.ravel()
        made = {name: table[name].take(row) for name in shared}
        joint = pa.array(self.joints, pa.string()).take(np.tile(np.arange(joints), rows))
        for name, numbers in sorted(self.numbers.items(), key=lambda item: item[1][-1]):
            chunks = [chunk for number in numbers for chunk in table.column(number).chunks]
            made[name] = pa.concat_arrays(chunks).take(by_row)
        ends_with_joint = any(numbers[-1] == table.num_columns - 1 for numbers in self.numbers.values())
        return pa.table({"joint": joint, **made} if ends_with_joint else {**made, "joint": joint})


def find_wide(names: Sequence[str], table: str) -> Wide | None:
    """Finds the columns of each joint by their names; None if fewer than five joints have x, y and z.

    Args:
        names: Of the columns.
        table: Of further names; see :mod:`devices.skeletons.name_tables`. Empty: none.
    """
    known = {plain(joint): joint for body in BODIES.values() for joint in body.joints}
    for points in (each for of in name_table(table).joints.values() for each in of) if table else ():
        known |= {plain(point): point for point in points}
    longest_first = "|".join(sorted(known, key=len, reverse=True))
    of_joint = re.compile(rf"(?:k4abtjoint|mixamorig\d*)?({longest_first})(.+)")
    found: dict[tuple[str, str], dict[str, int]] = {}  # spelling, axis or state → joint → column
    for number, name in enumerate(names):
        if match := of_joint.fullmatch(plain(name)):
            joint, rest = match.groups()
            axis = next((axis for axis, spelled in AXES.items() if re.fullmatch(spelled, rest)), "")
            kind = (rest.replace(axis, ""), axis) if axis else ("", "confidence" if rest == "c" else rest)
            found.setdefault(kind, {}).setdefault(joint, number)
    places = [[found.get((spelling, axis), {}) for axis in AXES] for spelling, axis in found if axis == "x"]
    complete = [[joint for joint in x if joint in y and joint in z] for x, y, z in places]
    joints, axes = max(zip(complete, places, strict=True), key=lambda of: len(of[0]), default=([], []))
    if len(joints) < _FEWEST:
        return None
    columns = dict(zip(AXES, axes, strict=True))
    columns |= {
        name: of for (_, name), of in found.items() if StateColumn.is_like(name) and set(joints) <= of.keys()
    }
    joints.sort(key=lambda joint: max(of[joint] for of in columns.values()))
    numbers = {name: [of[joint] for joint in joints] for name, of in columns.items()}
    return Wide(names, [known[joint] for joint in joints], numbers)
