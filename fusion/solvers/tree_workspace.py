"""The tree solver's workspace: one named array per quantity, one row per joint.

Symmetric 3×3 matrices are six numbers: xx, xy, xz, yy, yz, zz. A basis T (3, 2) is its two columns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class TreeWorkspace(NamedTuple):
    """Arrays that :func:`fusion.solvers.tree_solver.solve_tree` overwrites; W is in units of the weights."""

    lengths: Array  # (J,) l_i, metres
    targets: Array  # (J, 3) m_i, metres
    information: Array  # (J, 6) W_i
    aims: Array  # (J, 3) point that the bone of joint i is aimed at when a start is placed, metres
    aim_counts: Array  # (J,) number of points that are averaged in it; 0 where there is none
    aim_reaches: Array  # (J,) sum of the squares of the bones between joint i and that point, m²
    positions: Array  # (J, 3) x_i, metres
    bones: Array  # (J, 3) e_i = x_i - x_parent, metres
    gradients: Array  # (J, 3) g_i = 2 W_i (x_i - m_i)
    forces: Array  # (J, 3) F_i: the gradient summed over the subtree
    scales: Array  # (J,) trace of twice the subtree's information
    multipliers: Array  # (J,) λ_i
    reduced: Array  # (J, 6) A_i: twice the information of the subtree, its steps eliminated
    reduced_forces: Array  # (J, 3) b_i: the subtree's force, its steps eliminated
    basis: Array  # (J, 6) T_i
    reduced_basis: Array  # (J, 6) A_i T_i
    pivots: Array  # (J, 3) M_i⁻¹: xx, xy, yy
    pivot_forces: Array  # (J, 2) T_iᵀ b_i
    steps: Array  # (J, 2) s_i: the step of bone i along T_i, metres
    moves: Array  # (J, 3) d_i: the step of joint i, metres
    trial: Array  # (J, 3) x_i after the step, metres
    best: Array  # (J, 3) the last good point while steps may climb, metres
    best_multipliers: Array  # (J,) its λ_i


def new_tree_workspace(joints: int) -> TreeWorkspace:
    """The workspace for a tree of joints."""
    six = ("information", "reduced", "basis", "reduced_basis")
    one = ("lengths", "aim_counts", "aim_reaches", "scales", "multipliers", "best_multipliers")
    columns = dict.fromkeys(TreeWorkspace._fields, 3) | dict.fromkeys(six, 6)
    columns |= {"pivot_forces": 2, "steps": 2}
    return TreeWorkspace(
        **{name: np.zeros(joints if name in one else (joints, n)) for name, n in columns.items()}
    )
