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

from fusion.errors import DuplexError

if sys.platform != "win32":
    import fcntl

_HIDDEN = re.compile(r"\.[0-9a-f]{8}(\.\d+\.\d+)?\.partial(\.\w+)?")
_SAFE_S = 1.0  # how much of a growing file is on the disk before it replaces an older one
_TRIES = 5  # a lock may be held for a moment by a process that looks for remains
_numbers = count()
_held: set[Path] = set()


class OutputError(DuplexError, OSError):
    """A file could not be written; made with the attributes of an OSError."""

    def __str__(self) -> str:
        return f"{self.filename} could not be written: {self.strerror}."


class KeptError(OutputError):
    """A file could not get its name; `kept` is where it is instead, which the message says."""

    def __init__(self, fault: OSError, path: Path, kept: Path) -> None:
        why = "another program made it meanwhile" if fault.errno == errno.EEXIST else fault.strerror
        super().__init__(fault.errno, f"{why}; what was written is {kept}", str(path))
        self.kept = kept


class Hidden:
    """A locked file or folder beside `target`, with the target's suffix in lower case.

    ezc3d appends the suffix to any other name. A link of that name is not followed.

    Attributes:
        descriptor: Of the open file or folder, which holds its lock; -1 once it is closed.

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
                self.path.mkdir()
                self.path.chmod(0o700)
            descriptor = _locked(self.path, 0 if folder else os.O_CREAT | (0 if shared else os.O_EXCL))
            if descriptor is not None:
                self.descriptor = descriptor
                with suppress(OSError):  # libraries open it again, whatever the umask
                    self.path.chmod(self.path.stat().st_mode | 0o600)
                _held.add(self.path)
                return
            time.sleep(0.02 * tries)
        raise BlockingIOError(errno.EWOULDBLOCK, "another process is writing it", str(target))

    def place(self, target: Path, overwrite: bool) -> None:
        """Gives the file its name.

        Raises:
            FileExistsError: The target exists, and `overwrite` is not set.
            OSError: It could not be renamed.
        """
        if target.exists() and not target.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file", str(target))
        if sys.platform == "win32":  # which renames no open file
            self._release()
        if overwrite:
            self.path.replace(target)
        elif sys.platform == "win32":
            self.path.rename(target)
        else:
            try:
                os.link(self.path, target)
                with suppress(OSError):
                    self.path.unlink()
            except FileExistsError:
                raise
            except OSError:  # a file system without hard links
                if os.path.lexists(target):
                    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from None
                self.path.rename(target)
        with suppress(OSError):
            folder = os.open(target.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def keep(self, target: Path, fault: OSError) -> KeptError:
        """Gives a file that could not get its name a free one, or leaves it there; returns the error."""
        kept = free_name(target)
        try:
            self.place(kept, overwrite=False)
        except OSError:
            kept = self.path
            _held.discard(kept)
            with suppress(OSError):  # what is read-only is no remains
                kept.chmod(0o400)
        return KeptError(fault, target, kept)

    def remove(self) -> None:
        """Removes the file unless it was placed or kept. A second call has no effect."""
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
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


@contextmanager
def whole_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yields a hidden path beside `path`; gives the file its name on success, and removes it on failure.

    Raises:
        KeptError: It could not get its name, as where the file exists and `overwrite` is not set.
        OutputError: It could not be written.
    """
    try:
        real = real_path(path)
        if real in _held:  # the block of another whole_file
            yield real
            return
        if real.exists() and not real.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file")
        hidden = Hidden(real)
        try:
            yield hidden.path
            os.fsync(hidden.descriptor)
            try:
                hidden.place(real, overwrite)
            except OSError as fault:
                raise hidden.keep(path, fault) from None
        finally:
            hidden.remove()
    except OSError as fault:
        own: Exception = fault
        if isinstance(own, DuplexError) and type(own) is not OutputError:  # as of a file that is read
            raise
        why = (fault.strerror or str(fault)).removesuffix(".")
        raise OutputError(fault.errno, why, str(path)) from fault


