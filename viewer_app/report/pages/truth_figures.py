"""A comparison with motion capture as figures, lines and tables."""

from collections.abc import Iterator

import numpy as np

from fusion.movement.angles import ANGLES
from recordings.comparing.agreement import Agreement, agreement, step_agreement
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.data import layout
from recordings.gait.events import find_gait
from recordings.quality.figures import Figures, known_or_none, of_finite
from viewer_app.report.words import Line, in_mm, in_percent

NAMES = tuple(layout.SKELETON_NAMES[key] for key in SKELETONS)
ALL_HEAD = ("distance to the truth, mm", *NAMES)
"""The columns of :func:`all_rows`."""
JOINT_HEAD = ("joint", *NAMES)
"""The columns of :func:`joint_rows`."""
ANGLE_HEAD = ("angle", *NAMES, "range: truth / A / B / S*")
"""The columns of :func:`angle_rows`."""
AGREEMENT_HEAD = ("angle", "bias", "limits of agreement", "RMSE", "ICC(A,1)")
"""The columns of :func:`agreement_rows`."""
STEP_HEAD = ("step", *AGREEMENT_HEAD[1:], "steps")
"""The columns of :func:`step_rows`."""
_RANGE = 1.0, 99.0  # percentiles that a range of motion lies between
_LEAST_RANGE = 1.0  # degrees: the correlation of an angle that moves less says nothing
_FEWEST = 10  # frames
_NAMED = 5  # offsets that match as well
_BLOCK_S = 2.0  # seconds of frames whose errors may be alike: about two strides


def truth_figures(comparison: TruthComparison) -> Figures:
    """The figures as ``--report`` writes them; None where one is unknown."""
    offset, joints = comparison.offset, comparison.joints
    transform, steps = comparison.a_from_truth, _of_steps(comparison)
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
        "as_filed_mm": None if (filed := comparison.distance_as_filed) is None else 1e3 * filed,
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
        "steps": steps,
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
        equal = ", ".join(f"{other:.2f} s" for other in others[:_NAMED])
        equal += f" and {more} more" if (more := len(others) - _NAMED) > 0 else ""
        yield Line(
            "", f"The movement repeats itself: {equal} match about as well. State one with --offset.", True
        )
    if lag is not None:
        yield Line("Lag", f"S* is {abs(lag):.1f} ms {'behind' if lag >= 0.0 else 'ahead of'} the two views.")
    apart = f"{in_mm(figures['residual_mm'])} (median) after the fit"
    yield Line("Match", f"Displacements correlate at {_digits(figures['correlation'], 2)}; {apart}.")
    if (filed := figures["as_filed_mm"]) is not None:
        fitted = in_mm(figures["all_joints"]["fused"]["mean_mm"])
        yield Line(
            "In K_A",
            f"S* is {in_mm(filed)} off (mean) in K_A's frame, which the file has; {fitted} after the fit.",
        )


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
    """Of each angle of S*: bias, limits of agreement and RMSE in degrees, and ICC, with 95 % intervals."""
    for name, of in figures["angles"].items():
        if (of_fused := of["fused"])["limits_deg"] is not None:
            plain = {key.removesuffix("_deg"): value for key, value in of_fused.items()}
            yield [name.replace("_", " "), *_stated(plain, 1)]


def step_rows(figures: Figures) -> Iterator[list[str]]:
    """Of each parameter of a step, the same, and how many steps both have."""
    for name, of in (figures["steps"] or {"of_each": {}})["of_each"].items():
        digits = {"s": 3, "m": 3, "m/s": 3}.get(of["unit"], 1)
        yield [f"{name}, {of['unit']}", *_stated(of, digits), str(of["count"])]


def step_line(figures: Figures) -> str:
    """Which steps only one of both has; empty without steps."""
    if (of := figures["steps"]) is None:
        return ""
    return f"{of['missed']} steps of the truth were not found, and {of['extra']} of S* are not in the truth."


def _stated(of: Figures, digits: int) -> list[str]:
    limits = " to ".join(f"{limit:+.{digits}f}" for limit in of["limits"])
    return [
        f"{of['bias']:+.{digits}f}{_in_brackets(of['bias_interval'], digits, '+')}",
        limits,
        f"{of['rmse']:.{digits}f}{_in_brackets(of['rmse_interval'], digits)}",
        f"{_digits(of['icc'], 2)}{_in_brackets(of['icc_interval'], 2)}",
    ]


def _in_brackets(interval: list[float] | None, digits: int, sign: str = "") -> str:
    return "" if interval is None else f" ({' to '.join(f'{end:{sign}.{digits}f}' for end in interval)})"


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
    agrees = agreement(true + off, true, 1e-9 * comparison.time_ns[both] // _BLOCK_S)
    return {
        **{f"{name}_deg": value for name, value in _of_agreement(agrees).items() if "icc" not in name},
        "icc": agrees.icc if moves else None,
        "icc_interval": _or_none(agrees.icc_interval) if moves else None,
        "correlation": float(np.corrcoef(found, true)[0, 1]) if moves else None,
        "range_deg": float((high - low)[0]),
        "true_range_deg": float((high - low)[1]),
    }


_OF_ANGLE = (
    "bias_deg", "bias_interval_deg", "limits_deg", "limits_intervals_deg", "rmse_deg", "rmse_interval_deg",
    "icc", "icc_interval", "correlation", "range_deg", "true_range_deg",
)  # fmt: skip


def _of_steps(comparison: TruthComparison) -> Figures | None:
    """How the steps of S* agree with those of the truth; None without five steps in both."""
    found, true = (
        find_gait(comparison.body, comparison.time_ns, positions["fused"], comparison.up)
        for positions in (comparison.found, comparison.truth)
    )
    agrees = step_agreement(found, true)
    if agrees is None:
        return None
    return {
        "missed": agrees.missed,
        "extra": agrees.extra,
        "of_each": {
            name: {"unit": unit, "count": of.n, **_of_agreement(of)}
            for name, (unit, of) in agrees.of_each.items()
        },
    }


def _of_agreement(of: Agreement) -> Figures:
    low, high = map(_or_none, of.limits_intervals)
    return {
        "bias": of.bias,
        "bias_interval": _or_none(of.bias_interval),
        "limits": list(of.limits),
        "limits_intervals": None if low is None or high is None else [low, high],
        "rmse": of.rmse,
        "rmse_interval": _or_none(of.rmse_interval),
        "icc": known_or_none(of.icc),
        "icc_interval": _or_none(of.icc_interval),
    }


def _or_none(interval: tuple[float, float]) -> list[float] | None:
    return None if np.isnan(interval).any() else list(interval)


def _digits(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
