"""The closest joints with exactly these bone lengths, eq. (1), one constraint per bone.

    minimise    f(x) = Σ w_i ‖x_i − m_i‖²      over joints i
    subject to  ‖x_i − x_p(i)‖ = l_i           for the bone from each joint i to its parent p(i)

With m_i the weighted mean of p_i and R q_i + t, and w_i = w_i^A + w_i^B, f is eq. (1)'s objective up to a
constant. Eq. (1) adds all bones into one scalar constraint, which does not enforce them (``docs/method.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_ITERATIONS = 50
"""Of any solver, sec. 2."""


@dataclass(frozen=True, eq=False)
class Solution:
    """S* of one frame.

    Attributes:
        positions: (J, 3) metres, in the frame of the targets.
        iterations: Steps to a better point, from the start that led to the solution.
        objective: Σ (x - m)ᵀ W (x - m) there, in m² times the unit of the weights.
        converged: Whether the solver's own criterion was met before the iterations ran out.
        systems: Linear systems solved, including line searches and abandoned starts.
    """

    positions: NDArray[np.float64]
    iterations: int
    objective: float
    converged: bool
    systems: int
