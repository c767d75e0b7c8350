"""Two simulated sensors at 30 fps with depth, for as long as one likes: memory, pace, latency, pairs lost.

``python -m tests.experiments.soak --minutes 10`` prints a line every half minute and the verdict at the end;
with ``--viewer`` the session goes to a viewer's hub too.
"""

import argparse
import os
import sys
import tempfile
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar
from unittest import mock

import numpy as np

from devices.capture.sensor_pair import TwoSensors
from devices.depth import witness as depth_witness
from devices.depth.rvl import encode_depth
from devices.frame_pairs import PairingFigures
from devices.simulated.kinect import simulated_pair
from devices.simulated.real_time import paced_together
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.writing.recorder import Recorder
from viewer_app.running.loop import run_live
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.sink import FanOut
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.viewer_choice import Viewing

FPS = 30
REPORT_EVERY_S = 30.0
SETTLED_S = 60.0  # the minute after which memory must be flat: caches and kept frames are full by then
GROWTH_MB = 20.0
SHOWN_MS = 15.0  # 99 % of the frames, from capture to logged for the viewer


@dataclass
class Soak:
    """What was seen; ``memory`` is (seconds, resident MB), ``waiting`` the most frames in each queue.

    The times are in ms per frame: how long the loop was held up by logging, and from when the frame's images
    reached this machine until it was handed over to file and viewer, and was written to the viewer.
    ``stolen`` is the share of the processors' time that a virtual machine's host gave to others: that is in
    the times too.
    """

    seconds: float = 0.0
    frames: int = 0
    pairing: PairingFigures = field(default_factory=PairingFigures)
    received: tuple[int, int] = (0, 0)
    dropped: tuple[int, int] = (0, 0)
    lost: int = 0
    not_shown: int = 0
    without_images: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)
    waiting: int = 0
    held_up: list[float] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    shown: list[float] = field(default_factory=list)
    saved_mb: float = 0.0
    processor: float = 0.0
    stolen: float = 0.0

    @property
    def growth_mb(self):
        """How much the memory grew after the first minute, at most."""
        first = [mb for at, mb in self.memory if SETTLED_S <= at < SETTLED_S + 15.0]
        later = [mb for at, mb in self.memory if at >= SETTLED_S]
        return max(later) - float(np.median(first)) if first else float("nan")

    @property
    def rate(self):
        """Fused frames per second."""
        return self.frames / self.seconds


class _Timed(FanOut):
    """A session that takes the time it takes."""

    def __init__(self, sinks, seen):
        super().__init__(sinks)
        self._seen = seen

    def write(self, frame):
        """Takes a frame."""
        before = time.perf_counter_ns()
        super().write(frame)
        after = time.perf_counter_ns()
        self._seen.held_up.append((after - before) * 1e-6)
        self._seen.latency.append((after - _arrived(frame)) * 1e-6)


class _TimedRecorder(Recorder):
    """A viewer's, which takes the time until each frame is logged."""

    shown: ClassVar[list[float]] = []

    def record_all(self, frames, numbers=None):
        super().record_all(frames, numbers)
        now = time.perf_counter_ns()
        if self._plots_later:  # otherwise the call is the file's
            self.shown.extend((now - _arrived(frame)) * 1e-6 for frame in frames)


def _arrived(frame):
    """When the later of a pair's frames reached this machine."""
    return max(seen.host_ns or 0 for seen in (frame.pair.a, frame.pair.b) if seen is not None)


