"""Numbers that the paper names."""

PAPER_H = 0.786
"""Sec. 3: how much more a tracked joint counts than an inferred one."""
