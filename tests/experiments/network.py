"""Two sensor programs → Zenoh → pairs → S* on this machine, beside the direct path: latency and losses.

``python -m tests.experiments.network --minutes 5`` runs two ``duplex sensor --simulate`` and fuses them in
this process, then fuses two simulated sensors of this process for a fifth of that time. The latency of a
pair is from when the later of its two frames existed until S* is there.
"""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np

from devices.capture.sensor_pair import TwoSensors
from devices.capture.stream_pairing import PairingFigures
from devices.network.remote_sensor import RemoteSensor
from devices.network.zenoh_session import ZenohAddresses, zenoh_session
from devices.real_time import paced_together
from devices.sensor import LinkFigures
from devices.simulated.kinect import simulated_pair
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.fusing.sensors import LiveFusion
from tests.helpers.network import free_address
from tests.helpers.programs import running
from viewer_app.running.loop import low_latency

MEDIAN_MS, P99_MS = 5.0, 15.0
"""Most that the network may add to the direct path."""
_SETTLED_S = 15.0  # kernels are compiled and the first calibration is found by then


@dataclass
class Run:
    """What was seen after the first seconds; latencies in ms."""

    latency: list[float] = field(default_factory=list)
    seconds: float = 0.0
    pairs: int = 0
    dropped: tuple[int, int] = (0, 0)
    pairing: PairingFigures = field(default_factory=PairingFigures)
    links: tuple[LinkFigures | None, LinkFigures | None] = (None, None)

    def __str__(self) -> str:
        if not self.latency:
            return "no pair"
        median, high = np.percentile(self.latency, (50, 99))
        return (
            f"{self.seconds:.0f} s, {self.pairs / self.seconds:.2f} pairs/s, median {median:.2f} ms, "
            f"99 % {high:.2f} ms, max {max(self.latency):.1f} ms, dropped {self.dropped}"
        )


@low_latency()
def measured(sensors: TwoSensors, seconds: float) -> Run:
    """Fuses open sensors for so long and measures after the first seconds."""
    a, b = sensors.a.sensor, sensors.b.sensor
    setup = FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
    fusion, run = LiveFusion(setup), Run()
    begun, settled = time.perf_counter(), False
    for frame in fusion.frames(sensors):
        now_ns = time.perf_counter_ns()
        fusion.learn(frame)
        elapsed = now_ns * 1e-9 - begun
        if elapsed > _SETTLED_S and not settled:
            settled = True
            for thread in (sensors.a, sensors.b):
                thread.count_from_now()
        elif settled:
            run.pairs += 1
            came = [
                seen.host_ns for seen in (frame.pair.a, frame.pair.b) if seen is not None and seen.host_ns
            ]
            run.latency.append((now_ns - max(came)) * 1e-6)
        if elapsed > _SETTLED_S + seconds:
            break
    run.seconds = time.perf_counter() - begun - _SETTLED_S
    run.dropped = sensors.a.dropped, sensors.b.dropped
    run.links, run.pairing = sensors.links, sensors.figures
    return run


def by_network(seconds: float) -> Run:
    """Two sensor programs, fused here."""
    address = free_address()
    addresses = ZenohAddresses(listen=(address,))
    with ExitStack() as stack:
        stack.enter_context(zenoh_session(addresses))
        for which in "ab":
            program = ("sensor", "--publish", f"lab/{which}", "--simulate", which, "--zenoh-connect", address)
            stack.enter_context(running(*program, "--quiet"))
        remotes = [RemoteSensor(f"lab/{which}", addresses, appear_s=120.0) for which in "ab"]
        return measured(stack.enter_context(TwoSensors(*remotes)), seconds)


def directly(seconds: float) -> Run:
    """The same sensors in this process."""
    a, b, _ = simulated_pair(motion="walk")
    with TwoSensors(*paced_together(a, b)) as sensors:
        return measured(sensors, seconds)


def main() -> int:
    """The program."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=5.0)
    seconds = 60.0 * options.parse_args().minutes
    a, _, _ = simulated_pair()
    Fuser(FusionSetup(nominal_calibration(a.body))).warm_up()
    network = by_network(seconds)
    print(f"by network: {network}", flush=True)
    print(f"  {network.pairing}", flush=True)
    for side, link in zip("AB", network.links, strict=True):
        print(f"  {side}: {link}", flush=True)
    direct = directly(seconds / 5.0)
    print(f"direct:     {direct}", flush=True)
    beyond = np.percentile(network.latency, (50, 99)) - np.percentile(direct.latency, (50, 99))
    lost = sum(link.lost for link in network.links if link is not None) + sum(network.dropped)
    print(f"beyond the direct path: median {beyond[0]:.2f} ms, 99 % {beyond[1]:.2f} ms; lost {lost} frames")
    fine = beyond[0] <= MEDIAN_MS and beyond[1] <= P99_MS and lost == 0
    print("passed" if fine else "FAILED", file=sys.stderr)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
