"""Fuses pairs one after another, with the calibration of each part of a recording."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from devices.frame_pairs import FramePair, RecordedPairs
from fusion.facing.labels import Labels
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from fusion.support.large_arrays import parts
from recordings.data.session_arrays import PairBlock, SessionFrame, SessionFrames

if TYPE_CHECKING:
    from fusion.plan import RecordingPlan

_BLOCK = 256  # pairs that are fused in one compiled loop
Segments = Sequence[tuple[FusionSetup, slice]]
"""The setups of successive parts of a recording."""


def setups_of(
    plan: RecordingPlan, settings: FuserSettings, cameras: tuple[Intrinsics | None, Intrinsics | None]
) -> Segments:
    """Returns the segments of a plan as setups with the settings and cameras."""
    return [(FusionSetup(calibration, settings, *cameras), own) for calibration, own in plan.segments]


def block_count(segments: Segments) -> int:
    """How many blocks :func:`fuse_segments` yields."""
    return sum(-((own.start - own.stop) // _block_size(setup, own)) for setup, own in segments)


def _block_size(setup: FusionSetup, own: slice) -> int:
    """The number of pairs that are fused at once: all of them where later ones count."""
    return max(own.stop - own.start, 1) if _smooths(setup) else _BLOCK


def _smooths(setup: FusionSetup) -> bool:
    return setup.settings.method == "duplex" and setup.settings.hindsight == "whole"


def fuse_segments(
    segments: Segments, pairs: RecordedPairs, labels: Labels | None = None
) -> Iterator[SessionFrames]:
    """Fuses a recording with the calibration of each segment, and yields block after block.

    The method ``duplex`` keeps its state from segment to segment; the paper's methods start each one anew.

    Args:
        segments: Segments in order, without gaps.
        labels: Of all pairs; None: found pair by pair.
    """
    fuser: Fuser | None = None
    for setup, own in segments:
        if fuser is None or setup.settings.method != "duplex":
            fuser = Fuser(setup)
        else:
            fuser.recalibrate(setup)
        fuse = fuser.smooth_sequence if _smooths(setup) else fuser.fuse_sequence
        for part in parts(own.stop - own.start, _block_size(setup, own)):
            own_part = slice(own.start + part.start, own.start + part.stop)
            before, block = time.perf_counter_ns(), pairs.skeletons[own_part]
            fused = fuse(block, None if labels is None else labels.rows(own_part))
            each = (time.perf_counter_ns() - before) // len(fused)
            a, b = (view.chosen(block.frames[:, k]) for k, view in enumerate(block.views))
            blocks = PairBlock(block.time_ns, block.skew_ns, a, b)
            yield SessionFrames(blocks, fused, each, pairs, own_part.start, _depth_errors(setup))


def fuse_one(fuser: Fuser, pair: FramePair) -> SessionFrame:
    """Fuses a pair and measures the time."""
    before = time.perf_counter_ns()
    fused = fuser.update(pair.skeletons)
    each = time.perf_counter_ns() - before
    return SessionFrame(pair, fused, each, depth_errors=_depth_errors(fuser.setup))


def _depth_errors(setup: FusionSetup) -> NDArray[np.float64] | None:
    errors = setup.calibration.depth_errors
    return errors if errors.any() else None


def calibration_event(setup: FusionSetup, own: slice, time_ns: NDArray[np.int64]) -> Event:
    """Returns the event that a calibration takes effect, at the frame before its first.

    Args:
        time_ns: (T,) time of the session's frames since the first pair.
    """
    frame = max(own.start - 1, 0)
    return Event(f"calibrated: {setup.calibration.how}").placed(frame, int(time_ns[frame]))
