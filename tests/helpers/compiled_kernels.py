"""Compiles the kernels in one process beside those of pytest-xdist, which begin with tests that need none.

A process that does not find a kernel on disk waits until it is there, or the one that compiles has ended.

    python -m tests.helpers.compiled_kernels          # compiles the kernels that are not on disk
    python -m tests.helpers.compiled_kernels --list   # compiles all of them, and says how long each took
"""

import re
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from threading import Thread
from time import process_time
from unittest.mock import patch

import psutil
import pytest

_ROOT = Path(__file__).resolve().parents[2]
_NEEDS_NONE = re.compile(r"tests/(devices/(?!.*(?<!re)fus)|documents/(?!test_(commands|architecture)))")
_COMPILING = pytest.StashKey()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config):
    process = subprocess.Popen([sys.executable, "-m", "tests.helpers.compiled_kernels"], cwd=_ROOT)
    Thread(target=process.wait, daemon=True).start()  # else its identifier stays in use
    config.stash[_COMPILING] = process


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    node.workerinput["compiling"] = node.config.stash[_COMPILING].pid


def pytest_configure(config):
    if hasattr(config, "workerinput"):
        from fusion.compiling.disk_cache import _ForgivingCache

        _ForgivingCache.load_overload = _waiting(
            _ForgivingCache.load_overload, config.workerinput["compiling"]
        )


def pytest_unconfigure(config):
    if process := config.stash.get(_COMPILING, None):
        process.kill()


def _waiting(load, compiling):
    """How a kernel is found on disk: as soon as the process that compiles has written it, or ends."""
    running = []
    with suppress(psutil.NoSuchProcess):
        running.append(psutil.Process(compiling))

    def load_overload(cache, *of):
        waited = running if cache._py_func.__module__.startswith("fusion.") else []
        while (found := load(cache, *of)) is None and waited:
            try:
                waited[0].wait(0.2)
            except psutil.TimeoutExpired:
                continue
            waited.clear()
        return found

    return load_overload


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """The distribution worksteal begins with contiguous shares of equal length."""
    if not hasattr(config, "workerinput"):
        return
    first = [item for item in items if _NEEDS_NONE.match(item.nodeid)]
    later = [item for item in items if not _NEEDS_NONE.match(item.nodeid)]
    workers = config.workerinput["workercount"]
    items[:] = [
        item
        for k in range(workers)
        for part in (first, later)
        for item in part[k * len(part) // workers : (k + 1) * len(part) // workers]
    ]


def compile_kernels():
    """Compiles the kernels of every method that are not on disk, and those of whole recordings."""
    from typing import get_args

    from fusion.body import AZURE_KINECT
    from fusion.calibration.calibration import nominal_calibration
    from fusion.fuser import Fuser
    from fusion.setup import FuserSettings, FusionSetup, Method
    from tests.helpers import golden_session

    for method in get_args(Method):
        Fuser(FusionSetup(nominal_calibration(AZURE_KINECT), FuserSettings(method=method))).warm_up()
    golden_session.runs_of(golden_session.load())


def print_seconds(compiles=compile_kernels):
    """CPU seconds of compiling each kernel without those that it calls, longest first."""
    from numba.core import event

    seconds, running = Counter(), []

    class Compiling(event.Listener):
        def on_start(self, event):
            function = event.data["dispatcher"].py_func
            running.append((f"{function.__module__}.{function.__name__}", process_time()))

        def on_end(self, _event):
            name, since = running.pop()
            spent = process_time() - since
            seconds[name] += spent
            for caller, _ in running[-1:]:
                seconds[caller] -= spent

    # with no folder for kernels this process finds none, and starts no other that compiles
    with (
        event.install_listener("numba:compile", Compiling()),
        patch("fusion.compiling.disk_cache.ensure_cache_folder", return_value=False),
    ):
        compiles()
    for name, of_one in [*seconds.most_common(), (f"{len(seconds)} kernels", seconds.total())]:
        print(f"{of_one:7.2f} s  {name}")


if __name__ == "__main__":
    print_seconds() if "--list" in sys.argv else compile_kernels()
