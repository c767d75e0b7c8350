"""The real pyorbbecsdk2, in a folder of its own that is made once and kept."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_PACKAGE = "pyorbbecsdk2==2.1.2"
_OPTIONS = ("--no-deps", "--only-binary=:all:")
_ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def real_orbbec() -> dict[str, dict[str, object]]:
    """What the real library does with every clause of the contract; skipped where it cannot be installed."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.helpers.orbbec.contract"],
        capture_output=True,
        text=True,
        cwd=_ROOT,
        env={**os.environ, "PYTHONPATH": f"{_folder()}{os.pathsep}{_ROOT}"},
        timeout=300.0,
    )
    assert done.returncode == 0, done.stderr
    results: dict[str, dict[str, object]] = json.loads(done.stdout.strip().splitlines()[-1])
    return results


def _folder() -> Path:
    """A folder for PYTHONPATH with the package alone: its requirements clash with this program's."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "duplex-kinects"
    folder = cache / f"pyorbbecsdk2-2.1.2-{sys.implementation.cache_tag}"
    ready = folder / "ready"
    if ready.is_file():
        return folder
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        pytest.skip("pyorbbecsdk2 2.1.2 has wheels for CPython 3.11 to 3.13 only")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The output of pip is not shown: it may name a private package registry.
        subprocess.run(
            [
                sys.executable,
                "-m",
                "pip",
                "install",
                "--no-deps",
                "--only-binary=:all:",
                "--target",
                str(folder),
                _PACKAGE,
            ],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=600.0,
        )
    except (OSError, subprocess.SubprocessError) as fault:
        shutil.rmtree(folder, ignore_errors=True)
        pytest.skip(f"{_PACKAGE} cannot be installed here ({type(fault).__name__})")
    ready.touch()
    return folder
