"""A comparison with motion capture as figures, lines and tables."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fusion.movement.angles import ANGLES
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.data import layout
from recordings.quality.figures import Figures, known_or_none, of_finite
from viewer_app.report.words import Line, in_mm, in_percent

Array = NDArray[np.float64]
NAMES = tuple(layout.SKELETON_NAMES[key] for key in SKELETONS)
ALL_HEAD = ("distance to the truth, mm", *NAMES)
"""The columns of :func:`all_rows`."""
JOINT_HEAD = ("joint", *NAMES)
"""The columns of :func:`joint_rows`."""
ANGLE_HEAD = ("angle", *NAMES, "range: truth / A / B / S*")
"""The columns of :func:`angle_rows`."""
AGREEMENT_HEAD = ("angle", "bias", "limits of agreement", "ICC(A,1)")
"""The columns of :func:`agreement_rows`."""
_RANGE = 1.0, 99.0  # percentiles that a range of motion lies between
_LEAST_RANGE = 1.0  # degrees: the correlation of an angle that moves less says nothing
_FEWEST = 10  # frames
_LIMITS = 1.96  # standard deviations between which 95 % of the differences lie (Bland and Altman 1986)


def truth_figures(comparison: TruthComparison) -> Figures:
    """The figures as ``--report`` writes them; None where one is unknown."""
    offset, joints = comparison.offset, comparison.joints
    transform = comparison.a_from_truth
    return {
        "truth": comparison.truth_name,
        "names": comparison.table,
        "unit": comparison.unit,
        "frames": len(comparison),
        "offset_s": offset.seconds,
        "offset_sd_ms": known_or_none(1e3 * offset.sd_seconds),
        "equal_offsets_s": list(offset.others),
        "offset_by_motion_s": known_or_none(offset.instead_of),
        "lag_ms": known_or_none(1e3 * offset.lag_seconds),
        "clock_fast_percent": 1e2 * offset.fast,
        "clock_fast_sd_percent": known_or_none(1e2 * offset.fast_sd),
        "correlation": known_or_none(offset.correlation),
        "residual_mm": 1e3 * comparison.residual,
        "a_from_truth": {
            "rotation": transform.rotation.tolist(),
            "translation_m": transform.translation.tolist(),
        },
        "all_joints": {key: _of_all(comparison, key) for key in SKELETONS},
        "joints": {
            comparison.body.joints[j]: {key: _of_joint(comparison, key, j) for key in SKELETONS}
            for j in joints
        },
        "angles": {
            name: {key: _of_angle(comparison, key, k) for key in SKELETONS}
            for k, name in enumerate(ANGLES)
            if np.isfinite(comparison.angles["fused"][1][:, k]).sum() >= _FEWEST
        },
    }


def truth_lines(figures: Figures) -> Iterator[Line]:
    """How the clocks are related, and how well the movements match."""
    sd, lag, others = figures["offset_sd_ms"], figures["lag_ms"], figures["equal_offsets_s"]
    certain = "as given" if sd is None else f"± {sd:.1f} ms"
    yield Line("Offset", f"{figures['offset_s']:.4f} s to add to the truth's times, {certain}.")
    if (motion := figures["offset_by_motion_s"]) is not None:
        yield Line("", f"The motion contradicts it: by the motion, the offset is {motion:.4f} s.", True)
    if fast := figures["clock_fast_percent"]:
        sd, how = figures["clock_fast_sd_percent"], "fast" if fast > 0.0 else "slow"
        text = f"The truth's clock is {how} by {abs(fast):.3f} ± {sd:.3f} %, which is corrected."
        yield Line("Clock", text, True)
    if others:
        equal = ", ".join(f"{other:.2f} s" for other in others)
        yield Line(
            "", f"The movement repeats itself: {equal} match about as well. State one with --offset.", True
        )
    if lag is not None:
        yield Line("Lag", f"S* is {abs(lag):.1f} ms {'behind' if lag >= 0.0 else 'ahead of'} the two views.")
    apart = f"{in_mm(figures['residual_mm'])} (median) after the fit"
    yield Line("Match", f"Displacements correlate at {_digits(figures['correlation'], 2)}; {apart}.")


_OF_ALL = {
    "mean_mm": "mean over joints and frames",
    "common_mean_mm": "where all three have the joint",
    "p95_mm": "95 % are below",
    "rest_mean_mm": "mean without the constant part",
}


def all_rows(figures: Figures) -> Iterator[list[str]]:
    """Of all joints: distances of each skeleton to the truth, and which share of the joints it has."""
    of = figures["all_joints"]
    for key, words in _OF_ALL.items():
        yield [words, *(in_mm(of[skeleton][key], "") for skeleton in SKELETONS)]
    yield ["joints that it has", *(in_percent(of[skeleton]["known"]) for skeleton in SKELETONS)]


def joint_rows(figures: Figures) -> Iterator[list[str]]:
    """Of each joint and skeleton: mean distance, length of its constant part, mean of the rest; mm."""
    for name, of in figures["joints"].items():
        yield [
            name,
            *(
                " / ".join(in_mm(of[key][f"{part}_mm"], "") for part in _PARTS_OF_DISTANCE)
                for key in SKELETONS
            ),
        ]


_PARTS_OF_DISTANCE = "mean", "constant_length", "rest_mean"


def angle_rows(figures: Figures) -> Iterator[list[str]]:
    """Of each angle and skeleton: RMSE in degrees and correlation; ranges of motion, the truth's first."""
    for name, of in figures["angles"].items():
        ranges = [of["fused"]["true_range_deg"], *(of[key]["range_deg"] for key in SKELETONS)]
        yield [
            name.replace("_", " "),
            *(f"{_digits(of[key]['rmse_deg'], 1)} {_digits(of[key]['correlation'], 2)}" for key in SKELETONS),
            " / ".join(_digits(degrees, 0) for degrees in ranges),
        ]


