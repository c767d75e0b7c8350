"""Fuses two recordings into what a session is made of; :mod:`recordings.file_fusion` makes the session."""

from __future__ import annotations

import json
from dataclasses import asdict

from devices.depth.image_thinning import Depth
from devices.pairing import pair_views
from devices.people.recorded_people import Follow, RecordedPeople
from devices.recorded.files import distinct_names, recorded_at
from devices.recorded.two_recordings import RecordingChoice, TwoRecordings, read_two
from devices.tracker_choice import TrackerChoice
from fusion.calibration.calibration import Calibration
from fusion.compiling.kernels import WarmUp, compiles
from fusion.errors import CalibrationError
from fusion.estimator.duplex_fusion import compile_smoother
from fusion.facing import sequence
from fusion.fuser import Fuser
from fusion.plan import RecordingPlan, plan_recording
from fusion.setup import FuserSettings
from fusion.support.progress import Progress, quietly
from recordings.fusing.recording_images import RecordingImages
from recordings.fusing.two_views import FusedRecordings, clock_of, fuse_views

_LARGEST_OFFSET_MS = 1e12  # so that nanoseconds fit into 64 bits


def fuse_read(
    read: TwoRecordings,
    sources: tuple[str, str],
    settings: FuserSettings,
    calibration: Calibration | None = None,
    refine: bool = True,
    depth: Depth = "none",
    force: bool = False,
    progress: Progress = quietly,
) -> FusedRecordings:
    """Plans the fusion of what two recordings hold; it is fused while the frames are taken.

    Args:
        sources: Names of the sensors, or their files, K_A first.
        refine: Whether the calibration is refined over the whole recording.
        depth: How many depth images the session contains; they are read from the recordings on demand.

    Raises:
        CalibrationError: See :func:`recordings.fusing.two_views.fuse_views`.
    """
    names = distinct_names(*sources)
    warnings = list(read.warnings)
    for source, name in zip(sources, names, strict=True):  # a session is opened elsewhere
        warnings = [text.replace(source, name) for text in warnings]
    plan, frames, events = fuse_views(
        *(read.body, read.pairing, names, settings, calibration),
        refine=refine,
        cameras=read.cameras(depth),
        warnings=warnings,
        question=read.question,
        force=force,
        progress=progress,
        surfaces=read.shared_surface if None not in read.images else None,
    )
    images = RecordingImages(read, depth, progress)
    return FusedRecordings(frames, names, events, images, _about(read, plan))


def read_for(
    settings: FuserSettings,
    choices: tuple[RecordingChoice, RecordingChoice],
    tracker: TrackerChoice | None,
    offset_ms: float | None = None,
    progress: Progress = quietly,
    follow: Follow = "longest",
) -> TwoRecordings:
    """Reads two recordings as a method takes them: ``duplex`` every frame, the paper's methods pairs.

    Args:
        choices, tracker, progress, follow: As for :func:`devices.recorded.two_recordings.read_two`.
        offset_ms: Added to the times of B. None: the method ``duplex`` finds it from the motion.

    Raises:
        CalibrationError: The offset is no number, or beyond 1e12 ms.
    """
    if offset_ms is not None and not abs(offset_ms) <= _LARGEST_OFFSET_MS:
        raise CalibrationError(
            f"The offset of the clocks is {offset_ms:g} ms; give at most 1e12 milliseconds."
        )
    duplex = settings.method == "duplex"
    found = None if duplex else 0
    offset_ns = found if offset_ms is None else round(1e6 * offset_ms)
    return read_two(*choices, tracker, progress, offset_ns=offset_ns, every_frame=duplex, follow=follow)


def _about(read: TwoRecordings, plan: RecordingPlan) -> dict[str, str | float]:
    """What a session keeps of its recordings: tracker, dropped frames, people, the clocks' offset."""
    about: dict[str, str | float] = {"tracker": read.tracker} if read.tracker else {}
    about |= read.stated.about
    if read.images[0] is not None and (recorded := recorded_at(read.images[0])):
        about["recorded"] = recorded
        pairs = read.pairing.pairs.skeletons
        # frames of A alone may be left out, and B may begin before A, of which is known when it was recorded
        if later_ns := int(pairs.time_ns[0] - pairs.views[0].time_ns[0]):
            about["seconds_before"] = 1e-9 * later_ns
    about |= {"dropped_a": read.pairing.dropped_a, "dropped_b": read.pairing.dropped_b}
    if read.people:
        about["people"] = json.dumps([asdict(person) for person in read.people])
        about["others_seen"] = read.others_seen
    if read.clock is not None:
        about |= {"clock_corrected_ms": read.clock.offset_ns * 1e-6}
    return about | clock_of(plan)


def recording_warm_ups(settings: FuserSettings, *others: WarmUp) -> tuple[list[WarmUp], list[WarmUp]]:
    """What two processes compile on a first run for whole recordings, and others."""
    first, second = Fuser.warm_ups(settings.method)
    if settings.method == "duplex":
        second.append(compile_plan)
    if settings.hindsight == "whole":
        first.append(compile_smoother)
    return first, [*second, *others]


@compiles(*sequence.KERNELS)
def compile_plan() -> None:
    """Compiles what :func:`fuse_read` calls before it fuses, by planning the fusion of simulated people."""
    from devices.simulated.kinect import simulated_pair

    sensors = simulated_pair(motion="still", seconds=3.0)[:2]
    people = (RecordedPeople.of(sensor.body, sensor.frames()) for sensor in sensors)
    a, b = (each.view(each.ids) for each in people)
    pairs = pair_views(sensors[0].body, a, b).pairs
    plan_recording(sensors[0].body, pairs.skeletons, FuserSettings(hindsight="labels"))
