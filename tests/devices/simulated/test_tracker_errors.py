"""Each parameter of the simulated tracker changes the figure that it is meant to change."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.mirroring import Mirroring
from devices.simulated.tracking.tracker_errors import JointGroups, TrackerErrors
from fusion.body import KINECT_V2
from tests.helpers.pair_statistics import run_lengths, statistics

NONE = TrackerErrors.none()
EVEN = JointGroups(**dict.fromkeys(JointGroups.__dataclass_fields__, 0.003))
HIDING = replace(NONE, seen_share=0.35)

# (what else must be on, the knob, from, to, the figure, how many times larger it becomes at least or at most)
#
# Where the figure is in the knob's own unit it becomes larger as the knob does: 2 for a factor of 4 leaves
# room for chance in 12 s. Where the figure holds more than this error, 1.2 is more than chance: all else is
# drawn alike, as every frame draws the same number of values.
TABLE: list[tuple[TrackerErrors, str, Any, Any, str, float]] = [
    (NONE, "view_bias", 0.005, 0.02, "view_rms", 2.0),
    (NONE, "skin", 0.1, 0.4, "view_rms", 2.0),
    (NONE, "seen_share", 0.05, 0.5, "inferred", 1.2),
    (NONE, "unsure", JointGroups(hand=0.05), JointGroups(hand=0.2), "hands_unsure", 2.0),
    (HIDING, "inferred_error", 0.02, 0.08, "view_rms", 2.0),
    (replace(HIDING, jitter=EVEN), "inferred_jitter", 1.0, 4.0, "inferred_change", 1.2),
    (HIDING, "not_tracked", 0.2, 0.8, "not_tracked", 2.0),
    (HIDING, "mistracked", 0.2, 0.8, "inferred", 1 / 2.0),
    (replace(HIDING, mistracked=1.0), "snap", 0.2, 0.8, "view_rms", 2.0),
    (replace(NONE, view_bias=0.02), "stretch", 1.0, 0.1, "bone_deviation", 1 / 2.0),
    (replace(NONE, outlier_size=0.2), "outliers", 0.002, 0.02, "tracked_change_p99", 1.2),
    (replace(NONE, outliers=0.02), "outlier_size", 0.05, 0.2, "tracked_change_p99", 2.0),
    (NONE, "rescale", 0.01, 0.04, "bone_deviation_share", 2.0),
    (replace(NONE, rescale=0.04), "rescale_seconds", 0.1, 2.0, "tracked_change", 1 / 1.2),
    (NONE, "jitter", JointGroups(hand=0.002), JointGroups(hand=0.008), "jitter hand", 1.2),
    (NONE, "moving_jitter", 0.005, 0.02, "tracked_change", 1.2),
    (replace(NONE, jitter=EVEN), "jitter_memory", 0.0, 0.9, "tracked_change", 1 / 1.2),
    (NONE, "mirroring", Mirroring(back=0.1), Mirroring(back=0.9), "swapped", 1.2),
    (NONE, "stale", 0.05, 0.2, "stale", 2.0),
    (NONE, "lost", 0.03, 0.2, "lost", 1.2),
    (replace(NONE, lost=0.2), "lost_seconds", 0.1, 1.0, "lost frames", 2.0),
]


@cache
def figures_of(errors: TrackerErrors) -> dict[str, float]:
    """By name, of 12 s of walking before two sensors at the same time."""
    a, b, _ = simulated_pair(
        motion="walk", seconds=12.0, body=KINECT_V2, rig=Rig(skew_seconds=0.0), errors=errors
    )
    views = [[frame.people.get(PERSON) for frame in sensor.frames()] for sensor in (a, b)]
    lost = [np.array([skeleton is None for skeleton in view]) for view in views]
    runs = [length for view in lost for length in run_lengths(view)]
    found = asdict(statistics(*views))
    found |= {f"jitter {kind}": value for kind, value in found.pop("jitter").items()}
    found |= {"lost": float(np.mean(lost)), "lost frames": float(np.mean(runs)) if runs else 0.0}
    return found


@pytest.mark.parametrize(
    ("others", "knob", "low", "high", "figure", "times"), TABLE, ids=[r[1] for r in TABLE]
)
def test_the_knobs_own_figure_follows_it(
    others: TrackerErrors, knob: str, low: object, high: object, figure: str, times: float
) -> None:
    before, after = (figures_of(replace(others, **{knob: value}))[figure] for value in (low, high))
    if times > 1.0:
        assert after > times * before > 0.0
    else:
        assert 0.0 < after < times * before


def test_no_knob_is_left_out() -> None:
    assert {row[1] for row in TABLE} == set(TrackerErrors.knobs()) - {"added"}