def agreement_rows(figures: Figures) -> Iterator[list[str]]:
    """Of each angle of S*: its bias in degrees, between which differences 95 % of them lie, and the ICC."""
    for name, of in figures["angles"].items():
        if (of_fused := of["fused"])["limits_deg"] is not None:
            limits = " to ".join(f"{limit:+.1f}" for limit in of_fused["limits_deg"])
            bias, icc = f"{of_fused['bias_deg']:+.1f}", _digits(of_fused["icc"], 2)
            yield [name.replace("_", " "), bias, limits, icc]


def _of_all(comparison: TruthComparison, key: str) -> Figures:
    distance, rest = comparison.distance[key], comparison.rest[key]
    common = np.isfinite([comparison.distance[each] for each in SKELETONS]).all(axis=0)
    true = np.isfinite(comparison.truth[key]).all(axis=2)
    return {
        "mean_mm": of_finite(np.mean, 1e3 * distance),
        "common_mean_mm": of_finite(np.mean, 1e3 * distance[common]),
        "p95_mm": of_finite(lambda mm: np.percentile(mm, 95.0), 1e3 * distance),
        "rest_mean_mm": of_finite(np.mean, 1e3 * rest),
        "known": of_finite(np.mean, np.isfinite(distance[true])),
    }


def _of_joint(comparison: TruthComparison, key: str, joint: int) -> Figures:
    constant = comparison.constant[key][joint]
    return {
        "mean_mm": of_finite(np.mean, 1e3 * comparison.distance[key][:, joint]),
        "constant_mm": [known_or_none(1e3 * c) for c in constant],
        "constant_length_mm": known_or_none(1e3 * float(np.linalg.norm(constant))),
        "rest_mean_mm": of_finite(np.mean, 1e3 * comparison.rest[key][:, joint]),
        "frames": int(np.isfinite(comparison.distance[key][:, joint]).sum()),
    }


def _of_angle(comparison: TruthComparison, key: str, angle: int) -> Figures:
    found, true = (values[:, angle] for values in comparison.angles[key])
    both = np.isfinite(found) & np.isfinite(true)
    found, true = found[both], true[both]
    if len(found) < _FEWEST:
        return dict.fromkeys(_OF_ANGLE)
    off = (found - true + 180.0) % 360.0 - 180.0
    low, high = np.percentile([found, true], _RANGE, axis=1)
    moves = (high - low > _LEAST_RANGE).all()
    return {
        "rmse_deg": float(np.sqrt(np.mean(off**2))),
        "bias_deg": float(off.mean()),
        "limits_deg": [float(off.mean() + side * _LIMITS * off.std(ddof=1)) for side in (-1.0, 1.0)],
        "icc": _agreement(true + off, true) if moves else None,
        "correlation": float(np.corrcoef(found, true)[0, 1]) if moves else None,
        "range_deg": float((high - low)[0]),
        "true_range_deg": float((high - low)[1]),
    }


_OF_ANGLE = ("rmse_deg", "bias_deg", "limits_deg", "icc", "correlation", "range_deg", "true_range_deg")


def _agreement(found: Array, true: Array) -> float:
    """ICC(A,1): absolute agreement of single values in a two-way model (McGraw and Wong 1996)."""
    values = np.stack([found, true], axis=1)
    n, k = values.shape
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    of_rows = k * rows.var(ddof=1)
    of_columns = n * columns.var(ddof=1)
    rest = values - rows[:, None] - columns + values.mean()
    error = np.sum(rest**2) / ((n - 1) * (k - 1))
    return float((of_rows - error) / (of_rows + (k - 1) * error + k / n * (of_columns - error)))


def _digits(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
