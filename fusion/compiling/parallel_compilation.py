"""The first run on a machine, which compiles: two processes at once, since numba uses one core.

What one compiles, the other finds on disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fusion.body import KINECT_V1
from fusion.compiling.kernels import find_on_disk
from fusion.solvers.tree_solver import TreeSolver, solve_tree


def compile_tree_solver() -> None:
    """Compiles the solver, by solving something."""
    body = KINECT_V1
    solver = TreeSolver(body.parent_indices, body.order, body.rest)
    solver.solve(np.zeros((len(body), 3)), np.ones(len(body)), body.nominal_lengths)


@contextmanager
def tree_solver_compiled_meanwhile() -> Iterator[None]:
    """Lets another process compile the solver, if it is not on disk; waits for it at the end."""
    process = None if _is_on_disk() else _start()
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _is_on_disk() -> bool:
    find_on_disk(solve_tree)
    folder = Path(solve_tree.stats.cache_path)  # type: ignore[attr-defined]
    python = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    return any(folder.glob(f"*{solve_tree.__name__}-*.{python}.nbi"))


def _start() -> subprocess.Popen[bytes] | None:
    """None where no process can be started; then it is compiled here, later."""
    packages = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", f"import {__name__} as first_run; first_run.compile_tree_solver()"],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
