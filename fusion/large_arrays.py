"""Arrays that may be larger than the memory, and the parts in which long recordings are worked on."""

import mmap
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from typing import IO, Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from fusion.errors import FusionError

Item = TypeVar("Item")
PART = 4096
"""Frames: two minutes."""
_LARGE = 8_000_000  # bytes
_MAPPED: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


class GrowingArray:
    """An array to which rows are appended. A large one lies in a temporary file.

    The file has no name: it vanishes with the array, also when the program is killed.
    """

    def __init__(self) -> None:
        self._parts: list[NDArray[Any]] = []
        self._size = 0
        self._file: IO[bytes] | None = None

    def append(self, rows: NDArray[Any]) -> None:
        """Appends rows, of one type and shape.

        Raises:
            FusionError: There is no room for the file.
        """
        self._parts.append(rows)
        self._size += rows.nbytes
        if self._size < _LARGE:
            return
        try:
            self._file = self._file or tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
            for part in self._parts:
                rest = memoryview(part.tobytes())
                while rest:
                    rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise FusionError(
                f"A recording this long needs temporary files in the folder {tempfile.gettempdir()}: "
                f"{error.strerror or error}. The variable TMPDIR names another folder."
            ) from None
        self._parts = [rows[:0]]

    def whole(self) -> NDArray[Any]:
        """All rows; at least one was appended. A large array cannot be written."""
        if self._file is None:
            return np.concatenate(self._parts)
        with self._file as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        _MAPPED.add(mapped)
        kind = self._parts[0]
        return np.frombuffer(mapped, kind.dtype).reshape(-1, *kind.shape[1:])


class Rows(Sequence[Item]):
    """A sequence whose items are made when they are asked for; a slice of it is a list."""

    def row(self, k: int) -> Item:
        """Item k."""
        raise NotImplementedError

    @overload
    def __getitem__(self, k: int) -> Item: ...
    @overload
    def __getitem__(self, k: slice) -> list[Item]: ...
    def __getitem__(self, k: int | slice) -> Item | list[Item]:
        numbers = range(len(self))
        return [self.row(number) for number in numbers[k]] if isinstance(k, slice) else self.row(numbers[k])


def parts(count: int, size: int = PART) -> Iterator[slice]:
    """The slices of `size` frames; memory that large arrays took meanwhile is given back after each."""
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))
        give_back()


def give_back(*mapped: mmap.mmap) -> None:
    """Gives back the memory of large arrays, or of mapped files, which are read again when needed."""
    for each in mapped or list(_MAPPED):
        if hasattr(each, "madvise"):  # not on Windows
            each.madvise(mmap.MADV_DONTNEED)
