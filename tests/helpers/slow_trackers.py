"""Two stand-in Kinects on a sync cable with slow trackers, run in virtual time.

Each sensor has a clock of its own; the one that is behind goes on, so that what they share (the decimation,
the pairing) sees the frames in the order of time. Nothing sleeps.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from devices.azure.kinect import KinectSensor
from devices.azure.settings import KinectSettings
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import LASER_GAP_US
from devices.capture.stream_pairing import LivePairing
from devices.sensor import SensorFrame
from tests.helpers.standin_camera import DEPTH_LATENCY_NS, Device, VirtualTime

PERIOD_NS = 33_333_000
SETTLED_NS = 3_000_000_000  # the trackers' times are known after this time


class SlowTracker:
    """A body tracker on a thread of its own, whose results have a given delay."""

    patience_s = 5.0

    def __init__(self, time, takes_ns):
        self._time, self._takes_ns = time, takes_ns
        self._inside = deque()
        self._busy_until_ns = 0

    def open(self, calibration):
        assert calibration

    def close(self):
        self._inside.clear()

    def enqueue(self, capture):
        begun_ns = max(self._time.now_ns(), self._busy_until_ns)
        self._busy_until_ns = begun_ns + self._takes_ns()
        self._inside.append((capture, self._busy_until_ns))

    def pop(self, wait_s=None):
        until_ns = self._time.now_ns() + round(1e9 * (self.patience_s if wait_s is None else wait_s))
        if not self._inside or self._inside[0][1] > until_ns:
            self._time.wait_until(until_ns)
            return None
        capture, ready_ns = self._inside.popleft()
        self._time.wait_until(ready_ns)
        return SensorFrame(1000 * capture, {})


@dataclass(frozen=True)
class Outcome:
    """The result of a run after it settled.

    Attributes:
        paired: Share of the frames that both trackers could process that came out as pairs.
        age_ns: Median of how old both frames of a pair were when it came out, since they could be had
            from libk4a.
        step: The decimation at the end: one of so many moments was tracked.
    """

    paired: float
    age_ns: float
    step: int


def run_slow_trackers(
    bus, *, color_latency_ns=0, tracking_ns=(20_000_000, 20_000_000), seconds=20.0, cable=True
):
    """Runs two sensors in virtual time, A the master."""
    rng = np.random.default_rng(1)
    serials = ("000001", "000002")
    times = [VirtualTime(), VirtualTime()]
    bus.devices = [
        Device(serial, jacks, paced=True, time=time, color_latency_ns=color_latency_ns, clock_usec=clock)
        for serial, jacks, time, clock in zip(
            serials, ((False, cable), (cable, False)), times, (1_000_000, 777_000_123), strict=True
        )
    ]
    decimation = FrameDecimation(30, lambda: max(time.now_ns() for time in times))
    roles = ("master", "subordinate") if cable else ("standalone", "standalone")
    sensors = [
        KinectSensor(serial, KinectSettings(sync=role), decimation=decimation, clock=time.now_ns)
        for serial, role, time in zip(serials, roles, times, strict=True)
    ]
    for sensor, time, takes in zip(sensors, times, tracking_ns, strict=True):
        sensor._tracker = SlowTracker(time, lambda takes=takes: takes + int(rng.integers(0, 1_000_001)))
    pairing = LivePairing(round(1e9 / 30), sync_delay_ns=1000 * LASER_GAP_US if cable else None)
    pairs = []
    with sensors[1], sensors[0]:
        streams = [sensor.frames() for sensor in sensors]
        arrivals = []
        end_ns = times[0].now_ns() + round(1e9 * seconds)
        while min(time.now_ns() for time in times) < end_ns:
            index = min((0, 1), key=lambda index: times[index].now_ns())
            frame = next(streams[index])
            arrivals.append((times[index].now_ns(), index, frame))
            # Frames older than both clocks are in time order.
            arrivals.sort(key=lambda arrival: arrival[0])
            while arrivals and arrivals[0][0] <= min(time.now_ns() for time in times):
                at_ns, side, ready = arrivals.pop(0)
                pairing.set_interval(decimation.interval_ns)
                came = pairing.add("ab"[side], ready, at_ns)
                pairs += [(at_ns, pair) for pair in came if pair.a is not None and pair.b is not None]
        for stream in streams:
            stream.close()
    begun_ns = 100_000_000_000 + SETTLED_NS
    settled = [(at_ns, pair) for at_ns, pair in pairs if begun_ns <= at_ns < end_ns - SETTLED_NS // 10]
    span_ns = end_ns - SETTLED_NS // 10 - begun_ns
    possible = span_ns / (PERIOD_NS * -(-max(tracking_ns) // PERIOD_NS))
    held_ns = max(0, color_latency_ns - DEPTH_LATENCY_NS) if cable else 0
    ages = [at_ns - (frame.host_ns or 0) for at_ns, pair in settled for frame in (pair.a, pair.b) if frame]
    return Outcome(len(settled) / possible, float(np.median(ages)) - held_ns, decimation.step)
