"""``duplex live``: fuses two connected Kinects and shows or saves the session."""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from devices.azure.kinect import KinectSensor
from devices.azure.kinect_settings import LASER_GAP_US, KinectSettings, check_modes
from devices.azure.pyk4a_access import ConnectedKinect, connected_kinects
from devices.azure.sensor_roles import NeedsChoiceError, cable_notes, choose_one, choose_two, sync_master
from devices.azure.tracking.body_tracker import TrackerSettings, check_smoothing
from devices.image_thinning import thinned_camera
from devices.live.frame_decimation import FrameDecimation
from devices.live.sensor_pair import TwoSensors
from devices.live.stream_pairing import LivePairing, Side
from devices.sensor import Sensor
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings.calibration_file import calibration_to_json, read_calibration
from viewer_app.coach.setup_coach import WARM_UP, Coach
from viewer_app.errors import UsageError
from viewer_app.loop.fusing import warm_up
from viewer_app.loop.interruption import CtrlC
from viewer_app.loop.live_loop import Status, run_live
from viewer_app.loop.live_summary import check_saved, print_saved, print_session, session_report
from viewer_app.loop.status_line import LiveDisplay
from viewer_app.method_options import check_paper_options
from viewer_app.network_sensors import names_remote, sensors_by_network, teller
from viewer_app.options.sensing import LiveOptions
from viewer_app.output_files import check_outputs, warn_of_little_room, whole_file
from viewer_app.outputs.opening import announce_outputs, plan_outputs
from viewer_app.report.figures import report_to_json
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.viewer_sink import Viewing
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.viewer_choice import announce, viewing_of

_PERSON_AT = np.array([0.0, 0.0, 2.5])  # the initial view target, metres in K_A's frame


def run(options: LiveOptions) -> None:
    """Runs the command.

    Raises:
        DeviceError, FusionError, RecordingError, UsageError: With a one-line message for the user.
    """
    console = Console()
    check(options)
    if names_remote(options):
        with sensors_by_network(options, console, lambda serial: _one_kinect(options, serial)) as remote:
            show(options, remote, console)
        return
    sensors = two_kinects(options, console)
    show(options, sensors, console)


def check(options: LiveOptions) -> None:
    """Checks the options before any sensor is opened.

    Raises:
        DeviceError, UsageError: With one line for the person who asked.
    """
    _viewing(options)
    plan_outputs(options, options.listen, names_remote(options))
    check_modes(_settings(options, "", None))
    check_smoothing(options.smoothing)
    read = () if options.calibrate == "auto" else (Path(options.calibrate),)
    check_outputs((options.save, options.report, options.save_calibration), read, options.force)
    if options.seconds is not None and not 0.0 < options.seconds < float("inf"):
        raise UsageError(f"--seconds must be a positive number; got {options.seconds}.")
    if options.calibrate != "auto" and not Path(options.calibrate).exists():
        raise UsageError(
            f"--calibrate {options.calibrate}: neither auto nor an existing file. Make one with "
            f"--save-calibration."
        )


