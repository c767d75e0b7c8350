"""A sensor that does what a test tells it, frame by frame, from another thread; nothing sleeps."""

from __future__ import annotations

import queue
import threading

import numpy as np

from devices.sensor import DeviceError, Sensor, SensorFrame
from fusion.body import AZURE_KINECT, Body
from fusion.skeleton import Skeleton

PATIENCE_S = 10.0  # time limit for waiting on a thread; never reached when the test passes


def frame_at(time_ns, host_ns=None, people=False):
    person = {"1": Skeleton.of(AZURE_KINECT, np.ones((32, 3)), time_ns=time_ns)} if people else {}
    return SensorFrame(time_ns, person, host_ns=host_ns)


class ScriptedSensor(Sensor):
    """Gives what is put: a frame, an error to raise, a function to call, or None for the end."""

    body: Body = AZURE_KINECT

    def __init__(self, name="000123", open_faults=None):
        self.name = name
        self.open_faults = open_faults or []
        self.script = queue.Queue()
        self.opened = self.closed = 0
        self.close_hook = lambda: None

    def put(self, *steps):
        for step in steps:
            self.script.put(step)

    def __enter__(self):
        if self.open_faults:
            raise self.open_faults.pop(0)
        self.opened += 1
        return self

    def __exit__(self, *exc_info):
        self.closed += 1
        self.close_hook()

    def interrupt(self):
        self.script.put(None)

    def frames(self):
        while True:
            step = self.script.get(timeout=PATIENCE_S)
            if step is None:
                return
            if isinstance(step, BaseException):
                raise step
            if isinstance(step, SensorFrame):
                yield step
            else:
                step()


def all_threads_end(earlier):
    """Returns whether all threads but the earlier ones end within a time limit."""
    others = set(threading.enumerate()) - earlier
    for thread in others:
        thread.join(PATIENCE_S)
    return not any(thread.is_alive() for thread in others)


def unplugged(name="000123"):
    return DeviceError(f"Kinect {name} was unplugged.")
