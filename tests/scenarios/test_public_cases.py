"""Inputs that people who do this job reported, from ``../shared/cases``, with the right values."""

import numpy as np
import pytest

from recordings import fuse
from viewer_app.report.figures import report
from viewer_app.report.words import lead_lines


@pytest.fixture
def case(shared):
    """Finds both files of a case by its number."""

    def files(number):
        folders = sorted((shared / "cases").glob(f"{number:02}-*"))
        if not folders:
            pytest.skip(f"no case {number} in {shared / 'cases'}")
        return folders[0] / "a.csv", folders[0] / "b.csv"

    return files


def pace(session):
    """What the summary says of S*."""
    return next(line.text for line in lead_lines(report(session)) if line.label == "S*")


def test_case_1_a_gap_of_minutes_in_the_middle(case):
    session, expected = fuse(*case(1)), fuse(*case(1), offset_ms=0)
    np.testing.assert_array_equal(session.fused, expected.fused)
    assert len(session) == 52
    assert pace(session) == "52 frames in 601.7 s, 30.0 per second between pauses."
