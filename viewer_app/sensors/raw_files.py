"""Raw recordings of two sensors, written beside what else a command does."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from devices.capture.sensor_pair import TwoSensors
from devices.capture.settings import CaptureSettings
from viewer_app.errors import UsageError
from viewer_app.output_files import check_outputs, make_folder, warn_of_little_room

if TYPE_CHECKING:
    from viewer_app.sinks.raw_recording import RawRecorder

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
        folder: Path | None,
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
        if folder is None:
            return
        make_folder(folder)
        check_outputs([folder / name for name in _NAMES], played, force)
        warn_of_little_room(folder / _NAMES[0], console, _BYTES_PER_MINUTE)

    def attach(self, sensors: TwoSensors) -> None:
        """Records both sensors from their opening on; they are not open yet."""
        if self.folder is None:
            return
        from viewer_app.sinks.raw_recording import RawRecorder, camera_of, record_images

        for name, thread in zip(_NAMES, (sensors.a, sensors.b), strict=True):
            sensor = thread.sensor
            if sensor.link is not None:
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
