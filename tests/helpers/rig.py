"""The rig of ``../shared/rig``, the real libk4a with simulated sensors, made ready under the cache folder."""

import os
import shutil
import subprocess
import sys

import pytest

from tests.helpers.machine import lacks
from tests.helpers.real_libraries import CACHE

_DEBIAN = "build-essential python3-dev libcjson1 libfmt9 libspdlog1.10"


def built_rig(shared):
    """The folder with the rig's libraries (``lib``), files (``bus``) and pyk4a (``site``).

    Skips the running test where the rig or what it needs is missing.
    """
    source = shared / "rig"
    if not source.is_dir() or not sys.platform.startswith("linux"):
        pytest.skip(f"no rig at {source}, or not on Linux")
    if shutil.which("g++") is None:
        lacks("a C++ compiler", f"Debian: apt install {_DEBIAN}")
    target = CACHE / f"rig-{sys.implementation.cache_tag}"
    worker = os.environ.get("PYTEST_XDIST_WORKER", "one")
    making = target.with_name(f"{target.name}-{worker}")
    if not (target / "site" / "pyk4a").is_dir():
        shutil.rmtree(making, ignore_errors=True)
        for part in ("lib", "bus", "include"):
            shutil.copytree(source / part, making / part)
        _link_libraries(making / "lib")
        _build_pyk4a(making)
        if not target.exists():
            making.rename(target)
    libraries = subprocess.run(
        ["ldd", str(target / "lib" / "libk4a.so")], capture_output=True, text=True
    ).stdout
    if "not found" in libraries:
        lacks("libraries of the rig", f"Debian 12: apt install {_DEBIAN}")
    return target


def _link_libraries(folder):
    """Replaces files that hold the name of another library, as a copy without links has them, by links."""
    folder.chmod(0o755)
    for file in folder.iterdir():
        if file.stat().st_size < 64:
            name = file.read_text().strip()
            file.unlink()
            file.symlink_to(name)


def _build_pyk4a(folder):
    environment = os.environ | {"CPATH": str(folder / "include"), "LIBRARY_PATH": str(folder / "lib")}
    command = [sys.executable, "-m", "pip", "install", "--no-binary=pyk4a", "--no-deps"]
    command += ["--target", str(folder / "site"), "pyk4a==1.5.0"]
    done = subprocess.run(command, env=environment, capture_output=True, timeout=300.0)
    if done.returncode:
        lacks("what pyk4a is built with", f"Debian: apt install {_DEBIAN}")
