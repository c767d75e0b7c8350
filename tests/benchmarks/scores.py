"""Error figures of a skeleton against ground truth."""

import numpy as np

from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.skeleton import TrackingState

_STILL_SPEED = 0.02  # m/s: slower is standing still
_SMOOTH = 5  # frames of the moving mean that jitter is measured against
_LONGEST_LAG = 10  # frames
_EVEN_STEPS = 1e-4  # metres per frame: a speed that varies less has no shape to match
_WEAK_MATCH = 0.5  # correlation: a lower peak is noise


def accuracy(body, found, truth, states_a, states_b, frame_seconds, sd=None):
    """Figures of a method's joints against the true ones; metres, NaN where a figure does not exist.

    mpjpe: Mean per joint position error, the mean distance of a joint from its true place.
    p95: 95th percentile of that distance.
    hidden_one, hidden_both: MPJPE of joints that one view, or both, do not track.
    bone_error: Largest difference of a bone from its true length.
    jitter: RMS distance of a joint from its moving mean over 5 frames while it truly stands still.
    lag: Frames by which the joints' mean speed trails the true one: where they correlate most. NaN where
        that is less than 0.5, or at the end of the ±10 frames that are searched.
    within_1sd, within_2sd: Share of joints within one and two standard deviations of the truth, as the
        method states them: 0.608 and 0.993 for isotropic Gaussian errors. NaN where it states none.

    Args:
        body: The joints.
        found: (T, J, 3) the method's joints; NaN where it has none.
        truth: (T, J, 3) in the same frame.
        states_a, states_b: (T, J) tracking states of its two views.
        frame_seconds: Between two frames.
        sd: (T, J) metres, one standard deviation of a joint's distance to the truth that the method states.
    """
    off = np.linalg.norm(found - truth, axis=2)  # (T, J)
    untracked = (states_a != TrackingState.TRACKED).astype(int) + (states_b != TrackingState.TRACKED)
    lengths = bone_lengths_of(body, found)[:, body.bone_joints]
    true_lengths = bone_lengths_of(body, truth)[:, body.bone_joints]
    return {
        "mpjpe": _mean(off),
        "p95": float(np.nanpercentile(off, 95)) if np.isfinite(off).any() else np.nan,
        "hidden_one": _mean(off[untracked == 1]),
        "hidden_both": _mean(off[untracked == 2]),
        "bone_error": float(np.nanmax(np.abs(lengths - true_lengths))),
        "jitter": _jitter(found, truth, frame_seconds),
        "lag": _lag(found, truth),
        "within_1sd": np.nan if sd is None else _coverage(off, sd),
        "within_2sd": np.nan if sd is None else _coverage(off, 2.0 * sd),
    }


def _coverage(errors, bound):
    """Share of (T, J) distances within a (T, J) bound, where both are known."""
    known = np.isfinite(errors) & np.isfinite(bound)
    return float((errors <= bound)[known].mean()) if known.any() else np.nan


def _mean(values):
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else np.nan


def _jitter(found, truth, frame_seconds):
    speed = np.linalg.norm(np.diff(truth, axis=0), axis=2) / frame_seconds
    still = (speed < _STILL_SPEED).all(axis=1)  # (T-1,)
    if len(found) < _SMOOTH:
        return np.nan
    windows = np.lib.stride_tricks.sliding_window_view(found, _SMOOTH, axis=0)  # (T-4, J, 3, 5)
    high = np.linalg.norm(windows[..., _SMOOTH // 2] - windows.mean(axis=-1), axis=2)
    calm = np.lib.stride_tricks.sliding_window_view(still, _SMOOTH - 1).all(axis=1)
    square = high[calm] ** 2
    square = square[np.isfinite(square)]
    return float(np.sqrt(square.mean())) if square.size else np.nan


def _lag(found, truth):
    steps, true_steps = (np.linalg.norm(np.diff(at, axis=0), axis=2) for at in (found, truth))  # (T-1, J)
    frames = np.arange(_LONGEST_LAG, len(steps) - _LONGEST_LAG)
    if len(steps) < 4 * _LONGEST_LAG or true_steps.mean(axis=1).std() < _EVEN_STEPS:
        return np.nan
    lags = np.arange(-_LONGEST_LAG, _LONGEST_LAG + 1)
    match = np.array([_correlation(steps[frames + lag], true_steps[frames]) for lag in lags])
    if not np.isfinite(match).all():
        return np.nan
    best = int(np.argmax(match))
    if match[best] < _WEAK_MATCH or best in (0, len(lags) - 1):
        return np.nan
    left, top, right = match[best - 1 : best + 2]  # a parabola through the peak
    return float(lags[best] + 0.5 * (left - right) / (left - 2.0 * top + right))


def _correlation(steps, true_steps):
    """Of the joints' mean speeds, each frame over the joints that ``steps`` knows in it."""
    known = np.isfinite(steps)
    count = known.sum(axis=1)
    some = count > 0
    speed, true_speed = (
        np.where(known, of, 0.0).sum(axis=1)[some] / count[some] for of in (steps, true_steps)
    )
    if some.sum() < 2 * _LONGEST_LAG or min(speed.std(), true_speed.std()) == 0.0:
        return np.nan
    return float(np.corrcoef(speed, true_speed)[0, 1])
