"""Comparison of sessions in tests, also in users' own: ``examples/test_fusion.py`` shows it."""

from pathlib import Path

import numpy as np

from recordings.errors import RecordingError
from recordings.session import Session
from recordings.session_comparison import Comparison


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
    for session in (one, two):
        assert session.damage is None, f"{session}: {session.damage}"
    try:
        common = Comparison.of(one, two)
    except RecordingError as error:
        raise AssertionError(str(error)) from None
    assert len(one) == len(two) == len(common), f"{one} has {len(one)} frames, {two} has {len(two)}"
    for t in np.flatnonzero((np.isnan(one.rows.fused) != np.isnan(two.rows.fused)).any(axis=(1, 2)))[:1]:
        raise AssertionError(f"frame {t}: only one of the sessions has an S*")
    if position_mm == 0.0:
        for t in np.flatnonzero(one.fused_checksums != two.fused_checksums)[:1]:
            raise AssertionError(f"frame {t}: S* differs")
    apart = common.apart * 1e3
    far = np.argwhere(apart > position_mm)
    if len(far):
        t, j = far[0]
        worst = np.unravel_index(np.nanargmax(apart), apart.shape)
        raise AssertionError(
            f"S* differs by more than {position_mm:g} mm at {len(far)} joints, first at frame {t}, "
            f"{one.body.joints[j]}: {apart[t, j]:.3g} mm; most at frame {worst[0]}, "
            f"{one.body.joints[worst[1]]}: {apart[worst]:.3g} mm"
        )
