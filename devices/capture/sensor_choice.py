"""The connected sensors: which is A, which is B, and which is the master on the sync cable."""

from collections.abc import Sequence
from dataclasses import dataclass

from devices.sensor import DeviceError

_PLUG = "USB 3 (a Kinect v1: USB 2) and a power supply"
PLUG_IN_TWO = f"Plug in two: {_PLUG} each, on two USB controllers."


@dataclass(frozen=True)
class ConnectedSensor:
    """A sensor that a vendor's software sees."""

    index: int  # its place in the list, which changes when sensors come and go
    serial: str | None  # its serial number; None if it cannot be opened
    sync_in: bool | None = None
    sync_out: bool | None = None
    """Whether a cable is in the jack; None if it cannot be opened."""
    fault: str = ""  # why it cannot be opened; empty if it can
    sdk: str = "k4a"  # whose software gives its images: libk4a's, or a name in ``devices.live.sensors``
    description: str = ""  # its model, connection or firmware, as far as the software tells
    advice: str = ""  # what to do about its firmware; empty if nothing
    tells_jacks: bool = True  # whether its software tells whether a cable is in a jack
    has_port: bool = True  # whether a sync cable fits

    @property
    def hides_jacks(self) -> bool:
        """Whether it may be on a cable that its software does not tell of.

        Orbbec's K4A wrapper always says that the jacks are empty. Its serial numbers hold letters,
        Microsoft's do not.
        """
        wrapped = self.sdk == "k4a" and self.serial is not None and not self.serial.isdigit()
        return wrapped or not self.tells_jacks


class NeedsChoiceError(DeviceError):
    """Two sensors are connected and the principal one is not named: ask the user, or use ``principal``."""

    def __init__(self, serials: tuple[str, str]) -> None:
        super().__init__(
            f"Two sensors are connected, {serials[0]} and {serials[1]}. Say which one the person faces: "
            f"`principal={serials[0]}` or `principal={serials[1]}`."
        )
        self.serials = serials


def choose_one(connected: Sequence[ConnectedSensor], serial: str | None, option: str) -> str:
    """The serial number of one sensor: the one asked for, else the only one.

    Raises:
        DeviceError: It is not there, or more than one is and none is named; the message names the `option`.
    """
    there = _serials(connected, serial)
    if serial is not None:
        return serial
    if len(there) != 1:
        advice = f"Name one with {option}." if there else f"Plug it in: {_PLUG}."
        raise DeviceError(f"Connected sensors: {', '.join(there) or 'none'}. {advice}")
    return there[0]


def choose_two(
    connected: Sequence[ConnectedSensor],
    a: str | None = None,
    b: str | None = None,
    principal: str | None = None,
) -> tuple[str, str]:
    """The serial numbers of K_A (the principal sensor) and K_B. One that is asked for leaves the other to
    what is connected.

    Raises:
        NeedsChoiceError: Exactly two are there, and none is named.
        DeviceError: Not two, one of them cannot be opened, a name is not among them, or A has two names.
    """
    if a is not None and principal is not None and a != principal:
        raise DeviceError(f"`kinect_a={a}` and `principal={principal}` both name K_A. Leave one of them out.")
    a = a or principal
    there = _serials(connected, a, b)
    listed = ", ".join(there)
    if a is not None and a == b:
        raise DeviceError(f"Sensors A and B are both {a}. Name two different sensors. Connected: {listed}.")
    if a is not None and b is not None:
        return a, b
    if not there:
        raise DeviceError(f"No sensor is connected. {PLUG_IN_TWO} {_LIBRARIES}")
    if len(there) == 1:
        raise DeviceError(
            f"Only one sensor is connected, {there[0]}; fusion needs two. Check the other one's USB and "
            f"power (its light is white when ready), or record with one and fuse later."
        )
    named = a or b
    if len(there) > 2:
        raise DeviceError(
            f"{len(there)} sensors are connected: {listed}. Choose two: `kinect_a`, `kinect_b`."
        )
    if named is None:
        raise NeedsChoiceError((there[0], there[1]))
    other = there[1] if there[0] == named else there[0]
    return (named, other) if a is not None else (other, named)


