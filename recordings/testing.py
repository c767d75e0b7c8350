"""Comparison of sessions in tests, also in users' own: ``examples/test_fusion.py`` shows it."""

from pathlib import Path

import numpy as np

from recordings.session import Session

_CAPTURED = {
    "time_ns": "the time since the first pair",
    "skew_ns": "the skew between A and B",
    "clock_a": "the time of A",
    "clock_b": "the time of B",
    "positions_a": "S_A",
    "positions_b": "S_B",
    "states_a": "a tracking state of S_A",
    "states_b": "a tracking state of S_B",
}
"""Data shared by two fusions of one capture, by name in :class:`recordings.session_arrays.SessionArrays`."""


def assert_sessions_match(
    actual: Session | str | Path, expected: Session | str | Path, *, position_mm: float
) -> None:
    """Fails if two sessions are of different captures or S* differs; names the frame and the joint.

    Two sessions are of the same capture if their frames have equal times and bit-identical S_A and S_B.

    Args:
        actual, expected: Sessions or their files.
        position_mm: Tolerance for the distance of a joint of S*; 0 requires bit-identical values.

    Raises:
        AssertionError: The body, the number of frames, the times, S_A or S_B differ; S* is missing in one
            session; or a joint exceeds the tolerance.
        ValueError: `position_mm` is negative or not a number.
    """
    if not 0.0 <= position_mm < np.inf:
        raise ValueError(f"position_mm is {position_mm}; it must be 0 or more millimetres")
    one, two = (s if isinstance(s, Session) else Session.open(s) for s in (actual, expected))
    assert one.body is two.body, f"{one} is of {one.body.name}, {two} of {two.body.name}"
    assert len(one) == len(two), f"{one} has {len(one)} frames, {two} has {len(two)}"
    for session in (one, two):
        assert session.damage is None, f"{session}: {session.damage}"
    for name, what in _CAPTURED.items():
        got, wanted = getattr(one.rows, name), getattr(two.rows, name)
        for t, *_ in np.argwhere((got != wanted) & ~((got != got) & (wanted != wanted)))[:1]:
            raise AssertionError(f"frame {t}: {what} differs; the sessions are of different captures")
    for t in np.flatnonzero((np.isnan(one.rows.fused) != np.isnan(two.rows.fused)).any(axis=(1, 2)))[:1]:
        raise AssertionError(f"frame {t}: only one of the sessions has an S*")
    if position_mm == 0.0:
        for t in np.flatnonzero(one.fused_checksums != two.fused_checksums)[:1]:
            raise AssertionError(f"frame {t}: S* differs")
    apart = np.linalg.norm(one.rows.fused - two.rows.fused, axis=2) * 1e3
    far = np.argwhere(apart > position_mm)
    if len(far):
        t, j = far[0]
        worst = np.unravel_index(np.nanargmax(apart), apart.shape)
        raise AssertionError(
            f"S* differs by more than {position_mm:g} mm at {len(far)} joints, first at frame {t}, "
            f"{one.body.joints[j]}: {apart[t, j]:.3g} mm; most at frame {worst[0]}, "
            f"{one.body.joints[worst[1]]}: {apart[worst]:.3g} mm"
        )
