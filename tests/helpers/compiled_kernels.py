"""Compiles the kernels before pytest-xdist starts its processes, so that not each of them compiles all."""

import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from fusion.setup import Method

_ROOT = Path(__file__).resolve().parents[2]
_WARM_UP = """
import sys
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
Fuser(FusionSetup(nominal_calibration(AZURE_KINECT), FuserSettings(method=sys.argv[1]))).warm_up()
"""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes():
    compile_kernels()


def compile_kernels():
    """Compiles the kernels of every method that are not on disk."""
    processes = [
        subprocess.Popen([sys.executable, "-c", _WARM_UP, method], cwd=_ROOT) for method in get_args(Method)
    ]
    for process in processes:
        process.wait()


if __name__ == "__main__":
    compile_kernels()
