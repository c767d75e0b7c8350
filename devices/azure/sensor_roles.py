"""Which of the connected Kinects is A, which is B, and which leads on the sync cable."""

from __future__ import annotations

from collections.abc import Sequence

from devices.azure.pyk4a_access import ConnectedKinect
from devices.sensor import DeviceError


class NeedsChoiceError(DeviceError):
    """Two Kinects are connected and nobody said which is the principal one: ask, or ``--principal``.

    Attributes:
        serials: The two, sorted.
    """

    def __init__(self, serials: tuple[str, str]) -> None:
        super().__init__(
            f"Two Kinects are connected, {serials[0]} and {serials[1]}. Say which one the person faces: "
            f"--principal {serials[0]} or --principal {serials[1]}."
        )
        self.serials = serials


def choose_two(
    connected: Sequence[ConnectedKinect],
    a: str | None = None,
    b: str | None = None,
    principal: str | None = None,
) -> tuple[str, str]:
    """The serial numbers of K_A (the principal sensor) and K_B.

    Args:
        connected: What is there.
        a, b: Serial numbers asked for; one alone leaves the other to what is connected.
        principal: Serial number of K_A, when ``a`` is not given.

    Raises:
        NeedsChoiceError: Exactly two are there, and none is named.
        DeviceError: Not two, one of them cannot be opened, or a name is not among them.
    """
    a = a or principal
    there = sorted(kinect.serial for kinect in connected if kinect.serial is not None)
    faults = [kinect.fault for kinect in connected if kinect.fault]
    listed = ", ".join(there) or "none"
    for serial in (a, b):
        if serial is not None and serial not in there:
            raise DeviceError(
                f"No Kinect with serial {serial}. Connected: {listed}. "
                + (f"Another cannot be opened: {faults[0]}" if faults else "Check its USB and power.")
            )
    if a is not None and a == b:
        raise DeviceError(f"Kinect A and B are both {a}. Name two different sensors. Connected: {listed}.")
    if a is not None and b is not None:
        return a, b
    if faults:
        raise DeviceError(f"A Kinect cannot be opened: {faults[0]} Connected: {listed}.")
    if not there:
        raise DeviceError("No Kinect is connected. Plug in two: USB 3 and a power supply each.")
    if len(there) == 1:
        raise DeviceError(
            f"Only one Kinect is connected, {there[0]}; fusion needs two. Check the other one's USB and "
            f"power (its light is white when ready), or record with one and fuse later."
        )
    named = a or b
    if len(there) > 2:
        raise DeviceError(
            f"{len(there)} Kinects are connected: {listed}. Choose two: --kinect-a, --kinect-b."
        )
    if named is None:
        raise NeedsChoiceError((there[0], there[1]))
    other = there[1] if there[0] == named else there[0]
    return (named, other) if a is not None else (other, named)


def sync_master(a: ConnectedKinect, b: ConnectedKinect) -> str | None:
    """The serial number of the sensor that leads on the sync cable; None when there is no cable.

    The cable leads from the master's sync out to the subordinate's sync in. Start the subordinate first.

    Raises:
        DeviceError: A cable is there but joins no out to an in.
    """
    for master, subordinate in ((a, b), (b, a)):
        if master.sync_out and subordinate.sync_in:
            return master.serial
    if not any((a.sync_in, a.sync_out, b.sync_in, b.sync_out)):
        return None
    jacks = "; ".join(
        f"{kinect.serial}: in {'connected' if kinect.sync_in else 'empty'}, "
        f"out {'connected' if kinect.sync_out else 'empty'}"
        for kinect in (a, b)
    )
    raise DeviceError(
        f"The sync cable joins no sync out to a sync in ({jacks}). Lead it from one sensor's sync out to the "
        f"other's sync in, or unplug it to run without."
    )
