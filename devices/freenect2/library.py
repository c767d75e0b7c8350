"""Access to Kinects v2 through libfreenect2, by the C functions of ``binding.cpp``, which this file calls."""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from ctypes import POINTER, c_char_p, c_float, c_int, c_int64, c_uint32, c_void_p
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices import vendor
from devices.cache import home, user_cache
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.usb import usb_kinects, why_not_open
from devices.check import Check
from devices.output_file import whole_file
from devices.sensor import DeviceError

PREFIX, PIPELINE = "LIBFREENECT2_INSTALL_PREFIX", "LIBFREENECT2_PIPELINE"
PROGRAMS = "Protonect, KinectService"
SHAPE = (424, 512)
_FOLDERS = ("/usr/local", "/opt/homebrew", "/usr", "C:/vcpkg/installed/x64-windows")
_SOURCES = (Path(__file__).with_name("binding.cpp"), Path(__file__).with_name("CMakeLists.txt"))
_DRIVER = " Windows: give it the driver UsbDk, or libusbK by Zadig, in place of Microsoft's."
_CHECK = "Check its USB 3 port and power supply."
_OPENGL_S = 20.0
_CPU = (
    "libfreenect2 computes depth on the CPU, too slowly for 30 fps. OpenGL (on Linux with an X display), "
    "CUDA or OpenCL must be there when it is built and when it runs."
)
_MEMORY = "Give USB more memory: echo 128 | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb."

SIGNATURES: dict[str, tuple[Any, ...]] = {  # the result, then the arguments; binding.cpp
    "k2_context": (c_void_p,),
    "k2_pipelines": (c_char_p,),
    "k2_count": (c_int, c_void_p),
    "k2_serial": (c_char_p, c_void_p, c_int),
    "k2_open": (c_void_p, c_void_p, c_char_p, c_char_p),
    "k2_start": (c_int, c_void_p, POINTER(c_float)),
    "k2_take": (c_int, c_void_p, c_int, c_void_p, c_void_p, POINTER(c_uint32), POINTER(c_int64)),
    "k2_close": (None, c_void_p),
    "k2_said": (c_char_p,),
}
_one_at_a_time = threading.RLock()  # a context is not made for several threads
_opened: set[str] = set()  # serial numbers
_failed: dict[Path, subprocess.CalledProcessError] = {}
"""Bindings that this process could not compile, which takes seconds each time."""


def installed_prefix() -> Path | None:
    """The folder that libfreenect2 was installed into; None if there is none."""
    named = os.environ.get(PREFIX)
    folders = [Path(named)] if named else [home() / "freenect2", *map(Path, _FOLDERS)]
    return next((one for one in folders if (one / "include/libfreenect2/libfreenect2.hpp").is_file()), None)


