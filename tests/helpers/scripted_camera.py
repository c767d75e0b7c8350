"""A live sensor at the seam *one moment*: exposures by a schedule, in virtual time, and what goes wrong."""

import heapq
from collections import deque
from itertools import count

import numpy as np

from devices.capture.capture_stream import CaptureStream, LiveSensor
from devices.capture.clock.moments import ImageJoiner
from devices.sensor import SensorFrame
from tests.helpers.standin_camera import VirtualTime

PERIOD_NS = 33_333_333
QUEUE = 16  # images that the queue of an SDK holds; one more drops the oldest


def never(_number):
    """No exposure of these."""
    return False


class Schedule:
    """Exposures of a camera in virtual time: what comes when.

    Attributes:
        depth_lost: Of an exposure, whether depth is lost on USB.
        infrared_lost: Whether depth comes without infrared.
        color_lost: Whether colour does not come.
        silent: Whether nothing comes.
        blind: Whether no depth comes.
        plugged: Whether the sensor is connected.
    """

    def __init__(self):
        self.time, self.silent, self.blind, self.plugged = VirtualTime(), False, False, True
        self.depth_lost, self.infrared_lost, self.color_lost = never, never, never
        self.depth_latency_ns, self.color_latency_ns = 15_000_000, 40_000_000
        self._begun_ns, self._count, self._due, self._order = self.time.now_ns(), 0, [], count()
        self._queue = deque(maxlen=QUEUE)

    def take(self, timeout_ms):
        """The oldest image that waits: ``(kind, number, arrived_ns)``; None if none comes."""
        until_ns = self.time.now_ns() + 1_000_000 * timeout_ms
        while self._comes_ns() <= self.time.now_ns():
            self._next()
        while not self._queue and self._comes_ns() <= until_ns:
            self.time.wait_until(self._comes_ns())
            self._next()
        if not self._queue:
            self.time.wait_until(until_ns)
            return None
        return self._queue.popleft()

    def _exposed_ns(self):
        return self._begun_ns + (self._count + 1) * PERIOD_NS

    def _comes_ns(self):
        return min([self._exposed_ns(), *(due[0] for due in self._due[:1])])

    def _next(self):
        """The next exposure, or the next image that arrives."""
        exposed_ns = self._exposed_ns()
        if self._due and self._due[0][0] <= exposed_ns:
            self._queue.append(heapq.heappop(self._due)[2:])
            return
        self._count += 1
        if self.silent or not self.plugged:
            return
        for kind, lost, latency_ns in (
            ("depth", self.blind or self.depth_lost(self._count), self.depth_latency_ns),
            ("color", self.color_lost(self._count), self.color_latency_ns),
        ):
            if not lost:
                due_ns = exposed_ns + latency_ns
                heapq.heappush(self._due, (due_ns, next(self._order), kind, self._count, due_ns))


class _Stream(CaptureStream):
    def __init__(self, sensor):
        wanted = ["color"] * (sensor.settings.color is not None)
        joiner = ImageJoiner(PERIOD_NS, **dict.fromkeys(wanted, PERIOD_NS))
        super().__init__(f"Camera {sensor.name}", sensor, joiner, "infrared", *wanted)

    def receive(self, timeout_ms):
        schedule = self.sensor.schedule
        taken = schedule.take(timeout_ms)
        if taken is None:
            return False
        kind, number, arrived_ns = taken
        if kind == "color":
            self.joiner.add("color", number * PERIOD_NS, number)
        else:
            lacks = ("infrared",) * schedule.infrared_lost(number)
            now_ns = schedule.time.now_ns()
            self.joiner.add_depth(number * PERIOD_NS, arrived_ns, number, now_ns, lacks)
        return True

    def is_connected(self):
        return self.sensor.schedule.plugged


class ScriptedCamera(LiveSensor):
    """The camera of a :class:`Schedule`; depth and colour tell the exposure's number."""

    def __init__(self, schedule, settings):
        super().__init__("000123", settings, clock=schedule.time.now_ns)
        self.schedule = schedule

    def frames(self):
        yield from self._frames(_Stream(self))

    def frame_of(self, moment):
        image = np.full((4, 4), moment.depth, np.uint16)
        return SensorFrame(moment.time_ns, depth=image, color=moment.color, host_ns=moment.host_ns)
