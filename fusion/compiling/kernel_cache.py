"""Compiled kernels on disk, and when they no longer fit their sources.

numba keeps a compiled kernel until the file that the kernel itself stands in changes. But a kernel holds the
code of the kernels that it calls, and the values of the constants it imports: an edit of *those* files would
go unnoticed.
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

    Only an edit in place can leave a stale kernel behind, and it makes a newest source. A read-only folder
    cannot be edited, so it holds no stale kernels.

    Args:
        package: The folder of the sources.
    """
    with suppress(OSError):
        newest = max(source.stat().st_mtime_ns for source in package.rglob("*.py"))
        for index in package.rglob("__pycache__/*.nbi"):
            if index.stat().st_mtime_ns <= newest:
                index.unlink(missing_ok=True)  # without its index a kernel is compiled again


def ensure_cache_folder() -> None:
    """Where numba finds no folder to keep kernels in, gives it one for as long as this process runs.

    That is so in a read-only installation of someone without a writable home, where ``njit(cache=True)``
    would fail. Processes that this one starts use the folder too.
    """
    from numba import config, njit

    try:
        njit(cache=True)(_probe)  # compiles nothing, but looks for a folder
    except RuntimeError:
        folder = tempfile.mkdtemp(prefix="duplex-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder  # type: ignore[attr-defined]


def _probe() -> None:
    """What a folder is looked for."""
