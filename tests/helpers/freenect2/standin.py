"""Kinects v2 on the stand-in for libfreenect2, which is C++ like the real library, or on the real one."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from devices.freenect2 import library
from tests.helpers.freenect2.contract import DEPTH, INFRARED, Library
from tests.helpers.machine import lacks, need_compiler

_HERE = Path(__file__).parent
_installed = library.installed_prefix


@pytest.fixture(autouse=True)
def without_libfreenect2(monkeypatch):
    """Hides an installed libfreenect2 from tests that do not ask for it."""
    library.load_library.cache_clear()
    monkeypatch.setattr(library, "installed_prefix", lambda: None)


@pytest.fixture(scope="session")
def standin_prefix(tmp_path_factory):
    """The folder that the stand-in is installed into."""
    if not sys.platform.startswith("linux"):
        pytest.skip("the stand-in for libfreenect2 is compiled on Linux only")
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None or shutil.which("cmake") is None:
        lacks("a C++ compiler or CMake", "Debian: apt install g++ cmake")
    prefix = tmp_path_factory.mktemp("freenect2")
    headers = prefix / "include" / "libfreenect2"
    (prefix / "lib").mkdir()
    shutil.copytree(_HERE / "libfreenect2", headers)
    built = ["-o", str(prefix / "lib" / "libfreenect2.so"), str(_HERE / "standin.cpp")]
    flags = ["-std=c++11", "-shared", "-fPIC", "-O1", "-Wall", "-Werror", f"-I{headers.parent}"]
    subprocess.run([compiler, *flags, *built], check=True)
    return prefix


@pytest.fixture
def freenect2(standin_prefix, monkeypatch):
    """Two Kinects v2 in this process, which a test sets and whose frames it gives."""
    monkeypatch.setenv(library.PREFIX, str(standin_prefix))
    monkeypatch.setenv(library.PIPELINE, "gl")
    monkeypatch.setenv("DISPLAY", ":77")  # the stand-in for OpenGL wants one
    monkeypatch.setattr(library, "installed_prefix", _installed)
    monkeypatch.setattr(library, "user_cache", lambda name: standin_prefix / "cache" / name)
    standin = Library()
    yield standin
    assert standin.counts() == [0], "all sensors are closed"
    for name in ("gone", "forbidden", "busy", "replugged", "computing"):
        for kinect in (0, 1):
            standin.set(name, 0, kinect)
    standin.set("submissions", -1)
    library.load_library.cache_clear()


def give(standin, number, depth, infrared, kinect=0, **fields):
    """Gives both images of a packet; returns whether the sensor runs."""
    images = ((INFRARED, infrared), (DEPTH, depth))
    return [standin.give(kinect, kind, number, image, **fields) for kind, image in images] == [True, True]


@pytest.fixture(scope="session")
def real_freenect2(tmp_path_factory):
    """The real library's folder, and simulated USB for it."""
    prefix = _installed()
    if not sys.platform.startswith("linux") or prefix is None:
        lacks("the real libfreenect2", "build it as docs/installing.md says", required=False)
    usb = tmp_path_factory.mktemp("usb") / "usb.so"
    source = _HERE.with_name("simulated_usb_v2.c")
    flags = ["-shared", "-fPIC", "-O1", "-Wall", "-Werror"]
    subprocess.run([need_compiler(), *flags, "-o", str(usb), str(source), "-lm"], check=True)
    return prefix, usb


def run(prefix, cache, *arguments, usb=None):
    """Runs Python on a libfreenect2; returns what it prints."""
    environment = {**os.environ, library.PREFIX: str(prefix), library.PIPELINE: "cpu"}
    environment |= {"XDG_CACHE_HOME": str(cache)} | ({"LD_PRELOAD": str(usb)} if usb else {})
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        cwd=_HERE.parents[2],
        env=environment,
        timeout=120.0,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
