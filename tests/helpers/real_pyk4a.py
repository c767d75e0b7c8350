"""The real pyk4a with libk4a, in an environment of its own that is made once and kept."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import pyk4a_contract

_PACKAGES = ("pyk4a-bundle==1.5.0", "numpy<2")
_INTERPRETERS = ("python3.11", "python3.12", "python3.10")


@pytest.fixture(scope="session")
def real_pyk4a(shared: Path) -> dict[str, dict[str, object]]:
    """What the real library does with every clause of the contract; skipped where it cannot be installed."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        pytest.skip("pyk4a-bundle 1.5.0 is tried on Linux x86-64 only")
    environment = {**os.environ, "K4A_ENABLE_LOG_TO_STDOUT": "0"}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        [str(_interpreter()), pyk4a_contract.__file__, str(shared / "azure" / "recording.mkv")],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300.0,
    )
    assert done.returncode == 0, done.stderr
    results: dict[str, dict[str, object]] = json.loads(done.stdout)
    return results


def _interpreter() -> Path:
    """The environment's Python. It is made under the user's cache folder, where later runs find it."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "duplex-kinects"
    folder = cache / f"pyk4a-bundle-1.5.0-{sys.implementation.cache_tag}"
    python, ready = folder / "bin" / "python", folder / "ready"
    if ready.is_file():
        return python
    base = [sys.executable] if sys.version_info[:2] <= (3, 12) else []
    candidates = base or [found for name in _INTERPRETERS if (found := shutil.which(name))]
    if not candidates:
        pytest.skip("the wheels of pyk4a-bundle 1.5.0 need CPython 3.12 or older, and there is none")
    try:
        cache.mkdir(parents=True, exist_ok=True)
        _quietly([candidates[0], "-m", "venv", "--clear", str(folder)])
        _quietly([str(python), "-m", "pip", "install", "--only-binary=:all:", *_PACKAGES])
        _quietly([str(python), "-c", "import pyk4a"])
    except (OSError, subprocess.SubprocessError) as fault:
        shutil.rmtree(folder, ignore_errors=True)
        pytest.skip(f"pyk4a-bundle 1.5.0 with numpy < 2 cannot be installed here ({type(fault).__name__})")
    ready.touch()
    return python


def _quietly(command: list[str]) -> None:
    """Runs a command without showing its output, which may name a private package registry."""
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=600.0)
