"""Kernels as plain Python functions, so that a step can be tested by itself and without compiling it."""

from types import FunctionType

from numba.core.dispatcher import Dispatcher

from fusion.compiling.kernels import LazyKernel


def interpreted(kernel):
    """The kernel's own Python function, which calls the Python functions of the kernels it calls."""
    return _interpreted(kernel, {})


def _interpreted(kernel, known):
    if kernel in known:
        return known[kernel]
    source = kernel.py_func
    names = dict(source.__globals__)
    function = known[kernel] = FunctionType(source.__code__, names, source.__name__, source.__defaults__)
    for name in source.__code__.co_names:
        if isinstance(names.get(name), Dispatcher | LazyKernel):
            names[name] = _interpreted(names[name], known)
    return function
