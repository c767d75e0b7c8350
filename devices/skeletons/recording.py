"""Plays recorded skeletons as a sensor: ``.csv``, offline_processor ``.json``, NTU RGB+D ``.skeleton``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType

from devices.sensor import DeviceError, SensorFrame
from devices.skeletons.conventions import upside_down
from devices.skeletons.csv_file import read_csv
from devices.skeletons.ntu import read_ntu
from devices.skeletons.offline_processor import read_json
from fusion.body import Body
from fusion.intrinsics import Intrinsics

Reader = Callable[[Path], tuple[Body, list[SensorFrame]]]

READERS: MappingProxyType[str, Reader] = MappingProxyType(
    {".csv": read_csv, ".json": read_json, ".skeleton": read_ntu}
)
"""The reader for each file extension. It returns body and frames in time order, or raises DeviceError."""


class SkeletonRecording:
    """A file of recorded skeletons; it is read completely when it is opened.

    Args:
        path: The file; its extension determines the format (:data:`READERS`).
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self.intrinsics: Intrinsics | None = None
        self.warnings: Sequence[str] = ()
        self._path = path
        self._body: Body | None = None
        self._frames: Sequence[SensorFrame] = ()

    @property
    def body(self) -> Body:
        """The body to which the joints of the file belong; known after opening."""
        if self._body is None:
            raise DeviceError(f"{self.name} is not open.")
        return self._body

    def __enter__(self) -> SkeletonRecording:
        """Reads the file.

        Raises:
            DeviceError: The file cannot be read, or its content is invalid.
        """
        reader = READERS.get(self._path.suffix.lower())
        if reader is None:
            raise DeviceError(
                f"{self.name}: {self._path.suffix or 'no ending'} is not a format of recorded skeletons. "
                f"Known: {', '.join(READERS)}."
            )
        try:
            self._body, self._frames = reader(self._path)
        except FileNotFoundError:
            raise DeviceError(f"No file {self.name}.") from None
        except UnicodeDecodeError as error:
            raise DeviceError(f"{self.name} is not text: byte {error.start} is not UTF-8.") from None
        except OSError as error:
            raise DeviceError(f"{self.name} cannot be read: {error.strerror or error}.") from None
        if not self._frames:
            raise DeviceError(f"{self.name} has no frames.")
        self.warnings = upside_down(self.name, self._body, self._frames)
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Releases the frames."""
        self._frames = ()

    def frames(self) -> Iterator[SensorFrame]:
        """Returns an iterator over the frames in time order."""
        return iter(self._frames)
