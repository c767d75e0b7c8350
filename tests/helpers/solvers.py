"""The solver kernels for one frame, with a result that names its figures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.compiling.references import by_reference
from fusion.solvers.published import solve_published
from fusion.solvers.tree_solver import solve_tree
from fusion.solvers.tree_start import TreeWorkspace
from fusion.support.array_fields import new_arrays


@dataclass(frozen=True, eq=False)
class Solution:
    """S* of one frame; see :func:`fusion.solvers.tree_solver.solve_tree` for its figures."""

    positions: NDArray[np.float64]
    iterations: int
    objective: float
    converged: bool
    systems: int


def _floats(values):
    return np.array(values, dtype=np.float64, order="C")  # of one type, whoever may write it


class TreeSolver:
    """:func:`solve_tree` for one tree; keeps the workspace between frames."""

    def __init__(self, parents, order, rest):
        self.parents, self.order = (np.array(each, dtype=np.int64) for each in (parents, order))
        self.rest, self._work = _floats(rest), by_reference(new_arrays(TreeWorkspace, J=len(self.parents)))

    def solve(self, targets, weights, bone_lengths, start=None):
        """Solves one frame."""
        m, W, lengths = _floats(targets), _floats(weights), _floats(bone_lengths)
        near = np.full(m.shape, np.nan) if start is None else _floats(start)
        positions = np.empty(m.shape)
        iterations, systems, objective, converged = solve_tree(
            self.parents, self.order, self.rest, m, W, lengths, near, self._work, positions
        )
        return Solution(positions, iterations, objective, converged, systems)


class PaperSolver:
    """:func:`solve_published` for one tree of joints, from the targets where no start is given."""

    def __init__(self, parents, line_search=True):
        self.parents, self.line_search = np.array(parents, dtype=np.int64), line_search

    def solve(self, targets, weights, bone_lengths, start=None):
        """Solves one frame."""
        m = _floats(targets)
        w = np.where(np.isfinite(m).all(axis=1), _floats(weights), 0.0)
        at = np.array(m if start is None else start, dtype=np.float64)
        iterations, objective, converged = solve_published(
            self.parents, m, w, _floats(bone_lengths), self.line_search, at, np.empty((2, *m.shape))
        )
        return Solution(at, iterations, objective, converged, iterations)
