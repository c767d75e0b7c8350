"""How often the truth lies within what is stated: ``python -m tests.benchmarks.coverage``.

Two simulated sensors see a person for 20 s; then the same again without the frames of 2.5 s. The figures are
written to ``results/coverage.json``. With normal errors that are equal in all directions, 99.3 % of a joint's
errors lie within 2 σ, and 68 and 95 % of a number's within 1 and 2.
"""

import argparse
from collections import defaultdict

import numpy as np

from devices.pairing import pair_views
from devices.people.recorded_people import RecordedPeople
from devices.recorded.two_recordings import TwoRecordings
from devices.simulated.kinect import simulated_pair
from fusion.body import BODIES
from fusion.setup import FuserSettings
from recordings.fusing.files import fuse_read
from recordings.gait.events import find_gait
from recordings.session import Session
from tests.benchmarks import results

_GAP = 8.0, 10.5  # seconds without frames
_AFTER = 0.5  # seconds after a gap
_BEGINNING = 3.0  # seconds
_WITHIN = 2.5  # stated standard deviations
_RARE = 12.8  # a squared Mahalanobis distance in space exceeds it with a probability of 0.5 %


def of_body(body, movements, angles, seeds):
    """Figures of one body: σ by what the sensors saw, covariance, speed and steps of walks."""
    joints = defaultdict(list)
    distances, least, speeds, late = [], [], [], []
    for movement, angle, seed, gap in (
        (m, angle, seed, gap)
        for m in movements
        for angle in angles
        for seed in seeds
        for gap in (False, True)
    ):
        session, truth, covariance = fused(body, movement, angle, seed, gap)
        offset = session.fused - truth
        error = np.linalg.norm(offset, axis=2)
        known = np.isfinite(error) & np.isfinite(session.sigma)
        for group, chosen in groups(session, gap).items():
            joints[group].append(np.stack([error, session.sigma], axis=-1)[known & chosen])
        if gap:
            continue
        variances, axes = np.linalg.eigh(covariance[known])
        along = np.einsum("nij,ni->nj", axes, offset[known])
        distances.append((along**2 / variances).sum(axis=1))
        least.append(along[:, 0] ** 2 / variances[:, 0])
        if movement == "walk":
            of_walk = _of_walk(session, truth)
            speeds.append(of_walk[0])
            late.append(of_walk[1])
    speed, late = np.array(speeds), np.concatenate(late)
    return {
        "joints": {group: _of_joints(np.concatenate(of)) for group, of in joints.items()},
        "covariance": {
            "beyond_12.8": float(np.mean(np.concatenate(distances) > _RARE)),
            "least_axis": float(np.mean(np.concatenate(least))),
        },
        "walks": {
            "speed_over_true": float(np.mean(speed[:, 0])),
            "speed_within": float(np.mean(speed[:, 1] <= _WITHIN)),
            "strike_late": float(np.median(late[:, 0])),
            "toe_off_late": float(np.nanmedian(late[:, 1])),
        },
    }


def fused(body, movement, angle, seed, gap):
    """The session of a scene, its truth (T, J, 3), and the covariances (T, J, 3, 3)."""
    *sensors, truth = simulated_pair(
        motion=movement, seed=seed, body=BODIES[body], angle_deg=angle, seconds=20.0
    )
    views = []
    for sensor in sensors:
        people = RecordedPeople.of(sensor.body, sensor.frames())
        view = people.view(people.ids)
        seconds = (view.time_ns - view.time_ns[0]) * 1e-9
        missing = gap & (seconds >= _GAP[0]) & (seconds < _GAP[1])
        views.append(view.chosen(np.flatnonzero(~missing)))
    read = TwoRecordings(BODIES[body], pair_views(BODIES[body], *views), (None, None), ())
    parts = fuse_read(read, ("a", "b"), FuserSettings(hindsight="labels"), force=True)
    covariances = []

    def kept(frames):
        for block in frames:
            covariances.append(block.fused.covariance)
            yield block

    session = Session.of([(setup, kept(frames)) for setup, frames in parts.fused])
    at = truth.positions_at(read.pairing.pairs.skeletons.time_ns)
    return session, at, np.concatenate(covariances)


def groups(session, gap):
    """The joints (T, J) of each kind of condition."""
    seconds = session.time[:, None]
    if gap:
        last = _GAP[1]
        return {"after a gap of both views": (seconds >= last) & (seconds < last + _AFTER)}
    exchanged = (session.rows.exchanged != 0).any(axis=1)[:, None]
    return {
        "all": np.ones(session.rows.states_a.shape, dtype=bool),
        "left and right exchanged": (seconds > _BEGINNING) & exchanged,
    }


def _of_joints(rows):
    """Figures of (N, 2) errors and σ, metres; None without any."""
    if not len(rows):
        return None
    error, sigma = rows.T
    return {
        "within_2": float(np.mean(error <= 2.0 * sigma)),
        "rms_sigma_over_error": float(np.sqrt(np.mean(sigma**2) / np.mean(error**2))),
    }


def _of_walk(session, truth):
    """Speed over the true one and its error in deviations; (n, 2) seconds that strikes, toe-offs are late."""
    body, gait, up = session.body, session.gait, session.up
    hips = truth[:, [body.joint("HipLeft"), body.joint("HipRight")]].mean(axis=1)
    on_floor = hips - (hips @ up)[:, None] * up
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(on_floor, axis=0), axis=1))])
    walked = sum(
        float(np.diff(np.interp([walk[0].strike, walk[-1].strike], session.time, path))[0])
        for walk in gait.walks
    )
    true_speed = walked / gait.walking_seconds
    true = find_gait(body, session.time_ns, truth, up)
    late = [
        (
            min((step.strike - other.strike for other in of_side), key=abs),
            min(
                (step.toe_off - other.toe_off for other in of_side if np.isfinite(other.toe_off)),
                key=abs,
                default=np.nan,
            ),
        )
        for step in gait.steps
        if (of_side := true.of_side(step.side))
    ]
    speed = gait.speed
    return (speed.value / true_speed, abs(speed.value - true_speed) / speed.sigma), np.array(late)


def main(arguments=None):
    """Measures each body."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", nargs="+", default=["azure_kinect", "kinect_v2"])
    parser.add_argument("--movements", nargs="+", default=["walk", "arms", "squat", "badminton"])
    parser.add_argument("--angles", nargs="+", type=float, default=[90.0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[7900, 7901])
    options = parser.parse_args(arguments)
    results.write(
        "coverage",
        {
            body: {"labels": of_body(body, options.movements, options.angles, options.seeds)}
            for body in options.bodies
        },
    )


if __name__ == "__main__":
    main()