def _serials(connected: Sequence[ConnectedSensor], *named: str | None) -> list[str]:
    """The serial numbers that are there, sorted, with those asked for; None asks for any."""
    there = sorted(kinect.serial for kinect in connected if kinect.serial is not None)
    faults = [kinect.fault for kinect in connected if kinect.fault]
    listed = ", ".join(there) or "none"
    for serial in named:
        if serial is not None and serial not in there:
            why = f"Another cannot be opened: {faults[0]}" if faults else "Check its USB and power."
            why += "" if there or faults else f" {_LIBRARIES}"
            raise DeviceError(f"No sensor with serial {serial}. Connected: {listed}. {why}")
    if faults and None in named:
        raise DeviceError(f"A sensor cannot be opened: {faults[0]} Connected: {listed}.")
    return there


def sync_master(a: ConnectedSensor, b: ConnectedSensor, named: str | None = None) -> str | None:
    """The serial number of the sensor that leads on the sync cable; None when there is no cable.

    The cable leads from the master's sync out to the subordinate's sync in. Start the subordinate first.

    Args:
        named: The master, where the person says which one it is. Hidden jacks are not asked then;
            Microsoft's know better than the person.

    Raises:
        DeviceError: A cable is there but joins no out to an in, or the master named is neither of the two or
            not where a cable leads out.
    """
    if named is not None:
        if named not in (a.serial, b.serial):
            raise DeviceError(
                f"`sync_master={named}` is neither of the two sensors chosen, {a.serial} and {b.serial}."
            )
        if not (a.has_port and b.has_port):
            raise DeviceError(f"`sync_master={named}`: {no_port(a, b)} Leave `sync_master` out.")
        leads, follows = (a, b) if named == a.serial else (b, a)
        seen = (leads.hides_jacks or leads.sync_out) and (follows.hides_jacks or follows.sync_in)
        if not seen:
            raise DeviceError(
                f"`sync_master={named}`: no cable leads from its sync out to the sync in of {follows.serial} "
                f"({_jacks(a, b)}). Put the cable there, or leave `sync_master` out."
            )
        return named
    for master, subordinate in ((a, b), (b, a)):
        if master.sync_out and subordinate.sync_in:
            return master.serial
    if not any((a.sync_in, a.sync_out, b.sync_in, b.sync_out)):
        return None
    lead = "Lead it from one sensor's sync out to the other's sync in, or unplug it to run without."
    way_out = f"{no_port(a, b)} Unplug it to run without." if no_port(a, b) else lead
    unknown = "" if no_port(a, b) else cable_unknown(a, b)
    raise DeviceError(
        f"The sync cable joins no sync out to a sync in ({_jacks(a, b)}). {way_out} {unknown}".rstrip()
    )


def _jacks(*sensors: ConnectedSensor) -> str:
    def jack(sensor: ConnectedSensor, cable: bool | None) -> str:
        return "unknown" if sensor.hides_jacks else "connected" if cable else "empty"

    return "; ".join(
        f"{sensor.serial}: in {jack(sensor, sensor.sync_in)}, out {jack(sensor, sensor.sync_out)}"
        for sensor in sensors
        if sensor.has_port
    )


def cable_unknown(a: ConnectedSensor, b: ConnectedSensor) -> str:
    """Advice if no cable was detected but one may exist: some software cannot detect cables."""
    hidden = [str(kinect.serial) for kinect in (a, b) if kinect.hides_jacks]
    if not hidden:
        return ""
    return (
        f"The vendor's software does not say whether a sync cable is in {' and '.join(hidden)}. "
        f"If there is one, name the sensor that it leads out of: `sync_master={a.serial}` or {b.serial}."
    )


def no_port(a: ConnectedSensor, b: ConnectedSensor) -> str:
    """A sentence if a sync cable does not fit into both; else empty."""
    without = [str(sensor.serial) for sensor in (a, b) if not sensor.has_port]
    return f"No sync cable fits into {' and '.join(without)}." if without else ""


def cable_notes(a: ConnectedSensor, b: ConnectedSensor, master: str | None) -> list[str]:
    """Notes for the user about the sync cable and the firmware it needs."""
    if master is None:
        if no_port(a, b):
            return [f"{no_port(a, b)} {_APART}"]
        return [cable_unknown(a, b) or f"No sync cable. {_APART} {_CABLE_HELPS}"]
    return [sensor.advice for sensor in (a, b) if sensor.advice]


_LIBRARIES = "duplex doctor names the sensor libraries that are missing."
_APART = "Pairs are up to half a frame apart, and the sensors' lasers disturb each other where both shine."
_CABLE_HELPS = "A 3.5 mm cable from one's sync out to the other's sync in helps both."
