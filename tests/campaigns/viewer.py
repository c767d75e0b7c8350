"""Two minutes of two simulated sensors with depth, the viewer killed ten times: file, pace and memory.

``python -m tests.campaigns.viewer`` prints a line a kill and the verdict at the end. The viewer draws
without a screen. With ``--hub-too`` the hub that feeds it is killed every other time: each new one costs this
process memory that Rerun never gives back, which the verdict then counts against it.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from devices.live.sensor_pair import TwoSensors
from devices.simulated.kinect import simulated_pair
from devices.simulated.real_time import paced_together
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.session_arrays import RecordedFrame
from tests.campaigns.soak import GROWTH_MB, SETTLED_S, resident_mb
from tests.helpers.live_frames import numbers_in
from viewer_app.loop.live_loop import Status, run_live
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.sink import FanOut
from viewer_app.sinks.viewer_sink import ShownSession
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.rerun_process import Hub, stop
from viewer_app.viewer.viewer_choice import Viewing


@dataclass
class Campaign:
    """What was seen; ``memory`` is (seconds, resident MB) of this process."""

    frames: int = 0
    in_file: list[int] = field(default_factory=list)
    dropped: tuple[int, int] = (0, 0)
    kills: int = 0
    windows: int = 0
    hubs: int = 0
    not_shown: int = 0
    slowest_ms: float = 0.0
    memory: list[tuple[float, float]] = field(default_factory=list)

    def growth_mb(self, since: float) -> float:
        """From the median of the ten seconds after `since` to the most later on."""
        base = [mb for at, mb in self.memory if since <= at < since + 10.0]
        return max(mb for at, mb in self.memory if at >= since) - float(np.median(base))

    @property
    def complete(self) -> bool:
        """Whether the file has every frame once, in order."""
        return self.in_file == list(range(self.frames))


def campaign(seconds: float, kills: int, path: Path, hub_too: bool = False) -> Campaign:
    """Runs the loop with a viewer and kills that at equal intervals."""
    seen = Campaign()
    a, b, _ = simulated_pair(motion="walk", depth="half")
    nominal = FusionSetup(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    Fuser(nominal).warm_up()
    for sensor in (a, b):
        next(sensor.frames())  # compiles the renderer before the clock runs
    blueprint = session_blueprint(nominal, np.array([0.0, 0.0, 2.5]), "setup")
    viewing = Viewing(window=True, hub=Hub.on_free_ports(web=False), headless=True)
    with (
        LiveSession(nominal, (a.name, b.name), blueprint, file=path, viewing=viewing) as session,
        TwoSensors(*paced_together(a, b)) as sensors,
    ):
        assert isinstance(session.viewer, ShownSession)
        assert session.viewer.window is not None
        window, feed = session.viewer.window, session.viewer.feed
        begun = time.perf_counter()

        def kill() -> None:
            for k in range(kills):
                time.sleep(max(0.0, begun + seconds * (k + 1) / (kills + 1) - time.perf_counter()))
                victims = [window.process, *([feed.process] if hub_too and k % 2 else [])]
                for victim in victims:
                    os.kill(victim.pid, signal.SIGKILL)
                seen.kills += 1
                now = time.perf_counter() - begun
                print(
                    f"{now:6.1f} s  kill {k + 1}  {seen.frames} frames  {resident_mb():.1f} MB",
                    flush=True,
                )
            time.sleep(max(0.0, begun + seconds - time.perf_counter()))
            sensors.stop()

        def look(_: Status) -> bool:
            seen.frames += 1
            now = time.perf_counter() - begun
            if not seen.memory or now - seen.memory[-1][0] >= 1.0:
                seen.memory.append((now, resident_mb()))
            return True

        class Timed(FanOut):
            """The session, with a watch beside ``write``."""

            def write(self, frame: RecordedFrame) -> None:
                before = time.perf_counter()
                super().write(frame)
                seen.slowest_ms = max(seen.slowest_ms, 1e3 * (time.perf_counter() - before))

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        run_live(sensors, nominal, Timed((session,)), go_on=look)
        killer.join()
        seen.dropped = sensors.a.dropped, sensors.b.dropped
        seen.windows, seen.hubs, seen.not_shown = window.starts, feed.starts, session.viewer.dropped
    stop(window.process)
    seen.in_file = numbers_in(path)
    return seen


def main() -> int:
    """The program."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=120.0)
    options.add_argument("--kills", type=int, default=10)
    options.add_argument("--hub-too", action="store_true", help="kill the hub too, every other time")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen = campaign(given.seconds, given.kills, Path(folder) / "campaign.rrd", given.hub_too)
    first = given.seconds / (given.kills + 1)
    # the summary keeps the frames of one minute; this memory fills up during the first minute
    growth = seen.growth_mb(min(SETTLED_S, given.seconds / 2.0))
    print(
        f"{seen.frames} frames, {len(seen.in_file)} in the file, complete: {seen.complete}; dropped "
        f"{seen.dropped}; {seen.kills} kills, {seen.windows} viewers and {seen.hubs} hubs started; "
        f"{seen.not_shown} frames not shown; record() took {seen.slowest_ms:.2f} ms at most; memory grew "
        f"{seen.growth_mb(first):.1f} MB after the first kill, {growth:.1f} MB after the first minute (end "
        f"{seen.memory[-1][1]:.0f} MB)"
    )
    fine = seen.complete and seen.kills == given.kills and not growth >= GROWTH_MB
    print("passed" if fine else "FAILED")
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
