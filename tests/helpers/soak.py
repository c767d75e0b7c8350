"""Two simulated sensors at 30 fps with depth, for as long as one likes: memory, pace, latency, pairs lost."""

import os
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
SETTLED_S = 60.0  # the minute after which memory must be flat: caches and kept frames are full by then


@dataclass
class Soak:
    """What was seen; ``memory`` is (seconds, resident MB), ``waiting`` the most frames in each queue.

    The times are in ms per frame, from when its images reached this machine until it was handed over to file
    and viewer, and until it was written to the viewer.
    ``stolen`` is the share of the processors' time that a virtual machine's host gave to others: that is in
    the times too.
    """

    seconds: float = 0.0
    frames: int = 0
    pairing: PairingFigures = field(default_factory=PairingFigures)
    dropped: tuple[int, int] = (0, 0)
    lost: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)
    waiting: int = 0
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


class _Timed(FanOut):
    """A session that takes the time it takes."""

    def __init__(self, sinks, seen):
        super().__init__(sinks)
        self._seen = seen

    def write(self, frame):
        """Takes a frame."""
        super().write(frame)
        self._seen.latency.append((time.perf_counter_ns() - _arrived(frame)) * 1e-6)


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
    begun, looked = time.perf_counter(), [0.0]

    def look(status):
        seen.frames += 1
        now = time.perf_counter() - begun
        queues = (status.sensors.a._frames, status.sensors.b._frames)
        seen.waiting = max(seen.waiting, *(len(queue) for queue in queues))
        if now - looked[0] >= 1.0:
            looked[0] = now
            seen.memory.append((now, resident_mb()))
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
        seen.dropped = sensors.a.dropped, sensors.b.dropped
    seen.lost = session.file.lost + seen.frames - session.file.written
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


def at_pace(seen):
    """Whether the rate was 30 frames per second, except at the start and the end."""
    return seen.frames >= FPS * seen.seconds - 3
