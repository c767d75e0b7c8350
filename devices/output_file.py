"""Output files: whole or absent, with one writer each.

A file is written under a hidden name beside its own, and gets its own when it is safe on the disk. The hidden
file is locked while its process lives; what a killed one left is removed by the next writer in the folder.
"""

import errno
import os
import re
import shutil
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from itertools import chain, count
from pathlib import Path
from zlib import crc32

if sys.platform != "win32":
    import fcntl

_HIDDEN = re.compile(r"\.[0-9a-f]{8}(\.\d+\.\d+)?\.partial(\.\w+)?")
_SAFE_S = 1.0  # how much of a growing file is on the disk before it replaces an older one
_TRIES = 5  # a lock may be held for a moment by a process that looks for remains
_numbers = count()
_held: set[Path] = set()


class TakenError(FileExistsError):
    """Another program has made a file of that name; `kept` is where this one's is."""

    def __init__(self, path: Path, kept: Path) -> None:
        super().__init__(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        self.kept = kept


class Hidden:
    """A locked file or folder beside `target`, with the target's suffix in lower case.

    ezc3d appends the suffix to any other name.

    Raises:
        BlockingIOError: It is `shared`, and another process has it.
        OSError: It cannot be made.
    """

    def __init__(self, target: Path, *, folder: bool = False, shared: bool = False) -> None:
        _remove_remains(target.parent)
        start = f".{crc32(os.fsencode(target.name)):08x}"
        for tries in range(_TRIES + 1):
            unique = "" if shared else f".{os.getpid()}.{next(_numbers)}"
            suffix = "" if shared or folder else target.suffix.lower()
            self.path = target.with_name(f"{start}{unique}.partial{suffix}")
            if folder:
                self.path.mkdir(mode=0o700)
            else:
                os.close(os.open(self.path, os.O_CREAT | os.O_RDWR | (0 if shared else os.O_EXCL), 0o666))
            lock = _lock(self.path)
            if lock is not None:
                self._lock: int | None = lock
                _held.add(self.path)
                return
            time.sleep(0.02 * tries)
        raise BlockingIOError(errno.EWOULDBLOCK, "another process is writing it", str(target))

    def place(self, target: Path, overwrite: bool) -> None:
        """Gives the file its name once it is on the disk.

        Raises:
            FileExistsError: The target exists, and `overwrite` is not set.
            OSError: It could not be written or renamed.
        """
        if target.exists() and not target.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file", str(target))
        _sync(self.path, os.O_RDWR)
        if sys.platform == "win32":  # which renames no open file
            self._release()
        if overwrite:
            self.path.replace(target)
        elif sys.platform == "win32":
            self.path.rename(target)
        else:
            try:
                os.link(self.path, target)
                self.path.unlink()
            except FileExistsError:
                raise
            except OSError:  # a file system without hard links
                if os.path.lexists(target):
                    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from None
                self.path.rename(target)
        with suppress(OSError):
            _sync(target.parent, os.O_RDONLY)

    def remove(self) -> None:
        """Removes what has not got its name. Removing twice has no effect."""
        if self.path in _held:
            _held.discard(self.path)
            if self.path.is_dir():
                shutil.rmtree(self.path, ignore_errors=True)
            if sys.platform == "win32":
                self._release()
            with suppress(OSError):
                self.path.unlink(missing_ok=True)
            self._release()

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None and lock >= 0:
            os.close(lock)


@contextmanager
def whole_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yields a hidden path beside `path`; gives the file its name on success, and removes it on failure.

    Raises:
        TakenError: The file exists, and `overwrite` is not set. What was written has another name.
        OSError: It could not be written.
    """
    path = Path(os.path.realpath(path))  # not a link to it
    if path in _held:  # the block of another whole_file
        yield path
        return
    hidden = Hidden(path)
    try:
        yield hidden.path
        try:
            hidden.place(path, overwrite)
        except FileExistsError:
            kept = free_name(path)
            hidden.place(kept, overwrite=False)
            raise TakenError(path, kept) from None
    finally:
        hidden.remove()


class GrowingOutput:
    """A file that is written block by block, and can be read meanwhile under its name.

    It gets its name with the first block, or where it replaces an older file, after a second.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self.path, self._overwrite = Path(os.path.realpath(path)), overwrite
        self._hidden = Hidden(self.path)
        self._file = FileIO(self._hidden.path, "r+")
        self.size, self.placed = 0, False
        self._ending = b""
        self._since = time.monotonic()

    def append(self, block: bytes | memoryview, ending: bytes = b"") -> None:
        """Writes a block completely; or raises an OSError, and the file is as after the block before.

        Args:
            ending: What makes the file whole; the next block replaces it.
        """
        if self.placed and not self._is_there():
            raise FileNotFoundError("it was moved or deleted")
        try:
            self._write_all(block, ending)
        except OSError:
            with suppress(OSError):
                self._file.seek(self.size)
                self._write_all(self._ending)
            raise
        self.size, self._ending = self.size + len(block), ending
        self._file.seek(self.size)
        waits = self._overwrite and self.path.exists() and time.monotonic() - self._since < _SAFE_S
        if not self.placed and not waits:
            self._place()

    def _write_all(self, *parts: bytes | memoryview) -> None:
        """Writes from here on; nothing follows."""
        for part in parts:
            rest = memoryview(part)
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        self._file.truncate()

    def patch(self, at: int, block: bytes) -> None:
        """Replaces bytes that are written."""
        self._file.seek(at)
        self._file.write(block)
        self._file.seek(self.size)

    def close(self, *, whole: bool = True) -> None:
        """Ends the file. One that has no name yet gets it if it is `whole`, else it is removed."""
        try:
            if whole and self.size and not self.placed and not self._file.closed:
                self._place()
        finally:
            self._file.close()
            self._hidden.remove()

    def _place(self) -> None:
        self._file.close()
        self._hidden.place(self.path, self._overwrite)
        self._hidden.remove()
        self._file = FileIO(self.path, "r+")
        self._file.seek(self.size)
        self.placed = True

    def _is_there(self) -> bool:
        with suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(self._file.fileno()), self.path.stat())
        return False


