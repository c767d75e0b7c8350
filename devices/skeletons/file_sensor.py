"""Plays recorded skeletons as a sensor: ``.csv``, offline_processor ``.json``, NTU RGB+D ``.skeleton``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType

from devices.people import RecordedPeople
from devices.sensor import DeviceError, Sensor, SensorFrame
from devices.skeletons.conventions import frozen, upside_down
from devices.skeletons.csv_file import read_csv
from devices.skeletons.ntu import read_ntu
from devices.skeletons.offline_processor import read_json
from devices.skeletons.read_file import ReadFile
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.progress import Progress, quietly

Reader = Callable[[Path, StatedFormat, Progress], ReadFile]

READERS: MappingProxyType[str, Reader] = MappingProxyType(
    {".csv": read_csv, ".json": read_json, ".skeleton": read_ntu}
)
"""The reader for each file extension. It raises DeviceError if the file is invalid."""


class SkeletonRecording(Sensor):
    """A file of recorded skeletons; it is read completely when it is opened."""

    def __init__(self, path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly) -> None:
        self.name = str(path)
        self.intrinsics: Intrinsics | None = None
        self.warnings: Sequence[str] = ()
        self._path = path
        self._stated, self._progress = stated, progress
        self._body: Body | None = None
        self._people: RecordedPeople | None = None

    @property
    def people(self) -> RecordedPeople:
        """The content of the file; known while it is open."""
        if self._people is None:
            raise DeviceError(f"{self.name} is not open.")
        return self._people

    @property
    def body(self) -> Body:  # type: ignore[override]
        """The body to which the joints of the file belong; known after opening."""
        if self._body is None:
            raise DeviceError(f"{self.name} is not open.")
        return self._body

    def __enter__(self) -> SkeletonRecording:
        reader = READERS.get(self._path.suffix.lower())
        if reader is None:
            if self._path.is_dir():
                raise DeviceError(f"{self.name} is a folder, not a recording.")
            raise DeviceError(
                f"{self.name}: {self._path.suffix or 'no ending'} is not a format of recorded skeletons. "
                f"Known: {', '.join(READERS)}; with images: .mkv, .bag."
            )
        try:
            read = reader(self._path, self._stated, self._progress)
        except FileNotFoundError:
            raise DeviceError(f"No file {self.name}.") from None
        except OSError as error:
            raise DeviceError(f"{self.name} cannot be read: {error.strerror or error}.") from None
        except MemoryError:
            raise DeviceError(f"{self.name} is too large for the memory of this machine.") from None
        if not read.people:
            raise DeviceError(f"{self.name} has no frames.")
        if read.people.ids and not read.people.skeletons.states.any():
            raise DeviceError(f"{self.name}: no joint has a position in any frame.")
        self._body, self._people = read.body, read.people
        self.warnings = [
            *read.warnings,
            *upside_down(self.name, read.body, read.people),
            *frozen(self.name, read.people),
        ]
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._people = None

    def frames(self) -> Iterator[SensorFrame]:
        return iter(self._people or ())
