"""Two simulated sensors at 30 fps with depth, for as long as one likes: memory, pace, pairs lost.

``python -m tests.soak --minutes 10`` prints a line every half minute and the verdict at the end.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from devices.live_pairing import PairingFigures
from devices.simulated.paced import PacedSensor
from devices.simulated.sensor import simulated_pair
from devices.two_sensors import TwoSensors
from fusion.body import AZURE_KINECT
from fusion.calibration import nominal_calibration
from fusion.fuser import Fuser, FuserSettings
from viewer_app.blueprint import session_blueprint
from viewer_app.live import Status, run_live
from viewer_app.live_session import LiveSession

FPS = 30
SETTLED_S = 60.0  # the minute after which memory must be flat: caches and kept frames are full by then
GROWTH_MB = 20.0


@dataclass
class Soak:
    """What was seen; ``memory`` is (seconds, resident MB), ``waiting`` the most frames in each queue."""

    seconds: float = 0.0
    frames: int = 0
    pairing: PairingFigures = field(default_factory=PairingFigures)
    received: tuple[int, int] = (0, 0)
    dropped: tuple[int, int] = (0, 0)
    lost: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)
    waiting: int = 0
    latest_ms: float = 0.0
    saved_mb: float = 0.0
    threads: int = 0

    @property
    def growth_mb(self) -> float:
        """How much the memory grew after the first minute, at most."""
        first = [mb for at, mb in self.memory if SETTLED_S <= at < SETTLED_S + 15.0]
        later = [mb for at, mb in self.memory if at >= SETTLED_S]
        return max(later) - float(np.median(first)) if first else float("nan")

    @property
    def rate(self) -> float:
        """Fused frames a second."""
        return self.frames / self.seconds


def soak(seconds: float, depth: Literal["off", "half"], path: Path, report_every_s: float = 30.0) -> Soak:
    """Runs the loop and looks at it a few times a second."""
    seen = Soak()
    a, b, _ = simulated_pair(motion="walk", depth=depth)
    Fuser(nominal_calibration(AZURE_KINECT)).warm_up()
    for sensor in (a, b):
        next(sensor.frames())  # compiles the renderer before the clock runs
    begun, said = time.perf_counter(), [0.0]
    looked = [0.0]

    def look(status: Status) -> bool:
        seen.frames += 1
        now = time.perf_counter() - begun
        queues = (status.sensors.a._frames, status.sensors.b._frames)
        seen.waiting = max(seen.waiting, *(len(queue) for queue in queues))
        frame = status.frame.pair.a or status.frame.pair.b
        assert frame is not None
        assert frame.host_ns is not None
        seen.latest_ms = max(seen.latest_ms, time.perf_counter_ns() * 1e-6 - frame.host_ns * 1e-6)
        if now - looked[0] >= 1.0:
            looked[0] = now
            seen.memory.append((now, resident_mb()))
        if now - said[0] >= report_every_s:
            said[0] = now
            figures = status.sensors.figures
            print(
                f"{now:6.0f} s  {resident_mb():6.1f} MB  {figures.pairs} pairs  "
                f"dropped {status.sensors.a.dropped}/{status.sensors.b.dropped}  "
                f"alone {figures.alone_a}/{figures.alone_b}/{figures.unmatched_b}",
                flush=True,
            )
        return True

    nominal = Fuser(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    blueprint = session_blueprint(nominal, np.array([0.0, 0.0, 2.5]), "inspect")
    with (
        LiveSession(nominal, (a.name, b.name), blueprint, file=path) as session,
        TwoSensors(PacedSensor(a), PacedSensor(b)) as sensors,
    ):
        timer = threading.Timer(seconds, sensors.stop)
        timer.daemon = True
        timer.start()
        started = time.perf_counter()
        run_live(
            sensors,
            body=AZURE_KINECT,
            settings=FuserSettings(),
            intrinsics=(a.intrinsics, b.intrinsics),
            calibration=None,
            recorder_for=lambda _: session,
            go_on=look,
        )
        seen.seconds = time.perf_counter() - started
        seen.pairing = sensors.figures
        seen.received = sensors.a.received, sensors.b.received
        seen.dropped = sensors.a.dropped, sensors.b.dropped
    seen.lost = session.lost
    seen.saved_mb = path.stat().st_size / 1e6
    seen.threads = threading.active_count()
    return seen


def resident_mb() -> float:
    """This process's memory, without what it shares with files."""
    pages = Path("/proc/self/statm").read_text().split()
    return (int(pages[1]) - int(pages[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    """The program."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--depth", choices=("off", "half"), default="half")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen = soak(60.0 * given.minutes, given.depth, Path(folder) / "soak.rrd")
    figures = seen.pairing
    lost = (
        seen.lost + sum(seen.dropped) + figures.alone_a + figures.alone_b + figures.unmatched_b + figures.late
    )
    print(
        f"{seen.seconds:.1f} s: {seen.frames} frames, {seen.rate:.2f} a second; {figures.pairs} pairs of "
        f"{seen.received}; dropped {seen.dropped}, alone {figures.alone_a}/{figures.alone_b}, unmatched "
        f"{figures.unmatched_b}, late {figures.late}; at most {seen.waiting} frames waited, the latest "
        f"recorded {seen.latest_ms:.0f} ms after it came; memory grew {seen.growth_mb:.1f} MB after the "
        f"first minute (end {seen.memory[-1][1]:.0f} MB); file {seen.saved_mb:.1f} MB"
    )
    fine = lost == 0 and at_pace(seen) and not seen.growth_mb >= GROWTH_MB
    print("passed" if fine else "FAILED")
    return 0 if fine else 1


def at_pace(seen: Soak) -> bool:
    """Whether it was 30 frames a second, but for those on their way at the start and at the end."""
    return seen.frames >= FPS * seen.seconds - 3


if __name__ == "__main__":
    sys.exit(main())
