"""State of a sensor on its own thread, the back-off between attempts to reopen it, and its messages."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from devices.capture.causes import Cause
from devices.sensor import AbsentError, DeviceError, FrameError, Sensor, SensorFrame

_LONGEST_S = 10.0
_JOINTLESS = 30  # skeletons: a second


class Arrival(NamedTuple):
    """A frame that a sensor's thread handed on."""

    at_ns: int
    """When it arrived, on the thread's clock: a reader that was busy learns what it would have seen."""
    frame: SensorFrame
    opening: int = 0
    """How often the sensor had come back before it: its clock may have started anew with each opening."""


class SensorState(Enum):
    """What a sensor is doing."""

    CLOSED = "closed"
    OPENING = "opening"
    RUNNING = "running"
    STALLED = "stalled"
    """Open, but without a frame for too long."""
    LOST = "lost"
    """Failed; it is reopened until it works again."""
    ENDED = "ended"
    """The source has reached its end."""


@dataclass(frozen=True)
class TimeLimits:
    """How long a sensor on its own thread may take."""

    open_s: float = 120.0
    """Longest time for opening, and for the first frame: a body tracker loads its network."""
    stall_s: float = 2.0  # longest time without a frame; longer where frames are rarer
    retry_s: float = 1.0  # wait before a lost sensor is reopened; longer if it is there and does not open


USUAL_LIMITS = TimeLimits()


class Retries:
    """Doubles the wait after each failed attempt, up to ten seconds.

    Each failed attempt searches the USB bus while pyk4a holds the GIL, and leaks memory in pyk4a. A sensor
    that is not connected causes no such attempt, so its wait stays at ``first_s``.
    """

    def __init__(self, first_s: float) -> None:
        self._first_s = self._next_s = first_s

    def after(self, fault: DeviceError) -> float:
        """Returns the seconds to wait after this failure."""
        if isinstance(fault, AbsentError):
            return self._first_s
        wait_s, self._next_s = self._next_s, max(self._first_s, min(2.0 * self._next_s, _LONGEST_S))
        return wait_s

    def succeeded(self) -> None:
        """Resets the wait after the sensor was opened."""
        self._next_s = self._first_s


class FrameBorder:
    """The border for the people of a source: skeletons of its body, which have joints.

    Args:
        tell: Gets a line for the user if none of the first skeletons has a joint.
    """

    def __init__(self, sensor: Sensor, tell: Callable[[str], None]) -> None:
        self._sensor, self._tell = sensor, tell
        self._jointless: int | None = None if sensor.tracked_by else 0  # skeletons; None: not counted

    def check(self, frame: object) -> None:
        """Checks the next frame.

        Raises:
            BodyError: It is no frame, or a skeleton has another body.
        """
        name = self._sensor.name
        if not isinstance(frame, SensorFrame):
            raise FrameError(f"The frames of {name} are each a SensorFrame; got a {type(frame).__name__}.")
        for person in frame.people.values():
            self._sensor.body.require(person.body, f"A skeleton of {name}")
            if self._jointless is not None:
                self._jointless = None if person.states.any() else self._jointless + 1
        if self._jointless is not None and self._jointless >= _JOINTLESS:
            self._jointless = None
            self._tell(
                f"{name}: its skeletons have no joint in front of it and within range. Positions are in "
                f"metres, z forward; give no people while nobody is seen."
            )


def not_opened(sensor: Sensor, within_s: float) -> DeviceError:
    """The error for a sensor that did not open in time."""
    cause = f"it waits for {sensor.waits_for}" if sensor.waits_for else "its driver hangs"
    cause = "its disk or its body tracker hangs" if sensor.recorded else cause
    again = "" if sensor.recorded else "; if it is the same, unplug it and plug it in again first"
    return DeviceError(f"{sensor.name} did not open in {within_s:g} s: {cause}. Try again{again}.")


def not_closed(sensor: Sensor) -> str:
    """Message for a sensor that does not close in time."""
    left = Cause.RECORDING_LEFT_BEHIND if sensor.recorded else Cause.LEFT_BEHIND
    cause = Cause.CLOSES_LATER if sensor.waits_for else left
    return cause.says(label=sensor.name, waits_for=sensor.waits_for)


def failed_within(sensor: str, fault: Exception) -> DeviceError:
    """The error for a fault of the program or a driver, which reopening does not fix."""
    what = f"{type(fault).__name__}: {fault}".rstrip(": ")
    return DeviceError(
        f"{sensor} failed within its driver or this program ({what}). What was saved stays readable. Start "
        f"again; if it comes back, report it."
    )
