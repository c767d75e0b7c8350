"""Opens a recording on disk as a sensor. A vendor's modules are imported when its file is opened."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from devices.sensor import (
    BAG,
    DB3,
    IMAGE_SUFFIXES,
    DeviceError,
    ImageRecording,
    Orientation,
    Sensor,
    SensorFrame,
    SensorWrapper,
)
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from devices.tracker_choice import TrackerChoice, choose_tracker
from fusion.support.progress import Progress, quietly


def open_source(
    path: Path,
    skeletons: Path | None = None,
    tracker: TrackerChoice | None = None,
    option: str = "",
    stated: StatedFormat = UNSTATED,
    progress: Progress = quietly,
    orientation: Orientation | None = None,
) -> Sensor:
    """Creates the sensor for a recording; opens nothing.

    An ``.mkv``, ``.bag`` or ``.db3`` contains images, so its people come from a body tracker. Those of an
    ``.mkv`` may come from saved skeletons instead.

    Args:
        path: Recorded skeletons, or a recording of an Azure Kinect, of Orbbec's SDK v2 or of a RealSense
            sensor.
        skeletons: Saved skeletons of an Azure Kinect recording.
        tracker: The body tracker, if one is needed. None: chosen for this machine.
        option: Name of the option that gives ``skeletons``, for messages; empty without one.
        stated: What is stated about a file of skeletons.
        progress: Shows the progress of reading a ``.csv``.
        orientation: Of the sensor; see :mod:`devices.upright`. None: not stated.

    Raises:
        DeviceError: Skeletons are given for a file without images, or the tracker cannot
            use its images.
    """
    if not has_images(path):
        if skeletons is not None:
            raise DeviceError(f"{path.name} has its own skeletons; {option} {skeletons} is for an .mkv.")
        return SkeletonRecording(path, replace(stated, orientation=orientation), progress)
    from devices.upright import upright

    if skeletons is not None:
        if not_of_libk4a(path):
            raise DeviceError(f"{option} {skeletons} is for an .mkv; {path.name} is tracked.")
        from devices.azure.mkv import MkvRecording
        from devices.azure.tracking.tracked_recording import RecordingWithSkeletons

        in_images = replace(stated, of_images=True)
        return upright(
            RecordingWithSkeletons(MkvRecording(path), SkeletonRecording(skeletons, in_images)),
            orientation or 0,
        )
    stated.refuse_for(path)
    tracker = (tracker or choose_tracker()).for_images_of(not_of_libk4a(path))
    if tracker.name == "blazepose":
        from devices.blazepose.tracked_images import TrackedImages

        return TrackedImages(upright(open_images(path), orientation or 0), tracker.blazepose)
    from devices.azure.mkv import MkvRecording
    from devices.azure.tracking.tracked_recording import TrackedRecording

    otherwise = f" Or give its skeletons, saved before, with {option} FILE." if option else ""
    settings = replace(tracker.k4abt, orientation=orientation or 0)
    return upright(TrackedRecording(MkvRecording(path), settings, otherwise=otherwise), orientation or 0)


def has_images(path: Path) -> bool:
    """Whether a recording holds images, by its suffix; else it holds skeletons."""
    return path.suffix.lower() in IMAGE_SUFFIXES


def not_of_libk4a(*paths: Path) -> list[str]:
    """The names of those recordings whose images are not libk4a's."""
    return [path.name for path in paths if path.suffix.lower() in (BAG, DB3)]


def open_images(path: Path) -> ImageRecording:
    """Creates the sensor for a recording's images, without people; opens nothing."""
    suffix = path.suffix.lower()
    if suffix not in (BAG, DB3):
        from devices.azure.mkv import MkvRecording

        return MkvRecording(path)
    from devices.orbbec.playback import OrbbecRecording
    from devices.realsense.sensors import RealSenseRecording, is_realsense_bag
    from devices.recorded.recording_apart import RecordingApart

    realsense = suffix == DB3 or is_realsense_bag(path)
    return RecordingApart(path, RealSenseRecording if realsense else OrbbecRecording)


def recorded_at(path: Path) -> str:
    """When images were recorded, ISO 8601; empty if the file does not say."""
    if path.suffix.lower() != ".mkv":
        return ""
    from devices.azure.mkv import MkvRecording

    with MkvRecording(path) as recording:
        return "" if recording.info is None else recording.info.recorded


def depth_offset(path: Path) -> float:
    """The ``depth_offset`` of the sensor of a recording; 0 where the file does not say which it was."""
    if path.suffix.lower() != ".mkv":
        return 0.0
    from devices.azure.mkv import MkvRecording

    with MkvRecording(path) as recording:
        return recording.depth_offset


def distinct_names(a: str, b: str) -> tuple[str, str]:
    """The names of two files, with as many of their folders as tell them apart; other names as they are."""
    one, other = (re.split(r"[/\\]", name) for name in (a, b))
    for parts in range(1, max(len(one), len(other)) + 1):
        if one[-parts:] != other[-parts:]:
            return "/".join(one[-parts:]), "/".join(other[-parts:])
    return one[-1], other[-1]


def frame_count(source: Sensor) -> int | None:
    """About how many frames an open recording has, for a progress bar; None if it does not say."""
    images = images_of(source)
    if not isinstance(images, ImageRecording) or not images.duration_ns:
        return None
    return images.duration_ns // images.interval_ns + 1


def frame_interval_ns(source: Sensor) -> int | None:
    """Time between two frames of an open recording; None for another sensor, or a recording of one frame."""
    recording = images_of(source)
    if isinstance(recording, SkeletonRecording):
        steps = np.diff(recording.people.time_ns)
        return int(np.median(steps)) if len(steps) else None
    return recording.interval_ns if isinstance(recording, ImageRecording) else None


def images_of(source: Sensor) -> Sensor:
    """The sensor or recording behind a body tracker, saved skeletons or an orientation."""
    while isinstance(source, SensorWrapper):
        source = source.source
    return source


def without_images(source: Sensor) -> Iterator[SensorFrame]:
    """An open source's frames with their people only: an hour of them is some hundred MB, not 150 GB.

    What the depth images say about the joints stays with the skeletons.
    """
    from devices.depth.witness import with_witness

    for frame in source.frames():
        if source.intrinsics is not None:
            frame = with_witness(frame, source.intrinsics)
        yield replace(frame, depth=None, ir=None, color=None)
