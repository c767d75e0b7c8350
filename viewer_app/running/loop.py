"""The loops at the pace of sensors or of a recording, and the compilation before them.

:class:`recordings.live_fusion.LiveFusion` fuses and learns; the loop hands its frames to sinks.
"""

import gc
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.capture.sensor_pair import TwoSensors
from devices.depth.image_thinning import Depth, pair_without_images
from devices.events import Event
from devices.people.recorded_people import Follow
from fusion.calibration.calibration import Calibration
from fusion.calibration.calibrator import Calibrator
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionFrame
from recordings.live_fusion import LiveFusion
from viewer_app.sinks.sink import Sink

_KEPT_FRAMES = 1_800
"""One minute at 30 fps: the frames that the final summary covers."""
_SWITCH_INTERVAL = 0.0005  # seconds
_LEARNING_DELAY = 0.010
"""Seconds, a third of a frame: for so long, learning waits for the threads that pass the frame on."""


@dataclass(frozen=True)
class Status:
    """What the loop reports to its observer after each frame."""

    frame: SessionFrame
    calibration: Calibration  # with which the frame was fused: that of the calibrator, or a refined one
    calibrator: Calibrator
    sensors: TwoSensors
    events: tuple[Event, ...]


@contextmanager
def low_latency() -> Iterator[None]:
    """Reduces the latency that other threads and the garbage collector add to the loop.

    A thread that waits for the GIL gets it only after the switch interval of the running thread. Python's
    default of 5 ms is a sixth of a frame; this context sets 0.5 ms. The garbage collector stops all threads;
    a full collection over all imported and compiled objects takes about four frames. ``gc.freeze`` excludes
    the objects that exist when the loop starts.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@low_latency()
def run_live(
    sensors: TwoSensors,
    setup: FusionSetup,
    sink: Sink,
    *,
    calibrated: bool = False,
    depth: Depth = "full",
    truth_at: Callable[[int], NDArray[np.float64]] | None = None,
    go_on: Callable[[Status], bool] = lambda _: True,
    clock: Callable[[], int] = time.perf_counter_ns,
    follow: Follow = "middle",
) -> tuple[FusionSetup, list[SessionFrame]]:
    """Fuses and records the frames of two open sensors until they end or ``go_on`` returns False.

    Args:
        setup: The setup at the start. Its intrinsics belong to the depth images that `depth` selects.
        calibrated: Whether to keep the calibration of `setup`. If not, one is computed while the loop runs.
        truth_at: Returns the true joints (J, 3) at a time of A's clock; None if they are unknown.
        go_on: Called with the status after each frame; returns whether to continue.
        follow: Whom of several people; see :class:`devices.people.following.PersonOfPair`.

    Returns:
        The last setup, and the frames of the last minute without their images.
    """
    fusion = LiveFusion(setup, calibrated, follow=follow)
    kept: deque[SessionFrame] = deque(maxlen=_KEPT_FRAMES)
    ahead_ns = 0
    for frame in fusion.frames(sensors, depth, clock):
        pair, recalibrated = frame.pair, fusion.setup is not setup
        if recalibrated:
            setup = fusion.setup
            sink.recalibrated(setup)
        if truth_at is not None:
            if pair.a is not None:  # the pair's time continues when A's clock is reset
                ahead_ns = pair.time_ns - pair.a.time_ns
            frame = replace(frame, truth=truth_at(pair.time_ns - ahead_ns))
        events = tuple(sensors.events())
        sink.write(frame)
        if recalibrated:
            sink.event(Event(f"calibrated: {fusion.setup.calibration.how}"))
        for event in events:
            sink.event(event)
        kept.append(replace(frame, pair=pair_without_images(pair)))
        goes_on = go_on(Status(frame, fusion.setup.calibration, fusion.calibrator, sensors, events))
        if not sensors.waiting:
            sink.rest(_LEARNING_DELAY)
        for event in fusion.learn(frame):
            sink.event(event)
        if not goes_on:
            break
    for late in sensors.events():  # what happened after the last pair
        sink.event(late)
    sink.finish()
    return fusion.setup, list(kept)


def played(
    frames: Iterable[SessionFrame],
    sink: Sink,
    setups: Mapping[int, FusionSetup],
    events: Sequence[Event],
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], object] = time.sleep,
) -> Iterator[SessionFrame]:
    """Gives each frame to the sink when it is due, then yields it. A frame that comes late is not skipped.

    Args:
        setups: By the number of the first frame that they apply to.
        events: In the order of their frames.
        clock, wait: Seconds; tests inject their own.
    """
    begin = first_ns = None
    at = 0
    for number, frame in enumerate(frames):
        time_ns = frame.pair.time_ns
        if begin is None or first_ns is None:
            begin, first_ns = clock(), time_ns
        left = begin + (time_ns - first_ns) * 1e-9 - clock()
        if left > 0.0:
            wait(left)
        if number and number in setups:
            sink.recalibrated(setups[number])
        sink.write(frame)
        while at < len(events) and events[at].frame <= number:
            sink.event(events[at])
            at += 1
        yield frame
    sink.finish()