class GrowingOutput:
    """A file that is written block by block, and can be read meanwhile under its name.

    It is made with the first block, and gets its name then; where it replaces an older file, after a second.
    Where it cannot get it, each block tries again. One that another program has made keeps its name.

    Args:
        again: Called where a block could not be written, with the reason; whether to try again.
    """

    def __init__(
        self, path: Path, *, overwrite: bool = False, again: Callable[[OSError], bool] = lambda _: False
    ) -> None:
        self.path, self._overwrite, self._again = real_path(path), overwrite, again
        self._hidden: Hidden | None = None
        self._file: FileIO | None = None
        self.size, self._since, self._ending = 0, 0.0, b""
        self._placed = False
        self._kept: KeptError | None = None

    def append(self, block: bytes | memoryview, ending: bytes = b"") -> None:
        """Writes a block completely; or raises an OSError, and the file is as after the block before.

        Args:
            ending: What makes the file whole; the next block replaces it.
        """
        while True:
            try:
                return self._append(block, ending)
            except OSError as fault:
                if isinstance(fault, FileNotFoundError) or not self._again(fault):
                    raise

    def _append(self, block: bytes | memoryview, ending: bytes) -> None:
        file = self._opened()
        if self._placed and not (
            self.path.exists() and os.path.samestat(os.fstat(file.fileno()), self.path.stat())
        ):
            raise FileNotFoundError("it was moved or deleted")
        try:
            self._write_all(file, block, ending)
        except OSError:
            with suppress(OSError):
                self._write_all(file, self._ending)
            raise
        waits = self._overwrite and self.path.exists() and time.monotonic() - self._since < _SAFE_S
        if not self._placed and not waits:
            os.fsync(file.fileno())
        self.size, self._ending = self.size + len(block), ending
        if not self._placed and not waits:
            with suppress(OSError):
                self._place(self._overwrite)

    def _opened(self) -> FileIO:
        if self._hidden is None:
            self._hidden, self._since = Hidden(self.path), time.monotonic()
        if self._file is None and sys.platform == "win32":  # which renames no open file
            self._file = FileIO(self.path if self._placed else self._hidden.path, "r+")
        elif self._file is None:
            self._file = FileIO(self._hidden.descriptor, "r+", closefd=False)
        return self._file

    def _write_all(self, file: FileIO, *parts: bytes | memoryview) -> None:
        """Writes after the blocks; nothing follows."""
        file.seek(self.size)
        for part in parts:
            rest = memoryview(part)
            while rest:
                rest = rest[file.write(rest) or 0 :]
        file.truncate()

    def patch(self, at: int, block: bytes) -> None:
        """Replaces bytes that are written."""
        file = self._opened()
        file.seek(at)
        file.write(block)

    def close(self, *, whole: bool = True) -> None:
        """Ends the file. One that has no name yet gets it; one that is not `whole` replaces no other.

        Raises:
            KeptError: It could not get its name, once.
        """
        try:
            if self.size and not self._placed:
                os.fsync(self._opened().fileno())
                self._place(self._overwrite and whole)
        except OSError as fault:
            assert self._hidden is not None
            self._placed, self._kept = True, self._hidden.keep(self.path, fault)
        finally:
            if self._file is not None:
                self._file.close()
            if self._hidden is not None:
                self._hidden.remove()
        kept, self._kept = self._kept, None
        if kept is not None:
            raise kept

    def _place(self, overwrite: bool) -> None:
        assert self._hidden is not None
        if sys.platform == "win32" and self._file is not None:
            self._file.close()
            self._file = None
        try:
            self._hidden.place(self.path, overwrite)
        except FileExistsError as fault:
            name = free_name(self.path)
            self._hidden.place(name, overwrite=False)
            self.path, self._kept = name, KeptError(fault, self.path, name)
        self._placed = True


def real_path(path: Path) -> Path:
    """What links to an output lead to.

    Raises:
        OSError: One is another user's in a folder where everybody may make one, such as ``/tmp``.
    """
    if sys.platform != "win32":
        for part in (path, *path.parents):
            if part.is_symlink():
                folder, user = part.parent.stat(), part.stat(follow_symlinks=False).st_uid
                if folder.st_mode & stat.S_IWOTH and user not in (os.getuid(), folder.st_uid):
                    raise OSError(errno.ELOOP, f"{part.name} is a link of another user", str(path))
    return Path(os.path.realpath(path))


def free_name(path: Path) -> Path:
    """The path, or if it exists, the first free one of ``name-2``, ``name-3`` …"""
    names = (path.with_stem(f"{path.stem}-{k}") for k in count(2))
    return next(name for name in chain([path], names) if not os.path.lexists(name))


def _locked(path: Path, how: int = 0, *, surely: bool = False) -> int | None:
    """A descriptor that holds the lock of a file or folder; None if another process has it or removed it.

    Windows does not remove open files, which is lock enough. Where there are no locks, it is open only, or
    None where it must hold the lock `surely`.
    """
    if sys.platform == "win32":
        return -1 if path.is_dir() else os.open(path, how | os.O_RDWR | os.O_BINARY, 0o666)
    how |= (os.O_RDONLY if path.is_dir() else os.O_RDWR) | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        lock = os.open(path, how, 0o666)
    except OSError as fault:
        if isinstance(fault, FileNotFoundError) and not how & os.O_CREAT:
            return None
        if path.is_symlink():
            raise OSError(fault.errno, f"{path.name} in its folder is a link; remove it", str(path)) from None
        raise
    try:
        if sys.platform != "win32":  # for mypy
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        there = os.path.samestat(os.fstat(lock), path.stat(follow_symlinks=False))
    except (BlockingIOError, FileNotFoundError):
        there = False
    except OSError:
        there = not surely
    if there:
        return lock
    os.close(lock)
    return None


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
    own = about.st_uid == os.getuid() and about.st_mode & stat.S_IWUSR
    if own and (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        lock = _locked(path, surely=True)
        if lock is not None:
            if stat.S_ISDIR(about.st_mode):
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
            os.close(lock)
