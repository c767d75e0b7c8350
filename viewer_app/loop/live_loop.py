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

from devices.following import PersonOfPair
from devices.live.sensor_pair import TwoSensors
from fusion.body import Body
from fusion.calibration.calibration import Calibration, StartUpPose, calibrate, nominal_calibration
from fusion.errors import CalibrationError
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder
from viewer_app.loop.fusing import fuse_one
from viewer_app.loop.image_thinning import Depth, with_depth, without_images
from viewer_app.sinks.live_session import LiveSession

_KEPT_FRAMES = 1_800
"""A minute at 30 fps: what the summary at the end speaks of."""
_PROVISIONAL_PAIRS = 30
_TURN = 0.0005  # seconds


class Calibrator:
    """Finds a calibration while pairs come in: a provisional one at once, the real one on the start-up pose.

    Args:
        body: The sensors' body.
        calibration: One from before, which is then kept.
    """

    def __init__(self, body: Body, calibration: Calibration | None = None) -> None:
        self._body = body
        self._pose = StartUpPose(body)
        self._seen: list[SkeletonPair] = []
        self._settled = calibration is not None
        self.calibration = calibration or nominal_calibration(body)

    @property
    def settled(self) -> bool:
        """Whether the calibration is the real one."""
        return self._settled

    @property
    def held(self) -> float:
        """Seconds for which the start-up pose has been held."""
        return self._pose.held

    def watch(self, pair: SkeletonPair) -> Calibration | None:
        """Takes the next pair.

        Returns:
            The new calibration where this pair completes one, else None.
        """
        if self._settled or pair.a is None or pair.b is None:
            return None
        held = self._pose.watch(pair)
        if held is not None:
            found = self._try(held, f"start-up pose, {len(held)} frames")
            self._settled = found is not None
            return found
        if len(self._seen) < _PROVISIONAL_PAIRS:
            self._seen.append(pair)
            if len(self._seen) in (1, _PROVISIONAL_PAIRS):
                return self._try(self._seen, f"provisional, {len(self._seen)} frames of any pose")
        return None

    def _try(self, pairs: list[SkeletonPair], how: str) -> Calibration | None:
        try:
            self.calibration = calibrate(self._body, pairs, how)
        except CalibrationError:
            return None
        return self.calibration


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
    *,
    body: Body,
    settings: FuserSettings,
    intrinsics: tuple[Intrinsics | None, Intrinsics | None],
    calibration: Calibration | None,
    recorder_for: Callable[[FusionSetup], Recorder | LiveSession],
    depth: Depth = "full",
    truth_at: Callable[[int], NDArray[np.float64]] | None = None,
    go_on: Callable[[Status], bool] = lambda _: True,
) -> tuple[FusionSetup, list[RecordedFrame]]:
    """Fuses and records what two open sensors give until they end or ``go_on`` says no.

    Args:
        sensors: Open.
        body: Of both sensors.
        settings: The method's choices.
        intrinsics: Of the two depth cameras, for depth images as `depth` leaves them.
        calibration: One to keep; None to find it while running.
        recorder_for: Makes the recorder, once.
        depth: How much of the depth images is recorded.
        truth_at: (J, 3) the true joints at a time of A's clock, where they are known.
        go_on: Asked after each frame; shows the status in passing.

    Returns:
        The last setup, and the last frames, without their images.
    """
    calibrator = Calibrator(body, calibration)
    setup = FusionSetup(calibrator.calibration, settings, *intrinsics)
    fuser = Fuser(setup)
    recorder = recorder_for(setup)
    people = PersonOfPair()
    kept: deque[RecordedFrame] = deque(maxlen=_KEPT_FRAMES)
    ahead_ns = 0
    for live in sensors.pairs():
        b_from_a = calibrator.calibration.a_from_b.inverse() if calibrator.settled else None
        pair = with_depth(people.chosen(live, b_from_a), depth)
        found = calibrator.watch(pair.skeletons)
        if found is not None:
            setup = FusionSetup(found, settings, *intrinsics)
            fuser = Fuser(setup)
            recorder.recalibrated(setup)
        frame = replace(fuse_one(fuser, pair), streams=sensors.stream_figures)
        if truth_at is not None:
            if pair.a is not None:  # A's own time: a pair's goes on where A's clock is reset
                ahead_ns = pair.time_ns - pair.a.time_ns
            frame = replace(frame, truth=truth_at(pair.time_ns - ahead_ns))
        events = tuple(event.message for event in sensors.events())
        recorder.record(frame)
        if found is not None:
            recorder.event(f"calibrated: {found.how}")
        for event in events:
            recorder.event(event, "WARN")
        kept.append(replace(frame, pair=without_images(pair)))
        if not go_on(Status(frame, calibrator, sensors, events)):
            break
    for late in sensors.events():  # what happened after the last pair
        recorder.event(late.message, "WARN")
    recorder.finish()
    return setup, list(kept)
