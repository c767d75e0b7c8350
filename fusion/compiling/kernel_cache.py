"""Compiled kernels on disk, and removal of stale ones.

numba keeps a compiled kernel until the kernel's own file changes. A kernel also contains the code of the
kernels that it calls and the values of imported constants; numba does not notice a change of *their* files.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path


def drop_stale_kernels(package: Path) -> None:
    """Deletes the compiled kernels of a package and its subpackages that are older than its newest source.

    Only an edit in place can leave a stale kernel, and it updates a source's time. A read-only folder cannot
    be edited, so it contains no stale kernels.

    Args:
        package: The folder of the sources.
    """
    with suppress(OSError):
        newest = max(source.stat().st_mtime_ns for source in package.rglob("*.py"))
        for index in package.rglob("__pycache__/*.nbi"):
            if index.stat().st_mtime_ns <= newest:
                index.unlink(missing_ok=True)  # without its index a kernel is compiled again


def ensure_cache_folder() -> None:
    """Gives numba a temporary cache folder if it finds none.

    In a read-only installation without a writable home directory, ``njit(cache=True)`` would fail. Child
    processes use the same folder.
    """
    from numba import config, njit

    try:
        njit(cache=True)(_probe)  # compiles nothing, but looks for a folder
    except RuntimeError:
        folder = tempfile.mkdtemp(prefix="duplex-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder  # type: ignore[attr-defined]


def _probe() -> None:
    """A function for which numba looks for a cache folder."""
