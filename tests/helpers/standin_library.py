"""The stand-in for libk4a and libk4abt, compiled once a session and set from the tests."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers.machine import need_compiler

_SOURCE = Path(__file__).with_name("standin_k4abt.c")
_STATUSES = ("create_status", "enqueue_status", "pop_status", "calibration_status")
_SETTINGS = dict.fromkeys((*_STATUSES, "alive", "misuses", "processing", "orientation"), ctypes.c_int)
_SETTINGS |= dict.fromkeys(("bodies", "first_id"), ctypes.c_uint32)
_SETTINGS |= dict.fromkeys(("wait_ms", "tracking_ms"), ctypes.c_int32) | {"smoothing": ctypes.c_float}
_AT_START = {"bodies": 1, "first_id": 7, "smoothing": -1.0}


class Standin:
    """The compiled library; its settings are attributes."""

    def __init__(self, path):
        self.__dict__["path"] = path
        self.__dict__["library"] = ctypes.CDLL(str(path))

    def __getattr__(self, name):
        return _SETTINGS[name].in_dll(self.library, f"standin_{name}").value

    def __setattr__(self, name, value):
        _SETTINGS[name].in_dll(self.library, f"standin_{name}").value = value

    def reset(self):
        for name in _SETTINGS:
            setattr(self, name, _AT_START.get(name, 0))


@pytest.fixture(scope="session")
def compiled(tmp_path_factory):
    path = tmp_path_factory.mktemp("standin") / "libk4abt.so"
    command = [need_compiler(), "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(path), str(_SOURCE)]
    subprocess.run(command, check=True)
    return path


@pytest.fixture(scope="session")
def wheel_library(compiled, tmp_path_factory):
    """The stand-in loaded as libk4a from a wheel, whose libraries carry a hash in their names."""
    path = tmp_path_factory.mktemp("wheel.libs") / "libk4a-f64cb9eb.so.1.4.2"
    shutil.copyfile(compiled, path)
    ctypes.CDLL(str(path))
    return path


@pytest.fixture
def standin(compiled):
    """The stand-in in its initial state. After the test it must hold no live handle and no misuse."""
    library = Standin(compiled)
    library.reset()
    yield library
    assert library.misuses == 0
    assert library.alive == 0
