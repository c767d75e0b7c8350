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

import numpy as np

from fusion.body import KINECT_V1
from fusion.compiling.kernels import find_on_disk
from fusion.solvers.tree_solver import TreeSolver, solve_tree


def compile_tree_solver(matrices: bool = False) -> None:
    """Compiles the solver by solving a problem with 3×3 or with scalar weights."""
    body = KINECT_V1
    solver = TreeSolver(body.parent_indices, body.order, body.rest)
    weights = np.tile(np.eye(3), (len(body), 1, 1)) if matrices else np.ones(len(body))
    solver.solve(np.zeros((len(body), 3)), weights, body.nominal_lengths)


@contextmanager
def tree_solver_compiled_meanwhile(needed_by: Any = None, matrices: bool = False) -> Iterator[None]:
    """Lets another process compile the solver, if it is not on disk; waits for it at the end.

    Args:
        needed_by: The kernel that will be called, if not the solver. If it is on disk, nothing is compiled.
        matrices: Whether the solver takes 3×3 weights.
    """
    process = None if _is_on_disk(needed_by) else _start(matrices)
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _is_on_disk(kernel: Any = None) -> bool:
    kernel = kernel or solve_tree
    find_on_disk(kernel)
    folder = Path(kernel.stats.cache_path)
    python = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    return any(folder.glob(f"*{kernel.__name__}-*.{python}.nbi"))


def _start(matrices: bool) -> subprocess.Popen[bytes] | None:
    """None where no process can be started; this process then compiles the solver later."""
    packages = str(Path(__file__).parents[2])
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    try:
        return subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-c",
                f"import {__name__} as first_run; first_run.compile_tree_solver({matrices})",
            ],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
