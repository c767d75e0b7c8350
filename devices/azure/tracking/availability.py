"""Whether Microsoft's body tracker can run on this machine."""

from __future__ import annotations

import ctypes
import shutil
import sys
from pathlib import Path

from devices.azure.tracking.body_tracker import INSTALL, TrackerSettings
from devices.azure.tracking.native_library import load_library
from devices.sensor import DeviceError


def why_not_k4abt(settings: TrackerSettings | None = None, root: Path = Path("/")) -> str:
    """Why libk4abt is of no use here, in one clause; empty where it works, as far as can be told.

    Args:
        settings: Settings of the tracker.
        root: Root of the file system; tests inject their own.
    """
    settings = settings or TrackerSettings()
    try:
        library = load_library("k4abt", settings.library, INSTALL)
    except DeviceError:
        return "libk4abt is not installed"
    if not hasattr(library, "k4abt_tracker_create"):
        return f"{library._name} is not libk4abt"
    if settings.processing == "cpu":
        return "libk4abt tracks about one frame per second on a CPU"
    return "" if found_gpu(root) else "libk4abt finds no GPU driver"


def found_gpu(root: Path = Path("/")) -> str:
    """What libk4abt can compute on: "NVIDIA driver", "DirectML", or nothing.

    Args:
        root: Root of the file system; tests inject their own.
    """
    if (root / "proc/driver/nvidia/version").is_file() or shutil.which("nvidia-smi"):
        return "NVIDIA driver"
    if sys.platform == "win32":
        try:
            ctypes.CDLL("DirectML.dll")
        except OSError:
            return ""
        return "DirectML"
    return ""
