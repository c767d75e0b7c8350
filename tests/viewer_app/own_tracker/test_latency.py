"""The time from images to S*, as the summary and the report state it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from devices.pairing import FramePair
from devices.sensor import SensorFrame
from fusion.body import KINECT_V1
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.session_arrays import RecordedFrame
from tests.helpers.two_views import FRAME_NS, pair_of, standing
from viewer_app.running.loop import run_live
from viewer_app.running.summary import latency_figures
from viewer_app.sinks.sink import Sink

ARRIVED = ((100, 140), (300, 290), (None, 500), (None, None))
DONE = (1_100, 1_300, 1_600, 1_900)


class Arriving:
    """Two sensors whose images arrive at known times, milliseconds."""

    stream_figures, waiting = None, False

    def pairs(self) -> Iterator[FramePair]:
        for t, arrived in enumerate(ARRIVED):
            seen = pair_of(KINECT_V1, standing(KINECT_V1), t * FRAME_NS)
            a, b = (
                SensorFrame(t * FRAME_NS, {"1": skeleton}, host_ns=None if at is None else at * 1_000_000)
                for skeleton, at in zip((seen.a, seen.b), arrived, strict=True)
            )
            yield FramePair(a, b, SkeletonPair(None, None, t * FRAME_NS))

    def events(self) -> tuple[()]:
        return ()


def frames_of_a_session() -> list[RecordedFrame]:
    now = iter(DONE)
    setup = FusionSetup(nominal_calibration(KINECT_V1))
    return run_live(Arriving(), setup, Sink(), clock=lambda: next(now) * 1_000_000)[1]


def test_latency_counts_from_the_images_that_arrived_first() -> None:
    latencies = [frame.latency_ns for frame in frames_of_a_session()]
    assert latencies == [1_000_000_000, 1_010_000_000, 1_100_000_000, None]


def test_figures_are_milliseconds_of_the_frames_that_tell() -> None:
    frames = frames_of_a_session()
    figures = latency_figures(frames)
    assert (figures["p50"], figures["max"]) == (1_010.0, 1_100.0)
    assert figures["p99"] == pytest.approx(1_100.0 - 0.02 * 90.0)  # linear between the last two
    silent = [replace(frame, latency_ns=None) for frame in frames]
    assert latency_figures(silent) == {"p50": None, "p99": None, "max": None}
