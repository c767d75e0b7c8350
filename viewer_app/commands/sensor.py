"""``duplex sensor``: runs one sensor and its body tracker, and publishes its skeletons over Zenoh."""

import threading
import time
from contextlib import ExitStack

from rich.console import Console

from devices.azure.settings import KinectSettings
from devices.capture.sensor_thread import SensorThread
from devices.network.publishing import FramePublisher, publish_until
from devices.network.remote_sensor import PREFIX
from devices.network.zenoh_session import ZenohAddresses, checked_key, load_zenoh
from devices.recorded.files import frame_interval_ns, has_images, not_of_libk4a, open_source
from devices.sensor import Sensor
from devices.simulated.demonstration import demonstrated, sensor_by_wall_clock
from devices.simulated.real_time import PacedSensor
from fusion.body import BODIES
from viewer_app.errors import UsageError
from viewer_app.options.sensing import PublishOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.running.interruption import CtrlC, call_after
from viewer_app.sensors.local import one_sensor
from viewer_app.sensors.remote import teller, warn_of_others
from viewer_app.sensors.tracker import announce_tracker, tracker_of

_EVERY_S = 10.0  # seconds between two lines about what was sent


def run(options: PublishOptions) -> None:
    """Runs the command."""
    console = output_console()
    addresses = ZenohAddresses.of_visitor(options.zenoh_listen, options.zenoh_connect)
    checked_key(options.publish)
    load_zenoh()
    check_seconds(options.seconds)
    warn_of_others(addresses, console)
    sensor = _sensor(options, console)
    tell = teller(console)
    stopped = threading.Event()
    with CtrlC() as ctrl_c, ExitStack() as stack:
        console.print(f"Opening {sensor.name} …", markup=False)
        thread = SensorThread(sensor, keep=8)
        with ctrl_c.raising():  # a body tracker may take minutes to load its network
            stack.enter_context(thread)
        ctrl_c.calls(stopped.set)
        publisher = stack.enter_context(
            FramePublisher(
                options.publish,
                addresses,
                sensor,
                interval_ns=frame_interval_ns(sensor) or round(1e9 / options.fps),
                depth=options.depth,
            )
        )
        where = ", ".join((*addresses.listen, *addresses.connect))
        console.print(
            f"Publishing {sensor.name} as {PREFIX}{options.publish} at {where}. Press Ctrl-C to end.",
            markup=False,
        )
        if not options.quiet:
            stack.callback(stopped.set)
            reports = threading.Thread(
                target=_report, args=(publisher, console, stopped), name="reports", daemon=True
            )
            reports.start()
        with call_after(options.seconds, stopped.set):
            publish_until(thread, publisher, stopped, tell)
    for warning in sensor.warnings:
        console.print(warning, style="yellow", markup=False)
    console.print(_summary(thread, publisher))


def _report(publisher: FramePublisher, console: Console, stopped: threading.Event) -> None:
    """Prints a line about what was sent every ten seconds."""
    before_s, before_frames, before_bytes = time.monotonic(), 0, 0
    while not stopped.wait(_EVERY_S):
        now_s, frames, sent = time.monotonic(), publisher.published, publisher.bytes_sent
        elapsed_s = now_s - before_s
        rate, size = (frames - before_frames) / elapsed_s, (sent - before_bytes) / elapsed_s
        asked = "" if publisher.requests else "; nobody listens yet"
        console.print(f"{rate:.1f} frames and {size * 1e-3:.0f} kB per second{asked}.")
        before_s, before_frames, before_bytes = now_s, frames, sent


def _sensor(options: PublishOptions, console: Console) -> Sensor:
    given = {"--kinect": options.kinect, "--recording": options.recording, "--simulate": options.simulate}
    several = [name for name, value in given.items() if value is not None]
    if len(several) > 1:
        raise UsageError(f"{' and '.join(several)} cannot be combined: one program runs one sensor.")
    if options.simulate is not None:
        which = "ab".index(options.simulate)
        return sensor_by_wall_clock(which, demonstrated(options.motion), BODIES[options.body])
    tracker = tracker_of(options)
    if options.recording is not None:
        if has_images(options.recording):
            tracker = tracker.for_images_of(not_of_libk4a(options.recording))
            announce_tracker(tracker, console, options.recording)
        turned = options.orientation or None
        return PacedSensor(
            open_source(options.recording, tracker=tracker, stated=options.stated, orientation=turned)
        )
    settings = KinectSettings(depth_mode=options.depth_mode, fps=options.fps)
    return one_sensor(options.kinect, "--kinect", tracker, settings, console, options.orientation)


def _summary(thread: SensorThread, publisher: FramePublisher) -> str:
    said = f"frames published: {publisher.published}, {publisher.bytes_sent * 1e-6:.1f} MB"
    if thread.dropped:
        said += f", {thread.dropped} dropped: this PC is too slow"
    if not publisher.requests:
        said += "; nobody listened"
    return f"{said}."