@cache
def load_library() -> Any:
    """The binding to the library, with the types of its functions; compiled at the first call.

    Raises:
        DeviceError: libfreenect2 is not installed, or the binding cannot be compiled or loaded.
    """
    prefix = installed_prefix()
    if prefix is None:
        raise DeviceError(
            f"A Kinect v2 needs libfreenect2, which is not installed. Build it as docs/installing.md says "
            f"(Windows: vcpkg install libfreenect2); {PREFIX} names its folder if it is not found."
        )
    try:
        if sys.platform == "win32":
            os.add_dll_directory(str(prefix / "bin"))
        with _one_at_a_time:
            library = _loaded(prefix)
    except (OSError, subprocess.SubprocessError) as fault:
        lines = [line.strip() for line in (getattr(fault, "stdout", None) or str(fault)).split("\n") if line]
        first = next((k for k, line in enumerate(lines) if "error" in line.lower()), 0)
        raise DeviceError(
            f"The binding to libfreenect2 in {prefix} cannot be compiled or loaded "
            f"({' '.join(lines[first : first + 2])}). It needs CMake and a C++ compiler, as libfreenect2 "
            f"did, and writes to the folder {user_cache('freenect2')}."
        ) from fault
    for name, (result, *arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _loaded(prefix: Path) -> Any:
    """The binding; a file in the cache that does not load is compiled anew."""
    file = _compiled(prefix)
    try:
        return ctypes.CDLL(str(file))
    except OSError:
        file.unlink(missing_ok=True)
        return ctypes.CDLL(str(_compiled(prefix)))


def _is_whole(file: Path) -> bool:
    """Whether a file in the cache is as it was written: one cut off, by a loss of power, ends the process."""
    try:
        if sys.platform != "win32" and file.stat().st_uid not in (0, os.getuid()):  # where others may write
            return False
        return _checksum_of(file).read_text(encoding="ascii") == hashlib.sha256(file.read_bytes()).hexdigest()
    except (OSError, ValueError):
        return False


def _checksum_of(file: Path) -> Path:
    return file.with_suffix(".sha256")


def _compiled(prefix: Path) -> Path:
    """The compiled binding, in the cache folder; compiled anew for another library or source."""
    libraries = [one for folder in ("lib*", "lib/*", "bin") for one in prefix.glob(f"{folder}/*freenect2.*")]
    states = [f"{one} {one.stat().st_mtime_ns}".encode() for one in sorted(libraries)]
    key = hashlib.sha256(b"\n".join((*(one.read_bytes() for one in _SOURCES), *states))).hexdigest()
    file = user_cache("freenect2") / f"{key[:16]}.module"
    if file in _failed:
        raise _failed[file]
    if not _is_whole(file):
        with tempfile.TemporaryDirectory() as folder:
            configure = ("-S", str(_SOURCES[0].parent), "-B", folder, "-DCMAKE_BUILD_TYPE=Release")
            build = ("--build", folder, "--config", "Release")
            for given in ((*configure, f"-DCMAKE_PREFIX_PATH={prefix}"), build):
                command = ["cmake", *given]
                done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
                if done.returncode:
                    _failed[file] = subprocess.CalledProcessError(done.returncode, command, done.stdout)
                    raise _failed[file]
            file.parent.mkdir(parents=True, exist_ok=True)
            built = Path(folder) / "binding.module"
            checksum = hashlib.sha256(built.read_bytes()).hexdigest()
            with whole_file(file, overwrite=True) as hidden:
                shutil.copyfile(built, hidden)
            with whole_file(_checksum_of(file), overwrite=True) as hidden:
                hidden.write_text(checksum, encoding="ascii")
    return file


@cache
def _context_of(library: Any) -> Any:
    """The process's one context: it knows the sensors that it opened, which no other one may open."""
    return library.k2_context()


@cache
def _pipeline(library: Any) -> str:
    """The name of the pipeline that computes depth: the library's first choice that works here.

    Where OpenGL fails, the library ends the process, so another one tries. On macOS it wants the main thread.
    """
    choices = str(library.k2_pipelines().decode()).split()
    if "gl" in choices and sys.platform != "win32":
        code = "import ctypes, sys; ctypes.CDLL(sys.argv[1]).k2_try_opengl()"
        command = [sys.executable, "-c", code, library._name]
        try:
            subprocess.run(command, capture_output=True, check=True, timeout=_OPENGL_S)
        except subprocess.SubprocessError:
            choices.remove("gl")
    return next(name for name in choices if name != "gl" or sys.platform != "darwin")


def _named_pipeline(library: Any) -> str:
    """The pipeline that the user names; empty if they name none.

    Raises:
        DeviceError: The library was built without it.
    """
    name, has = os.environ.get(PIPELINE, ""), str(library.k2_pipelines().decode()).split()
    if name and name not in has:
        raise DeviceError(f"{PIPELINE} is {name}, but libfreenect2 was built with {', '.join(has)}.")
    return name


def _found(library: Any) -> tuple[list[str], list[str]]:
    """The serial numbers of the connected sensors, and what the library says of those it cannot open."""
    with _one_at_a_time:
        context = _context_of(library)
        library.k2_said()
        count = library.k2_count(context)
        serials = [library.k2_serial(context, index).decode("ascii", "replace") for index in range(count)]
        return serials, [line for line in _said(library).splitlines() if "failed to" in line]


def _said(library: Any) -> str:
    return str(library.k2_said().decode("utf-8", "replace").strip())


class Images(NamedTuple):
    """Images of one moment as the library gives them: mirrored, of numbers that may be NaN or infinite."""

    ticks: int  # of 0.125 ms, 32 bits
    age_ns: int  # since they arrived
    depth: NDArray[np.float32]  # millimetres
    infrared: NDArray[np.float32]


class Camera:
    """A running depth camera.

    Attributes:
        lens: fx, fy, cx, cy, k1, k2, p1, p2, k3 that the sensor stores, of the mirrored image.
        warnings: What makes it lose frames.
    """

    def __init__(self, sensor: vendor.VendorSensor) -> None:
        """Opens and starts it.

        Raises:
            AbsentError: It is not connected.
            DeviceError: It cannot be opened or started.
        """
        self._library, self.serial = load_library(), sensor.name
        serial = self.serial
        with _one_at_a_time:
            there, faults = _found(self._library)
            if serial not in there:
                why = f"Another cannot be opened: {_why(faults[0])}" if faults else _CHECK
                raise vendor.absent("Kinect v2", serial, there, why)
            pipeline = _named_pipeline(self._library) or _pipeline(self._library)
            if serial in _opened:  # the library would give the same device once more
                raise DeviceError(f"Kinect v2 {serial} is already open in this program.")
            context = _context_of(self._library)
            self._handle = self._library.k2_open(context, serial.encode(), pipeline.encode())
            said = _said(self._library)
            if self._handle:
                _opened.add(serial)
        if not self._handle:
            raise DeviceError(f"Kinect v2 {serial} cannot be opened: {_why(said)}")
        values = (c_float * 9)()
        started = self._library.k2_start(self._handle, values)
        self.lens, said = tuple(values), _said(self._library)
        memory = _MEMORY if "NO_MEM" in said else ""
        self.warnings = [memory, _CPU if pipeline == "cpu" else ""]
        if not started:
            self.close()
            advice = f"{memory} " if memory else ""
            raise sensor.not_started(_first(said), "did not start its camera", advice)

    def take(self, timeout_ms: int) -> Images | None:
        """The oldest images that wait; None if none come."""
        depth, infrared = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.float32)
        ticks, age_ns = c_uint32(), c_int64()
        into = depth.ctypes.data, infrared.ctypes.data, ticks, age_ns
        if not self._library.k2_take(self._handle, timeout_ms, *into):
            return None
        return Images(ticks.value, age_ns.value, depth, infrared)

    def is_connected(self) -> bool:
        """Whether the library still lists it."""
        return self.serial in _found(self._library)[0]

    def close(self) -> None:
        """Stops and closes it, even if it is no longer connected."""
        with _one_at_a_time:
            self._library.k2_close(self._handle)
            _opened.discard(self.serial)


