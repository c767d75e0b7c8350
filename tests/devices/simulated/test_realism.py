"""The simulated trackers err as real ones do, by figures that need no ground truth."""

from __future__ import annotations

import csv
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2, Body
from fusion.joint_kinds import KINDS
from fusion.skeleton import Skeleton, TrackingState
from tests.helpers.pair_statistics import PairStatistics, statistics

SHARED = Path(os.environ.get("DUPLEX_SHARED", Path(__file__).parents[4] / "shared"))
TUNING_SEEDS = range(1000, 1020)
"""The seeds to which the defaults of TrackerErrors were fitted. No accuracy is reported on these seeds."""


@dataclass(frozen=True)
class Setting:
    """The movement and the set-up of a simulated recording that corresponds to a real one.

    ``standing`` is the share of the time in which the person stands between the sensors and faces them. On
    seven real walks the trunk is slower than 0.2 m/s in 30 to 48 % of the frames (mean 41 %).
    """

    motion: str
    body: Body
    angle_deg: float
    seconds: float
    standing: float = 0.0


REAL = {
    "kinect_v2_90deg_stationary": Setting("still", KINECT_V2, 90.0, 8.0),
    "kinect_v2_90deg_steps": Setting("steps", KINECT_V2, 90.0, 24.0),
    "kinect_v2_90deg_walk": Setting("walk", KINECT_V2, 90.0, 30.0, standing=0.4),
}
AZURE_SQUAT = Setting("squat", AZURE_KINECT, 45.0, 24.0)
PUBLISHED_SQUATS = {
    "view_median": (0.025, 0.025),
    "view_rms": (0.048, 0.048),
    "bone_deviation": (0.006, 0.027),
    "bone_deviation_share": (0.025, 0.065),
    "inferred": (0.025, 0.025),
    "not_tracked": (0.05, 0.05),
    "hands_unsure": (0.13, 0.77),
    "feet_unsure": (0.15, 0.15),
    "tracked_change": (0.008, 0.015),
    "tracked_change_p99": (0.057, 0.204),
    "inferred_change": (0.018, 0.049),
    "inferred_change_p99": (0.155, 0.817),
    "stale": (0.03, 0.10),
}
"""Ranges over 87 trials of squats before two Azure Kinects, 38 to 54 degrees apart; metres and shares."""
UNTOLD = {"inferred", "not_tracked", "hands_unsure", "feet_unsure", "inferred_change", "inferred_change_p99"}
"""What the real recordings do not tell: their source kept no tracking states."""
LARGEST_IF_NONE = {"swapped": 0.01, "stale": 0.01}
"""Largest simulated share where the real recording has none."""
NONE = TrackerErrors()
SYNCHRONOUS = Rig(skew_seconds=0.0)


def views(
    motion: str, errors: TrackerErrors, seconds: float = 8.0, seed: int = 0
) -> tuple[list[Skeleton], list[Skeleton]]:
    a, b, _ = simulated_pair(
        motion=motion, seconds=seconds, seed=seed, body=KINECT_V2, rig=SYNCHRONOUS, errors=errors
    )
    one, other = ([f.people[PERSON] for f in sensor.frames()] for sensor in (a, b))
    return one, other


def read_csv(path: Path) -> list[Skeleton]:
    frames: dict[int, np.ndarray] = {}
    with path.open() as file:
        for row in csv.DictReader(file):
            positions = frames.setdefault(int(row["time_us"]), np.full((len(KINECT_V2), 3), np.nan))
            positions[KINECT_V2.joint(row["joint"])] = [float(row[axis]) for axis in "xyz"]
    return [Skeleton.of(KINECT_V2, positions, time_ns=1000 * time) for time, positions in frames.items()]


def test_white_jitter_is_found_with_its_size() -> None:
    size = 0.005
    jitter = dict.fromkeys(KINDS, size)
    found = statistics(*views("still", replace(NONE, jitter=jitter, jitter_memory=0.0), 20.0))
    # Against a mean over 5 frames a white sample keeps 1 − 1/5 of its variance, in 3 coordinates.
    expected = size * np.sqrt(3 * 0.8)
    for kind, value in found.jitter.items():
        assert value == pytest.approx(expected, rel=0.1), kind  # median of some 20 windows of 30 frames
    # Two views of independent noise, 3 coordinates each.
    assert found.view_rms == pytest.approx(size * np.sqrt(6), rel=0.03)
    # x₂ − 2 x₁ + x₀ has 6 times the variance; the median of a 3-D Gaussian's length is 1.538 σ.
    assert found.tracked_change == pytest.approx(size * np.sqrt(6) * 1.538, rel=0.03)


