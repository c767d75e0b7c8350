"""Sessions as live ones are: uneven times, moments a nanosecond apart, gaps without S*."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st


def uneven(session, draw):
    """The first frames of a session at other times, with gaps; the first one has an S*."""
    steps = draw(st.lists(st.sampled_from([8_000_000, 33_333_333, 111_000_000]), min_size=8, max_size=40))
    steps[draw(st.integers(0, len(steps) - 1))] = 1
    times = np.cumsum([0, *steps])
    rows = session.rows[: len(times)]
    gone = np.zeros(len(times), dtype=bool)
    for begin, count in draw(st.lists(st.tuples(st.integers(0, 39), st.integers(1, 15)), max_size=3)):
        gone[begin : begin + count] = True
    gone[0] = False
    fused = np.where(gone[:, None, None], np.nan, rows.fused)
    return replace(session, rows=replace(rows, time_ns=times, fused=fused))