def _first(said: str) -> Exception:
    """The first logged error, without its place in the sources."""
    line = next(iter(said.splitlines()), "")
    return Exception(re.sub(r"^\[.*?\] |[. ]*Try debugging .*", "", line))


def _why(said: str) -> str:
    """Why a connected sensor does not open."""
    why = why_not_open(_first(said), usb_kinects(), PROGRAMS, "freenect2")
    return why + (_DRIVER if "NOT_SUPPORTED" in said or "NOT_FOUND" in said else "")


def connected_freenect2s() -> list[ConnectedSensor]:
    """The Kinects v2 on the buses.

    Raises:
        DeviceError: The library is not installed.
    """
    serials, faults = _found(load_library())
    found = [
        ConnectedSensor(*(k, serial, False, False), sdk="freenect2", description="Kinect v2", has_port=False)
        for k, serial in enumerate(serials)
    ]
    for index, said in enumerate(faults, len(serials)):
        fault = f"Kinect v2 at place {index} cannot be opened: {_why(said)}"
        found.append(ConnectedSensor(index, None, fault=fault, sdk="freenect2"))
    return found


def found() -> str:
    """Where libfreenect2 is, and what computes depth.

    Raises:
        DeviceError: It is not installed, or its binding cannot be compiled.
    """
    library = load_library()
    computes = _named_pipeline(library) or " or ".join(str(library.k2_pipelines().decode()).split())
    return f"{installed_prefix()}, depth by {computes}"


def library_check() -> Check:
    """Whether libfreenect2 is installed, and its binding can be compiled."""
    check = vendor.library_check("libfreenect2 (Kinect v2)", found)
    return replace(check, advice=_CPU) if check.detail.endswith("depth by cpu") else check