def two_kinects(options: LiveOptions, console: Console) -> TwoSensors:
    """Chooses the two sensors from the options, the sync cable and the user's answers; opens neither.

    Raises:
        DeviceError: Fewer than two usable Kinects, no SDK, or a wrongly connected sync cable.
    """
    connected = connected_kinects()
    serials = _choose(connected, options, console)
    kinect_a, kinect_b = (next(k for k in connected if k.serial == serial) for serial in serials)
    master = sync_master(kinect_a, kinect_b, options.sync_master)
    for note in cable_notes(kinect_a, kinect_b, master):
        console.print(note, style="yellow", highlight=False, markup=False)
    if master is not None:
        leads, follows = ("A", "B") if master == serials[0] else ("B", "A")
        console.print(
            f"Sync cable: {leads} leads, {follows} captures {LASER_GAP_US} µs later and is started first, to "
            f"be there at the first pulse."
        )
    tracker = TrackerSettings(
        processing=options.processing, smoothing=options.tracker_smoothing, library=options.k4abt
    )
    if options.processing == "cpu":
        console.print(
            "A CPU tracks only about one frame per second of both sensors. To fuse every frame, "
            "record with k4arecorder, then run duplex fuse a.mkv b.mkv.",
            style="yellow",
            highlight=False,
        )
    if options.processing == "tensorrt":
        console.print("TensorRT builds its engine; minutes the first time.")
    decimation = FrameDecimation(options.fps)
    a, b = (
        KinectSensor(serial, _settings(options, serial, master), tracker, decimation=decimation)
        for serial in serials
    )
    interval_ns = round(1e9 / options.fps)
    delay_ns = {None: None, serials[0]: 1000 * LASER_GAP_US}.get(master, -1000 * LASER_GAP_US)
    pairing = LivePairing(
        interval_ns,
        sync_delay_ns=delay_ns,
    )
    first: Side = "a" if master == serials[1] else "b"
    return TwoSensors(
        *(a, b),
        pairing=pairing,
        decimation=decimation,
        first=first,
        open_s=_opens_within(options),
        tell=teller(console),
    )


def _one_kinect(options: LiveOptions, serial: str | None) -> Sensor:
    """The sensor of this PC, where the other one is on another PC; it runs without a sync cable."""
    tracker = TrackerSettings(
        processing=options.processing, smoothing=options.tracker_smoothing, library=options.k4abt
    )
    chosen = choose_one(connected_kinects(), serial, "--kinect-a or --kinect-b")
    return KinectSensor(chosen, _settings(options, chosen, None), tracker)


def show(options: LiveOptions, sensors: TwoSensors, console: Console) -> None:
    """Fuses two sensors until they end, Ctrl-C is pressed or the time is up; saves and prints the summary."""
    viewing = _viewing(options)
    settings = FuserSettings(options.method, options.h, options.weights, options.smoothing)
    check_paper_options(settings)
    a, b = sensors.a.sensor, sensors.b.sensor
    calibration = _given_calibration(options, a)
    nominal = FusionSetup(calibration or nominal_calibration(a.body), settings)
    warm_up(Fuser(nominal), console)
    watch = _Watch(console)
    plan = plan_outputs(options, options.listen, names_remote(options))
    with CtrlC() as ctrl_c:
        with ExitStack() as opened:
            outputs = opened.enter_context(plan.opened(nominal, options.fps))
            announce_outputs(console, outputs)
            console.print(f"Opening {a.name} (A) and {b.name} (B) …", highlight=False, markup=False)
            with ctrl_c.raising():  # a body tracker may take minutes to load its network
                opened.enter_context(sensors)
            ctrl_c.calls(sensors.stop)
            cameras = _camera(options, a), _camera(options, b)
            nominal = FusionSetup(nominal.calibration, settings, *cameras)
            if options.save is not None:
                warn_of_little_room(options.save, console)
            announce(viewing, console)
            blueprint = session_blueprint(
                nominal, _PERSON_AT, options.layout, live=True, color=options.color != "off"
            )
            session = opened.enter_context(
                LiveSession(
                    *(nominal, (a.name, b.name), blueprint),
                    file=options.save,
                    overwrite=options.force,
                    viewing=viewing,
                    others=outputs,
                )
            )
            coach = Coach(a.body, nominal.intrinsics, options.fps, warm_up=WARM_UP)
            display = opened.enter_context(
                LiveDisplay(console, session, coach, options.quiet, options.verbose)
            )
            console.print("Running. Press Ctrl-C to end.")
            with _Timer(options.seconds, sensors):
                setup, frames = run_live(
                    sensors,
                    nominal,
                    session,
                    calibrated=calibration is not None,
                    depth=options.depth,
                    # the sensors report events at once, even while no frame arrives
                    go_on=lambda status: watch(status) and display(replace(status, events=())),
                )
        for warning in (*a.warnings, *b.warnings):
            console.print(warning, style="yellow", highlight=False, markup=False)
        print_session(console, setup, frames, sensors, outputs)
        if options.report is not None:
            with whole_file(options.report) as partial:
                figures = session_report(setup, frames, sensors, outputs)
                partial.write_text(report_to_json(figures), encoding="utf-8")
        print_saved(console, session.file)
        if options.save_calibration is not None:
            _save_calibration(options.save_calibration, watch.settled)
        check_saved(session.file)


