"""Fuses pairs one after another, with the calibration of each part of a recording."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from devices.pairing import FramePair
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.plan import RecordingPlan
from fusion.setup import FuserSettings, FusionSetup
from recordings.session_arrays import SessionFrame

Segments = Sequence[tuple[FusionSetup, slice]]
"""The setups of successive parts of a recording."""


def setups_of(
    plan: RecordingPlan, settings: FuserSettings, cameras: tuple[Intrinsics | None, Intrinsics | None]
) -> Segments:
    """Returns the segments of a plan as setups with the settings and cameras."""
    return [(FusionSetup(calibration, settings, *cameras), own) for calibration, own in plan.segments]


def fuse_segments(
    segments: Segments, pairs: Sequence[FramePair], codes: NDArray[np.int64] | None = None
) -> Iterator[SessionFrame]:
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
                yield SessionFrame(pair, fused, each)
            continue
        for k, pair in enumerate(pairs[own]):
            yield fuse_one(fuser, pair, None if known is None else (int(known[k, 0]), int(known[k, 1])))


def fuse_one(fuser: Fuser, pair: FramePair, codes: tuple[int, int] | None = None) -> SessionFrame:
    """Fuses a pair and measures the time; ``codes`` as in :meth:`fusion.fuser.Fuser.update`."""
    before = time.perf_counter_ns()
    fused = fuser.update(pair.skeletons, codes)
    return SessionFrame(pair, fused, time.perf_counter_ns() - before)


def calibration_event(setup: FusionSetup, own: slice, time_ns: NDArray[np.int64]) -> Event:
    """Returns the event that a calibration takes effect, at the frame before its first.

    Args:
        setup: The setup with this calibration.
        own: The frames that it applies to.
        time_ns: (T,) time of the session's frames since the first pair.
    """
    frame = max(own.start - 1, 0)
    return Event(f"calibrated: {setup.calibration.how}").placed(frame, int(time_ns[frame]))
