"""Trackers that no constant was fitted to: with larger errors, and with heavy-tailed errors."""

from dataclasses import fields, replace
from itertools import islice

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.benchmarks.harsher_errors import (
    LARGEST_SHARE,
    SHAPES,
    SHARES,
    SIZES,
    heavy_tailed,
    heavy_tails,
    scaled,
)

FITTED = TrackerErrors.of(AZURE_KINECT)


def test_every_knob_is_a_size_a_share_or_a_shape():
    knobs = [field.name for field in fields(TrackerErrors)]
    assert set(knobs) == SIZES | SHARES | SHAPES
    assert len(SIZES) + len(SHARES) + len(SHAPES) == len(knobs)


def test_sizes_and_shares_grow_and_shapes_stay():
    larger = scaled(FITTED, 1.5)
    assert larger.view_bias == pytest.approx(1.5 * FITTED.view_bias)
    assert larger.jitter["thumb"] == pytest.approx(1.5 * FITTED.jitter["thumb"])
    assert larger.unsure["hand"] == pytest.approx(1.5 * FITTED.unsure["hand"])
    assert larger.mirroring.back == pytest.approx(1.5 * FITTED.mirroring.back)
    assert replace(larger.mirroring, back=FITTED.mirroring.back) == FITTED.mirroring
    often = TrackerErrors.of(KINECT_V2)
    assert scaled(often, 1.5).mirroring == often.mirroring  # 97 % is more than LARGEST_SHARE: it stays
    assert larger.not_tracked == LARGEST_SHARE  # 1.5 times 65 % would be 98 %
    assert (larger.seen_share, larger.lost_seconds) == (FITTED.seen_share, FITTED.lost_seconds)


def distances(body):
    """(T, J) of 40,000 frames: over 1,300 independent sizes, so a 99th percentile is known to a third."""
    errors = islice(heavy_tails(body, 1 / 30, np.random.default_rng(5)), 40_000)
    return np.linalg.norm([*errors], axis=2)


# Ranges over three exercises of one Kinect v2 view against optical motion capture: median, 90 %, 99 %, mm.
# Widened by what chance makes of the 99th percentile.
PUBLISHED = {
    "SpineBase": ((13, 24), (30, 70), (51, 100)),
    "Head": ((12, 31), (33, 245), (69, 273)),
    "KneeLeft": ((5, 15), (16, 33), (21, 55)),
    "HandLeft": ((18, 38), (84, 775), (279, 1139)),
    "HandRight": ((18, 38), (84, 775), (279, 1139)),
}


def test_tails_are_as_heavy_as_measured():
    found = distances(KINECT_V2) * 1e3
    for joint, ranges in PUBLISHED.items():
        tails = np.percentile(found[:, KINECT_V2.joint(joint)], (50, 90, 99))
        assert all(low <= value <= high for value, (low, high) in zip(tails, ranges, strict=True)), (
            joint,
            tails,
        )


def test_tails_change_no_other_error():
    """A tracker with added errors reports what it reports without them, plus those errors."""

    def one_metre_left(body, frame_seconds, random):
        del frame_seconds, random
        while True:
            yield np.tile((1.0, 0.0, 0.0), (len(body), 1))

    quiet = replace(FITTED, rescale=0.0)
    plain, added = (
        [
            frame.people[PERSON]
            for frame in simulated_pair(motion="arms", seconds=1.0, seed=1, errors=errors)[0].frames()
        ]
        for errors in (quiet, replace(quiet, added=one_metre_left))
    )
    for before, after in zip(plain, added, strict=True):
        np.testing.assert_array_equal(before.states, after.states)
        np.testing.assert_allclose(after.positions, before.positions + (1.0, 0.0, 0.0), atol=1e-5)
    heavy, fitted = (
        next(iter(simulated_pair(seconds=0.1, errors=errors)[0].frames())).people[PERSON].positions
        for errors in (heavy_tailed(FITTED), FITTED)
    )
    assert not np.array_equal(heavy, fitted)
