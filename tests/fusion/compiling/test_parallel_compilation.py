"""Tests of compilation on a first run."""

import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from fusion.compiling import kernels as first_run
from fusion.compiling.kernels import compiled_meanwhile
from fusion.solvers.tree_solver import compile_tree_solver, solve_tree

PYTHON = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
COLD = """
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.paper.method import prepare
from fusion.solvers.tree_solver import solve_tree
Fuser(FusionSetup(nominal_calibration(AZURE_KINECT), FuserSettings(method="paper"))).warm_up()
print(*(sum(counts.values()) for counts in (solve_tree.stats.cache_hits, solve_tree.stats.cache_misses)))
print(len(prepare.signatures))
"""


def test_another_process_compiles_the_solver_on_a_first_run(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd()), "NUMBA_CACHE_DIR": str(tmp_path)}
    cold = subprocess.run(
        [sys.executable, "-c", COLD], capture_output=True, text=True, env=environment, check=True
    )
    # the solver is found on disk; the other kernels compiled are those that the loop over frames calls
    assert cold.stdout.split() == ["1", "0", "1"]


def test_the_program_continues_if_no_process_starts(monkeypatch):
    monkeypatch.setattr(first_run, "_is_on_disk", lambda _: False)
    monkeypatch.setattr(sys, "executable", "/nonexistent")
    with compiled_meanwhile(solve_tree, "pass"):
        pass


def test_only_what_this_interpreter_compiled_counts(tmp_path):
    solver = Mock(__name__="solve_tree", stats=Mock(cache_path=tmp_path))
    (tmp_path / "tree_solver.solve_tree-163.py27.nbi").touch()
    (tmp_path / f"tree_solver.solve_tree-163.{PYTHON}x.nbi").touch()
    assert not first_run._is_on_disk(solver)
    (tmp_path / f"tree_solver.solve_tree-163.{PYTHON}.nbi").touch()
    assert first_run._is_on_disk(solver)


def test_a_later_run_starts_no_process(monkeypatch):
    compile_tree_solver()
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process"))
    with compiled_meanwhile(solve_tree, "pass"):
        pass
