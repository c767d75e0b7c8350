"""How kernels are compiled: once a machine, kept on disk.

Compiling is what a first run waits for, so that every kernel is compiled for one set of types, and only what
Python calls gets a way in from Python. Whole arrays are not assigned in kernels: numba would compile the
wording of the error for shapes that differ, which takes longer than a kernel.

Importing a module with kernels touches no file and no environment variable: the folder with compiled kernels
is looked for, and stale ones in it are deleted, when the first kernel is compiled.
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
    """Compiles a function with numba's own options, as outside of the method.

    Args:
        nogil: Whether it runs beside Python's other threads.
    """
    return lambda function: _kept_on_disk(function, {"nogil": nogil})


def find_on_disk(function: _Kernel) -> None:
    """Lets a kernel look for what is compiled of it already, as its first call does."""
    ready: Callable[[], None] | None = getattr(function, "ready", None)
    if ready is not None:
        ready()


def _kept_on_disk(function: _Kernel, options: dict[str, Any]) -> _Kernel:
    """The compiled function. numba's ``cache=True`` would look for a folder at once, hence this detour."""
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
    """Once for each package with kernels."""
    ensure_cache_folder()
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is not None:
        drop_stale_kernels(Path(file).parent)
