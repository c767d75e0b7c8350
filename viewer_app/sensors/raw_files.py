"""Raw recordings of two sensors: written beside what else a command does, and played as live sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from devices.blazepose.tracked_images import TrackedImages
from devices.capture.sensor_pair import TwoSensors
from devices.capture.settings import CaptureSettings
from devices.capture.stream_pairing import LivePairing
from devices.live.sensors import decimation_of
from devices.network.remote_sensor import RemoteSensor
from devices.pairing import ONE_RUN_NS
from devices.recorded.files import distinct_names, images_of, not_of_libk4a, open_images, open_source
from devices.recorded.two_recordings import cable_delay_ns, refuse_same
from devices.sensor import CableSync, Sensor
from devices.simulated.real_time import Beat, PacedSensor
from devices.upright import upright
from viewer_app.errors import UsageError
from viewer_app.options.sensing import DemoOptions, LiveOptions
from viewer_app.output_files import check_outputs, warn_of_little_room
from viewer_app.sensors.remote import teller
from viewer_app.sensors.tracker import announce_tracker, tracker_of
from viewer_app.sinks.raw_recording import RawRecorder, camera_of, record_images

_NAMES = ("a.mkv", "b.mkv")
_BYTES_PER_MINUTE = 5_300_000_000  # of two sensors, uncompressed


class RawFiles(ExitStack):
    """The recordings a.mkv and b.mkv of a folder. Enter it before the sensors, so that it closes after them.

    Args:
        hide: As for :class:`~viewer_app.sinks.raw_recording.RawRecorder`.

    Raises:
        UsageError: The folder cannot be made, or has such files and `force` is not set, or one of them is
            played.
    """

    def __init__(
        self,
        folder: Path,
        console: Console,
        *,
        force: bool,
        compress: bool,
        hide: Callable[[str], str] = str,
        played: Iterable[Path] = (),
    ) -> None:
        super().__init__()
        self.folder, self._console, self._hide = folder, console, hide
        self._compress, self._force = compress, force
        self.recorders: list[RawRecorder] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise UsageError(f"The folder {folder} cannot be created: {fault.strerror or fault}.") from None
        check_outputs([folder / name for name in _NAMES], played, force)
        warn_of_little_room(folder / _NAMES[0], console, _BYTES_PER_MINUTE)

    def attach(self, sensors: TwoSensors) -> None:
        """Records both sensors from their opening on; they are not open yet."""
        for name, thread in zip(_NAMES, (sensors.a, sensors.b), strict=True):
            sensor = thread.sensor
            if isinstance(sensor, RemoteSensor):
                raise UsageError(
                    f"{sensor.name} is on another PC, from which no infrared comes: record it there."
                )
            images = camera_of(sensor)
            settings = getattr(images, "settings", None) or CaptureSettings(fps=round(sensors.rate))  # type: ignore[arg-type]
            recorder = RawRecorder(
                *(self.folder / name, images, settings),
                compress=self._compress,
                overwrite=self._force,
                hide=self._hide,
                on_failure=self._tell,
            )
            self.recorders.append(self.enter_context(recorder))
            record_images(sensor, recorder)

    @property
    def failure(self) -> str | None:
        """Why a recording ended early; None where none did."""
        return next((recorder.failure for recorder in self.recorders if recorder.failure), None)

    def print_end(self) -> None:
        """Prints what was recorded, and what is missing."""
        for recorder in self.recorders:
            if recorder.written:
                said = f"{recorder.path}: {recorder.written} frames, {recorder.written_bytes / 1e6:.0f} MB"
                self._console.print(said, markup=False, soft_wrap=True)
            for text in recorder.missing:
                self._console.print(text, style="yellow", markup=False, soft_wrap=True)

    def check_whole(self) -> None:
        """Reports a recording that ended early as a usage error: one line and exit code 2."""
        if self.failure is not None:
            raise UsageError(self.failure)

    def _tell(self, failure: str) -> None:
        self._console.print(f"[bold red]{escape(failure)}[/]", soft_wrap=True)


def raw_files(
    options: LiveOptions | DemoOptions, console: Console, played: Iterable[Path] = ()
) -> RawFiles | None:
    """The recordings that ``--record`` asks for; None without it.

    Raises:
        UsageError: As for :class:`RawFiles`.
    """
    if options.record is not None:
        return RawFiles(
            options.record, console, force=options.force, compress=options.compress, played=played
        )
    return None


def two_played_sensors(options: LiveOptions, paths: Sequence[Path], console: Console) -> TwoSensors:
    """Two recordings of images as live sensors, at the pace at which they were recorded; opens neither.

    Raises:
        DeviceError: One cannot be read, or both are the same.
    """
    refuse_same(*paths)
    tracker = tracker_of(options).for_images_of(not_of_libk4a(*paths))
    announce_tracker(tracker, console)
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
    names = distinct_names(*paths)
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
