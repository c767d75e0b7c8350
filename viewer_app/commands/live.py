"""``duplex live``: fuses two connected Kinects and shows or saves the session."""

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from devices.azure.settings import check_modes
from devices.capture.causes import origin_of
from devices.capture.sensor_pair import TwoSensors
from devices.depth import witness as depth_witness
from devices.depth.image_thinning import thinned_camera
from devices.network.remote_sensor import PREFIX
from devices.recorded.files import has_images
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.setup import FuserSettings, FusionSetup
from recordings.calibration_file import calibration_to_json, read_calibration
from viewer_app.coach.setup_coach import WARM_UP, Coach
from viewer_app.errors import UsageError
from viewer_app.options.sensing import LiveOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, write_text
from viewer_app.running.interruption import call_after
from viewer_app.running.loop import Status, run_live
from viewer_app.running.runner import Runner
from viewer_app.running.status import LiveDisplay
from viewer_app.sensors.local import capture_settings, one_of_live, two_connected_sensors, two_played_sensors
from viewer_app.sensors.raw_files import RawFiles
from viewer_app.sensors.remote import names_remote, sensors_by_network


def run(options: LiveOptions) -> None:
    """Runs the command."""
    console = output_console()
    live, played = _Live(options, _check(options), console), _played(options)
    raw = RawFiles(options.record, console, force=options.force, compress=options.compress, played=played)
    if names_remote(options):
        with sensors_by_network(options, console, partial(one_of_live, options, console)) as sensors:
            live.run(sensors, raw)
    elif played:
        live.run(two_played_sensors(options, played, console), raw)
    else:
        live.run(two_connected_sensors(options, console), raw)


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


class _Live(Runner):
    """Fuses two sensors until they end, Ctrl-C is pressed or the time is up; saves and prints the summary."""

    options: LiveOptions
    person_at = np.array([0.0, 0.0, 2.5])  # at the start

    def __init__(self, options: LiveOptions, settings: FuserSettings, console: Console) -> None:
        super().__init__(options, console, options.save, names_remote(options))
        self.active, self._settings = options.layout, settings
        self._found: Calibration | None = None

    def run(self, sensors: TwoSensors, raw: RawFiles) -> None:
        body, given = sensors.a.sensor.body, self.options.calibrate
        start = nominal_calibration(body) if given == "auto" else read_calibration(Path(given), body)
        self.setup = FusionSetup(start, self._settings)
        super().run(sensors, raw)

    def open_session(self, stack: ExitStack, sample: bool = False) -> LiveDisplay:
        """Opens the sensors first, whose cameras it shows."""
        del sample  # people before their sensors look for themselves
        depth_witness.warm_up()  # which the sensors' threads call
        self.open_sensors(stack)
        sensors = self.sensors.a.sensor, self.sensors.b.sensor
        cameras = (
            thinned_camera(each.intrinsics or NOMINAL_INTRINSICS[each.body.name], self.options.depth)
            for each in sensors
        )
        self.setup = setup = FusionSetup(self.setup.calibration, self._settings, *cameras)
        origins = origin_of(sensors[0]), origin_of(sensors[1])
        self.coach = Coach(setup.body, setup.intrinsics, self.sensors.rate, origins)
        if setup.body.name == "azure_kinect" and "sensor" in origins:
            self.warm_up = WARM_UP
        return super().open_session(stack)

    def begin(self, stack: ExitStack) -> None:
        """Counts frames from now on: earlier ones waited for the kernels."""
        del stack
        self.sensors.count_from_now()

    def loop(self, display: LiveDisplay) -> None:
        def go_on(status: Status) -> bool:
            if self._found is None and status.calibrator.final:
                self._found = status.calibrator.calibration
                self.console.print(f"[bold]Calibrated[/]: {escape(self._found.how)}.")
            # the sensors report events at once, even while no frame arrives
            return display(replace(status, events=()))

        self.console.print("Running. Press Ctrl-C to end.")
        with call_after(self.options.seconds, self.sensors.stop):  # even while no frame arrives
            self.setup, self.frames = run_live(
                self.sensors,
                self.setup,
                self.session,
                calibrated=self.options.calibrate != "auto",
                depth=self.options.depth,
                go_on=go_on,
                follow=self.options.follow or "middle",
            )

    def end(self) -> None:
        path = self.options.save_calibration
        if path is not None:
            if self._found is None:
                raise UsageError(
                    f"{path} was not written: no calibration was found. Stand where both sensors see all of "
                    f"you, turned half-way between them, arms and legs apart, and hold still for a second."
                )
            write_text(path, calibration_to_json(self._found), self.options.force)
        super().end()
