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

_BLOCK = 256  # pairs that are fused in one compiled loop
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
        smooth = setup.settings.method == "duplex" and setup.settings.hindsight == "whole"
        fuse = fuser.smooth_sequence if smooth else fuser.fuse_sequence
        step = own.stop - own.start if smooth else _BLOCK
        for first in range(own.start, own.stop, max(step, 1)):
            block = slice(first, min(first + step, own.stop))
            before = time.perf_counter_ns()
            skeletons = [pair.skeletons for pair in pairs[block]]
            fused = fuse(skeletons, None if codes is None else codes[block])
            each = (time.perf_counter_ns() - before) // len(skeletons)
            for pair, frame in zip(pairs[block], fused, strict=True):
                yield SessionFrame(pair, frame, each)


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
