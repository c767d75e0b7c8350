"""``duplex record``: records the images of two connected sensors, to be tracked and fused later."""

from contextlib import suppress

from rich.console import Console

from devices.azure.settings import check_modes
from viewer_app.errors import UsageError
from viewer_app.options.sensing import RecordOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.output_files import outputs_of_one_run
from viewer_app.running.interruption import CtrlC, call_after
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
    existed = options.folder.exists()
    try:
        with outputs_of_one_run():  # what is held in the folder is gone before the folder
            files = RawFiles(options.folder, console, force=options.force, compress=options.compress)
            record(options, console, files)
    finally:
        if not existed:
            with suppress(OSError):  # it holds a recording
                options.folder.rmdir()


def record(options: RecordOptions, console: Console, files: RawFiles) -> None:
    """Records until a sensor's end, the time's, a failure or Ctrl-C."""
    sensors = two_connected_sensors(options, console)
    with CtrlC() as ctrl_c, files:
        files.attach(sensors)
        console.print(f"Opening {sensors.a.sensor.name} (A) and {sensors.b.sensor.name} (B) …", markup=False)
        with ctrl_c.raising():  # a subordinate waits for its master
            files.enter_context(sensors)
        ctrl_c.calls(sensors.stop)
        if not options.quiet:
            console.print(f"Recording to {options.folder}. Press Ctrl-C to end.", markup=False)
        with call_after(options.seconds, sensors.stop), console.status("") as line:
            for number, _ in enumerate(sensors.pairs()):
                if files.failure is not None:
                    break
                if number % options.fps == 0 and not options.quiet:
                    megabytes = "/".join(f"{file.written_bytes / 1e6:.0f}" for file in files.recorders)
                    line.update(f"frames {sensors.a.received}/{sensors.b.received} · {megabytes} MB")
    for thread, recorder in zip((sensors.a, sensors.b), files.recorders, strict=True):
        for warning in thread.sensor.warnings:
            console.print(warning, style="yellow", markup=False)
        if missing := thread.dropped + thread.lost:
            console.print(f"{recorder.path.name}: {missing} frames never came.", style="yellow")
    files.print_end()
    files.check_whole()
