"""Creates the sensor for a recording's path, by the file's suffix."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from devices.azure.recording.mkv import MkvInfo, MkvRecording
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.azure.tracking.tracked_recording import RecordingWithSkeletons, TrackedRecording
from devices.blazepose.tracked_images import TrackedImages
from devices.depth_witness import with_witness
from devices.following import PersonChoice
from devices.orbbec.playback import SUFFIX as BAG
from devices.orbbec.playback import OrbbecRecording
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.skeletons.conventions import Unit
from devices.skeletons.recording import SkeletonRecording
from devices.tracker_choice import TrackerChoice, choose_tracker

MKV = ".mkv"
FOLLOWED = "followed"
"""The id of the person that :func:`one_person` follows."""


def open_source(
    path: Path,
    skeletons: Path | None = None,
    tracker: TrackerChoice | None = None,
    option: str = "",
    unit: Unit = "auto",
) -> Sensor:
    """Creates the sensor for a recording; opens nothing.

    An ``.mkv`` or ``.bag`` holds images, so its people come from a body tracker; an ``.mkv``'s may come from
    skeletons saved before.

    Args:
        path: Recorded skeletons, an Azure Kinect recording, or a recording of Orbbec's SDK v2.
        skeletons: The skeletons of an Azure Kinect recording, saved before.
        tracker: The body tracker, where one is needed. None: chosen for this machine.
        option: What the option that gives ``skeletons`` is called, for the message.
        unit: Unit of the positions of a ``.csv``; found from the size of the person where ``auto``.

    Raises:
        DeviceError: Skeletons for a file that has its own, or a tracker that cannot take its images.
    """
    if not has_images(path):
        if skeletons is not None:
            raise DeviceError(f"{path.name} has its own skeletons; {option} {skeletons} is for an .mkv.")
        return SkeletonRecording(path, unit)
    images = open_images(path)
    if skeletons is not None:
        if not isinstance(images, MkvRecording):
            raise DeviceError(f"{option} {skeletons} is for an .mkv; {path.name} is tracked.")
        return RecordingWithSkeletons(images, SkeletonRecording(skeletons, unit))
    tracker = (tracker or choose_tracker()).for_images_of(not_of_libk4a(path))
    if tracker.name == "blazepose" or not isinstance(images, MkvRecording):
        return TrackedImages(images, tracker.blazepose)
    return _NeedsTracker(images, tracker.k4abt, option)


def has_images(path: Path) -> bool:
    """Whether a recording holds images, by its suffix; else it holds skeletons."""
    return path.suffix.lower() in (MKV, BAG)


def not_of_libk4a(*paths: Path) -> list[str]:
    """The names of those recordings whose images are not libk4a's."""
    return [path.name for path in paths if path.suffix.lower() == BAG]


def open_images(path: Path) -> MkvRecording | OrbbecRecording:
    """Creates the sensor for a recording's images, without people; opens nothing."""
    return OrbbecRecording(path) if path.suffix.lower() == BAG else MkvRecording(path, color=False)


def recording_info(source: Sensor) -> MkvInfo | None:
    """What an open ``.mkv`` says about itself; None for other sources."""
    recording = _images_of(source)
    return recording.info if isinstance(recording, MkvRecording) else None


def frame_count(source: Sensor) -> int | None:
    """About how many frames an open recording has, for a progress bar; None where it does not say."""
    recording = _images_of(source)
    info = recording.info if isinstance(recording, MkvRecording) else recording
    if not isinstance(info, MkvInfo | OrbbecRecording) or not info.duration_ns:
        return None
    return info.duration_ns // info.interval_ns + 1


def _images_of(source: Sensor) -> object:
    return source.source if isinstance(source, TrackedImages) else getattr(source, "recording", None)


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
