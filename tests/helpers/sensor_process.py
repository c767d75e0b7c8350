"""A simulated sensor in a process of its own: like a vendor's SDK, it needs none of this interpreter's time.

A simulated sensor takes about 5 ms of Python's interpreter for a frame; a real one takes what passing on the
images takes. Skeletons and depth images come through a pipe.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from devices.depth.image_thinning import Depth
from devices.real_time import Beat, PacedSensor
from devices.sensor import Sensor, SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.skeleton import Skeleton

_SPAWN = multiprocessing.get_context("spawn")
_POLL = 0.2  # seconds


class SensorProcess(Sensor):
    """A simulated sensor that walks in front of a process of its own.

    Args:
        which: 0 for sensor A, 1 for B.
        depth: Size of the depth images.
        start: Where the processes of all sensors wait for each other.
    """

    def __init__(self, which: int, depth: Depth, start: Any) -> None:
        like = simulated_pair(motion="walk", depth=depth)[which]
        assert not isinstance(like, tuple)
        self.name, self.body, self.intrinsics = like.name, like.body, like.intrinsics  # type: ignore[union-attr]
        self._start = start  # kept: the processes open it by its name
        self._frames, theirs = _SPAWN.Pipe(duplex=False)
        self._process = _SPAWN.Process(target=_give, args=(theirs, which, depth, start), daemon=True)
        self._stopping = threading.Event()

    def __enter__(self) -> SensorProcess:
        """Starts the process, and waits until it has its first frame."""
        self._process.start()
        self._frames.recv()
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Ends the process."""
        self._process.terminate()
        self._process.join()

    def interrupt(self) -> None:
        """Ends ``frames``."""
        self._stopping.set()

    def frames(self) -> Iterator[SensorFrame]:
        """The frames, each when it is due."""
        while not self._stopping.is_set():
            if not self._frames.poll(_POLL):
                continue
            time_ns, host_ns, people, size = self._frames.recv()
            seen = {name: self._skeleton(*of) for name, of in people.items()}
            depth = None
            if size is not None:
                depth = np.frombuffer(self._frames.recv_bytes(), dtype=np.uint16).reshape(size)
            yield SensorFrame(time_ns, seen, depth, host_ns=host_ns)

    def _skeleton(self, positions: Any, states: Any, time_ns: int, witness: Any) -> Skeleton:
        # as every sensor makes one: kernels are compiled for its read-only arrays
        return Skeleton.of(self.body, positions, states, time_ns).with_witness(witness)


def sensor_processes(depth: Depth) -> tuple[SensorProcess, SensorProcess]:
    """Two sensors that start together."""
    start = _SPAWN.Barrier(2)
    return SensorProcess(0, depth, start), SensorProcess(1, depth, start)


class _Start(Beat):
    """Starts sensors of several processes together."""

    def __init__(self, ready: Connection, start: Any) -> None:
        super().__init__()
        self._ready, self._start = ready, start

    def begin(self, clock: Callable[[], float], stopping: threading.Event) -> float:
        """Tells that the first frame is made, and waits for the other sensor."""
        del stopping
        self._ready.send(None)
        self._start.wait()
        return clock()


def _give(pipe: Connection, which: int, depth: Depth, start: Any) -> None:
    """The process."""
    sensor = simulated_pair(motion="walk", depth=depth)[which]
    next(sensor.frames())  # compiles
    for frame in PacedSensor(sensor, _Start(pipe, start)).frames():
        people = {
            name: (seen.positions, seen.states, seen.time_ns, seen.witness)
            for name, seen in frame.people.items()
        }
        image = frame.depth
        pipe.send((frame.time_ns, frame.host_ns, people, None if image is None else image.shape))
        if image is not None:
            pipe.send_bytes(np.ascontiguousarray(image))
