"""A moment of a live sensor, joined from images that come one by one, without losing a depth image."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from devices.sensor import SensorFrame

_WAIT_NS = 180_000_000  # how long depth waits for another image: less than pairing waits for the other sensor
_DEAD_NS = 2_000_000_000  # without an image for so long, depth no longer waits for it


class Incomplete(Enum):
    """Why an SDK's queue gave no moment."""

    NOTHING = auto()  # it was empty
    PART = auto()  # images came, but none that completes a moment


@dataclass(eq=False)
class Moment:
    """A depth image and the images that belong to it, as the SDK gave them."""

    time_ns: int  # capture time on the sensor's clock
    host_ns: int  # when the depth image reached this machine, on ``time.perf_counter_ns``
    depth: Any
    infrared: Any = None
    color: Any = None
    waited_ns: int = 0  # how long the depth image waited in the SDK's queue
    lacks: tuple[str, ...] = ()  # the wanted images that did not come: ``infrared``, ``color``
    held: bool = False  # whether it waited for another image
    frame: SensorFrame | None = None  # its images, once they are made


class _Images:
    """The newest images of one stream beside depth: those that a waiting depth image may need."""

    def __init__(self, period_ns: int, wait_ns: int, depth_period_ns: int) -> None:
        self.period_ns, self.wait_ns, self.late_ns = period_ns, wait_ns, 0
        kept = 2 + (2 * wait_ns + depth_period_ns) // period_ns
        self.newest: deque[tuple[int, Any]] = deque(maxlen=kept)
        # time of the last depth image that had one; at first, and when images come again, of the newest
        self.joined_ns: int | None = None

    def near(self, time_ns: int, half_ns: int) -> tuple[Any, bool]:
        """The image nearest to a time, None if it is more than half a frame away; and whether no nearer one
        can come.
        """
        if not self.newest:
            return None, False
        last_ns = self.newest[-1][0]
        nearest_ns, image = min(self.newest, key=lambda one: abs(one[0] - time_ns))
        if abs(nearest_ns - time_ns) <= half_ns:
            return image, last_ns >= time_ns - self.period_ns // 2
        return None, last_ns > time_ns


class ImageJoiner:
    """Joins each depth image with the nearest images of other streams, at most half a frame away.

    Images of one stream come in order. A depth image waits for a missing one until a later one of that stream
    shows that it is missing, but no longer than 0.18 s by later depth images (0.36 s by other images). Once
    no depth image has had one for two seconds, each further depth image shortens this by ``period_ns``, down
    to 0. So every depth image is given, in order, with what it lacks.

    Args:
        period_ns: Time between two depth images.
        streams: ``infrared`` and ``color``, as far as they come apart from depth, with the time between two.
        wait_ns: For recordings: how long depth waits for an image, on the sensor's clock, always.
    """

    def __init__(self, period_ns: int, wait_ns: int | None = None, **streams: int) -> None:
        self._period_ns, self._patient = period_ns, wait_ns is not None
        wait_ns = wait_ns if wait_ns is not None else _WAIT_NS
        self._streams = {name: _Images(every_ns, wait_ns, period_ns) for name, every_ns in streams.items()}
        self._waiting: deque[Moment] = deque()
        self._ready: deque[Moment] = deque()
        self._last_ns: int | None = None  # time of the newest depth image

    def take(self) -> Moment | None:
        """The oldest complete moment; None if there is none."""
        return self._ready.popleft() if self._ready else None

    def late_ns(self, stream: str) -> int:
        """How much later than depth the images of a stream come; 0 if none comes, or in time."""
        images = self._streams.get(stream)
        if images is None or not images.newest or self._last_ns is None:
            return 0
        return images.late_ns if self._last_ns - images.newest[-1][0] < _DEAD_NS else 0

    def add_depth(
        self, time_ns: int, host_ns: int, image: Any, now_ns: int, lacks: tuple[str, ...] = ()
    ) -> None:
        """Takes a depth image.

        Args:
            lacks: What should have come with it and did not.
        """
        if self._last_ns is not None and time_ns < self._last_ns:  # its clock starts anew
            self.flush()
            for images in self._streams.values():
                images.newest.clear()
                images.joined_ns = None
        self._last_ns = time_ns
        for images in self._streams.values():
            since_ns = time_ns if images.joined_ns is None else images.joined_ns
            if time_ns - since_ns >= _DEAD_NS and not self._patient:
                images.wait_ns = max(0, images.wait_ns - self._period_ns)  # bit by bit: no burst of moments
        moment = Moment(time_ns, host_ns, image, waited_ns=now_ns - host_ns, lacks=lacks)
        self._waiting.append(moment)
        self._release()
        moment.held = bool(self._waiting) and self._waiting[-1] is moment

    def add(self, stream: str, time_ns: int, image: Any) -> None:
        """Takes another image; one of a stream that is not joined is left out."""
        images = self._streams.get(stream)
        if images is None:
            return
        if images.newest and time_ns < images.newest[-1][0]:  # its clock starts anew
            images.newest.clear()
        images.newest.append((time_ns, image))
        if self._last_ns is not None:
            images.late_ns = max(0, self._last_ns - time_ns)
            comes_again = images.late_ns < _WAIT_NS and images.wait_ns < _WAIT_NS
            if comes_again and not self._patient:
                images.wait_ns, images.joined_ns = _WAIT_NS, self._last_ns
        self._release()

    def flush(self) -> None:
        """Completes all depth images with what is there."""
        while self._waiting:
            self._complete()

    def _release(self) -> None:
        while self._waiting:
            time_ns = self._waiting[0].time_ns
            waits_ns = self._waiting[-1].time_ns - time_ns
            # Where depth fails, the images of the other streams show how time passes.
            last_ns = max(
                (each.newest[-1][0] for each in self._streams.values() if each.newest), default=time_ns
            )
            for images in self._streams.values():
                _, settled = images.near(time_ns, self._period_ns // 2)
                if not settled and waits_ns < images.wait_ns and last_ns - time_ns < 2 * images.wait_ns:
                    return
            self._complete()

    def _complete(self) -> None:
        moment = self._waiting.popleft()
        for name, images in self._streams.items():
            image, _ = images.near(moment.time_ns, self._period_ns // 2)
            setattr(moment, name, image)
            if image is not None or images.joined_ns is None:
                images.joined_ns = moment.time_ns
            if image is None:
                moment.lacks = (*moment.lacks, name)
        self._ready.append(moment)
