"""What a vendor's module consists of: a row, a sensor with the verbs that are its own, and shared words."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any, Self

from devices.capture.capture_stream import CaptureStream, LiveSensor
from devices.capture.causes import Cause, in_brackets
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.check import Check, failed, installed_version, missing_names, words_of
from devices.sensor import AbsentError, DeviceError, SensorFrame


@dataclass(frozen=True)
class Vendor:
    """A row of the table of sensors, and the software that gives their images."""

    sensors: str  # what they are called in messages
    install: str  # how their software is installed, in a few words
    connected: Callable[[], list[ConnectedSensor]]
    """Those that are connected; raises a DeviceError if the software is not installed."""
    sensor: Callable[[str, CaptureSettings, FrameDecimation], LiveSensor]
    """The sensor with a serial number, without people; opens nothing."""
    sdk_check: Callable[[], Check]
    sensor_check: Callable[[ConnectedSensor], Check]


class VendorSensor(LiveSensor):
    """A live sensor: a vendor's class opens it, takes its images, closes it.

    Attributes:
        model: What it is called in messages, before its serial number.
        programs: The vendor's programs, one of which may use it instead.
    """

    model = ""
    programs = ""
    _opened: Any = None

    @abstractmethod
    def open(self) -> Any:
        """Opens the sensor, starts its cameras, and reads :attr:`intrinsics`.

        Returns:
            What :meth:`stream` and :meth:`close` get; not None.

        Raises:
            AbsentError: It is not connected.
            DeviceError: It cannot be opened or started; nothing is left open.
        """

    @abstractmethod
    def stream(self, opened: Any) -> CaptureStream:
        """Gives the moments of the running cameras."""

    @abstractmethod
    def close(self, opened: Any) -> None:
        """Stops and closes the sensor, even if it is no longer connected."""

    @property
    def label(self) -> str:
        """Its name in messages."""
        return f"{self.model} {self.name}"

    def __enter__(self) -> Self:
        self.__exit__()
        self._interrupted.clear()
        self._opened = self.open()
        return self

    def __exit__(self, *exc_info: object) -> None:
        opened, self._opened = self._opened, None
        if opened is not None:
            self.close(opened)

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they arrive, until interrupted."""
        if self._opened is None:
            raise DeviceError(f"{self.label} is not open: use it in a with statement.")
        yield from self._frames(self.stream(self._opened))

    def not_started(
        self, fault: Exception, what: str = "did not start its cameras", advice: str = ""
    ) -> DeviceError:
        """The error for an open sensor that does not start."""
        said = in_brackets(fault)
        return Cause.CAMERAS_NOT_STARTED.error(
            label=self.label, what=what, said=said, advice=advice, programs=self.programs
        )

    def refuse_modes(self, size: str, fps: int) -> None:
        """Checks the settings of a sensor that has one mode, and no port for a sync cable.

        Raises:
            DeviceError: Another mode is asked for.
        """
        settings = self.settings
        if settings.depth_mode != CaptureSettings.depth_mode:
            raise DeviceError(f"{self.label} has one depth mode, {size}. Leave `depth_mode` out.")
        if settings.fps != fps:
            raise DeviceError(f"{self.label} runs at {fps} fps, not {settings.fps}. Leave `fps` out.")
        if settings.sync != "standalone":
            raise DeviceError(f"{self.label} has no port for a sync cable. Leave `sync_master` out.")


def absent(model: str, serial: str, others: Sequence[str], advice: str) -> AbsentError:
    """The error for a sensor that is not in its library's list."""
    listed = f"Connected: {', '.join(sorted(others))}." if others else "No other is connected."
    return AbsentError(f"No {model} with serial {serial}. {listed} {advice}")


def load_module(name: str, package: str, sensors: str, names: Iterable[str], install: str) -> ModuleType:
    """A vendor's Python module.

    Args:
        package: What pip calls it.
        sensors: The subject of "… need": whose sensors they are.
        names: All dotted names that the program uses of it.
        install: How to install it, in sentences.

    Raises:
        DeviceError: It is not installed, or of a version that lacks a name.
    """
    try:
        module = import_module(name)
    except Exception as fault:  # a damaged library raises what it likes
        raise DeviceError(
            f"{sensors} need {package}, which cannot be imported ({words_of(fault)}). {install}"
        ) from fault
    if missing := missing_names(module, names):
        version = installed_version(package) or "another package of this name"
        raise DeviceError(
            f"The installed {name} ({version}) lacks {missing[0]}: it is of another version. {install}"
        )
    return module


def library_check(name: str, found: Callable[[], object]) -> Check:
    """Whether a library is installed; ``found`` loads it and says which it is."""
    try:
        return Check(name, True, str(found()))
    except DeviceError as fault:
        return failed(name, fault)


def listed_check(model: str, sensor: ConnectedSensor, detail: str) -> Check:
    """A sensor that its library lists."""
    if sensor.serial is None:
        return failed(f"{model} at place {sensor.index}", DeviceError(sensor.fault), needed=False)
    return Check(f"{model} {sensor.serial}", not sensor.advice, detail, sensor.advice, needed=False)
