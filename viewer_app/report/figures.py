"""The figures of a fusion, as ``report.json`` has them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.pairing import Pairing
from fusion.calibration.calibration import Calibration
from fusion.setup import FuserSettings
from fusion.solvers.solver import MAX_ITERATIONS
from recordings.session_arrays import SessionArrays

Figures = dict[str, Any]


@dataclass(frozen=True, eq=False)
class FusionResult:
    """The data of a report.

    Attributes:
        pairing: Counts of paired and dropped frames.
        calibration: The calibration used.
        settings: The settings used.
        rows: The fused frames.
        exact: The same frames solved with exact bones, if the published scheme was used; else None.
    """

    pairing: Pairing
    calibration: Calibration
    settings: FuserSettings
    rows: SessionArrays
    exact: SessionArrays | None = None


def report(result: FusionResult) -> Figures:
    """The report as plain data; figures that do not exist are None."""
    pairing = result.pairing
    figures: Figures = {
        "frames": {"a": pairing.frames_a, "b": pairing.frames_b},
        "paired": len(pairing.pairs) - pairing.alone_a - pairing.alone_b,
        "alone": {"a": pairing.alone_a, "b": pairing.alone_b},
        "dropped": {"a": pairing.dropped_a, "b": pairing.dropped_b},
        **fusion_figures(result.calibration, result.settings, result.rows),
    }
    if result.exact is not None:
        figures["compared_with_exact"] = _comparison(result.rows, result.exact)
    return figures


def fusion_figures(calibration: Calibration, settings: FuserSettings, rows: SessionArrays) -> Figures:
    """The figures of fused frames from any source."""
    registration = calibration.registration
    return {
        "stale": {"a": int(rows.stale_a.sum()), "b": int(rows.stale_b.sum())},
        "without_person": {
            "a": int((rows.states_a == 0).all(axis=1).sum()),
            "b": int((rows.states_b == 0).all(axis=1).sum()),
            "both": int(rows.predicted.all(axis=1).sum()),
        },
        "settings": {
            "method": settings.method,
            "h": settings.h,
            "weights": settings.weights,
            "smoothing": settings.smoothing,
        },
        "calibration": {
            "how": calibration.how,
            "residual_mm": None
            if registration is None
            else {"median": registration.residual_median * 1e3, "rms": registration.residual_rms * 1e3},
            "axes_angle_deg": math.degrees(calibration.axes_angle),
            "rotation_sd_deg": None if registration is None else math.degrees(registration.rotation_sd),
            "frames": None if registration is None else registration.frames,
            "worst_joints_mm": {}
            if registration is None
            else {name: distance * 1e3 for name, distance in registration.worst_joints()},
        },
        **method_figures(rows),
    }


def method_figures(rows: SessionArrays) -> Figures:
    """Bones, errors, disagreement, repaired data and time of fused frames."""
    lengths, target = rows.bone_length_of_each, rows.bone_lengths
    disagreement = rows.disagreement * 1e3
    bones = {}
    for joint in rows.body.bone_joints:
        of_bone: Figures = {"target_m": float(target[-1, joint])}
        for key, length in zip(("a", "b", "fused"), lengths[:, :, joint], strict=True):
            of_bone[key] = {"mean_m": _of(np.mean, length), "std_mm": _of(np.std, length * 1e3)}
        of_bone["fused"]["max_error_mm"] = _of(np.max, np.abs(lengths[2, :, joint] - target[:, joint]) * 1e3)
        bones[rows.body.bones[joint]] = of_bone
    error = (lengths - target)[:, :, rows.body.bone_joints] * 1e3
    seconds = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
    return {
        "fused_frames": len(rows),
        "seconds": seconds,
        "frames_per_second": (len(rows) - 1) / seconds if seconds > 0.0 else None,
        "repaired": _repaired(rows),
        "bones": bones,
        "bone_error_mm": {
            key: {"rms": _of(_rms, error[k]), "max": _of(np.max, np.abs(error[k]))}
            for k, key in enumerate(("a", "b", "fused"))
        },
        "disagreement_mm": {"median": _of(np.median, disagreement), "p95": _percentile(disagreement, 95)},
        "fuse_ms": {
            "p50": _percentile(rows.fuse_ms, 50),
            "p99": _percentile(rows.fuse_ms, 99),
            "max": _of(np.max, rows.fuse_ms),
        },
    }


def _repaired(rows: SessionArrays) -> Figures:
    """Shares of frames whose sides were exchanged in each view, and of joints that neither view has.

    Frames without any person do not count. ``exchanged`` is None for methods that do not look for it.
    """
    seen = ~rows.predicted.all(axis=1)
    exchanged = None
    if rows.exchanged is not None:
        exchanged = {key: _of(np.mean, rows.exchanged[seen, k] != 0) for k, key in enumerate(("a", "b"))}
    return {"exchanged": exchanged, "unseen_joints": _of(np.mean, rows.predicted[seen])}


def report_to_json(figures: Figures) -> str:
    """The report as standard JSON."""
    return json.dumps(figures, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _comparison(rows: SessionArrays, exact: SessionArrays) -> Figures:
    apart = np.linalg.norm(rows.fused - exact.fused, axis=2) * 1e3
    return {
        "difference_mm": {"median": _of(np.median, apart), "max": _of(np.max, apart)},
        **{
            name: {
                "max_bone_error_mm": _of(np.max, of.bone_error * 1e3),
                "median_iterations": _of(np.median, of.iterations),
                "at_iteration_limit": int((of.iterations >= MAX_ITERATIONS).sum()),
                "fuse_ms_p50": _percentile(of.fuse_ms, 50),
            }
            for name, of in (("paper", rows), ("exact", exact))
        },
    }


def _of(figure: Any, values: NDArray[Any]) -> float | None:
    """A figure of the finite values; None if there are none."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(figure(finite)) if finite.size else None


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percentile(values: NDArray[Any], percent: float) -> float | None:
    return _of(lambda finite: np.percentile(finite, percent), values)
