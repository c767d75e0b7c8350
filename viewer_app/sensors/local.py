"""The two sensors of a live session, as the options, the cables and the user choose them."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from devices.azure.settings import KinectSettings
from devices.capture.sensor_choice import (
    ConnectedSensor,
    NeedsChoiceError,
    cable_notes,
    choose_one,
    choose_two,
    sync_master,
)
from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import LASER_GAP_US
from devices.capture.stream_pairing import LivePairing
from devices.network.remote_sensor import PREFIX
from devices.sensor import CableSync, Orientation, Sensor
from devices.tracker_choice import TrackerChoice
from viewer_app.options.sensing import LiveOptions, RecordOptions
from viewer_app.options.shared import SensorOptions
from viewer_app.sensors.remote import teller
from viewer_app.sensors.tracker import announce_tracker, decimation_of, tracker_of


def two_connected_sensors(options: LiveOptions | RecordOptions, console: Console) -> TwoSensors:
    """Chooses the two sensors from the options, the sync cable and the user's answers; opens neither.

    Raises:
        DeviceError: Fewer than two usable Kinects, no SDK, or a wrongly connected sync cable.
    """
    from devices.live.sensors import live_sensor

    tracker = tracker_of(options) if isinstance(options, LiveOptions) else None
    (kinect_a, kinect_b), tracker = _chosen(lambda found: _choose(found, options, console), tracker)
    master = sync_master(kinect_a, kinect_b, options.sync_master)
    for note in cable_notes(kinect_a, kinect_b, master):
        console.print(note, style="yellow", markup=False)
    if master is not None:
        leads, follows = ("A", "B") if master == kinect_a.serial else ("B", "A")
        console.print(
            f"Sync cable: {leads} leads, {follows} captures on its pulses and is started first, so that it "
            f"sees the first pulse."
        )
    if tracker is not None and isinstance(options, LiveOptions):
        announce_tracker(tracker, console)
        if options.processing == "cpu" and tracker.name == "k4abt":
            console.print(
                "A CPU tracks only about one frame per second from both sensors. To fuse every frame, run "
                "duplex record, then duplex fuse a.mkv b.mkv.",
                style="yellow",
            )
        if options.processing == "tensorrt" and tracker.name == "k4abt":
            console.print("TensorRT builds its engine, which takes minutes the first time.")
    decimation = decimation_of(tracker, options.fps)
    settings_a, settings_b = (capture_settings(options, kinect, master) for kinect in (kinect_a, kinect_b))
    turned_a, turned_b = options.orientations if isinstance(options, LiveOptions) else (0, 0)
    a = live_sensor(kinect_a, settings_a, tracker, decimation, turned_a or 0)
    b = live_sensor(kinect_b, settings_b, tracker, decimation, turned_b or 0)
    later_us = settings_b.delay_us if master == kinect_a.serial else -settings_a.delay_us
    delay_ns = None if master is None else 1000 * later_us
    pairing = LivePairing(round(1e9 / options.fps), sync_delay_ns=delay_ns)
    return TwoSensors(
        a,
        b,
        pairing=pairing,
        decimation=decimation,
        limits=TimeLimits(open_s=opens_within(options)),
        tell=teller(console),
    )


def one_of_live(options: LiveOptions, console: Console, serial: str | None) -> Sensor:
    """The sensor of this PC, where the other one is on another PC; it runs without a sync cable."""
    tracker = tracker_of(options)
    named = "--kinect-a or --kinect-b"
    orientation = options.orientations[(options.kinect_a or "").startswith(PREFIX)] or 0
    return one_sensor(serial, named, tracker, capture_settings(options), console, orientation)


def one_sensor(
    serial: str | None,
    option: str,
    tracker: TrackerChoice,
    settings: KinectSettings,
    console: Console,
    orientation: Orientation = 0,
) -> Sensor:
    """The only sensor of this PC, or the one with a serial number, with its body tracker; opens nothing.

    Raises:
        DeviceError: It is not there, or several are and none is named; the message names the `option`.
    """
    from devices.live.sensors import live_sensor

    (kinect,), fitting = _chosen(lambda found: [choose_one(found, serial, option)], tracker)
    announce_tracker(fitting or tracker, console)
    return live_sensor(kinect, settings, fitting, decimation_of(fitting, settings.fps), orientation)


def two_played_sensors(options: LiveOptions, paths: Sequence[Path], console: Console) -> TwoSensors:
    """Two recordings of images as live sensors, at the pace at which they were recorded; opens neither.

    Raises:
        DeviceError: One cannot be read, or both are the same.
    """
    from devices.blazepose.tracked_images import TrackedImages
    from devices.pairing import ONE_RUN_NS
    from devices.recorded.files import distinct_names, images_of, not_of_libk4a, open_images, open_source
    from devices.recorded.two_recordings import cable_delay_ns, refuse_same
    from devices.simulated.real_time import Beat, PacedSensor
    from devices.upright import upright

    refuse_same(*paths)
    tracker = tracker_of(options).for_images_of(not_of_libk4a(*paths))
    announce_tracker(tracker, console, *paths)
    syncs: list[CableSync | None] = []
    intervals: list[int] = []
    arrivals: list[int] = []  # of the first frames, where they were recorded
    for path in paths:
        with open_images(path) as images:
            syncs.append(images.sync)
            intervals.append(images.interval_ns)
            if images.sync is not None:
                arrivals += filter(None, [next(images.frames()).host_ns])
    one_run = len(arrivals) == 2 and abs(arrivals[1] - arrivals[0]) < ONE_RUN_NS
    delay_ns = cable_delay_ns(*syncs)
    decimation = decimation_of(tracker, 1e9 / min(intervals))
    on_cable = delay_ns is not None and len(arrivals) < 2
    beat = Beat(2, common="arrival" if one_run else "capture" if on_cable else None)
    played: list[Sensor] = []
    names = distinct_names(*map(str, paths))
    for path, name, orientation in zip(paths, names, options.orientations, strict=True):
        if tracker.name == "k4abt":
            tracked = open_source(path, tracker=tracker, orientation=orientation or 0)
            images_of(tracked).name = name
            played.append(PacedSensor(tracked, beat))
        else:
            images = open_images(path)
            images.name = name
            paced = upright(PacedSensor(images, beat, decimation), orientation or 0)
            played.append(TrackedImages(paced, tracker.blazepose, pace=decimation))  # type: ignore[arg-type]
    return TwoSensors(
        *played,
        pairing=LivePairing(min(intervals), sync_delay_ns=delay_ns),
        decimation=decimation,
        tell=teller(console),
    )


def _chosen(
    choose: Callable[[Sequence[ConnectedSensor]], Sequence[str]], tracker: TrackerChoice | None
) -> tuple[list[ConnectedSensor], TrackerChoice | None]:
    """The sensors whose serial numbers are chosen, and the tracker that takes the images of all of them.

    Which library opens a Femto depends on the tracker, so the sensors are listed again for another one.
    """
    from devices.live.sensors import connected_sensors

    connected = connected_sensors(tracker)
    serials = choose(connected)
    chosen = [next(sensor for sensor in connected if sensor.serial == serial) for serial in serials]
    if tracker is None:
        return chosen, None
    fitting = tracker.for_images_of([str(sensor.serial) for sensor in chosen if sensor.sdk != "k4a"])
    if fitting.name == tracker.name:
        return chosen, fitting
    again = connected_sensors(fitting)
    found = [next((other for other in again if other.serial == one.serial), one) for one in chosen]
    return found, fitting


def _choose(
    connected: Sequence[ConnectedSensor], options: SensorOptions, console: Console
) -> tuple[str, str]:
    try:
        return choose_two(connected, options.kinect_a, options.kinect_b, options.principal)
    except NeedsChoiceError as choice:
        if not sys.stdin.isatty():
            raise
        principal = _ask(choice, console)
        console.print(f"Next time: --principal {principal}")
        return choose_two(connected, principal=principal)


def _ask(choice: NeedsChoiceError, console: Console) -> str:
    one, two = choice.serials
    console.print(f"Two sensors are connected: [bold]1[/] {one}, [bold]2[/] {two}.")
    console.print(
        "Their serial numbers are on the labels underneath. S* will be in the principal one's frame."
    )
    while True:
        try:
            answer = console.input("Which one is the principal sensor A? [1/2] ").strip()
        except EOFError:
            raise choice from None
        if answer in ("1", one):
            return one
        if answer in ("2", two):
            return two


def capture_settings(
    options: LiveOptions | RecordOptions, sensor: ConnectedSensor | None = None, master: str | None = None
) -> KinectSettings:
    """The settings of a sensor, which has its place on the cable that leads out of ``master``.

    A RealSense captures at its master's pulse; the other vendors' sensors can be told to wait.
    """
    leads = sensor is not None and sensor.serial == master
    return KinectSettings(
        depth_mode=options.depth_mode,
        fps=options.fps,
        color=None if options.color == "off" else options.color,
        sync="standalone" if master is None else "master" if leads else "subordinate",
        delay_us=0 if sensor is not None and sensor.sdk == "realsense" else LASER_GAP_US,
        trust_jacks=options.sync_master is None,
        start_s=opens_within(options),
    )


def opens_within(options: LiveOptions | RecordOptions) -> float:
    """The time limit for opening a sensor and its body tracker, seconds."""
    return 900.0 if isinstance(options, LiveOptions) and options.processing == "tensorrt" else 120.0
