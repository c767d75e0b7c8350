"""Opens the sensors of ``duplex live`` of which one or both hang on another PC."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console

from devices.capture.sensor_pair import TwoSensors
from devices.capture.stream_pairing import LivePairing
from devices.events import Event
from devices.network.remote_sensor import PREFIX, RemoteSensor
from devices.network.zenoh_session import ZenohAddresses, zenoh_session
from devices.sensor import Sensor
from viewer_app.addresses import zenoh_warning
from viewer_app.errors import UsageError
from viewer_app.options.sensing import LiveOptions
from viewer_app.options.shared import SensorOptions


def names_remote(options: SensorOptions) -> bool:
    """Whether a sensor is named ``zenoh:KEY``."""
    return any((name or "").startswith(PREFIX) for name in (options.kinect_a, options.kinect_b))


@contextmanager
def sensors_by_network(
    options: LiveOptions, console: Console, local: Callable[[str | None], Sensor]
) -> Iterator[TwoSensors]:
    """The two sensors; those on other PCs have described themselves, and none is open.

    Args:
        local: Makes the sensor of this PC with a serial number; None: the only one that is connected.

    Raises:
        DeviceError, UsageError: A sensor is not there, both are the same, or they report different bodies.
    """
    if options.principal is not None or options.sync_master is not None:
        unused = "--principal" if options.principal is not None else "--sync-master"
        raise UsageError(f"{unused} is for two Kinects on this PC; leave it out with zenoh:KEY.")
    if options.kinect_a == options.kinect_b:
        raise UsageError(f"Sensors A and B are both {options.kinect_a}. Name two different sensors.")
    addresses = ZenohAddresses.of_meeting_point(options.zenoh_listen, options.zenoh_connect)
    if options.zenoh is None:  # else its output warns
        warn_of_others(addresses, console)
    names = options.kinect_a, options.kinect_b
    a, b = (
        RemoteSensor(name.removeprefix(PREFIX), addresses) if (name or "").startswith(PREFIX) else None
        for name in (name or "" for name in names)
    )
    with ExitStack() as stack:
        # One session for as long as the command runs: it goes on listening while a sensor is away.
        stack.enter_context(zenoh_session(addresses))
        for remote in (a, b):
            if remote is not None:
                console.print(f"Waiting for {remote.name} …", markup=False)
                with remote:
                    pass
        interval_ns = min(interval_of(remote, options.fps) for remote in (a, b))
        sensor_a: Sensor = a if a is not None else local(names[0])
        sensor_b: Sensor = b if b is not None else local(names[1])
        if sensor_a.body is not sensor_b.body:
            raise UsageError(
                f"A reports the body {sensor_a.body.name}, B {sensor_b.body.name}. Both need the same "
                f"body tracker."
            )
        yield TwoSensors(sensor_a, sensor_b, pairing=LivePairing(interval_ns), tell=teller(console))


def interval_of(remote: RemoteSensor | None, fps: float) -> int:
    """Nominal time between two frames, ns: what a remote sensor says; ``--fps`` is of a sensor of this PC."""
    return round(1e9 / fps) if remote is None else remote.interval_ns


def warn_of_others(addresses: ZenohAddresses, console: Console) -> None:
    """Warns where other machines can reach Zenoh."""
    if warning := zenoh_warning(addresses.listen):
        console.print(warning, style="yellow", markup=False, soft_wrap=True)


def teller(console: Console) -> Callable[[Event], None]:
    """Prints events of sensors."""
    return lambda event: console.print(event.text, style="yellow", markup=False)
