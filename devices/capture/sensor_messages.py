"""Messages for a sensor in trouble."""

from __future__ import annotations

from devices.sensor import DeviceError


def not_opened(sensor: str, within_s: float, waits_for: str) -> DeviceError:
    """The error for a sensor that did not open in time.

    Args:
        sensor: Its name.
        within_s: How long that was, in seconds.
        waits_for: What it is known to wait for; empty if nothing explains it.
    """
    cause = f"it waits for {waits_for}" if waits_for else "its driver hangs"
    return DeviceError(
        f"{sensor} did not open in {within_s:g} s: {cause}. Try again; if it is the same, unplug it and plug "
        f"it in again first."
    )


def not_closed(sensor: str, waits_for: str) -> str:
    """Message for a sensor that does not close in time; arguments as for :func:`not_opened`."""
    if waits_for:
        return (
            f"{sensor} does not close yet: it waits for {waits_for}. It closes by itself after that; leave "
            f"it plugged in."
        )
    return f"{sensor} does not close; it is left behind. Unplug it before using it again."


def failed_within(sensor: str, fault: Exception) -> DeviceError:
    """The error for a fault of the program or a driver, which reopening does not fix."""
    what = f"{type(fault).__name__}: {fault}".rstrip(": ")
    return DeviceError(
        f"{sensor} failed within its driver or this program ({what}). What was saved stays readable. Start "
        f"again; if it comes back, report it."
    )
