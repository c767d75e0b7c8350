"""Compilation on a first run: in other processes beside the program, with what is left to do.

numba holds the interpreter while it compiles, on one core. Two other processes leave the kernels on disk; the
program, which opens windows and sensors meanwhile, loads them. Where nothing is kept on disk or no process
starts, the program compiles for itself.

``python -m fusion.compiling.first_run MODULE:FUNCTION …`` is such a process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from fusion.compiling.kernels import WarmUp

_TOLD_AFTER, _TOLD_EVERY = 1.0, 3.0  # seconds
_BYTES_PER_SECOND, _KERNEL_BYTES = 2000, 120
"""How fast one core compiles the code of kernels, each of which takes as long as so many bytes more."""
_START = 5.0
"""Seconds of one core before the first kernel is compiled; also the weight of the estimate before a run."""


class Progress(NamedTuple):
    """How many of the kernels that a run lacked are compiled, and the estimated seconds for the others."""

    done: int
    of: int
    seconds_left: float

    def __str__(self) -> str:
        if not self.of:
            return "Loading the kernels …"
        left = f", about {self.seconds_left:.0f} s left" if self.done else ""
        return f"The first run compiles the kernels: {self.done} of {self.of}{left} …"


class FirstRun:
    """Compiles what a run needs and is not on disk yet. A context manager: other processes compile, and the
    progress is told, from entering it until :meth:`finish` returns or the block ends.

    Args:
        shares: What each process compiles, in this order.
        tell: Called after a second and then every so many seconds, on a thread of its own.
        clock: Seconds.
    """

    def __init__(
        self,
        *shares: Sequence[WarmUp],
        tell: Callable[[Progress], object] | None = None,
        every: float = _TOLD_EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._shares = list(filter(None, shares))
        calls: dict[Any, set[Any]] = {}
        for dispatcher in (each for share in shares for warm_up in share for each in warm_up.dispatchers):
            _add_calls(dispatcher, calls)
        self._calls, self._called = calls, set[Any]().union(*calls.values())
        self._lacking = {kernel: _cost(kernel) for kernel in calls if not _is_compiled(kernel)}
        self._tell, self._every, self._clock = tell, every, clock
        self._began, self._done = clock(), 0
        self._processes: list[subprocess.Popen[bytes]] = []
        self._finished = threading.Event()
        self._telling = threading.Thread(target=self._tell_often, name="first run", daemon=True)

    def __bool__(self) -> bool:
        """Whether a kernel was not on disk at the start."""
        return bool(self._lacking)

    def __enter__(self) -> FirstRun:
        if self and all(kernel.stats.cache_path is not None for kernel in self._lacking):
            with suppress(OSError):
                for share in self._shares:
                    if lacking := [warm_up for warm_up in share if self._lacks(warm_up)]:
                        self._processes.append(_start(lacking))
        self._telling.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._finished.set()
        self._telling.join()
        for process in self._processes:
            process.kill()
            process.wait()

    def progress(self) -> Progress:
        """The progress now; the number of kernels never sinks."""
        left = [kernel for kernel in self._lacking if not _is_compiled(kernel)]
        self._done = max(self._done, len(self._lacking) - len(left))
        cost = sum(self._lacking[kernel] for kernel in left)
        compiled = sum(self._lacking.values()) - cost
        pace = (self._clock() - self._began + _START / len(self._shares)) / (compiled + _START)
        return Progress(self._done, len(self._lacking), pace * cost)

    def finish(self, load: bool = True) -> None:
        """Waits for the other processes, and compiles what they have not.

        Args:
            load: Whether to load all kernels, so that no first call waits for it.
        """
        for process in self._processes:
            process.wait()
        if load or not all(map(_is_compiled, self._lacking)):
            for warm_up in (warm_up for share in self._shares for warm_up in share):
                if not warm_up.dispatchers <= self._called:
                    warm_up()
        self.__exit__()

    def _lacks(self, warm_up: WarmUp) -> bool:
        reached = warm_up.dispatchers.union(*map(self._calls.__getitem__, warm_up.dispatchers))
        return not reached.isdisjoint(self._lacking)

    def _tell_often(self) -> None:
        pause = _TOLD_AFTER
        while self._tell is not None and not self._finished.wait(pause):
            self._tell(self.progress())
            pause = self._every


def _add_calls(dispatcher: Any, calls: dict[Any, set[Any]]) -> None:
    """Adds a dispatcher and all that it reaches, each with all that it reaches."""
    if dispatcher not in calls:
        reached = calls[dispatcher] = set()
        names, code = dispatcher.py_func.__globals__, dispatcher.py_func.__code__
        for called in (names[name] for name in code.co_names if hasattr(names.get(name), "py_func")):
            _add_calls(called, calls)
            reached |= {called, *calls[called]}


def _cost(kernel: Any) -> float:
    """Seconds of one core that its compilation takes."""
    return (_KERNEL_BYTES + len(kernel.py_func.__code__.co_code)) / _BYTES_PER_SECOND


def _is_compiled(kernel: Any) -> bool:
    """Whether it is in memory or on disk, for any types."""
    path = kernel.stats.cache_path
    return bool(kernel.signatures) or (
        path is not None and Path(path, kernel._cache._cache_file._index_name).exists()
    )


def _start(share: Sequence[WarmUp]) -> subprocess.Popen[bytes]:
    packages = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, *(warm_up.name for warm_up in share)],
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


if __name__ == "__main__":
    for module, _, function in (name.partition(":") for name in sys.argv[1:]):
        getattr(import_module(module), function)()
