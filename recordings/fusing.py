"""Fuses two recordings into a session in memory, as ``duplex fuse`` does, without files or terminal
output."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from devices.image_thinning import Depth
from devices.pairing import FramePair
from devices.two_recordings import Progress, RecordingChoice, TwoRecordings, quietly, read_two
from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.events import Event
from recordings.images.session_images import RecordingImages
from recordings.session import Session
from recordings.session_arrays import RecordedFrame


def fuse(
    a: str | Path,
    b: str | Path,
    *,
    calibration: Calibration | None = None,
    settings: FuserSettings | None = None,
    person_a: str | None = None,
    person_b: str | None = None,
    skeletons_a: str | Path | None = None,
    skeletons_b: str | Path | None = None,
    depth: Depth = "full",
) -> Session:
    """Fuses two recordings of one capture.

    >>> from recordings import fuse
    >>> session = fuse("a.csv", "b.csv")
    >>> session.fused.shape
    (120, 20, 3)

    This function writes no file. :meth:`recordings.session.Session.save` writes what ``duplex fuse --save``
    writes, except the advice of the set-up coach.

    Args:
        a, b: Recordings of the principal sensor K_A, in whose frame S* is, and of the secondary one K_B:
            ``.csv``, ``.json``, ``.skeleton``, or ``.mkv`` of an Azure Kinect.
        calibration: An existing calibration. None: calibrate from the recordings, on the start-up pose if
            there is one.
        settings: Settings of the method.
        person_a, person_b: Ids of the person in each recording. None: the person seen longest.
        skeletons_a, skeletons_b: For an ``.mkv``: files of saved skeletons, used instead of the body tracker.
        depth: For an ``.mkv``: which depth images the session has.

    Raises:
        DeviceError: A recording cannot be read or tracked, the bodies differ, or they never overlap in time.
        FusionError: The views cannot be calibrated.
    """
    choices = (
        RecordingChoice(Path(a), _path(skeletons_a), person_a, "skeletons_a", "person_a"),
        RecordingChoice(Path(b), _path(skeletons_b), person_b, "skeletons_b", "person_b"),
    )
    read = read_two(*choices)
    pairs = read.pairing.pairs
    found = calibration or calibration_of(read.body, [pair.skeletons for pair in pairs])
    setup = FusionSetup(found, settings, *read.cameras(depth))
    fuser = Fuser(setup)
    return fused_session(read, setup, [fuse_one(fuser, pair) for pair in pairs], (str(a), str(b)), depth)


def calibration_of(body: Body, pairs: Sequence[SkeletonPair]) -> Calibration:
    """Calibrates on the start-up pose of a recording, or on its calmest window if there is no such pose.

    Raises:
        CalibrationError: No frame shows a person to both sensors, or the views cannot be registered.
    """
    chosen, how = find_start_up_pose(body, pairs)
    return calibrate(body, chosen, how)


def fuse_one(fuser: Fuser, pair: FramePair) -> RecordedFrame:
    """Fuses a pair and measures the duration."""
    before = time.perf_counter_ns()
    fused = fuser.update(pair.skeletons)
    return RecordedFrame(pair, fused, time.perf_counter_ns() - before)


def fused_session(
    read: TwoRecordings,
    setup: FusionSetup,
    frames: Sequence[RecordedFrame],
    sources: tuple[str, str],
    depth: Depth,
    progress: Progress = quietly,
) -> Session:
    """Returns the session of two fused recordings.

    Args:
        read: The recordings.
        setup: The setup used for the fusion.
        frames: The fused frames.
        sources: Names of the recordings.
        depth: Which depth images the session has. They are read from the recordings on demand.
        progress: Shows the progress of reading the images.
    """
    messages = [(f"calibrated: {setup.calibration.how}", "INFO"), *((text, "WARN") for text in read.warnings)]
    return Session.of(
        [(setup, frames)],
        sources,
        events=[Event(0, 0, text, level) for text, level in messages],
        images=RecordingImages(read, depth, progress),
    )


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
