"""Numbers that the paper names."""

PAPER_H = 0.786
"""h of sec. 3: weight of a tracked joint relative to an inferred one."""
