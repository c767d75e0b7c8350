"""Fuses two recordings into what a session is made of; :mod:`recordings.file_fusion` makes the session."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from devices.depth.image_thinning import Depth
from devices.events import Event
from devices.pairing import pair_views
from devices.people.recorded_people import Follow, RecordedPeople
from devices.recorded.files import distinct_names, recorded_at
from devices.recorded.two_recordings import RecordingChoice, TwoRecordings, read_two
from devices.tracker_choice import TrackerChoice
from fusion.body import BODIES, Body
from fusion.calibration.calibration import Calibration
from fusion.compiling.kernels import WarmUp, compiles
from fusion.errors import CalibrationError
from fusion.estimator.duplex_fusion import compile_smoother
from fusion.facing import sequence
from fusion.facing.handedness import mirrored_share
from fusion.fuser import Fuser
from fusion.pair_arrays import View
from fusion.plan import RecordingPlan, plan_recording
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import checked_joints
from fusion.support.progress import Progress, quietly
from recordings.data.images import SessionImages
from recordings.data.session_arrays import SessionFrames
from recordings.errors import RecordingError, UnknownNameError
from recordings.fusing.pairs import Segments, block_count, calibration_event, fuse_segments, setups_of
from recordings.fusing.recording_images import RecordingImages
from recordings.fusing.view_events import watch

_UNRELATED = 0.2  # metres
_MOSTLY = 0.5
_LARGEST_OFFSET_MS = 1e12  # so that nanoseconds fit into 64 bits


class FusedRecordings(NamedTuple):
    """Two fused recordings: the arguments of :meth:`recordings.session.Session.of`."""

    fused: Sequence[tuple[FusionSetup, Iterable[SessionFrames]]]
    sources: tuple[str, str]
    events: Sequence[Event]  # those of the views come in while the frames are taken
    images: SessionImages
    about: Mapping[str, str | float]


def fuse_arrays(
    body: Body | str,
    time: ArrayLike,
    views: Sequence[tuple[ArrayLike, ArrayLike | None]],
    sources: tuple[str, str] = ("a", "b"),
    settings: FuserSettings | None = None,
    calibration: Calibration | None = None,
) -> FusedRecordings:
    """Fuses positions (T, J, 3) and states (T, J) of A and of B; see
    :meth:`recordings.session.Session.of_arrays`."""
    from devices.skeletons.border import impossible  # of files; others are read by the time they are fused

    if isinstance(body, str):
        if body not in BODIES:
            raise UnknownNameError("body", body, tuple(BODIES))
        body = BODIES[body]
    seconds = np.asarray(time, dtype=np.float64)
    time_ns = np.rint(1e9 * (seconds - seconds[:1])).astype(np.int64) if seconds.ndim == 1 else None
    if time_ns is None or not len(time_ns) or not np.isfinite(seconds).all() or (np.diff(time_ns) <= 0).any():
        raise RecordingError(
            f"`time` is (T,) seconds that increase, of at least one frame; got {seconds.shape} values."
        )
    read = []
    for side, (positions, states) in zip("ab", views, strict=True):
        at = np.array(positions, dtype=np.float64)
        if at.shape != (len(time_ns), len(body), 3):
            raise RecordingError(
                f"`positions_{side}` has the shape {at.shape}; {len(time_ns)} frames of {body.name} need "
                f"{(len(time_ns), len(body), 3)}."
            )
        stated = np.isfinite(at).all(axis=2)
        if stated.any() and impossible(at)[stated].mean() > _MOSTLY:
            raise RecordingError(
                f"`positions_{side}`: most joints are where no sensor sees. Positions are metres in the "
                "sensor's frame: x right, y down, z forward."
            )
        read.append(View(time_ns, *checked_joints(body, at, states, (len(time_ns),))))
    settings = settings or FuserSettings(hindsight="labels")
    pairing = pair_views(body, read[0], read[1], every_frame=settings.method == "duplex")
    read_both = TwoRecordings(body, pairing, (None, None), ())
    return fuse_read(read_both, sources, settings, calibration, refine=calibration is None)


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
        CalibrationError: There is no calibration, or the views differ too much; see :func:`check_related`.
    """
    skeletons = read.pairing.pairs.skeletons
    plan = plan_recording(read.body, skeletons, settings, calibration, refine, progress)
    names = distinct_names(*sources)
    if not force:
        check_related(read, plan, *names, calibrated=calibration is not None)
    segments = setups_of(plan, settings, read.cameras(depth))
    fused = fuse_segments(segments, read.pairing.pairs, plan.labels)
    times = skeletons.time_ns
    events = _events_of(read, plan, segments, times, dict(zip(sources, names, strict=True)))
    blocks = watch(read.body, progress(fused, "fusing", block_count(segments)), int(times[0]), events)
    frames = [(setup, islice(blocks, block_count([(setup, own)]))) for setup, own in segments]
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


def check_related(
    read: TwoRecordings, plan: RecordingPlan, a: str, b: str, *, calibrated: bool = False
) -> None:
    """Refuses recordings that cannot be of one person at one time.

    Args:
        calibrated: Whether a calibration was given, which may be that of another place of the sensors.

    Raises:
        CalibrationError: The views differ by more than 200 mm in the median. On 15 real pairs they differ by
            29 to 77 mm, with clocks 200 ms apart by 99 mm; 12 walks of different people by 248 mm and more.
    """
    if not plan.views_differ > _UNRELATED:
        return
    for name, view in zip((a, b), read.pairing.pairs.skeletons.views, strict=True):
        if (mirrored_share(read.body, view.positions) or 0.0) > _MOSTLY:
            raise CalibrationError(
                f"{name} is the mirror image of a person: state its axes with `axes`, or change the sign of "
                "x in it. `force` uses it as it is."
            )
    if calibrated:
        raise CalibrationError(
            f"The calibration does not fit {a} and {b}: the views differ by {1e3 * plan.views_differ:.0f} mm."
            " Leave it out if the sensors were moved; `force` fuses them all the same."
        )
    raise CalibrationError(
        f"{a} and {b} cannot be of one person at the same time: the views differ by "
        f"{1e3 * plan.views_differ:.0f} mm after the best registration. Check that they belong together, and "
        f"their clocks; `force` fuses them all the same. {read.question}"
    )


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
    if plan.clock is not None:
        about |= {"clock_offset_ms": plan.clock.offset_ns * 1e-6, "clock_sd_ms": plan.clock.sd_ns * 1e-6}
    return about


def _events_of(
    read: TwoRecordings,
    plan: RecordingPlan,
    segments: Segments,
    times: NDArray[np.int64],
    names: Mapping[str, str],
) -> list[Event]:
    """Returns calibrations, warnings and events of the learner, in time order.

    Args:
        names: By source: a session is opened elsewhere, and names no folders.
    """
    events = [calibration_event(setup, own, times - times[0]) for setup, own in segments]
    for text in read.warnings:
        for source, name in names.items():
            text = text.replace(source, name)
        events.append(Event(text, "WARN"))
    if plan.clock is not None:
        events.append(Event(plan.clock.event))
    for change in plan.changes:
        since_ns = change.since_ns if change.kind == "person" and change.since_ns else change.time_ns
        frame = min(int(np.searchsorted(times, since_ns)), len(times) - 1)
        event = Event(change.event, "WARN" if change.kind == "knocked" else "INFO")
        events.append(event.placed(frame, int(times[frame] - times[0])))
    return sorted(events, key=lambda event: event.frame)


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
