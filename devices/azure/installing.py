"""Instructions for installing pyk4a, by platform."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version

_EXTRA = "pip install '.[kinect]' (after make: .venv/bin/pip install -e '.[kinect]')"
_NEEDS = {
    "linux": (
        "a C++ compiler (Debian, Ubuntu: build-essential), Python's headers (python3-dev) and the headers of "
        "the Azure Kinect Sensor SDK 1.4 (libk4a1.4-dev; for Orbbec their K4A wrapper, its folders named by "
        "CPATH, LIBRARY_PATH and LD_LIBRARY_PATH)"
    ),
    "win32": (
        "Microsoft's C++ Build Tools and the Azure Kinect Sensor SDK 1.4.1 where its installer puts it (for "
        "Orbbec: build against it, then put the DLLs of their K4A wrapper in its place)"
    ),
}


def how_to_install(platform: str = sys.platform) -> str:
    """Returns the instructions for installing a pyk4a that works with this program.

    pyk4a is built from source: the wheels of pyk4a-bundle need numpy < 2, and rerun-sdk needs numpy ≥ 2.

    Args:
        platform: A platform name as in ``sys.platform``.
    """
    needs = _NEEDS.get(platform)
    if needs is None:
        return "The Azure Kinect Sensor SDK runs on Windows and Linux only: record there, and fuse here."
    remove = ""
    if _has_bundle():
        remove = "Remove pyk4a-bundle, whose wheels need numpy < 2 (pip uninstall pyk4a-bundle). "
    return f"{remove}pyk4a is built from source, with {needs}. Then, from this program's folder: {_EXTRA}."


def _has_bundle() -> bool:
    try:
        version("pyk4a-bundle")
    except PackageNotFoundError:
        return False
    return True
