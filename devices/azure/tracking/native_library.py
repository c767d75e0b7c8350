"""Finds and loads the C libraries of a vendor."""

import ctypes
import ctypes.util
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from devices.sensor import DeviceError

Prototypes = Mapping[str, tuple[Any, list[Any]]]

_WINDOWS_FOLDERS = {
    "k4abt": ("Azure Kinect Body Tracking SDK/tools",),
    "k4a": (
        "Azure Kinect Body Tracking SDK/tools",
        "Azure Kinect SDK v1.4.1/sdk/windows-desktop/amd64/release/bin",
    ),
}
_LINUX_NAMES = {
    "k4abt": ("libk4abt.so.1.1", "libk4abt.so.1", "libk4abt.so"),
    "k4a": ("libk4a.so.1.4", "libk4a.so"),
}


def load_library(name: str, path: Path | None, advice: str) -> ctypes.CDLL:
    """Loads ``k4abt`` or ``k4a`` from a path, or from where the system finds it; on Windows also in the
    folders of the SDKs.

    Raises:
        DeviceError: The library is missing or cannot be loaded. The message ends with the advice.
    """
    if path is not None and not path.is_file():
        raise DeviceError(f"No library at {path}. {advice}")
    faults = []
    for candidate in [str(path)] if path is not None else _candidates(name):
        try:
            return ctypes.CDLL(candidate)
        except OSError as fault:
            faults.append(str(fault))
    raise DeviceError(f"The library {path or name} cannot be loaded ({faults[-1]}). {advice}")


def declare(library: ctypes.CDLL, prototypes: Prototypes, otherwise: str) -> None:
    """Sets the types of a library's functions.

    Args:
        prototypes: Type of the result and types of the arguments by function name.
        otherwise: What it means that a function is missing, and what to do.

    Raises:
        DeviceError: A function is missing.
    """
    for name, (result, arguments) in prototypes.items():
        try:
            function = getattr(library, name)
        except AttributeError as fault:
            raise DeviceError(f"{library._name} has no {name}: {otherwise}") from fault
        function.restype, function.argtypes = result, arguments


def loaded_file(name: str) -> Path | None:
    """Returns the path of a library that this process has loaded.

    None if it is not loaded, or if the system has no ``/proc/self/maps``.
    """
    try:
        lines = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    except OSError:
        return None
    files = (Path(columns[5]) for line in lines if len(columns := line.split(maxsplit=5)) == 6)
    # A wheel's libraries carry a hash in their names: libk4a-f64cb9eb.so.1.4.2.
    pattern = re.compile(rf"lib{name}(-[0-9a-f]+)?\.so(\.\d+)*")
    return next((file for file in files if pattern.fullmatch(file.name)), None)


def _candidates(name: str) -> list[str]:
    if sys.platform == "win32":
        folders = [Path("C:/Program Files") / folder for folder in _WINDOWS_FOLDERS[name]]
        return [*(str(folder / f"{name}.dll") for folder in folders if folder.is_dir()), f"{name}.dll"]
    found = ctypes.util.find_library(name)
    return [*([found] if found else []), *_LINUX_NAMES[name]]
