"""The loop for sensors that run: pair, calibrate when there is something to calibrate on, fuse, record."""

from __future__ import annotations

import gc
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.image_thinning import Depth, with_depth, without_images
from devices.live.sensor_pair import TwoSensors
from fusion.calibration.calibrator import Calibrator
from fusion.setup import FusionSetup
from recordings.live_fusing import LiveFusion
from recordings.session_arrays import RecordedFrame
from viewer_app.sinks.sink import Sink

_KEPT_FRAMES = 1_800
"""A minute at 30 fps: what the summary at the end speaks of."""
_TURN = 0.0005  # seconds


@dataclass(frozen=True)
class Status:
    """What the loop tells whoever watches it, after each frame."""

    frame: RecordedFrame
    calibrator: Calibrator
    sensors: TwoSensors
    events: tuple[str, ...]


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keeps what else goes on in this process from holding up a loop, and those who wait for its frames.

    A loop that has waited for a frame, or for a lock, goes on only when the thread that runs has had its
    turn: Python's 5 ms are a sixth of a frame. And its search for garbage stops every thread, for four frames
    if it goes through all that was imported and compiled: what is there when the loop begins is left out.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_TURN)
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@undisturbed()
def run_live(
    sensors: TwoSensors,
    setup: FusionSetup,
    sink: Sink,
    *,
    calibrated: bool = False,
    depth: Depth = "full",
    truth_at: Callable[[int], NDArray[np.float64]] | None = None,
    go_on: Callable[[Status], bool] = lambda _: True,
) -> tuple[FusionSetup, list[RecordedFrame]]:
    """Fuses and records what two open sensors give until they end or ``go_on`` says no.

    Args:
        sensors: Open.
        setup: To begin with; its cameras are for depth images as `depth` leaves them.
        sink: Takes the frames, and what happened.
        calibrated: Whether to keep the setup's calibration; else one is found while running.
        depth: How much of the depth images is recorded.
        truth_at: (J, 3) the true joints at a time of A's clock, where they are known.
        go_on: Asked after each frame; shows the status in passing.

    Returns:
        The last setup, and the last frames, without their images.
    """
    fusion = LiveFusion(setup, calibrated)
    kept: deque[RecordedFrame] = deque(maxlen=_KEPT_FRAMES)
    ahead_ns = 0
    for live in sensors.pairs():
        pair = with_depth(fusion.chosen(live), depth)
        recalibrated = fusion.recalibrated(pair)
        if recalibrated:
            sink.recalibrated(fusion.setup)
        frame = replace(fusion.fuse(pair), streams=sensors.stream_figures)
        if truth_at is not None:
            if pair.a is not None:  # A's own time: a pair's goes on where A's clock is reset
                ahead_ns = pair.time_ns - pair.a.time_ns
            frame = replace(frame, truth=truth_at(pair.time_ns - ahead_ns))
        events = tuple(event.message for event in sensors.events())
        sink.write(frame)
        if recalibrated:
            sink.event(f"calibrated: {fusion.setup.calibration.how}")
        for told in fusion.told():
            sink.event(*told)
        for event in events:
            sink.event(event, "WARN")
        kept.append(replace(frame, pair=without_images(pair)))
        if not go_on(Status(frame, fusion.calibrator, sensors, events)):
            break
    for late in sensors.events():  # what happened after the last pair
        sink.event(late.message, "WARN")
    sink.finish()
    return fusion.setup, list(kept)
