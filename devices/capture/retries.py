"""The back-off between attempts to reopen a lost sensor."""

from __future__ import annotations

from devices.sensor import AbsentError, DeviceError

_LONGEST_S = 10.0


class Retries:
    """Doubles the wait after each failed attempt, up to ten seconds.

    Each failed attempt searches the USB bus while pyk4a holds the GIL, and leaks memory in pyk4a. A sensor
    that is not connected causes no such attempt, so its wait stays at ``first_s``.

    Args:
        first_s: Wait after the first failed attempt, in seconds.
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