def free_name(path: Path) -> Path:
    """The path, or if it exists, the first free one of ``name-2``, ``name-3`` …"""
    names = (path.with_stem(f"{path.stem}-{k}") for k in count(2))
    return next(name for name in chain([path], names) if not os.path.lexists(name))


def _lock(path: Path) -> int | None:
    """A descriptor that holds the lock of a file or folder; None if another process has it or removed it.

    Windows does not remove open files, which is lock enough. Where there are no locks, it is open only.
    """
    if sys.platform == "win32":
        return -1 if path.is_dir() else os.open(path, os.O_RDWR)
    try:
        lock = os.open(path, (os.O_RDONLY if path.is_dir() else os.O_RDWR) | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    try:
        _flock(lock)
    except BlockingIOError:
        os.close(lock)
        return None
    except OSError:
        return lock
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(lock), path.stat(follow_symlinks=False)):
            return lock
    os.close(lock)
    return None


def _flock(lock: int) -> None:
    """Locks what a descriptor is of, or raises an OSError: another process has it, or there are no locks."""
    if sys.platform != "win32":
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _remove_remains(folder: Path) -> None:
    """Removes what this user's killed processes left in a folder."""
    with suppress(OSError):
        for path in folder.iterdir():
            if _HIDDEN.fullmatch(path.name):
                with suppress(OSError):
                    _remove_if_left(path)


def _remove_if_left(path: Path) -> None:
    if sys.platform == "win32":
        path.unlink()
        return
    about = path.stat(follow_symlinks=False)
    remove: Callable[[Path], object] = shutil.rmtree if stat.S_ISDIR(about.st_mode) else os.unlink
    if about.st_uid != os.getuid() or not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        return
    lock = os.open(path, (os.O_RDONLY if stat.S_ISDIR(about.st_mode) else os.O_RDWR) | os.O_NOFOLLOW)
    try:
        _flock(lock)  # raises where there is a writer, or no lock
        if os.path.samestat(os.fstat(lock), path.stat(follow_symlinks=False)):
            remove(path)
    finally:
        os.close(lock)


def _sync(path: Path, how: int) -> None:
    """Waits until a file or folder is on the disk."""
    opened = os.open(path, how)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
