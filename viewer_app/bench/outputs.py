"""``duplex bench outputs``: measures encoding, and the way from ``Fuser.update`` to a VMC receiver."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from devices.capture.sensor_pair import TwoSensors
from devices.simulated.kinect import simulated_pair
from devices.simulated.real_time import paced_together
from fusion.body import BODIES, Body
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.session_arrays import RecordedFrame
from viewer_app.addresses import LOOPBACK
from viewer_app.errors import UsageError
from viewer_app.options.bench import BenchOutputsOptions
from viewer_app.options.shared import LiveOutputOptions
from viewer_app.output_files import check_writable, whole_file
from viewer_app.outputs.lab_streaming import sample
from viewer_app.outputs.opening import plan_outputs
from viewer_app.outputs.osc import Address
from viewer_app.outputs.output import LiveOutput, OutputCounts, TimedFrame
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.outputs.vmc import VmcEncoder, VmcOutput
from viewer_app.outputs.vrchat import VRChatEncoder
from viewer_app.running.loop import run_live
from viewer_app.sinks.sink import FanOut, Sink

_ROUNDS = 2000
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
    at = time.perf_counter_ns()
    mark = datagram.find(b"/VMC/Ext/T\\0")
    if mark >= 0:
        print(at, struct.unpack_from(">f", datagram, mark + 16)[0])
"""
"""Prints when each frame arrived and its time stamp; ends when its input ends."""


@dataclass(frozen=True)
class Delay:
    """From the end of ``Fuser.update`` to the receiver's ``recv``, milliseconds.

    Attributes:
        made: How many frames the loop made.
        frames: How many of them arrived and were counted.
        median_ms, p99_ms, max_ms: Of their delays.
        counts: As the output counted.
    """

    made: int
    frames: int
    median_ms: float
    p99_ms: float
    max_ms: float
    counts: OutputCounts


class _Stamps(Sink):
    """Notes when each frame left the fuser; the first sink that the loop calls after it."""

    def __init__(self) -> None:
        self.at: list[tuple[int, int]] = []  # perf_counter, time of the pair

    def write(self, frame: RecordedFrame) -> None:
        self.at.append((time.perf_counter_ns(), frame.pair.time_ns))


def run(options: BenchOutputsOptions) -> None:
    """Carries out the command.

    Raises:
        UsageError: The duration is not positive, or a file exists.
    """
    console = Console()
    if not 2.0 <= options.seconds < math.inf:
        raise UsageError(f"--seconds must be at least 2; got {options.seconds}.")
    if options.json is not None:
        check_writable(options.json, options.force)
    body = BODIES[options.body]
    frames = live_frames(body, [])
    table = Table(title=f"Encoding a frame of {len(body)} joints", title_justify="left", box=SIMPLE)
    for column in ("", "µs, mean of CPU time"):
        table.add_column(column, justify="right" if column else "left")
    encoding = encoding_us(body, frames)
    for name, microseconds in encoding.items():
        table.add_row(name, f"{microseconds:.1f}")
    console.print(table)
    delay = vmc_delay(body, options.seconds)
    console.print(
        f"S* to a VMC receiver in another process: median {delay.median_ms:.2f} ms, "
        f"99 % {delay.p99_ms:.2f} ms, max {delay.max_ms:.2f} ms, over {delay.frames} of {delay.made} frames; "
        f"{delay.counts.dropped} dropped, {delay.counts.late} late.",
        highlight=False,
    )
    if options.json is not None:
        with whole_file(options.json) as partial:
            figures = {"encoding_us": encoding, "vmc_delay": asdict(delay)}
            partial.write_text(json.dumps(figures, indent=1), encoding="utf-8")


def live_frames(body: Body, sinks: Sequence[Sink], seconds: float = 3.0) -> list[RecordedFrame]:
    """Runs the live loop on two simulated sensors at 30 fps without images; returns its frames."""
    a, b, _ = simulated_pair(motion="walk", seed=0, body=body, angle_deg=90.0, seconds=seconds, depth="none")
    setup = FusionSetup(nominal_calibration(body), None, a.intrinsics, b.intrinsics)
    Fuser(setup).warm_up()
    with TwoSensors(*paced_together(a, b)) as sensors:
        _, frames = run_live(sensors, setup, FanOut(sinks))
    return frames


def encoding_us(body: Body, frames: Sequence[RecordedFrame]) -> dict[str, float]:
    """Mean CPU time of each encoder per frame, microseconds; joint rotations included."""
    setup = FusionSetup(nominal_calibration(body))
    vmc, vrchat, text = VmcEncoder(body), VRChatEncoder(body), SkeletonJson(setup)
    encoders: dict[str, Callable[[TimedFrame], object]] = {
        "VMC": lambda timed: vmc.encode(timed.fused.positions, timed.time_ns),
        "VRChat": lambda timed: vrchat.encode(timed.fused.positions, timed.time_ns),
        "LSL": lambda timed: sample(timed.fused),
        "JSON (WebSocket, Zenoh)": text.frame,
    }
    took = {}
    for name, encode in encoders.items():
        timed = [TimedFrame(k, frames[k % len(frames)], k * 33_333_333, 0) for k in range(_ROUNDS)]
        encode(timed[0])
        before = time.process_time_ns()
        for each in timed:
            encode(each)
        took[name] = (time.process_time_ns() - before) * 1e-3 / _ROUNDS
    return took


def vmc_delay(body: Body, seconds: float) -> Delay:
    """The live loop with a VMC output, and a receiver in another process."""
    with subprocess.Popen(
        [sys.executable, "-c", _RECEIVER, LOOPBACK], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as receiver:
        assert receiver.stdout is not None
        plan_outputs(LiveOutputOptions(vmc=f"{LOOPBACK}:9")).warm_up(body)
        output: LiveOutput = VmcOutput(Address(LOOPBACK, int(receiver.stdout.readline())), body)
        stamps = _Stamps()
        live_frames(body, [stamps, output], seconds)
        output.close()
        said, _ = receiver.communicate(input="end\n")
    first_ns = stamps.at[0][1]
    left = {float(np.float32((time_ns - first_ns) * 1e-9)): at for at, time_ns in stamps.at}
    rows = [line.split() for line in said.splitlines()]
    delays = np.array([int(at) - left[float(stamp)] for at, stamp in rows][_SETTLING:]) * 1e-6
    if not len(delays):
        raise UsageError("No datagram arrived on the loopback interface.")
    median, p99 = np.percentile(delays, [50, 99])
    return Delay(len(stamps.at), len(delays), float(median), float(p99), float(delays.max()), output.counts)
