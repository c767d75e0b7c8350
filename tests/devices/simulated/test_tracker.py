"""Faults of a simulated tracker at given times, and its errors, which are those of real ones."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, Scene, SimulatedKinect, movement, simulated_pair
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from devices.simulated.tracking.scripted_faults import ScriptedFaults, Spells
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import BODIES, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.joint_kinds import kind_of
from fusion.registration.rigid_fit import fit_rigid
from fusion.skeleton import TrackingState
from tests.helpers.labelled_views import heading, real_views, simulated_views

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
REAL = {
    "stationary": (("still", 8.0),),
    "steps": (("steps", 24.0),),
    "walk": (
        ("walk", 18.0),
        ("idle", 12.0),
    ),  # on seven real walks the trunk is slow in 30 to 48 % of the time
}
"""Of each real recording, the movements and seconds of the simulated one."""
PUBLISHED_SQUATS = {
    "view_median": (0.025, 0.025),
    "view_rms": (0.048, 0.048),
    "bone_deviation": (0.025, 0.065),
    "inferred": (0.025, 0.025),
    "not_tracked": (0.05, 0.05),
    "hands_unsure": (0.13, 0.77),
    "feet_unsure": (0.15, 0.15),
    "change": (0.008, 0.015),
    "change_p99": (0.057, 0.204),
    "stale": (0.03, 0.10),
}
"""Ranges over 87 trials of squats before two Azure Kinects, 38 to 54 degrees apart; metres and shares."""
UNTOLD = {"inferred", "not_tracked", "hands_unsure", "feet_unsure"}
"""What the real recordings do not tell: their source kept no tracking states."""


def figures_of(recordings):
    """What needs no truth, by name, of recordings of one pair: (views, first frame). Lengths are metres.

    view_median, view_rms: Distance between the two views of a joint, after the best rigid fit.
    bone_deviation: Standard deviation of a bone's length as a share of it; median over bones and views.
    inferred, not_tracked, hands_unsure, feet_unsure: Shares of joints in such states.
    swapped: Share of frames in which one view fits the other better with left and right exchanged.
    change, change_p99: Second difference of a joint that is tracked in all three frames.
    jitter: Distance of a joint from its mean over five frames; noise only while the person stands still.
    stale: Share of frames that repeat the previous frame.
    """
    body, parts = recordings[0][0].body, []
    for views, first in recordings:
        seen = np.isfinite(views.a).any(axis=(1, 2)) & np.isfinite(views.b_in_a).any(axis=(1, 2))
        seen[:first] = False
        parts.append([of[seen] for of in (views.a, views.b_in_a, views.states_a, views.states_b)])
    a, b, *states = (np.concatenate(of) for of in zip(*parts, strict=True))
    known = np.isfinite(a).all(axis=2) & np.isfinite(b).all(axis=2)
    b_in_a = fit_rigid(a[known], b[known]).apply(b)
    apart, mirrored = (np.linalg.norm(b_in_a[:, of] - a, axis=2) for of in (slice(None), body.mirror))
    lengths = np.concatenate([bone_lengths_of(body, at)[:, body.bone_joints] for at in (a, b)], axis=1)
    lengths = lengths[:, np.isfinite(lengths).sum(axis=0) >= 30]
    at, states = np.concatenate((a, b)), np.concatenate(states)
    unsure, sure = states != TrackingState.TRACKED, states == TrackingState.TRACKED
    change = np.linalg.norm(at[2:] - 2.0 * at[1:-1] + at[:-2], axis=2)[sure[2:] & sure[1:-1] & sure[:-2]]
    moving = np.lib.stride_tricks.sliding_window_view(at, 5, axis=0).mean(axis=-1)
    return {
        "view_median": np.nanmedian(apart),
        "view_rms": np.sqrt(np.nanmean(apart**2)),
        "bone_deviation": np.nanmedian(np.nanstd(lengths, axis=0) / np.nanmean(lengths, axis=0)),
        "inferred": (states == TrackingState.INFERRED).mean(),
        "not_tracked": (states == TrackingState.NOT_TRACKED).mean(),
        "hands_unsure": unsure[:, _kinds(body, "hand", "tip", "thumb")].mean(),
        "feet_unsure": unsure[:, _kinds(body, "foot")].mean(),
        "swapped": np.mean(np.nanmean(mirrored, axis=1) < np.nanmean(apart, axis=1)),
        "change": np.median(change),
        "change_p99": np.percentile(change, 99),
        "jitter": np.nanmedian(np.linalg.norm(at[2:-2] - moving, axis=2)),
        "stale": np.mean((np.nan_to_num(np.diff(at, axis=0)) == 0.0).all(axis=(1, 2))),
    }


def _kinds(body, *groups):
    return [j for j, name in enumerate(body.joints) if kind_of(name) in groups]


def simulated_figures(movements, seeds, **how):
    """The figures of simulated recordings without their start-up poses, each the median over some seeds."""
    found = [
        figures_of(
            [
                (
                    simulated_views(motion, seconds=seconds, seed=seed, **how),
                    round(30 * MOTIONS[motion].begins),
                )
                for motion, seconds in movements
            ]
        )
        for seed in seeds
    ]
    return {name: np.median([one[name] for one in found]) for name in found[0]}


def far_off(simulated, ranges):
    """The figures that differ from the nearer end of the real range by more than a factor of two.

    The aim is 1.5 over all tuning seeds; a few of them scatter about it. A share of 1 % is none.
    """
    return [
        f"{name}: {simulated[name]:.4g}, not {low:.4g} to {high:.4g}"
        for name, (low, high) in ranges.items()
        if not low / 2.0 <= simulated[name] <= (2.0 * high or 0.01)
    ]


@pytest.mark.parametrize("recording", REAL)
def test_the_simulated_pair_errs_like_the_real_one(recording):
    folder = SHARED / "real" / f"kinect_v2_90deg_{recording}"
    if not folder.exists():
        pytest.skip(f"no real recording at {folder}: set DUPLEX_SHARED")
    real, still = figures_of([(real_views(folder), 0)]), recording == "stationary"
    simulated = simulated_figures(REAL[recording], TUNING_SEEDS[: 4 if still else 1])
    left_out = UNTOLD | (set() if still else {"jitter"})
    assert not far_off(simulated, {name: (real[name], real[name]) for name in real.keys() - left_out})


def test_the_simulated_azure_pair_errs_like_the_published_ones():
    found = simulated_figures((("squat", 24.0),), TUNING_SEEDS[:1], body="azure_kinect", angle_deg=45.0)
    assert not far_off(found, PUBLISHED_SQUATS)


def lean(views):
    """How much farther from its sensor a joint is reported for each metre above the root.

    The coefficient s of p - q = s (h_A r_A - h_B r_B) + shift + turn × p, with heights h and rays r, by least
    squares over the middles of joints of head, trunk and legs, which no exchange of sides moves. A slope in
    height is told from a turn of R because the person moves about and turns.
    """
    body, sensors = views.body, (np.zeros(3), views.sensor_b)
    chosen = _kinds(body, "spine", "head", "girdle", "knee", "ankle", "foot")
    middles = [0.5 * (at + at[:, body.mirror]) for at in (views.a, views.b_in_a)]
    apart = (middles[0] - middles[1])[:, chosen]
    raised = []
    for at, sensor in zip(middles, sensors, strict=True):
        above = at[:, body.root, None, 1:2] - at[..., 1:2]
        raised.append((above * (at - sensor) / np.linalg.norm(at - sensor, axis=2, keepdims=True))[:, chosen])
    near = (np.linalg.norm(apart, axis=2) < 0.15) & np.isfinite(raised[0] - raised[1]).all(axis=2)
    turned = np.cross(np.eye(3), (middles[0] - np.nanmean(middles[0]))[:, chosen][near][:, None])
    columns = [(raised[0] - raised[1])[near][:, None], np.broadcast_to(np.eye(3), turned.shape), turned]
    A = np.concatenate(columns, axis=1).transpose(0, 2, 1).reshape(-1, 7)
    return np.linalg.lstsq(A, apart[near].ravel())[0][0]


def test_the_simulated_tracker_leans_as_the_real_ones_do():
    folders = [*SHARED.glob("real*/kinect_v2_*walk*"), *SHARED.glob("real*/kinect_v2_*steps*")]
    if not folders:
        pytest.skip(f"no real recordings in {SHARED}: set DUPLEX_SHARED")
    real = [lean(real_views(folder)) for folder in folders]
    simulated = [
        lean(simulated_views(motion, seed=seed, seconds=20.0))
        for motion in ("walk", "steps") for seed in TUNING_SEEDS[:4]
    ]  # fmt: skip
    # Two standard errors of the difference; without a lean, or with the wrong sign, it is four or more.
    error = np.hypot(*(np.std(of, ddof=1) / np.sqrt(len(of)) for of in (real, simulated)))
    assert abs(np.mean(real) - np.mean(simulated)) < 2.0 * error


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
