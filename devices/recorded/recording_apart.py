"""Recordings whose makers' libraries crash at damaged files, or never end: another process reads them."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

from devices.input_file import check_recording
from devices.orbbec.playback import OrbbecRecording
from devices.realsense.sensors import RealSenseRecording
from devices.recorded.apart import ApartError, items_of
from devices.sensor import DeviceError, ImageRecording, SensorFrame
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

Library = type[OrbbecRecording] | type[RealSenseRecording]
_SECONDS, _BYTES_PER_S, _MEMORY = 20.0, 20e6, 8 << 30


class RecordingApart(ImageRecording):
    """A recording that another process plays.

    Attributes:
        library: Plays it in that process.
    """

    def __init__(self, path: Path, library: Library) -> None:
        self.path, self.name, self.body, self.library = path, path.name, BLAZEPOSE, library
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self._playing: Generator[Any, None, None] | None = None

    def __enter__(self) -> RecordingApart:
        self.__exit__()
        check_recording(self.path)
        self._playing = self._played()
        self.intrinsics, self.duration_ns, self.interval_ns, self.warnings = next(self._playing)
        return self

    def __exit__(self, *exc_info: object) -> None:
        playing, self._playing = self._playing, None
        if playing is not None:
            playing.close()

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order, once for each opening."""
        if self._playing is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        for item in self._playing:
            if isinstance(item, SensorFrame):
                yield item
            else:
                self.warnings = item

    def _played(self) -> Generator[Any, None, None]:
        seconds = _SECONDS + self.path.stat().st_size / _BYTES_PER_S
        items = items_of(played, self.library, self.path, self.name, seconds=seconds, memory=_MEMORY)
        try:
            yield from items
        except ApartError as fault:
            raise DeviceError(f"{self.name} cannot be read by its maker's library: {fault}.") from None


def played(library: Library, path: Path, name: str) -> Iterator[Any]:
    """What a recording knows of itself, its frames, and its warnings."""
    recording = library(path)
    recording.name = name
    with recording:
        yield recording.intrinsics, recording.duration_ns, recording.interval_ns, recording.warnings
        yield from recording.frames()
        yield recording.warnings
