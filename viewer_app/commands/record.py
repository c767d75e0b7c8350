"""``duplex record``: records the images of two connected sensors, to be tracked and fused later."""

from contextlib import ExitStack

from rich.console import Console

from devices.azure.settings import check_modes
from viewer_app.errors import UsageError
from viewer_app.options.sensing import RecordOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.running.interruption import call_after
from viewer_app.running.sensor_run import SensorRun
from viewer_app.sensors.local import capture_settings, two_connected_sensors
from viewer_app.sensors.raw_files import RawFiles
from viewer_app.sensors.remote import names_remote


def run(options: RecordOptions) -> None:
    """Runs the command."""
    console = output_console()
    check_modes(capture_settings(options))
    check_seconds(options.seconds)
    if names_remote(options):
        raise UsageError("duplex record records sensors on this PC: run it on the sensor's own PC.")
    record(
        options,
        console,
        RawFiles(options.folder, console, force=options.force, compress=options.compress),
    )


def record(options: RecordOptions, console: Console, files: RawFiles) -> None:
    """Records until a sensor's end, the time's, a failure or Ctrl-C."""
    _Recording(options, console).run(two_connected_sensors(options, console), files)


class _Recording(SensorRun):
    options: RecordOptions

    def work(self, stack: ExitStack) -> None:
        """Waits until the sensors end; their images are recorded as they come."""
        self.open_sensors(stack)
        options, sensors = self.options, self.sensors
        if not options.quiet:
            self.console.print(f"Recording to {options.folder}. Press Ctrl-C to end.", markup=False)
        with call_after(options.seconds, sensors.stop), self.console.status("") as line:
            for number, _ in enumerate(sensors.pairs()):
                if self.raw.failure is not None:
                    break
                if number % options.fps == 0 and not options.quiet:
                    megabytes = "/".join(f"{file.written_bytes / 1e6:.0f}" for file in self.raw.recorders)
                    line.update(f"frames {sensors.a.received}/{sensors.b.received} · {megabytes} MB")

    def tell(self) -> None:
        for thread, recorder in zip((self.sensors.a, self.sensors.b), self.raw.recorders, strict=True):
            if missing := thread.dropped + thread.lost:
                self.console.print(f"{recorder.path.name}: {missing} frames never came.", style="yellow")
