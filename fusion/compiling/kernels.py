"""Compilation of kernels: once per machine, cached on disk.

A first run waits for compilation, so that every kernel is compiled for one set of types, and only kernels
that Python calls get a Python wrapper. Kernels do not assign whole arrays: numba would compile the error
message for mismatched shapes, which takes longer than a kernel.

Importing a module with kernels does not import numba, which takes as long as all else, and touches no file
and no environment variable. numba keeps a compiled kernel until the kernel's own file changes. A kernel also
contains the code of the kernels that it calls and the values of imported constants; numba does not notice a
change of *their* files (:mod:`fusion.compiling.disk_cache`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, update_wrapper
from typing import Any

_Kernel = Callable[..., Any]
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = {**_OPTIONS, "no_cpython_wrapper": True, "_nrt": False}


class LazyKernel:
    """A function that becomes numba's dispatcher when it is first called, and has that one's attributes."""

    def __init__(self, function: _Kernel, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options

    @cached_property
    def dispatcher(self) -> Any:
        """numba's dispatcher. The module's names of this kernel and of those it calls become dispatchers,
        because numba knows no other functions."""
        from fusion.compiling.disk_cache import dispatcher

        names = self._function.__globals__
        for name in self._function.__code__.co_names:
            if isinstance(called := names.get(name), LazyKernel):
                names[name] = called.dispatcher
        found = dispatcher(self._function, self._options)
        if names.get(self._function.__name__) is self:
            names[self._function.__name__] = found
        return found

    def __call__(self, *values: Any) -> Any:
        return self.dispatcher(*values)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)


def kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that Python calls."""
    return LazyKernel(function, _OPTIONS)


def inner_kernel(function: _Kernel) -> _Kernel:
    """Compiles a function that only kernels call, that makes no array, and that returns none.

    numba counts no references in it, and would not notice an array in a tuple that it returns.
    """
    return LazyKernel(function, _INNER_OPTIONS)


def njit(*, nogil: bool = False) -> Callable[[_Kernel], _Kernel]:
    """Compiles a function with numba's own options, for code outside the method."""
    return lambda function: LazyKernel(function, {"nogil": nogil})


@dataclass(frozen=True)
class WarmUp:
    """A function of a module that compiles or loads kernels by calling them."""

    function: Callable[[], object]
    kernels: tuple[Any, ...]  # that it calls; they call others

    def __call__(self) -> None:
        self.function()

    @property
    def dispatchers(self) -> set[Any]:
        """Those of the kernels; some modules already have them in place of kernels."""
        return {getattr(kernel, "dispatcher", kernel) for kernel in self.kernels}

    @property
    def name(self) -> str:
        """``module:function``."""
        return f"{self.function.__module__}:{self.function.__name__}"


def compiles(*kernels: Any) -> Callable[[Callable[[], object]], WarmUp]:
    """Decorates a function without arguments that calls these kernels."""
    return lambda function: WarmUp(function, kernels)
