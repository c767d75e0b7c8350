"""Reads JSON of Microsoft's ``offline_processor`` sample: skeletons in millimetres, without confidences."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError
from devices.skeletons.read_file import FoundPoints, JointRows, found_of, text_bytes
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.skeleton import TrackingState
from fusion.support.progress import Progress, quietly


def read_json(path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> FoundPoints:
    """Reads an offline_processor file. Every joint counts as tracked.

    Raises:
        DeviceError: The file is not JSON, is cut off, has another layout, or names an unknown joint.
    """
    stated.refuse_for(path)
    del progress
    text = text_bytes(path).decode("utf-8-sig")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:  # a number may have too many digits
        if not text.lstrip().startswith(("{", "[")):
            raise DeviceError(f"{path} is not JSON: it begins with {text[:40]!r}.") from None
        if "Extra data" not in str(error):
            hint = " Was it cut off?" if isinstance(error, json.JSONDecodeError) else ""
            raise DeviceError(f"{path} is not complete JSON: {error}.{hint}") from None
        document = None
    where = "the top level"
    try:
        if not isinstance(document, dict):
            raise TypeError("it does not hold one object")
        names = [str(name) for name in document["joint_names"]]
        if not names or len(set(names)) < len(names):
            raise DeviceError(f"{path}: joint_names is empty or names a joint twice.")
        times, frames, people, places = [], [], [], []
        told: tuple[str, ...] = ()
        for number, frame in enumerate(document["frames"]):
            where = f"frame {number}"
            times.append(_time(frame["timestamp_usec"]))
            for person in frame["bodies"]:
                frames.append(number)
                people.append(str(person["body_id"]))
                places.append(_places(person["joint_positions"], len(names)))
            count = frame.get("num_bodies", len(frame["bodies"]))
            if count != len(frame["bodies"]) and not told:
                told = (f"{path}: {where} states {count} bodies and has {len(frame['bodies'])}.",)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DeviceError(
            f"{path}, {where}: not as offline_processor writes it ({what}). Of another program, write a .csv "
            "with a row for each joint and frame: time_us,body,joint,x,y,z,confidence."
        ) from None
    ids, person = np.unique(people, return_inverse=True)
    order = np.argsort(np.unique(people, return_index=True)[1])  # in that of the file
    each = np.repeat(np.array(frames, dtype=np.int64), len(names))
    rows = JointRows(
        path, "time_us", np.array(times, dtype=np.int64), each, ids[order].tolist(),
        np.repeat(np.argsort(order)[person], len(names)), names, np.tile(np.arange(len(names)), len(frames)),
        np.array(places).reshape(-1, 3), np.full(len(each), TrackingState.TRACKED, dtype=np.uint8),
        lambda row: f"in frame {each[row]}", "timestamp_usec",
    )  # fmt: skip
    return found_of(rows, told=told, unit="mm")


def _time(time_us: Any) -> int:
    if isinstance(time_us, bool) or not isinstance(time_us, int):
        raise ValueError(f"timestamp_usec must be a whole number; it is {time_us!r}")
    if abs(time_us) > np.iinfo(np.int64).max:
        raise ValueError(f"timestamp_usec {time_us} has more than 64 bits")
    return time_us


def _places(given: Any, count: int) -> NDArray[np.float64]:
    try:
        places = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("joint_positions must be numbers, three per joint") from None
    if places.shape != (count, 3):
        raise ValueError(f"joint_positions has shape {places.shape}, not ({count}, 3)")
    return places
