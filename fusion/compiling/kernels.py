"""How kernels are compiled: once a machine, kept on disk.

Compiling is what a first run waits for, so that every kernel is compiled for one set of types, and only what
Python calls gets a way in from Python. Whole arrays are not assigned in kernels: numba would compile the
wording of the error for shapes that differ, which takes longer than a kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit as njit

from fusion.compiling.kernel_cache import ensure_cache_folder

ensure_cache_folder()  # whoever takes njit from here has one

_Kernel = Callable[..., Any]
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = {**_OPTIONS, "no_cpython_wrapper": True}


def kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that Python calls."""
    compiled: _Kernel = njit(**_OPTIONS)(function)
    return compiled


def inner_kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that only kernels call."""
    compiled: _Kernel = njit(**_INNER_OPTIONS)(function)
    return compiled