def _viewing(options: LiveOptions) -> Viewing | None:
    return viewing_of(options, options.save, live=True, served=options.listens)


class _Watch:
    """Prints the calibration on the terminal when it is found, and keeps it."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self.settled: Calibration | None = None

    def __call__(self, status: Status) -> bool:
        if self.settled is None and status.calibrator.settled:
            self.settled = status.calibrator.calibration
            self._console.print(f"[bold]Calibrated[/]: {escape(self.settled.how)}.", highlight=False)
        return True


class _Timer:
    """Stops the sensors when the time is up, even while no frame arrives."""

    def __init__(self, seconds: float | None, sensors: TwoSensors) -> None:
        self._timer = None if seconds is None else threading.Timer(seconds, sensors.stop)

    def __enter__(self) -> None:
        if self._timer is not None:
            self._timer.daemon = True
            self._timer.start()

    def __exit__(self, *exc_info: object) -> None:
        if self._timer is not None:
            self._timer.cancel()


def _choose(connected: Sequence[ConnectedKinect], options: LiveOptions, console: Console) -> tuple[str, str]:
    try:
        return choose_two(connected, options.kinect_a, options.kinect_b, options.principal)
    except NeedsChoiceError as choice:
        if not sys.stdin.isatty():
            raise
        principal = _ask(choice, console)
        console.print(f"Next time: --principal {principal}", highlight=False)
        return choose_two(connected, principal=principal)


def _ask(choice: NeedsChoiceError, console: Console) -> str:
    one, two = choice.serials
    console.print(f"Two Kinects are connected: [bold]1[/] {one}, [bold]2[/] {two}.", highlight=False)
    console.print("Their serial numbers are on the labels beneath. S* will be in the principal one's frame.")
    while True:
        try:
            answer = console.input("Which one is the principal sensor A? [1/2] ").strip()
        except EOFError:
            raise choice from None
        if answer in ("1", one):
            return one
        if answer in ("2", two):
            return two


def _settings(options: LiveOptions, serial: str, master: str | None) -> KinectSettings:
    return KinectSettings(
        depth_mode=options.depth_mode,
        fps=options.fps,
        color=None if options.color == "off" else options.color,
        sync="standalone" if master is None else "master" if serial == master else "subordinate",
        trust_jacks=options.sync_master is None,
        start_s=_opens_within(options),
    )


def _opens_within(options: LiveOptions) -> float:
    """The time limit for opening a sensor and its body tracker, seconds."""
    return 900.0 if options.processing == "tensorrt" else 120.0


def _camera(options: LiveOptions, sensor: Sensor) -> Intrinsics:
    return thinned_camera(sensor.intrinsics or NOMINAL_INTRINSICS[sensor.body.name], options.depth)


def _given_calibration(options: LiveOptions, sensor: Sensor) -> Calibration | None:
    if options.calibrate == "auto":
        return None
    return read_calibration(Path(options.calibrate), sensor.body)


def _save_calibration(path: Path, calibration: Calibration | None) -> None:
    if calibration is None:
        raise UsageError(
            f"{path} was not written: no calibration was found. Stand where both sensors see all of you, "
            f"turned half-way between them, arms and legs apart, and hold still for a second."
        )
    with whole_file(path) as partial:
        partial.write_text(calibration_to_json(calibration), encoding="utf-8")