def soak(seconds, depth, path, viewer=False):
    """Runs the loop and inspects it a few times per second."""
    seen = Soak(shown=_TimedRecorder.shown)
    seen.shown.clear()
    a, b, _ = simulated_pair(motion="walk", depth=depth)
    Fuser(FusionSetup(nominal_calibration(AZURE_KINECT))).warm_up()
    depth_witness.warm_up()
    for sensor in (a, b):
        image = next(sensor.frames()).depth  # compiles the renderer before the clock runs
        if image is not None:
            encode_depth(image)
    begun, said, looked = time.perf_counter(), [0.0], [0.0]

    def look(status):
        seen.frames += 1
        now = time.perf_counter() - begun
        queues = (status.sensors.a._frames, status.sensors.b._frames)
        seen.waiting = max(seen.waiting, *(len(queue) for queue in queues))
        if now - looked[0] >= 1.0:
            looked[0] = now
            seen.memory.append((now, resident_mb()))
        if now - said[0] >= REPORT_EVERY_S:
            said[0] = now
            figures = status.sensors.figures
            print(
                f"{now:6.0f} s  {resident_mb():6.1f} MB  {figures.pairs} pairs  "
                f"dropped {status.sensors.a.dropped}/{status.sensors.b.dropped}  "
                f"alone {figures.alone_a}/{figures.alone_b}/{figures.unmatched_b}",
                flush=True,
            )
        return True

    nominal = FusionSetup(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    blueprint = session_blueprint(nominal, np.array([0.0, 0.0, 2.5]), "inspect")
    viewing = Viewing(hub=Hub.on_free_ports(web=False)) if viewer else None
    with (
        mock.patch("viewer_app.sinks.viewer_sink.Recorder", _TimedRecorder) if viewer else nullcontext(),
        LiveSession(nominal, (a.name, b.name), blueprint, file=path, viewing=viewing) as session,
        TwoSensors(*paced_together(a, b)) as sensors,
    ):
        timer = threading.Timer(seconds, sensors.stop)
        timer.daemon = True
        timer.start()
        started, worked, stolen = time.perf_counter(), time.process_time(), stolen_seconds()
        run_live(sensors, nominal, _Timed((session,), seen), go_on=look)
        seen.seconds = time.perf_counter() - started
        seen.processor = (time.process_time() - worked) / seen.seconds
        seen.stolen = (stolen_seconds() - stolen) / (seen.seconds * (os.cpu_count() or 1))
        seen.pairing = sensors.figures
        seen.received = sensors.a.received, sensors.b.received
        seen.dropped = sensors.a.dropped, sensors.b.dropped
    seen.lost = session.file.lost + seen.frames - session.file.written
    seen.not_shown = 0 if session.viewer is None else session.viewer.dropped
    seen.without_images = session.file.without_images
    seen.saved_mb = path.stat().st_size / 1e6
    return seen


def resident_mb():
    """This process's memory, without what it shares with files."""
    pages = Path("/proc/self/statm").read_text().split()
    return (int(pages[1]) - int(pages[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def stolen_seconds():
    """What the host of a virtual machine gave of our processors' time to others, since the start."""
    of_all = Path("/proc/stat").read_text().splitlines()[0].split()
    return int(of_all[8]) / os.sysconf("SC_CLK_TCK")


def main():
    """The program."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--depth", choices=("none", "half", "full"), default="half")
    options.add_argument("--viewer", action="store_true")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.rrd"
        seen = soak(60.0 * given.minutes, given.depth, path, viewer=given.viewer)
    figures = seen.pairing
    lost = seen.lost + sum(seen.dropped)
    lost += figures.alone_a + figures.alone_b + figures.unmatched_b + figures.late
    print(
        f"{seen.seconds:.1f} s: {seen.frames} frames, {seen.rate:.2f} a second; {figures.pairs} pairs of "
        f"{seen.received}; dropped {seen.dropped}, alone {figures.alone_a}/{figures.alone_b}, unmatched "
        f"{figures.unmatched_b}, late {figures.late}; at most {seen.waiting} frames waited; not saved "
        f"{seen.lost}, saved without images {seen.without_images}, not shown {seen.not_shown}; memory grew "
        f"{seen.growth_mb:.1f} MB after the first minute (end {seen.memory[-1][1]:.0f} MB); file "
        f"{seen.saved_mb:.1f} MB; {seen.processor:.0%} of a processor, simulation included; "
        f"{seen.stolen:.1%} of the processors stolen"
    )
    for what, ms in (
        ("the loop held up by logging", seen.held_up),
        ("capture to handed over", seen.latency),
        ("capture to logged for the viewer", seen.shown),
    ):
        if ms:
            p50, p99, p999 = np.percentile(ms, (50.0, 99.0, 99.9))
            print(f"{what}: {p50:.3f} ms (median), 99 % {p99:.3f}, 99.9 % {p999:.3f}, max {max(ms):.3f}")
    fine = lost == 0 and at_pace(seen) and not seen.growth_mb >= GROWTH_MB and in_time(seen)
    print("passed" if fine else "FAILED")
    return 0 if fine else 1


def at_pace(seen):
    """Whether the rate was 30 frames per second, except at the start and the end."""
    return seen.frames >= FPS * seen.seconds - 3


def in_time(seen):
    """Whether frames were with the viewer soon enough, where there was one."""
    return not seen.shown or float(np.percentile(seen.shown, 99.0)) < SHOWN_MS


if __name__ == "__main__":
    sys.exit(main())
