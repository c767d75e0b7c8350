"""Creates the sensor for a recording's path, by the file's suffix."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from devices.azure.recording.mkv import MkvInfo, MkvRecording
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.azure.tracking.tracked_recording import RecordingWithSkeletons, TrackedRecording
from devices.depth_witness import with_witness
from devices.following import PersonChoice
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.skeletons.recording import SkeletonRecording

MKV = ".mkv"
FOLLOWED = "followed"
"""The id of the person that :func:`one_person` follows."""


def open_source(
    path: Path, skeletons: Path | None = None, tracker: TrackerSettings | None = None, option: str = ""
) -> Sensor:
    """Creates the sensor for a recording; opens nothing.

    An ``.mkv`` holds images, so its people come from the body tracker, or from skeletons saved before.

    Args:
        path: Recorded skeletons, or an Azure Kinect recording.
        skeletons: The skeletons of an Azure Kinect recording, saved before.
        tracker: How the body tracker runs, where it is needed.
        option: What the option that gives ``skeletons`` is called, for the message.

    Raises:
        DeviceError: Skeletons are given for a file that has its own.
    """
    if path.suffix.lower() != MKV:
        if skeletons is not None:
            raise DeviceError(f"{path.name} has its own skeletons; {option} {skeletons} is for an .mkv.")
        return SkeletonRecording(path)
    recording = MkvRecording(path, color=False)
    if skeletons is not None:
        return RecordingWithSkeletons(recording, SkeletonRecording(skeletons))
    tracker = tracker or TrackerSettings()
    return _NeedsTracker(recording, tracker, option)


def recording_info(source: Sensor) -> MkvInfo | None:
    """What an open ``.mkv`` says about itself; None for other sources."""
    recording = getattr(source, "recording", None)
    return recording.info if isinstance(recording, MkvRecording) else None


def without_images(source: Sensor) -> Iterator[SensorFrame]:
    """An open source's frames with their people only: an hour of them is some hundred MB, not 150 GB.

    What the depth images say about the joints stays with the skeletons.
    """
    for frame in source.frames():
        if source.intrinsics is not None:
            frame = with_witness(frame, source.intrinsics)
        yield replace(frame, depth=None, ir=None, color=None)


def one_person(frames: Iterable[SensorFrame]) -> Iterator[SensorFrame]:
    """The frames with only the person followed from the start, under one id regardless of the tracker's
    ids."""
    choice = PersonChoice()
    for frame in frames:
        person = choice.choose(frame.people, frame.time_ns)
        yield replace(frame, people={} if person is None else {FOLLOWED: person})


class _NeedsTracker(TrackedRecording):
    """A recording to be tracked, which knows the other way when there is no tracker."""

    def __init__(self, recording: MkvRecording, tracker: TrackerSettings, option: str) -> None:
        super().__init__(recording, tracker, _libk4a_beside(tracker.library))
        self._option = option

    def __enter__(self) -> TrackedRecording:
        with self.recording:
            pass  # report problems of the file itself first
        try:
            return super().__enter__()
        except DeviceError as fault:
            raise DeviceError(
                f"{fault} Or give its skeletons, saved before, with {self._option} FILE."
            ) from fault


def _libk4a_beside(libk4abt: Path | None) -> Path | None:
    """The Sensor SDK's library in the tracker's folder; None for the system's."""
    if libk4abt is None:
        return None
    names = ("libk4a.so.1.4", "libk4a.so", "k4a.dll")
    return next((libk4abt.with_name(name) for name in names if libk4abt.with_name(name).is_file()), None)
