"""Compiles the kernels in one process beside those of pytest-xdist, which begin with tests that need none.

The first test of a process that may need them waits.
"""

import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import get_args

import psutil
import pytest

from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup, Method
from tests.helpers import golden_session

_ROOT = Path(__file__).resolve().parents[2]
_KERNEL_FREE = ("tests/devices/", "tests/documents/")
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
        config.pluginmanager.register(_Worker(config.workerinput))


def pytest_unconfigure(config):
    if process := config.stash.get(_COMPILING, None):
        process.kill()


class _Worker:
    """Orders the tests of a process of pytest-xdist, and waits for the kernels."""

    def __init__(self, workerinput):
        self._workers, self._compiling = workerinput["workercount"], workerinput["compiling"]

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        """The distribution worksteal begins with contiguous shares of equal length."""
        free = [item for item in items if item.nodeid.startswith(_KERNEL_FREE)]
        others = [item for item in items if not item.nodeid.startswith(_KERNEL_FREE)]
        items[:] = [
            item
            for k in range(self._workers)
            for part in (free, others)
            for item in part[k * len(part) // self._workers : (k + 1) * len(part) // self._workers]
        ]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item):
        if self._compiling is not None and not item.nodeid.startswith(_KERNEL_FREE):
            with suppress(psutil.NoSuchProcess):
                psutil.Process(self._compiling).wait()
            self._compiling = None


def compile_kernels():
    """Compiles the kernels of every method that are not on disk, and those of whole recordings."""
    for method in get_args(Method):
        Fuser(FusionSetup(nominal_calibration(AZURE_KINECT), FuserSettings(method=method))).warm_up()
    golden_session.runs_of(golden_session.load())


if __name__ == "__main__":
    compile_kernels()
