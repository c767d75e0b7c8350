"""Queries the state of a sensor on its own thread, and builds the messages for a sensor in trouble."""

from __future__ import annotations

from typing import TypeGuard

from devices.sensor import (
    ArrivesByNetwork,
    CountsMissed,
    DeviceError,
    LinkFigures,
    NamesItsWait,
    Sensor,
)


def _counts_missed(sensor: Sensor) -> TypeGuard[CountsMissed]:
    # asked several times per frame, and ``isinstance`` with a protocol takes 30 µs
    return hasattr(sensor, "missed")


def _arrives_by_network(sensor: Sensor) -> TypeGuard[ArrivesByNetwork]:
    return hasattr(sensor, "link") and hasattr(sensor, "told")


def wait_of(sensor: Sensor) -> str:
    """What a sensor is waiting for, if it reports this; else empty."""
    return sensor.waits_for if isinstance(sensor, NamesItsWait) else ""


def told_by(sensor: Sensor) -> list[str]:
    """What happened to a sensor's messages on their way, if it hangs on another PC."""
    return sensor.told() if _arrives_by_network(sensor) else []


def link_of(sensor: Sensor) -> LinkFigures | None:
    """How a sensor's messages arrive; None for a sensor of this machine."""
    return sensor.link if _arrives_by_network(sensor) else None


def missed_by(sensor: Sensor) -> int:
    """Number of captured frames that never arrived, if the sensor counts them; else 0."""
    return sensor.missed if _counts_missed(sensor) else 0


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
