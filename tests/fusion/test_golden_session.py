"""S* of the method ``duplex``: the golden session to the bit within one revision, and summaries of scenes."""

import numpy as np
import pytest

from fusion.setup import REVISIONS
from tests.helpers import golden_session, golden_summaries
from tests.helpers.recorded_pairs import REAL

MADE_ANEW = "raise the revision and run python -m tests.helpers.golden_session"


@pytest.fixture(scope="module")
def runs():
    stored = golden_session.load()
    return golden_session.expected_runs(stored), golden_session.runs_of(stored)


def test_the_golden_session_is_of_this_revision():
    assert int(golden_session.load()["revision"]) == REVISIONS["duplex"], MADE_ANEW


@pytest.mark.parametrize("name", ["live", "whole"])
def test_the_golden_session_has_its_figures_on_any_machine(runs, name):
    """Another C library rounds exp, log and sine otherwise by a unit in the last place, 1e-16 of the value.

    The filter forgets, so that such differences add up over a second at most: less than 1e-12. (Without the C
    library's FMA, by GLIBC_TUNABLES, the digest differs and every float32 is the same.) What is stored are
    float32 of up to 8: half a unit is 2.4e-7.
    """
    expected, found = (run[name].figures for run in runs)
    for figure, values in expected.items():
        np.testing.assert_allclose(
            found[figure], values, rtol=0.0, atol=1e-6, err_msg=f"{figure}: {MADE_ANEW}"
        )


@pytest.mark.skipif(
    not golden_session.c_library_rounds_likewise(),
    reason="the digests are of Linux on x86-64 processors with FMA",
)
@pytest.mark.parametrize("name", ["live", "whole"])
def test_the_golden_session_is_the_same_to_the_bit(runs, name):
    expected, found = runs
    assert found[name].digest == expected[name].digest, MADE_ANEW


def test_the_golden_session_contains_what_it_is_there_for(runs):
    stored = golden_session.load()
    assert np.diff(stored["time_ns"]).max() > 2e9, "a gap"
    assert (stored["skew_ns"] > 10e6).all()
    for side in ("a", "b"):
        assert set(runs[1]["live"].figures[f"exchanged_{side}"]) == {0.0, 3.0}
    assert golden_session.FILE.stat().st_size < 200_000


def changed(name, figures):
    """What a failure says: each figure that has changed, the old one and the new one."""
    return "\n".join(golden_summaries.differences(figures, golden_summaries.expected()[name]))


@pytest.mark.parametrize("name", golden_summaries.SCENES)
def test_a_simulated_scene_has_its_summary(name):
    assert changed(name, golden_summaries.of_scene(golden_summaries.SCENES[name])) == ""


@pytest.mark.parametrize("name", REAL)
def test_a_real_pair_has_its_summary(name, shared):
    assert changed(f"real {name}", golden_summaries.of_real(name, shared / "real")) == ""
