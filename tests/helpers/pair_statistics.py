"""Error statistics of two views of one person, for real and simulated recordings.

They need no ground truth: they compare the views with each other, a joint with its own mean over time and a
bone with its mean length. The simulator can therefore be compared with real recordings.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.joint_kinds import kind_of
from fusion.registration.rigid_fit import fit_rigid
from fusion.skeleton import TrackingState

Array = NDArray[np.float64]

_WARM_UP = 15  # frames: a tracker's first frames have start-up errors
_WINDOW = 30  # frames of one jitter value
_SMOOTH = 5  # frames of the moving mean from which jitter is measured


def statistics(a, b):
    """Computes the statistics of one pair of recordings, by name. Lengths are metres.

    view_rms, view_median: Distance between the two views of a joint, after the best rigid fit over the whole
        recording (Kabsch, all joints that both views have).
    bone_deviation: Standard deviation of a bone's length in one view; median over bones and views.
    bone_deviation_share: The same as a share of the bone's mean length.
    jitter_KIND: Distance of joints of this kind from their moving mean over 5 frames: RMS over each second,
        median over seconds, joints and views. It measures noise only while the person stands still.
    inferred, not_tracked: Share of joints in that state.
    hands_unsure, feet_unsure: Share of hands, tips and thumbs (of feet) in a state other than tracked.
    swapped: Share of frames in which one view fits the other better with left and right exchanged.
    swap_frames: Mean length of a run of such frames; NaN if there is none.
    tracked_change, tracked_change_p99: Second difference of a joint between frames, while tracked in all
        three: median and 99th percentile.
    inferred_change, inferred_change_p99: The same if one of the three is inferred; NaN if none is.
    stale: Share of frames that repeat the previous frame.
    """
    both = [(p, q) for p, q in zip(a, b, strict=True) if p is not None and q is not None]
    body = both[0][0].body
    views = [(_positions(pair), np.stack([s.states for s in pair])) for pair in zip(*both, strict=True)]
    (pa, _), (pb, _) = views
    apart, mirrored = _views_apart(pa, pb, body)
    swapped = np.nanmean(mirrored, axis=1) < np.nanmean(apart, axis=1)
    runs = run_lengths(swapped)
    lengths = np.concatenate([bone_lengths_of(body, p)[:, body.bone_joints] for p, _ in views], axis=1)
    lengths = lengths[:, np.isfinite(lengths).sum(axis=0) >= _WINDOW]
    deviations, means = np.nanstd(lengths, axis=0), np.nanmean(lengths, axis=0)
    states = np.concatenate([s for _, s in views])
    unsure = (states != TrackingState.TRACKED).mean(axis=0)
    change, sure = (np.concatenate(parts) for parts in zip(*(_changes(p, s) for p, s in views), strict=True))
    guessed = change[~sure & np.isfinite(change)]
    found = {
        "view_rms": float(np.sqrt(np.nanmean(apart**2))),
        "view_median": float(np.nanmedian(apart)),
        "bone_deviation": float(np.nanmedian(deviations)),
        "bone_deviation_share": float(np.nanmedian(deviations / means)),
        "inferred": float((states == TrackingState.INFERRED).mean()),
        "not_tracked": float((states == TrackingState.NOT_TRACKED).mean()),
        "hands_unsure": float(unsure[_kinds(body, "hand", "tip", "thumb")].mean()),
        "feet_unsure": float(unsure[_kinds(body, "foot")].mean()),
        "swapped": float(swapped.mean()),
        "swap_frames": float(np.mean(runs)) if runs else float("nan"),
        "tracked_change": float(np.median(change[sure])),
        "tracked_change_p99": float(np.percentile(change[sure], 99)),
        "inferred_change": _median(guessed),
        "inferred_change_p99": float(np.percentile(guessed, 99)) if guessed.size else float("nan"),
        "stale": float(np.mean([_stale(view) for view in (a, b)])),
    }
    jitter = _jitter([p for p, _ in views], body)
    return found | {f"jitter_{kind}": value for kind, value in jitter.items()}


def _positions(skeletons):
    return np.stack([s.positions for s in skeletons]).astype(np.float64)


def _views_apart(a, b, body):
    """Returns (T, J) distances between the fitted views, as reported and with B's sides exchanged."""
    known = np.isfinite(a).all(axis=2) & np.isfinite(b).all(axis=2)
    b_in_a = fit_rigid(a[known], b[known]).apply(b)
    return np.linalg.norm(b_in_a - a, axis=2), np.linalg.norm(b_in_a[:, body.mirror] - a, axis=2)


def _kinds(body, *groups):
    return [j for j, name in enumerate(body.joints) if kind_of(name) in groups]


def _jitter(views, body):
    kernel = np.ones(_SMOOTH) / _SMOOTH
    found = []
    for at in views:
        moving = np.apply_along_axis(np.convolve, 0, at[_WARM_UP:], kernel, "valid")
        half = _SMOOTH // 2
        apart = np.sum((at[_WARM_UP + half : len(at) - half] - moving) ** 2, axis=2)  # (T, J)
        seconds = len(apart) // _WINDOW
        found.append(np.sqrt(apart[: seconds * _WINDOW].reshape(seconds, _WINDOW, -1).mean(axis=1)))
    per_second = np.concatenate(found)
    groups = dict.fromkeys(kind_of(name) for name in body.joints)
    return {group: _median(per_second[:, _kinds(body, group)]) for group in groups}


def _median(values):
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _changes(at, states):
    """Returns (T-2, J) second differences, and whether the joint is tracked in all three frames."""
    sure = states == TrackingState.TRACKED
    change = np.linalg.norm(at[2:] - 2.0 * at[1:-1] + at[:-2], axis=2)
    return change, sure[2:] & sure[1:-1] & sure[:-2]


def _stale(view):
    known = [s for s in view if s is not None]
    return float(np.mean([s.repeats(before) for before, s in pairwise(known)]))


def run_lengths(flags):
    """Returns the length of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return list(np.diff(edges)[::2])
