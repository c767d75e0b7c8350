"""Compilation on a first run with two processes, because numba uses one core.

Each process finds the other's kernels on disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fusion.compiling.kernels import find_on_disk


@contextmanager
def compiled_meanwhile(kernel: Any, statements: str) -> Iterator[None]:
    """Lets another process compile kernels; waits for it at the end.

    Args:
        kernel: The kernel that will be called. If it is on disk, nothing is compiled.
        statements: Python statements that compile what the other process is to compile.
    """
    process = None if _is_on_disk(kernel) else _start(statements)
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _is_on_disk(kernel: Any) -> bool:
    find_on_disk(kernel)
    folder = Path(kernel.stats.cache_path)
    python = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    return any(folder.glob(f"*{kernel.__name__}-*.{python}.nbi"))


def _start(statements: str) -> subprocess.Popen[bytes] | None:
    """None where no process can be started; this process then compiles everything itself."""
    packages = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", statements],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
