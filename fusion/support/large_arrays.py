"""Arrays that may be larger than the memory, and the parts in which long recordings are worked on."""

import ctypes
import mmap
import os
import sys
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from fusion.errors import FusionError
from fusion.support.read_only import read_only

Item = TypeVar("Item")
PART = 4096
"""Frames: two minutes."""
_LARGE = 2_000_000  # bytes
_COPIED, _ALIGNED = 1_000_000, 64  # bytes
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
        if self._size >= _LARGE:
            with _room_needed():
                self._file = self._file or tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
                for part in self._parts:
                    _write(self._file, part.tobytes())
            self._parts = [rows[:0]]

    @staticmethod
    def wholes(arrays: "Iterable[GrowingArray]") -> list[NDArray[Any]]:
        """All rows of each array, at least one; they cannot be written, and the arrays take no more.

        Large arrays are put into one file, because a file counts as open as long as it is mapped.
        """
        shared: IO[bytes] | None = None
        every = [(array, 0) for array in arrays]
        for k, (array, _) in enumerate(every):
            if array._file is not None:
                if shared is None:
                    shared = array._file
                else:
                    every[k] = array, _move(array._file, shared)
        mapped = None
        if shared is not None:
            with shared:
                mapped = mmap.mmap(shared.fileno(), 0, access=mmap.ACCESS_READ)
            _MAPPED.add(mapped)
        return [array._whole(mapped, begin) for array, begin in every]

    def _whole(self, mapped: mmap.mmap | None, begin: int) -> NDArray[Any]:
        """All rows; those of a file from a byte of the mapped one."""
        if self._file is None or mapped is None:
            return read_only(np.concatenate(self._parts))
        kind = self._parts[0]
        values = np.frombuffer(mapped, kind.dtype, self._size // kind.itemsize, begin)
        return values.reshape(-1, *kind.shape[1:])


def _move(own: IO[bytes], shared: IO[bytes]) -> int:
    """Moves a file to the end of another one; returns the byte at which it begins there."""
    with _room_needed(), own:
        begin = -(-shared.seek(0, os.SEEK_END) // _ALIGNED) * _ALIGNED
        shared.seek(begin)
        own.seek(0)
        while block := own.read(_COPIED):
            _write(shared, block)
    return begin


def _write(file: IO[bytes], data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


@contextmanager
def _room_needed() -> Iterator[None]:
    """Turns the errors of a temporary file into one for the user."""
    try:
        yield
    except OSError as error:
        raise FusionError(
            f"A recording this long needs temporary files in the folder {tempfile.gettempdir()}: "
            f"{error.strerror or error}. The variable TMPDIR names another folder."
        ) from None


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


def stored(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """The arrays, read-only; large ones in a temporary file."""
    growing = [GrowingArray() for _ in arrays]
    for array, rows in zip(growing, arrays, strict=True):
        array.append(rows)
    return GrowingArray.wholes(growing)


def _trim() -> None:
    """Gives back what was freed, which glibc keeps; it takes some milliseconds."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def parts(count: int, size: int = PART) -> Iterator[slice]:
    """The slices of `size` frames; memory that they took is given back."""
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))
        give_back()
        if count > size and (size > PART or first + size >= count):
            _trim()


def give_back(*mapped: mmap.mmap) -> None:
    """Gives back the memory of large arrays, or of mapped files, which are read again when needed."""
    if sys.platform != "win32":
        for each in mapped or list(_MAPPED):
            each.madvise(mmap.MADV_DONTNEED)
