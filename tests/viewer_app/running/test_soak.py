"""A few seconds of the soak (``python -m tests.experiments.soak --minutes 10`` runs all of it)."""

import os

import psutil
import pytest

from tests.experiments.soak import Soak, at_pace, soak


def test_no_pair_is_lost_and_no_queue_grows(tmp_path):
    if psutil.getloadavg()[0] > 2.0 * (os.cpu_count() or 1):
        pytest.skip("this machine is too busy to tell frames that we lose from frames that it loses")
    seen = soak(3.0, "none", tmp_path / "soak.rrd")
    figures = seen.pairing
    assert seen.dropped == (0, 0)
    assert (figures.alone_a, figures.alone_b, figures.unmatched_b, figures.late) == (0, 0, 0, 0)
    assert at_pace(seen)
    assert seen.waiting <= 8
    assert seen.saved_mb > 0.1
    assert figures.pairs == seen.frames


def test_growth_is_measured_from_the_end_of_the_first_minute():
    flat = Soak(memory=[(float(s), 100.0 + min(s, 60)) for s in range(300)])
    assert flat.growth_mb == pytest.approx(0.0)
    leaking = Soak(memory=[(float(s), 100.0 + 0.1 * s) for s in range(300)])
    # from the middle of the 15 s that are the base to the end
    assert leaking.growth_mb == pytest.approx(0.1 * (299 - 67))
