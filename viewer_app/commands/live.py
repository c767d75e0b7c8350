"""``duplex live``: fuses two connected Kinects and shows or saves the session."""

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from devices.azure.settings import check_modes
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.sensor_pair import TwoSensors
from devices.depth.image_thinning import thinned_camera
from devices.network.remote_sensor import PREFIX, RemoteSensor
from devices.recorded.files import has_images
from devices.sensor import Sensor
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.fuser import Fuser
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings.calibration_file import calibration_to_json, read_calibration
from viewer_app.coach.setup_coach import WARM_UP, Coach
from viewer_app.errors import UsageError
from viewer_app.options.sensing import LiveOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, write_text
from viewer_app.running.interruption import CtrlC, call_after
from viewer_app.running.loop import Status, run_live, warm_up
from viewer_app.running.runner import Runner
from viewer_app.sensors.local import capture_settings, one_of_live, two_connected_sensors
from viewer_app.sensors.raw_files import RawFiles, raw_files, two_played_sensors
from viewer_app.sensors.remote import names_remote, sensors_by_network
from viewer_app.viewer.blueprint import session_blueprint

_PERSON_AT = np.array([0.0, 0.0, 2.5])  # the initial view target, metres in K_A's frame


def run(options: LiveOptions) -> None:
    """Runs the command."""
    console = output_console()
    remote = names_remote(options)
    settings = _check(options)
    runner = Runner(options, console, options.save, remote)
    raw = raw_files(options, console, _played(options))
    if remote:
        with sensors_by_network(options, console, partial(one_of_live, options, console)) as sensors:
            _show(options, settings, sensors, runner, raw, console)
        return
    played = _played(options)
    if played:
        _show(options, settings, two_played_sensors(options, played, console), runner, raw, console)
    else:
        _show(options, settings, two_connected_sensors(options, console), runner, raw, console)


def _played(options: LiveOptions) -> list[Path]:
    """The recordings that are played; none where sensors run."""
    return [path for path in (options.a, options.b) if path is not None]


def _check(options: LiveOptions) -> FuserSettings:
    """Checks the other options before any sensor is opened; returns the method's."""
    check_modes(capture_settings(options))
    settings = FuserSettings(options.method, options.h, options.weights, options.smoothing)
    read = _played(options) + ([] if options.calibrate == "auto" else [Path(options.calibrate)])
    written = options.report, options.save_calibration, options.save_mcap
    check_outputs(written, read, options.force, options.save)
    check_seconds(options.seconds)
    sensors = (options.kinect_a, options.kinect_b, options.principal, options.sync_master)
    if _played(options) and (options.b is None or any(sensors)):
        raise UsageError("duplex live plays two recordings: name both, and no sensor.")
    for path in _played(options):
        if not has_images(path):
            raise UsageError(f"{path} has no images: duplex live plays .mkv, .db3 and .bag. Use duplex fuse.")
    for name, turned in zip((options.kinect_a, options.kinect_b), options.orientations, strict=True):
        if turned and (name or "").startswith(PREFIX):
            raise UsageError(f"{name} is on another PC: give --orientation to duplex sensor there.")
    if options.calibrate != "auto" and not Path(options.calibrate).exists():
        raise UsageError(
            f"--calibrate {options.calibrate}: neither auto nor an existing file. Create one with "
            f"--save-calibration."
        )
    return settings


def _show(
    options: LiveOptions,
    settings: FuserSettings,
    sensors: TwoSensors,
    runner: Runner,
    raw: RawFiles | None,
    console: Console,
) -> None:
    """Fuses two sensors until they end, Ctrl-C is pressed or the time is up; saves and prints the summary."""
    a, b = sensors.a.sensor, sensors.b.sensor
    given = None if options.calibrate == "auto" else read_calibration(Path(options.calibrate), a.body)
    nominal = FusionSetup(given or nominal_calibration(a.body), settings)
    warm_up(Fuser(nominal), console)
    watch = _Watch(console)
    with CtrlC() as ctrl_c:
        with ExitStack() as stack:
            if raw is not None:
                stack.enter_context(raw).attach(sensors)
            runner.open_outputs(stack, nominal, sensors.rate)
            console.print(f"Opening {a.name} (A) and {b.name} (B) …", markup=False)
            with ctrl_c.raising():  # a body tracker may take minutes to load its network
                stack.enter_context(sensors)
            ctrl_c.calls(sensors.stop)
            nominal = FusionSetup(nominal.calibration, settings, _camera(options, a), _camera(options, b))
            remote = "".join("AB"[k] for k, each in enumerate((a, b)) if isinstance(each, RemoteSensor))
            coach = Coach(a.body, nominal.intrinsics, sensors.rate, warm_up=WARM_UP, remote=remote)
            images = {"depth": options.depth != "none", "color": options.color != "off"}
            layout = partial(
                session_blueprint,
                person_at=_PERSON_AT,
                active=options.layout,
                live=True,
                depth=images["depth"],
                color=images["color"],
            )
            # of both sensors, on which the program's own tracker works; without depth there are no others
            infrared = images["depth"] and isinstance(a, TrackedImages) and isinstance(b, TrackedImages)
            display = runner.open_session(
                stack, sensors, nominal, coach, layout, infrared, reframes=options.layout == "setup"
            )
            console.print("Running. Press Ctrl-C to end.")
            with call_after(options.seconds, sensors.stop):  # even while no frame arrives
                setup, frames = run_live(
                    sensors,
                    nominal,
                    runner.session,
                    calibrated=given is not None,
                    depth=options.depth,
                    # the sensors report events at once, even while no frame arrives
                    go_on=lambda status: watch(status) and display(replace(status, events=())),
                    follow=options.follow or "middle",
                )
        for warning in (*a.warnings, *b.warnings):
            console.print(warning, style="yellow", markup=False)
        runner.summarise(setup, frames, sensors)
        runner.print_end()
        if raw is not None:
            raw.print_end()
        if options.save_calibration is not None:
            _save_calibration(options.save_calibration, watch.final, options.force)
        runner.check_saved()
        if raw is not None:
            raw.check_whole()


class _Watch:
    """Prints the calibration on the terminal when it is found, and keeps it."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self.final: Calibration | None = None

    def __call__(self, status: Status) -> bool:
        if self.final is None and status.calibrator.final:
            self.final = status.calibrator.calibration
            self._console.print(f"[bold]Calibrated[/]: {escape(self.final.how)}.")
        return True


def _camera(options: LiveOptions, sensor: Sensor) -> Intrinsics:
    return thinned_camera(sensor.intrinsics or NOMINAL_INTRINSICS[sensor.body.name], options.depth)


def _save_calibration(path: Path, calibration: Calibration | None, force: bool) -> None:
    if calibration is None:
        raise UsageError(
            f"{path} was not written: no calibration was found. Stand where both sensors see all of you, "
            f"turned half-way between them, arms and legs apart, and hold still for a second."
        )
    write_text(path, calibration_to_json(calibration), force)
