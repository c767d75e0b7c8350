"""The rig of ``../shared/rig``, the real libk4a with simulated sensors, made ready under the cache folder."""

import os
import shutil
import subprocess
import sys

import pytest

from tests.helpers.machine import lacks
from tests.helpers.real_libraries import CACHE

_DEBIAN = "build-essential python3-dev libusb-1.0-0-dev"


def built_rig(shared):
    """The folder with the rig's libraries (``lib``), files (``bus``) and pyk4a (``site``).

    Skips the running test where the rig or what it needs is missing.
    """
    source = shared / "rig"
    if not source.is_dir() or not sys.platform.startswith("linux"):
        pytest.skip(f"no rig at {source}, or not on Linux")
    if shutil.which("g++") is None:
        lacks("a C++ compiler", f"Debian: apt install {_DEBIAN}")
    target = CACHE / f"rig2-{sys.implementation.cache_tag}"
    worker = os.environ.get("PYTEST_XDIST_WORKER", "one")
    making = target.with_name(f"{target.name}-{worker}")
    if not (target / "site" / "pyk4a").is_dir():
        shutil.rmtree(making, ignore_errors=True)
        command = ["bash", str(source / "build.sh"), str(making), sys.executable]
        if subprocess.run(command, capture_output=True, timeout=600.0).returncode:
            lacks("what the rig is built with", f"Debian: apt install {_DEBIAN}")
        if not target.exists():
            making.rename(target)
    return target
