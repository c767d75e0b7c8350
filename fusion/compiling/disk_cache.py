"""Where numba keeps compiled kernels, and what happens where it cannot.

The folder is looked for, and stale kernels are deleted, before the first kernel is called. A cache that is
damaged, full or nowhere to be written costs a compilation and no more.
"""

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import types
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

_NumbasCache: Any = FunctionCache


def dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """numba's dispatcher of a function, with the cache of this module.

    It has no types of its own for constant integers, for each of which numba would compile it again.
    """
    compiled: Any = numba.njit(**options)(function)
    template = compiled.get_call_template
    compiled.get_call_template = lambda args, kws: template(tuple(map(types.unliteral, args)), kws)
    if _prepare_disk(function.__module__.partition(".")[0]):
        with suppress(RuntimeError):  # no folder for this one
            compiled._cache = _ForgivingCache(function)
    return compiled


class _ForgivingCache(_NumbasCache):  # type: ignore[misc]
    """numba's cache, whose files may be damaged, and whose disk may be full."""

    def load_overload(self, types: Any, target: Any) -> Any:
        try:
            # not super().load_overload: it imports what only compiling needs, as long again as numba itself
            rtsys.initialize(target)
            found = self._load_overload(types, target)
        except Exception:  # what unpickling raises
            return None
        # of two processes that keep a kernel for other types at once, one gets the file that the other writes
        return found if found is not None and found.signature.args == types else None

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
        numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder  # type: ignore[attr-defined]
    return True


def _probe() -> None:
    """A function for which numba looks for a cache folder."""
