"""Where a live session's CPU time goes: the spans of each thread in a soak with a viewer.

``python -m tests.campaigns.live_spans --seconds 20`` prints for each span how often it ran, its CPU time per
second of the session, and the CPU and wall time of its mean and its longest run. Spans contain each other.
"""

from __future__ import annotations

import argparse
import importlib
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns import soak

SPANS = (
    "devices.simulated.kinect:surface",
    "devices.simulated.kinect:depth_image",
    "devices.simulated.kinect:visibility",
    "devices.simulated.kinect:Tracker.report",
    "devices.live.sensor_pair:TwoSensors.poll",
    "recordings.fusing.live:LiveFusion.chosen",
    "recordings.fusing.live:LiveFusion.recalibrated",
    "recordings.fusing.live:LiveFusion.fuse",
    "recordings.fusing.live:LiveFusion.learn",
    "fusion.registration.refinement:Refinement._go_on",
    "fusion.registration.knocked:KnockDetector.observe",
    "viewer_app.sinks.session_file:SessionFile.write",
    "viewer_app.sinks.viewer_sink:ShownSession.write",
    "viewer_app.sinks.viewer_feed:write_items",
    "viewer_app.sinks.viewer_feed:ViewerFeed._send",
    "recordings.writing.recorder:Recorder._draw",
    "recordings.writing.recorder:Recorder.plot",
    "recordings.writing.recorder:Recorder.record_rows",
    "recordings.writing.recorder:Recorder.record_depth",
    "recordings.writing.growing_file:GrowingFile.write",
)
"""Module and name of the functions that are measured."""

Runs = dict[tuple[str, str], list[tuple[float, float]]]


def measure(place: str, runs: Runs) -> None:
    """Replaces a function by one that notes its CPU and wall time, in ms, per thread."""
    module, _, path = place.partition(":")
    owner: Any = importlib.import_module(module)
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    function = getattr(owner, name)

    def timed(*given: Any, **more: Any) -> Any:
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        try:
            return function(*given, **more)
        finally:
            took = (time.thread_time_ns() - cpu) * 1e-6, (time.perf_counter_ns() - wall) * 1e-6
            runs[threading.current_thread().name, path].append(took)

    setattr(owner, name, timed)


def main() -> None:
    """The program."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=20.0)
    options.add_argument("--sensors", choices=("threads", "processes"), default="threads")
    given = options.parse_args()
    runs: Runs = defaultdict(list)
    for place in SPANS:
        measure(place, runs)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.rrd"
        seen = soak.soak(given.seconds, "half", path, viewer=True, processes=given.sensors == "processes")
    print(f"{seen.frames} frames, {seen.processor:.0%} of a processor")
    print(f"{'thread':20} {'span':26} runs, CPU ms per s, mean CPU and wall ms, longest CPU and wall ms")
    for (thread, span), took in sorted(runs.items(), key=lambda of: (of[0][0], -sum(t[0] for t in of[1]))):
        each = np.array(took)
        (cpu, wall), (most, longest) = each.mean(axis=0), each.max(axis=0)
        figures = (
            f"{each[:, 0].sum() / seen.seconds:9.1f} {cpu:10.2f} {wall:7.2f} {most:10.1f} {longest:7.1f}"
        )
        print(f"{thread:20} {span:26} {len(each):5d} {figures}")


if __name__ == "__main__":
    main()
