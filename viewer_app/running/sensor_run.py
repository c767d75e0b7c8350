"""The order in which the commands that run two sensors open, close and print."""

from contextlib import ExitStack
from typing import Any

from rich.console import Console

from devices.capture.sensor_pair import TwoSensors
from viewer_app.running.interruption import CtrlC
from viewer_app.sensors.raw_files import RawFiles


class SensorRun:
    """Two sensors from opening to the end of a command. Ctrl-C ends them, but not what saves their data.

    Attributes:
        sensors, raw: The sensors, and the recordings of their images; set by :meth:`run`.
    """

    sensors: TwoSensors
    raw: RawFiles

    def __init__(self, options: Any, console: Console) -> None:
        self.options, self.console, self.ctrl_c = options, console, CtrlC()

    def run(self, sensors: TwoSensors, raw: RawFiles) -> None:
        """Runs with sensors that are not open yet; raises a UsageError if something is not saved."""
        self.sensors, self.raw = sensors, raw
        with self.ctrl_c:
            with ExitStack() as stack:
                stack.enter_context(raw).attach(sensors)
                self.work(stack)
            for warning in (*sensors.a.sensor.warnings, *sensors.b.sensor.warnings):
                self.console.print(warning, style="yellow", markup=False)
            self.tell()
            raw.print_end()
            self.end()
            raw.check_whole()

    def open_sensors(self, stack: ExitStack, announced: bool = True) -> None:
        """Opens the sensors, which the stack closes; from then on Ctrl-C stops them."""
        a, b = self.sensors.a.sensor, self.sensors.b.sensor
        if announced:
            self.console.print(f"Opening {a.name} (A) and {b.name} (B) …", markup=False)
        with self.ctrl_c.raising():  # a body tracker may take minutes to load its network
            stack.enter_context(self.sensors)
        self.ctrl_c.calls(self.sensors.stop)

    def work(self, stack: ExitStack) -> None:
        """Opens sensors and more, which the stack closes, and returns when the sensors have ended."""
        raise NotImplementedError

    def tell(self) -> None:
        """Prints the results, when all is closed."""

    def end(self) -> None:
        """Prints what comes after the results; raises a UsageError if a file is not saved."""
