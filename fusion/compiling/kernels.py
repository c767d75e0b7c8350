"""Compilation of kernels: once per machine, cached on disk.

A first run waits for compilation, so that every kernel is compiled for one set of types, and only kernels
that Python calls get a Python wrapper. Kernels do not assign whole arrays: numba would compile the error
message for mismatched shapes, which takes longer than a kernel.

Importing a module with kernels touches no file and no environment variable: the cache folder is
looked for, and stale kernels are deleted, when the first kernel is compiled. numba keeps a compiled kernel
until the kernel's own file changes. A kernel also contains the code of the kernels that it calls and the
values of imported constants; numba does not notice a change of *their* files. A cache that is damaged, full
or nowhere to be written costs a compilation and no more.

On a first run two processes compile, because numba uses one core; each finds the other's kernels on disk.
"""

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache

_Kernel = Callable[..., Any]
_NumbasCache: Any = FunctionCache
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = {**_OPTIONS, "no_cpython_wrapper": True}


def kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that Python calls."""
    return _kept_on_disk(function, _OPTIONS)


def inner_kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that only kernels call."""
    return _kept_on_disk(function, _INNER_OPTIONS)


def njit(*, nogil: bool = False) -> Callable[[_Kernel], _Kernel]:
    """Compiles a function with numba's own options, for code outside the method."""
    return lambda function: _kept_on_disk(function, {"nogil": nogil})


def find_on_disk(function: _Kernel) -> None:
    """Loads a kernel from the cache, as its first call does."""
    ready: Callable[[], None] | None = getattr(function, "ready", None)
    if ready is not None:
        ready()


def _kept_on_disk(function: _Kernel, options: dict[str, Any]) -> _Kernel:
    """The compiled function. numba's ``cache=True`` would look for a folder at import."""
    compiled: Any = numba.njit(**options)(function)
    compile_now = compiled.compile

    def ready() -> None:
        if "ready" in vars(compiled):
            del compiled.compile, compiled.ready
            if _prepare_disk(function.__module__.partition(".")[0]):
                with suppress(RuntimeError):  # no folder for this one
                    compiled._cache = _ForgivingCache(function)

    def compile_first(signature: Any) -> Any:
        ready()
        return compile_now(signature)

    compiled.compile, compiled.ready = compile_first, ready
    kept: _Kernel = compiled
    return kept


class _ForgivingCache(_NumbasCache):  # type: ignore[misc]
    """numba's cache, whose files may be damaged, and whose disk may be full."""

    def load_overload(self, *of: Any) -> Any:
        try:
            return super().load_overload(*of)
        except Exception:  # what unpickling raises
            return None

    def save_overload(self, *of: Any) -> None:
        try:
            super().save_overload(*of)
        except Exception:
            with suppress(Exception):
                self.flush()  # a damaged index, which is read before it is written
                super().save_overload(*of)


@cache
def _prepare_disk(package: str) -> bool:
    """Prepares the cache once per package with kernels; whether there is one."""
    if not ensure_cache_folder():
        return False
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is not None:
        drop_stale_kernels(Path(file).parent, Path(__file__).parents[1])
    return True


def drop_stale_kernels(package: Path, *imported: Path) -> None:
    """Deletes the compiled kernels of a package and its subpackages that are older than its newest source.

    Args:
        imported: Other packages, whose kernels and constants its kernels contain.

    Only an edit in place can leave a stale kernel, and it updates a source's time. A read-only folder cannot
    be edited, so it contains no stale kernels.
    """
    with suppress(OSError):
        sources = (source for folder in (package, *imported) for source in folder.rglob("*.py"))
        newest = max(source.stat().st_mtime_ns for source in sources)
        for index in package.rglob("__pycache__/*.nbi"):
            if index.stat().st_mtime_ns <= newest:
                index.unlink(missing_ok=True)  # without its index a kernel is compiled again


@cache
def ensure_cache_folder() -> bool:
    """Gives numba a temporary cache folder if it finds none; whether there is one.

    In a read-only installation without a writable home directory, ``njit(cache=True)`` would fail; for a user
    without a home, numba would make a folder ``~`` where the program runs. Child processes use the same
    folder.
    """
    from numba import config

    try:
        if not (os.environ.get("NUMBA_CACHE_DIR") or os.access(Path(__file__).parent, os.W_OK)):
            Path.home()
        _NumbasCache(_probe)
    except RuntimeError:
        try:
            folder = tempfile.mkdtemp(prefix="duplex-kernels-")
        except OSError:
            return False
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder  # type: ignore[attr-defined]
    return True


def _probe() -> None:
    """A function for which numba looks for a cache folder."""


@contextmanager
def compiled_meanwhile(kernel: Any, statements: str) -> Iterator[None]:
    """Lets another process compile kernels; waits for it at the end.

    Args:
        kernel: The kernel that will be called. If it is on disk, nothing is compiled.
    """
    process = None if _is_on_disk(kernel) else _start(statements)
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _is_on_disk(kernel: Any) -> bool:
    """True also where nothing is kept on disk: another process would compile for itself."""
    find_on_disk(kernel)
    if kernel.stats.cache_path is None:
        return True
    folder = Path(kernel.stats.cache_path)
    python = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    return any(folder.glob(f"*{kernel.__name__}-*.{python}.nbi"))


def _start(statements: str) -> subprocess.Popen[bytes] | None:
    """None where no process can be started; this process then compiles everything itself."""
    packages = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", statements],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
