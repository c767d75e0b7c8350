"""What the summary of a live session says about its streams without ``--verbose``."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from devices.sensor import LinkFigures
from viewer_app.report.words import lead_lines
from viewer_app.running.runner import stream_figures

WELL = LinkFigures(received=900, round_trip_ns=2_000_000, clock_bound_ns=1_000_000)


def sensors(links=(None, None), **counts):
    """The counts of two sensors that run well but for what is given."""
    stream = {name: SimpleNamespace(dropped=0, lost=0, returns=0, received=900) for name in ("a", "b")}
    stream["b"].dropped = counts.pop("dropped_b", 0)
    stream["a"].lost = counts.pop("lost_a", 0)
    stream["a"].returns = counts.pop("returns_a", 0)
    figures = SimpleNamespace(pairs=900, alone_a=0, alone_b=0, unmatched_b=0, offset_ns=None, drift_ppm=0.0)
    figures.late = figures.repeated = figures.reordered = 9
    figures.resets = counts.pop("resets", 0)
    assert not counts
    return SimpleNamespace(**stream, figures=figures, links=links)


def trouble(sensors):
    return list(lead_lines(stream_figures(sensors)))


def test_streams_that_run_well_are_not_mentioned():
    """Late, repeated and reordered frames are put right; they come with --verbose."""
    assert trouble(sensors()) == []
    assert trouble(sensors((WELL, WELL))) == []


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({"dropped_b": 4}, "frames of B dropped (too slow) 4."),
        ({"lost_a": 5}, "frames of A lost on USB 5."),
        ({"returns_a": 2, "resets": 1}, "reconnects of A 2, clocks reset 1."),
    ],
)
def test_what_is_lost_is_a_warning(counts, words):
    (line,) = trouble(sensors(**counts))
    assert (line.label, line.text, line.warning) == ("Streams", words, True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lost": 3}, "B: frames arrived: 900, lost 3; round trip 2.0 ms"),
        ({"malformed": 1}, "B: frames arrived: 900, damaged messages 1"),
        ({"restarts": 1}, "B: frames arrived: 900, restarts 1"),
        ({"clock_bound_ns": None}, "the clocks of the two PCs could not be related"),
    ],
)
def test_a_link_that_loses_something_is_a_warning(change, words):
    (line,) = trouble(sensors((WELL, replace(WELL, **change))))
    assert line.label == "Network"
    assert words in line.text
    assert line.warning