def test_a_common_scale_is_found_as_the_bones_deviation() -> None:
    found = statistics(*views("startup", replace(NONE, rescale=0.03, rescale_seconds=0.1), 30.0))
    assert found.bone_deviation_share == pytest.approx(0.03, rel=0.25)


def test_states_stale_frames_and_swaps_are_counted() -> None:
    a, b = views("still", NONE)
    perfect = statistics(a, b)
    assert max(perfect.view_rms, perfect.bone_deviation) < 1e-6  # float32 positions of some 3 m
    assert perfect.swapped == perfect.stale == perfect.inferred == 0.0
    states = np.full(25, TrackingState.TRACKED)
    states[[KINECT_V2.joint("ThumbLeft"), KINECT_V2.joint("FootRight")]] = TrackingState.INFERRED
    a = [Skeleton.of(KINECT_V2, s.positions, states, s.time_ns) for s in a]
    for k in (50, 51, 52, 100):  # swapped in one view: runs of 3 and 1
        a[k] = Skeleton.of(KINECT_V2, a[k].positions[KINECT_V2.mirror], states, a[k].time_ns)
    for k in (10, 20, 30):  # the same again
        b[k] = replace(b[k - 1], time_ns=b[k].time_ns)
    found = statistics(a, b)
    assert found.inferred == pytest.approx(2 / 25 / 2)
    assert found.hands_unsure == pytest.approx(1 / 6 / 2)  # hands, tips and thumbs: six
    assert found.feet_unsure == pytest.approx(1 / 2 / 2)
    assert found.swapped == pytest.approx(4 / 240)
    assert found.swap_frames == pytest.approx(2.0)
    assert found.stale == pytest.approx(3 / 239 / 2)
    assert np.isfinite(found.inferred_change)


def test_lost_frames_are_left_out() -> None:
    a, b = views("still", NONE)
    holed = [None if 30 < k < 60 else s for k, s in enumerate(a)]
    assert statistics(holed, b).view_rms == pytest.approx(statistics(a, b).view_rms, abs=1e-6)


def simulated_statistics(setting: Setting, seeds: range) -> dict[str, float]:
    """The statistics of a simulated setting without its start-up pose, each the median over the seeds."""
    found = []
    for seed in seeds:
        both: list[list[Skeleton | None]] = [[], []]
        for motion, share in ((setting.motion, 1.0 - setting.standing), ("idle", setting.standing)):
            if share > 0.0:
                a, b, truth = simulated_pair(
                    motion=motion, body=setting.body, angle_deg=setting.angle_deg,
                    seconds=share * setting.seconds, seed=seed,
                )  # fmt: skip
                skip = int(np.ceil(getattr(truth.scene.motion, "begins", 0.0) / truth.rig.frame_seconds))
                for view, sensor in zip(both, (a, b), strict=True):
                    view += [frame.people.get(PERSON) for frame in sensor.frames()][skip:]
        found.append(flat(statistics(*both)))
    return {name: float(np.nanmedian([one.get(name, np.nan) for one in found])) for name in found[0]}


def flat(found: PairStatistics) -> dict[str, float]:
    values = asdict(found)
    jitter = values.pop("jitter")
    known = values | {f"jitter_{kind}": value for kind, value in jitter.items()}
    return {name: value for name, value in known.items() if np.isfinite(value)}


def far_off(simulated: dict[str, float], ranges: dict[str, tuple[float, float]]) -> list[str]:
    """The figures that differ from the nearer end of the real range by more than a factor of two.

    The aim is 1.5 over all tuning seeds; a few of them scatter about it.
    """
    return [
        f"{name}: {simulated[name]:.4g}, not {low:.4g} to {high:.4g}"
        for name, (low, high) in ranges.items()
        if not (low / 2.0 <= simulated[name] <= (2.0 * high or LARGEST_IF_NONE[name]))
    ]


@pytest.mark.parametrize("recording", REAL)
def test_the_simulated_pair_errs_like_the_real_one(recording: str) -> None:
    folder = SHARED / "real" / recording
    if not folder.exists():
        pytest.skip(f"no real recording at {folder}: set DUPLEX_SHARED")
    setting = REAL[recording]
    real = flat(statistics(read_csv(folder / "a.csv"), read_csv(folder / "b.csv")))
    simulated = simulated_statistics(setting, TUNING_SEEDS[:4])
    # Jitter measures noise only while the person stands still.
    compared = {
        name: (value, value)
        for name, value in real.items()
        if name not in UNTOLD and (setting.motion == "still" or not name.startswith("jitter"))
    }
    assert len(compared) >= 8
    assert not far_off(simulated, compared)


def test_the_simulated_azure_pair_errs_like_the_published_ones() -> None:
    assert not far_off(simulated_statistics(AZURE_SQUAT, TUNING_SEEDS[:3]), PUBLISHED_SQUATS)
