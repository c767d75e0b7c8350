"""Reads JSON of Microsoft's ``offline_processor`` sample: skeletons in millimetres, without confidences."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from devices.sensor import DeviceError, SensorFrame
from devices.skeletons.csv_file import LATEST_US
from devices.skeletons.read_file import ReadFile, in_time_order, text_bytes
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import Body, body_of
from fusion.errors import FusionError
from fusion.progress import Progress, quietly
from fusion.skeleton import Skeleton


def read_json(path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> ReadFile:
    """Reads an offline_processor file. Every joint counts as tracked; positions are always millimetres.

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
        hint = " Was it cut off?" if isinstance(error, json.JSONDecodeError) else ""
        raise DeviceError(f"{path} is not complete JSON: {error}.{hint}") from None
    where = "the top level"
    try:
        if not isinstance(document, dict):
            raise TypeError(f"it holds a {type(document).__name__}, not an object")
        names = [str(name) for name in document["joint_names"]]
        body = body_of(set(names))
        joint = np.array([body.joint(name) for name in names], dtype=np.int64)
        if len(names) == 0 or len(set(joint.tolist())) < len(names):
            raise DeviceError(f"{path}: joint_names is empty or names a joint twice.")
        frames = []
        for number, frame in enumerate(document["frames"]):
            where = f"frame {number}"
            frames.append(_frame(frame, body, joint))
    except FusionError as error:
        raise DeviceError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DeviceError(f"{path}, {where}: not as offline_processor writes it ({what}).") from None
    return ReadFile(body, *in_time_order(path, body, frames))


def _frame(frame: dict[str, Any], body: Body, joint: np.ndarray[Any, np.dtype[np.int64]]) -> SensorFrame:
    time_us = frame["timestamp_usec"]
    if isinstance(time_us, bool) or not isinstance(time_us, int):
        raise ValueError(f"timestamp_usec must be a whole number; it is {time_us!r}")
    if abs(time_us) > LATEST_US:
        raise ValueError(f"timestamp_usec {time_us} is beyond {LATEST_US}")
    time_ns = time_us * 1000
    people = {}
    for person in frame["bodies"]:
        try:
            given = np.array(person["joint_positions"], dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError("joint_positions must be numbers, three per joint") from None
        if given.shape != (len(joint), 3):
            raise ValueError(f"joint_positions has shape {given.shape}, not ({len(joint)}, 3)")
        positions = np.full((len(body), 3), np.nan)
        positions[joint] = given * 1e-3
        people[str(person["body_id"])] = Skeleton.of(body, positions, None, time_ns)
    return SensorFrame(time_ns, people)
