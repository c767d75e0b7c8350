"""Fuses two recordings into a session in memory, as ``duplex fuse`` does, without files or terminal
output."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import Depth
from devices.files import Progress, RecordingChoice, TwoRecordings, quietly, read_two
from devices.pairing import FramePair
from devices.skeletons.conventions import Unit
from devices.tracker_choice import WantedTracker, choose_tracker
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.plan import RecordingPlan, plan_recording
from fusion.setup import FuserSettings, FusionSetup, Hindsight
from recordings.events import Event
from recordings.fusing.exchanged_sides import exchange_events
from recordings.fusing.lost_limbs import limb_events
from recordings.images import RecordingImages
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
    unit: Unit = "auto",
    tracker: WantedTracker = "auto",
    depth: Depth = "full",
    hindsight: Hindsight = "labels",
    refine: bool = True,
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
            ``.csv``, ``.json``, ``.skeleton``, ``.mkv`` of an Azure Kinect, or ``.bag`` of Orbbec's SDK v2.
        calibration: An earlier calibration. None: calibrate on the start-up pose of the recordings, or on
            their calmest window if there is no such pose.
        settings: Settings of the method, except ``hindsight``.
        person_a, person_b: Ids of the person. None: the person seen longest in each recording.
        skeletons_a, skeletons_b: For an ``.mkv``: saved skeletons, used instead of the body tracker.
        unit: Unit of the positions of ``.csv`` files: ``m``, ``cm``, ``mm``, ``ft``, ``in``; ``auto``: found
            from the size of the person.
        tracker: The body tracker of images: ``k4abt``, Microsoft's; ``blazepose``, the program's own, whose
            networks ``duplex tracker fetch`` has fetched; ``auto``: k4abt where it works, else blazepose.
        depth: For an ``.mkv``: how many of its depth images the session contains.
        hindsight: How later frames are used; see :class:`fusion.setup.FuserSettings`.
        refine: Whether a calibration found here is refined over the whole recording.

    Raises:
        DeviceError: A recording cannot be read or tracked, the bodies differ, or they never overlap in time.
        FusionError: The views cannot be calibrated.
    """
    choices = (
        RecordingChoice(Path(a), _path(skeletons_a), person_a, unit, "skeletons_a", "person_a"),
        RecordingChoice(Path(b), _path(skeletons_b), person_b, unit, "skeletons_b", "person_b"),
    )
    read = read_two(*choices, choose_tracker(tracker))
    settings = replace(settings or FuserSettings(), hindsight=hindsight)
    pairs = read.pairing.pairs
    plan = plan_recording(
        read.body, [pair.skeletons for pair in pairs], settings, calibration, refine and calibration is None
    )
    segments = setups_of(plan, settings, read.cameras(depth))
    frames = list(fuse_segments(segments, pairs, plan.codes))
    return fused_session(read, plan, segments, frames, (str(a), str(b)), depth)


Segments = Sequence[tuple[FusionSetup, slice]]
"""The setups of successive parts of a recording."""


def setups_of(
    plan: RecordingPlan, settings: FuserSettings, cameras: tuple[Intrinsics | None, Intrinsics | None]
) -> Segments:
    """Returns the segments of a plan as setups with the settings and cameras."""
    return [(FusionSetup(calibration, settings, *cameras), own) for calibration, own in plan.segments]


def fuse_segments(
    segments: Segments, pairs: Sequence[FramePair], codes: NDArray[np.int64] | None = None
) -> Iterator[RecordedFrame]:
    """Fuses a recording with the calibration of each segment.

    The method ``duplex`` keeps its state from segment to segment; the paper's methods start each one anew.

    Args:
        segments: Segments in order, without gaps.
        pairs: Pairs of all segments.
        codes: (T, 2) exchange codes with doubt; None: found pair by pair.
    """
    fuser: Fuser | None = None
    for setup, own in segments:
        if fuser is None or setup.settings.method != "duplex":
            fuser = Fuser(setup)
        else:
            fuser.recalibrate(setup)
        known = None if codes is None else codes[own]
        if setup.settings.method == "duplex" and setup.settings.hindsight == "whole":
            before = time.perf_counter_ns()
            smoothed = fuser.smooth_sequence([pair.skeletons for pair in pairs[own]], known)
            each = (time.perf_counter_ns() - before) // max(len(smoothed), 1)
            for pair, fused in zip(pairs[own], smoothed, strict=True):
                yield RecordedFrame(pair, fused, each)
            continue
        for k, pair in enumerate(pairs[own]):
            yield fuse_one(fuser, pair, None if known is None else (int(known[k, 0]), int(known[k, 1])))


def fuse_one(fuser: Fuser, pair: FramePair, codes: tuple[int, int] | None = None) -> RecordedFrame:
    """Fuses a pair and measures the time; ``codes`` as in :meth:`fusion.fuser.Fuser.update`."""
    before = time.perf_counter_ns()
    fused = fuser.update(pair.skeletons, codes)
    return RecordedFrame(pair, fused, time.perf_counter_ns() - before)


def fused_session(
    read: TwoRecordings,
    plan: RecordingPlan,
    segments: Segments,
    frames: Sequence[RecordedFrame],
    sources: tuple[str, str],
    depth: Depth,
    progress: Progress = quietly,
) -> Session:
    """Returns the session of two fused recordings.

    Args:
        read: The recordings.
        plan: Plan of the recordings.
        segments: Setups with which they were fused.
        frames: Fused frames.
        sources: Names of the recordings.
        depth: How many depth images the session contains; they are read from the recordings on demand.
        progress: Shows the progress of reading the depth images.
    """
    first_ns = read.pairing.pairs[0].time_ns
    return Session.of(
        [(setup, frames[own]) for setup, own in segments],
        sources,
        events=[
            *_events_of(read, plan, segments, first_ns),
            *exchange_events((f.fused for f in frames), first_ns),
            *limb_events(read.body, frames, first_ns),
        ],
        images=RecordingImages(read, depth, progress),
        about={"tracker": read.tracker} if read.tracker else None,
    )


def _events_of(read: TwoRecordings, plan: RecordingPlan, segments: Segments, first_ns: int) -> list[Event]:
    """Returns calibrations, warnings and events of the learner, in time order."""
    pairs = read.pairing.pairs
    times = np.array([pair.time_ns for pair in pairs], dtype=np.int64)
    said = []
    for setup, own in segments:
        frame = max(own.start - 1, 0)
        said.append(
            Event(frame, pairs[frame].time_ns - first_ns, f"calibrated: {setup.calibration.how}", "INFO")
        )
    said += [Event(0, 0, text, "WARN") for text in read.warnings]
    if plan.clock is not None:
        said.append(Event(0, 0, plan.clock.event, "INFO"))
    for change in plan.changes:
        frame = min(int(np.searchsorted(times, change.time_ns)), len(pairs) - 1)
        said.append(Event(frame, pairs[frame].time_ns - first_ns, change.event, "WARN"))
    return sorted(said, key=lambda event: event.frame)


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
