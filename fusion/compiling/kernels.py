"""Compilation of kernels: once per machine, cached on disk.

A first run waits for compilation, so that every kernel is compiled for one set of types, and only kernels
that Python calls get a Python wrapper. Kernels do not assign whole arrays: numba would compile the error
message for mismatched shapes, which takes longer than a kernel.

Importing a module with kernels touches no file and no environment variable: the cache folder is
looked for, and stale kernels are deleted, when the first kernel is compiled.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

from fusion.compiling.kernel_cache import drop_stale_kernels, ensure_cache_folder

_Kernel = Callable[..., Any]
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = {**_OPTIONS, "no_cpython_wrapper": True}


def kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that Python calls."""
    return _kept_on_disk(function, _OPTIONS)


def inner_kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that only kernels call."""
    return _kept_on_disk(function, _INNER_OPTIONS)


def njit(*, nogil: bool = False) -> Callable[[_Kernel], _Kernel]:
    """Compiles a function with numba's own options, for code outside the method.

    Args:
        nogil: Whether it releases the GIL.
    """
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
            _prepare_disk(function.__module__.partition(".")[0])
            compiled.enable_caching()

    def compile_first(signature: Any) -> Any:
        ready()
        return compile_now(signature)

    compiled.compile, compiled.ready = compile_first, ready
    kept: _Kernel = compiled
    return kept


@cache
def _prepare_disk(package: str) -> None:
    """Prepares the cache once per package with kernels."""
    ensure_cache_folder()
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is not None:
        drop_stale_kernels(Path(file).parent)
