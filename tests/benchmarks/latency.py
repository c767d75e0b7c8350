"""How late S* is, live: ``python -m tests.benchmarks.latency``.

Two simulated sensors run at 30 frames per second with depth images. It measures the time from
capture to the sinks and to the viewer, alone and beside two busy processes, and the time from S* to a VMC
receiver in another process. The figures are written to ``results/latency.json``.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from devices.capture.sensor_pair import TwoSensors
from devices.simulated.kinect import simulated_pair
from devices.simulated.real_time import paced_together
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from tests.benchmarks import results
from tests.helpers.soak import soak
from viewer_app.addresses import LOOPBACK
from viewer_app.options.shared import LiveOutputOptions
from viewer_app.outputs.avatars.osc import Address, OscOutput
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.opening import plan_outputs
from viewer_app.running.loop import run_live
from viewer_app.sinks.sink import FanOut, Sink

_SETTLING = 30  # frames that are not counted: caches and the receiver's start
_RECEIVER = """
import select, socket, struct, sys, time
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind((sys.argv[1], 0))
print(receiver.getsockname()[1], flush=True)
while True:
    ready = select.select([receiver, sys.stdin], [], [])[0]
    if receiver not in ready:
        break
    datagram = receiver.recv(2000)
    now = time.perf_counter_ns()
    mark = datagram.find(b"/VMC/Ext/T\\0")
    if mark >= 0:
        print(now, struct.unpack_from(">f", datagram, mark + 16)[0])
"""
"""Prints when each frame arrived and its time stamp; ends when its input ends."""


class _Departures(Sink):
    """Notes when each frame left the fuser: the first sink that the loop calls after it."""

    def __init__(self):
        self.times = []  # perf_counter, time of the pair

    def write(self, frame):
        self.times.append((time.perf_counter_ns(), frame.pair.time_ns))


def vmc_delay(body, seconds):
    """The time from the end of ``Fuser.update`` to the ``recv`` of a VMC receiver, milliseconds."""
    with subprocess.Popen(
        [sys.executable, "-c", _RECEIVER, LOOPBACK], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as receiver:
        plan_outputs(LiveOutputOptions(vmc=f"{LOOPBACK}:9")).warm_up(body)
        address = Address(LOOPBACK, int(receiver.stdout.readline()))
        output = OscOutput("VMC", address, "--vmc", VmcEncoder(body).encode)
        departures = _Departures()
        a, b, _ = simulated_pair(motion="walk", seed=0, body=body, seconds=seconds, depth="none")
        setup = FusionSetup(nominal_calibration(body), None, a.intrinsics, b.intrinsics)
        Fuser(setup).warm_up()
        with TwoSensors(*paced_together(a, b)) as sensors:
            run_live(sensors, setup, FanOut((departures, output)))
        output.close()
        printed, _ = receiver.communicate(input="end\n")
    first_ns = departures.times[0][1]
    left = {float(np.float32((time_ns - first_ns) * 1e-9)): now for now, time_ns in departures.times}
    rows = [line.split() for line in printed.splitlines()]
    sent = [(now, float(stamp)) for now, stamp in rows if float(stamp) in left]  # not the last word
    delays = np.array([int(now) - left[stamp] for now, stamp in sent][_SETTLING:]) * 1e-6
    return {"frames": len(departures.times), "arrived": len(sent), **_percentiles(delays)}


def live_latency(seconds, viewer, busy=0):
    """The soak's figures, beside a number of busy processes."""
    with _busy_processes(busy), tempfile.TemporaryDirectory() as folder:
        seen = soak(seconds, "half", Path(folder) / "soak.rrd", viewer=viewer)
    return {
        "lost": seen.lost + sum(seen.dropped),
        "handed_over": _percentiles(seen.latency),
        "shown": _percentiles(seen.shown) if seen.shown else None,
        "processor": seen.processor,
        "stolen": seen.stolen,
        "growth_mb": seen.growth_mb,
    }


@contextmanager
def _busy_processes(count):
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _percentiles(milliseconds):
    median, p99 = np.percentile(milliseconds, [50, 99])
    return {"median_ms": float(median), "p99_ms": float(p99)}


def main(arguments=None):
    """Measures the three conditions and the output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=90.0, help="of each condition; for memory 75 or more"
    )
    options = parser.parse_args(arguments)
    figures = {
        "file": live_latency(options.seconds, viewer=False),
        "viewer": live_latency(options.seconds, viewer=True),
        "busy": live_latency(options.seconds, viewer=True, busy=2),
        "vmc": vmc_delay(AZURE_KINECT, 30.0),
    }
    results.write("latency", {"seconds": options.seconds, **figures})


if __name__ == "__main__":
    main()
