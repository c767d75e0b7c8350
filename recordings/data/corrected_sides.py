"""Whether S* corrects a view that reports left and right exchanged."""

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body

Floats = NDArray[np.floating]


def corrects_sides(
    body: Body, fused: Floats, view: Floats, states: NDArray[np.uint8], codes: NDArray[np.int8]
) -> NDArray[np.bool_]:
    """(T,) whether S* is nearer to a view with left and right exchanged than to the view as reported.

    A label says what the filter believes about the view. S* may follow the other view all the same.

    Args:
        fused: (T, J, 3) S*, metres; NaN where there is none.
        view: (T, J, 3) the view as reported, in the same frame.
        states: (T, J) its tracking states; joints of state 0 do not count.
        codes: (T,) exchange codes; False where 0.
    """
    found: NDArray[np.bool_] = np.asarray(codes) != 0
    if found.any():
        x, y = view[found], fused[found]
        there = (states[found] != 0) & body.sided
        own, other = (np.linalg.norm(y - each, axis=2) for each in (x, x[:, body.mirror]))
        both = there & there[:, body.mirror] & np.isfinite(own) & np.isfinite(other)
        found[found] = np.sum(np.where(both, other - own, 0.0), axis=1) < 0.0
    return found
