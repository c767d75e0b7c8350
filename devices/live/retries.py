"""How long to wait before a lost sensor is opened again."""

from __future__ import annotations

from devices.sensor import AbsentError, DeviceError

_LONGEST_S = 10.0


class Retries:
    """Waits twice as long after each opening that fails, up to ten seconds.

    Each opening that libk4a refuses searches the USB bus while pyk4a holds the GIL, and leaks in pyk4a. A
    sensor that is not connected is not opened at all, so that is asked at the first interval again and again.

    Args:
        first_s: How long to wait after the first failure.
    """

    def __init__(self, first_s: float) -> None:
        self._first_s = self._next_s = first_s

    def after(self, fault: DeviceError) -> float:
        """Seconds to wait after this failure."""
        if isinstance(fault, AbsentError):
            return self._first_s
        wait_s, self._next_s = self._next_s, max(self._first_s, min(2.0 * self._next_s, _LONGEST_S))
        return wait_s

    def succeeded(self) -> None:
        """Starts anew: the sensor was opened."""
        self._next_s = self._first_s
