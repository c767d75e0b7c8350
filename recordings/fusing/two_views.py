"""Fuses two paired views into what a session is made of, whatever they come from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from devices.pairing import Pairing
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import Surfaces
from fusion.errors import CalibrationError
from fusion.facing.handedness import mirrored_share
from fusion.intrinsics import Intrinsics
from fusion.plan import RecordingPlan, plan_recording
from fusion.setup import FuserSettings, FusionSetup
from fusion.support.progress import Progress, quietly
from recordings.data.images import SessionImages
from recordings.data.session_arrays import SessionFrames
from recordings.fusing.pairs import Segments, block_count, calibration_event, fuse_segments, setups_of
from recordings.fusing.view_events import watch

_UNRELATED = 0.2  # metres
MOSTLY = 0.5


Fused = Sequence[tuple[FusionSetup, Iterable[SessionFrames]]]


class FusedRecordings(NamedTuple):
    """Two fused recordings: the arguments of :meth:`recordings.session.Session.of`."""

    fused: Fused
    sources: tuple[str, str]
    events: Sequence[Event]  # those of the views come in while the frames are taken
    images: SessionImages
    about: Mapping[str, str | float]


def fuse_views(
    body: Body,
    pairing: Pairing,
    names: tuple[str, str],
    settings: FuserSettings,
    calibration: Calibration | None = None,
    *,
    refine: bool = True,
    cameras: tuple[Intrinsics | None, Intrinsics | None] = (None, None),
    warnings: Iterable[str] = (),
    question: str = "",
    force: bool = False,
    progress: Progress = quietly,
    surfaces: Surfaces | None = None,
) -> tuple[RecordingPlan, Fused, Sequence[Event]]:
    """Plans the fusion of paired views; they are fused while the frames are taken.

    Args:
        names: Of the sensors, K_A first.
        refine: Whether the calibration is refined over the whole recording.
        cameras: Intrinsics of the depth images of the session.
        warnings: About the recordings, one line each.
        question: Where the motion does not tell the clocks' offset, those that may be right.
        force: Whether to fuse views that cannot be of one person at one time.
        surfaces: Gives the depth images of recordings that have them.

    Returns:
        The plan, what :meth:`recordings.session.Session.of` takes, and its events.

    Raises:
        CalibrationError: There is no calibration, or the views differ by more than 200 mm in the median. On
            15 real pairs they differ by 29 to 77 mm, with clocks 200 ms apart by 99 mm; 12 walks of different
            people by 248 mm and more.
    """
    skeletons = pairing.pairs.skeletons
    plan = plan_recording(body, skeletons, settings, calibration, refine, progress, surfaces)
    if plan.views_differ > _UNRELATED and not force:
        raise CalibrationError(_why_unrelated(body, pairing, plan, names, calibration is not None, question))
    segments = setups_of(plan, settings, cameras)
    fused = fuse_segments(segments, pairing.pairs, plan.labels)
    times = skeletons.time_ns
    events = _events_of(plan, segments, times, warnings)
    blocks = watch(body, progress(fused, "fusing", block_count(segments)), int(times[0]), events)
    return plan, [(setup, islice(blocks, block_count([(setup, own)]))) for setup, own in segments], events


def clock_of(plan: RecordingPlan) -> dict[str, str | float]:
    """The properties of a session that say how much later B captures than it says."""
    if plan.clock is None:
        return {}
    return {"clock_offset_ms": plan.clock.offset_ns * 1e-6, "clock_sd_ms": plan.clock.sd_ns * 1e-6}


def _why_unrelated(
    body: Body, pairing: Pairing, plan: RecordingPlan, names: tuple[str, str], calibrated: bool, question: str
) -> str:
    """Why recordings cannot be of one person at one time."""
    a, b = names
    for name, view in zip(names, pairing.pairs.skeletons.views, strict=True):
        if (mirrored_share(body, view.positions) or 0.0) > MOSTLY:
            return (
                f"{name} is the mirror image of a person: state its axes with `axes`, or change the sign of "
                "x in it. `force` uses it as it is."
            )
    if calibrated:  # the calibration may be that of another place of the sensors
        return (
            f"The calibration does not fit {a} and {b}: the views differ by {1e3 * plan.views_differ:.0f} mm."
            " Leave it out if the sensors were moved; `force` fuses them all the same."
        )
    return (
        f"{a} and {b} cannot be of one person at the same time: the views differ by "
        f"{1e3 * plan.views_differ:.0f} mm after the best registration. Check that they belong together, and "
        f"their clocks; `force` fuses them all the same. {question}"
    )


def _events_of(
    plan: RecordingPlan, segments: Segments, times: NDArray[np.int64], warnings: Iterable[str]
) -> list[Event]:
    """Returns calibrations, warnings and events of the learner, in time order."""
    events = [calibration_event(setup, own, times - times[0]) for setup, own in segments]
    events += [Event(text, "WARN") for text in warnings]
    if plan.clock is not None:
        events.append(Event(plan.clock.event))
    for change in plan.changes:
        since_ns = change.since_ns if change.kind == "person" and change.since_ns else change.time_ns
        frame = min(int(np.searchsorted(times, since_ns)), len(times) - 1)
        event = Event(change.event, "WARN" if change.kind == "knocked" else "INFO")
        events.append(event.placed(frame, int(times[frame] - times[0])))
    return sorted(events, key=lambda event: event.frame)
