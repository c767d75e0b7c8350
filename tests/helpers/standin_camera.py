"""One sensor on the stand-in's bus: when its images reach the host, and how the SDK queues them.

As libk4a 1.4 opened with K4A_DISABLE_SYNCHRONIZATION: depth goes to the queue of captures as it comes, and
colour in captures of its own. Orbbec's wrapper has them in one. Starting the colour camera resets the clock.
"""

import heapq
import random
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

QUEUE = 7  # captures; one more drops the oldest
DEPTH_LATENCY_NS = 15_000_000  # from exposure until the depth image is on the host
_MASTER, _SUBORDINATE, _WFOV_UNBINNED, _3072P = 1, 2, 4, 6


class RealTime:
    """The machine's own clock."""

    def now_ns(self):
        return time.perf_counter_ns()

    def wait_until(self, ns):
        time.sleep(max(0.0, (ns - self.now_ns()) * 1e-9))


class VirtualTime:
    """A clock that jumps to whatever is waited for."""

    def __init__(self, now_ns=100_000_000_000):
        self._now_ns = now_ns

    def now_ns(self):
        return self._now_ns

    def wait_until(self, ns):
        self._now_ns = max(self._now_ns, ns)


@dataclass(frozen=True)
class Shot:
    """The images of one moment, as an entry of the queue of captures."""

    number: int
    clock_usec: int
    depth_host_ns: int
    ready_ns: int
    has_depth: bool
    has_color: bool


@dataclass
class Device:
    """One sensor on the stand-in's bus, and what is wrong with it."""

    serial: str
    jacks: tuple[bool, bool] = (False, False)
    busy: bool = False
    plugged: bool = True
    starts: bool = True
    silent: bool = False
    infrared_lost: Callable[[int], bool] = lambda _number: False
    orbbec: bool = False  # behind Orbbec's wrapper: opens lazily, hides its jacks, epoch times
    firmware: tuple[int, int, int] = (1, 6, 110)
    clock_usec: int = 1_000_000
    captures: int = 0
    interval_usec: int = 33_333
    color: bool = True  # the colour camera works
    depth_latency_ns: int = DEPTH_LATENCY_NS
    color_latency_ns: int = 40_000_000
    first_usec: int | None = None  # the clock when colour starts; None: as it is
    lost_on_usb: float = 0.0  # share of the depth images
    open_s: float = 0.0
    start_s: float = 0.0
    stop_s: float = 0.0
    log: dict[str, str] = field(default_factory=dict)  # what libk4a logs where open or start fail
    skips: int = 0  # captures before each one that the full queue of the SDK dropped
    paced: bool = False  # captures arrive when they are due; otherwise one per wait
    time: RealTime | VirtualTime = field(default_factory=RealTime)
    at: dict[int, Callable[[], object]] = field(default_factory=dict)  # called at these capture numbers
    opened_by: object = None
    color_runs: bool = False
    joins_color: bool = True  # in one capture with depth
    begun_ns: Callable[[], int | None] = lambda: None
    _made: int = 0
    _queue: deque[Shot] = field(default_factory=deque)
    _due: list[tuple[int, int, bool, Shot]] = field(default_factory=list)

    def start(self, color, begun_ns):
        """Starts the cameras; ``begun_ns`` is the time of the first exposure once the master runs."""
        self.color_runs, self.begun_ns = color, begun_ns
        if color and self.first_usec is not None:
            self.clock_usec = self.first_usec
        self._made = 0
        self._due.clear()
        self._queue.clear()

    def next_shot(self, timeout_ms):
        """Returns the oldest capture in the queue after a bounded wait; None if none arrives."""
        if not self.paced:
            if self._queue:
                return self._queue.popleft()
            if not timeout_ms:
                return None
            shot = self._make(self.time.now_ns())
            if self._colored_alone():
                self._queue.append(replace(shot, has_depth=False, has_color=True))
            return shot
        until_ns = self.time.now_ns() + timeout_ms * 1_000_000
        self._fill()
        while not self._queue:
            # A subordinate waits for a master that another thread will start.
            soon_ns = self.time.now_ns() + 2_000_000
            following = (self._next_exposure_ns() or soon_ns, *(due[0] for due in self._due[:1]))
            self.time.wait_until(min(until_ns, *(following if not self.silent else (soon_ns,))))
            if self.time.now_ns() >= until_ns:
                return None
            self._fill()
        return self._queue.popleft()

    def _fill(self):
        while (next_ns := self._next_exposure_ns()) is not None and next_ns <= self.time.now_ns():
            self._expose(next_ns)
        while self._due and self._due[0][0] <= self.time.now_ns():
            shot = heapq.heappop(self._due)[-1]
            self._queue.append(shot)
            if len(self._queue) > QUEUE:
                self._queue.popleft()

    def _next_exposure_ns(self):
        begun_ns = self.begun_ns()
        return None if begun_ns is None else begun_ns + (self._made + 1) * self.interval_usec * 1000

    def _expose(self, exposed_ns):
        """Takes the images of one moment; each capture is due when libk4a releases it."""
        shot = self._make(exposed_ns + self.depth_latency_ns)
        captures = [shot] * (random.random() >= self.lost_on_usb)
        if self._colored_alone():
            ready_ns = exposed_ns + self.color_latency_ns
            captures.append(replace(shot, ready_ns=ready_ns, has_depth=False, has_color=True))
        for capture in captures:
            heapq.heappush(self._due, (capture.ready_ns, capture.number, capture.has_depth, capture))

    def _make(self, host_ns):
        self._made += 1
        self.clock_usec += self.interval_usec * (1 + self.skips)
        color = self.color_runs and self.joins_color and self.color
        return Shot(self._made, self.clock_usec, host_ns, host_ns, True, color)

    def _colored_alone(self):
        """Whether colour comes in a capture of its own."""
        return self.color_runs and not self.joins_color and self.color


def refused(config, device):
    """Why libk4a 1.4 does not start cameras with this configuration; empty if it does."""
    depth, color = int(config.depth_mode) != 0, int(config.color_resolution) != 0
    sync, delay = int(config.wired_sync_mode), config.subordinate_delay_off_master_usec
    period = 1_000_000 // (5, 15, 30)[int(config.camera_fps)]
    sync_in, sync_out = device.jacks
    if not device.orbbec:
        if (sync == _SUBORDINATE and not sync_in) or (sync == _MASTER and not sync_out):
            return "no cable in the jack"
        if sync == _MASTER and not color:
            return "a master needs its colour camera"
    if delay and (sync != _SUBORDINATE or delay > period):
        return "the delay is a subordinate's, and at most a frame"
    if not depth and not color:
        return "no camera at all"
    if not (depth and color) and (config.synchronized_images_only or config.depth_delay_off_color_usec):
        return "both cameras are needed for that"
    if abs(config.depth_delay_off_color_usec) > period:
        return "depth and colour more than a frame apart"
    fast = int(config.camera_fps) == 2
    if fast and (int(config.depth_mode) == _WFOV_UNBINNED or int(config.color_resolution) == _3072P):
        return "15 fps at most"
    if color and int(config.color_format) in (1, 2) and int(config.color_resolution) != 1:
        return "NV12 and YUY2 in 720p only"
    return ""
