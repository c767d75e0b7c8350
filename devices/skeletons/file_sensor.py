"""Plays recorded skeletons as a sensor: ``.csv``, offline_processor ``.json``, NTU RGB+D ``.skeleton``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from devices.input_file import reading
from devices.people.recorded_people import RecordedPeople
from devices.sensor import IMAGE_SUFFIXES, DeviceError, MissingRecordingError, Sensor, SensorFrame
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.support.progress import Progress, quietly

if TYPE_CHECKING:
    from devices.skeletons.border import Look, ReadFile
    from devices.skeletons.meaning import Meaning

READERS = MappingProxyType({".csv": "csv_files.reader", ".json": "formats", ".skeleton": "formats"})
"""The module for each file extension, with ``read_…``; imported when such a file is opened."""


class SkeletonRecording(Sensor):
    """A file of recorded skeletons; it is read completely when it is opened."""

    def __init__(self, path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> None:
        self.name = str(path)
        self.intrinsics: Intrinsics | None = None
        self.warnings: Sequence[str] = ()
        self._path = path
        self._stated, self._progress = stated, progress
        self._read: ReadFile | None = None
        self._look: Look | None = None
        self._meaning: Meaning | None = None
        self.partner: SkeletonRecording | None = None
        """The other file of the capture, with which its meaning is found."""
        self._body: Body | None = None

    @property
    def content(self) -> ReadFile:
        """The content of the file; known while it is open."""
        if self._read is None:
            raise DeviceError(f"{self.name} is not open.")
        return self._read

    @property
    def people(self) -> RecordedPeople:
        """The people in it; known while it is open."""
        return self.content.people

    @property
    def body(self) -> Body:  # type: ignore[override]
        """The body to which the joints of the file belong; known after opening."""
        if self._body is None:
            raise DeviceError(f"{self.name} is not open.")
        return self._body

    def __enter__(self) -> SkeletonRecording:
        from devices.skeletons.border import checked
        from devices.skeletons.meaning import decide

        look = self.looked()
        if self._meaning is None:
            files = [self] if self.partner is None else [self, self.partner]
            for file, meaning in zip(files, decide([file.looked().evidence for file in files]), strict=True):
                file._meaning = meaning
        assert self._meaning is not None
        with reading(self.name, DeviceError, MissingRecordingError):
            read = checked(look, self._meaning)
        self._read, self._body, self.warnings = read, read.body, list(read.warnings)
        self._look = None
        return self

    def looked(self) -> Look:
        """The file as it was found, and what it tells of its meaning.

        Raises:
            DeviceError: It cannot be read.
        """
        from devices.skeletons.border import look

        if self._look is None:
            suffix = self._path.suffix.lower()
            if suffix not in READERS:
                if self._path.is_dir():
                    raise DeviceError(f"{self.name} is a folder, not a recording.")
                raise DeviceError(
                    f"{self.name}: {self._path.suffix or 'no ending'} is not a format of recorded skeletons. "
                    f"Known: {', '.join(READERS)}; with images: {', '.join(IMAGE_SUFFIXES)}."
                )
            if suffix != ".csv":
                self._stated.refuse_for(self._path)
            reader = getattr(import_module(f"devices.skeletons.{READERS[suffix]}"), f"read_{suffix[1:]}")
            with reading(self.name, DeviceError, MissingRecordingError):
                found = reader(self._path, self._stated, self._progress)
                self._look = look(self._path, found, self._stated)
        return self._look

    def __exit__(self, *exc_info: object) -> None:
        self._read = None

    def frames(self) -> Iterator[SensorFrame]:
        return iter(self._read.people if self._read else ())
