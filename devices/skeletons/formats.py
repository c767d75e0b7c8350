"""Formats that define their axes and names: offline_processor's JSON, NTU RGB+D's ``.skeleton``."""

import json
from collections.abc import Callable, Sequence
from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from devices.sensor import DeviceError
from devices.skeletons.read_file import FoundPoints, JointRows, found_of, text_bytes
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import KINECT_V2
from fusion.support.progress import Progress, quietly
from fusion.support.types import Array

FRAME_NS = 33_333_333
"""Frame interval of ``.skeleton`` files. They contain no times; the frame rate is 30 Hz."""
_NUMBERS = 12  # of a joint
_SENSOR_FROM_CAMERA_SPACE = np.array([-1.0, -1.0, 1.0, 1.0])  # which has x to the sensor's left and y up


def read_json(path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> FoundPoints:
    """Reads an offline_processor file, in millimetres. Every joint counts as tracked.

    Raises:
        DeviceError: The file is not JSON, is cut off, has another layout, or names an unknown joint.
    """
    del stated, progress
    text = text_bytes(path).decode("utf-8-sig")
    where = "the top level"
    try:
        document = json.loads(text)
        if not isinstance(document, dict):
            raise TypeError("it does not hold one object")
        names = [str(name) for name in document["joint_names"]]
        if not names or len(set(names)) < len(names):
            raise DeviceError(f"{path}: joint_names is empty or names a joint twice.")
        times, frames, people, places = [], [], [], []
        told: tuple[str, ...] = ()
        for number, frame in enumerate(document["frames"]):
            where = f"frame {number}"
            times.append(index(frame["timestamp_usec"]))
            for person in frame["bodies"]:
                frames.append(number)
                people.append(str(person["body_id"]))
                places.append(np.array(person["joint_positions"], dtype=np.float64).reshape(len(names), 3))
            count = frame.get("num_bodies", len(frame["bodies"]))
            if count != len(frame["bodies"]) and not told:
                told = (f"{path}: {where} states {count} bodies and has {len(frame['bodies'])}.",)
    except (json.JSONDecodeError, RecursionError, KeyError, TypeError, ValueError, OverflowError) as error:
        if not text.lstrip().startswith(("{", "[")):
            raise DeviceError(f"{path} is not JSON: it begins with {text[:40]!r}.") from None
        whole = "Extra data" in str(error) or not isinstance(error, (json.JSONDecodeError, RecursionError))
        if not whole or "digits" in str(error):  # a number may have too many
            raise DeviceError(f"{path} is not complete JSON: {error}. Was it cut off?") from None
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DeviceError(
            f"{path}, {where}: not as offline_processor writes it ({what}). Of another program, write a .csv "
            "with a row for each joint and frame: time_us,body,joint,x,y,z,confidence."
        ) from None
    at = np.pad(np.array(places).reshape(-1, len(names), 3), ((0, 0), (0, 0), (0, 1)), constant_values=2.0)
    return _found(path, "time_us", times, frames, people, names, at, told, unit="mm")


def read_skeleton(path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> FoundPoints:
    """Reads a ``.skeleton`` file.

    Raises:
        DeviceError: The file is empty or cut off, or has an invalid line; the message names the line.
    """
    del stated, progress
    lines = enumerate(text_bytes(path).decode("utf-8-sig").splitlines(), start=1)
    left = [(number, line.split()) for number, line in lines if line.strip()][::-1]
    at = 0

    def take(what: str, fits: Callable[[list[str]], bool]) -> list[str]:
        """The cells of the next line that is not blank."""
        nonlocal at
        if not left:
            raise DeviceError(f"{path} is cut off at line {at + 1}, where {what} is expected.")
        at, cells = left.pop()
        if not fits(cells):
            raise DeviceError(f"{path}, line {at}: expected {what}; got {' '.join(cells)[:60]!r}.")
        return cells

    def count(what: str) -> int:
        return int(take(f"the number of {what}", lambda cells: cells[0].isdecimal())[0])

    stated_count, number = count("frames"), 0
    frames, people, rows = list[int](), list[str](), list[list[str]]()
    while number < stated_count or left:
        for _ in range(count("bodies")):
            frames.append(number)
            people.append(take("a body", bool)[0])
            if (joints := count("joints")) != len(KINECT_V2):
                raise DeviceError(f"{path}, line {at}: a body has {joints} joints, not {len(KINECT_V2)}.")
            rows += [take("12 numbers of a joint, the last a state 0 to 2", _is_joint) for _ in range(joints)]
        number += 1
    told = [f"{path}: it states {stated_count} frames and has {number}; all were read."]
    values = np.array(rows, dtype=np.float64).reshape(-1, len(KINECT_V2), _NUMBERS)
    places = values[..., [0, 1, 2, -1]] * _SENSOR_FROM_CAMERA_SPACE
    times = range(0, number * FRAME_NS, FRAME_NS)
    told = told[: number - stated_count]
    return _found(path, "time_ns", times, frames, people, KINECT_V2.joints, places, told)


def _is_joint(cells: list[str]) -> bool:
    try:
        return len([float(cell) for cell in cells]) == _NUMBERS and float(cells[-1]) in (0, 1, 2)
    except ValueError:
        return False


def _found(
    path: Path, column: str, times: Sequence[int], frames: list[int], people: list[str],
    names: Sequence[str], at: Array, told: Sequence[str], **about: Any,
) -> FoundPoints:  # fmt: skip
    """The points of N people (N, J, 4), which are places and states, in the frames of these times."""
    ids = list(dict.fromkeys(people))
    each = np.repeat(np.array(frames, dtype=np.int64), len(names))
    person = np.repeat(np.array([ids.index(one) for one in people], dtype=np.int64), len(names))
    label, at = np.tile(np.arange(len(names)), len(frames)), at.reshape(-1, 4)
    rows = JointRows(
        path, column, np.array(times, dtype=np.int64), each, ids, person, names, label, at[:, :3],
        at[:, 3].astype(np.uint8), lambda row: f"in frame {each[row]}",
    )  # fmt: skip
    return found_of(rows, told=told, **about)
