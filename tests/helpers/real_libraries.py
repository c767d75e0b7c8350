"""The real pyk4a and pyorbbecsdk2 in environments of their own, because their requirements clash with ours.

``python -m tests.helpers.real_libraries`` installs them under the user's cache folder, which takes minutes;
``.ci/run`` does it. Without them, the tests that compare the stand-ins with the real libraries are skipped.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from devices.cache import user_cache
from devices.freenect import libfreenect
from devices.freenect2 import library
from tests.helpers import pyk4a_contract
from tests.helpers.machine import lacks

_ROOT = Path(__file__).resolve().parents[2]
CACHE = user_cache("")


@dataclass(frozen=True)
class Library:
    """A vendor's library that pip installs from wheels.

    Attributes:
        package: What pip calls it, with its version.
        module: What Python calls it.
        options: Further arguments of ``pip install``.
        pythons: The CPython versions that it has wheels for, the preferred one first.
        inherits: Whether its environment also has the packages of this interpreter.
    """

    package: str
    module: str
    options: tuple[str, ...]
    pythons: tuple[str, ...]
    inherits: bool = False

    @property
    def folder(self):
        """Where its environment is, made or not."""
        return CACHE / f"real-{self.package.replace('==', '-')}-{sys.implementation.cache_tag}"

    @property
    def interpreter(self):
        """A Python that it has wheels for; None where there is none."""
        own = f"{sys.version_info.major}.{sys.version_info.minor}"
        if own in self.pythons:
            return sys.executable
        if self.inherits:
            return None
        return next(filter(None, (shutil.which(f"python{version}") for version in self.pythons)), None)

    def install(self):
        """Makes the environment, unless it is there already."""
        ready, python = self.folder / "ready", self.interpreter
        if ready.is_file() or python is None:
            return
        target = str(self.folder / "bin" / "python")
        commands = [
            [python, "-m", "venv", "--clear", str(self.folder)],
            [target, "-m", "pip", "install", "--only-binary=:all:", *self.options, self.package],
            [target, "-c", f"import {self.module}"],
        ]
        CACHE.mkdir(parents=True, exist_ok=True)
        for command in commands:
            # The output of pip is not shown: it may name a private package registry.
            subprocess.run(command, check=True, capture_output=True, timeout=600.0, env=self._environment())
        ready.touch()

    def run(self, *arguments):
        """Runs a program in the environment, and reads the JSON that it prints last.

        Skips the running test if the library is not installed, or cannot be.
        """
        if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
            pytest.skip(f"{self.package} is tried on Linux x86-64 only")
        if self.interpreter is None:
            pytest.skip(f"{self.package} has wheels for CPython {', '.join(self.pythons)} only")
        if not (self.folder / "ready").is_file():
            lacks(f"the real {self.package}", "run python -m tests.helpers.real_libraries")
        done = subprocess.run(
            [str(self.folder / "bin" / "python"), *arguments],
            capture_output=True,
            text=True,
            cwd=_ROOT,
            env=self._environment(),
            timeout=300.0,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.strip().splitlines()[-1])

    def _environment(self):
        environment = {**os.environ, "K4A_ENABLE_LOG_TO_STDOUT": "0"}
        environment.pop("PYTHONPATH", None)
        if self.inherits:
            environment["PYTHONPATH"] = os.pathsep.join((str(_ROOT), *filter(None, sys.path)))
        return environment


PYK4A = Library("pyk4a-bundle==1.5.0", "pyk4a", ("numpy<2",), ("3.11", "3.12", "3.10"))
ORBBEC = Library(
    "pyorbbecsdk2==2.1.2", "pyorbbecsdk", ("--no-deps",), ("3.11", "3.12", "3.13"), inherits=True
)


@pytest.fixture(scope="session")
def real_pyk4a(shared):
    """What the real pyk4a does with every clause of the contract."""
    return PYK4A.run(pyk4a_contract.__file__, str(shared / "azure" / "recording.mkv"))


@pytest.fixture(scope="session")
def real_orbbec():
    """What the real pyorbbecsdk2 does with every clause of the contract."""
    return ORBBEC.run("-m", "tests.helpers.orbbec.contract")


if __name__ == "__main__":
    for library in (PYK4A, ORBBEC):
        library.install()


@pytest.fixture
def no_libraries(monkeypatch):
    """A machine without any library of sensors."""
    for module in ("pyk4a", "pyorbbecsdk", "pyrealsense2"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(libfreenect, "find_library", lambda _: None)
    monkeypatch.setattr(library, "installed_prefix", lambda: None)
    for each in (libfreenect, library):
        monkeypatch.setattr(each, "load_library", each.load_library.__wrapped__)  # without its cache
