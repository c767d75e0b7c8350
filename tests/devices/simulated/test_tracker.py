"""Faults of a simulated tracker at given times."""

import csv
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, Scene, SimulatedKinect, movement, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.scripted_faults import ScriptedFaults, Spells
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, BODIES, KINECT_V2, Body
from fusion.skeleton import Skeleton, TrackingState
from tests.helpers.labelled_views import heading
from tests.helpers.pair_statistics import statistics

ONCE = Spells(1.0, 1.0)


def frames(script, body, errors=None):
    scene = Scene(movement("startup"), body, seconds=3.0, seed=3)
    # Without lost people there is a skeleton in each frame.
    errors = errors or replace(TrackerErrors.of(body), lost=0.0)
    sensor = SimulatedKinect(scene, Rig(), 0, errors=errors, script=script)
    return [frame.people[PERSON] for frame in sensor.frames()]


def test_spells_repeat_and_begin_before_they_end():
    spells = Spells(1.0, 0.5, 4.0)
    at = [0.9, 1.0, 1.4, 1.5, 4.9, 5.0, 5.6]
    assert [spells.include(time) for time in at] == [False, True, True, False, False, True, False]
    assert spells.starts_before(5.4) == [1.0]
    assert spells.starts_before(5.5) == [1.0, 5.0]
    assert spells.starts_before(1.4) == []
    assert Spells(1.0, 0.5).starts_before(1e6) == [1.0]


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_a_misplaced_arm_is_tracked_at_a_wrong_place_and_nothing_else_changes(body):
    script = ScriptedFaults(body, misplaced=(ONCE,))
    arm = script.misplaces(1_500_000_000)
    assert {body.joints[j].lower().replace("_", "") for j in np.flatnonzero(arm)} >= {
        "elbowleft",
        "wristleft",
    }
    assert not any("right" in body.joints[j].lower() for j in np.flatnonzero(arm))
    # A perfect tracker but for the snap: what differs is what the script does.
    perfect = replace(TrackerErrors(), snap=0.6)
    plain, told = frames(None, body, perfect), frames(script, body, perfect)
    off = np.array(
        [np.linalg.norm(t.positions - p.positions, axis=1) for t, p in zip(told, plain, strict=True)]
    )
    time = np.array([skeleton.time_ns for skeleton in plain]) * 1e-9
    assert off[time < 1.0].max() == 0.0
    assert off[:, ~arm].max() == 0.0
    assert off[(time > 1.5) & (time < 2.0)][:, body.joint("WRIST_LEFT")].min() > 0.1
    states = np.array([skeleton.states for skeleton in told])
    assert (states[(time >= 1.0) & (time < 2.0)] == TrackingState.TRACKED).all()
    # the transition has a time constant of 0.08 s: 1 cm of at most 1 m is left after 0.37 s
    assert off[time > 2.4].max() < 0.01


def test_a_mirrored_person_has_left_and_right_exchanged_for_the_spell():
    body = KINECT_V2
    perfect = TrackerErrors()
    plain = frames(None, body, perfect)
    told = frames(ScriptedFaults(body, mirrored=(ONCE,)), body, perfect)
    knees = [body.joint("KNEE_LEFT"), body.joint("KNEE_RIGHT")]
    for one, other in zip(told, plain, strict=True):
        seconds = one.time_ns * 1e-9
        if seconds < 1.0:
            np.testing.assert_array_equal(one.positions, other.positions)
        elif 1.3 < seconds < 2.0:  # after the change of labels, 0.25 s
            np.testing.assert_allclose(one.positions[knees], other.positions[knees[::-1]], atol=0.05)


# --- The simulated trackers err as real ones do, by figures that need no ground truth.


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
    seeds: int = 2


REAL = {
    "kinect_v2_90deg_stationary": Setting("still", KINECT_V2, 90.0, 8.0, seeds=4),
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


def read_csv(path):
    frames = {}
    with path.open() as file:
        for row in csv.DictReader(file):
            positions = frames.setdefault(int(row["time_us"]), np.full((len(KINECT_V2), 3), np.nan))
            positions[KINECT_V2.joint(row["joint"])] = [float(row[axis]) for axis in "xyz"]
    return [Skeleton.of(KINECT_V2, positions, time_ns=1000 * time) for time, positions in frames.items()]


def simulated_statistics(setting):
    """The statistics of a simulated setting without its start-up pose, each the median over some seeds."""
    found = []
    for seed in TUNING_SEEDS[: setting.seeds]:
        both = [[], []]
        for motion, share in ((setting.motion, 1.0 - setting.standing), ("idle", setting.standing)):
            if share > 0.0:
                a, b, truth = simulated_pair(
                    motion=motion, body=setting.body, angle_deg=setting.angle_deg,
                    seconds=share * setting.seconds, seed=seed,
                )  # fmt: skip
                skip = int(np.ceil(getattr(truth.scene.motion, "begins", 0.0) / truth.rig.frame_seconds))
                for view, sensor in zip(both, (a, b), strict=True):
                    view += [frame.people.get(PERSON) for frame in sensor.frames()][skip:]
        found.append(known(statistics(*both)))
    return {name: float(np.nanmedian([one.get(name, np.nan) for one in found])) for name in found[0]}


def known(figures):
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def far_off(simulated, ranges):
    """The figures that differ from the nearer end of the real range by more than a factor of two.

    The aim is 1.5 over all tuning seeds; a few of them scatter about it.
    """
    return [
        f"{name}: {simulated[name]:.4g}, not {low:.4g} to {high:.4g}"
        for name, (low, high) in ranges.items()
        if not (low / 2.0 <= simulated[name] <= (2.0 * high or LARGEST_IF_NONE[name]))
    ]


@pytest.mark.parametrize("recording", REAL)
def test_the_simulated_pair_errs_like_the_real_one(recording):
    folder = SHARED / "real" / recording
    if not folder.exists():
        pytest.skip(f"no real recording at {folder}: set DUPLEX_SHARED")
    setting = REAL[recording]
    real = known(statistics(read_csv(folder / "a.csv"), read_csv(folder / "b.csv")))
    simulated = simulated_statistics(setting)
    # Jitter measures noise only while the person stands still.
    compared = {
        name: (value, value)
        for name, value in real.items()
        if name not in UNTOLD and (setting.motion == "still" or not name.startswith("jitter"))
    }
    assert len(compared) >= 8
    assert not far_off(simulated, compared)


def test_the_simulated_azure_pair_errs_like_the_published_ones():
    assert not far_off(simulated_statistics(AZURE_SQUAT), PUBLISHED_SQUATS)


def test_turning_round_before_a_kinect_v2_is_reported_as_facing_it():
    errors = replace(TrackerErrors(), mirroring=TrackerErrors.of(KINECT_V2).mirroring)
    a, _, truth = simulated_pair(motion="walk", seconds=25.0, body=KINECT_V2, angle_deg=0.0, errors=errors)
    frames = list(a.frames())
    reported = np.array([frame.people[PERSON].positions for frame in frames], dtype=np.float64)
    true = truth.positions_at([frame.time_ns for frame in frames])
    toward = -true[:, KINECT_V2.root] * (1.0, 0.0, 1.0)
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine, claimed = (np.sum(heading(KINECT_V2, at) * toward, axis=1) for at in (true, reported))
    assert np.mean(cosine < -0.8) > 0.2
    # Real walks: 93 to 99 % of the frames with the back turned so far, 0 to 2 % from the front.
    assert 0.75 <= np.mean(claimed[cosine < -0.8] > 0.0) <= 1.0
    assert np.mean(claimed[cosine > 0.5] < 0.0) <= 0.02
